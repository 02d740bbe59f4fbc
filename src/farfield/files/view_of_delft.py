"""View-of-Delft's JSON files: poses of the camera, and labels with nine degrees of freedom.

A pose file holds three JSON objects one after another, each with one matrix of 16 numbers, row by row:
``odomToCamera``, ``mapToCamera``, ``UTMToCamera``. In spite of their names they map camera coordinates to the named
frame: their rotation turns the camera's y axis downwards, and their translation is the camera's place.

A label file is a list of objects with ``className``, ``objectId``, ``geometry`` (size, centre, quaternion) and
``attributes``. Its axes are x forward, y right, z down, at the radar's origin.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import FARTHEST_M, check_turns, is_name
from farfield.files.json_text import concatenated_json, plain_json
from farfield.files.limits import check_name

MAX_LABEL_BYTES = 1 << 24  # a label file has about 20 kB
MAX_POSE_BYTES = 1 << 16  # a pose file has about 900 bytes
_POSE_NAMES = {"odomToCamera": "odom", "mapToCamera": "map", "UTMToCamera": "utm"}


@dataclass(frozen=True, eq=False, kw_only=True)
class DelftObjects:
    """Objects of a JSON label file as they stand there, one row an object.

    Args:
        class_name: ``car``, ``pedestrian``, ``bicycle``..., n names.
        object_id: Identity over time, n names.
        centre_m: Centres: x forward, y right, z down from the radar, shape (n, 3).
        size_m: Length, width, height, shape (n, 3).
        quaternion_xyzw: Turn of the box in these axes, shape (n, 4), of unit length.
        attributes: ``activity``, ``has_rider``, ``spatial occlusion``... of each object.
    """

    class_name: tuple[str, ...]
    object_id: tuple[str, ...]
    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    quaternion_xyzw: Float[np.ndarray, "n 4"]
    attributes: tuple[Mapping[str, Any], ...]

    def __len__(self) -> int:
        return len(self.class_name)


def read_camera_poses(path: Path | str) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Read the poses of the camera: ``odom``, ``map`` and ``utm`` to the matrix that maps camera coordinates there.

    Raises:
        FileFormatError: If the file holds anything but such objects, or a matrix is no rigid motion.
    """
    poses: dict[str, np.ndarray] = {}
    try:
        entries = tuple(concatenated_json(_text(path, MAX_POSE_BYTES)))
    except ValueError as error:
        raise _wrong(path, "the file", "JSON objects", plain(error)) from error
    for position, entry in entries:
        if not isinstance(entry, dict) or not set(entry) <= set(_POSE_NAMES):
            raise _wrong(path, f"character {position}", f"objects of {', '.join(_POSE_NAMES)}", repr(entry))
        twice = next((name for name in entry if _POSE_NAMES[name] in poses), None)
        if twice is not None:
            raise _wrong(path, twice, "each pose once", "a second one")
        poses |= {_POSE_NAMES[name]: _motion(path, name, values) for name, values in entry.items()}
    if not poses:
        raise _wrong(path, "the file", f"objects of {', '.join(_POSE_NAMES)}", "an empty file")
    return poses


def read_objects(path: Path | str) -> DelftObjects:
    """Read a JSON label file; an empty list is a frame without objects.

    Raises:
        FileFormatError: If it is no such list, or a size, centre or quaternion is missing or no use.
    """
    try:
        entries = plain_json(_text(path, MAX_LABEL_BYTES))
    except ValueError as error:
        raise _wrong(path, "the file", "a JSON list of objects", plain(error)) from error
    if not isinstance(entries, list):
        raise _wrong(path, "the file", "a JSON list of objects", type(entries).__name__)
    rows = [_object(path, number, entry) for number, entry in enumerate(entries)]
    numbers = np.array([row[2] for row in rows], dtype=np.float64).reshape(len(rows), 10)
    check_turns(numbers[:, 6:], path, "object {}")
    return DelftObjects(
        class_name=tuple(row[0] for row in rows),
        object_id=tuple(row[1] for row in rows),
        centre_m=numbers[:, :3],
        size_m=numbers[:, 3:6],
        quaternion_xyzw=numbers[:, 6:] / np.linalg.norm(numbers[:, 6:], axis=1, keepdims=True),
        attributes=tuple(row[3] for row in rows),
    )


def _object(path: Path | str, number: int, entry: Any) -> tuple[str, str, list[float], Mapping[str, Any]]:
    where = f"object {number}"
    try:
        geometry = entry["geometry"]
        groups = (("center", "xyz"), ("size", ("length", "width", "height")), ("quaternion", "xyzw"))
        raw = [geometry[group][key] for group, keys in groups for key in keys]
        name, identity, attributes = entry["className"], entry.get("objectId", ""), entry.get("attributes", {})
    except (KeyError, TypeError, AttributeError) as error:
        expected = "className and geometry with center, size and quaternion"
        raise _wrong(path, where, expected, plain(error)) from error
    if not (isinstance(name, str) and isinstance(identity, str) and isinstance(attributes, dict)):
        raise _wrong(path, where, "texts for className and objectId, an object for attributes", repr(entry))
    flag, activity = attributes.get("has_rider"), attributes.get("activity")
    if not is_name(name) or not (flag is None or isinstance(flag, bool)) or not isinstance(activity, str | None):
        expected = "a className, true or false as has_rider, a text as activity"
        raise _wrong(path, where, expected, repr([name, flag, activity]))
    for text in (name, identity, activity or ""):
        check_name(path, where, text)
    values = _numbers(path, where, raw, 10)
    if not (values[3:6] > 0).all() or not (np.abs(values[:3]) <= FARTHEST_M).all():
        raise _wrong(path, where, f"positive sizes, a centre within {FARTHEST_M:g} m", str(values[:6].tolist()))
    return name, identity, values.tolist(), attributes


def _motion(path: Path | str, name: str, values: Any) -> Float[np.ndarray, "4 4"]:
    matrix = _numbers(path, name, values, 16).reshape(4, 4)
    turn = matrix[:3, :3]
    rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
    if not rigid or not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise _wrong(path, name, "a rotation, a translation and a last row 0 0 0 1", str(matrix.tolist()))
    return matrix


def _numbers(path: Path | str, where: str, values: Any, count: int) -> Float[np.ndarray, " n"]:
    good = isinstance(values, list) and len(values) == count
    if not good or not all(type(value) in (int, float) and abs(value) <= 1e9 for value in values):
        raise _wrong(path, where, f"{count} numbers within 1e9", repr(values))
    return np.array(values, dtype=np.float64)


def _text(path: Path | str, max_bytes: int) -> str:
    try:
        return read_bytes(path, max_bytes=max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _wrong(
            path, f"byte {error.start}", "UTF-8 text", repr(error.object[error.start : error.start + 8])
        ) from None


def _wrong(path: Path | str, where: str, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=where, expected=expected, got=actual[:120])
