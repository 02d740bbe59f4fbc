"""The road's reference line, and surfaces swept along it.

A place on the road is (s, d): the distance along the reference line and the offset to its left, metres. Traffic keeps
right, so that its own direction lies at negative d.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from farfield.simulation.bodies.mesh import Mesh, grid

_STEP_M = 1.0


@dataclass(frozen=True, eq=False)
class RoadLine:
    """A smooth line with gentle bends and undulation; s = 0 lies at the world's origin, heading along x.

    Args:
        first_s_m: Where the tabulated line begins.
        table: x, y, z, heading at every metre, shape (n, 4).
    """

    first_s_m: float
    table: Float[np.ndarray, "n 4"]

    @classmethod
    def draw(
        cls, rng: np.random.Generator, *, behind_m: float, ahead_m: float, curvature_per_m: float, undulation_m: float
    ) -> "RoadLine":
        """Draw a line from ``-behind_m`` to ``ahead_m``.

        Args:
            rng: Source of randomness.
            behind_m: Length before the origin.
            ahead_m: Length after the origin.
            curvature_per_m: Amplitude of each of the two waves of curvature.
            undulation_m: Amplitude of each of the two waves of height.
        """
        s = np.arange(-np.ceil(behind_m), ahead_m + _STEP_M, _STEP_M)
        curvature, z = np.zeros_like(s), np.zeros_like(s)
        for shortest, longest in ((350.0, 800.0), (900.0, 2500.0)):
            wave = curvature_per_m * rng.uniform(-1, 1)
            curvature += wave * np.sin(2 * np.pi * s / rng.uniform(shortest, longest) + rng.uniform(0, 2 * np.pi))
        for shortest, longest in ((200.0, 400.0), (500.0, 1200.0)):
            wave = undulation_m * rng.uniform(0.1, 1.0)
            z += wave * np.sin(2 * np.pi * s / rng.uniform(shortest, longest) + rng.uniform(0, 2 * np.pi))
        heading = np.cumsum(curvature) * _STEP_M
        origin = int(np.argmin(np.abs(s)))
        heading -= heading[origin]
        x, y = np.cumsum(np.cos(heading)) * _STEP_M, np.cumsum(np.sin(heading)) * _STEP_M
        table = np.stack([x - x[origin], y - y[origin], z - z[origin], heading], axis=1)
        return cls(float(s[0]), table)

    def _column(self, s_m: Float[np.ndarray, "*shape"], column: int) -> Float[np.ndarray, "*shape"]:
        position = (s_m - self.first_s_m) / _STEP_M
        return np.asarray(np.interp(position, np.arange(len(self.table)), self.table[:, column]))

    def heading_rad(self, s_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Direction of growing s."""
        return self._column(s_m, 3)

    def slope(self, s_m: float) -> float:
        """Rise per metre."""
        ends = self._column(np.array([s_m - 1.5, s_m + 1.5]), 2)
        return float(ends[1] - ends[0]) / 3.0

    def point_m(
        self, s_m: Float[np.ndarray, "*shape"], d_m: Float[np.ndarray, "*shape"] | float
    ) -> Float[np.ndarray, "*shape 3"]:
        """World coordinates of a place on the road's surface."""
        heading = self.heading_rad(s_m)
        x = self._column(s_m, 0) - d_m * np.sin(heading)
        y = self._column(s_m, 1) + d_m * np.cos(heading)
        return np.stack([x, y, self._column(s_m, 2)], axis=-1)


def ribbon(
    road: RoadLine,
    s_m: Float[np.ndarray, " k"],
    d_m: Float[np.ndarray, "k n"] | Float[np.ndarray, " n"],
    height_m: Float[np.ndarray, "k n"] | Float[np.ndarray, " n"],
    material: Int[np.ndarray, "k1 n1"] | Int[np.ndarray, " n1"] | int,
) -> Mesh:
    """Sweep a section along the road.

    Args:
        road: The reference line.
        s_m: Where the sections stand, shape (k,).
        d_m: Offsets of the section's points, shape (n,) or (k, n).
        height_m: Their heights above the reference line, the same shape.
        material: One material, one for each stretch of the section, or one for each cell.
    """
    n = np.shape(d_m)[-1]
    offsets = np.broadcast_to(np.asarray(d_m, dtype=np.float64), (len(s_m), n))
    points = road.point_m(np.repeat(s_m[:, None], n, axis=1), offsets)
    points[..., 2] += height_m
    return grid(points, np.broadcast_to(np.asarray(material, dtype=np.int64), (len(s_m) - 1, n - 1)))
