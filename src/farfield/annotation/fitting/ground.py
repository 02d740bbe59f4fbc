"""The ground near an object: a plane through the lowest points of 1 m cells, by reweighted least squares."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

RADIUS_M, FARTHEST_M = 15.0, 60.0
LOWEST_M, HIGHEST_M = 0.15, 4.5
"""Points between these heights over the ground may be an object's. 0.15 m keeps 93 % of the points of objects at 30 to
60 m and 80 % at 60 to 100 m; 0.3 m keeps 85 % and 60 % only."""
_CELL_M = 1.0
_CELLS_NEEDED = 8
_THRESHOLDS_M = (0.5, 0.3, 0.2, 0.2)
_START_QUANTILE = 0.1
_RIDGE = 50.0  # in units of cells times square metres: a slope of 2 % costs as much as 0.02 m in 50 cells


@dataclass(frozen=True, kw_only=True)
class Ground:
    """The plane ``z = c + a (x - x0) + b (y - y0)``.

    Args:
        origin_m: x0 and y0.
        plane: a, b (slopes) and c (metres).
        cells: How many cells decided it; 0 where there were no points at all, and c is 0.
    """

    origin_m: tuple[float, float]
    plane: tuple[float, float, float]
    cells: int

    def z_m(self, x_m: float, y_m: float) -> float:
        """Height of the ground at a place."""
        a, b, c = self.plane
        return c + a * (x_m - self.origin_m[0]) + b * (y_m - self.origin_m[1])

    def heights_m(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Heights of points over the ground, shape (n,)."""
        a, b, c = self.plane
        return points_m[:, 2] - (c + a * (points_m[:, 0] - self.origin_m[0]) + b * (points_m[:, 1] - self.origin_m[1]))


def points_near(
    points_m: Float[np.ndarray, "n 3"], at_m: tuple[float, float], radius_m: float
) -> Float[np.ndarray, "m 3"]:
    """Points within a square of twice the radius about a place, as float64; those that are not finite are left out."""
    x, y = points_m[:, 0], points_m[:, 1]
    chosen: Int[np.ndarray, " k"] = np.flatnonzero(np.abs(x - at_m[0]) <= radius_m)
    chosen = chosen[np.abs(y[chosen] - at_m[1]) <= radius_m]
    square = points_m[chosen].astype(np.float64)
    return square[np.isfinite(square[:, 2])]


def fit_ground(points_m: Float[np.ndarray, "n 3"], at_m: tuple[float, float]) -> Ground:
    """The ground about a place.

    Cells hold the lowest point of each square metre within 15 m; where there are too few of them (far away) the circle
    grows to 60 m. The plane starts level at their 10 % quantile; cells farther from it than 0.5, 0.3, 0.2 and 0.2 m are
    left out in turn, and steep slopes are held back.

    Args:
        points_m: Points of the frame, shape (n, 3).
        at_m: x and y of the place.
    """
    radius_m, cells = RADIUS_M, np.zeros((0, 3))
    while True:
        cells = _lowest(points_near(points_m, at_m, radius_m) - np.array([*at_m, 0.0]))
        if len(cells) >= _CELLS_NEEDED or radius_m >= FARTHEST_M:
            break
        radius_m *= 2
    if len(cells) == 0:
        return Ground(origin_m=at_m, plane=(0.0, 0.0, 0.0), cells=0)
    plane = np.array([0.0, 0.0, np.quantile(cells[:, 2], _START_QUANTILE)])
    design = np.column_stack([cells[:, :2], np.ones(len(cells))])
    for threshold_m in _THRESHOLDS_M:
        inlier = np.abs(cells[:, 2] - design @ plane) < threshold_m
        if inlier.sum() < 3:
            break
        normal = design[inlier].T @ design[inlier] + np.diag([_RIDGE, _RIDGE, 1e-9])
        plane = np.linalg.solve(normal, design[inlier].T @ cells[inlier, 2])
    a, b, c = plane.tolist()
    return Ground(origin_m=at_m, plane=(a, b, c), cells=len(cells))


def _lowest(points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """The lowest point of each cell."""
    if len(points_m) == 0:
        return points_m
    cell = np.floor(points_m[:, :2] / _CELL_M).astype(np.int64)
    code = (cell[:, 0] - cell[:, 0].min()) * (int(np.ptp(cell[:, 1])) + 1) + cell[:, 1] - cell[:, 1].min()
    order = np.lexsort((points_m[:, 2], code))
    first = np.flatnonzero(np.diff(code[order], prepend=-1))
    return points_m[order[first]]


def points_above(points_m: Float[np.ndarray, "n 3"], ground: Ground) -> Float[np.ndarray, "m 3"]:
    """Points that stand over the ground, and not higher than any vehicle."""
    height_m = ground.heights_m(points_m)
    return points_m[(height_m > LOWEST_M) & (height_m < HIGHEST_M)]
