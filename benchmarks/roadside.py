"""How real the simulated roadside is: thickness, scatter and clutter of both worlds, beside real sweeps."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, MissingError, Part, part_parser, run_parts

from farfield.api import open_dataset
from farfield.datasets.base import Dataset
from farfield.frame import Frame
from farfield.geometry.boxes import points_in_boxes
from farfield.inspection.statistics.background import BackgroundTally, tell_apart
from farfield.simulation import simulate_frame
from farfield.vocabulary.conditions import WORLDS

_AIMS = {"thickness_m": (0.06, 0.15), "scatter": (0.35, 0.65), "scatter_of_all": (0.08, 0.30), "clusters": (2, 6)}
_LEAST_IN_BOX, _MOST_IN_BOX = 30, 300


def real_sets(real: Path) -> dict[str, Dataset]:
    """Annotated real sweeps by name."""
    return {
        "Luminar": open_dataset(real / "cirrus_layout" / "Cirrus_dataset1"),
        "KITTI": open_dataset(real / "kitti"),
        "KITTI, further": open_dataset(real / "kitti_more"),
        "View-of-Delft": open_dataset(real / "view_of_delft" / "lidar"),
        "Argoverse 2": open_dataset(real / "argoverse2"),
    }


def line(name: str, tally: BackgroundTally) -> str:
    """T, S, S_all and C of some sweeps, each with its interval."""
    summary = tally.summary()
    text = f"  {name:<28}{summary['samples']:4d}"
    for key in _AIMS:
        scale = 100.0 if key == "thickness_m" else 1.0
        value, low, high = (summary[key][end] for end in ("value", "low", "high"))
        span = "" if low is None else f" [{scale * low:.3g}, {scale * high:.3g}]"
        text += f"  {scale * value:6.3g}{span:<16}"
    return text


def within_boxes_m(frames: Sequence[Frame]) -> list[float]:
    """Thickness of what lies within each annotated vehicle: its points' median distance from planes about them."""
    out = []
    for frame in frames:
        points = frame.cloud().points_m.astype(np.float64)
        for rows in points_in_boxes(points, frame.annotation.full_boxes or frame.boxes):
            own = points[rows[:: -(-len(rows) // _MOST_IN_BOX)]] if len(rows) >= _LEAST_IN_BOX else points[:0]
            if not len(own):
                continue
            near = np.linalg.norm(own[:, None] - own[None], axis=2) < 0.75
            own_m = [np.linalg.eigvalsh(np.cov(own[row].T, bias=True))[0] for row in near if row.sum() >= 10]
            out += [float(np.sqrt(max(np.median(own_m), 0.0)))] if own_m else []
    return out


def run_background(arguments: Sequence[str]) -> None:
    """T, S, S_all and C (see ``farfield compare``) of both worlds and of real sweeps, and how well they are told apart.

        python benchmarks/roadside.py background [REAL] [--preset NAME] [--sequences N] [--worlds WORLD ...]

    One frame a sequence. AUC_T: how well a real set's patches are told from the simulated ones by thickness alone; the
    classifier has seven features and is tried on roads that it did not learn from.
    """
    parser = part_parser(run_background.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--preset", default="cirrus-sim-urban")
    parser.add_argument("--sequences", type=int, default=12)
    parser.add_argument("--seed", type=int, default=901)
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS))
    parser.add_argument("--cloud", default="gaussian")
    options = parser.parse_args(arguments)
    if not options.real.is_dir():
        raise MissingError(f"no real frames in {options.real.name}")
    print(f"  {'':<28}{'n':>4}  " + "".join(f"{name:<24}" for name in ("T cm", "S", "S_all", "C a sweep")))
    scale = {"thickness_m": 100.0}
    spans = (f"{scale.get(key, 1) * low:g} to {scale.get(key, 1) * high:g}" for key, (low, high) in _AIMS.items())
    print(f"  {'aims':<34}" + "".join(f"{span:<24}" for span in spans))
    reals = {name: BackgroundTally() for name in real_sets(options.real)}
    for name, data in real_sets(options.real).items():
        for frame in data:
            reals[name].add(frame.cloud().points_m, frame.boxes, frame.sequence)
        print(line(name, reals[name]), flush=True)
    thickness: dict[str, list[float]] = {}
    for world in options.worlds:
        tally, frames = BackgroundTally(), []
        for sequence in range(options.sequences):
            frame = simulate_frame(
                options.preset, seed=options.seed, sequence=sequence, index=0, world=world,
                sensors=(options.cloud,), duration_s=6.0,
            )  # fmt: skip
            full = frame.annotation.full_boxes or frame.boxes
            tally.add(frame.clouds[options.cloud].points_m, full, str(sequence))
            frames.append(frame)
        print(line(f"{options.preset}, {world}", tally), flush=True)
        for name, real in reals.items():
            told = tell_apart(tally.samples, real.samples)
            if told is not None:
                classifier = "" if told.by_classifier is None else f", seven features {told.by_classifier:.2f}"
                first, area = next(iter(told.features.items()))
                print(f"      beside {name:<18} AUC_T {told.by_thickness:.2f}{classifier}, most by {first} {area:.2f}")
        thickness[world] = within_boxes_m(frames)
    for world, values in thickness.items():
        print(f"  thickness within {len(values)} annotated boxes, {world}: {100 * np.median(values):.2f} cm")


if __name__ == "__main__":
    raise SystemExit(run_parts(__doc__, {"background": Part(run_background, "--sequences 1")}))
