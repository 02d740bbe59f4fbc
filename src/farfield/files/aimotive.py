"""JSON files of aiMotive's multimodal data set (Matuszka et al., ICLR workshop 2023): boxes, radar targets, sensors.

Boxes are centres with full sizes and quaternions in the body's coordinates (x forward, y left, z up), under keys with
blanks; a text tells their time in nanoseconds. A radar's targets are angles, range and radial speed in its own
coordinates. What each key means was found on the files themselves, of which one drive is public
(https://github.com/aimotive/aimotive-dataset-loader, its data alone).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import FileFormatError
from farfield.files.cuboids import FARTHEST_M, check_turns, is_name, numbers
from farfield.files.json_text import read_json
from farfield.files.limits import MAX_NAME

RADAR_COLUMNS = ("azimuth", "elevation", "range", "speed", "rcs", "power", "noise")
PINHOLE = "opencv_pinhole"
_JSON_BYTES = 64 << 20
_FARTHEST_SENSOR_M = 100.0
_MOST_SPEED_M_S, _LARGEST_M, _UNIT, _INVERSE = 300.0, 1000.0, 1e-2, 1e-3
_BOX = "BoundingBox3D"


@dataclass(frozen=True, kw_only=True)
class AimotiveBoxes:
    """The annotated boxes of a frame.

    Args:
        time_ns: Of the frame, by the car's own clock.
        name: Class of each.
        track_id: Identity of each.
        centre_m: Shape (n, 3), in the body's coordinates.
        size_m: Length, width, height, shape (n, 3).
        quaternion_xyzw: Shape (n, 4).
        velocity_m_s: Relative to the car, shape (n, 3).
        occluded: As the file has it, shape (n,).
        truncated: As the file has it, shape (n,).
    """

    time_ns: int
    name: tuple[str, ...]
    track_id: Int64[np.ndarray, " n"]
    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    quaternion_xyzw: Float[np.ndarray, "n 4"]
    velocity_m_s: Float[np.ndarray, "n 3"]
    occluded: Int64[np.ndarray, " n"]
    truncated: Int64[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class AimotiveSensor:
    """One sensor of the calibration.

    Args:
        kind: ``"camera"``, ``"lidar"``, ``"radar"`` or another.
        body_T_sensor: Its pose.
        model: A camera's lens: :data:`PINHOLE`, ``"mei"``... ; empty for others.
        focal_px: A camera's focal lengths.
        centre_px: Its principal point.
        distortion: k1, k2, p1, p2, k3.
        size_px: Width and height of its images.
    """

    kind: str
    body_T_sensor: Float[np.ndarray, "4 4"]
    model: str = ""
    focal_px: tuple[float, float] = (0.0, 0.0)
    centre_px: tuple[float, float] = (0.0, 0.0)
    distortion: tuple[float, ...] = ()
    size_px: tuple[int, int] = (0, 0)


def read_boxes(path: Path | str) -> AimotiveBoxes:
    """The boxes of a frame.

    Raises:
        FileFormatError: If the file holds anything else, or a box cannot be.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    entries = content.get("CapturedObjects") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FileFormatError(path, where="CapturedObjects", expected="a list of objects", got=repr(entries)[:80])
    rows = [_row(entry, path, f"CapturedObjects[{number}]") for number, entry in enumerate(entries)]
    names = tuple(_name(entry, path, f"CapturedObjects[{number}]") for number, entry in enumerate(entries))
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 13)
    whole = [_whole(entry, path, f"CapturedObjects[{number}]") for number, entry in enumerate(entries)]
    track_id, occluded, truncated = np.array(whole, dtype=np.int64).reshape(len(rows), 3).T
    if len(np.unique(track_id)) < len(track_id):
        expected, actual = "each ObjectId once", str(track_id.tolist())[:80]
        raise FileFormatError(path, where="CapturedObjects", expected=expected, got=actual)
    check_turns(table[:, 6:10], path, "CapturedObjects[{}]")
    return AimotiveBoxes(
        time_ns=read_time(content, path),
        name=names,
        track_id=track_id,
        centre_m=table[:, :3],
        size_m=table[:, 3:6],
        quaternion_xyzw=table[:, 6:10],
        velocity_m_s=table[:, 10:],
        occluded=occluded,
        truncated=truncated,
    )


