"""Datumaro's JSON, in which CVAT exports cuboids of point clouds: all frames of a task in one file.

Its form::

    {"info": {},
     "categories": {"label": {"labels": [{"name": "Car", "parent": "", "attributes": []}], "attributes": []}},
     "items": [{"id": "000000", "attr": {"frame": 0}, "point_cloud": {"path": "000000.pcd"}, "annotations": [
       {"id": 0, "type": "cuboid_3d", "label_id": 0, "group": 0, "attributes": {"occluded": false, "track_id": 3},
        "position": [x, y, z], "rotation": [0, 0, yaw], "scale": [l, w, h]}]}]}

Position is the centre, scale the full sizes, rotation Euler angles in radians, of which z is the yaw.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, CuboidEntry, attributes_of, checked, numbers, word, wrapped
from farfield.files.json_text import append, finite, parse_json, plain_json

KIND = "cuboid_3d"


def parse_datumaro(data: bytes, path: Path | str) -> tuple[CuboidEntry, ...]:
    """The cuboids of all items; other kinds of annotations are passed over. A frame is named by its item's stem.

    Raises:
        FileFormatError: If it is not of this form.
    """
    content = parse_json(data, path)
    items = content.get("items") if isinstance(content, dict) else None
    if not isinstance(items, list):
        raise FileFormatError(path, where="the root", expected="an object with items", got=repr(content)[:80])
    names = class_names(content, path)
    cuboids: list[CuboidEntry] = []
    filled: set[str] = set()
    for number, item in enumerate(items):
        entries = item.get("annotations", []) if isinstance(item, dict) else None
        if not isinstance(entries, list):
            raise FileFormatError(path, where=f"item {number}", expected="annotations", got=repr(item)[:80])
        frame = frame_name(item, path, f"item {number}")
        if entries and frame in filled:
            expected = "each cloud of one name, in one item"
            raise FileFormatError(path, where=f"item {number}", expected=expected, got=f"{frame!r} twice")
        filled |= {frame} if entries else set()
        for index, entry in enumerate(entries):
            where = f"item {number}, annotation {index}"
            if not isinstance(entry, dict):
                raise FileFormatError(path, where=where, expected="an object", got=repr(entry)[:80])
            if entry.get("type") == KIND:
                cuboid = _cuboid(entry, frame, names, path, where)
                cuboids.append(CuboidEntry(("items", number, "annotations", index), cuboid))
    return tuple(cuboids)


def class_names(content: Mapping[str, Any], path: Path | str) -> list[str]:
    """The classes that ``label_id`` counts.

    Raises:
        FileFormatError: If there are none of the usual form.
    """
    categories = content.get("categories")
    label = categories.get("label") if isinstance(categories, dict) else None
    labels = label.get("labels") if isinstance(label, dict) else None
    if not isinstance(labels, list) or not all(isinstance(entry, dict) for entry in labels):
        raise FileFormatError(path, where="categories", expected="label with labels", got=repr(categories)[:80])
    return [word(entry.get("name"), path, f"label {number}", "name") for number, entry in enumerate(labels)]


def frame_name(item: Mapping[str, Any], path: Path | str, where: str) -> str:
    """The name of an item's cloud without folders and suffix; of one that names no cloud its id's."""
    name = word(item.get("id"), path, where, "id")
    cloud = item.get("point_cloud")
    file = cloud.get("path") if isinstance(cloud, Mapping) else None
    last = PurePosixPath((file if isinstance(file, str) and file.strip() else name).replace("\\", "/")).name
    return last[:-4] if last.lower().endswith((".pcd", ".bin")) and len(last) > 4 else last or "."


def _cuboid(entry: Mapping[str, Any], frame: str, names: Sequence[str], path: Path | str, where: str) -> Cuboid:
    number = entry.get("label_id")
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(names):
        raise FileFormatError(path, where=where, expected=f"label_id below {len(names)}", got=repr(number)[:80])
    centre, turn, size = (numbers(entry.get(key), 3, path, where, key) for key in ("position", "rotation", "scale"))
    own = entry.get("attributes")
    track = _track_name(own.get("track_id") if isinstance(own, Mapping) else None, path, where)
    attributes = {name: value for name, value in attributes_of(own).items() if name != "track_id"}
    return Cuboid(
        frame=frame,
        label=names[number],
        box=checked(centre, size, turn[2], path, where, tilt_rad=turn[:2]),
        track=track,
        attributes=attributes,
    )


def _track_name(value: Any, path: Path | str, where: str) -> str:
    """A track's name or number as text; empty where there is none, or -1."""
    if value is None or isinstance(value, str):
        return value or ""
    number = finite(value, limit=2.0**53)
    if number is None or number != int(number) or number < -1:
        expected = "a whole number from -1 on, or a name, as track_id"
        raise FileFormatError(path, where=where, expected=expected, got=repr(value)[:80])
    return str(int(number)) if number >= 0 else ""


