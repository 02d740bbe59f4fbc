"""OpenLABEL 1.0 (ASAM): cuboids by frame and object, here one file a sequence.

Its form::

    {"openlabel": {"metadata": {"schema_version": "1.0.0"},
      "coordinate_systems": {"lidar": {"type": "local", "parent": "", "children": []}},
      "objects": {"17": {"name": "17", "type": "Car"}},
      "frames": {"0": {"frame_properties": {"timestamp": 1.5, "frame_id": "00033_00001"},
        "objects": {"17": {"object_data": {"cuboid": [{"name": "box", "coordinate_system": "lidar",
          "val": [x, y, z, qx, qy, qz, qw, sx, sy, sz]}]}}}}}}}

``val`` is the centre, a quaternion and the full sizes along the box's own axes; with 9 numbers Euler angles about x, y
and z stand in the quaternion's place. 10 are written. ``frame_id`` is ours: the frame's name, as frames have numbers.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, CuboidEntry, attributes_of, checked, numbers, word
from farfield.files.json_text import append, parse_json, plain_json, set_value, span

SYSTEM = "lidar"
_ROOT = "openlabel"


def parse_openlabel(data: bytes, path: Path | str) -> tuple[CuboidEntry, ...]:
    """The cuboids of all frames, in the file's order; the object's uid is the track.

    Raises:
        FileFormatError: If it is not of this form.
    """
    content = parse_json(data, path)
    frames = parsed_frames(content, path)
    types = _mapping(content[_ROOT].get("objects", {}), path, "objects")
    cuboids: list[CuboidEntry] = []
    lengths: set[int] = set()
    for number, frame in frames.items():
        name = frame_name(number, frame, path)
        for uid, entry in _mapping(frame.get("objects", {}), path, f"frame {number}").items():
            where = f"frame {number}, object {uid}"
            kind = word(_mapping(types.get(uid, {}), path, where).get("type"), path, where, "type")
            inner = _mapping(_mapping(entry, path, where).get("object_data", {}), path, where).get("cuboid", [])
            if not isinstance(inner, list):
                raise FileFormatError(path, where=where, expected="a list of cuboids", got=repr(inner)[:80])
            for index, cuboid in enumerate(inner):
                value = cuboid.get("val") if isinstance(cuboid, dict) else None
                lengths |= {len(value)} if isinstance(value, list) else set()
                if lengths == {9, 10}:
                    expected = "10 numbers in every val of a file, or 9 in every one"
                    raise FileFormatError(path, where=where, expected=expected, got=repr(value)[:80])
                steps = (_ROOT, "frames", number, "objects", uid, "object_data", "cuboid", index)
                cuboids.append(CuboidEntry(steps, _cuboid(_mapping(cuboid, path, where), name, kind, uid, path, where)))
    return tuple(cuboids)


def parsed_frames(content: Any, path: Path | str) -> dict[str, dict[str, Any]]:
    """The frames of a file by their numbers.

    Raises:
        FileFormatError: If it is not of this form.
    """
    root = content.get(_ROOT) if isinstance(content, dict) else None
    if not isinstance(root, dict):
        raise FileFormatError(path, where="the root", expected="an object 'openlabel'", got=repr(content)[:80])
    frames = _mapping(root.get("frames", {}), path, "frames")
    return {number: _mapping(frame, path, f"frame {number}") for number, frame in frames.items()}


def frame_name(number: str, frame: Mapping[str, Any], path: Path | str) -> str:
    """A frame's name: ours where the file has it, else its number."""
    properties = frame.get("frame_properties")
    frame_id = properties.get("frame_id") if isinstance(properties, dict) else None
    return number if frame_id is None else word(frame_id, path, f"frame {number}", "frame_id")


def _cuboid(entry: Mapping[str, Any], frame: str, label: str, uid: str, path: Path | str, where: str) -> Cuboid:
    value = entry.get("val")
    if not isinstance(value, list) or len(value) not in (9, 10):
        expected = "val with 10 numbers (a quaternion) or 9 (Euler angles)"
        raise FileFormatError(path, where=where, expected=expected, got=repr(value)[:80])
    row = numbers(value, len(value), path, where, "val")
    roll, pitch, yaw = row[3:6] if len(row) == 9 else _angles(row[3:7], path, where)
    return Cuboid(
        frame=frame,
        label=label,
        box=checked(row[:3], row[-3:], yaw, path, where, tilt_rad=(roll, pitch)),
        track=word(uid, path, where, "uid"),
        attributes=_attributes(entry),
    )


def _angles(quaternion: Sequence[float], path: Path | str, where: str) -> tuple[float, float, float]:
    """Roll, pitch and yaw: yaw is the direction of the turned x axis seen from above."""
    x, y, z, w = quaternion
    norm = x * x + y * y + z * z + w * w
    if not 0.8 < norm < 1.2:
        raise FileFormatError(path, where=where, expected="a quaternion of length 1", got=repr(list(quaternion)))
    roll = math.atan2(2 * (w * x + y * z), norm - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x) / norm)))
    return roll, pitch, math.atan2(2 * (x * y + z * w), norm - 2 * (y * y + z * z))


def _attributes(entry: Mapping[str, Any]) -> dict[str, str | int | float | bool]:
    """Texts, numbers and flags of ``attributes``, whose lists hold ``{"name", "val"}``."""
    groups = entry.get("attributes")
    lists = groups.values() if isinstance(groups, dict) else []
    pairs = {
        str(attribute["name"]): attribute.get("val")
        for group in lists
        if isinstance(group, list)
        for attribute in group
        if isinstance(attribute, dict) and isinstance(attribute.get("name"), str)
    }
    return attributes_of(pairs)


