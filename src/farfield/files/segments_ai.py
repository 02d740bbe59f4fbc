"""Segments.ai's release files: one JSON of a data set's samples and their labels.

Its form, as far as cuboids of point clouds go (https://docs.segments.ai: "structure of the release file", "label
formats", "sample formats", "categories and task attributes")::

    {"name": "v1", "dataset": {"name": "d", "task_type": "pointcloud-cuboid-sequence",
      "task_attributes": {"categories": [{"id": 1, "name": "car"}]},
      "samples": [{"name": "drive", "attributes": {"frames": [
          {"pcd": {"url": "https://.../a.pcd", "type": "pcd"}, "name": "a", "timestamp": "00001",
           "ego_pose": {"position": {"x", "y", "z"}, "heading": {"qx", "qy", "qz", "qw"}}}]},
        "labels": {"ground-truth": {"label_status": "LABELED", "attributes": {"format_version": "0.2", "frames": [
          {"annotations": [{"id": 1, "category_id": 1, "type": "cuboid", "position": {"x", "y", "z"},
            "dimensions": {"x", "y", "z"}, "yaw": 0.63, "track_id": 1, "is_keyframe": true, "index": 0,
            "attributes": {"color": "red"}}]}]}}}}]}}

A sample of one cloud (``pointcloud-cuboid``) has ``pcd`` and ``annotations`` in the place of the frames. Position is
the centre in world coordinates, into which ``ego_pose`` brings the cloud; x of the dimensions is the length, yaw counts
counter-clockwise from +x. A box with a further ``rotation``, which a data set may allow, has to stand upright.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, attributes_of, check_turns, checked, numbers, word, xyz
from farfield.files.json_text import finite, parse_json

TASKS = ("pointcloud-cuboid", "pointcloud-cuboid-sequence")
_KIND = "cuboid"
_FARTHEST_M = 1e8


@dataclass(frozen=True, kw_only=True)
class SegmentsFrame:
    """One frame of a sample.

    Args:
        sample: The sample's name.
        cloud: Name of the cloud's file, as its address ends.
        cuboids: Its boxes in the cloud's coordinates; None where nobody labelled it.
        world_T_cloud: The ego pose (metres); None without one.
    """

    sample: str
    cloud: str
    cuboids: tuple[Cuboid, ...] | None
    world_T_cloud: Float[np.ndarray, "4 4"] | None


def parse_segments(data: bytes, path: Path | str, *, label_set: str = "") -> tuple[SegmentsFrame, ...]:
    """The frames of all samples in order.

    Args:
        data: The file's bytes.
        path: The file, for messages.
        label_set: The labels to take; empty: ``ground-truth``, or the only ones there.

    Raises:
        FileFormatError: If it is not of this form, or of another task.
    """
    content = parse_json(data, path)
    dataset = _mapping(_mapping(content, path, "the root").get("dataset"), path, "dataset")
    task = dataset.get("task_type")
    if task not in TASKS:
        expected = f"a task_type of point clouds with cuboids ({', '.join(TASKS)})"
        raise FileFormatError(path, where="dataset", expected=expected, got=repr(task)[:80])
    classes = _classes(_mapping(dataset.get("task_attributes"), path, "task_attributes").get("categories"), path)
    samples = dataset.get("samples")
    if not isinstance(samples, list):
        raise FileFormatError(path, where="dataset", expected="a list samples", got=repr(samples)[:80])
    frames: list[SegmentsFrame] = []
    names: set[str] = set()
    for number, sample in enumerate(samples):
        where = f"sample {number}"
        name = _name(_mapping(sample, path, where).get("name"), path, where)
        if name in names:
            raise FileFormatError(path, where=where, expected="samples of different names", got=f"{name!r} again")
        names.add(name)
        frames += _frames(sample, name, classes, label_set, path, where)
    return tuple(frames)


def _classes(value: Any, path: Path | str) -> dict[int, str]:
    entries = value if isinstance(value, list) and all(isinstance(entry, dict) for entry in value) else None
    if entries is None:
        raise FileFormatError(path, where="task_attributes", expected="a list categories", got=repr(value)[:80])
    return {
        _whole(entry.get("id"), path, f"category {number}", "id"): _name(entry.get("name"), path, f"category {number}")
        for number, entry in enumerate(entries)
    }


def _frames(
    sample: Mapping[str, Any], name: str, classes: Mapping[int, str], label_set: str, path: Path | str, where: str
) -> list[SegmentsFrame]:
    attributes = _mapping(sample.get("attributes"), path, f"{where}, attributes")
    rows = attributes.get("frames") if "frames" in attributes else [attributes]
    if not isinstance(rows, list):
        raise FileFormatError(path, where=where, expected="a list frames", got=repr(rows)[:80])
    labels = _labels(sample.get("labels"), label_set, path, where)
    if labels is not None and len(labels) != len(rows):
        raise FileFormatError(path, where=where, expected=f"labels of {len(rows)} frames", got=f"{len(labels)}")
    return [
        _frame(row, name, None if labels is None else labels[index], classes, path, f"{where}, frame {index}")
        for index, row in enumerate(rows)
    ]


def _labels(value: Any, label_set: str, path: Path | str, where: str) -> list[Any] | None:
    """What the frames' labels are, one a frame; None where nobody labelled the sample."""
    sets = {name: held for name, held in _mapping(value or {}, path, f"{where}, labels").items() if held is not None}
    if label_set:
        sets = {name: held for name, held in sets.items() if name == label_set}
    elif len(sets) > 1:
        if "ground-truth" not in sets:
            expected = "one set of labels, or one of the name ground-truth"
            raise FileFormatError(path, where=f"{where}, labels", expected=expected, got=", ".join(sets)[:80])
        sets = {"ground-truth": sets["ground-truth"]}
    if not sets:
        return None
    attributes = _mapping(next(iter(sets.values())), path, f"{where}, labels").get("attributes")
    if attributes is None:
        return None
    held = _mapping(attributes, path, f"{where}, labels")
    frames = held.get("frames") if "frames" in held else [held]
    if not isinstance(frames, list):
        raise FileFormatError(path, where=f"{where}, labels", expected="a list frames", got=repr(frames)[:80])
    return frames


