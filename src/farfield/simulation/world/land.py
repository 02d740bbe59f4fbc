"""The ground: a section of strips swept along the road, and the land beyond it, without gaps or folds."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from farfield.simulation.bodies.mesh import Mesh, quads
from farfield.simulation.world.road import RoadLine, ribbon

_CELL_M = 16.0
_SAMPLE_M = 4.0
LAND_REACH_M = 300.0


@dataclass(frozen=True)
class Strip:
    """One strip of ground, from the reference line outwards.

    Args:
        width_m: Its width.
        material: What it is made of.
        rise_m: How much higher its outer edge lies than its inner one.
        rough_m: Amplitude of the height noise at its outer edge.
    """

    width_m: float
    material: int
    rise_m: float = 0.0
    rough_m: float = 0.0


@dataclass(frozen=True)
class FarLand:
    """What lies beyond the strips of one side.

    Args:
        material: What it is made of.
        slope: Rise per metre outwards, over the first 80 m.
        hills_m: Amplitude of its hills.
    """

    material: int
    slope: float = 0.0
    hills_m: float = 0.6


class HeightNoise:
    """A smooth height field over (s, d): waves of 9 to 60 m, of standard deviation about 1."""

    def __init__(self, rng: np.random.Generator, *, shortest_m: float = 9.0, longest_m: float = 60.0) -> None:
        turn, length = rng.uniform(0, 2 * np.pi, (2, 7)), np.geomspace(shortest_m, longest_m, 7)
        self._wave = 2 * np.pi / length * np.stack([np.cos(turn[0]), np.sin(turn[0])])
        self._phase, self._share = turn[1], np.sqrt(length / length.sum() * 2)

    def __call__(
        self, s_m: Float[np.ndarray, "*shape"], d_m: Float[np.ndarray, "*shape"]
    ) -> Float[np.ndarray, "*shape"]:
        """Heights at some places."""
        angle = s_m[..., None] * self._wave[0] + d_m[..., None] * self._wave[1] + self._phase
        return np.asarray(np.sin(angle) @ self._share)


class Land:
    """The ground of one scene.

    Args:
        road: The reference line.
        right: Strips from the reference line to the right.
        left: Strips from the reference line to the left.
        far: What lies beyond, right and left.
        rng: Draws the height noise.
        below_m: How far below the strips the land reaches under their edges; steep sections need more.
    """

    def __init__(
        self,
        road: RoadLine,
        right: Sequence[Strip],
        left: Sequence[Strip],
        far: tuple[FarLand, FarLand],
        rng: np.random.Generator,
        below_m: float = 0.15,
    ) -> None:
        self.road, self.far, self._below_m = road, far, below_m
        self._noise, self._hills = HeightNoise(rng), HeightNoise(rng, shortest_m=50.0, longest_m=220.0)

        self.d_m = np.concatenate([-_edges(right, "width_m")[::-1], [0.0], _edges(left, "width_m")])
        self.z_m = np.concatenate([_edges(right, "rise_m")[::-1], [0.0], _edges(left, "rise_m")])
        self.rough_m = np.array([*(r.rough_m for r in right[::-1]), 0.0, *(r.rough_m for r in left)])
        self.material = np.array([*(r.material for r in right[::-1]), *(r.material for r in left)])

    def rise_m(self, s_m: Float[np.ndarray, "*shape"], d_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Height of the ground over the road's surface carried on to both sides; exact at the strips' edges."""
        inside = np.interp(d_m, self.d_m, self.z_m) + np.interp(d_m, self.d_m, self.rough_m) * self._noise(s_m, d_m)
        out = np.zeros_like(inside)
        for land, beyond in zip(self.far, (self.d_m[0] - d_m, d_m - self.d_m[-1]), strict=True):
            grown = np.clip(beyond / 60.0, 0.0, 1.0)
            out += np.where(
                beyond > 0, land.slope * np.clip(beyond, 0, 80) + land.hills_m * grown * self._hills(s_m, d_m), 0
            )
        return np.asarray(inside + out)

    def open_share(self, s_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """How much of the ground beside the road is open, not paved across, at some stations: all of it."""
        return np.ones_like(s_m)

    def section(
        self, s_m: Float[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, "k n"], Int[np.ndarray, "k1 n1"] | Int[np.ndarray, " n1"]]:
        """Heights of the strips' edges at some stations, and the materials between."""
        s, d = np.broadcast_arrays(s_m[:, None], self.d_m)
        return self.rise_m(s, d), self.material

    def strips(self, s_m: Float[np.ndarray, " k"]) -> Mesh:
        """The strips over the given stations."""
        height, material = self.section(s_m)
        return ribbon(self.road, s_m, self.d_m, height, material)

    def stand(self, model: Mesh, s_m: float, d_m: float, *, turn_rad: float = 0.0, raise_m: float = 0.0) -> Mesh:
        """Put an object on the ground at (s, d), its x axis along the road (turned by ``turn_rad``)."""
        s, d = np.array(s_m), np.array(d_m)
        x, y, z = self.road.point_m(s, d) + np.array([0.0, 0.0, raise_m])
        height = float(z + self.rise_m(s[None], d[None])[0])
        return model.placed(float(x), float(y), height, yaw_rad=float(self.road.heading_rad(s)) + turn_rad)

    @cached_property
    def _samples(self) -> tuple[Float[np.ndarray, " n"], cKDTree]:
        s = np.arange(self.road.first_s_m, self.road.last_s_m, _SAMPLE_M)
        return s, cKDTree(self.road.point_m(s, 0.0)[:, :2])

    def locate(self, xy_m: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """(s, d) of places in the world by the nearest point of the road."""
        stations, tree = self._samples
        s = stations[tree.query(xy_m)[1]]
        offset, heading = xy_m - self.road.point_m(s, 0.0)[:, :2], self.road.heading_rad(s)
        return s, np.hypot(*offset.T) * np.where(
            offset[:, 1] * np.cos(heading) > offset[:, 0] * np.sin(heading), 1.0, -1.0
        )

    def beyond(self, first_m: float, last_m: float) -> Mesh:
        """The land nearest to a stretch of the road, out to ``LAND_REACH_M``: a grid fixed in the world."""
        along = self.road.point_m(np.arange(first_m, last_m + 1.0, 20.0), 0.0)[:, :2]
        low = np.floor((along.min(axis=0) - LAND_REACH_M) / _CELL_M).astype(np.int64)
        high = np.ceil((along.max(axis=0) + LAND_REACH_M) / _CELL_M).astype(np.int64)
        node = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
        shape = node.shape[:2]
        xy = node.reshape(-1, 2) * _CELL_M
        s, d = self.locate(xy)
        under = (d > self.d_m[0] - 1.0) & (d < self.d_m[-1] + 1.0)
        z = self.road.point_m(s, d)[:, 2] + self.rise_m(s, d) - np.where(under, self._below_m, 0.0)
        points = np.concatenate([xy, z[:, None]], axis=1).reshape(*shape, 3)
        own_s, own_d = self.locate((xy.reshape(*shape, 2)[:-1, :-1] + _CELL_M / 2).reshape(-1, 2))
        nearest = (own_s >= first_m) & (own_s < last_m) & (np.abs(own_d) < LAND_REACH_M)
        nearest &= (own_d < self.d_m[0] + 0.75 * _CELL_M) | (own_d > self.d_m[-1] - 0.75 * _CELL_M)
        corners = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2)
        side = np.where(own_d < 0, self.far[0].material, self.far[1].material)
        return quads(corners.reshape(-1, 4, 3)[nearest], side[nearest])


def _edges(strips: Sequence[Strip], name: str) -> Float[np.ndarray, " n"]:
    return np.cumsum([getattr(strip, name) for strip in strips])