def read_time(content: Any, path: Path | str) -> int:
    """The time of a file of boxes, nanoseconds of the car's clock.

    Raises:
        FileFormatError: If there is none.
    """
    text = content.get("Timestamp") if isinstance(content, dict) else None
    if not isinstance(text, str) or not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise FileFormatError(path, where="Timestamp", expected="a text of nanoseconds", got=repr(text)[:80])
    return int(text)


def _row(entry: Mapping[str, Any], path: Path | str, where: str) -> list[float]:
    """Centre, size, quaternion x y z w and velocity."""
    keys = [f"{_BOX} {part} {axis}" for part in ("Origin", "Extent") for axis in "XYZ"]
    keys += [f"{_BOX} Orientation Quat {axis}" for axis in "XYZW"] + [f"Relative Velocity {axis}" for axis in "XYZ"]
    row = numbers([entry.get(key) for key in keys], len(keys), path, where, ", ".join(keys)[:60] + "...")
    sizes, speeds = row[3:6], row[10:]
    if max(map(abs, row[:3])) > FARTHEST_M or not all(0 < size <= _LARGEST_M for size in sizes):
        expected = f"a centre within {FARTHEST_M:g} m and sizes from 0 to {_LARGEST_M:g} m"
        raise FileFormatError(path, where=where, expected=expected, got=repr(row[:6])[:120])
    if abs(np.linalg.norm(row[6:10]) - 1) > _UNIT or max(map(abs, speeds)) > _MOST_SPEED_M_S:
        expected = f"a unit quaternion and a velocity within {_MOST_SPEED_M_S:g} m/s"
        raise FileFormatError(path, where=where, expected=expected, got=repr(row[6:])[:120])
    return row


def _name(entry: Mapping[str, Any], path: Path | str, where: str) -> str:
    name = entry.get("ObjectType")
    if not is_name(name) or len(str(name)) > MAX_NAME:
        raise FileFormatError(path, where=where, expected="an ObjectType", got=repr(name)[:80])
    return str(name)


def _whole(entry: Mapping[str, Any], path: Path | str, where: str) -> list[int]:
    values = [entry.get(key) for key in ("ObjectId", "Occluded", "Truncated")]
    if not all(type(value) is int and 0 <= value < 1 << 53 for value in values):
        expected = "whole ObjectId, Occluded and Truncated"
        raise FileFormatError(path, where=where, expected=expected, got=repr(values)[:80])
    return [int(value) for value in values if value is not None]


