"""Supervisely's annotations of point clouds, which CVAT exports as "Sly Point Cloud".

One file a cloud, ``ann/<cloud file>.json``::

    {"objects": [{"key": "a1", "classTitle": "Car", "tags": []}],
     "figures": [{"key": "b1", "objectKey": "a1", "geometryType": "cuboid_3d", "geometry":
       {"position": {"x", "y", "z"}, "rotation": {"x", "y", "z"}, "dimensions": {"x", "y", "z"}}}]}

Position is the centre, dimensions the full sizes along the box's own axes, rotation Euler angles in radians.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, CuboidEntry, attributes_of, checked, word, xyz
from farfield.files.json_text import append, parse_json, plain_json, set_value

MAX_BYTES = 64 << 20
_KIND = "cuboid_3d"


def parse_supervisely(data: bytes, path: Path | str) -> tuple[Cuboid, ...]:
    """The cuboids of one cloud; the object's key is the track, its tags are attributes.

    Raises:
        FileFormatError: If it is not of this form.
    """
    return tuple(placed.cuboid for placed in placed_supervisely(data, path))


def placed_supervisely(data: bytes, path: Path | str) -> tuple[CuboidEntry, ...]:
    """The same with the way to each figure; errors as above."""
    content = parse_json(data, path, max_bytes=MAX_BYTES)
    held = {name: content.get(name) if isinstance(content, dict) else None for name in ("objects", "figures")}
    for name, value in held.items():
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise FileFormatError(path, where="the root", expected=f"a list {name}", got=repr(value)[:80])
    objects = {str(entry.get("key")): entry for entry in held["objects"] or []}
    return tuple(
        CuboidEntry(("figures", number), _cuboid(figure, objects, path, f"figure {number}"))
        for number, figure in enumerate(held["figures"] or [])
        if figure.get("geometryType") == _KIND
    )


def values(cuboid: Cuboid) -> dict[tuple[str | int, ...], Any]:
    """What a figure says of a cuboid; of the rotation only the yaw, so that a pitch that stands there stays."""
    centre, size = cuboid.box[:3], cuboid.box[3:6]
    changes: dict[tuple[str | int, ...], Any] = {
        ("geometry", name, axis): value
        for name, numbers in (("position", centre), ("dimensions", size))
        for axis, value in zip("xyz", numbers, strict=True)
    }
    return changes | {("geometry", "rotation", "z"): cuboid.box[6]}


def with_class(text: str, key: str, label: str) -> str:
    """The text with another class of an object."""
    return set_value(text, ("objects", _object_places(text).index(key), "classTitle"), label)


def with_new(text: str, cuboid: Cuboid) -> str:
    """The text with one figure more, and its object where that is not there yet."""
    mark = hashlib.blake2b(repr((cuboid, len(text))).encode(), digest_size=16).hexdigest()
    key = cuboid.track or mark
    if key not in _object_places(text):
        text = append(text, ("objects",), {"key": key, "classTitle": cuboid.label, "tags": []})
    (x, y, z, length, width, height, yaw) = cuboid.box
    geometry = {
        "position": {"x": x, "y": y, "z": z},
        "rotation": {"x": 0, "y": 0, "z": yaw},
        "dimensions": {"x": length, "y": width, "z": height},
    }
    figure = {"key": mark, "objectKey": key, "geometryType": _KIND, "geometry": geometry}
    return append(text, ("figures",), figure)


def _object_places(text: str) -> list[str]:
    objects = plain_json(text)["objects"]
    return [str(entry.get("key")) for entry in objects]


def _cuboid(figure: Mapping[str, Any], objects: Mapping[str, Any], path: Path | str, where: str) -> Cuboid:
    key = word(figure.get("objectKey"), path, where, "objectKey")
    geometry = figure.get("geometry")
    if key not in objects or not isinstance(geometry, dict):
        raise FileFormatError(path, where=where, expected="a known objectKey and a geometry", got=repr(figure)[:80])
    centre, turn, size = (xyz(geometry.get(name), path, where, name) for name in ("position", "rotation", "dimensions"))
    value = objects[key].get("tags")
    tags = [tag for tag in value if isinstance(tag, dict)] if isinstance(value, list) else []
    return Cuboid(
        label=word(objects[key].get("classTitle"), path, where, "classTitle"),
        box=checked(centre, size, turn[2], path, where, tilt_rad=turn[:2]),
        track=key,
        attributes=attributes_of({str(tag.get("name")): tag.get("value") for tag in tags}),
    )
