"""Supervisely's annotations of point clouds, which CVAT exports as "Sly Point Cloud".

One file a cloud, ``ann/<cloud file>.json``::

    {"objects": [{"key": "a1", "classTitle": "Car", "tags": []}],
     "figures": [{"key": "b1", "objectKey": "a1", "geometryType": "cuboid_3d", "geometry":
       {"position": {"x", "y", "z"}, "rotation": {"x", "y", "z"}, "dimensions": {"x", "y", "z"}}}]}

Position is the centre, dimensions the full sizes along the box's own axes, rotation Euler angles in radians.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, Value, attributes_of, checked, word, xyz
from farfield.files.json_text import parse_json

MAX_BYTES = 64 << 20
_KIND = "cuboid_3d"


def parse_supervisely(data: bytes, path: Path | str) -> tuple[Cuboid, ...]:
    """The cuboids of one cloud; the object's key is the track, its tags are attributes.

    Raises:
        FileFormatError: If it is not of this form.
    """
    content = parse_json(data, path, max_bytes=MAX_BYTES)
    held = {name: content.get(name) if isinstance(content, dict) else None for name in ("objects", "figures")}
    for name, value in held.items():
        if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
            raise FileFormatError(path, where="the root", expected=f"a list {name}", found=repr(value)[:80])
    objects = {str(each.get("key")): each for each in held["objects"] or []}
    figures = [each for each in held["figures"] or [] if each.get("geometryType") == _KIND]
    return tuple(_cuboid(figure, objects, path, f"figure {number}") for number, figure in enumerate(figures))


def _cuboid(figure: Mapping[str, Any], objects: Mapping[str, Any], path: Path | str, where: str) -> Cuboid:
    key = word(figure.get("objectKey"), path, where, "objectKey")
    geometry = figure.get("geometry")
    if key not in objects or not isinstance(geometry, dict):
        raise FileFormatError(path, where=where, expected="a known objectKey and a geometry", found=repr(figure)[:80])
    centre, turn, size = (xyz(geometry.get(name), path, where, name) for name in ("position", "rotation", "dimensions"))
    return Cuboid(
        label=word(objects[key].get("classTitle"), path, where, "classTitle"),
        box=checked(centre, size, turn[2], path, where),
        track=key,
        attributes=_tags(objects[key].get("tags")),
    )


def _tags(value: Any) -> dict[str, Value]:
    tags = [tag for tag in value if isinstance(tag, dict)] if isinstance(value, list) else []
    return attributes_of({str(tag.get("name")): tag.get("value") for tag in tags})
