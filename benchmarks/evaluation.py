"""Scoring: K-Radar's average precision beside its kit, K-Radar's labels beside what is published, DDS' choices."""

import argparse
import csv
import itertools
import json
import os
import resource
import tarfile
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _report import SHARED_REAL, MissingError, Part, child_output, part_parser, run_parts

from farfield.datasets import open_dataset
from farfield.datasets.kradar import KRadar
from farfield.datasets.kradar.label_table import DEFECTS, LabelTable
from farfield.geometry.boxes import Boxes
from farfield.metrics import (
    Bootstrap,
    DdsSettings,
    KRadarResult,
    KRadarSettings,
    evaluate_dds,
    evaluate_kradar,
    kradar_settings,
)
from farfield.metrics.box_files import read
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M, SEQUENCES

ByFrame = dict[tuple[str, str], Boxes]
KRADAR_CLASSES = ("vehicle", "large_vehicle")
NO_INTERVALS = Bootstrap(replicates=0)
LIMITS = {"whole": (1.5, 500), "subsets": (3.0, None)}
_MAX_LABEL_BYTES = 1 << 20


def run_kradar(arguments: Sequence[str]) -> int:
    """K-Radar's average precision on the whole test split: time, memory, and parity with the development kit.

        python benchmarks/evaluation.py kradar [--repeats 5] [--real FOLDER]

    The annotated boxes are the real ones (labels v2.1, test split, wide region, Sedan and Bus or Truck); the
    predictions come from a seeded noise model. Each measurement runs in a process of its own, so that its peak memory
    is that of the evaluation with the boxes already in memory. Reading is not timed. The parity table compares with
    what the kit prints for 500 frames. Without the real files this is left out.
    """
    parser = part_parser(run_kradar.__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--real", type=Path, default=SHARED_REAL / "kradar")
    parser.add_argument("--frames", type=int, help="of the test split, in place of all")
    parser.add_argument("--only", nargs="+", choices=list(WORK), default=list(WORK))
    parser.add_argument("--worker", choices=list(WORK), help=argparse.SUPPRESS)
    parser.add_argument("scene", nargs="?", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.worker:
        print(json.dumps(measure(options.worker, options.scene, options.repeats)))
        return 0
    if not (options.real / "labels_v2_1.tar.gz").is_file():
        raise MissingError("no real K-Radar labels beside the project")
    passed = parity(options.real / "evaluation")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.npz"
        write_scene(path, options.real, options.frames)
        turned(path)
        for name in options.only:
            found = json.loads(child_output("--worker", name, "--repeats", options.repeats, path))
            passed &= report(name, found)
    return 0 if passed else 1


def parity(folder: Path) -> bool:
    """Compare every figure with the kit's on 500 frames; both are in per cent."""
    predictions, annotations = fixture(folder / "boxes_iso.csv")
    expected = json.loads((folder / "expected_iso.json").read_text())["variants"]
    worst = 0.0
    count = 0
    print("\nparity with the development kit, 500 frames, per cent (kit | here)")
    for variant, values in expected.items():
        settings = kradar_settings(f"kradar-compat:{variant}", region="none", bootstrap=NO_INTERVALS)
        figures = evaluate_kradar(predictions, annotations, settings).figures
        for short, label in (("sed", "vehicle"), ("bus", "large_vehicle")):
            kit = values["ap"][short]
            cells = []
            for measure_name in ("bev", "3d"):
                for iou, theirs in zip(kit["iou"], kit[measure_name], strict=True):
                    ours = 100 * (figures[f"ap/{label}/{measure_name}/{iou:g}"] or 0.0)
                    worst, count = max(worst, abs(ours - theirs)), count + 1
                    cells.append(f"{measure_name} {iou}: {theirs:.3f} | {ours:.3f}")
            print(f"  {variant:<20} {label:<14} {'   '.join(cells)}")
    print(f"  {count} figures, largest difference {worst:.6f} (limit 0.001; the kit's are rounded to 0.001)")
    return worst <= 0.001


def fixture(path: Path) -> tuple[ByFrame, ByFrame]:
    """Predictions and annotations of the parity files."""
    rows: dict[tuple[str, str], dict[str, list[dict[str, str]]]] = {}
    with path.open(newline="") as handle:
        for row in csv.DictReader(handle):
            rows.setdefault((row["seq"], row["stem"]), {"gt": [], "pred": []})[row["kind"]].append(row)
    sides = {"gt": {}, "pred": {}}
    for key, kinds in rows.items():
        for kind, found in kinds.items():
            names = ("x", "y", "z", "l", "w", "h", "yaw_rad", "score")
            table = np.array([[float(row[name]) for name in names] for row in found]).reshape(-1, len(names))
            sides[kind][key] = Boxes(
                centre_m=table[:, :3],
                size_m=table[:, 3:6],
                yaw_rad=table[:, 6],
                label=[row["cls"] for row in found],
                score=table[:, 7] if kind == "pred" else None,
            )
    return sides["pred"], sides["gt"]


def write_scene(path: Path, real: Path, frames: int | None) -> None:
    """The test split's annotated boxes in the radar's frame and predictions made of them, as flat arrays."""
    annotations = read_test_split(real, frames)
    settings = KRadarSettings(classes=KRADAR_CLASSES)
    low, high = np.array(settings.bounds_m)[::2], np.array(settings.bounds_m)[1::2]
    kept: ByFrame = {}
    for key, boxes in annotations.items():
        moved = boxes.replace(centre_m=boxes.centre_m - np.array(KRADAR_ORIGIN_M))
        inside = ((moved.centre_m >= low) & (moved.centre_m <= high)).all(axis=1) & np.isin(moved.label, KRADAR_CLASSES)
        inside &= np.abs(np.arctan2(moved.centre_m[:, 1], moved.centre_m[:, 0])) <= np.deg2rad(53.0)
        if inside.any():
            kept[key] = moved[inside]
    keys = np.array(list(kept))
    frame = np.repeat(np.arange(len(kept)), [len(boxes) for boxes in kept.values()])
    annotated = Boxes.concatenate([boxes.replace(track_id=None) for boxes in kept.values()])
    predicted, predicted_frame = predict(annotated, frame, len(kept), np.random.default_rng(7))
    arrays: dict[str, np.ndarray] = {"keys": keys}
    for side, boxes, frames in (("annotated", annotated, frame), ("predicted", predicted, predicted_frame)):
        arrays |= {f"{side}_{name}": getattr(boxes, name) for name in ("centre_m", "size_m", "yaw_rad", "label")}
        arrays[f"{side}_frame"] = frames
    arrays["predicted_score"] = predicted.score if predicted.score is not None else np.zeros(0)
    np.savez(path, **arrays)
    pairs = (np.bincount(frame, minlength=len(kept)) * np.bincount(predicted_frame, minlength=len(kept))).sum()
    print(
        f"\ntest split: {len(annotations)} frames, {len(kept)} with an annotated box of the two classes in the wide "
        f"region;\n{len(annotated)} annotated, {len(predicted)} predicted by noise (seed 7), {pairs} pairs in a frame"
    )


def turned(path: Path) -> None:
    """What the quarter turn does: noise along and across the heading, scored as the kit does and correctly."""
    _, annotations = load_scene(path)
    print("\nAP_BEV of vehicle at IoU 0.5 in per cent, position errors along and across the heading (seed 7)")
    for along_m, across_m in ((0.8, 0.1), (0.1, 0.8), (0.5, 0.5)):
        rng = np.random.default_rng(7)
        predictions = {}
        for key, boxes in annotations.items():
            error_m = rng.normal(0, 1, (len(boxes), 2)) * (along_m, across_m)
            cos, sin = np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)
            moved = np.column_stack(
                [error_m[:, 0] * cos - error_m[:, 1] * sin, error_m[:, 0] * sin + error_m[:, 1] * cos]
            )
            centre = boxes.centre_m + np.column_stack([moved, np.zeros(len(boxes))])
            predictions[key] = boxes.replace(centre_m=centre, score=rng.uniform(0.3, 1.0, len(boxes)))
        figures = []
        for name in ("revised_as_shipped", "revised_yaw_fixed"):
            settings = kradar_settings(f"kradar-compat:{name}", bootstrap=NO_INTERVALS)
            figures.append(
                100 * (evaluate_kradar(predictions, annotations, settings).figures["ap/vehicle/bev/0.5"] or 0)
            )
        print(f"  along {along_m} m, across {across_m} m: as shipped {figures[0]:.1f}, yaw corrected {figures[1]:.1f}")


def read_test_split(real: Path, frames: int | None) -> ByFrame:
    """Annotated boxes of the test split in the os2-64's frame, read from the archive without unpacking it."""
    from farfield.datasets.kradar.labels import parse_labels

    lines = (real / "split" / "test.txt").read_text().split()[:frames]
    wanted = {tuple(line.split(",")) for line in lines}
    found: ByFrame = {}
    with tarfile.open(real / "labels_v2_1.tar.gz") as archive:
        for member in archive:
            key = tuple(member.name.split("/")[-2:])
            if key not in wanted or not member.isfile() or member.size > _MAX_LABEL_BYTES:
                continue
            handle = archive.extractfile(member)
            if handle is not None:
                found[key[0], key[1].removesuffix(".txt")] = parse_labels(handle.read(), member.name).boxes
            if len(found) == len(wanted):
                break
    if len(found) != len(wanted):
        raise SystemExit(f"expected {len(wanted)} label files of the test split, found {len(found)}")
    return found


def predict(annotated: Boxes, frame: np.ndarray, frames: int, rng: np.random.Generator) -> tuple[Boxes, np.ndarray]:
    """A detector of noise: finds boxes with errors, some twice, the far ones less often, and sees false ones."""
    found = np.flatnonzero(rng.random(len(annotated)) < 0.97 - 0.004 * annotated.range_m)
    twice = found[rng.random(len(found)) < 0.1]
    source = np.concatenate([found, twice])
    false_frame = np.repeat(np.arange(frames), rng.poisson(1.61, frames))
    count = len(false_frame)
    template = rng.integers(0, len(annotated), count)
    error_m = np.column_stack([rng.normal(0, 0.5, len(source)), rng.normal(0, 0.3, len(source))])
    centre = annotated.centre_m[source] + np.column_stack([error_m, rng.normal(0, 0.15, len(source))])
    false_centre = rng.uniform([0, -16, -2], [72, 16, 2], (count, 3))
    size = annotated.size_m[source] * rng.normal(1, 0.06, (len(source), 3)).clip(0.7, 1.3)
    score = np.clip(rng.normal(0.75, 0.15, len(source)) - 0.15 * np.hypot(*error_m.T), 0.01, 1.0)
    boxes = Boxes(
        centre_m=np.concatenate([centre, false_centre]),
        size_m=np.concatenate([size, annotated.size_m[template]]),
        yaw_rad=np.concatenate(
            [annotated.yaw_rad[source] + rng.normal(0, 0.06, len(source)), rng.uniform(-np.pi, np.pi, count)]
        ),
        label=np.concatenate([annotated.label[source], annotated.label[template]]),
        score=np.concatenate([score, rng.beta(1.5, 3.0, count).clip(0.01, 1.0)]),
    )
    owner = np.concatenate([frame[source], false_frame])
    order = np.argsort(owner, kind="stable")
    return boxes[order], owner[order]


def load_scene(path: Path) -> tuple[ByFrame, ByFrame]:
    """Predictions and annotations by frame."""
    with np.load(path, allow_pickle=False) as scene:
        arrays = dict(scene)
    keys = [(str(sequence), str(stem)) for sequence, stem in arrays["keys"]]
    sides = []
    for side in ("predicted", "annotated"):
        cuts = np.searchsorted(arrays[f"{side}_frame"], np.arange(1, len(keys)))
        names = ["centre_m", "size_m", "yaw_rad", "label", *(["score"] if side == "predicted" else [])]
        parts = {name: np.split(arrays[f"{side}_{name}"], cuts) for name in names}
        rows = zip(*parts.values(), strict=True)
        sides.append({key: Boxes(**dict(zip(names, row, strict=True))) for key, row in zip(keys, rows, strict=True)})
    return sides[0], sides[1]


def _whole(predictions: ByFrame, annotations: ByFrame) -> KRadarResult:
    return evaluate_kradar(predictions, annotations, KRadarSettings(bootstrap=NO_INTERVALS, label_version="v2.1"))


def _compat(predictions: ByFrame, annotations: ByFrame) -> KRadarResult:
    settings = kradar_settings("kradar-compat:revised_as_shipped", bootstrap=NO_INTERVALS, label_version="v2.1")
    return evaluate_kradar(predictions, annotations, settings, protocol="kradar-compat:revised_as_shipped")


def _conditions(annotations: ByFrame) -> dict[tuple[str, str], dict[str, str]]:
    from farfield.vocabulary.kradar import published_conditions

    return {key: published_conditions(key[0]) for key in annotations}


def _subsets(predictions: ByFrame, annotations: ByFrame) -> KRadarResult:
    conditions = _conditions(annotations)
    settings = KRadarSettings(bootstrap=NO_INTERVALS, label_version="v2.1")
    return evaluate_kradar(predictions, annotations, settings, conditions=conditions)


def _intervals(predictions: ByFrame, annotations: ByFrame) -> KRadarResult:
    conditions = _conditions(annotations)
    return evaluate_kradar(predictions, annotations, KRadarSettings(label_version="v2.1"), conditions=conditions)


def _perfect(predictions: ByFrame, annotations: ByFrame) -> KRadarResult:
    del predictions
    found = {key: boxes.replace(score=np.ones(len(boxes))) for key, boxes in annotations.items()}
    return _subsets(found, annotations)


WORK: dict[str, Callable[[ByFrame, ByFrame], KRadarResult]] = {
    "whole": _whole,
    "compat": _compat,
    "subsets": _subsets,
    "intervals": _intervals,
    "perfect": _perfect,
}
TITLES = {
    "whole": "kradar: the whole and four range bins",
    "compat": "kradar-compat:revised_as_shipped: the whole and four range bins (the kit took 67.9 s and 1,872 MB)",
    "subsets": "kradar: the whole, 17 conditions and four range bins",
    "intervals": "the same with 200 bootstrap replicates",
    "perfect": "kradar: annotated against annotated",
}


def peak_mb() -> float:
    """Largest resident memory of this process so far; unlike getrusage's it does not begin with the parent's."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def measure(name: str, scene: Path, repeats: int) -> dict[str, Any]:
    """Times of one evaluation, the process's peak memory and the printed result."""
    predictions, annotations = load_scene(scene)
    before_mb = peak_mb()
    wall_s, cpu_s = [], []
    for _ in range(1 if name in ("intervals", "perfect") else repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        result = WORK[name](predictions, annotations)
        wall_s.append(time.perf_counter() - wall)
        cpu_s.append(time.process_time() - cpu)
    parts = [value for _, _, figures, _ in result.parts() for value in figures.values() if value is not None]
    return {
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "before_mb": before_mb,
        "peak_mb": peak_mb(),
        "lowest": min(parts),
        "parts": sum(1 for _ in result.parts()),
        "table": str(result),
    }


def report(name: str, found: dict[str, Any]) -> bool:
    """Print one measurement; returns whether it is within its limits."""
    best_s, first_s = min(found["wall_s"]), found["wall_s"][0]
    print(f"\n{TITLES[name]}")
    print(
        f"  first {first_s:.3f} s, least of {len(found['wall_s'])} {best_s:.3f} s ({min(found['cpu_s']):.3f} s of "
        f"processor time); peak {found['peak_mb']:.0f} MB, {found['before_mb']:.0f} MB of it before the evaluation"
    )
    if name == "perfect":
        print(f"  lowest figure of the non-empty subsets: {100 * found['lowest']:.12g}")
        return bool(found["lowest"] == 1.0)
    if name in ("compat", "intervals"):
        print("\n" + found["table"])
    limit_s, limit_mb = LIMITS.get(name, (np.inf, None))
    return bool(best_s <= limit_s and (limit_mb is None or found["peak_mb"] <= limit_mb))


os.environ.setdefault("OMP_NUM_THREADS", "1")


FRAMES, EMPTY, OBJECTS = 34_994, 4_307, 115_229
LABELS_CLASSES = {  # objects, tracks, R, L, L1; the slips LL and l count as L, LR as L1
    "Sedan": (89_272, 1_424, 52_822, 16_731, 19_719),
    "Bus or Truck": (18_380, 246, 11_648, 3_908, 2_824),
    "Pedestrian": (5_863, 61, 4_483, 599, 781),
    "Bicycle": (955, 33, 706, 172, 77),
    "Motorcycle": (616, 18, 323, 96, 197),
    "Pedestrian Group": (137, 7, 110, 27, 0),
    "Bicycle Group": (6, 2, 6, 0, 0),
}
WEATHER = {  # the supplement's Table 5, summed by weather
    "normal": 12_781,
    "overcast": 825,
    "fog": 3_578,
    "rain": 4_780,
    "sleet": 7_040,
    "light_snow": 2_237,
    "heavy_snow": 3_753,
}
LIMIT_S = 10.0


def read_labels(root: Path) -> tuple[KRadar, LabelTable, float, float]:
    """The data set, its table, and the seconds that opening and reading took."""
    start = time.perf_counter()
    dataset = open_dataset(root)
    opened = time.perf_counter()
    assert isinstance(dataset, KRadar)
    table = dataset.label_table()
    return dataset, table, opened - start, time.perf_counter() - opened


def counts(dataset: KRadar, table: LabelTable) -> tuple[list[str], bool]:
    """Lines of found and published figures, and whether all agree."""
    lines, good = [], True

    def compare(what: str, found: object, published: object) -> None:
        nonlocal good
        good &= found == published
        lines.append(f"{what:46}{found!s:>40}{published!s:>40}  {'' if found == published else 'DIFFERS'}")

    lines.append(f"{'':46}{'found':>40}{'published':>40}")
    compare("frames", len(table.stem), FRAMES)
    compare("empty frames", int((table.per_frame == 0).sum()), EMPTY)
    compare("objects", len(table.name), OBJECTS)
    compare("damaged files", len(table.damaged), 0)
    tracks, flags = table.tracks(), Counter(zip(table.name.tolist(), table.availability.tolist(), strict=True))
    for name, published in LABELS_CLASSES.items():
        found = (
            int((table.name == name).sum()),
            tracks.get(name, 0),
            *(flags[name, flag] for flag in ("R", "L", "L1")),
        )
        compare(f"{name}: objects, tracks, R, L, L1", found, published)
    conditions = {name: dataset.of_sequence(name).conditions for name in dict.fromkeys(dataset.sequences)}
    for kind in ("weather", "road", "time"):
        found = Counter(conditions[name][kind] for name in table.sequence.tolist())
        published: Counter[str] = Counter()
        for one in SEQUENCES.values():
            published[one.conditions[kind]] += one.frames
        for name, count in found.most_common():
            compare(f"frames, {kind} {name}", count, published[name])
            if kind == "weather":
                good &= count == WEATHER[name]
    frames = Counter(table.sequence.tolist())
    compare("sequences as long as published", sum(frames[n] == one.frames for n, one in SEQUENCES.items()), 58)
    return lines, good


def run_labels(arguments: Sequence[str]) -> int:
    """All annotations of K-Radar beside what is published of them: frames, classes, tracks, visibility, weather.

        python benchmarks/evaluation.py labels [--archive labels_v2_1.tar.gz | --tree FOLDER] [--rounds 5]

    The archive is unpacked into a temporary folder; unpacking is not counted. The time is that of opening the tree and
    of reading and parsing every file in one process, the files in the system's cache; the first round is printed apart.
    Exit status 1 where a count is not the published one.
    """
    parser = part_parser(run_labels.__doc__)
    parser.add_argument("--archive", type=Path, default=SHARED_REAL / "kradar" / "labels_v2_1.tar.gz")
    parser.add_argument("--tree", type=Path, help="an unpacked tree of annotations v2.1 instead of the archive")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--first", type=int, help="so many files of the archive, in place of all")
    options = parser.parse_args(arguments)
    if options.tree is None and not options.archive.is_file():
        raise MissingError(f"no {options.archive.name} beside the project")
    with tempfile.TemporaryDirectory() as folder:
        root = options.tree or Path(folder)
        if options.tree is None:
            with tarfile.open(options.archive) as archive:
                members = archive if options.first is None else itertools.islice(archive, options.first)
                archive.extractall(root, [*members], filter="data")
        rounds = [read_labels(root) for _ in range(options.rounds)]
        dataset, table, *_ = rounds[-1]
        lines, good = counts(dataset, table)
        start = time.perf_counter()
        boxes = table.boxes_by_frame()
        split_s = time.perf_counter() - start
    times = [opened + seconds for _, _, opened, seconds in rounds]
    _, _, opened, seconds = min(rounds, key=lambda one: one[2] + one[3])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    lines += [
        "",
        *(f"defect: {table.defects[name]:6} {what}" for name, what in DEFECTS.items() if table.defects[name]),
        "",
        f"open and read all {len(table.stem):,} files, 1 process: best {min(times):.2f} s of {options.rounds} "
        f"(opening {opened:.2f}, reading {seconds:.2f}); first {times[0]:.2f} s; limit {LIMIT_S:g} s",
        f"boxes of each of {len(boxes):,} frames: {split_s:.2f} s more",
        f"peak memory of the process: {peak:.0f} MB",
        f"every count as published: {'yes' if good else 'NO'}",
    ]
    print("\n".join(lines))
    return int(not good or min(times) > LIMIT_S)


TRACKING = SHARED_REAL / "kitti_tracking"
CHOICES = (
    {},
    {"distance": "bev"},
    {"omega_range": "pred"},
    {"match": "nearest_normalised"},
    {"ap": "interp101"},
    {"ap": "area"},
    {"ap": "voc"},
    {"aiou": "scale"},
    {"aiou": "bev"},
    {"aiou_threshold_m": 0.5},
    {"aiou_threshold_m": 4.0},
    {"aiou_threshold_m": "all"},
    {"aiou_mean": "tp_mean"},
    {"range_assign": "match_then_bin"},
    {"ties": "later_first"},
    {"ties": "stable"},
    {"scores": "raw"},
)


def run_dds(arguments: Sequence[str]) -> None:
    """How much each open choice of DDS moves the score, on real detections.

    python benchmarks/evaluation.py dds [DETECTIONS LABELS] [--format kitti-tracking] [--label Car]
    """
    parser = part_parser(run_dds.__doc__)
    parser.add_argument("detections", type=Path, nargs="?", default=TRACKING / "detections_pointrcnn_car")
    parser.add_argument("labels", type=Path, nargs="?", default=TRACKING / "label")
    parser.add_argument("--format", default="kitti-tracking")
    parser.add_argument("--label", default="Car")
    options = parser.parse_args(arguments)
    if not options.labels.is_dir():
        raise MissingError(f"no {options.labels.name} beside the project")
    found = read(options.detections, options.labels, format=options.format)
    base = None
    print(f"{'choice':<36} {'DDS':>7} {'0.006':>7} {'50 m +':>7}   change of each")
    for choice in CHOICES:
        settings = DdsSettings(
            label=options.label,
            region="none",
            range_bins_m=(0.0, 25.0, 50.0, 1e9),
            epsilons=(0.0, 0.006),
            bootstrap=Bootstrap(replicates=0),
            **choice,
        )
        result = evaluate_dds(found.boxes, found.annotated, settings)
        far = list(result.ranges.values())[-1]
        row = (result.figures["dds/0/dds"], result.figures["dds/0.006/dds"], far["dds/0/dds"])
        base = base or row
        name = ", ".join(f"{key}={value}" for key, value in choice.items()) or "default"
        change = "  ".join(f"{value - start:+.4f}" for value, start in zip(row, base, strict=True))
        print(f"{name:<36} " + " ".join(f"{value:7.4f}" for value in row) + f"   {change}", flush=True)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "kradar": Part(run_kradar, "--repeats 1 --frames 200 --only whole"),
                "labels": Part(run_labels, "--rounds 1 --first 400"),
                "dds": Part(run_dds),
            },
        )
    )
