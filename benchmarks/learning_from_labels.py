"""What labels of a few sweeps are worth to farfield adapt: real KITTI frames, and a simulated foreign LiDAR."""

import argparse
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _report import ROOT, SHARED_REAL, MissingError, Part, part_parser, progress, run_parts

import farfield as ff
from farfield.datasets import Dataset
from farfield.evaluation import detect
from farfield.experiments.frames import spread
from farfield.metrics.deciding import figure, samples
from farfield.metrics.deciding.difference import ScoreSample
from farfield.metrics.detections import Detections
from farfield.simulation.recording import record
from farfield.training.report import TrainingReport

FIGURES = {"AP 2 m": figure("ap/2.0"), "mAP": figure("dds/0/map"), "DDS": figure("dds/0/dds")}
SETTINGS: dict[str, Any] = {"label": "vehicle", "range_bins_m": (0.0, 70.0), "epsilons": (0.0,), "min_points": 5}
BEFORE = "before"

FOLDS: tuple[dict[str, tuple[str, ...]], ...] = (
    {"0106": ("000000", "000011"), "0101": ("000001", "000004"), "0046": ("000003",), "0028": ("000014",)},
    {"0001": ("002364", "003638", "002352", "002335"), "0026": ("000006",)},
    {
        "0070": ("000005",),
        "0036": ("000010",),
        "0022": ("000019",),
        "0059": ("002155",),
        "0027": ("000013",),
        "0002": ("000134",),
    },
)
"""The KITTI frames by raw drive, in three folds."""
RAW = "0001"
"""The drive of which there are whole raw sweeps, too."""


class Course(TrainingReport):
    """Says how the work goes on, on the error stream."""

    def reading(self, numbers: Iterable[int], what: str) -> Iterable[int]:
        """With a progress bar."""
        return progress(list(numbers), what)

    def say(self, text: str) -> None:
        """Print it."""
        print(text, file=sys.stderr, flush=True)


def searched(detector: str | Path, data: Dataset, journal: Path) -> Detections:
    """What a detector finds in annotated frames, kept in a journal."""
    bar = partial(progress, what=f"searching with {Path(detector).name}")
    return detect(ff.load_detector(detector), data, annotated_only=True, journal=journal, progress=bar)


def joined(parts: Sequence[Detections]) -> Detections:
    """Detections in several sets of other frames, as one."""
    boxes = {key: one for part in parts for key, one in part.boxes.items()}
    annotations = {key: one for part in parts for key, one in part.annotations.items()}
    drives = tuple(drive for part in parts for drive in part.drives)
    return replace(parts[0], boxes=boxes, annotations=annotations, drives=drives)


def print_curve(rows: Mapping[str, dict[str, ScoreSample]], paired_with: Mapping[str, str]) -> None:
    """The figures of each row, and the paired gain over another row."""
    print(f"{'labelled sweeps':<22}" + "".join(f"{name:>9}" for name in FIGURES) + "   gain in AP 2 m and DDS over")
    for name, row in rows.items():
        text = "".join(f"{row[one].value or 0.0:9.3f}" for one in FIGURES)
        for other in (paired_with[name],) if name in paired_with and paired_with[name] in rows else ():
            gains = (gain_text(row[one], rows[other][one]) for one in ("AP 2 m", "DDS"))
            text += f"   {other}: {', '.join(gains)}"
        print(f"{name:<22}{text}")


def gain_text(row: ScoreSample, other: ScoreSample) -> str:
    """A difference with 95 % of its draws, both rows drawn alike."""
    low, high = np.nanquantile(row.draws - other.draws, (0.025, 0.975))
    return f"{(row.value or 0) - (other.value or 0):+.3f} [{low:+.3f}, {high:+.3f}]"


def adapted(
    options: argparse.Namespace, target: Dataset | Path, out: Path, learn_from: Any, source: Path | None
) -> Path:
    """One adaptation; goes on where it was killed."""
    done = ff.adapt(
        options.detector,
        target,
        out=out,
        source=source,
        learn_from=learn_from,
        steps=options.steps,
        rounds=options.rounds,
        source_frames=options.source_frames,
        whole_bodies=options.rounds > 1,
        frames=0,
        report=Course(),
    )
    return done.folder


def common_options(parser: argparse.ArgumentParser, counts: Sequence[int]) -> None:
    """The options of both parts."""
    parser.add_argument("--detector", default="pointpillars-cirrus-sim")
    parser.add_argument("--labelled", nargs="+", type=int, default=list(counts), help="rows: labelled sweeps")
    parser.add_argument("--steps", type=int, default=0, help="of all rounds; the command's own unless given")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--source-frames", type=int, default=240)


# Real KITTI frames, drives held apart.


def laid_out(real: Path, folder: Path, frames: Sequence[str], *, labels: bool, sweeps: Path | None = None) -> Path:
    """A folder in KITTI's layout with some of the frames, as links; made anew where it is not what it should be.

    Args:
        real: Where ``kitti`` and ``kitti_more`` stand.
        folder: The folder.
        frames: Names of frames.
        labels: With their labels.
        sweeps: Further sweeps without labels, ``*.bin``.
    """
    shutil.rmtree(folder, ignore_errors=True)
    kinds = {"velodyne": ".bin", "calib": ".txt", "image_2": ".*", **({"label_2": ".txt"} if labels else {})}
    for frame in frames:
        for kind, suffix in kinds.items():
            for path in real.glob(f"kitti*/training/{kind}/{frame}{suffix}"):
                (folder / "training" / kind).mkdir(parents=True, exist_ok=True)
                (folder / "training" / kind / path.name).symlink_to(path)
    for number, path in enumerate(() if sweeps is None else sorted(sweeps.glob("*.bin"))):
        (folder / "training" / "velodyne" / f"{900000 + number:06d}.bin").symlink_to(path)
    return folder


