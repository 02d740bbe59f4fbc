"""Structural edits of boxes in tables: CSV of own folders and of scores, feather files of Argoverse 2."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

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
    exponents,
    model,
)
from _structures import Case, Family, Reading
from _structures_json import FRAMES, USUAL, about_z, written
from _structures_lines import NO_NUMBERS

from farfield.frame import Boxes
from farfield.metrics.box_files import read, read_predictions

NUMBERS = ("x", "y", "z", "l", "w", "h", "yaw_rad")
HEADER = ["frame", "label", *NUMBERS, "score", "track_id", "point_count"]


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Header and rows as cells."""
    keys = ("x", "y", "z", "l", "w", "h", "yaw", "score", "track", "points")
    return [[*HEADER], *([row["frame"], written(row), *(str(row[key]) for key in keys)] for row in rows)]


def column(cells: Sequence[Sequence[str]], name: str) -> int:
    return list(cells[0]).index(name)


# Edits of the cells.


def columns_in_another_order(draft: Draft, cells: list[list[str]]) -> None:
    order = draft.random.permutation(len(cells[0]))
    cells[:] = [[row[place] for place in order] for row in cells]
    draft.note("columns in another order")


def column_missing(draft: Draft, cells: list[list[str]]) -> None:
    name = draft.pick(cells[0])
    place = column(cells, name)
    for row in cells:
        del row[place]
    optional = {"score": "score", "track_id": "track", "point_count": "points"}
    for row in draft.rows if name in optional else []:
        row[optional[name]] = None
    draft.note(f"column {name} missing", "same" if name in optional else "refused")


def column_twice(draft: Draft, cells: list[list[str]]) -> None:
    place = column(cells, draft.pick(cells[0]))
    for row in cells:
        row.append(row[place])
    draft.note("a column twice", "refused")


def column_more(draft: Draft, cells: list[list[str]]) -> None:
    name = draft.pick(["remark", "", "index", "Unnamed: 0", "roll_rad", "class_id"])
    for number, row in enumerate(cells):
        row.insert(0, name if number == 0 else str(number))
    draft.note(f"column {name!r} more", "refused")


def column_renamed(draft: Draft, cells: list[list[str]]) -> None:
    name = draft.pick([*NUMBERS, "frame", "label", "score", "track_id"])
    other = {"yaw_rad": draft.pick(["yaw", "yaw_deg", "heading", "rotation_y", "Yaw_rad"]), "label": "class"}
    cells[0][column(cells, name)] = other.get(name, draft.pick([name.upper(), f"{name}_m", f"box_{name}"]))
    draft.note(f"column {name} renamed", "refused")


def blanks_in_header(draft: Draft, cells: list[list[str]]) -> None:
    cells[0] = [f" {name} " for name in cells[0]]
    draft.note("blanks in the header")


def header_missing(draft: Draft, cells: list[list[str]]) -> None:
    del cells[0]
    draft.note("header missing", "refused")


def header_again(draft: Draft, cells: list[list[str]]) -> None:
    cells.insert(int(draft.random.integers(1, len(cells) + 1)), list(cells[0]))
    draft.note("header again", "refused")


def cell_of(draft: Draft, cells: list[list[str]], name: str, word: str) -> None:
    cells[int(draft.random.integers(1, len(cells)))][column(cells, name)] = word


def no_number(draft: Draft, cells: list[list[str]]) -> None:
    word = draft.pick([*NO_NUMBERS, "", " ", "1 234.5", "12,5"])
    name = draft.pick(NUMBERS)
    cell_of(draft, cells, name, word)
    draft.note(f"{word!r} for a number", "refused")


def no_count(draft: Draft, cells: list[list[str]]) -> None:
    word = draft.pick(["2.5", "x", str(2**53), "1e30", "nan", "\u0663"])
    cell_of(draft, cells, draft.pick(["track_id", "point_count"]), word)
    draft.note(f"{word!r} for a whole number", "refused")


def no_track(draft: Draft, cells: list[list[str]]) -> None:
    """An empty track, or -1: the box has none."""
    place = int(draft.random.integers(1, len(cells)))
    cells[place][column(cells, "track_id")] = draft.pick(["", "-1"])
    draft.rows[place - 1]["track"] = None
    draft.note("a box without a track")


def some_scores(draft: Draft, cells: list[list[str]]) -> None:
    cell_of(draft, cells, "score", "")
    draft.note("a score missing", "refused")


def impossible_number(draft: Draft, cells: list[list[str]]) -> None:
    name, words = draft.pick([("x", ["2e7", "-1e12"]), ("w", ["0", "-2", "1e9"]), ("yaw_rad", ["1e5", "-4000"])])
    cell_of(draft, cells, name, draft.pick(words))
    draft.note(f"impossible {name}", "refused")