def read_targets(path: Path | str) -> Float[np.ndarray, "n 7"]:
    """A radar's targets, the columns those of :data:`RADAR_COLUMNS`: radians, metres, m/s, and dB for power and noise.

    The speed is relative to the car, positive where a target goes away. The unit of ``rcs`` is not published: it is
    never negative, so that it may be square metres.

    Raises:
        FileFormatError: If the file holds anything else, or an angle, range or speed cannot be.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    entries = content.get("targets") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FileFormatError(path, where="targets", expected="a list of objects", got=repr(entries)[:80])
    rows = [
        numbers([entry.get(key) for key in RADAR_COLUMNS], 7, path, f"targets[{number}]", ", ".join(RADAR_COLUMNS))
        for number, entry in enumerate(entries)
    ]
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 7)
    legal = (np.abs(table[:, :2]) <= [np.pi, np.pi / 2]).all(axis=1) & (table[:, 2] > 0) & (table[:, 2] <= FARTHEST_M)
    legal &= (np.abs(table[:, 3]) <= _MOST_SPEED_M_S) & (table[:, 4] >= 0)
    if not legal.all():
        row = int(np.argmin(legal))
        expected = "azimuth and elevation in radians, a range above 0, a speed within 300 m/s, rcs of 0 or more"
        actual = repr(dict(zip(RADAR_COLUMNS, table[row].tolist(), strict=True)))[:160]
        raise FileFormatError(path, where=f"targets[{row}]", expected=expected, got=actual)
    return table


def read_sensors(path: Path | str) -> dict[str, AimotiveSensor]:
    """The sensors of ``calibration.json`` that have a pose, by name.

    Raises:
        FileFormatError: If a pose is no rigid motion, is not what its inverse says, or a camera lacks its lens.
    """
    content = read_json(path, max_bytes=_JSON_BYTES, nan=True)
    if not isinstance(content, dict) or not all(isinstance(entry, dict) for entry in content.values()):
        raise FileFormatError(path, where="the file", expected="an object a sensor", got=repr(content)[:80])
    sensors = {}
    for name, entry in content.items():
        if "RT_body_from_sensor" in entry:
            if not is_name(name) or len(name) > MAX_NAME:
                raise FileFormatError(path, where="the names", expected="a name a sensor", got=repr(name)[:80])
            sensors[name] = _sensor(entry, path, name)
    return sensors


def _sensor(entry: Mapping[str, Any], path: Path | str, where: str) -> AimotiveSensor:
    pose = _motion(entry.get("RT_body_from_sensor"), path, f"{where}, RT_body_from_sensor")
    kind = entry.get("sensor_type", "camera" if "model" in entry else "other")
    if not isinstance(kind, str):
        raise FileFormatError(path, where=where, expected="a sensor_type", got=repr(kind)[:80])
    if "RT_sensor_from_body" in entry:
        back = _motion(entry["RT_sensor_from_body"], path, f"{where}, RT_sensor_from_body")
        if not np.allclose(back @ pose, np.eye(4), atol=_INVERSE):
            expected = "RT_sensor_from_body to be the inverse of RT_body_from_sensor"
            raise FileFormatError(path, where=where, expected=expected, got="another motion")
    if kind != "camera":
        return AimotiveSensor(kind=kind, body_T_sensor=pose)
    model = entry.get("model")
    if not isinstance(model, str):
        raise FileFormatError(path, where=where, expected="a camera's model", got=repr(model)[:80])
    focal = numbers(entry.get("focal_length_px"), 2, path, where, "focal_length_px")
    centre = numbers(entry.get("principal_point_px"), 2, path, where, "principal_point_px")
    distortion = numbers(entry.get("distortion_coeffs"), 5, path, where, "distortion_coeffs")
    size = numbers(entry.get("image_resolution_px"), 2, path, where, "image_resolution_px")
    if min(focal) <= 0 or not all(side == int(side) and 0 < side < 1 << 16 for side in size):
        expected, actual = "positive focal lengths and a whole size", repr([*focal, *size])[:120]
        raise FileFormatError(path, where=where, expected=expected, got=actual)
    return AimotiveSensor(
        kind=kind,
        body_T_sensor=pose,
        model=model,
        focal_px=(focal[0], focal[1]),
        centre_px=(centre[0], centre[1]),
        distortion=tuple(distortion),
        size_px=(int(size[0]), int(size[1])),
    )


def _motion(value: Any, path: Path | str, where: str) -> Float[np.ndarray, "4 4"]:
    rows = value if isinstance(value, list) and len(value) == 4 else [None] * 4
    motion = np.array([numbers(row, 4, path, where, "four rows") for row in rows])
    turn, last = motion[:3, :3], motion[3].tolist()
    is_rigid = np.allclose(turn @ turn.T, np.eye(3), atol=_INVERSE) and np.linalg.det(turn) > 0 and last == [0, 0, 0, 1]
    if not is_rigid or np.abs(motion[:3, 3]).max() > _FARTHEST_SENSOR_M:
        expected = f"a rotation and a place within {_FARTHEST_SENSOR_M:g} m"
        raise FileFormatError(path, where=where, expected=expected, got=repr(motion.tolist())[:120])
    return motion
