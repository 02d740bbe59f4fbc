"""Xtreme1's results and camera parameters: a JSON of each a cloud.

``result/<cloud>.json`` (https://docs.xtreme1.io/xtreme1-docs/export-data/data-annotation-result), one entry a source::

    [{"version": "Xtreme1 V0.6", "dataId": 1, "sourceName": "Ground Truth", "classificationValues": null, "objects": [
      {"id": "033DA6D7", "type": "3D_BOX", "classId": 7, "className": "car", "trackId": "-COOq29", "trackName": "2",
       "classValues": [{"id": "77", "name": "type", "type": "RADIO", "alias": "type", "value": "suv", "isLeaf": true}],
       "contour": {"pointN": 16, "points": [], "viewIndex": 0, "size3D": {"x", "y", "z"}, "center3D": {"x", "y", "z"},
                   "rotation3D": {"x", "y", "z"}},
       "modelConfidence": null, "modelClass": ""}]}]

The centre, the full length, width and height, and Euler angles in radians; the cloud's coordinates, z up. Objects of
images have other types and are passed over. ``camera_config/<cloud>.json`` (the page "coordinate system"): a camera, or
a list of them in the order of the image folders; ``cameraExternal`` brings points of the cloud into the camera.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, CuboidEntry, attributes_of, checked, is_name, numbers, word, wrapped, xyz
from farfield.files.json_text import append, finite, parse_json, plain_json

MAX_BYTES = 64 << 20
BY_PEOPLE = ("Ground Truth", "Without Task")
"""Names of the source that people annotated in, as the documentation has them."""
_KIND = "3D_BOX"
_LARGEST_PX = 1e5


def parse_xtreme1(data: bytes, path: Path | str) -> tuple[CuboidEntry, ...]:
    """The boxes of one file: of its only source, or of the one that people annotated in.

    The track is ``trackId``, or ``trackName`` without one; attributes are ``classValues`` and, of another name than
    the track, ``trackName``.

    Raises:
        FileFormatError: If it is not of this form, or several sources have boxes and none of them is people's alone.
    """
    content = parse_json(data, path, max_bytes=MAX_BYTES)
    sources = content if isinstance(content, list) else [content]
    boxes: dict[int, list[CuboidEntry]] = {}
    for row, source in enumerate(sources):
        objects = source.get("objects") if isinstance(source, dict) else None
        if not isinstance(objects, list) or not all(isinstance(entry, dict) for entry in objects):
            raise FileFormatError(path, where=f"source {row}", expected="a list objects", got=repr(source)[:80])
        steps: tuple[str | int, ...] = (row,) if isinstance(content, list) else ()
        boxes[row] = [
            CuboidEntry((*steps, "objects", number), _cuboid(entry, path, f"source {row}, object {number}"))
            for number, entry in enumerate(objects)
            if entry.get("type") == _KIND
        ]
    filled = [row for row, entries in boxes.items() if entries]
    if len(filled) > 1:
        filled = [row for row in filled if sources[row].get("sourceName") in BY_PEOPLE]
        if len(filled) != 1:
            names = [source.get("sourceName") for source in sources]
            expected = f"boxes of one source, or one of the name {' or '.join(BY_PEOPLE)}"
            fix = "Export the results of one source."
            raise FileFormatError(path, where="sourceName", expected=expected, got=repr(names)[:120], fix=fix)
    return tuple(boxes[filled[0]]) if filled else ()


def _cuboid(entry: Mapping[str, Any], path: Path | str, where: str) -> Cuboid:
    contour = entry.get("contour")
    if not isinstance(contour, dict):
        raise FileFormatError(path, where=where, expected="an object with a contour", got=repr(entry)[:80])
    centre, size, turn = (xyz(contour.get(name), path, where, name) for name in ("center3D", "size3D", "rotation3D"))
    label = word(entry.get("className") or entry.get("modelClass") or None, path, where, "className")
    if not label.strip():
        raise FileFormatError(path, where=where, expected="a text as className", got=repr(label))
    tracks = {name: _track(entry.get(name), path, where, name) for name in ("trackId", "trackName")}
    track = tracks["trackId"] or tracks["trackName"]
    named = {"trackName": tracks["trackName"]} if tracks["trackName"] not in ("", track) else {}
    return Cuboid(
        label=label,
        box=checked(centre, size, turn[2], path, where, tilt_rad=turn[:2]),
        track=track,
        attributes=named | {name: value for name, (_, value) in _class_values(entry).items()},
    )


def _track(value: Any, path: Path | str, where: str, name: str) -> str:
    if value in (None, "", -1) and not isinstance(value, bool):
        return ""
    if isinstance(value, int) and value < 0:
        raise FileFormatError(
            path, where=where, expected=f"a name or a whole number from 0 on as {name}", got=f"{value}"
        )
    return word(value, path, where, name)


def _class_values(entry: Mapping[str, Any]) -> dict[str, tuple[int, Any]]:
    """Place and value of each plain attribute of an object."""
    held = entry.get("classValues")
    rows = [(i, row) for i, row in enumerate(held if isinstance(held, list) else []) if isinstance(row, dict)]
    named = {row["name"]: (i, row.get("value")) for i, row in rows if is_name(row.get("name"))}
    return {name: (i, value) for name, (i, value) in named.items() if attributes_of({name: value})}


def values(cuboid: Cuboid, entry: Mapping[str, Any] | None = None) -> Mapping[tuple[str | int, ...], Any]:
    """What an object says of a cuboid, by the way to it in the object.

    Args:
        cuboid: The cuboid.
        entry: The object as it stands, whose attributes keep their places.
    """
    groups = zip(("center3D", "size3D"), (cuboid.box[:3], cuboid.box[3:6]), strict=True)
    changes: dict[tuple[str | int, ...], Any] = {
        ("contour", name, axis): value for name, row in groups for axis, value in zip("xyz", row, strict=True)
    }
    changes |= {("contour", "rotation3D", "z"): wrapped(cuboid.box[6]), ("className",): cuboid.label}
    track = "trackId" if entry is None or entry.get("trackId") or not entry.get("trackName") else "trackName"
    changes |= {(track,): cuboid.track}
    for name, (row, _) in _class_values(entry or {}).items():
        if name in cuboid.attributes:
            changes[("classValues", row, "value")] = cuboid.attributes[name]
    return changes


def entry_of(cuboid: Cuboid, mark: str) -> dict[str, Any]:
    """A whole new object."""
    x, y, z, length, width, height, yaw = cuboid.box
    names = [name for name in cuboid.attributes if name != "trackName"]
    return {
        "id": mark,
        "type": _KIND,
        "classId": None,
        "className": cuboid.label,
        "trackId": cuboid.track,
        "trackName": str(cuboid.attributes.get("trackName", cuboid.track)),
        "classValues": [
            {"id": name, "name": name, "type": "TEXT", "alias": name, "value": cuboid.attributes[name], "isLeaf": True}
            for name in names
        ],
        "contour": {
            "pointN": 0,
            "points": [],
            "size3D": {"x": length, "y": width, "z": height},
            "center3D": {"x": x, "y": y, "z": z},
            "viewIndex": 0,
            "rotation3D": {"x": 0, "y": 0, "z": wrapped(yaw)},
        },
        "modelConfidence": None,
        "modelClass": "",
    }


def with_new(text: str, cuboid: Cuboid) -> str:
    """A file's text with an object more, in the source whose boxes are read, else in people's or the first."""
    content = plain_json(text)
    mark = hashlib.blake2b(repr((cuboid, len(text))).encode(), digest_size=16).hexdigest()
    if not isinstance(content, list):
        return append(text, ("objects",), entry_of(cuboid, mark))
    if not content:
        return append(text, (), _source([entry_of(cuboid, mark)]))
    entries = parse_xtreme1(text.encode(), "")
    people = [row for row, source in enumerate(content) if source.get("sourceName") in BY_PEOPLE]
    row = entries[0].steps[0] if entries else [*people, 0][0]
    return append(text, (row, "objects"), entry_of(cuboid, mark))


def _source(objects: Sequence[Any]) -> dict[str, Any]:
    head = {"version": "1.0", "dataId": None, "sourceName": BY_PEOPLE[0], "classificationValues": None}
    return head | {"objects": list(objects)}


def format_xtreme1(cuboids: Sequence[Cuboid]) -> str:
    """A new file's text."""
    marks = [hashlib.blake2b(f"{i} {cuboid}".encode(), digest_size=16).hexdigest() for i, cuboid in enumerate(cuboids)]
    rows = [entry_of(cuboid, mark) for cuboid, mark in zip(cuboids, marks, strict=True)]
    return json.dumps([_source(rows)], indent=1) + "\n"