def row_cut(draft: Draft, cells: list[list[str]]) -> None:
    row = cells[int(draft.random.integers(1, len(cells)))]
    if draft.random.random() < 0.5:
        del row[-1]
    else:
        row.append(draft.pick(["", "x", "7"]))
    draft.note("a row of another length", "refused")


def empty_name(draft: Draft, cells: list[list[str]]) -> None:
    cell_of(draft, cells, draft.pick(["frame", "label"]), draft.pick(["", "  ", "a\nb", "a\0b"]))
    draft.note("no name in a cell", "refused")


CELL_EDITS: tuple[Callable[[Draft, list[list[str]]], None], ...] = (
    *(columns_in_another_order, column_missing, column_missing, column_twice, column_more, column_renamed),
    *(blanks_in_header, header_missing, header_again, no_number, no_number, no_number, no_count, no_track),
    *(some_scores, impossible_number, impossible_number, row_cut, empty_name),
)


def csv_text(draft: Draft, cells: Sequence[Sequence[str]]) -> str:
    """The text: separated by commas, in quotes where it must be or everywhere, or as another program writes it."""
    kind = draft.pick(["", "", "", "", "quoted", "exponents", "semicolons", "decimal commas", "tabs", "comment"])
    special = any(mark in cell for row in cells for cell in row for mark in ',"\n')
    if kind == "quoted" or special:
        draft.note("cells in quotes")
        return "".join(",".join('"' + cell.replace('"', '""') + '"' for cell in row) + "\n" for row in cells)
    separator = {"semicolons": ";", "decimal commas": ";", "tabs": "\t"}.get(kind, ",")
    text = "".join(separator.join(row) + "\n" for row in cells)
    if kind == "exponents":
        draft.note(kind)
        return "\n".join(exponents_in(line) for line in text.split("\n"))
    if kind == "decimal commas":
        text = text.replace(".", ",")
    if kind == "comment":
        text = f"# boxes of our detector\n{text}"
    if kind:
        draft.note(kind, "refused")
    return text


def exponents_in(line: str) -> str:
    return ",".join(exponents(cell) for cell in line.split(","))


def csv_rows(draft: Draft) -> str:
    """A table with one or two edits."""
    kind = draft.pick(["none", "model", "model", "cells", "cells", "cells", "cells", "cells", "text"])
    if kind == "model" or draft.random.random() < 0.25:
        draft.pick(MODEL_EDITS)(draft)
    cells = table(draft.rows)
    if kind == "cells" and len(cells) > 1:
        draft.pick(CELL_EDITS)(draft, cells)
    return csv_text(draft, cells) if kind in ("text", "none") else csv_plain(cells)


def csv_plain(cells: Sequence[Sequence[str]]) -> str:
    """As csv modules write it."""
    quoted = [[f'"{cell}"' if set(cell) & set(',"\n') else cell for cell in row] for row in cells]
    return "".join(",".join(row) + "\n" for row in quoted)


def own_table(random: np.random.Generator, folder: Path) -> Case:
    """``labels.csv`` of an own folder."""
    draft = Draft(random, model(random, FRAMES, tuple(USUAL), scored=True))
    for frame in FRAMES:
        np.save(folder / f"{frame}.npy", np.ones((4, 4), np.float32))
    text = csv_rows(draft)
    if random.random() < 0.1:
        text = text.replace("000002", "2").replace("000001", "1")
        draft.note("leading zeros lost", "refused")
    (folder / "labels.csv").write_bytes(encoded(draft, text, LAYOUTS if random.random() < 0.92 else STRANGE))
    return dataset_case(draft, folder, ours=USUAL, columns="track score points")


def score_table(random: np.random.Generator, folder: Path) -> Case:
    """The boxes of a detector, as a score takes them."""
    draft = Draft(random, model(random, FRAMES, tuple(USUAL), scored=True))
    text = csv_rows(draft)
    kinds = LAYOUTS if random.random() < 0.92 else STRANGE
    (folder / "boxes.csv").write_bytes(encoded(draft, text, kinds))
    rows = [row | {"label": written(row)} for row in draft.rows]
    for row in rows:
        row["score"] = 1.0 if row["score"] is None else row["score"]
    return Case(
        tuple(draft.edits or ["none"]),
        draft.oracle,
        lambda: Reading(read_table(folder / "boxes.csv")),
        lambda frames: differing(frames, rows, ours={}, columns="track score points"),
        draft.words,
    )


def read_table(path: Path) -> Mapping[str, Boxes | None]:
    return {frame: boxes for (_, frame), boxes in read_predictions(path).boxes.items()}


