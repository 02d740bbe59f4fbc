"""Columns of a bag's clouds into ours: intensity in [0, 1], the moment of each point, the rest by its own name."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Int64, Shaped

from farfield.errors import ConfigError, FileFormatError
from farfield.files.bags import Bag, guarded
from farfield.files.point_cloud2 import read_points
from farfield.frame import Cloud

INTENSITY = ("intensity", "i", "reflectivity", "signal")
TIMES = ("t", "time", "timestamp", "time_stamp", "offset_time", "timeOffset", "time_offset", "point_time_offset")
RADAR = ("doppler", "velocity", "range_rate", "radial_speed", "rcs", "power", "snr", "v_r")
_FULL = {"u1": 255.0, "u2": 65535.0}

Columns = dict[str, Shaped[np.ndarray, " n"]]


def is_radar(names: Any) -> bool:
    """Whether a cloud's columns are a radar's: a speed or a cross-section."""
    return any(word in str(name).lower() for name in names for word in RADAR)


def intensity_limit(columns: Columns) -> float | None:
    """The value that is taken as 1: all that an integer holds, else the least of 1, 255, 65,535 above what is seen."""
    name = next((name for name in INTENSITY if name in columns), None)
    if name is None:
        return None
    kind = columns[name].dtype.str[1:]
    seen = float(np.nanmax(columns[name], initial=0))
    return _FULL.get(kind) or next((limit for limit in (1.0, 255.0, 65535.0) if seen <= limit), None)


def load_cloud(
    bag: Bag,
    topic: str,
    log_ns: int,
    place: int,
    *,
    limit: float | None,
    target_T_sensor: np.ndarray | None = None,
) -> Cloud:
    """Read one cloud of a bag; points that are not finite ("no return") are left out.

    Args:
        bag: The bag.
        topic: The cloud's topic.
        log_ns: When it was recorded.
        place: Which of those recorded then.
        limit: Intensity that is taken as 1; None leaves the column as it is among the others.
        target_T_sensor: Moves the points into other coordinates.
    """
    message = bag.at(topic, log_ns, place)
    columns = read_points(message, bag.path)
    cloud = cloud_of(columns, bag.path, limit=limit, stamp_ns=_stamp(message, bag.path))
    return cloud if target_T_sensor is None else cloud.transform(target_T_sensor)


def _stamp(message: Any, path: Path) -> int:
    with guarded(path, "a cloud's header"):
        return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def cloud_of(columns: Columns, path: Path | str, *, limit: float | None, stamp_ns: int) -> Cloud:
    """A cloud of the columns of a message.

    Raises:
        FileFormatError: If there is no x, y, z.
        ConfigError: If an intensity lies above what is taken as 1.
    """
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise FileFormatError(
            path, where="a point cloud", expected="fields x, y, z", found=", ".join(columns) or "none"
        )
    points = np.column_stack([columns[name] for name in "xyz"]).astype(np.float32)
    finite = np.isfinite(points).all(axis=1)
    rest = {name: values[finite] for name, values in columns.items() if name not in "xyz"}
    times = next((name for name in TIMES if name in rest), None)
    if times is not None:
        rest["offset_ns"] = offsets_ns(rest.pop(times), stamp_ns)
    name = next((name for name in INTENSITY if name in rest), None)
    strength = None if name is None or limit is None else _scaled(rest.pop(name), limit, path)
    return Cloud(points[finite], strength, rest)


def _scaled(values: Shaped[np.ndarray, " n"], limit: float, path: Path | str) -> Float32[np.ndarray, " n"]:
    scaled = (values / limit).astype(np.float32)
    if not ((scaled >= 0) & (scaled <= 1)).all():
        raise ConfigError(
            f"{path}: expected intensities from 0 to {limit:g}, taken from the first cloud; got {np.nanmin(values):g} "
            f"to {np.nanmax(values):g}. Say what is full strength: intensity_max=."
        )
    return scaled


def offsets_ns(values: Shaped[np.ndarray, " n"], stamp_ns: int) -> Int64[np.ndarray, " n"]:
    """How long after the cloud's stamp each point was measured, in nanoseconds.

    Integers are nanoseconds, since the stamp or since 1970; floating point is seconds, likewise, or from 1e17 on
    nanoseconds since 1970 (Ouster, Velodyne, Hesai and Livox drivers).
    """
    if values.dtype.kind in "iu":
        whole = values.astype(np.int64)
        return np.asarray(whole - stamp_ns if len(whole) and whole.max() > 10**17 else whole)
    size = float(np.abs(values).max(initial=0))
    if size >= 1e17:
        return np.rint(values - float(stamp_ns)).astype(np.int64)
    if size >= 1e8:
        whole_s = stamp_ns // 1_000_000_000
        return np.rint((values - whole_s) * 1e9).astype(np.int64) - stamp_ns % 1_000_000_000
    return np.rint(values.astype(np.float64) * 1e9).astype(np.int64)
