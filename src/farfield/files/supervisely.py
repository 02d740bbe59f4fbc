"""Supervisely's annotations of point clouds, one file a cloud, and of episodes, one file a sequence.

``ann/<cloud file>.json``, which CVAT exports as "Sly Point Cloud"::

    {"objects": [{"key": "a1", "classTitle": "Car", "tags": []}],
     "figures": [{"key": "b1", "objectKey": "a1", "geometryType": "cuboid_3d", "geometry":
       {"position": {"x", "y", "z"}, "rotation": {"x", "y", "z"}, "dimensions": {"x", "y", "z"}}}]}

``annotation.json`` of an episode, the list around it optional; ``frame_pointcloud_map.json`` beside it names each
frame's cloud, ``{"0": "a.pcd"}``::

    {"description": "", "key": "c1", "tags": [], "objects": [as above], "framesCount": 2,
     "frames": [{"index": 0, "figures": [as above]}]}

Position is the centre, dimensions the full sizes along the box's own axes, rotation Euler angles in radians.
Supervisely says (https://developer.supervisely.com/getting-started/supervisely-annotation-format/point-cloud-episodes)
that x of the dimensions is the width and y the length, and that a box without rotation heads along +y. CVAT writes its
own boxes into the same keys: x is the length, and a box without rotation heads along +x.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, CuboidEntry, attributes_of, checked, word, xyz
from farfield.files.json_text import append, finite, parse_json, plain_json, set_value

Axes = Literal["supervisely", "cvat"]
AXES = ("supervisely", "cvat")
MAX_BYTES = 64 << 20
_KIND = "cuboid_3d"
_QUARTER = math.pi / 2
_TOP = 1 << 31  # no episode has more frames


def parse_supervisely(data: bytes, path: Path | str, *, axes: Axes = "cvat") -> tuple[CuboidEntry, ...]:
    """The cuboids of one cloud; the object's key is the track, its tags are attributes.

    Raises:
        FileFormatError: If it is not of this form.
    """
    content = parse_json(data, path, max_bytes=MAX_BYTES)
    objects = _objects(content, path)
    return tuple(
        CuboidEntry(("figures", number), _cuboid(figure, objects, axes, path, f"figure {number}"))
        for number, figure in enumerate(_entries(content, "figures", path, "the root"))
        if figure.get("geometryType") == _KIND
    )


def parse_episode(data: bytes, path: Path | str, *, axes: Axes = "supervisely") -> tuple[CuboidEntry, ...]:
    """The cuboids of all frames of an episode; a cuboid's frame is the frame's number.

    Raises:
        FileFormatError: If it is not of this form.
    """
    content = parse_json(data, path)
    before: tuple[str | int, ...] = ()
    if isinstance(content, list) and len(content) == 1:
        content, before = content[0], (0,)
    objects = _objects(content, path)
    cuboids: list[CuboidEntry] = []
    numbers: set[int] = set()
    for row, frame in enumerate(_entries(content, "frames", path, "the root")):
        number = _whole(frame.get("index"), path, f"frame entry {row}", "index")
        if number in numbers:
            raise FileFormatError(path, where=f"frame entry {row}", expected="each frame once", got=f"{number} twice")
        numbers.add(number)
        for index, figure in enumerate(_entries(frame, "figures", path, f"frame {number}")):
            if figure.get("geometryType") == _KIND:
                cuboid = _cuboid(figure, objects, axes, path, f"frame {number}, figure {index}", str(number))
                cuboids.append(CuboidEntry((*before, "frames", row, "figures", index), cuboid))
    return tuple(cuboids)


def parse_frame_map(data: bytes, path: Path | str) -> dict[str, str]:
    """The frame number of each cloud file of an episode.

    Raises:
        FileFormatError: If it is not of this form, or names a cloud twice or a folder.
    """
    content = parse_json(data, path, max_bytes=MAX_BYTES)
    if not isinstance(content, dict) or not content:
        expected = 'an object of frames and their clouds, {"0": "a.pcd"}'
        raise FileFormatError(path, where="the root", expected=expected, got=repr(content)[:80])
    frames: dict[str, str] = {}
    for number, name in content.items():
        if not (number.isascii() and number.isdigit() and len(number) < 10):
            raise FileFormatError(path, where="a key", expected="a frame's number", got=repr(number)[:80])
        cloud = word(name, path, f"frame {number}", "the cloud's file")
        if PurePosixPath(cloud.replace("\\", "/")).name != cloud or cloud in frames:
            expected = "the name of one file in pointcloud/, each once"
            raise FileFormatError(path, where=f"frame {number}", expected=expected, got=repr(cloud)[:80])
        frames[cloud] = str(int(number))
    return frames


def _objects(content: Any, path: Path | str) -> dict[str, Any]:
    return {str(entry.get("key")): entry for entry in _entries(content, "objects", path, "the root")}


def _entries(content: Any, name: str, path: Path | str, where: str) -> list[dict[str, Any]]:
    value = content.get(name) if isinstance(content, dict) else None
    if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
        raise FileFormatError(path, where=where, expected=f"a list {name}", got=repr(value)[:80])
    return value


def _whole(value: Any, path: Path | str, where: str, name: str) -> int:
    number = finite(value, limit=float(_TOP))
    if number is None or number < 0 or number != int(number) or isinstance(value, float):
        raise FileFormatError(path, where=where, expected=f"a whole number as {name}", got=repr(value)[:80])
    return int(number)


def values(cuboid: Cuboid, axes: Axes = "cvat") -> dict[tuple[str | int, ...], Any]:
    """What a figure says of a cuboid; of the rotation only the yaw, so that a pitch that stands there stays."""
    x, y, z, length, width, height, yaw = cuboid.box
    sides = (width, length, height) if axes == "supervisely" else (length, width, height)
    changes: dict[tuple[str | int, ...], Any] = {
        ("geometry", name, axis): value
        for name, numbers in (("position", (x, y, z)), ("dimensions", sides))
        for axis, value in zip("xyz", numbers, strict=True)
    }
    turn = math.remainder(yaw - _QUARTER, 2 * math.pi) if axes == "supervisely" else yaw
    return changes | {("geometry", "rotation", "z"): turn}


def with_class(text: str, key: str, label: str) -> str:
    """The text with another class of an object."""
    row = _object_places(text).index(key)
    return set_value(text, (*_before(text), "objects", row, "classTitle"), label)


def with_new(text: str, cuboid: Cuboid, axes: Axes = "cvat", *, episode: bool = False) -> str:
    """The text with one figure more, and its object and (of an episode) its frame where they are not there yet."""
    mark = hashlib.blake2b(repr((cuboid, len(text))).encode(), digest_size=16).hexdigest()
    key, before = cuboid.track or mark, _before(text)
    if key not in _object_places(text):
        text = append(text, (*before, "objects"), _object(key, cuboid))
    if not episode:
        return append(text, (*before, "figures"), _figure(mark, key, cuboid, axes))
    frames = _root(text)["frames"]
    row = next((i for i, frame in enumerate(frames) if str(frame["index"]) == cuboid.frame), len(frames))
    if row == len(frames):
        text = append(text, (*before, "frames"), {"index": int(cuboid.frame), "figures": []})
    return append(text, (*before, "frames", row, "figures"), _figure(mark, key, cuboid, axes))


def _object(key: str, cuboid: Cuboid) -> dict[str, Any]:
    tags = [{"name": name, "value": value} for name, value in cuboid.attributes.items()]
    return {"key": key, "classTitle": cuboid.label, "tags": tags}


def _figure(mark: str, key: str, cuboid: Cuboid, axes: Axes) -> dict[str, Any]:
    geometry: dict[str, Any] = {"position": {}, "rotation": {"x": 0, "y": 0}, "dimensions": {}}
    for steps, value in values(cuboid, axes).items():
        geometry[str(steps[1])][steps[2]] = value
    return {"key": mark, "objectKey": key, "geometryType": _KIND, "geometry": geometry}


def _root(text: str) -> dict[str, Any]:
    content = plain_json(text)
    root: dict[str, Any] = content[0] if isinstance(content, list) else content
    return root


def _before(text: str) -> tuple[str | int, ...]:
    return (0,) if isinstance(plain_json(text), list) else ()


def _object_places(text: str) -> list[str]:
    return [str(entry.get("key")) for entry in _root(text)["objects"]]


def empty_cloud() -> str:
    """A file of one cloud without objects."""
    return json.dumps({"description": "", "tags": [], "objects": [], "figures": []}, indent=1) + "\n"


def format_episode(cuboids: Sequence[Cuboid], frames: int, *, name: str = "") -> str:
    """A new episode's ``annotation.json``, in Supervisely's own axes.

    Args:
        cuboids: All boxes; a box's frame is its number. One without a track becomes an object of its own.
        frames: How many frames there are.
        name: Gives the keys, so that the same boxes have the same.
    """
    objects: dict[str, Any] = {}
    by_frame: dict[int, list[Any]] = {}
    for number, cuboid in enumerate(cuboids):
        mark = hashlib.blake2b(f"{name} {number}".encode(), digest_size=16).hexdigest()
        key = cuboid.track or mark
        objects.setdefault(key, _object(key, cuboid))
        by_frame.setdefault(int(cuboid.frame), []).append(_figure(mark, key, cuboid, "supervisely"))
    content = {
        "description": "",
        "key": hashlib.blake2b(name.encode(), digest_size=16).hexdigest(),
        "tags": [],
        "objects": list(objects.values()),
        "framesCount": frames,
        "frames": [{"index": index, "figures": figures} for index, figures in sorted(by_frame.items())],
    }
    return json.dumps(content, indent=1) + "\n"


def format_meta(classes: Sequence[str]) -> str:
    """A project's ``meta.json``: its classes, whose tags are texts."""
    entries = [{"title": name, "shape": _KIND, "color": _colour(name), "geometry_config": {}} for name in classes]
    return json.dumps({"classes": entries, "tags": [], "projectType": "point_cloud_episodes"}, indent=1) + "\n"