# Two tables that are scored: what is odd about one of them has to be said.


def _degrees(rows: list[Row]) -> None:
    for row in rows:
        row["yaw"] = round(float(np.rad2deg(row["yaw"])), 3)


def _feet(rows: list[Row]) -> None:
    for row in rows:
        row |= {name: round(row[name] / 0.3048, 3) for name in "lwh"}


def _halves(rows: list[Row]) -> None:
    for row in rows:
        row |= {name: round(row[name] / 2, 4) for name in "lwh"}


def _shifted(rows: list[Row]) -> None:
    for row in rows:
        row["x"] = round(row["x"] + 1.5, 3)


def _mirrored(rows: list[Row]) -> None:
    for row in rows:
        row |= {"y": -row["y"], "yaw": -row["yaw"]}


def _exchanged(rows: list[Row]) -> None:
    for row in rows:
        row |= {"l": row["w"], "w": row["l"]}


def _doubled(rows: list[Row]) -> None:
    rows += [dict(row) for row in rows]


def _percent(rows: list[Row]) -> None:
    for row in rows:
        row["score"] = round(100 * row["score"], 1)


def _one_score(rows: list[Row]) -> None:
    for row in rows:
        row["score"] = 0.5


def _two_names(rows: list[Row]) -> None:
    for row in rows[::2]:
        row["label"] = {"Car": "vehicle"}.get(row["label"], row["label"])


SLIPS: tuple[tuple[str, Callable[[list[Row]], None], str], ...] = (
    ("yaws in degrees", _degrees, "degrees"),
    ("sizes in feet", _feet, "feet|3.28"),
    ("half sizes", _halves, "hal(f|ves)|0.5"),
    ("shifted by 1.5 m", _shifted, r"1\.[45]\d* ?m|offset"),
    ("mirrored", _mirrored, "mirror|y"),
    ("length and width exchanged", _exchanged, "exchanged|width|length"),
    ("each box twice", _doubled, "twice|double"),
    ("scores in per cent", _percent, "score"),
    ("one score for all", _one_score, "score"),
    ("two names of a class", _two_names, "name|vehicle"),
)


def scored_pair(random: np.random.Generator, folder: Path) -> Case:
    """Predictions and labels of eight frames with one systematic slip."""
    frames = [f"{number:06d}" for number in range(8)]
    labels = model(random, frames, ("Car",), scored=True)
    for number, row in enumerate(labels):
        row["x"] = round(10 + number * 37 % 60 + random.uniform(-2, 2), 3)
    rows = [row | {axis: round(row[axis] + random.normal(0, 0.05), 3) for axis in "xyz"} for row in labels]
    draft = Draft(random, rows)
    name, slip, words = draft.pick(SLIPS)
    slip(rows)
    draft.note(name, "said", words)
    for path, content in (("labels", labels), ("predictions", rows)):
        cells = table(content)
        if path == "labels":
            cells = [row[:9] for row in cells]
        (folder / f"{path}.csv").write_text(csv_plain(cells))
    return Case(
        (name,),
        draft.oracle,
        partial(read_pair, folder),
        lambda values: "" if values == len(rows) else str(values),
        words,
    )


def read_pair(folder: Path) -> Reading:
    detections = read(folder / "predictions.csv", folder / "labels.csv")
    result = detections.score("dds", range_bins_m=(0, 100))
    return Reading(sum(map(len, detections.boxes.values())), "\n".join((*detections.notes, *result.notes)))


# Argoverse 2.

STAMPS = ("315966265259836000", "315966265360032000")
_CUBOID = ("length_m", "width_m", "height_m", "qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")


def argoverse(random: np.random.Generator, folder: Path) -> Case:
    """A log of annotations alone: quaternions w x y z, centres, the ego vehicle's axes."""
    classes = ("REGULAR_VEHICLE", "BUS", "PEDESTRIAN", "BICYCLE")
    draft = Draft(random, model(random, STAMPS, classes))
    kind = draft.pick(["none", "model", "columns", "columns", "columns", "columns", "stored"])
    if kind == "model" or random.random() < 0.2:
        draft.pick(MODEL_EDITS)(draft)
    columns: dict[str, list[Any]] = {
        "timestamp_ns": [int(row["frame"]) for row in draft.rows],
        "track_uuid": [f"00000000-{row['track']:08d}" for row in draft.rows],
        "category": [written(row) for row in draft.rows],
    }
    for name in _CUBOID:
        columns[name] = [_cuboid(row)[name] for row in draft.rows]
    columns["num_interior_pts"] = [row["points"] for row in draft.rows]
    if kind == "columns" and draft.rows:
        draft.pick(COLUMN_EDITS)(draft, columns)
    write_feather(draft, folder / "annotations.feather", columns, stored=kind == "stored")
    ours = {"REGULAR_VEHICLE": "vehicle", "BUS": "large_vehicle", "PEDESTRIAN": "pedestrian", "BICYCLE": "bicycle"}
    return dataset_case(draft, folder, ours=ours, columns="points", options={"format": "argoverse2"})


