"""Arrays as the page takes them, ``FFP1``: a JSON header, then arrays at 8-byte boundaries, all little-endian.

Points are int16 in steps of 1/128 m where all lie within 256 m (error at most 3.9 mm, below the sensors' noise), else
in coarser steps of a power of two; a fourth int16 makes a stride of 8 bytes and holds the ring, or the age in
milliseconds. They travel as the differences from one point to the next, zigzag (0, -1, 1, -2 ... become 0, 1, 2, 3
...), column by column, first all low bytes, then all high ones: a sweep in ring order is half as large after zstd, and
packed in half the time. Other columns are bytes between ``low`` and ``high``. Fits run on the original floats, never on
these.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int16, Shaped, UInt8

from farfield.frame import Cloud
from farfield.radar.views import decibel

_MAGIC = b"FFP1"
_FINEST_M = 1 / 128
_STEPS = 255
DIFFERENCES = "differences"
"""Coding of a field: see above."""


def encode_cloud(cloud: Cloud, facts: Mapping[str, Any]) -> bytes:
    """A point cloud; invalid returns (not finite, or all three coordinates 0) are left out.

    Args:
        cloud: The points.
        facts: What else the header says: ``frame``, ``layer``, ``time_ns``, ``version``.
    """
    cloud = _valid_returns(cloud)
    quantised, scale_m = _quantised(cloud)
    arrays: dict[str, tuple[np.ndarray, dict[str, Any]]] = {
        "place": (_differences(quantised), {"type": "int16", "items": quantised.shape[1], "coding": DIFFERENCES})
    }
    for name in cloud.columns[3:]:
        shown, values = _shown(name, np.asarray(cloud.intensity if name == "intensity" else cloud.extra[name]))
        if values.ndim == 1 and values.dtype.kind in "fiub":
            rows, low, high = as_bytes(values.astype(np.float64), *_span(name, values))
            arrays[shown] = rows, {"low": low, "high": high}
    return _packed({**facts, "count": len(cloud), "scale_m": scale_m, "offset_m": [0.0, 0.0, 0.0]}, arrays)


def encode_map(
    level: Float[np.ndarray, "rows *rest"],
    facts: Mapping[str, Any],
    doppler_m_s: Float[np.ndarray, "rows *rest"] | None = None,
) -> bytes:
    """A map, such as a radar's power in dB: one row after the other, byte 0 where there is no number.

    Args:
        level: Values; NaN where there is none.
        facts: What else the header says.
        doppler_m_s: Velocities of its cells, or None.
    """
    finite = level[np.isfinite(level)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    high = high if high > low else low + 1.0
    scaled = np.where(np.isfinite(level), 1 + np.rint((level - low) / (high - low) * (_STEPS - 1)), 0).astype(np.uint8)
    arrays = {"level": (np.ascontiguousarray(scaled), {"low": low, "high": high})}
    if doppler_m_s is not None:
        reach = max(float(np.nan_to_num(np.abs(doppler_m_s)).max(initial=0.0)), 1.0)
        steps, low, high = as_bytes(doppler_m_s.astype(np.float64).ravel(), -reach, reach)
        arrays["doppler_m_s"] = steps.reshape(doppler_m_s.shape), {"low": low, "high": high}
    return _packed({**facts, "count": len(level), "scale_m": 1.0, "offset_m": [0.0, 0.0, 0.0]}, arrays)


def as_bytes(values: Float[np.ndarray, " n"], low: float, high: float) -> tuple[UInt8[np.ndarray, " n"], float, float]:
    """Values as bytes between two limits; what is not finite becomes the lower one."""
    span = high - low if high > low else 1.0
    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.rint((values - low) * (_STEPS / span))
    return np.clip(np.nan_to_num(steps, nan=0.0), 0, _STEPS).astype(np.uint8), low, low + span


def _valid_returns(cloud: Cloud) -> Cloud:
    """The returns that have a place. Columns are compared, not rows of three: that is several times as fast."""
    x, y, z = cloud.points_m.T
    valid = (x != 0) | (y != 0) | (z != 0)
    finite = np.isfinite(cloud.points_m)
    if not finite.all():
        valid &= finite.all(axis=1)
    return cloud if valid.all() else cloud[valid]


def _quantised(cloud: Cloud) -> tuple[Int16[np.ndarray, "n 4"], float]:
    reach_m = float(np.abs(cloud.points_m).max()) if len(cloud) else 0.0
    scale_m = _FINEST_M
    while reach_m / scale_m > 32767:
        scale_m *= 2
    quantised = np.zeros((len(cloud), 4), dtype="<i2")
    quantised[:, :3] = np.rint(cloud.points_m * np.float32(1 / scale_m))
    quantised[:, 3] = _spare(cloud)
    return quantised, scale_m


def _differences(places: Int16[np.ndarray, "n c"]) -> UInt8[np.ndarray, " 2*n*c"]:
    columns = np.ascontiguousarray(places.T)
    steps = np.diff(columns, axis=1, prepend=np.int16(0))  # wraps, and so does the sum that undoes it
    zigzag = ((steps << 1) ^ (steps >> 15)).astype("<i2").view(np.uint8).reshape(*columns.shape, 2)
    return zigzag.transpose(0, 2, 1).ravel()


def _spare(cloud: Cloud) -> Shaped[np.ndarray, " n"] | int:
    if "ring" in cloud.extra:
        return np.clip(cloud.extra["ring"], 0, 32767).astype("<i2")
    if "lag_s" in cloud.extra:
        return np.clip(np.nan_to_num(cloud.extra["lag_s"] * 1e3), -32768, 32767).astype("<i2")
    return 0


def _span(name: str, values: Shaped[np.ndarray, " n"]) -> tuple[float, float]:
    """Between which values a column's bytes lie: whole numbers up to 255 stand as they are."""
    if name == "intensity":
        return 0.0, 1.0
    if values.dtype.kind in "ub" and (not len(values) or values.max() <= _STEPS):
        return 0.0, 255.0
    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    return (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)


