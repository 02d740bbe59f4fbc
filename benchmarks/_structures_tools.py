"""Structural edits of what labelling tools write: SUSTechPOINTS, Datumaro, OpenLABEL, tracklets..."""

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _labelled_rows import (
    LAYOUTS,
    STRANGE,
    Draft,
    Row,
    dataset_case,
    differing,
    encoded,
    model,
    other_case,
    own_class,
)
from _structures import Case, Family, Reading
from _structures_json import FRAMES, USUAL, Entries, about_z, make, small_pcds, written

from farfield.datasets.labels.json_labels import annotation_of
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import CuboidEntry
from farfield.files.openlabel import parse_openlabel
from farfield.frame import Boxes


def axes(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def psr(row: Row, names: Sequence[str]) -> dict[str, Any]:
    """Place, turn and size as objects of x, y, z."""
    groups = ([row[axis] for axis in "xyz"], [0.0, 0.0, row["yaw"]], [row[axis] for axis in "lwh"])
    return {name: axes(values) for name, values in zip(names, groups, strict=True)}


def sustech_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """``psr`` holds position, rotation and scale."""
    small_pcds(folder / "lidar", FRAMES)
    entries = [
        {
            "obj_id": str(row["track"]),
            "obj_type": written(row),
            "psr": psr(row, ("position", "rotation", "scale")),
        }
        for row in rows
    ]
    trees: dict[Path, Any] = {folder / "label" / f"{frame}.json": [] for frame in FRAMES}
    for row, entry in zip(rows, entries, strict=True):
        trees[folder / "label" / f"{row['frame']}.json"].append(entry)
    return trees, entries


def grouped(before: tuple[str, ...], names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    return tuple((*before, name, axis) for name in names for axis in "xyz")


_SUSTECH = grouped(("psr",), ("position", "scale", "rotation"))
SUSTECH = Entries(
    write=sustech_files,
    numbers=_SUSTECH,
    sizes=_SUSTECH[3:6],
    places=_SUSTECH[:3],
    yaw=("psr", "rotation", "z"),
    words=(("obj_type",),),
    case=partial(dataset_case, ours=USUAL),
)


def datumaro_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """One file for all clouds; a class is a number of a list."""
    small_pcds(folder / "point_clouds", FRAMES)
    names = list(dict.fromkeys(written(row) for row in rows))
    entries = [
        {
            "id": number,
            "type": "cuboid_3d",
            "label_id": names.index(written(row)),
            "group": 0,
            "attributes": {"occluded": False, "track_id": row["track"]},
            "position": [row[axis] for axis in "xyz"],
            "rotation": [0.0, 0.0, row["yaw"]],
            "scale": [row[axis] for axis in "lwh"],
        }
        for number, row in enumerate(rows)
    ]
    items = {frame: {"id": frame, "annotations": [], "point_cloud": {"path": f"{frame}.pcd"}} for frame in FRAMES}
    for row, entry in zip(rows, entries, strict=True):
        items[row["frame"]]["annotations"].append(entry)  # type: ignore[union-attr]
    labels = {"labels": [{"name": name, "parent": "", "attributes": []} for name in names], "attributes": []}
    tree = {"info": {}, "categories": {"label": labels}, "items": list(items.values())}
    return {folder / "annotations" / "default.json": tree}, entries


_DATUMARO = tuple((name, axis) for name in ("position", "scale", "rotation") for axis in range(3))
DATUMARO = Entries(
    write=datumaro_files,
    numbers=_DATUMARO,
    sizes=_DATUMARO[3:6],
    places=_DATUMARO[:3],
    yaw=("rotation", 2),
    whole=(("label_id",),),
    tracks=(("attributes", "track_id"),),
    case=partial(dataset_case, ours=USUAL),
)


def supervisely_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Objects and their figures."""
    small_pcds(folder / "pointcloud", FRAMES)
    trees: dict[Path, Any] = {folder / "ann" / f"{frame}.pcd.json": {"objects": [], "figures": []} for frame in FRAMES}
    entries = []
    for row in rows:
        tree = trees[folder / "ann" / f"{row['frame']}.pcd.json"]
        tree["objects"].append({"key": str(row["track"]), "classTitle": written(row), "tags": []})
        geometry = psr(row, ("position", "rotation", "dimensions"))
        entry = {"key": f"f{row['track']}", "objectKey": str(row["track"]), "geometryType": "cuboid_3d"}
        entries.append(entry | {"geometry": geometry})
        tree["figures"].append(entries[-1])
    return trees, entries


_SUPERVISELY = grouped(("geometry",), ("position", "dimensions", "rotation"))
SUPERVISELY = Entries(
    write=supervisely_files,
    numbers=_SUPERVISELY,
    sizes=_SUPERVISELY[3:6],
    places=_SUPERVISELY[:3],
    yaw=("geometry", "rotation", "z"),
    words=(("objectKey",),),
    case=partial(dataset_case, ours=USUAL, columns=""),
)


def openlabel_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Ten numbers a cuboid: place, quaternion x y z w, sizes."""
    objects = {str(row["track"]): {"name": str(row["track"]), "type": written(row)} for row in rows}
    frames: dict[str, Any] = {
        str(number): {"frame_properties": {"frame_id": frame}, "objects": {}} for number, frame in enumerate(FRAMES)
    }
    entries = []
    for row in rows:
        sine, cosine = about_z(row["yaw"])
        val = [*(row[axis] for axis in "xyz"), 0.0, 0.0, sine, cosine, *(row[axis] for axis in "lwh")]
        entries.append({"name": "box", "val": val, "coordinate_system": "lidar"})
        held = frames[str(FRAMES.index(row["frame"]))]["objects"]
        held[str(row["track"])] = {"object_data": {"cuboid": [entries[-1]]}}
    root = {"metadata": {"schema_version": "1.0.0"}, "objects": objects, "frames": frames}
    return {folder / "labels.json": {"openlabel": root}}, entries


def read_openlabel(path: Path) -> Mapping[str, Boxes]:
    cuboids = [entry.cuboid for entry in parse_openlabel(read_bytes(path), path) if isinstance(entry, CuboidEntry)]
    return {frame: annotation_of([cuboid for cuboid in cuboids if cuboid.frame == frame]).boxes for frame in FRAMES}


def openlabel_case(draft: Draft, folder: Path) -> Case:
    rows = draft.rows
    return Case(
        tuple(draft.edits or ["none"]),
        draft.oracle,
        lambda: Reading(read_openlabel(folder / "labels.json")),
        lambda frames: differing(frames, rows, ours=USUAL, columns="track"),
        draft.words,
    )


_OPENLABEL = tuple(("val", axis) for axis in range(10))
OPENLABEL = Entries(
    write=openlabel_files,
    numbers=_OPENLABEL,
    sizes=_OPENLABEL[7:],
    places=_OPENLABEL[:3],
    case=openlabel_case,
)


# Label files beside clouds: labelCloud's three forms, Supervisely's episodes, Xtreme1's scenes, OpenLABEL's frames.


def labelcloud_files(form: str, rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """``labels/`` beside ``pointclouds/``; a file whose angles may be either has one more that shows it."""
    small_pcds(folder / "pointclouds", FRAMES)
    entries = []
    trees: dict[Path, Any] = {
        folder / "labels" / f"{frame}.json": {"folder": "pointclouds", "filename": f"{frame}.pcd", "objects": []}
        for frame in FRAMES
    }
    for row in rows:
        if form == "vertices":
            entry: dict[str, Any] = {"name": written(row), "vertices": corners(row)}
        else:
            turn = math.degrees(row["yaw"]) % 360 if form == "centroid_abs" else row["yaw"]
            entry = {
                "name": written(row),
                "centroid": axes([row[axis] for axis in "xyz"]),
                "dimensions": {"length": row["l"], "width": row["w"], "height": row["h"]},
                "rotations": axes([0.0, 0.0, turn]),
            }
        entries.append(entry)
        trees[folder / "labels" / f"{row['frame']}.json"]["objects"].append(entry)
        row["track"] = None
    return trees, entries


def corners(row: Row) -> list[list[float]]:
    """Left back, left front, right front and right back of the bottom, then of the top; right is ahead."""
    turn = np.array([[math.cos(row["yaw"]), math.sin(row["yaw"])], [-math.sin(row["yaw"]), math.cos(row["yaw"])]])
    flat = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * [row["l"] / 2, row["w"] / 2] @ turn
    levels = [row["z"] - row["h"] / 2, row["z"] + row["h"] / 2]
    return [[row["x"] + x, row["y"] + y, z] for z in levels for x, y in flat.tolist()]


def labelcloud_case(draft: Draft, folder: Path, *, form: str) -> Case:
    options = {"centroid_rel": {"label_angles": "radians"}, "centroid_abs": {"label_angles": "degrees"}}
    if form != "vertices" and draft.edits == ["yaw in degrees"]:
        draft.oracle = "either"
    return dataset_case(draft, folder, ours=USUAL, columns="", options=options.get(form, {}))


_CENTROID = (
    *grouped((), ("centroid",)),
    *(("dimensions", name) for name in ("length", "width", "height")),
    *grouped((), ("rotations",)),
)


def labelcloud_layout(form: str) -> Entries:
    """The entries of one form."""
    vertices = tuple(("vertices", corner, axis) for corner in range(8) for axis in range(3))
    numbers = vertices if form == "vertices" else _CENTROID
    return Entries(
        write=partial(labelcloud_files, form),
        numbers=numbers,
        sizes=() if form == "vertices" else _CENTROID[3:6],
        places=numbers if form == "vertices" else _CENTROID[:3],
        yaw=("rotations", "z") if form == "centroid_rel" else (),
        words=(("name",),),
        case=partial(labelcloud_case, form=form),
    )


def episode_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """Supervisely's own axes: the width is x, and a box without rotation heads along y."""
    drive = folder / "drive"
    small_pcds(drive / "pointcloud", FRAMES)
    (drive / "frame_pointcloud_map.json").write_text(json.dumps({str(i): f"{f}.pcd" for i, f in enumerate(FRAMES)}))
    objects, entries = [], []
    frames: list[dict[str, Any]] = [{"index": number, "figures": []} for number in range(len(FRAMES))]
    for row in rows:
        objects.append({"key": str(row["track"]), "classTitle": written(row), "tags": []})
        turned = row | {"yaw": row["yaw"] - math.pi / 2, "l": row["w"], "w": row["l"]}
        entry = {"key": f"f{row['track']}", "objectKey": str(row["track"]), "geometryType": "cuboid_3d"}
        entries.append(entry | {"geometry": psr(turned, ("position", "rotation", "dimensions"))})
        frames[FRAMES.index(row["frame"])]["figures"].append(entries[-1])
    tree = {"description": "", "key": "e", "tags": [], "objects": objects, "framesCount": 2, "frames": frames}
    return {drive / "annotation.json": tree}, entries


EPISODES = Entries(
    write=episode_files,
    numbers=_SUPERVISELY,
    sizes=_SUPERVISELY[3:6],
    places=_SUPERVISELY[:3],
    yaw=("geometry", "rotation", "z"),
    words=(("objectKey",),),
    case=partial(dataset_case, ours=USUAL, columns=""),
)


def xtreme1_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """One source a result, with an object of an image among the boxes."""
    scene = folder / "scene_1"
    small_pcds(scene / "lidar_point_cloud_0", FRAMES)
    flat = {"type": "2D_RECT", "className": "Car", "contour": {"points": [{"x": 1, "y": 2}]}}
    trees: dict[Path, Any] = {
        scene / "result" / f"{frame}.json": [{"version": "1.0", "sourceName": "Ground Truth", "objects": [dict(flat)]}]
        for frame in FRAMES
    }
    entries = []
    for row in rows:
        contour = {"pointN": 5, "points": [], "viewIndex": 0} | psr(row, ("center3D", "rotation3D", "size3D"))
        kind = {"type": "3D_BOX", "className": written(row), "trackId": str(row["track"]), "classValues": []}
        entries.append(kind | {"contour": contour})
        trees[scene / "result" / f"{row['frame']}.json"][0]["objects"].append(entries[-1])
    return trees, entries


_XTREME1 = grouped(("contour",), ("center3D", "size3D", "rotation3D"))
XTREME1 = Entries(
    write=xtreme1_files,
    numbers=_XTREME1,
    sizes=_XTREME1[3:6],
    places=_XTREME1[:3],
    yaw=("contour", "rotation3D", "z"),
    words=(("className",),),
    tracks=(("trackId",),),
    case=partial(dataset_case, ours=USUAL),
)


def openlabel_cloud_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """The same beside clouds that the frames' streams name."""
    trees, entries = openlabel_files(rows, folder)
    small_pcds(folder / "lidar", FRAMES)
    (tree,) = trees.values()
    for frame, name in zip(tree["openlabel"]["frames"].values(), FRAMES, strict=True):
        frame["frame_properties"] = {"timestamp": 1.5, "streams": {"lidar": {"uri": f"lidar/{name}.pcd"}}}
    return trees, entries


OPENLABEL_CLOUDS = Entries(
    write=openlabel_cloud_files,
    numbers=_OPENLABEL,
    sizes=_OPENLABEL[7:],
    places=_OPENLABEL[:3],
    case=partial(dataset_case, ours=USUAL),
)


def segments_files(rows: Sequence[Row], folder: Path) -> tuple[dict[Path, Any], list[Any]]:
    """A release of one sample whose clouds stand in the world as they are."""
    small_pcds(folder / "clouds", FRAMES)
    names = list(dict.fromkeys(written(row) for row in rows))
    labels: list[dict[str, Any]] = [{"annotations": []} for _ in FRAMES]
    entries = []
    for row in rows:
        places = {"position": axes([row[axis] for axis in "xyz"]), "dimensions": axes([row[axis] for axis in "lwh"])}
        kind = {"id": 1, "category_id": names.index(written(row)) + 1, "type": "cuboid", "track_id": row["track"]}
        entries.append(kind | places | {"yaw": row["yaw"]})
        labels[FRAMES.index(row["frame"])]["annotations"].append(entries[-1])
    frames = [{"pcd": {"url": f"https://a/{frame}.pcd", "type": "pcd"}, "name": frame} for frame in FRAMES]
    held = {"ground-truth": {"label_status": "LABELED", "attributes": {"frames": labels}}}
    sample = {"name": "drive", "attributes": {"frames": frames}, "labels": held}
    categories = [{"id": number + 1, "name": name} for number, name in enumerate(names)]
    task = {"task_type": "pointcloud-cuboid-sequence", "task_attributes": {"categories": categories}}
    return {folder / "v1.json": {"name": "v1", "dataset": task | {"samples": [sample]}}}, entries


_SEGMENTS = (*grouped((), ("position", "dimensions")), ("yaw",))
SEGMENTS = Entries(
    write=segments_files,
    numbers=_SEGMENTS,
    sizes=_SEGMENTS[3:6],
    places=_SEGMENTS[:3],
    yaw=("yaw",),
    whole=(("category_id",),),
    case=partial(dataset_case, ours=USUAL),
)


# KITTI's tracklets, as KITTI's own page and CVAT's and Datumaro's writers mean them.

_MEANINGS = {"kitti": ("l", "w", "h"), "cvat": ("h", "w", "l"), "datumaro": ("w", "h", "l")}


def tracklets(random: np.random.Generator, folder: Path) -> Case:
    """One drive, in one of the three meanings, with the flag that says it."""
    draft = Draft(random, model(random, FRAMES, tuple(USUAL)))
    kind = draft.pick(["none", "model", "element", "element", "element", "list", "list", "stored"])
    if kind == "model":
        draft.pick([other_case, own_class])(draft)
    meaning = draft.pick(list(_MEANINGS))
    drive = folder / "drive"
    small_pcds(drive / "velodyne_points" / "data", FRAMES)
    items = [_tracklet(draft, row, meaning, number) for number, row in enumerate(draft.rows)]
    if kind == "element":
        _wrong_element(draft, items, meaning)
    listed = [f"{number} {frame}" for number, frame in enumerate(FRAMES)]
    if kind == "list":
        _other_list(draft, listed)
    count = f"<count>{len(items)}</count><item_version>1</item_version>"
    body = f"<tracklets>{count}{''.join(items)}</tracklets>"
    text = f"<?xml version='1.0'?>\n<boost_serialization>{body}</boost_serialization>\n"
    kinds = STRANGE[1:] if kind == "stored" else LAYOUTS  # XML may stand in UTF-16
    (drive / "tracklet_labels.xml").write_bytes(encoded(draft, text, kinds))
    (drive / "frame_list.txt").write_text("\n".join(listed) + "\n")
    for number, row in enumerate(draft.rows):
        row["track"] = number
    return dataset_case(draft, folder, ours=USUAL, options={"tracklets": meaning})


def _tracklet(draft: Draft, row: Row, meaning: str, number: int) -> str:
    del draft, number
    sizes = dict(zip(_MEANINGS[meaning], (row["l"], row["w"], row["h"]), strict=True))
    low = row["z"] - (row["h"] / 2 if meaning == "kitti" else 0)
    values = {"tx": row["x"], "ty": row["y"], "tz": low, "rx": 0, "ry": 0, "rz": row["yaw"]}
    pose = "".join(f"<{name}>{value!r}</{name}>" for name, value in values.items())
    first = FRAMES.index(row["frame"])
    shape = "".join(f"<{name}>{sizes[name]!r}</{name}>" for name in "hwl")
    head = f"<objectType>{written(row)}</objectType>{shape}<first_frame>{first}</first_frame>"
    return f"<item>{head}<poses><count>1</count><item>{pose}</item></poses></item>"


def _wrong_element(draft: Draft, items: list[str], meaning: str) -> None:
    """One element of an object that is missing, empty, or no number."""
    del meaning
    number = int(draft.random.integers(len(items)))
    name = draft.pick(["h", "w", "l", "tx", "ty", "tz", "rz", "first_frame", "objectType"])
    head, _, rest = items[number].partition(f"<{name}>")
    value, _, tail = rest.partition(f"</{name}>")
    if name == "objectType":
        edit = draft.pick(["element missing", "empty element"])
    else:
        edit = draft.pick(["element missing", "empty element", "nan", "1,5", "1_0", "inf", "text", "1e30", "0x10"])
    new = {"element missing": head + tail, "empty element": f"{head}<{name}></{name}>{tail}"}
    items[number] = new.get(edit, f"{head}<{name}>{edit}</{name}>{tail}")
    del value
    draft.note(f"{edit} as {name}", "refused")


def _other_list(draft: Draft, listed: list[str]) -> None:
    """The list of frames beside the tracklets: in another order, with more, fewer or doubled lines."""
    kind = draft.pick(["reversed", "sweeps with suffix", "with folders", "a line more", "missing", "doubled", "names"])
    if kind == "reversed":
        listed.reverse()
    elif kind == "sweeps with suffix":
        listed[:] = [f"{line}.pcd" for line in listed]
    elif kind == "with folders":
        listed[:] = [line.replace(" ", " velodyne_points/data/") for line in listed]
    elif kind == "a line more":
        listed.append("7 000009")
    elif kind == "missing":
        del listed[int(draft.random.integers(len(listed)))]
    elif kind == "doubled":
        listed.append(f"0 {FRAMES[1]}")
    else:
        listed[:] = [line.replace(" 0", " sweep_0") for line in listed]
    good = kind in ("reversed", "sweeps with suffix", "with folders", "a line more")
    draft.note(f"list of frames: {kind}", "same" if good else "refused")


_TOOLS = {
    "sustechpoints": SUSTECH,
    "datumaro": DATUMARO,
    "supervisely": SUPERVISELY,
    "openlabel": OPENLABEL,
    "openlabel clouds": OPENLABEL_CLOUDS,
    "episodes": EPISODES,
    "xtreme1": XTREME1,
    "segments_ai": SEGMENTS,
    **{f"labelcloud {form}": labelcloud_layout(form) for form in ("centroid_rel", "centroid_abs", "vertices")},
}
FAMILIES = (
    *(Family(name, partial(make, layout), share=4.0) for name, layout in _TOOLS.items()),
    Family("tracklets", tracklets, share=4.0),
)
