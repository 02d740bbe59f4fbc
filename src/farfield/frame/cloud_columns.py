"""Columns of a cloud's file under our names, and the rows among them that are points."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Num, Shaped

from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.limits import check_numbers
from farfield.files.map_coordinates import NEAREST_M, beyond_any_sensor

Columns = Mapping[str, Shaped[np.ndarray, "..."]]
RowNames = Mapping[int, tuple[str, ...]] | tuple[str, ...] | None
_FARTHEST_M = 1e7  # coordinates of maps (UTM, ECEF) end before
_MOST_NAMES, _NAME = 64, re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")

INTENSITY_NAMES = ("intensity", "intensities", "i", "reflectivity", "reflectance", "remission", "signal")
"""Names of the column that becomes the intensity, in lower case; the first that a cloud has is taken."""


def named_columns(
    path: Path | str,
    columns: Columns | Shaped[np.ndarray, "n c"],
    row_names: RowNames = None,
) -> dict[str, Shaped[np.ndarray, " n"]]:
    """Columns of a cloud under our names: ``X`` is x, ``reflectivity`` is the intensity, ``rgb`` of three rgb_0 to 2.

    Args:
        path: The file, for messages.
        columns: By the file's names, each of shape (n,), or (n, count) where a point has several numbers; or rows.
        row_names: Names of the columns of rows, by how many they are, or those of all; None decides by the rows.

    Raises:
        FileFormatError: If a place or the intensity holds several numbers for each point, or rows have not as many
            columns as are named.
    """
    from farfield.files.clouds import names_of

    if isinstance(columns, np.ndarray):
        if not isinstance(row_names, tuple):
            names = (row_names or {}).get(columns.shape[1]) or names_of(points_of(path, columns))
            return dict(zip(names, columns.T, strict=True))
        if len(row_names) != columns.shape[1]:
            expected = f"{len(row_names)} columns, as --columns names them ({', '.join(row_names)})"
            raise FileFormatError(path, where="its rows", expected=expected, got=f"{columns.shape[1]}")
        columns = dict(zip(row_names, columns.T, strict=True))
    lower = {name.lower(): name for name in reversed(list(columns))} | {
        name: name for name in columns if name.islower()
    }
    ours = {lower[axis]: axis for axis in "xyz" if axis in lower}
    strength = next((lower[name] for name in INTENSITY_NAMES if name in lower), None)
    if strength is not None:
        ours[strength] = "intensity"
    check_numbers(path, "the fields", sum(math.prod(values.shape[1:]) for values in columns.values()))
    split: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        own_name = ours.get(name, name)
        if values.ndim == 1:
            split[own_name] = values
        elif own_name in ("x", "y", "z", "intensity"):
            raise FileFormatError(
                path,
                where=f"field {name}",
                expected="one number a point (COUNT 1)",
                got=f"{values.shape[1:]} numbers",
                fix="Write one of them as the field; the others as fields of their own.",
            )
        else:
            rows = values.reshape(len(values), math.prod(values.shape[1:]))
            parts = {f"{name}_{element}": np.ascontiguousarray(column) for element, column in enumerate(rows.T)}
            double = next((part for part in parts if part in columns), None)
            if double is not None:
                actual = f"field {double} and {rows.shape[1]} numbers of {name}"
                raise FileFormatError(path, where=f"field {name}", expected="names that differ", got=actual)
            split |= parts
    return split


def points_of(path: Path | str, rows: Shaped[np.ndarray, "n c"]) -> Shaped[np.ndarray, "m c"]:
    """The rows that are points: see :func:`returned`."""
    valid = returned(path, rows[:, :3])
    return rows if valid.all() else rows[valid]


def returned(path: Path | str, points_m: Num[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Which rows of a cloud are points: where nothing returned, sensors write NaN or 0, 0, 0, shape (n,).

    Args:
        path: The file, for messages.
        points_m: x, y, z in the sensor's own coordinates, before they are moved anywhere.

    Raises:
        DatasetError: If a coordinate is infinite or farther than any map's, or all points lie beyond 10 km.
    """
    number_type = np.result_type(points_m.dtype, np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = (np.abs(points_m[:, axis].astype(number_type, copy=False)) for axis in range(3))
        extent = x + y + z  # 0, or NaN, where nothing returned
        impossible = extent > 3 * _FARTHEST_M
    if impossible.any():
        row = int(np.argmax(impossible))
        got = f"{points_m[row].tolist()} in point {row}: of another number type, order of bytes or number of columns?"
        raise DatasetError(f"{path}: expected finite coordinates within 10,000 km, got {got}")
    valid: Bool[np.ndarray, " n"] = extent > 0
    if extent.min(initial=np.inf, where=valid) > NEAREST_M and (away_m := beyond_any_sensor(points_m)):
        raise DatasetError(
            f"{path}: expected metres from the sensor, got points of which the nearest lies {away_m:.4g} away: "
            "coordinates of a map (UTM, ECEF)? Subtract where the sensor stood, in float64."
        )
    return valid


def checked_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names that a user gives the columns of files without any.

    Raises:
        ConfigError: If one is no name or stands twice, or x, y or z is missing.
    """
    lower = [name.lower() for name in names]
    odd = next((name for name in names if not _NAME.fullmatch(name) or lower.count(name.lower()) > 1), None)
    if odd is not None or not {"x", "y", "z"} <= set(lower) or len(names) > _MOST_NAMES:
        fault = "" if odd is None else f", of which {odd!r} is no name or stands twice"
        raise ConfigError(f"columns: expected names such as x,y,z,intensity,time; got {','.join(names)}{fault}")
    return tuple(names)
