"""Boreas' files: annotated boxes and the LiDAR's poses (Burnett et al., IJRR 2023; format: the authors' documentation).

A label file is named by the sweep's time in microseconds since 1970; a line an object: uuid of the track, class,
length, width, height, x, y, z, yaw, number of points, in the LiDAR's frame, whose x points forward.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import FARTHEST_M, check_yaw, is_name

_LARGEST = 1e9
_CELLS = 10
_POSE_COLUMNS = 13


@dataclass(frozen=True, eq=False, kw_only=True)
class BoreasObjects:
    """Annotated objects of one sweep.

    Args:
        uuid: Identity of each object's track, n names.
        label: Class of each, such as ``Car``.
        size_m: Length, width, height, shape (n, 3).
        centre_m: Middle of each box in the LiDAR's frame, shape (n, 3).
        yaw_rad: Headings, shape (n,).
        point_count: Points in each box, shape (n,).
    """

    uuid: tuple[str, ...]
    label: tuple[str, ...]
    size_m: Float[np.ndarray, "n 3"]
    centre_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    point_count: Int[np.ndarray, " n"]


def read_boreas_objects(path: Path | str) -> BoreasObjects:
    """Read the annotated objects of one sweep.

    Raises:
        FileFormatError: If a line has another form.
    """
    names: dict[str, str] = {}
    rows = []
    for number, line in enumerate(_text(path).splitlines(), start=1):
        fields = line.split()
        if not fields:
            continue
        values = _numbers(fields[2:]) if len(fields) == _CELLS else None
        counted = values is not None and values[7] == int(values[7]) >= 0
        if (
            values is None
            or not counted
            or min(values[:3]) <= 0
            or max(map(abs, values[3:6])) > FARTHEST_M
            or not (is_name(fields[0]) and is_name(fields[1]))
        ):
            expected = "uuid, class, positive length width height, x y z, yaw, number of points"
            raise FileFormatError(path, where=f"line {number}", expected=expected, got=line[:100])
        if fields[0] in names:
            raise FileFormatError(path, where=f"line {number}", expected="each uuid once", got=fields[0][:100])
        check_yaw(values[6], path, f"line {number}")
        names[fields[0]] = fields[1]
        rows.append(values)
    table = np.array(rows, dtype=np.float64).reshape(-1, _CELLS - 2)
    return BoreasObjects(
        uuid=tuple(names),
        label=tuple(names.values()),
        size_m=table[:, :3],
        centre_m=table[:, 3:6],
        yaw_rad=table[:, 6],
        point_count=table[:, 7].astype(np.int64),
    )


def read_boreas_poses(path: Path | str) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
    """Read the LiDAR's poses: times in nanoseconds, and world_T_lidar with x east, y north, z up.

    Raises:
        FileFormatError: If a line has another form.
    """
    times, rows = [], []
    for number, line in enumerate(_text(path).splitlines()[1:], start=2):
        cells = line.split(",")
        values = _numbers(cells[1:]) if len(cells) == _POSE_COLUMNS else None
        if values is None or not (cells[0].isdigit() and len(cells[0]) <= 16):
            expected = "microseconds, easting, northing, altitude, three velocities, roll, pitch, heading, three rates"
            raise FileFormatError(path, where=f"line {number}", expected=expected, got=line[:100])
        times.append(int(cells[0]) * 1000)
        rows.append(values)
    table = np.array(rows, dtype=np.float64).reshape(-1, _POSE_COLUMNS - 1)
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, :3] = _about(0, table[:, 6]) @ _about(1, table[:, 7]) @ _about(2, table[:, 8])
    poses[:, :3, 3] = table[:, :3]
    return np.array(times, dtype=np.int64), poses


def _about(axis: int, angle_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """Rotations of the axes about one of them: the transposes of those of points."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out = np.tile(np.eye(3), (len(angle_rad), 1, 1))
    out[:, a, a] = out[:, b, b] = np.cos(angle_rad)
    out[:, a, b], out[:, b, a] = np.sin(angle_rad), -np.sin(angle_rad)
    return out


def _text(path: Path | str) -> str:
    data = read_bytes(path)
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        actual = f"byte 0x{data[error.start]:02x}"
        raise FileFormatError(path, where=f"byte {error.start}", expected="ASCII text", got=actual) from None


def _numbers(fields: list[str]) -> list[float] | None:
    try:
        values = [] if "_" in "".join(fields) else [float(word) for word in fields]
    except ValueError:
        return None
    return values if values and all(abs(value) < _LARGEST for value in values) else None
