"""Structural edits of labels in lines of text: KITTI, its tracking, View-of-Delft, K-Radar, Boreas, Cirrus."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from _labelled_rows import (
    LAYOUTS,
    MODEL_EDITS,
    STRANGE,
    Draft,
    Row,
    dataset_case,
    differing,
    encoded,
    model,
    other_case,
)
from _structures import Case, Family, Reading
from _structures_json import CIRRUS_FRAMES, FRAMES, empty_clouds, written

from farfield.datasets.cirrus.labels import boxes_from_labels, read_labels
from farfield.datasets.cirrus.layout import Labels
from farfield.files.boreas import read_boreas_objects
from farfield.frame import Boxes
from farfield.metrics.box_files import read_predictions

Lines = dict[Path, list[list[str]]]


@dataclass(frozen=True)
class Columns:
    """A format in lines.

    Args:
        write: The cells of each line by file; the lines of a frame in the order of its rows.
        numbers: Columns of numbers of any size.
        sizes: Columns of sizes.
        places: Columns of coordinates.
        case: Makes the case of the files in a folder.
        name: The column of the class.
        whole: Columns of whole numbers, which a point or a letter refuses.
        yaw: The column of a yaw in radians; -1 where there is none.
        separator: What stands between cells.
        blanks: Whether any blanks may stand between cells.
        head: The first line of each file.
        classes: Classes as files have them.
        frames: Names of the frames.
        own: Whether a class of one's own can be written.
        scored: Whether boxes have scores.
        edits: Edits of the model that the format cannot bear.
    """

    write: Callable[[Sequence[Row], Path], Lines]
    numbers: tuple[int, ...]
    sizes: tuple[int, ...]
    places: tuple[int, ...]
    case: Callable[[Draft, Path], Case]
    name: int
    whole: tuple[int, ...] = ()
    yaw: int = -1
    separator: str = " "
    blanks: bool = True
    head: str = ""
    classes: tuple[str, ...] = ("Car", "Truck", "Pedestrian", "Cyclist")
    frames: tuple[str, ...] = FRAMES
    scored: bool = False
    without: tuple[Callable[[Draft], None], ...] = ()
    marks: bool = False


NO_NUMBERS = (
    "nan",
    "inf",
    "-Infinity",
    "abc",
    "1_0",
    "0x10",
    "1e999",
    "12.5m",
    "--1",
    "1.2.3",
    "None",
    "NULL",
    "\u0663",
)
"""What is no number to a reader: of Python's own 1_0 is one, and digits of other scripts are."""


def other_cell(draft: Draft, layout: Columns, line: list[str]) -> None:
    """Something else in a number's cell."""
    word = draft.pick(NO_NUMBERS)
    line[draft.pick(layout.numbers)] = word
    draft.note(f"{word} for a number", "refused")


def comma_in_number(draft: Draft, layout: Columns, line: list[str]) -> None:
    """Commas in numbers: for the point, or between thousands."""
    column = draft.pick(layout.numbers)
    kind = draft.pick(["decimal comma", "comma between thousands", "quoted"])
    cells = {"decimal comma": line[column].replace(".", ","), "comma between thousands": "1,234.5"}
    line[column] = cells.get(kind, f'"{line[column]}"')
    if kind == "decimal comma" and "," not in line[column]:
        line[column] = "12,5"
    draft.note(kind, "refused")


def cell_missing(draft: Draft, layout: Columns, line: list[str]) -> None:
    """A cell is missing, or empty."""
    column = draft.pick([*layout.numbers, layout.name])
    if not layout.blanks and draft.random.random() < 0.5:
        line[column] = ""
        draft.note("empty cell", "refused")
    else:
        del line[column]
        draft.note("cell missing", "refused")


def cell_more(draft: Draft, layout: Columns, line: list[str]) -> None:
    """A cell too many."""
    line.insert(draft.pick([*layout.numbers, layout.name]), draft.pick(["0.5", "3", "x"]))
    draft.note("a cell too many", "refused")