# Cameras.


def parse_cameras(
    data: bytes, path: Path | str
) -> list[tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "4 4"], int, int]]:
    """Matrix (pixels), camera_T_lidar (metres), width and height (pixels, 0 where not said) of each camera in order.

    Raises:
        FileFormatError: If it is not of this form.
    """
    content = parse_json(data, path, max_bytes=MAX_BYTES)
    entries = content if isinstance(content, list) else [content]
    return [_camera(entry, path, f"camera {number}") for number, entry in enumerate(entries)]


def _camera(
    entry: Any, path: Path | str, where: str
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "4 4"], int, int]:
    held = entry if isinstance(entry, dict) else {}
    inner = held.get("cameraInternal", held.get("camera_internal"))
    row = [inner.get(name) for name in ("fx", "fy", "cx", "cy")] if isinstance(inner, dict) else None
    fx, fy, cx, cy = numbers(row, 4, path, where, "cameraInternal with fx, fy, cx, cy")
    outer = held.get("cameraExternal", held.get("camera_external"))
    pose = np.array(numbers(outer, 16, path, where, "cameraExternal")).reshape(4, 4)
    major = held.get("rowMajor", True)
    if not isinstance(major, bool):
        raise FileFormatError(path, where=where, expected="true or false as rowMajor", got=repr(major)[:80])
    pose = pose if major else pose.T
    if not (fx > 0 and fy > 0):
        raise FileFormatError(path, where=where, expected="focal lengths above 0", got=f"{fx:g}, {fy:g}")
    sizes = [finite(held.get(name, 0), limit=_LARGEST_PX) for name in ("width", "height")]
    if not all(size is not None and size >= 0 and math.floor(size) == size for size in sizes):
        raise FileFormatError(path, where=where, expected="whole pixels as width and height", got=repr(sizes))
    width, height = (int(size or 0) for size in sizes)
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), pose, width, height


def format_cameras(
    cameras: Sequence[tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "4 4"], int, int]],
) -> str:
    """A new ``camera_config`` file; skew and distortion have no place.

    Args:
        cameras: As :func:`parse_cameras` gives them.
    """
    rows = [
        {
            "cameraInternal": {"fx": float(m[0, 0]), "fy": float(m[1, 1]), "cx": float(m[0, 2]), "cy": float(m[1, 2])},
            "width": width,
            "height": height,
            "cameraExternal": pose.ravel().tolist(),
            "rowMajor": True,
        }
        for m, pose, width, height in cameras
    ]
    return json.dumps(rows, indent=1) + "\n"
