"""The points of a frame, sorted once so that those near a box are found quickly, and the ground beside it."""

import numpy as np
from jaxtyping import Float

from farfield.datasets.labels import Numbers

CELL_M = 4.0
GROUND_CELL_M = 1.0
BESIDE_M = 0.3
GROUND_REACH_M = 4.0
GROUND_QUANTILE = 0.3
FEWEST_CELLS = 5
Points = Float[np.ndarray, "n 3"]


class Surroundings:
    """LiDAR points of a frame by cells of 4 m.

    Args:
        points_m: Points in the frame's coordinates, shape (n, 3).
    """

    def __init__(self, points_m: Float[np.ndarray, "n 3"]) -> None:
        points = points_m[np.isfinite(points_m).all(axis=1)]
        cells = np.floor(points[:, :2] / CELL_M).astype(np.int32)
        self._low = cells.min(axis=0) if len(cells) else np.zeros(2, np.int32)
        self._counts = cells.max(axis=0) - self._low + 1 if len(cells) else np.zeros(2, np.int32)
        flat = (cells[:, 0] - self._low[0]).astype(np.int64) * int(self._counts[1]) + (cells[:, 1] - self._low[1])
        order = np.argsort(flat, kind="stable")
        self._points, self._flat = points[order], flat[order]

    def near(self, x: float, y: float, reach_m: float) -> Points:
        """Points of the cells that a square around a place touches, shape (k, 3)."""
        low = np.floor((np.array([x, y]) - reach_m) / CELL_M).astype(np.int64) - self._low
        high = np.floor((np.array([x, y]) + reach_m) / CELL_M).astype(np.int64) - self._low
        low, high = np.maximum(low, 0), np.minimum(high, self._counts - 1)
        if (low > high).any():
            return self._points[:0]
        columns = np.arange(low[0], high[0] + 1) * int(self._counts[1])
        starts = np.searchsorted(self._flat, columns + low[1], side="left")
        stops = np.searchsorted(self._flat, columns + high[1], side="right")
        return np.concatenate([self._points[start:stop] for start, stop in zip(starts, stops, strict=True)])


def in_box_axes(points_m: Points, box: Numbers) -> Points:
    """Points with the box's centre as origin and its length along x, shape (n, 3)."""
    cos, sin = np.cos(box[6]), np.sin(box[6])
    offset = points_m.astype(np.float64) - np.array(box[:3])
    return np.column_stack(
        [offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin, offset[:, 2]]
    )


def beyond_m(local_m: Points, box: Numbers) -> Float[np.ndarray, " n"]:
    """How far points, in the box's axes, stand outside its outline seen from above; negative inside."""
    return np.maximum(np.abs(local_m[:, 0]) - box[3] / 2, np.abs(local_m[:, 1]) - box[4] / 2)


def ground_m(local_m: Points, beyond: Float[np.ndarray, " n"]) -> float | None:
    """Height of the ground beside a box, in the box's axes (its centre is 0); None where too little is seen of it.

    The lowest point of each square metre within 4 m of the outline; of those the 30 % quantile, as other objects hide
    the ground of some.

    Args:
        local_m: Points in the box's axes, shape (n, 3).
        beyond: How far each stands outside, see :func:`beyond_m`.
    """
    points = local_m[(beyond > BESIDE_M) & (beyond <= GROUND_REACH_M)]
    if len(points) < FEWEST_CELLS:
        return None
    cells = np.floor(points[:, :2] / GROUND_CELL_M).astype(np.int64)
    flat = (cells[:, 0] << 20) + cells[:, 1]
    order = np.argsort(flat, kind="stable")
    ordered = flat[order]
    starts = np.flatnonzero(np.diff(ordered, prepend=ordered[0] - 1))
    lowest = np.minimum.reduceat(points[order, 2], starts)
    return None if len(lowest) < FEWEST_CELLS else float(np.quantile(lowest, GROUND_QUANTILE))
