"""Bounds of lengths in settings, in one place: a weights file's configuration is no more to be trusted than its bytes.

What is a length is told by its name, which ends in ``_m``. The bounds are far outside what any road holds; they keep
out what would overflow, or give boxes that no figure could hold.
"""

import math
from typing import Any

from pydantic import BaseModel

FARTHEST_M = 2000.0
"""No length, reach or height is larger, nor lower below the sensor."""
SMALLEST_M = 0.001
"""No size, cell or reach is smaller."""

_EXTENTS = ("size_m", "sizes_m", "cell_m", "range_m", "half_width_m")


def check_lengths(settings: BaseModel) -> None:
    """Check every length of settings and of those within them.

    Raises:
        ValueError: If one is not finite or out of bounds, or a lowest height is not below the highest.
    """
    _check(settings, "")


def _check(value: Any, path: str) -> None:
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            _check(getattr(value, name), f"{path}.{name}" if path else name)
        low, high = getattr(value, "z_min_m", None), getattr(value, "z_max_m", None)
        if low is not None and high is not None and not high > low:
            place = f"{path}.z_max_m" if path else "z_max_m"
            raise ValueError(f"{place}: expected more than z_min_m ({low:g}), got {high:g}")
    elif isinstance(value, dict):
        for name, each in value.items():
            _check(each, f"{path}.{name}")
    elif isinstance(value, tuple | list):
        for each in value:
            _check(each, path)
    elif isinstance(value, int | float) and any(part.endswith("_m") for part in path.split(".")):
        _check_length(float(value), path)


def _check_length(value: float, path: str) -> None:
    lowest = SMALLEST_M if set(path.split(".")) & set(_EXTENTS) else -FARTHEST_M
    if not (math.isfinite(value) and lowest <= value <= FARTHEST_M):
        raise ValueError(f"{path}: expected {lowest:g} to {FARTHEST_M:g} m, got {value:g}")
