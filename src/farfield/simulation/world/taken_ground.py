"""Which ground beside a road is taken, so that nothing is put into something else."""

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.mesh import Mesh

_LOW_M = 2.2  # what hangs higher leaves the ground free
_CELL_M = 10.0

Rectangle = tuple[float, float, float, float]
"""First and last station, right and left offset of a piece of ground, metres."""


def low_bounds_m(model: Mesh, turn_rad: float = 0.0) -> Float[np.ndarray, "2 2"]:
    """Least and greatest x and y of what a turned model fills below ``_LOW_M``, shape (2, 2)."""
    x, y, z = model.vertices_m.T
    low = z < _LOW_M
    x, y, cos, sin = x[low], y[low], np.cos(turn_rad), np.sin(turn_rad)
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)
    return np.stack([turned.min(axis=0), turned.max(axis=0)])


def rectangle_of(model: Mesh, s_m: float, d_m: float, turn_rad: float) -> Rectangle:
    """The ground under a model that stands at (s, d)."""
    (first, right), (last, left) = (low_bounds_m(model, turn_rad) + np.array([s_m, d_m])).tolist()
    return first, last, right, left


def halves_across(model: Mesh) -> list[Mesh]:
    """The vertices of a model to the left of its x axis and to the right of it, such as the posts of a gantry."""
    y = model.vertices_m[:, 1]
    return [Mesh.of(model.vertices_m[part], np.zeros((0, 3), dtype=np.int64), 0) for part in (y > 0, y < 0)]


class TakenGround:
    """Rectangles along a road, looked up by their stations."""

    def __init__(self) -> None:
        self._cells: dict[int, list[Rectangle]] = {}

    def take(self, first_m: float, last_m: float, right_m: float, left_m: float) -> None:
        """Take the ground of a rectangle."""
        for cell in range(int(first_m // _CELL_M), int(last_m // _CELL_M) + 1):
            self._cells.setdefault(cell, []).append((first_m, last_m, right_m, left_m))

    def free(self, first_m: float, last_m: float, right_m: float, left_m: float) -> bool:
        """Whether nothing has taken any of a rectangle."""
        return not any(
            first_m < taken[1] and taken[0] < last_m and right_m < taken[3] and taken[2] < left_m
            for cell in range(int(first_m // _CELL_M), int(last_m // _CELL_M) + 1)
            for taken in self._cells.get(cell, ())
        )