def _frame(
    row: Any, sample: str, label: Any, classes: Mapping[int, str], path: Path | str, where: str
) -> SegmentsFrame:
    held = _mapping(row, path, where)
    url = _mapping(held.get("pcd"), path, f"{where}, pcd").get("url")
    if not isinstance(url, str) or not (cloud := PurePosixPath(url.split("?")[0].replace("\\", "/")).name):
        raise FileFormatError(path, where=f"{where}, pcd", expected="an address as url", got=repr(url)[:80])
    pose = None if held.get("ego_pose") is None else _pose(held["ego_pose"], path, f"{where}, ego_pose")
    cuboids: tuple[Cuboid, ...] | None = None
    if label is not None:
        entries = _mapping(label, path, where).get("annotations")
        if not isinstance(entries, list):
            raise FileFormatError(path, where=where, expected="a list annotations", got=repr(entries)[:80])
        cuboids = tuple(
            _cuboid(_mapping(entry, path, f"{where}, annotation {i}"), classes, pose, path, f"{where}, annotation {i}")
            for i, entry in enumerate(entries)
            if not isinstance(entry, dict) or entry.get("type") == _KIND
        )
    return SegmentsFrame(sample=sample, cloud=cloud, cuboids=cuboids, world_T_cloud=pose)


def _pose(value: Any, path: Path | str, where: str) -> Float[np.ndarray, "4 4"]:
    held = _mapping(value, path, where)
    origin = xyz(held.get("position"), path, where, "position")
    if max(map(abs, origin)) > _FARTHEST_M:
        raise FileFormatError(path, where=where, expected="a position within 100,000 km", got=repr(origin))
    heading = held.get("heading")
    row = [heading.get(name) for name in ("qx", "qy", "qz", "qw")] if isinstance(heading, dict) else None
    turn = np.array(numbers(row, 4, path, where, "heading with qx, qy, qz, qw"))
    check_turns(turn[None], path, where, upright=False)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_of(turn), origin
    return pose


def rotation_of(quaternion_xyzw: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation of a quaternion of about length 1."""
    x, y, z, w = quaternion_xyzw / np.linalg.norm(quaternion_xyzw)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _cuboid(
    entry: Mapping[str, Any],
    classes: Mapping[int, str],
    world_T_cloud: Float[np.ndarray, "4 4"] | None,
    path: Path | str,
    where: str,
) -> Cuboid:
    number = _whole(entry.get("category_id"), path, where, "category_id")
    if number not in classes:
        raise FileFormatError(path, where=where, expected="the category_id of a category", got=repr(number))
    centre, size = (np.array(xyz(entry.get(name), path, where, name)) for name in ("position", "dimensions"))
    yaw = finite(entry.get("yaw"), limit=4 * math.pi)
    if yaw is None:
        raise FileFormatError(path, where=where, expected="radians as yaw", got=repr(entry.get("yaw"))[:80])
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1.0]])
    if isinstance(rotation := entry.get("rotation"), dict):
        row = numbers([rotation.get(name) for name in ("qx", "qy", "qz", "qw")], 4, path, where, "rotation")
        check_turns(np.array([row]), path, where)
        turn = rotation_of(np.array(row))
    if world_T_cloud is not None:
        turn = world_T_cloud[:3, :3].T @ turn
        centre = world_T_cloud[:3, :3].T @ (centre - world_T_cloud[:3, 3])
        yaw = math.atan2(turn[1, 0], turn[0, 0])
    elif isinstance(entry.get("rotation"), dict):
        yaw = math.atan2(turn[1, 0], turn[0, 0])
    tilt = [math.asin(max(-1.0, min(1.0, float(turn[2, axis])))) for axis in (0, 1)]
    track = entry.get("track_id")
    return Cuboid(
        label=classes[number],
        box=checked(centre.tolist(), size.tolist(), yaw, path, where, tilt_rad=tilt),
        track="" if track is None else str(_whole(track, path, where, "track_id")),
        attributes=attributes_of(entry.get("attributes")),
    )


def _whole(value: Any, path: Path | str, where: str, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise FileFormatError(path, where=where, expected=f"a whole number as {name}", got=repr(value)[:80])
    return value


def _name(value: Any, path: Path | str, where: str) -> str:
    name = word(value, path, where, "name")
    if not name.strip():
        raise FileFormatError(path, where=where, expected="a text as name", got=repr(value)[:80])
    return name


def _mapping(value: Any, path: Path | str, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise FileFormatError(path, where=where, expected="an object", got=repr(value)[:80])
    return value
