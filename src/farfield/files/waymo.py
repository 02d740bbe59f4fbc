"""The components of the Waymo Open Dataset v2: Parquet tables whose columns are named after classes and their fields.

Names and meanings after ``waymo_open_dataset/v2`` (https://github.com/waymo-research/waymo-open-dataset, Apache-2.0).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int64, Shaped

from farfield.errors import FileFormatError
from farfield.files.cuboids import is_name
from farfield.files.limits import MAX_NAME
from farfield.files.parquet import read_columns, read_rows

STAMP, LASER, CAMERA, OBJECT = (
    f"key.{name}" for name in ("frame_timestamp_micros", "laser_name", "camera_name", "laser_object_id")
)
_EPOCH_US = (10**15, 4 * 10**15)  # 2001 to 2096
_MOST_PIXELS, _MOST_ROWS = 4_000_000, 1024


@dataclass(frozen=True)
class RangeImage:
    """Two returns of a LiDAR's turn, or its pixels' poses.

    Args:
        returns: Shape (H, W, channels) each; None where a row has none.
    """

    returns: tuple[Float[np.ndarray, "h w c"] | None, ...]


def numbers_of(path: Path, column: Any, name: str, *, kinds: str = "iuf") -> Shaped[np.ndarray, " n"]:
    """A column of numbers without holes.

    Raises:
        FileFormatError: If it holds anything else.
    """
    values = np.zeros(0)
    sound = column.null_count == 0
    if sound:
        values = column.to_numpy(zero_copy_only=False)
    if not sound or values.dtype.kind not in kinds:
        got = f"{column.null_count} holes" if not sound else str(column.type)[:80]
        raise FileFormatError(path, where=f"column {name}", expected="numbers", got=got)
    return values


def texts_of(path: Path, column: Any, name: str, *, empty: bool = False) -> list[str]:
    """A column of names.

    Raises:
        FileFormatError: If it holds anything else.
    """
    if column.null_count:
        raise FileFormatError(path, where=f"column {name}", expected="texts", got=f"{column.null_count} holes")
    kinds = getattr(column, "dictionary", column).to_pylist()
    sound = [
        isinstance(text, str) and len(text) <= MAX_NAME and (is_name(text) or (empty and not text)) for text in kinds
    ]
    if not all(sound):
        raise FileFormatError(path, where=f"column {name}", expected="names", got=repr(kinds[sound.index(False)])[:80])
    if kinds is not None and hasattr(column, "indices"):
        return [kinds[index] for index in column.indices.to_numpy(zero_copy_only=False).tolist()]
    return kinds


def stamps_of(path: Path, column: Any) -> Int64[np.ndarray, " n"]:
    """Stamps of frames in microseconds since 1970.

    Raises:
        FileFormatError: If a number is none.
    """
    stamps = numbers_of(path, column, STAMP, kinds="i")
    odd = (stamps < _EPOCH_US[0]) | (stamps > _EPOCH_US[1])
    if odd.any():
        got = f"{stamps[odd][0]}"
        raise FileFormatError(path, where=f"column {STAMP}", expected="microseconds since 1970", got=got)
    return stamps.astype(np.int64)


def _flat(path: Path, column: Any, name: str) -> tuple[Shaped[np.ndarray, " m"], Int64[np.ndarray, " n"]]:
    """The numbers of lists one behind another, and how many each list has; a hole has none."""
    import pyarrow

    kind = column.type
    lists = pyarrow.types.is_list(kind) or pyarrow.types.is_fixed_size_list(kind) or pyarrow.types.is_large_list(kind)
    if not lists or not (pyarrow.types.is_floating(kind.value_type) or pyarrow.types.is_integer(kind.value_type)):
        raise FileFormatError(path, where=f"column {name}", expected="lists of numbers", got=str(kind)[:80])
    if pyarrow.types.is_fixed_size_list(kind):
        column = column.cast(pyarrow.list_(kind.value_type))
    counts = np.diff(column.offsets.to_numpy(zero_copy_only=False)).astype(np.int64)
    counts[column.is_null().to_numpy(zero_copy_only=False)] = 0
    flat = column.flatten()
    if flat.null_count or counts.sum() != len(flat):
        raise FileFormatError(path, where=f"column {name}", expected="numbers", got="holes in a list")
    return flat.to_numpy(zero_copy_only=False), counts


def poses_of(path: Path, column: Any, name: str) -> Float[np.ndarray, "n 4 4"]:
    """A column of matrices, 16 numbers each.

    Raises:
        FileFormatError: If one has another number of numbers, or some that are not finite.
    """
    flat, counts = _flat(path, column, name)
    if (counts != 16).any() or not np.isfinite(flat).all():
        raise FileFormatError(path, where=f"column {name}", expected="16 finite numbers a row", got="others")
    return flat.astype(np.float64).reshape(-1, 4, 4)


def list_of(path: Path, column: Any, name: str, row: int) -> Float[np.ndarray, " n"] | None:
    """The numbers of one row's list; None where it has none.

    Raises:
        FileFormatError: If it holds anything else.
    """
    if column.is_null()[row].as_py():
        return None
    return _flat(path, column.slice(row, 1), name)[0].astype(np.float64)


def read_image_rows(
    path: Path, component: str, fields: Sequence[str], rows: Sequence[int], channels: int
) -> list[RangeImage]:
    """Range images of some rows of a table.

    Args:
        path: The file.
        component: The class in its columns' names, such as ``"LiDARComponent"``.
        fields: The images, such as ``"range_image_return1"``.
        rows: Numbers of the rows, rising.
        channels: Numbers of a pixel.

    Raises:
        FileFormatError: If values and shape do not fit each other, or are those of no LiDAR.
    """
    columns = [f"[{component}].{field}.{part}" for field in fields for part in ("values", "shape")]
    images = []
    for held in read_rows(path, columns, rows):
        returns: list[Float[np.ndarray, "h w c"] | None] = []
        for field in fields:
            name = f"[{component}].{field}"
            shape, _ = _flat(path, held[f"{name}.shape"], f"{name}.shape")
            values, _ = _flat(path, held[f"{name}.values"], f"{name}.values")
            if not len(shape) and not len(values):
                returns.append(None)
                continue
            sides = [int(side) for side in shape] if shape.dtype.kind in "iu" else []
            fitting = len(sides) == 3 and 0 < sides[0] <= _MOST_ROWS and sides[1] > 0 and sides[2] == channels
            if not fitting or sides[0] * sides[1] > _MOST_PIXELS or len(values) != sides[0] * sides[1] * sides[2]:
                expected = f"an image of (rows, columns, {channels}) numbers"
                got = f"shape {shape.tolist()[:4]} and {len(values)} numbers"
                raise FileFormatError(path, where=f"column {name}", expected=expected, got=got)
            returns.append(values.astype(np.float32, copy=False).reshape(sides))
        images.append(RangeImage(tuple(returns)))
    return images


def inclinations_of(
    path: Path, values: Float[np.ndarray, " n"] | None, bounds: Sequence[float], rows: int
) -> Float[np.ndarray, " h"]:
    """The inclination of each row of a range image in radians, the highest row first.

    Args:
        path: The file, for messages.
        values: Those of a LiDAR whose rows are spaced unevenly, the lowest first; None where they are not given.
        bounds: The least and largest inclination, of evenly spaced rows.
        rows: Rows of the image.

    Raises:
        FileFormatError: If there are others than rows, they do not rise, or are no radians.
    """
    even = bounds[0] + (np.arange(rows) + 0.5) / rows * (bounds[1] - bounds[0])
    rising = even if values is None else values
    sound = len(rising) == rows and np.isfinite(rising).all() and (np.diff(rising) > 0).all()
    if not sound or np.abs(rising).max() > np.pi / 2:
        expected = f"{rows} rising inclinations in radians"
        raise FileFormatError(path, where="beam_inclination", expected=expected, got=f"{len(rising)}: {rising[:4]}")
    return rising[::-1]


def directions(
    inclination_rad: Float[np.ndarray, " h"], width: int, azimuth_of_x_rad: float
) -> tuple[Float[np.ndarray, " h"], Float[np.ndarray, " w"]]:
    """Inclination of each row, and azimuth of each column in the LiDAR's own coordinates, in radians.

    The first column looks backwards, and columns go clockwise; the middle one looks along the car.

    Args:
        inclination_rad: Of the rows.
        width: Columns of the image.
        azimuth_of_x_rad: Where the LiDAR's x axis points in the car's coordinates.
    """
    share = (width - np.arange(width) - 0.5) / width
    return inclination_rad, (share * 2 - 1) * np.pi - azimuth_of_x_rad


def points_of_pixels(
    range_m: Float[np.ndarray, "h w"],
    returned: Bool[np.ndarray, "h w"],
    vehicle_T_lidar: Float[np.ndarray, "4 4"],
    inclination_rad: Float[np.ndarray, " h"],
) -> Float[np.ndarray, "n 3"]:
    """Points of the pixels that returned, row by row, in the car's coordinates of their own moment.

    Args:
        range_m: The image's ranges.
        returned: Which pixels are points.
        vehicle_T_lidar: The LiDAR's place.
        inclination_rad: Of the rows.
    """
    heading = float(np.arctan2(vehicle_T_lidar[1, 0], vehicle_T_lidar[0, 0]))
    rows, columns = np.nonzero(returned)
    up, around = directions(inclination_rad, range_m.shape[1], heading)
    distance = range_m[rows, columns].astype(np.float64)
    level = distance * np.cos(up)[rows]
    local = np.column_stack(
        [level * np.cos(around)[columns], level * np.sin(around)[columns], distance * np.sin(up)[rows]]
    )
    return local @ vehicle_T_lidar[:3, :3].T + vehicle_T_lidar[:3, 3]


def moved_by_pixels(
    points_m: Float[np.ndarray, "n 3"], pixel_pose: Float[np.ndarray, "n 6"], world_T_vehicle: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "n 3"]:
    """Points in the car's coordinates of the frame's moment, from those of their own.

    Args:
        points_m: The points.
        pixel_pose: Roll, pitch, yaw in radians (about x, then y, then z) and x, y, z of the car in the world when each
            was measured.
        world_T_vehicle: The car's pose at the frame's moment.
    """
    roll, pitch, yaw, x, y, z = pixel_pose.astype(np.float64).T
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(angle), np.cos(angle)) for angle in (roll, pitch, yaw))
    px, py, pz = points_m.T
    world = np.column_stack(
        [
            cy * cp * px + (cy * sp * sr - sy * cr) * py + (cy * sp * cr + sy * sr) * pz + x,
            sy * cp * px + (sy * sp * sr + cy * cr) * py + (sy * sp * cr - cy * sr) * pz + y,
            -sp * px + cp * sr * py + cp * cr * pz + z,
        ]
    )
    return (world - world_T_vehicle[:3, 3]) @ world_T_vehicle[:3, :3]


def component_columns(
    path: Path, component: str, fields: Sequence[str], keys: Sequence[str], *, optional: Sequence[str] = ()
) -> Mapping[str, Any]:
    """Columns of a component by field, and its keys.

    Raises:
        FileFormatError: As :func:`read_columns`.
    """
    table = read_columns(
        path,
        [*keys, *(f"[{component}].{field}" for field in fields)],
        optional=[f"[{component}].{field}" for field in optional],
    )
    return {name.removeprefix(f"[{component}]."): column for name, column in table.items()}