def values(cuboid: Cuboid) -> Mapping[tuple[str | int, ...], Any]:
    """What an entry of 10 numbers says of a cuboid."""
    return {("val", index): number for index, number in enumerate(_val(cuboid))}


def values_of_nine(cuboid: Cuboid) -> Mapping[tuple[str | int, ...], Any]:
    """What an entry of 9 numbers says of a cuboid; its other two angles stay."""
    x, y, z, length, width, height, yaw = cuboid.box
    row = {0: x, 1: y, 2: z, 5: yaw, 6: length, 7: width, 8: height}
    return {("val", index): number for index, number in row.items()}


def _val(cuboid: Cuboid) -> list[float]:
    x, y, z, length, width, height, yaw = cuboid.box
    return [x, y, z, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2), length, width, height]


def entry_of(cuboid: Cuboid) -> dict[str, Any]:
    """A whole new cuboid."""
    entry: dict[str, Any] = {"name": "box", "val": _val(cuboid), "coordinate_system": SYSTEM}
    kinds: dict[str, tuple[type, ...]] = {"text": (str,), "boolean": (bool,), "num": (int, float)}
    groups = {
        kind: [
            {"name": name, "val": attribute}
            for name, attribute in cuboid.attributes.items()
            if type(attribute) in python_types
        ]
        for kind, python_types in kinds.items()
    }
    held = {kind: group for kind, group in groups.items() if group}
    return entry | ({"attributes": held} if held else {})


def with_new(text: str, cuboid: Cuboid) -> str:
    """A file's text with a cuboid more: of an object that is there, or of a new one.

    Args:
        text: The file's text.
        cuboid: The cuboid; without a track it gets a uid that no object has.
    """
    root = plain_json(text)[_ROOT]
    objects = root.get("objects", {})
    free = next(str(number) for number in range(len(objects) + 1) if str(number) not in objects)
    uid = cuboid.track or free
    for name in ("objects", "frames"):
        text = text if name in root else append(text, (_ROOT,), {}, key=name)
    if uid not in root.get("objects", {}):
        text = append(text, (_ROOT, "objects"), {"name": uid, "type": cuboid.label}, key=uid)
    frames = root.get("frames", {})
    number = next((key for key, frame in frames.items() if frame_name(key, frame, "") == cuboid.frame), None)
    if number is None:
        number = (
            cuboid.frame if _is_free_number(cuboid.frame, frames) else str(1 + max(map(_whole, frames), default=-1))
        )
        properties = {} if number == cuboid.frame else {"frame_id": cuboid.frame}
        text = append(text, (_ROOT, "frames"), {"frame_properties": properties, "objects": {}}, key=number)
    way: tuple[str | int, ...] = (_ROOT, "frames", number)
    for step, empty in (("objects", {}), (uid, {}), ("object_data", {}), ("cuboid", [])):
        text = text if span(text, (*way, step)) else append(text, way, empty, key=step)
        way = (*way, step)
    return append(text, way, entry_of(cuboid))


def with_class(text: str, uid: str, label: str) -> str:
    """A file's text in which an object is of another class, in all frames."""
    return set_value(text, (_ROOT, "objects", uid, "type"), label)


def _is_free_number(name: str, frames: Mapping[str, Any]) -> bool:
    return name.isascii() and name.isdigit() and str(int(name)) == name and name not in frames


def _whole(number: str) -> int:
    return int(number) if number.isascii() and number.isdigit() and len(number) < 18 else 0


def format_openlabel(
    cuboids: Sequence[Cuboid], frames: Sequence[str], times_ns: Sequence[int | None] = (), *, system: str = SYSTEM
) -> str:
    """A new file's text.

    Args:
        cuboids: All boxes; one without a track becomes an object of its own.
        frames: Names of all frames in order, also of those without boxes.
        times_ns: Time of each frame, as far as known; written as seconds.
        system: Name of the coordinates in which the boxes stand.
    """
    numbered = {name: str(number) for number, name in enumerate(frames)}
    properties: list[dict[str, Any]] = [{"frame_id": name} for name in frames]
    for frame_properties, time_ns in zip(properties, times_ns, strict=False):
        if time_ns is not None:
            frame_properties["timestamp"] = f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
    rows = [{"frame_properties": frame_properties, "objects": {}} for frame_properties in properties]
    objects: dict[str, Any] = {}
    by_number: dict[str, Any] = dict(zip(map(str, range(len(frames))), rows, strict=True))
    named = {cuboid.track for cuboid in cuboids}
    lonely = (str(number) for number in range(len(cuboids) + len(named) + 1) if str(number) not in named)
    for cuboid in cuboids:
        uid = cuboid.track or next(lonely)
        objects.setdefault(uid, {"name": uid, "type": cuboid.label})
        entry = by_number[numbered[cuboid.frame]]["objects"].setdefault(uid, {"object_data": {"cuboid": []}})
        entry["object_data"]["cuboid"].append(entry_of(cuboid) | {"coordinate_system": system})
    systems = {system: {"type": "local", "parent": "", "children": []}}
    root = {
        "metadata": {"schema_version": "1.0.0"},
        "coordinate_systems": systems,
        "objects": objects,
        "frames": by_number,
    }
    return json.dumps({_ROOT: root}, indent=1) + "\n"


def _mapping(value: Any, path: Path | str, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise FileFormatError(path, where=where, expected="an object", got=repr(value)[:80])
    return value
