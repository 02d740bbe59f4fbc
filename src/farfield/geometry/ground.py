"""The ground below the points of a sweep: a low quantile in square cells, opened so that no object stays in it."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Float64

_CELL_M, _QUANTILE, _OPENING_CELLS = 1.0, 0.05, 5


def ground_m(points_m: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Height of the ground below each point, shape (n,).

    Cells of 1 m take the 5 % quantile of their heights; a grey opening (minimum, then maximum, over 5 x 5 cells) takes
    out what stands on the ground and is narrower than 5 m.

    Args:
        points_m: Points with z up, shape (n, 3).
    """
    points = points_m.astype(np.float64)
    cells = np.floor(points[:, :2] / _CELL_M).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    shape = tuple((cells.max(axis=0, initial=0) + 1).tolist())
    number = np.ravel_multi_index((cells[:, 0], cells[:, 1]), shape)
    order = np.lexsort((points[:, 2], number))
    filled, first, count = np.unique(number[order], return_index=True, return_counts=True)
    low = np.full(shape, np.inf).ravel()
    low[filled] = points[order[first + (_QUANTILE * (count - 1)).astype(np.int64)], 2]
    lowest = _over_window(low.reshape(shape), np.min, np.inf)
    opened = _over_window(np.where(np.isinf(lowest), -np.inf, lowest), np.max, -np.inf)
    return np.minimum(opened.ravel(), low)[number]


def _over_window(
    grid: Float64[np.ndarray, "x y"], reduce: Callable[..., np.ndarray], outside: float
) -> Float64[np.ndarray, "x y"]:
    """A minimum or maximum over the cells about each cell, first along one axis and then along the other."""
    for axis in (0, 1):
        margin = [(_OPENING_CELLS // 2,) * 2 if axis == own else (0, 0) for own in (0, 1)]
        padded = np.pad(grid, margin, constant_values=outside)
        grid = reduce(np.lib.stride_tricks.sliding_window_view(padded, _OPENING_CELLS, axis=axis), axis=-1)
    return grid