def _shown(name: str, column: Shaped[np.ndarray, " n ..."]) -> tuple[str, Shaped[np.ndarray, " n ..."]]:
    """A column's name and values on the page: times as ages, a radar's power in dB, for it spans six decades."""
    if name == "time_ns":
        times_ns = np.asarray(column).astype(np.int64)
        return "age_s", (times_ns.max(initial=0) - times_ns) / 1e9 if len(times_ns) else np.zeros(0)
    if name == "power" and column.ndim == 1 and column.dtype.kind == "f":
        return "power_db", decibel(np.maximum(column, 0), unit=1.0)
    return name, column


def _packed(header: dict[str, Any], arrays: Mapping[str, tuple[np.ndarray, dict[str, Any]]]) -> bytes:
    """Magic, length of the header, header, arrays. Offsets count from the first byte; their digits stand fixed."""
    fields = [
        {"name": name, "type": rows.dtype.name, "offset": 0, "items": int(np.prod(rows.shape[1:])), **more}
        for name, (rows, more) in arrays.items()
    ]
    header = {**header, "fields": fields}
    room = len(json.dumps(header).encode()) + 12 * len(fields)
    at = 8 + _aligned(room)
    start = at
    for entry, (rows, _) in zip(fields, arrays.values(), strict=True):
        entry["offset"] = at
        at += _aligned(rows.nbytes)
    text = json.dumps(header).encode().ljust(start - 8)
    packed = bytearray(at)
    packed[:start] = _MAGIC + (start - 8).to_bytes(4, "little") + text
    for entry, (rows, _) in zip(fields, arrays.values(), strict=True):
        packed[entry["offset"] : entry["offset"] + rows.nbytes] = rows.tobytes()
    return bytes(packed)


def _aligned(size: int) -> int:
    return -(-size // 8) * 8
