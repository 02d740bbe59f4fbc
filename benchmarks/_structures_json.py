"""Structural edits of labels in JSON: own folders, published layouts and labelling tools."""

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
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
    other_case,
)
from _structures import Case, Family, Reading

from farfield.files.nuscenes import read_results
from farfield.files.pcd import write_pcd
from farfield.frame import Boxes
from farfield.metrics.box_files import read_predictions

Place = tuple[str | int, ...]
_KEYS = re.compile(r'"([^"\\]+)": ')
USUAL = {"Car": "vehicle", "Truck": "large_vehicle", "Pedestrian": "pedestrian", "Cyclist": "bicycle"}


@dataclass(frozen=True)
class Entries:
    """A format in JSON.

    Args:
        write: The files' trees by path, and the entry of each row in them.
        numbers: The ways to the numbers of an entry: places, sizes and turns.
        sizes: Which of them are sizes.
        places: Which of them are coordinates.
        yaw: Which of them is a yaw in radians, if any is.
        words: The ways to texts that have to be there, such as the class.
        whole: The ways to whole numbers.
        tracks: The ways to tracks, which may be names.
        strict: Whether a key that the format has not is refused.
        case: Makes the case of the files in a folder.
        classes: Classes as files have them.
        frames: Names of the frames.
        unordered: Whether the format keeps the boxes in an order of its own.
        scored: Whether boxes have scores.
    """

    write: Callable[[Sequence[Row], Path], tuple[dict[Path, Any], list[Any]]]
    numbers: tuple[Place, ...]
    sizes: tuple[Place, ...]
    places: tuple[Place, ...]
    case: Callable[[Draft, Path], Case]
    yaw: Place = ()
    words: tuple[Place, ...] = ()
    whole: tuple[Place, ...] = ()
    tracks: tuple[Place, ...] = ()
    strict: bool = False
    classes: tuple[str, ...] = tuple(USUAL)
    frames: tuple[str, ...] = ("000001", "000002")
    without: tuple[Callable[[Draft], None], ...] = ()
    scored: bool = False


def inner(entry: Any, place: Place) -> tuple[Any, str | int]:
    """What holds a value, and the value's key in it."""
    for step in place[:-1]:
        entry = entry[step]
    return entry, place[-1]


def put(entry: Any, place: Place, value: Any) -> None:
    holder, key = inner(entry, place)
    holder[key] = value


# Edits of one entry.


def other_number(draft: Draft, layout: Entries, entry: Any) -> None:
    """Something else in a number's place."""
    holder, key = inner(entry, draft.pick(layout.numbers))
    number = holder[key]
    kinds = {
        "number as text": str(number),
        "number with a decimal comma": f"{number}".replace(".", ","),
        "null for a number": None,
        "NaN for a number": math.nan,
        "infinity for a number": -math.inf,
        "true for a number": True,
        "list for a number": [number],
        "object for a number": {"value": number},
        "number of 400 digits": 10**400,
        "empty text for a number": "",
    }
    name = draft.pick(list(kinds))
    holder[key] = kinds[name]
    draft.note(name, "refused")


def without_key(draft: Draft, layout: Entries, entry: Any) -> None:
    """A number is missing, or its key is misspelt."""
    holder, key = inner(entry, draft.pick([*layout.numbers, *layout.words]))
    value = holder[key]
    del holder[key]
    if isinstance(key, str) and draft.random.random() < 0.5:
        holder[draft.pick([key.upper() if key.upper() != key else key.lower(), key + "s", f" {key}"])] = value
        draft.note("key misspelt", "refused")
    else:
        draft.note("value missing", "refused")


def more_numbers(draft: Draft, layout: Entries, entry: Any) -> None:
    """A list is longer than it may be, or one deeper."""
    lists = [place for place in layout.numbers if isinstance(place[-1], int)]
    if not lists:
        without_key(draft, layout, entry)
        return
    holder, _ = inner(entry, draft.pick(lists))
    if draft.random.random() < 0.5:
        holder.append(0.5)
        draft.note("a number too many", "refused")
    else:
        holder[:] = [list(holder)]
        draft.note("a list in a list", "refused")