def run_kitti(arguments: Sequence[str]) -> None:
    """KITTI frames: AP of vehicles over how many labelled sweeps taught, drives held apart, paired with intervals.

        python benchmarks/learning_from_labels.py kitti [REAL] [--labelled 0 2 5 10] [--folds 0 1 2] [--work FOLDER]

    The 17 frames are of 12 drives in three folds. A fold's frames score; of the other drives N frames teach by
    their labels, of as many drives as possible, and all their sweeps, and four whole ones of drive 0001 unless it
    scores, by pseudo boxes. Row 0 has pseudo boxes alone. Scored are vehicles of five points and more within 70 m, all
    folds that were run together; draws are of frames, the same for both rows of a difference. Killed, a call goes on.
    """
    parser = part_parser(run_kitti.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--folds", nargs="+", type=int, default=list(range(len(FOLDS))))
    parser.add_argument("--work", type=Path, default=ROOT / "data" / "learning-kitti")
    common_options(parser, (0, 2, 5, 10))
    options = parser.parse_args(arguments)
    real, work = options.real.resolve(), options.work.resolve()
    if not (real / "kitti").is_dir():
        raise MissingError(f"no KITTI frames in {real.name}")
    names = [BEFORE, *(str(count) for count in options.labelled)]
    parts: dict[str, list[Detections]] = {name: [] for name in names}
    source: Path | None = None
    for fold in options.folds:
        scored = [frame for drive in FOLDS[fold].values() for frame in drive]
        taught = [drive for number, drives in enumerate(FOLDS) if number != fold for drive in drives.values()]
        in_turn = [one[turn] for turn in range(max(map(len, taught))) for one in taught if turn < len(one)]
        raw = real / "kitti_raw/2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data"
        sweeps = None if RAW in FOLDS[fold] else raw
        home = work / f"fold-{fold}"
        target = laid_out(real, home / "sweeps", in_turn, labels=False, sweeps=sweeps)
        held = ff.open_dataset(laid_out(real, home / "scored", scored, labels=True))
        parts[BEFORE].append(searched(options.detector, held, home / ".found-before.jsonl"))
        for count in options.labelled:
            labels = laid_out(real, home / f"labels-{count}", in_turn[:count], labels=True) if count else None
            folder = adapted(options, target, home / f"adapted-{count}", labels, source)
            source = source or folder / "source"
            parts[str(count)].append(searched(folder, held, home / f".found-{count}.jsonl"))
        print(f"fold {fold}: scored {', '.join(scored)}; {len(ff.open_dataset(target))} sweeps teach")
    found = {name: joined(one) for name, one in parts.items()}
    rows = {name: samples(one, FIGURES, **SETTINGS) for name, one in found.items()}
    objects = found[BEFORE].counted().score("dds", **SETTINGS).counts["annotated"]
    frames = len(found[BEFORE].annotations)
    print(f"\n{options.detector}: {frames} frames of {len(options.folds)} of {len(FOLDS)} folds, {objects} vehicles")
    print_curve(rows, {str(count): "0" if count and 0 in options.labelled else BEFORE for count in options.labelled})


# Another LiDAR, simulated.


def simulated(work: Path, name: str, frames: int, sequences: int, seed: int) -> Dataset:
    """Frames of the simulated os2-64, made once."""
    bar = partial(progress, what=f"simulating {name}")
    record("kradar-sim", work / name, frames=frames, sequences=sequences, sensors="os2-64", seed=seed, progress=bar)
    return ff.open_dataset(work / name)


def run_foreign(arguments: Sequence[str]) -> None:
    """A simulated os2-64, which the Cirrus detectors never saw: 0 to 200 labelled sweeps, scored on other drives.

        python benchmarks/learning_from_labels.py foreign [--labelled 0 20 50 100 200] [--work FOLDER]

    The target is 240 frames of 48 drives; the labelled ones are spread over them evenly, and all others teach by pseudo
    boxes. Scored are vehicles of five points and more within 70 m on other drives; draws are of drives, the same for
    both rows of a difference. Killed, a call goes on.
    """
    parser = part_parser(run_foreign.__doc__)
    parser.add_argument("--work", type=Path, default=ROOT / "data" / "learning-foreign")
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument("--scored", type=int, default=120)
    common_options(parser, (0, 20, 50, 100, 200))
    options = parser.parse_args(arguments)
    work = options.work.resolve()
    target = simulated(work, "target", options.frames, max(1, options.frames // 5), 31)
    held = simulated(work, "scored", options.scored, max(1, options.scored // 3), 731)
    rows = {BEFORE: samples(searched(options.detector, held, work / ".found-before.jsonl"), FIGURES, **SETTINGS)}
    source: Path | None = None
    for count in options.labelled:
        labels = target.select(spread(len(target), count)) if count else None
        folder = adapted(options, target, work / f"adapted-{count}", labels, source)
        source = source or folder / "source"
        rows[str(count)] = samples(searched(folder, held, work / f".found-{count}.jsonl"), FIGURES, **SETTINGS)
    print(f"\n{options.detector}: {len(held)} frames of {len(set(held.sequences))} other drives, the os2-64")
    print_curve(rows, {str(count): "0" if count and 0 in options.labelled else BEFORE for count in options.labelled})


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "kitti": Part(run_kitti, None),
                "foreign": Part(
                    run_foreign,
                    "--work TMP/foreign --frames 5 --scored 3 --labelled 2 --steps 2 --rounds 1 --source-frames 2",
                ),
            },
        )
    )
