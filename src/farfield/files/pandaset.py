"""PandaSet's JSON files: poses, times, cameras and positions on the globe."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import FileFormatError
from farfield.files.cuboids import FARTHEST_M, check_turns, numbers
from farfield.files.json_text import finite, read_json

_JSON_BYTES = 1 << 24
_EPOCH_S = (1e9, 4e9)  # 2001 to 2096: milliseconds and nanoseconds lie beyond
_GPS = ("lat", "long", "height", "xvel", "yvel")

Placement = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]
"""Positions in metres, and turns as quaternions x, y, z, w."""


def read_placements(path: Path) -> Placement:
    """The poses of a sensor in the world, one a frame.

    Raises:
        FileFormatError: If the file holds anything but positions and turns.
    """
    positions: list[list[float]] = []
    turns: list[list[float]] = []
    for number, entry in enumerate(_entries(path)):
        where = f"entry {number}"
        for name, axes, rows in (("position", "xyz", positions), ("heading", "xyzw", turns)):
            values = entry.get(name)
            listed = [values.get(axis) for axis in axes] if isinstance(values, Mapping) else None
            rows.append(numbers(listed, len(axes), path, f"{where}.{name}", f"{name} with {', '.join(axes)}"))
        if max(map(abs, positions[-1])) > FARTHEST_M:
            raise FileFormatError(path, where=where, expected="metres", got=repr(positions[-1])[:120])
    turned = np.array(turns, dtype=np.float64).reshape(-1, 4)
    check_turns(turned, path, "entry {}", upright=False)
    return np.array(positions, dtype=np.float64).reshape(-1, 3), turned


def read_stamps(path: Path) -> Int64[np.ndarray, " n"]:
    """The times of a sensor's frames in nanoseconds since 1970.

    Raises:
        FileFormatError: If the file holds anything but rising seconds.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    values = [finite(value, limit=1e12) for value in content] if isinstance(content, list) else []
    stamps = [value for value in values if value is not None and _EPOCH_S[0] <= value <= _EPOCH_S[1]]
    if not stamps or len(stamps) != len(values):
        expected = "a list of times in seconds since 1970"
        raise FileFormatError(path, where="the file", expected=expected, got=repr(content)[:80])
    times_ns = np.array([round(stamp * 1e6) * 1000 for stamp in stamps], dtype=np.int64)
    back = np.flatnonzero(np.diff(times_ns) <= 0)
    if len(back):
        where = f"entry {int(back[0]) + 1}"
        raise FileFormatError(path, where=where, expected="a later time than the one before", got="an earlier one")
    return times_ns


def read_intrinsics(path: Path) -> Float[np.ndarray, "3 3"]:
    """A camera's matrix in pixels.

    Raises:
        FileFormatError: If the file holds anything but ``fx``, ``fy``, ``cx``, ``cy``.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    listed = [content.get(name) for name in ("fx", "fy", "cx", "cy")] if isinstance(content, dict) else None
    fx, fy, cx, cy = numbers(listed, 4, path, "the file", "fx, fy, cx, cy")
    if not (0 < fx < 1e6 and 0 < fy < 1e6 and abs(cx) < 1e6 and abs(cy) < 1e6):
        raise FileFormatError(path, where="the file", expected="focal lengths in pixels", got=repr(listed))
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def read_gps(path: Path) -> list[dict[str, float]]:
    """Latitude and longitude in degrees, height in metres and two velocities in m/s, one record a frame.

    Raises:
        FileFormatError: If the file holds anything else.
    """
    records = []
    for number, entry in enumerate(_entries(path)):
        values = numbers([entry.get(name) for name in _GPS], 5, path, f"entry {number}", ", ".join(_GPS))
        if abs(values[0]) > 90 or abs(values[1]) > 180:
            raise FileFormatError(path, where=f"entry {number}", expected="degrees", got=repr(values[:2]))
        records.append(dict(zip(_GPS, values, strict=True)))
    return records


def read_class_names(path: Path) -> dict[int, str]:
    """Names of the classes of points by number.

    Raises:
        FileFormatError: If the file holds anything else.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    sound = isinstance(content, dict) and all(
        key.isascii() and key.isdigit() and len(key) < 6 and isinstance(name, str) for key, name in content.items()
    )
    if not sound:
        raise FileFormatError(path, where="the file", expected="names by number", got=repr(content)[:80])
    return {int(key): name for key, name in content.items()}


def _entries(path: Path) -> Sequence[Mapping[str, Any]]:
    content = read_json(path, max_bytes=_JSON_BYTES)
    if not isinstance(content, list) or not content or not all(isinstance(entry, dict) for entry in content):
        raise FileFormatError(path, where="the file", expected="a list of objects", got=repr(content)[:80])
    return content