def impossible(draft: Draft, layout: Entries, entry: Any) -> None:
    """A size, a place or a turn that no object has."""
    kinds = [("size", layout.sizes, [0.0, -1.5]), ("place", layout.places, [2e7, -1e12])]
    kinds += [("yaw in degrees", (layout.yaw,), [90.0, -179.0, 45.0])] if layout.yaw else []
    name, places, values = draft.pick([kind for kind in kinds if kind[1]])
    put(entry, draft.pick(places), draft.pick(values))
    draft.note(f"impossible {name}", "refused")


def other_word(draft: Draft, layout: Entries, entry: Any) -> None:
    """No text in a text's place."""
    if not layout.words:
        other_number(draft, layout, entry)
        return
    value = draft.pick([None, "", "  ", 3.5, ["Car"], {"name": "Car"}, True])
    put(entry, draft.pick(layout.words), value)
    draft.note(f"{json.dumps(value)} for a class", "refused")


def other_whole(draft: Draft, layout: Entries, entry: Any) -> None:
    """A whole number that is none."""
    if not layout.whole:
        other_number(draft, layout, entry)
        return
    value = draft.pick([2.5, "2", True, -7, [2], 10**30])
    put(entry, draft.pick(layout.whole), value)
    draft.note(f"{json.dumps(value)[:9]} for a whole number", "refused")


def other_track(draft: Draft, layout: Entries, entry: Any) -> None:
    """A track that is neither a name nor a whole number."""
    if not layout.tracks:
        other_number(draft, layout, entry)
        return
    value = draft.pick([2.5, True, -7, [2], 10**30])
    put(entry, draft.pick(layout.tracks), value)
    draft.note(f"{json.dumps(value)[:9]} for a track", "refused")


def another_key(draft: Draft, layout: Entries, entry: Any) -> None:
    """A key that the format has not."""
    entry["remark"] = draft.pick(["checked", 3, None, [1, 2]])
    draft.note("a key of one's own", "refused" if layout.strict else "same")


def other_order_of_keys(draft: Draft, layout: Entries, entry: Any) -> None:
    """The same keys in another order."""
    del layout
    items = list(entry.items())
    entry.clear()
    entry.update(reversed(items))
    draft.note("keys in another order")


ENTRY_EDITS = (
    *(other_number,) * 4,
    *(without_key,) * 2,
    *(more_numbers, impossible, impossible, other_word, other_whole, other_track, another_key, other_order_of_keys),
)


# Edits of the text.


def doubled_key(draft: Draft, text: str) -> str:
    """A key stands twice with different values."""
    keys = list(_KEYS.finditer(text))
    match = draft.pick(keys)
    draft.note("a key twice", "refused")
    return f'{text[: match.start()]}"{match[1]}": 7.25, {text[match.start() :]}'


def cut_off(draft: Draft, text: str) -> str:
    """The end is missing."""
    draft.note("end missing", "refused")
    return text[: int(len(text.rstrip()) * draft.random.uniform(0.1, 0.99)) - 1]


def no_json(draft: Draft, text: str) -> str:
    """What other languages allow, and JSON does not."""
    kind = draft.pick(["comment", "comma at the end", "single quotes", "two values", "words of Python"])
    draft.note(kind, "refused")
    if kind == "comment":
        return f"// labels\n{text}"
    if kind == "comma at the end":
        return text.rstrip()[:-1] + "," + text.rstrip()[-1]
    if kind == "single quotes":
        return text.replace('"', "'")
    if kind == "two values":
        return text + text
    return text.rstrip()[:-1] + ', "last": None' + text.rstrip()[-1] if text.lstrip().startswith("{") else f"{text}None"


def with_exponents(draft: Draft, text: str) -> str:
    """The same numbers with exponents."""
    draft.note("exponents")
    return exponents(text)


def other_root(draft: Draft, text: str) -> str:
    """Another kind of value, or nothing at all."""
    del text
    draft.note("another root", "refused")
    return draft.pick(["", "null", "3", '"labels"', "[[]]", '[{"a": 1}]', '{"other": []}', "{}", "[null]", " \n"])


TEXT_EDITS = (doubled_key, cut_off, no_json, with_exponents, other_root)