def _cuboid(row: Row) -> dict[str, float]:
    sine, cosine = about_z(row["yaw"])
    sizes, turn = (row["l"], row["w"], row["h"]), (cosine, 0.0, 0.0, sine)
    return dict(zip(_CUBOID, (*sizes, *turn, row["x"], row["y"], row["z"]), strict=True))


def write_feather(draft: Draft, path: Path, columns: Mapping[str, list[Any]], *, stored: bool) -> None:
    """The table, as arrow stores it, or in a way that it does not."""
    import pyarrow
    from pyarrow import feather

    names = [name.rstrip("\0") for name in columns]
    compression = draft.pick(["lz4", "zstd", "uncompressed"])
    feather.write_feather(pyarrow.table(list(columns.values()), names=names), path, compression=compression)
    if stored:
        kind = draft.pick(["cut off", "pointer of Git LFS", "text"])
        data = path.read_bytes()
        new = {"cut off": data[: len(data) // 2], "text": b"timestamp_ns,track_uuid\n1,2\n"}
        path.write_bytes(new.get(kind, b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n"))
        draft.note(kind, "refused")


def reordered(draft: Draft, columns: dict[str, list[Any]]) -> None:
    items = list(columns.items())
    columns.clear()
    columns.update(items[place] for place in draft.random.permutation(len(items)))
    draft.note("columns in another order of names")


def dropped(draft: Draft, columns: dict[str, list[Any]]) -> None:
    del columns[draft.pick(list(columns))]
    draft.note("a column missing", "refused")


def doubled(draft: Draft, columns: dict[str, list[Any]]) -> None:
    name = draft.pick(list(columns))
    columns[name + "\0"] = list(columns[name])
    draft.note("a column twice", "refused")


def more_columns(draft: Draft, columns: dict[str, list[Any]]) -> None:
    columns["remark"] = ["x"] * len(draft.rows)
    draft.note("a column more")


def of_another_kind(draft: Draft, columns: dict[str, list[Any]]) -> None:
    """A column of texts, flags, lists or nulls where numbers are, or of numbers where texts are."""
    name = draft.pick(list(columns))
    if name in ("track_uuid", "category"):
        columns[name] = draft.pick([list(range(len(draft.rows))), [None] * len(draft.rows), [""] * len(draft.rows)])
    else:
        kinds = [[str(value) for value in columns[name]], [True] * len(draft.rows), [[1.0]] * len(draft.rows)]
        columns[name] = draft.pick([*kinds, [None, *columns[name][1:]]])
    draft.note(f"{name} of another kind", "refused")


def whole_as_decimals(draft: Draft, columns: dict[str, list[Any]]) -> None:
    name = draft.pick(["timestamp_ns", "num_interior_pts"])
    columns[name] = [float(value) for value in columns[name]]
    draft.note(f"{name} as decimals", "refused")


def one_value(draft: Draft, columns: dict[str, list[Any]]) -> None:
    """One impossible number."""
    name = draft.pick(_CUBOID)
    choices = [float("nan"), float("inf"), 2e7] + ([0.0, -1.0] if name.endswith(("th_m", "ht_m")) else [])
    columns[name][int(draft.random.integers(len(draft.rows)))] = draft.pick(choices)
    draft.note(f"impossible {name}", "refused")


def other_quaternions(draft: Draft, columns: dict[str, list[Any]]) -> None:
    """Quaternions in the order x y z w: boxes that head off x lie on their sides; of others nothing shows it."""
    if any(0.6 < abs(row["yaw"]) < 2.5 for row in draft.rows):
        names = ("qw", "qx", "qy", "qz")
        columns.update(zip(names, [columns[name] for name in ("qx", "qy", "qz", "qw")], strict=True))
        draft.note("quaternions in another order", "refused")


COLUMN_EDITS = (
    reordered,
    dropped,
    doubled,
    more_columns,
    of_another_kind,
    of_another_kind,
    whole_as_decimals,
    one_value,
    other_quaternions,
)

FAMILIES = (
    Family("own table", own_table, share=8.0),
    Family("boxes csv", score_table, share=8.0),
    Family("scored pairs", scored_pair, share=1.0),
    *((Family("argoverse2 annotations", argoverse, share=6.0),) if find_spec("pyarrow") else ()),
)