def impossible_cell(draft: Draft, layout: Columns, line: list[str]) -> None:
    """A size, a place or a turn that no object has."""
    kinds = [("size", layout.sizes, ["0", "-1.5", "0.0"]), ("place", layout.places, ["2e7", "-1e12"])]
    kinds += [("yaw in degrees", (layout.yaw,), ["90", "-179.5", "45"])] if layout.yaw >= 0 else []
    name, columns, values = draft.pick(kinds)
    line[draft.pick(columns)] = draft.pick(values)
    draft.note(f"impossible {name}", "refused")


def whole_cell(draft: Draft, layout: Columns, line: list[str]) -> None:
    """A whole number that is none."""
    if not layout.whole:
        other_cell(draft, layout, line)
        return
    word = draft.pick(["2.5", "x", "1e30", "", "nan", "0x1"])
    column = draft.pick(layout.whole)
    line[column] = word
    draft.note(f"{word!r} for a whole number", "refused")


def class_elsewhere(draft: Draft, layout: Columns, line: list[str]) -> None:
    """The class stands in another column."""
    name = line.pop(layout.name)
    places = [place for place in range(len(line) + 1) if place != layout.name]
    line.insert(draft.pick(places), name)
    draft.note("class in another column", "refused")


def spelt_otherwise(draft: Draft, layout: Columns, line: list[str]) -> None:
    """The same numbers, spelt in another way."""
    column = draft.pick(layout.numbers)
    value = float(line[column])
    words = (f"{value:.15e}", f"{value:+.9f}", f"{value:.12f}", f"{value:.12E}", f"{value!r}000")
    line[column] = draft.pick(words if "." in repr(value) and "e" not in repr(value) else words[:4])
    draft.note("numbers spelt otherwise")


LINE_EDITS = (
    *(other_cell,) * 3,
    *(comma_in_number, comma_in_number, cell_missing, cell_more, impossible_cell, impossible_cell, whole_cell),
    *(class_elsewhere, spelt_otherwise, spelt_otherwise),
)


def joined(draft: Draft, layout: Columns, lines: Sequence[Sequence[str]], kind: str) -> str:
    """The text of a file."""
    separator = layout.separator
    if kind == "separator":
        choices = ["\t", "   ", ";", "|"] + ([","] if separator.strip() != "," else ["\t"])
        separator = draft.pick(choices)
        good = layout.blanks and not separator.strip()
        draft.note(f"separated by {separator!r}", "same" if good else "refused")
    text = "".join(
        f"{line}\n" for line in ([layout.head] if layout.head else []) + [separator.join(line) for line in lines]
    )
    if kind == "blanks":
        draft.note("blanks at the ends of lines")
        text = text.replace("\n", "  \n")
    if kind == "cut off":
        draft.note("end missing", "refused")
        return text.rstrip().rsplit(layout.separator, 1)[0]
    return text


def make(layout: Columns, random: np.random.Generator, folder: Path) -> Case:
    """A case of a format in lines."""
    draft = Draft(random, model(random, layout.frames, layout.classes, scored=layout.scored))
    kind = draft.pick(["none", "model", "model", "line", "line", "line", "line", "line", "text", "stored"])
    if kind == "model" or random.random() < 0.25:
        draft.pick([edit for edit in MODEL_EDITS if edit not in layout.without])(draft)
    files = layout.write(draft.rows, folder)
    target = draft.pick(sorted(path for path, lines in files.items() if lines) or sorted(files))
    kind = kind if files[target] or kind != "text" else "none"
    if kind == "line" and files[target]:
        draft.pick(LINE_EDITS)(draft, layout, draft.pick(files[target]))
    for path, lines in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        whole = draft.pick(["separator", "blanks", "cut off"]) if kind == "text" and path == target else ""
        text = joined(draft, layout, lines, whole)
        kinds = STRANGE if path == target and kind == "stored" else ("", "") if whole else (*LAYOUTS, "blank lines")
        path.write_bytes(encoded(draft, text, kinds) if text else b"")
    return layout.case(draft, folder)


