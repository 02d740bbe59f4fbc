"""One drag, Fit, one click and a turned box on vehicles of drives that no constant of the heading was chosen on."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from _gestures import Subject, drag, measured, pressed, subjects
from _report import SHARED_REAL, part_parser

from farfield.annotation.annotator import offered_classes
from farfield.annotation.fitting import BoxFit, fit_click, refit
from farfield.annotation.schema import cirrus_class
from farfield.datasets import open_dataset
from farfield.frame import Frame
from farfield.simulation import simulate_frame

RANGES_M = ((0, 30), (30, 60), (60, 100))
UNSEEN_KITTI = ("000005", "000006", "000010", "000013", "000014", "000019", "002155")
UNSEEN_ASTYX = ("000208", "000267", "000306", "000356", "000378")
UNSEEN_SEED, UNSEEN_PX, UNSEEN_DEG, PIXELS_A_METRE = 6060, 3.0, 3.0, 24.0
UNSEEN_AIMS = "   aims of the issue: drag 0-30 m after Fit .78, drag 30-60 m .76, click .72; yaw within 10 degrees: .90"


def hand_click(subject: Subject, rng: np.random.Generator) -> BoxFit:
    prior = replace(subject.prior, lane_rad=0.0 if subject.prior.anchored else None)
    return fit_click(subject.points_m, pressed(subject, rng, UNSEEN_PX / PIXELS_A_METRE), prior)


def hand_drag(subject: Subject, rng: np.random.Generator) -> BoxFit:
    return drag(subject, rng, error_m=UNSEEN_PX / PIXELS_A_METRE, error_deg=UNSEEN_DEG)


def hand_fit(subject: Subject, rng: np.random.Generator) -> BoxFit:
    return refit(subject.points_m, hand_drag(subject, rng).box, subject.prior)


def turned_fit(subject: Subject, rng: np.random.Generator) -> BoxFit:
    """Fit of a box of the usual size that stands 10 degrees off, its middle as a hand places it."""
    middle = subject.box.centre_m[0] + np.append(rng.normal(0, UNSEEN_PX / PIXELS_A_METRE, 2), 0.0)
    yaw = float(subject.box.yaw_rad[0]) + np.deg2rad(10.0) * rng.choice([-1, 1])
    return refit(subject.points_m, [*middle, *subject.prior.size_m, yaw], subject.prior)


UNSEEN_GESTURES: dict[str, Callable[[Subject, np.random.Generator], BoxFit]] = {
    "one drag": hand_drag,
    "one drag, then Fit": hand_fit,
    "one click": hand_click,
    "10 degrees off, then Fit": turned_fit,
}


def offered_size(format_name: str, label: str, length_m: float) -> tuple[float, float, float] | None:
    """The size that the page offers, without labels of its own, for a class or the type that a person tells.

    None where the data set has no such class: nobody can annotate that there.
    """
    offered = offered_classes(format_name, (), {})
    specs = [spec for name, spec in offered.items() if label in (name, cirrus_class(name))]
    sizes = [size for spec in specs for size in (spec.size_m, *spec.types.values())]
    return min(sizes, key=lambda size: abs(size[0] - length_m), default=None)


def unseen_subjects(real: Path, simulated_drives: int) -> dict[str, list[Subject]]:
    """Vehicles by data set, with the presets as shipped."""
    sources: dict[str, list[tuple[str, Frame]]] = {}
    for title, folder, names in (
        ("KITTI", "kitti_more", UNSEEN_KITTI),
        ("Astyx (VLP-16)", "astyx", UNSEEN_ASTYX),
        ("SUSTechPOINTS", "sustechpoints", ()),
    ):
        if (real / folder).is_dir():
            data = open_dataset(real / folder)
            chosen = [index for index, key in enumerate(data.keys) if not names or key[1] in names]
            sources[title] = [(data.name, _lidar_only(data[index])) for index in chosen]
    sources["simulated"] = [
        ("kradar", simulate_frame("kradar-sim", seed=UNSEEN_SEED, sequence=sequence, index=0))
        for sequence in range(1, simulated_drives + 1)
    ]
    chosen_by_title = {}
    for title, frames in sources.items():
        sized = []
        for one in (subject for frame in frames for subject in subjects([frame])):
            if one.vehicle:
                size = offered_size(one.source, str(one.box.label[0]), float(one.box.size_m[0, 0]))
                if size is None:
                    continue
                sized.append(replace(one, prior=replace(one.prior, size_m=size)))
        chosen_by_title[title] = sized
    return chosen_by_title


def _lidar_only(frame: Frame) -> Frame:
    return replace(frame, clouds={"lidar": frame.clouds["lidar"]})


def run_unseen(arguments: Sequence[str]) -> None:
    """One drag, Fit, one click and a box 10 degrees off, on drives that no constant of the heading was chosen on.

        python benchmarks/studio_fitting.py unseen [REAL] [--seeds 2] [--simulated 10]

    A press is 3 pixels beside a point of the object at 24 pixels a metre, a drag 3 degrees off; the usual sizes are
    those that are offered where a data set has no labels. Real frames were split by drive first: the heading's
    constants were chosen on KITTI's drives 0002, 0046, 0101, 0106 and 0001, five frames of Astyx, Luminar and
    Argoverse 2; what is reported are seven other drives of KITTI, five other frames of Astyx, one of SUSTechPOINTS, and
    simulated drives of seed 6060. Yaw is the axis: 180 degrees are not told apart. ``decided`` are clicks whose points
    tell the axis, as the fit itself says.
    """
    parser = part_parser(run_unseen.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--simulated", type=int, default=10)
    options = parser.parse_args(arguments)
    for title, chosen in unseen_subjects(options.real, options.simulated).items():
        print(f"\n{title}: {len(chosen)} vehicles; overlap from above, centre, yaw (medians), 90 % of yaws")
        for name, gesture in UNSEEN_GESTURES.items():
            print(_unseen_row(name, chosen, gesture, options.seeds), flush=True)
    print(UNSEEN_AIMS)


def _unseen_row(
    name: str, chosen: Sequence[Subject], gesture: Callable[[Subject, np.random.Generator], BoxFit], seeds: int
) -> str:
    criteria: list[str] = []
    noted = partial(_noting, gesture, criteria)
    errors = [measured(chosen, noted, seed=seed) for seed in range(1, seeds + 1)]
    ranges = np.tile([one.range_m for one in chosen], seeds)
    iou, centre_m, yaw = (
        np.concatenate([getattr(part, field) for part in errors]) for field in ("iou", "centre_m", "yaw_deg")
    )
    groups = [(f"{low}-{high} m", (ranges >= low) & (ranges < high)) for low, high in RANGES_M]
    decided = np.array(criteria) == "faces"
    groups += [("decided", decided)] if name == "one click" else []
    cells = [
        f"{title} ({int(which.sum())}) {np.median(iou[which]):.2f} [{_interval(iou[which])}] "
        f"{np.median(centre_m[which]):.2f} m {np.median(yaw[which]):.1f} p90 {np.quantile(yaw[which], 0.9):.0f}"
        for title, which in groups
        if which.any()
    ]
    return f"  {name:<25} all {np.median(iou):.2f} [{_interval(iou)}]; within 10 {np.mean(yaw < 10):.2f}; " + "; ".join(
        cells
    )


def _noting(
    gesture: Callable[[Subject, np.random.Generator], BoxFit],
    criteria: list[str],
    subject: Subject,
    rng: np.random.Generator,
) -> BoxFit:
    fitted = gesture(subject, rng)
    criteria.append(fitted.criterion)
    return fitted


def _interval(values: np.ndarray) -> str:
    """95 % of the medians of resampled values."""
    drawn = np.random.default_rng(0).choice(values, size=(400, len(values)))
    low, high = np.quantile(np.median(drawn, axis=1), [0.025, 0.975])
    return f"{low:.2f} {high:.2f}"