def make(layout: Entries, random: np.random.Generator, folder: Path) -> Case:
    """A case of a format in JSON."""
    draft = Draft(random, model(random, layout.frames, layout.classes, scored=layout.scored))
    kind = draft.pick(["none", "model", "model", "entry", "entry", "entry", "entry", "text", "text", "stored"])
    if kind == "model" or random.random() < 0.25:
        draft.pick([edit for edit in MODEL_EDITS if edit not in layout.without])(draft)
    trees, entries = layout.write(draft.rows, folder)
    target: Path | None = None
    if kind == "entry" and entries:
        place = int(random.integers(len(entries)))
        draft.pick(ENTRY_EDITS)(draft, layout, entries[place])
    elif kind in ("text", "stored"):
        target = draft.pick(sorted(path for path, tree in trees.items() if tree))
    for path, tree in trees.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(tree, indent=draft.pick([None, None, 1]), ensure_ascii=draft.random.random() < 0.5) + "\n"
        if path == target and kind == "text":
            text = draft.pick(TEXT_EDITS)(draft, text)
        kinds = STRANGE if path == target and kind == "stored" else LAYOUTS
        path.write_bytes(encoded(draft, text, kinds))
    return layout.case(draft, folder)


def by_frame(rows: Sequence[Row], frames: Sequence[str]) -> dict[str, list[Row]]:
    return {frame: [row for row in rows if row["frame"] == frame] for frame in frames}


def written(row: Row) -> str:
    return str(row.get("written", row["label"]))


def about_z(yaw: float) -> tuple[float, float]:
    return math.sin(yaw / 2), math.cos(yaw / 2)


