"""The road's reference line, and surfaces swept along it.

A place on the road is (s, d): the distance along the reference line and the offset to its left, metres. Traffic keeps
right, so that its own direction lies at negative d.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import uniform_filter1d

from farfield.simulation.bodies.mesh import Mesh, grid

_STEP_M = 1.0
_MAX_BANK = 0.06
BANKED_HALF_M = 18.0  # super-elevation tilts the ground so far to both sides


@dataclass(frozen=True)
class Bends:
    """Bounds of a road's shape.

    Args:
        curvature_per_m: Greatest curvature.
        straight_m: Range of the straight pieces' lengths.
        turn_rad: Range of the bends' angles; headings stay within 1.2 times the greatest of the first one, so that the
            road never comes back to itself.
        grade: Greatest slope.
        climb: Mean slope.
        bank_gain_m: Super-elevation for a curvature of 1 / m; it stays below 0.06.
    """

    curvature_per_m: float
    straight_m: tuple[float, float] = (80.0, 300.0)
    turn_rad: tuple[float, float] = (0.1, 0.6)
    grade: float = 0.02
    climb: float = 0.0
    bank_gain_m: float = 0.0


def _bend_curvature(length: int, bends: Bends, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Straights and bends in turn; the bends are arcs between clothoids (curvature is a trapezium), then smoothed."""
    out, heading, at = np.zeros(length), 0.0, int(rng.uniform(20, 60))
    limit = 1.2 * bends.turn_rad[1] / 2
    while at < length:
        turn = rng.uniform(*bends.turn_rad) * (rng.choice([-1, 1]) if abs(heading) < limit / 2 else -np.sign(heading))
        turn = float(np.clip(heading + turn, -limit, limit)) - heading
        peak = bends.curvature_per_m * rng.uniform(0.55, 0.97)
        length_m = abs(turn) / peak
        ramp = max(int(0.5 * length_m), 12)
        arc = max(int(length_m - ramp), 1)
        shape = np.concatenate([np.linspace(0, 1, ramp), np.ones(arc), np.linspace(1, 0, ramp)])
        shape *= np.sign(turn) * min(peak, abs(turn) / shape.sum())
        piece = shape[: length - at]
        out[at : at + len(piece)] = piece
        heading += float(shape.sum())
        at += len(shape) + int(rng.uniform(*bends.straight_m))
    return uniform_filter1d(uniform_filter1d(out, 9, mode="nearest"), 9, mode="nearest")


@dataclass(frozen=True, eq=False)
class RoadLine:
    """A smooth line with bends, super-elevation and grades; s = 0 lies at the world's origin, heading along x.

    Args:
        first_s_m: Where the tabulated line begins.
        table: x, y, z, heading, grade, super-elevation (rise to the right), curvature at every metre, shape (n, 7).
    """

    first_s_m: float
    table: Float[np.ndarray, "n 7"]

    @classmethod
    def draw(cls, rng: np.random.Generator, *, behind_m: float, ahead_m: float, bends: Bends) -> "RoadLine":
        """Draw a line from ``-behind_m`` to ``ahead_m`` within the given bounds."""
        behind, ahead = int(np.ceil(behind_m)), int(np.ceil(ahead_m))
        s = np.arange(-behind, ahead + 1, dtype=np.float64)
        back, onward = _bend_curvature(behind, bends, rng), _bend_curvature(ahead + 1, bends, rng)
        curvature = uniform_filter1d(np.concatenate([back[::-1], onward]), 15, mode="nearest")
        spare, grade = bends.grade - abs(bends.climb), np.full_like(s, bends.climb)
        for share, shortest, longest in ((0.35, 120.0, 300.0), (0.65, 350.0, 1200.0)):
            phase = rng.uniform(0, 2 * np.pi)
            wave = share * spare * rng.uniform(0.2, 1.0)
            grade += wave * np.sin(2 * np.pi * s / rng.uniform(shortest, longest) + phase)
        bank = np.clip(uniform_filter1d(curvature, 41, mode="nearest") * bends.bank_gain_m, -_MAX_BANK, _MAX_BANK)
        columns = [np.zeros_like(s) for _ in range(3)]
        heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2)])
        heading -= heading[behind]
        for column, rate in zip(columns, (np.cos(heading), np.sin(heading), grade), strict=True):
            column[1:] = np.cumsum((rate[1:] + rate[:-1]) / 2)
            column -= column[behind]
        return cls(float(-behind), np.stack([*columns, heading, grade, bank, curvature], axis=1))

    @cached_property
    def _rows(self) -> Float[np.ndarray, " n"]:
        return np.arange(len(self.table), dtype=np.float64)

    @cached_property
    def _columns(self) -> Float[np.ndarray, "7 n"]:
        return np.ascontiguousarray(self.table.T)

    def _column(self, s_m: Float[np.ndarray, "*shape"], column: int) -> Float[np.ndarray, "*shape"]:
        return np.asarray(np.interp((s_m - self.first_s_m) / _STEP_M, self._rows, self._columns[column]))

    @property
    def last_s_m(self) -> float:
        """Where the tabulated line ends."""
        return self.first_s_m + (len(self.table) - 1) * _STEP_M

    def heading_rad(self, s_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Direction of growing s."""
        return self._column(s_m, 3)

    def curvature_per_m(self, s_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Change of heading per metre; positive in bends to the left."""
        return self._column(s_m, 6)

    def slopes(
        self, s_m: Float[np.ndarray, "*shape"]
    ) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
        """Rise per metre along the line, and to its left."""
        return self._column(s_m, 4), np.asarray(-self._column(s_m, 5))

    def point_m(
        self, s_m: Float[np.ndarray, "*shape"], d_m: Float[np.ndarray, "*shape"] | float
    ) -> Float[np.ndarray, "*shape 3"]:
        """World coordinates of a place on the road's surface."""
        row = (s_m - self.first_s_m) / _STEP_M
        x, y, z, heading, bank = (np.interp(row, self._rows, self._columns[number]) for number in (0, 1, 2, 3, 5))
        tilt = -bank * np.clip(d_m, -BANKED_HALF_M, BANKED_HALF_M)
        return np.stack([x - d_m * np.sin(heading), y + d_m * np.cos(heading), z + tilt], axis=-1)


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
        height_m: Their heights above the road's surface, the same shape.
        material: One material, one for each stretch of the section, or one for each cell.
    """
    n = np.shape(d_m)[-1]
    offsets = np.broadcast_to(np.asarray(d_m, dtype=np.float64), (len(s_m), n))
    points = road.point_m(np.repeat(s_m[:, None], n, axis=1), offsets)
    points[..., 2] += height_m
    return grid(points, np.broadcast_to(np.asarray(material, dtype=np.int64), (len(s_m) - 1, n - 1)))
