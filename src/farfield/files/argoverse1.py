"""The JSON files of Argoverse 1's tracking logs (Chang et al., CVPR 2019): labels of a sweep, poses, calibration.

Source: argoverse-api, MIT, https://github.com/argoverse/argoverse-api (``pose_loader.py``, ``object_label_record.py``,
``calibration.py``). Quaternions are w, x, y, z; boxes are centres with full sizes in the ego vehicle's coordinates
(x forward, y left, z up); times are nanoseconds; pictures are undistorted before they are published.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import FileFormatError
from farfield.files.cuboids import FARTHEST_M, check_turns, is_name, numbers, xyz
from farfield.files.json_text import read_json
from farfield.files.limits import MAX_NAME

_JSON_BYTES = 64 << 20
_LARGEST_M, _UNIT, _FARTHEST_SENSOR_M = 1000.0, 1e-2, 100.0
_CAMERA = "image_raw_"


@dataclass(frozen=True, kw_only=True)
class Argoverse1Labels:
    """The labels of one sweep.

    Args:
        name: Class of each.
        track: Identity of each, a UUID.
        centre_m: Shape (n, 3).
        size_m: Length, width, height, shape (n, 3).
        quaternion_xyzw: Shape (n, 4).
        occlusion: As the file has it, shape (n,); -1 where it has none.
    """

    name: tuple[str, ...]
    track: tuple[str, ...]
    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    quaternion_xyzw: Float[np.ndarray, "n 4"]
    occlusion: Int64[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class Argoverse1Camera:
    """A camera of the calibration, whose pictures are undistorted.

    Args:
        matrix: Intrinsics, shape (3, 3), in pixels.
        quaternion_xyzw: Of its pose in the ego vehicle's coordinates.
        translation_m: Of the same.
    """

    matrix: Float[np.ndarray, "3 3"]
    quaternion_xyzw: Float[np.ndarray, " 4"]
    translation_m: Float[np.ndarray, " 3"]


def read_sweep_labels(path: Path | str, time_ns: int) -> Argoverse1Labels:
    """The labels of one sweep.

    Args:
        path: The file.
        time_ns: The sweep's time, which each label repeats.

    Raises:
        FileFormatError: If the file holds anything else, a label of another time, or a box that cannot be.
    """
    entries = read_json(path, max_bytes=_JSON_BYTES)
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FileFormatError(path, where="the file", expected="a list of labels", got=repr(entries)[:80])
    rows = [_row(entry, path, f"label {number}") for number, entry in enumerate(entries)]
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 10)
    texts = [_texts(entry, path, f"label {number}") for number, entry in enumerate(entries)]
    for number, entry in enumerate(entries):
        if entry.get("timestamp") != time_ns:
            expected, actual = f"the sweep's timestamp {time_ns}", repr(entry.get("timestamp"))[:40]
            raise FileFormatError(path, where=f"label {number}", expected=expected, got=actual)
    tracks = tuple(track for _, track in texts)
    if len(set(tracks)) < len(tracks):
        raise FileFormatError(path, where="track_label_uuid", expected="each once in a sweep", got="one twice")
    check_turns(table[:, 6:], path, "label {}")
    occlusion = [entry.get("occlusion", -1) for entry in entries]
    if not all(type(value) is int and abs(value) < 1 << 31 for value in occlusion):
        raise FileFormatError(path, where="occlusion", expected="whole numbers", got=repr(occlusion)[:80])
    return Argoverse1Labels(
        name=tuple(name for name, _ in texts),
        track=tracks,
        centre_m=table[:, :3],
        size_m=table[:, 3:6],
        quaternion_xyzw=table[:, 6:],
        occlusion=np.array(occlusion, dtype=np.int64),
    )


def _row(entry: Mapping[str, Any], path: Path | str, where: str) -> list[float]:
    """Centre, size and quaternion x, y, z, w."""
    centre = xyz(entry.get("center"), path, where, "center")
    size = numbers([entry.get(key) for key in ("length", "width", "height")], 3, path, where, "length, width, height")
    turn = entry.get("rotation")
    quaternion = numbers(
        [turn.get(axis) for axis in "xyzw"] if isinstance(turn, Mapping) else None, 4, path, where, "rotation x y z w"
    )
    sound = max(map(abs, centre)) <= FARTHEST_M and all(0 < side <= _LARGEST_M for side in size)
    if not sound or abs(np.linalg.norm(quaternion) - 1) > _UNIT:
        expected = f"a place within {FARTHEST_M:g} m, sizes from 0 to {_LARGEST_M:g} m, a unit quaternion"
        raise FileFormatError(path, where=where, expected=expected, got=repr([*centre, *size, *quaternion])[:160])
    return [*centre, *size, *quaternion]


def _texts(entry: Mapping[str, Any], path: Path | str, where: str) -> tuple[str, str]:
    name = entry.get("label_class")
    name = name.get("name") if isinstance(name, Mapping) else name
    track = entry.get("track_label_uuid")
    if not all(is_name(text) and len(str(text)) <= MAX_NAME for text in (name, track)):
        expected = "label_class and track_label_uuid"
        raise FileFormatError(path, where=where, expected=expected, got=repr([name, track])[:80])
    return str(name), str(track)


def read_ego_pose(path: Path | str) -> tuple[Float[np.ndarray, " 4"], Float[np.ndarray, " 3"]]:
    """The ego vehicle's pose in the city: quaternion x, y, z, w and translation.

    Raises:
        FileFormatError: If the file holds anything else.
    """
    return _pose(read_json(path, max_bytes=_JSON_BYTES), path, "the file", "rotation", FARTHEST_M)


def _pose(
    content: Any, path: Path | str, where: str, key: str, farthest_m: float
) -> tuple[Float[np.ndarray, " 4"], Float[np.ndarray, " 3"]]:
    turn = content.get("rotation") if isinstance(content, Mapping) else None
    turn = turn.get(key) if key != "rotation" and isinstance(turn, Mapping) else turn
    offset = content.get("translation") if isinstance(content, Mapping) else None
    w, x, y, z = numbers(turn, 4, path, where, "a rotation w, x, y, z")
    translation = numbers(offset, 3, path, where, "a translation")
    if abs(np.linalg.norm([w, x, y, z]) - 1) > _UNIT or max(map(abs, translation)) > farthest_m:
        expected = f"a unit quaternion and a place within {farthest_m:g} m"
        raise FileFormatError(path, where=where, expected=expected, got=repr([w, x, y, z, *translation])[:120])
    return np.array([x, y, z, w]), np.array(translation)


def read_vehicle_calibration(path: Path | str) -> dict[str, Argoverse1Camera]:
    """The cameras of a log by name, such as ``ring_front_center``.

    Raises:
        FileFormatError: If the file holds anything else, or a camera has a skew.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    entries = content.get("camera_data_") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FileFormatError(path, where="camera_data_", expected="a list of cameras", got=repr(entries)[:80])
    cameras: dict[str, Argoverse1Camera] = {}
    for number, entry in enumerate(entries):
        key, value, where = entry.get("key"), entry.get("value"), f"camera_data_[{number}]"
        name = key.removeprefix(_CAMERA) if isinstance(key, str) else None
        if not isinstance(value, Mapping) or not is_name(name) or len(str(name)) > MAX_NAME or name in cameras:
            expected = f"a key {_CAMERA}NAME, each once, and a value"
            raise FileFormatError(path, where=where, expected=expected, got=repr(key)[:80])
        names = [f"focal_length_{axis}_px_" for axis in "xy"] + [f"focal_center_{axis}_px_" for axis in "xy"]
        lens = numbers([value.get(word) for word in (*names, "skew_")], 5, path, where, ", ".join(names))
        fx, fy, cx, cy, skew = lens
        if min(fx, fy) <= 0 or skew:
            raise FileFormatError(path, where=where, expected="focal lengths above 0, no skew", got=repr(lens))
        pose = _pose(value.get("vehicle_SE3_camera_"), path, where, "coefficients", _FARTHEST_SENSOR_M)
        cameras[str(name)] = Argoverse1Camera(
            matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
            quaternion_xyzw=pose[0],
            translation_m=pose[1],
        )
    return cameras