# KITTI: the camera's axes, x right, y down, z ahead; the centre of the bottom; height, width, length.

UNTURNED = ["P0", "P1", "P2", "P3"]
CALIB = "".join(f"{name}: 700 0 600 0 0 700 180 0 0 0 1 0\n" for name in UNTURNED)
CALIB += (
    "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\nTr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0\n"
)


def kitti_cells(row: Row, *, scored: bool = False) -> list[str]:
    """The fifteen columns of an object, sixteen with a score."""
    u, v = 600 - 700 * row["y"] / row["x"], 180 - 700 * row["z"] / row["x"]
    turn = -row["yaw"] - math.pi / 2
    box = (u - 20, v - 10, u + 20, v + 10)
    numbers = (*box, row["h"], row["w"], row["l"], -row["y"], -row["z"] + row["h"] / 2, row["x"], turn)
    cells = [written(row), "0.00", "0", "-1.57", *(f"{value:.7f}" for value in numbers)]
    return [*cells, str(row["score"])] if scored else cells


def kitti_files(rows: Sequence[Row], folder: Path) -> Lines:
    """KITTI's object set."""
    root = folder / "training"
    empty_clouds(root / "velodyne", ".bin", FRAMES)
    (root / "calib").mkdir(parents=True)
    for frame in FRAMES:
        (root / "calib" / f"{frame}.txt").write_text(CALIB)
    return {
        root / "label_2" / f"{frame}.txt": [kitti_cells(row) for row in rows if row["frame"] == frame]
        for frame in FRAMES
    }


_OURS = {"Car": "vehicle", "Truck": "large_vehicle", "Pedestrian": "pedestrian", "Cyclist": "bicycle"}
_KITTI: dict[str, tuple[int, ...]] = {"sizes": (8, 9, 10), "places": (11, 12, 13)}
KITTI = Columns(
    write=kitti_files,
    numbers=tuple(range(1, 15)),
    whole=(2,),
    yaw=14,
    name=0,
    case=partial(dataset_case, ours=_OURS, columns="", options={"format": "kitti"}),
    **_KITTI,
)


def delft_files(rows: Sequence[Row], folder: Path) -> Lines:
    """View-of-Delft's: KITTI's columns, and a sixteenth that is always 1."""
    root = folder / "radar" / "training"
    empty_clouds(root / "velodyne", ".bin", ("00001", "00002"))
    (root / "calib").mkdir()
    for frame in ("00001", "00002"):
        (root / "calib" / f"{frame}.txt").write_text(CALIB)
    return {
        root / "label_2" / f"{frame}.txt": [[*kitti_cells(row), "1"] for row in rows if row["frame"] == frame]
        for frame in ("00001", "00002")
    }


DELFT = Columns(
    write=delft_files,
    numbers=tuple(range(1, 15)),
    whole=(2,),
    yaw=14,
    name=0,
    frames=("00001", "00002"),
    classes=("Car", "truck", "Pedestrian", "Cyclist"),
    case=partial(
        dataset_case, ours=_OURS | {"truck": "large_vehicle"}, columns="", options={"format": "view_of_delft"}
    ),
    **_KITTI,
)


def tj4d_files(rows: Sequence[Row], folder: Path) -> Lines:
    """TJ4DRadSet's: KITTI's tree and labels."""
    return kitti_files(rows, folder)


TJ4D = Columns(
    write=tj4d_files,
    numbers=tuple(range(1, 15)),
    whole=(2,),
    yaw=14,
    name=0,
    case=partial(dataset_case, ours=_OURS, columns="", options={"format": "tj4dradset"}),
    **_KITTI,
)


def tracking_files(rows: Sequence[Row], folder: Path) -> Lines:
    """KITTI's tracking: frame and track before the columns of an object."""
    root = folder / "training"
    empty_clouds(root / "velodyne" / "0003", ".bin", FRAMES)
    (root / "calib").mkdir()
    (root / "calib" / "0003.txt").write_text(CALIB.replace("R0_rect:", "R_rect").replace("velo_to_cam:", "velo_cam"))
    cells = [[str(int(row["frame"])), str(row["track"]), *kitti_cells(row)] for row in rows]
    return {root / "label_02" / "0003.txt": cells}