def _colour(name: str) -> str:
    return "#" + hashlib.blake2b(name.encode(), digest_size=3).hexdigest().upper()


def longer_sides(entries: Sequence[CuboidEntry]) -> tuple[int, int]:
    """How many boxes, read in CVAT's axes, are clearly longer along x, and along y."""
    sides = [entry.cuboid.box[3:5] for entry in entries]
    return sum(x > 1.2 * y for x, y in sides), sum(y > 1.2 * x for x, y in sides)


def _cuboid(
    figure: Mapping[str, Any], objects: Mapping[str, Any], axes: Axes, path: Path | str, where: str, frame: str = ""
) -> Cuboid:
    key = word(figure.get("objectKey"), path, where, "objectKey")
    geometry = figure.get("geometry")
    if key not in objects or not isinstance(geometry, dict):
        raise FileFormatError(path, where=where, expected="a known objectKey and a geometry", got=repr(figure)[:80])
    centre, turn, size = (xyz(geometry.get(name), path, where, name) for name in ("position", "rotation", "dimensions"))
    value = objects[key].get("tags")
    tags = [tag for tag in value if isinstance(tag, dict)] if isinstance(value, list) else []
    box = checked(centre, size, turn[2], path, where, tilt_rad=turn[:2])
    if axes == "supervisely":
        box = (*box[:3], box[4], box[3], box[5], box[6] + _QUARTER)
    return Cuboid(
        frame=frame,
        label=word(objects[key].get("classTitle"), path, where, "classTitle"),
        box=box,
        track=key,
        attributes=attributes_of({str(tag.get("name")): tag.get("value") for tag in tags}),
    )
