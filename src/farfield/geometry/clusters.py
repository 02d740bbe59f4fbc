"""Clusters of a car's size in a sweep: narrow, apart, not below anything. What a detector could take for a vehicle."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int
from scipy.ndimage import label as connected
from scipy.spatial import ConvexHull, QhullError, cKDTree

# The constants are frozen: what is measured later is measured with the same eye.
_LOW_M, _TOP_M, _CELL_M, _POINTS, _HEIGHT_M = 0.3, 2.6, 0.3, 10, 0.6
_LONG_M, _WIDE_M = (1.2, 6.0), (0.3, 2.6)
_ABOVE_M, _ABOVE_NEAR_M, _ABOVE_POINTS = (2.8, 8.0), 1.0, 3


def car_sized(points_m: Float64[np.ndarray, "n 3"], height_m: Float64[np.ndarray, " n"]) -> list[Int[np.ndarray, " k"]]:
    """Rows of the points of each cluster of a car's size.

    Points from 0.3 to 2.6 m above the ground on a grid of 0.3 m, connected over edges and corners; a cluster has ten
    points, is 0.6 m high, its least rectangle 1.2 to 6 m long and 0.3 to 2.6 m wide, and above its middle are fewer
    than three points up to 8 m.

    Args:
        points_m: Points of a sweep, shape (n, 3).
        height_m: Their heights above the ground, shape (n,).
    """
    rows, number = standing_clusters(points_m, height_m)
    if not len(rows):
        return []
    above = points_m[(height_m > _ABOVE_M[0]) & (height_m < _ABOVE_M[1])]
    overhead = cKDTree(above[:, :2]) if len(above) else None
    order = np.argsort(number, kind="stable")
    edges = [0, *(np.flatnonzero(np.diff(number[order])) + 1).tolist(), len(order)]
    groups = (rows[order[start:end]] for start, end in pairwise(edges) if end - start >= _POINTS)
    return [group for group in groups if _is_like_a_car(points_m[group], height_m[group], overhead)]


def standing_clusters(
    points_m: Float64[np.ndarray, "n 3"], height_m: Float64[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Rows of the points from 0.3 to 2.6 m above the ground, and the cluster of each, of whatever size.

    Args:
        points_m: Points of a sweep, shape (n, 3).
        height_m: Their heights above the ground, shape (n,).

    Returns:
        Rows, shape (k,), and numbers of clusters from 0 on, shape (k,): connected on a grid of 0.3 m, over edges and
        corners.
    """
    rows = np.flatnonzero((height_m > _LOW_M) & (height_m < _TOP_M))
    if not len(rows):
        return rows, rows
    cells = np.floor(points_m[rows, :2] / _CELL_M).astype(np.int64)
    cells -= cells.min(axis=0)
    grid = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    grid[cells[:, 0], cells[:, 1]] = True
    numbers, _ = connected(grid, structure=np.ones((3, 3)))
    return rows, numbers[cells[:, 0], cells[:, 1]].astype(np.int64) - 1


def _is_like_a_car(
    points: Float64[np.ndarray, "k 3"], height_m: Float64[np.ndarray, " k"], overhead: cKDTree | None
) -> bool:
    if np.ptp(height_m) < _HEIGHT_M:
        return False
    long_m, wide_m = least_rectangle_m(points[:, :2])
    if not (_LONG_M[0] <= long_m <= _LONG_M[1] and _WIDE_M[0] <= wide_m <= _WIDE_M[1]):
        return False
    centre = (points[:, :2].min(axis=0) + points[:, :2].max(axis=0)) / 2
    return overhead is None or len(overhead.query_ball_point(centre, _ABOVE_NEAR_M)) < _ABOVE_POINTS


def least_rectangle_m(points: Float64[np.ndarray, "n 2"]) -> tuple[float, float]:
    """Length and width of the rectangle of the least area about points: one of its sides lies along their hull."""
    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:  # all on one line
        return float(np.linalg.norm(np.ptp(points, axis=0))), 0.0
    edges = np.diff(hull, axis=0, append=hull[:1])
    along = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    spans = np.stack([np.ptp(hull @ along.T, axis=0), np.ptp(hull @ across.T, axis=0)])
    sides = spans[:, np.argmin(spans[0] * spans[1])]
    return float(sides.max()), float(sides.min())