TRACKING = Columns(
    write=tracking_files,
    numbers=tuple(range(3, 17)),
    sizes=(10, 11, 12),
    places=(13, 14, 15),
    whole=(0, 1, 4),
    yaw=16,
    name=2,
    case=partial(dataset_case, ours=_OURS, options={"format": "kitti_tracking"}),
)


def results_files(rows: Sequence[Row], folder: Path) -> Lines:
    """KITTI's results: a file a frame with scores."""
    return {
        folder / "results" / f"{frame}.txt": [kitti_cells(row, scored=True) for row in rows if row["frame"] == frame]
        for frame in FRAMES
    }


def results_case(draft: Draft, folder: Path) -> Case:
    """The boxes as a score takes them: in the camera's axes turned to ours, which here is the LiDAR's place."""
    rows = draft.rows
    return Case(
        tuple(draft.edits or ["none"]),
        draft.oracle,
        lambda: Reading(read_results(folder / "results")),
        lambda frames: differing(frames, rows, ours={}, columns="score"),
        draft.words,
    )


def read_results(folder: Path) -> Mapping[str, Boxes | None]:
    return {frame: boxes for (_, frame), boxes in read_predictions(folder, format="kitti").boxes.items()}


RESULTS = Columns(
    write=results_files,
    numbers=tuple(range(1, 16)),
    whole=(2,),
    name=0,
    case=results_case,
    scored=True,
    without=(other_case,),
    **_KITTI,
)


# K-Radar: degrees, half sizes, commas.

HEADER = (
    "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)={:05d}_{:05d}_00002_00001_00004, timestamp=1643292946.710046076"
)
KRADAR_FRAMES = ("00033_00001", "00034_00002")
_TREES = {
    "v2.1": "KRadar_revised_visibility/1",
    "v2.0": "KRadar_refined_label_by_UWIPL/1",
    "v1.1": "1_info_label_revised",
    "v1.0": "1/info_label",
}


def kradar_files(version: str, rows: Sequence[Row], folder: Path) -> Lines:
    """K-Radar's labels of a version."""
    files: Lines = {}
    for frame in KRADAR_FRAMES:
        lines: list[list[str]] = []
        for row in (row for row in rows if row["frame"] == frame):
            flag = ["R"] if version.endswith(".1") else []
            tracks = [str(row["track"])] * (2 if version.startswith("v1") else 1)
            halves = [row[name] / 2 for name in "lwh"]
            numbers = [row["x"], row["y"], row["z"], math.degrees(row["yaw"]), *halves]
            lines.append(["*", *flag, *tracks, written(row), *(f"{value:.9f}" for value in numbers)])
        files[folder / _TREES[version] / f"{frame}.txt"] = lines
    return files


def kradar_case(version: str, draft: Draft, folder: Path) -> Case:
    """The annotations of the tree; version 1 has no tracks."""
    for number, path in enumerate(sorted((folder / _TREES[version]).glob("*.txt"))):
        head = HEADER.format(33 + number, 1 + number).encode()
        data = path.read_bytes()
        end = b"\r\n" if b"\r\n" in data else b"\n"
        path.write_bytes(head + end + data if _plain(data) else data)
    ours = {"Sedan": "vehicle", "Bus or Truck": "large_vehicle", "Motorcycle": "motorcycle", "Pedestrian": "pedestrian"}
    options = {"format": "kradar", "labels": version}
    return dataset_case(draft, folder, ours=ours, columns="track" if version[1] == "2" else "", options=options)


def _plain(data: bytes) -> bool:
    """Whether it is a text of lines, which gets its header."""
    return not data.startswith((b"\xef\xbb", b"\xff\xfe", b"\xfe\xff", b"version", b"<!DOC", b"\x1f", b"\0"))


