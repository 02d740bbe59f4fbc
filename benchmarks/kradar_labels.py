"""Read all annotations of K-Radar and print what is published of them: frames, classes, tracks, visibility, weather.

    python benchmarks/kradar_labels.py [--archive labels_v2_1.tar.gz | --tree FOLDER] [--rounds 5]
                                       [--output benchmarks/results/kradar_labels.txt]

The archive is unpacked into a temporary folder; unpacking is not counted. The time is that of opening the tree and of
reading and parsing every file in one process, the files in the system's cache; the first round is printed apart.
Exit status 1 where a count is not the published one.
"""

import argparse
import os
import resource
import tarfile
import tempfile
import time
from collections import Counter
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from _report import SHARED_REAL, header

from farfield.datasets import open_dataset
from farfield.datasets.kradar import KRadar
from farfield.datasets.kradar.label_table import DEFECTS, LabelTable
from farfield.files.atomic import write_text
from farfield.vocabulary.kradar import SEQUENCES

FRAMES, EMPTY, OBJECTS = 34_994, 4_307, 115_229
CLASSES = {  # objects, tracks, R, L, L1; the slips LL and l count as L, LR as L1
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


def read(root: Path) -> tuple[KRadar, LabelTable, float, float]:
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
    for name, published in CLASSES.items():
        found = (int((table.name == name).sum()), tracks[name], *(flags[name, flag] for flag in ("R", "L", "L1")))
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--archive", type=Path, default=SHARED_REAL / "kradar" / "labels_v2_1.tar.gz")
    parser.add_argument("--tree", type=Path, help="an unpacked tree of annotations v2.1 instead of the archive")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "kradar_labels.txt")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = arguments.tree or Path(folder)
        if arguments.tree is None:
            with tarfile.open(arguments.archive) as archive:
                archive.extractall(root, filter="data")
        rounds = [read(root) for _ in range(arguments.rounds)]
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
        f"open and read all {len(table.stem):,} files, 1 process: best {min(times):.2f} s of {arguments.rounds} "
        f"(opening {opened:.2f}, reading {seconds:.2f}); first {times[0]:.2f} s; limit {LIMIT_S:g} s",
        f"boxes of each of {len(boxes):,} frames: {split_s:.2f} s more",
        f"peak memory of the process: {peak:.0f} MB",
        f"every count as published: {'yes' if good else 'NO'}",
    ]
    text = "\n".join([header(), "", *lines, ""])
    print(text)
    arguments.output.parent.mkdir(exist_ok=True)
    write_text(arguments.output, text)
    return int(not good or min(times) > LIMIT_S)


if __name__ == "__main__":
    raise SystemExit(main())
