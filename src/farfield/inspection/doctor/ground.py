"""A rough ground height, so that ground returns do not count as points of an object."""

import numpy as np
from jaxtyping import Bool, Float

_CELL_M = 4.0
_REACH_M = 400.0
_SHARE = 0.05  # height below which this share of a cell's points lies
_MIN_CELL_POINTS = 10


def ground_height_m(points_m: Float[np.ndarray, "n 3"], at_m: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
    """Ground height at some places: the lowest cell (4 m) of the 3 x 3 around each; NaN where too few points lie.

    Args:
        points_m: The cloud.
        at_m: Places x, y.

    Returns:
        Heights in metres, shape (m,).
    """
    side = int(2 * _REACH_M / _CELL_M) + 2
    low = np.full((side, side), np.nan)
    cell = _cells(points_m[:, :2], side)
    order = np.lexsort((points_m[:, 2], cell))
    names, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    enough = count >= _MIN_CELL_POINTS
    low.flat[names[enough]] = points_m[order[first + (count * _SHARE).astype(np.intp)], 2][enough]
    padded = np.pad(low, 1, constant_values=np.nan)
    around = np.stack([padded[i : i + side, j : j + side] for i in range(3) for j in range(3)])
    floor = np.where(np.isnan(around), np.inf, around).min(axis=0)
    height = floor.flat[_cells(at_m, side)]
    return np.where(np.isinf(height), np.nan, height)


def above_ground(points_m: Float[np.ndarray, "n 3"], *, clearance_m: float = 0.3) -> Bool[np.ndarray, " n"]:
    """Which points stand clear of the ground; where it is not known they count as clear."""
    ground = ground_height_m(points_m, points_m[:, :2])
    return ~(points_m[:, 2] <= ground + clearance_m)


def _cells(at_m: Float[np.ndarray, "m 2"], side: int) -> np.ndarray:
    index = np.clip((at_m + _REACH_M) / _CELL_M, 0, side - 1).astype(np.intp)
    return index[:, 0] * side + index[:, 1]