def kradar(version: str) -> Columns:
    """The columns of a version."""
    before = 1 + version.endswith(".1") + (2 if version.startswith("v1") else 1)
    return Columns(
        write=partial(kradar_files, version),
        numbers=tuple(range(before + 1, before + 8)),
        sizes=tuple(range(before + 5, before + 8)),
        places=tuple(range(before + 1, before + 4)),
        whole=tuple(range(1 + version.endswith(".1"), before)),
        name=before,
        separator=", ",
        blanks=False,
        classes=("Sedan", "Bus or Truck", "Motorcycle", "Pedestrian"),
        frames=KRADAR_FRAMES,
        case=partial(kradar_case, version),
    )


# Boreas and Cirrus' text: files of one frame, read by the readers of files.


def boreas_files(rows: Sequence[Row], folder: Path) -> Lines:
    """Boreas: uuid, class, sizes, place, yaw, points."""
    cells = [
        [
            f"uuid-{row['track']}",
            written(row),
            *(str(row[name]) for name in ("l", "w", "h", "x", "y", "z", "yaw", "points")),
        ]
        for row in rows
    ]
    return {folder / "labels.txt": cells}


def boreas_case(draft: Draft, folder: Path) -> Case:
    return file_case(draft, partial(read_boreas, folder / "labels.txt"), columns="points")


def read_boreas(path: Path) -> Boxes:
    objects = read_boreas_objects(path)
    return Boxes(
        centre_m=objects.centre_m,
        size_m=objects.size_m,
        yaw_rad=objects.yaw_rad,
        label=objects.label,
        point_count=objects.point_count,
    )


def file_case(draft: Draft, read: Callable[[], Boxes], *, columns: str) -> Case:
    """The case of a file that holds one frame; its classes stand there as they are written."""
    rows = [row | {"label": written(row), "frame": "one"} for row in draft.rows]
    return Case(
        tuple(draft.edits or ["none"]),
        draft.oracle,
        lambda: Reading({"one": read()}),
        lambda frames: differing(frames, rows, ours={}, columns=columns),
        draft.words,
    )


BOREAS = Columns(
    write=boreas_files,
    numbers=tuple(range(2, 9)),
    sizes=(2, 3, 4),
    places=(5, 6, 7),
    whole=(9,),
    yaw=8,
    name=1,
    case=boreas_case,
    frames=("one",),
)


def cirrus_files(rows: Sequence[Row], folder: Path) -> Lines:
    """The authors' text: their w is the length, their l the width, their angle minus the yaw."""
    cells = []
    for row in rows:
        numbers = (row["h"], row["l"], row["w"], -row["y"], -row["z"] + row["h"] / 2, row["x"], -row["yaw"])
        cells.append([written(row), "0", "0", "0", "0", "0", "0", "0", *(f"{value:.7f}" for value in numbers)])
    return {folder / f"{CIRRUS_FRAMES[0]}.txt": cells}


def cirrus_case(draft: Draft, folder: Path) -> Case:
    for row in draft.rows:
        row.pop("written", None)
    return file_case(draft, partial(read_cirrus, folder / f"{CIRRUS_FRAMES[0]}.txt"), columns="")


def read_cirrus(path: Path) -> Boxes:
    return boxes_from_labels(read_labels(path, Labels()), Labels())


CIRRUS = Columns(
    write=cirrus_files,
    numbers=tuple(range(1, 15)),
    sizes=(8, 9, 10),
    places=(11, 12, 13),
    yaw=14,
    name=0,
    classes=("vehicle", "large_vehicle", "pedestrian"),
    frames=("one",),
    case=cirrus_case,
)

_LAYOUTS = {
    "kitti labels": KITTI,
    "kitti tracking labels": TRACKING,
    "kitti results": RESULTS,
    "view_of_delft text": DELFT,
    "tj4dradset labels": TJ4D,
    **{f"kradar labels {version}": kradar(version) for version in _TREES},
    "boreas labels": BOREAS,
    "cirrus text": CIRRUS,
}
FAMILIES = tuple(Family(name, partial(make, layout), share=3.0) for name, layout in _LAYOUTS.items())