def empty_clouds(folder: Path, suffix: str, frames: Sequence[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for frame in frames:
        (folder / f"{frame}{suffix}").write_bytes(b"")


def small_pcds(folder: Path, frames: Sequence[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    points = {axis: np.float32([20, 21, 22]) for axis in "xyz"}
    for frame in frames:
        write_pcd(folder / f"{frame}.pcd", points)


FRAMES = ("000001", "000002")
LISTED = tuple((name, axis) for name in ("centre_m", "size_m") for axis in range(3))


def own_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Own folders: a JSON file a frame."""
    for frame in FRAMES:
        np.save(folder / f"{frame}.npy", np.ones((4, 4), np.float32))
    entries = [
        {
            "label": written(row),
            "centre_m": [row[axis] for axis in "xyz"],
            "size_m": [row[axis] for axis in "lwh"],
            "yaw_rad": row["yaw"],
            "track_id": row["track"],
            "score": row["score"],
        }
        for row in rows
    ]
    trees: dict[Path, Any] = {folder / f"{frame}.json": {"boxes": []} for frame in FRAMES}
    for row, entry in zip(rows, entries, strict=True):
        trees[folder / f"{row['frame']}.json"]["boxes"].append(entry)
    return trees, entries


OWN = Entries(
    write=own_files,
    numbers=(*LISTED, ("yaw_rad",)),
    sizes=LISTED[3:],
    places=LISTED[:3],
    yaw=("yaw_rad",),
    words=(("label",),),
    whole=(("track_id",),),
    tracks=(("track_id",),),
    strict=True,
    case=partial(dataset_case, ours=USUAL, columns="track score"),
    scored=True,
)


# View-of-Delft, RADIATE, Cirrus, Astyx.


def delft_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Axes x forward, y right, z down from the radar; a car is ``car``."""
    root = folder / "radar" / "training"
    empty_clouds(root / "velodyne", ".bin", ("00001", "00002"))
    entries = []
    for row in rows:
        sine, cosine = about_z(-row["yaw"])
        geometry = {
            "center": {"x": row["x"], "y": -row["y"], "z": -row["z"]},
            "size": {"length": row["l"], "width": row["w"], "height": row["h"]},
            "quaternion": {"x": 0.0, "y": 0.0, "z": sine, "w": cosine},
        }
        attributes = {"activity": "moving", "spatial occlusion": "0-10%"}
        names = {"className": written(row), "objectId": f"{row['track']:08d}-0000", "id": "a"}
        entries.append(names | {"geometry": geometry, "attributes": attributes})
    trees: dict[Path, Any] = {root / "label_2" / f"{frame}.json": [] for frame in ("00001", "00002")}
    for row, entry in zip(rows, entries, strict=True):
        trees[root / "label_2" / f"{row['frame']}.json"].append(entry)
    return trees, entries


_GROUPS = (("center", "xyz"), ("size", ("length", "width", "height")), ("quaternion", "xyzw"))
_DELFT = tuple(("geometry", group, key) for group, keys in _GROUPS for key in keys)
DELFT = Entries(
    write=delft_files,
    numbers=_DELFT,
    sizes=_DELFT[3:6],
    places=_DELFT[:3],
    words=(("className",),),
    case=partial(
        dataset_case,
        ours={"car": "vehicle", "truck": "large_vehicle", "bicycle": "bicycle", "motor": "motorcycle"},
        columns="",
    ),
    classes=("car", "truck", "bicycle", "motor"),
    frames=("00001", "00002"),
)

_CELL_M, _CENTRE_PX = 100 / 576, 575.5  # of the radar's Cartesian picture, as its authors' kit has them
_HEIGHTS = {"car": 1.6, "truck": 3.2, "motorbike": 1.6, "pedestrian": 1.7}


def radiate_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Pixels of a picture whose columns run to the right and rows backwards; heights are nominal."""
    empty_clouds(folder / "Navtech_Cartesian", ".png", FRAMES)
    objects, entries = [], []
    for row in rows:
        height = _HEIGHTS.get(str(row["label"]), 1.7)
        row |= {"h": height, "z": height / 2 - 1.8}
        size = [row["w"] / _CELL_M, row["l"] / _CELL_M]
        centre = [_CENTRE_PX - row["y"] / _CELL_M, _CENTRE_PX - row["x"] / _CELL_M]
        corner = [middle - extent / 2 for middle, extent in zip(centre, size, strict=True)]
        entry = {"position": [*corner, *size], "rotation": math.degrees(row["yaw"])}
        boxes: list[Any] = [[] for _ in FRAMES]
        boxes[FRAMES.index(row["frame"])] = entry
        objects.append({"id": row["track"], "class_name": written(row), "bboxes": boxes})
        entries.append(entry)
    return {folder / "annotations" / "annotations.json": objects}, entries


_RADIATE = tuple(("position", axis) for axis in range(4))
RADIATE = Entries(
    write=radiate_files,
    numbers=(*_RADIATE, ("rotation",)),
    sizes=_RADIATE[2:],
    places=_RADIATE[:2],
    case=partial(
        dataset_case,
        ours={"car": "vehicle", "truck": "large_vehicle", "motorbike": "motorcycle", "pedestrian": "pedestrian"},
    ),
    classes=tuple(_HEIGHTS),
)


def cirrus_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Quaternions x y z w, the centre, length width height."""
    root = folder / "Cirrus_dataset1"
    empty_clouds(root / "dataset1_gaussian", ".xyz", CIRRUS_FRAMES)
    entries = []
    for row in rows:
        sine, cosine = about_z(row["yaw"])
        entry = {"label_class": written(row), "position": [row[axis] for axis in "xyz"]}
        entry |= {"size": [row[axis] for axis in "lwh"], "quaternion": [0.0, 0.0, sine, cosine]}
        entries.append(entry | {"track_id": row["track"], "point_count_gaussian": row["points"]})
    names = {frame: root / "dataset1_annotation" / f"{frame}.json" for frame in CIRRUS_FRAMES}
    trees: dict[Path, Any] = {path: {"label_type": "cuboid", "labels": []} for path in names.values()}
    for row, entry in zip(rows, entries, strict=True):
        trees[names[row["frame"]]]["labels"].append(entry)
    return trees, entries


CIRRUS_FRAMES = ("1556919593820375200", "1556919593920348000")
_CIRRUS = tuple(
    (name, axis) for name, count in (("position", 3), ("size", 3), ("quaternion", 4)) for axis in range(count)
)
_CIRRUS_CLASSES = ("vehicle", "large_vehicle", "pedestrian", "bicycle")
CIRRUS = Entries(
    write=cirrus_files,
    numbers=_CIRRUS,
    sizes=_CIRRUS[3:6],
    places=_CIRRUS[:3],
    words=(("label_class",),),
    whole=(("point_count_gaussian",),),
    tracks=(("track_id",),),
    case=partial(dataset_case, ours={}, columns="track points"),
    classes=_CIRRUS_CLASSES,
    frames=CIRRUS_FRAMES,
)


def astyx_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Quaternions w x y z in the radar's coordinates."""
    empty_clouds(folder / "radar_6455", ".txt", FRAMES)
    entries = []
    for row in rows:
        sine, cosine = about_z(row["yaw"])
        entry = {"center3d": [row[axis] for axis in "xyz"], "dimension3d": [row[axis] for axis in "lwh"]}
        entry |= {"orientation_quat": [cosine, 0.0, 0.0, sine], "classname": written(row), "object_id": -1}
        entries.append(entry | {"occlusion": 0, "label_certainty": 1, "score": -1.0})
    trees: dict[Path, Any] = {folder / "groundtruth_obj3d" / f"{frame}.json": {"objects": []} for frame in FRAMES}
    for row, entry in zip(rows, entries, strict=True):
        trees[folder / "groundtruth_obj3d" / f"{row['frame']}.json"]["objects"].append(entry)
    return trees, entries


_ASTYX = tuple(
    (name, axis)
    for name, count in (("center3d", 3), ("dimension3d", 3), ("orientation_quat", 4))
    for axis in range(count)
)
ASTYX = Entries(
    write=astyx_files,
    numbers=_ASTYX,
    sizes=_ASTYX[3:6],
    places=_ASTYX[:3],
    words=(("classname",),),
    case=partial(
        dataset_case,
        ours={"Car": "vehicle", "Truck": "large_vehicle", "Person": "pedestrian", "Cyclist": "bicycle"},
        columns="",
    ),
    classes=("Car", "Truck", "Person", "Cyclist"),
)


# nuScenes' results.


def nuscenes_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Width, length, height; quaternions w x y z."""
    entries = []
    for row in rows:
        sine, cosine = about_z(row["yaw"])
        entry = {"sample_token": row["frame"], "translation": [row[axis] for axis in "xyz"]}
        entry |= {"size": [row[axis] for axis in "wlh"], "rotation": [cosine, 0.0, 0.0, sine], "velocity": [0.5, 1.5]}
        entries.append(entry | {"detection_name": written(row), "detection_score": row["score"], "attribute_name": ""})
    results: dict[str, Any] = {frame: [] for frame in TOKENS}
    for row, entry in zip(rows, entries, strict=True):
        results[row["frame"]].append(entry)
    meta = {"use_camera": False, "use_lidar": True, "use_radar": False, "use_map": False, "use_external": False}
    return {folder / "results.json": {"meta": meta, "results": results}}, entries


def nuscenes_case(draft: Draft, folder: Path) -> Case:
    rows = draft.rows
    return Case(
        tuple(draft.edits or ["none"]),
        draft.oracle,
        lambda: Reading(read_nuscenes(folder / "results.json")),
        lambda frames: differing(frames, rows, ours={}, columns="score"),
        draft.words,
    )


def read_nuscenes(path: Path) -> dict[str, Boxes | None]:
    """The boxes of a result file by sample, as a score takes them."""
    read_results(path)
    detections = read_predictions(path, format="nuscenes")
    return {frame: boxes for (_, frame), boxes in detections.boxes.items()}


TOKENS = ("3e8750f331d7499e9b5123e9eb70f2e2", "3950bd41f74548429c0f7700ff3d8269")
_NUSCENES = tuple(
    (name, axis) for name, count in (("translation", 3), ("size", 3), ("rotation", 4)) for axis in range(count)
)
NUSCENES = Entries(
    write=nuscenes_files,
    numbers=(*_NUSCENES, ("detection_score",)),
    sizes=_NUSCENES[3:6],
    places=_NUSCENES[:3],
    words=(("detection_name",),),
    case=nuscenes_case,
    classes=("car", "truck", "pedestrian", "bicycle"),
    frames=TOKENS,
    scored=True,
    without=(other_case,),  # a score says it of two files
)


_LAYOUTS = {
    "own JSON": OWN,
    "view_of_delft JSON": DELFT,
    "radiate labels": RADIATE,
    "cirrus labels": CIRRUS,
    "astyx labels": ASTYX,
    "nuscenes results": NUSCENES,
}
FAMILIES = tuple(Family(name, partial(make, layout), share=5.0) for name, layout in _LAYOUTS.items())
