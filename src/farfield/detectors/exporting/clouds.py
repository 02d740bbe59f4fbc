"""Five clouds on which every export is checked: none, one point, a usual street, a full grid, and another range."""

from collections.abc import Sequence

import numpy as np

from farfield.frame import Cloud

_GROUND_M, _CARS = -1.9, 24


def checked_clouds(columns: Sequence[str], reach_m: float, half_width_m: float, low_m: float) -> dict[str, Cloud]:
    """The clouds by name, with all columns that a detector reads; the same at every call.

    Args:
        columns: What it reads.
        reach_m: How far ahead it looks.
        half_width_m: How far it looks to the sides.
        low_m: Lowest height that it looks at.
    """
    rng = np.random.default_rng(64)
    ground_m = max(_GROUND_M, low_m + 0.3)
    usual = _street(rng, reach_m, half_width_m, ground_m, 16_000)
    low, high = [0.0, -half_width_m, ground_m - 0.5], [reach_m, half_width_m, ground_m + 3.0]
    full = np.concatenate([_street(rng, reach_m, half_width_m, ground_m, 40_000), rng.uniform(low, high, (60_000, 3))])
    other = _street(rng, 3 * reach_m, 3 * half_width_m, ground_m, 16_000)
    one = np.array([[reach_m / 3, 0.5, ground_m + 0.7]])
    named = {"empty": one[:0], "one point": one, "usual": usual, "full": full, "another range": other}
    return {name: _with_columns(rng, points, columns) for name, points in named.items()}


def _street(rng: np.random.Generator, reach_m: float, half_width_m: float, ground_m: float, ground: int) -> np.ndarray:
    """A flat road with cars at all headings, of each the rear and one side, as a LiDAR at the origin sees them."""
    radius = reach_m * rng.uniform(0.02, 1.0, ground) ** 1.5
    angle = rng.uniform(-0.9, 0.9, ground)
    parts = [np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rng.normal(ground_m, 0.03, ground)])]
    for _ in range(_CARS):
        x, y = rng.uniform(6, 0.8 * reach_m), rng.uniform(-0.8 * half_width_m, 0.8 * half_width_m)
        yaw, count = rng.uniform(-np.pi, np.pi), max(20, int(6000 / np.hypot(x, y)))
        side = np.column_stack([rng.uniform(-2.2, 2.2, count), np.full(count, -0.9 * np.sign(y))])
        rear = np.column_stack([np.full(count // 2, -2.2), rng.uniform(-0.9, 0.9, count // 2)])
        walls = np.concatenate([side, rear])
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        parts.append(np.column_stack([walls @ turn + [x, y], rng.uniform(ground_m + 0.2, ground_m + 1.6, len(walls))]))
    return np.concatenate(parts)


def _with_columns(rng: np.random.Generator, points: np.ndarray, columns: Sequence[str]) -> Cloud:
    count, extra = len(points), {}
    for name in columns[3:]:
        if name not in ("intensity", "lag_s"):
            extra[name] = rng.gamma(1.5, 0.2, count).astype(np.float32)
    strength = rng.uniform(0, 0.8, count).astype(np.float32)
    is_radar = "power" in columns
    return Cloud(points.astype(np.float32), None if is_radar else strength, extra)