def values(cuboid: Cuboid, names: Sequence[str]) -> Mapping[tuple[str | int, ...], Any]:
    """What an annotation says of a cuboid; its class has to be one of the file's."""
    x, y, z, length, width, height, yaw = cuboid.box
    changes: dict[tuple[str | int, ...], Any] = {
        ("rotation", 2): wrapped(yaw),
        ("label_id",): names.index(cuboid.label),
    }
    changes |= {("position", axis): coordinate for axis, coordinate in enumerate((x, y, z))}
    changes |= {("scale", axis): size for axis, size in enumerate((length, width, height))}
    changes |= {("attributes", name): attribute for name, attribute in cuboid.attributes.items()}
    return changes | ({("attributes", "track_id"): _track(cuboid.track)} if cuboid.track else {})


def entry_of(cuboid: Cuboid, names: Sequence[str], number: int = 0) -> dict[str, Any]:
    """A whole new annotation."""
    x, y, z, length, width, height, yaw = cuboid.box
    attributes: dict[str, Any] = {"occluded": False} | dict(cuboid.attributes)
    return {
        "id": number,
        "type": KIND,
        "attributes": attributes | ({"track_id": _track(cuboid.track)} if cuboid.track else {}),
        "group": 0,
        "label_id": names.index(cuboid.label),
        "position": [x, y, z],
        "rotation": [0.0, 0.0, wrapped(yaw)],
        "scale": [length, width, height],
    }


def _track(track: str) -> int | str:
    return int(track) if track.isascii() and track.isdigit() and len(track) < 16 else track


def with_class(text: str, label: str) -> str:
    """A file's text that knows a class more; the same where it knows it."""
    names = class_names(plain_json(text), "")
    if label in names:
        return text
    return append(text, ("categories", "label", "labels"), {"name": label, "parent": "", "attributes": []})


def with_new(text: str, cuboid: Cuboid) -> str:
    """A file's text with a cuboid more, of a class that it knows; a frame that is not there is added."""
    content = plain_json(text)
    frames = [frame_name(item, "", f"item {number}") for number, item in enumerate(content["items"])]
    if cuboid.frame not in frames:
        text = append(text, ("items",), _item(cuboid.frame, len(frames), []))
        frames.append(cuboid.frame)
    item = frames.index(cuboid.frame)
    held = content["items"][item].get("annotations") if item < len(content["items"]) else []
    if held is None:
        text = append(text, ("items", item), [], key="annotations")
    number = 1 + max((entry.get("id", 0) for entry in held or [] if isinstance(entry.get("id", 0), int)), default=-1)
    return append(text, ("items", item, "annotations"), entry_of(cuboid, class_names(content, ""), number))


def _item(frame: str, number: int, annotations: list[Any]) -> dict[str, Any]:
    cloud = {"path": f"{frame}.pcd"}
    return {"id": frame, "annotations": annotations, "attr": {"frame": number}, "point_cloud": cloud}


def format_datumaro(cuboids: Sequence[Cuboid], frames: Sequence[str]) -> str:
    """A new file's text.

    Args:
        cuboids: All boxes.
        frames: Names of all frames in order, also of those without boxes.
    """
    names = sorted({cuboid.label for cuboid in cuboids})
    held: dict[str, list[Any]] = {frame: [] for frame in frames}
    for cuboid in cuboids:
        held[cuboid.frame].append(entry_of(cuboid, names, len(held[cuboid.frame])))
    labels = [{"name": name, "parent": "", "attributes": []} for name in names]
    content = {
        "info": {},
        "categories": {"label": {"labels": labels, "attributes": []}},
        "items": [_item(frame, number, held[frame]) for number, frame in enumerate(frames)],
    }
    return json.dumps(content, indent=1) + "\n"
