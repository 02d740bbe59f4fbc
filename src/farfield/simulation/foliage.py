"""Rays through plants: which leaf each ray meets first, the same leaf for every beam, sweep and sensor.

Leaves stand in cells of 4 cm. A cell has a number u in [0, 1), a hash of the plant, the cell and the world's seed, and
a ray whose path through the cell is l long meets a leaf there if u < 1 - exp(-mu l), at the depth -ln(1 - u) / mu. So
the share of rays that pass obeys Beer's and Lambert's law, and nothing is drawn: two rays through one cell agree. The
hash is splitmix64 (Steele, Lea and Flood 2014: "Fast splittable pseudorandom number generators").
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32, Int32

from farfield.errors import MissingExtraError
from farfield.simulation.bodies.materials import SURFACES, Material
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.bodies.plants import AIR, DENSITY_PER_M, OUTSIDE, VOXEL_M, Leaves
from farfield.simulation.trace import Caster, RayHits, corners_of

try:
    from numba import njit
except ImportError as error:
    raise MissingExtraError("numba", "simulate", "Rays through plants") from error

CELL_M = 0.04
_SORTED_M = 8.0  # plants are sorted into squares of the ground of this size
_LEAF_TURNS = 32  # directions that leaves face


@dataclass(frozen=True, eq=False)
class PlacedLeaves:
    """A plant's leaves in the world.

    Args:
        leaves: Its leaves in its own frame.
        number: Its number in the world, by which its cells are hashed.
        axes_m: Its origin and the ends of its x and y axes, 1 m long and level, shape (3, 3); they may be mirrored.
        reflectance: Of its leaves at 1550 nm.
        tint: Where in the range of leaves' colours it lies, in [0, 1).
    """

    leaves: Leaves
    number: int
    axes_m: Float[np.ndarray, "3 3"]
    reflectance: float
    tint: float


def leaf_reflectances(count: int, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Reflectances at 1550 nm of so many plants."""
    surface = SURFACES[Material.FOLIAGE]
    return np.clip(surface.reflectance * np.exp(surface.spread * rng.standard_normal(count)), 0.03, 1.0)


class Foliage(Caster):
    """The leaves of all plants of a stretch of road, as something that rays may hit.

    Args:
        plants: The plants; at least one.
        seed: The world's, below 2^64.
        anchor_m: A point near the rays' origins.
    """

    is_turbid = True

    def __init__(self, plants: Sequence[PlacedLeaves], *, seed: int, anchor_m: Float[np.ndarray, " 3"]) -> None:
        self.anchor_m = anchor_m
        self.mesh = _leaf_mesh(plants)
        self.level = np.zeros(len(self.mesh.faces), dtype=bool)
        corner = self.mesh.vertices_m[self.mesh.faces]
        self._normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        self._normal /= np.linalg.norm(self._normal, axis=1, keepdims=True)
        self._tables, self.corners_m = _tables(plants, seed, anchor_m)

    def cast_anchored(
        self,
        origins_m: Float32[np.ndarray, "n 3"],
        directions: Float32[np.ndarray, "n 3"],
        within_m: Float32[np.ndarray, " n"] | None = None,
    ) -> RayHits:
        """The first leaf of each ray; see :meth:`farfield.simulation.trace.Caster.cast_anchored`."""
        range_m, face, _ = self._run(origins_m, directions, within_m, pierce=False)
        hit = np.flatnonzero(face >= 0)
        cosine = np.zeros(len(directions), dtype=np.float32)
        cosine[hit] = np.abs(np.einsum("ij,ij->i", self._normal[face[hit]], directions[hit]))
        return RayHits(range_m, face, cosine)

    def paths_m(
        self,
        origin_m: Float[np.ndarray, " 3"],
        directions: Float[np.ndarray, "n 3"],
        within_m: Float[np.ndarray, " n"],
    ) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Paths within plants and entries; see :meth:`farfield.simulation.trace.Caster.paths_m`."""
        rays = np.ascontiguousarray(directions, dtype=np.float32)
        starts = np.ascontiguousarray(np.broadcast_to((origin_m - self.anchor_m).astype(np.float32), rays.shape))
        entry_m, _, path_m = self._run(starts, rays, within_m, pierce=True)
        return path_m, entry_m

    def _run(
        self,
        starts: Float32[np.ndarray, "n 3"],
        rays: Float32[np.ndarray, "n 3"],
        within_m: Float[np.ndarray, " n"] | None,
        *,
        pierce: bool,
    ) -> tuple[Float32[np.ndarray, " n"], Int32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        reach = np.broadcast_to(np.float32(np.inf) if within_m is None else within_m, len(rays))
        out_m, path_m = np.empty((2, len(rays)), dtype=np.float32)
        face = np.empty(len(rays), dtype=np.int32)
        _first_leaves(
            starts, rays, np.ascontiguousarray(reach, dtype=np.float32), pierce, *self._tables, out_m, face, path_m
        )
        return out_m, face, path_m


def _leaf_mesh(plants: Sequence[PlacedLeaves]) -> Mesh:
    """Stands for the leaves where triangles are looked up: of each plant, one of each direction that leaves face."""
    spiral = np.arange(_LEAF_TURNS) + 0.5
    up, turn = 1 - 2 * spiral / _LEAF_TURNS, np.pi * (1 + np.sqrt(5)) * spiral
    normal = np.stack([np.sqrt(1 - up**2) * np.cos(turn), np.sqrt(1 - up**2) * np.sin(turn), up], axis=1)
    side = np.cross(normal, [0.36, 0.48, 0.8])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    triangles = CELL_M * np.stack([0 * side, side, np.cross(normal, side)], axis=1)
    foot = np.stack([plant.axes_m[0] for plant in plants])
    axes = np.stack([[*(plant.axes_m[1:] - plant.axes_m[0]), [0.0, 0.0, 1.0]] for plant in plants])  # may be mirrored
    vertices = (foot[:, None, None] + np.einsum("tci,pij->ptcj", triangles, axes)).reshape(-1, 3)
    count = len(plants) * _LEAF_TURNS
    return Mesh(
        vertices,
        np.arange(3 * count).reshape(-1, 3),
        np.full(count, int(Material.FOLIAGE)),
        np.repeat([plant.reflectance for plant in plants], _LEAF_TURNS),
        np.repeat(np.array([plant.tint for plant in plants], dtype=np.float32), _LEAF_TURNS),
    )


def _tables(
    plants: Sequence[PlacedLeaves], seed: int, anchor_m: Float[np.ndarray, " 3"]
) -> tuple[tuple[np.ndarray, ...], Float[np.ndarray, "8 3"]]:
    """What the kernel reads: voxels, plants, and the plants of each square of the ground; and all plants' bounds."""
    models = {id(plant.leaves): plant.leaves for plant in plants}
    row = {key: index for index, key in enumerate(models)}
    sizes = [leaves.value.size for leaves in models.values()]
    voxels = np.concatenate([leaves.value.reshape(-1) for leaves in models.values()])
    begin = np.cumsum([0, *sizes[:-1]])
    shape = np.array([leaves.value.shape for leaves in models.values()])
    low = np.array([leaves.low_m for leaves in models.values()])
    model = np.array([row[id(plant.leaves)] for plant in plants])
    axes = np.stack([plant.axes_m for plant in plants])
    foot_m, turn = axes[:, 0] - anchor_m, axes[:, 1:, :2] - axes[:, :1, :2]
    key = np.array([_mixed(seed ^ _mixed(plant.number + 1)) for plant in plants], dtype=np.uint64)

    ends = np.stack([low[model], low[model] + VOXEL_M * shape[model]], axis=1)
    square = np.stack([ends[:, [0, 1, 0, 1], 0], ends[:, [0, 0, 1, 1], 1]], axis=2) @ turn + foot_m[:, None, :2]
    lower, upper = square.min(axis=1), square.max(axis=1)
    height = ends[:, :, 2] + foot_m[:, 2:]
    corner = np.floor(lower.min(axis=0) / _SORTED_M)
    first = (np.floor(lower / _SORTED_M) - corner).astype(np.int64)
    last = (np.floor(upper / _SORTED_M) - corner).astype(np.int64)
    count = last.max(axis=0) + 1
    pairs = np.array(
        [
            (x * count[1] + y, plant)
            for plant in range(len(plants))
            for x in range(first[plant, 0], last[plant, 0] + 1)
            for y in range(first[plant, 1], last[plant, 1] + 1)
        ],
        dtype=np.int64,
    )
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    starts = np.searchsorted(pairs[:, 0], np.arange(int(count.prod()) + 1))
    top = np.full(int(count.prod()), -np.inf)
    bottom = np.full(int(count.prod()), np.inf)
    np.maximum.at(top, pairs[:, 0], height[pairs[:, 1], 1])
    np.minimum.at(bottom, pairs[:, 0], height[pairs[:, 1], 0])
    shift, middle = np.array([*corner * _SORTED_M, 0.0]), (lower + upper) / 2
    radius = np.sqrt(np.square(square - middle[:, None]).sum(axis=2).max(axis=1))
    circle = np.column_stack([middle - shift[:2], radius, height])
    bounds = np.array([[*lower.min(axis=0), height.min()], [*upper.max(axis=0), height.max()]])
    tables = (
        voxels, begin, shape, low, model, foot_m - shift, turn.reshape(-1, 4), key, circle,
        corner * _SORTED_M, count, starts, pairs[:, 1].copy(), bottom, top,
    )  # fmt: skip
    return tables, corners_of(bounds + anchor_m)


_WORD = 2**64 - 1


def _mixed(word: int) -> int:
    """splitmix64 of a word."""
    z = (word + 0x9E3779B97F4A7C15) & _WORD
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _WORD
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _WORD
    return z ^ (z >> 31)


_VOXEL, _CELL, _STEP = VOXEL_M, CELL_M, DENSITY_PER_M
_EMPTY, _GAP, _TURNS, _SQUARE = OUTSIDE, AIR, _LEAF_TURNS, _SORTED_M
_PER_VOXEL = round(VOXEL_M / CELL_M)
_NUDGE = 1e-4


@njit("uint64(uint64, int64, int64, int64)", cache=True)
@no_type_check
def cell_hash(key, x, y, z):
    """splitmix64 of a plant's key and a cell's indices."""
    index = np.uint64(x) | (np.uint64(y) << np.uint64(20)) | (np.uint64(z) << np.uint64(40))
    h = key + index * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x9E3779B97F4A7C15)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


@njit(cache=True, error_model="numpy")
@no_type_check
def _index(at, size, low, high):
    """The interval of a size in which a coordinate lies, among those from low to high."""
    return min(max(int(np.floor(at / size)), low), high)


@njit(cache=True, error_model="numpy")
@no_type_check
def _leave(o, d, index, size):
    """Where along a ray an interval of a coordinate ends."""
    if d > 0.0:
        return ((index + 1) * size - o) / d
    return (index * size - o) / d if d < 0.0 else np.inf


@njit(cache=True, error_model="numpy")
@no_type_check
def _leaf_in_voxel(ox, oy, oz, dx, dy, dz, begin, end, vx, vy, vz, density, key, first):
    """Distance of the first leaf among a voxel's cells along a ray (inf: none), and which way that leaf faces."""
    s, n = begin, _PER_VOXEL
    at = begin + _NUDGE
    x = _index(ox + dx * at, _CELL, vx * n, vx * n + n - 1)
    y = _index(oy + dy * at, _CELL, vy * n, vy * n + n - 1)
    z = _index(oz + dz * at, _CELL, vz * n, vz * n + n - 1)
    tx, ty, tz = _leave(ox, dx, x, _CELL), _leave(oy, dy, y, _CELL), _leave(oz, dz, z, _CELL)
    while True:
        leave = min(min(tx, ty), min(tz, end))
        depth = density * (leave - s)
        h = cell_hash(key, x, y, z)
        u = np.float64(h >> np.uint64(11)) * (1.0 / 9007199254740992.0)
        if u < depth and u < 1.0 - np.exp(-depth) and not (first and s == 0.0):  # a ray leaves its own leaf behind
            return s - np.log(1.0 - u) / density, int(h & np.uint64(_TURNS - 1))
        if leave >= end:
            return np.inf, 0
        if leave == tx:
            x += 1 if dx > 0.0 else -1
            tx = _leave(ox, dx, x, _CELL)
        elif leave == ty:
            y += 1 if dy > 0.0 else -1
            ty = _leave(oy, dy, y, _CELL)
        else:
            z += 1 if dz > 0.0 else -1
            tz = _leave(oz, dz, z, _CELL)
        s = max(s, leave)


@njit(cache=True, error_model="numpy")
@no_type_check
def _span(o, d, width, begin, end):
    """The part of a span of a ray that lies between 0 and a width of one coordinate; empty where it misses."""
    if d == 0.0:
        return (begin, end) if 0.0 <= o <= width else (1.0, 0.0)
    a, b = -o / d, (width - o) / d
    return max(begin, min(a, b)), min(end, max(a, b))


@njit(cache=True, error_model="numpy")
@no_type_check
def _through(ox, oy, oz, dx, dy, dz, voxels, offset, nx, ny, nz, key, reach, pierce):
    """One ray through one plant: (distance of its first leaf, its turn); to pierce, (path within it, entry)."""
    t, end = _span(ox, dx, nx * _VOXEL, 0.0, reach)
    t, end = _span(oy, dy, ny * _VOXEL, t, end)
    t, end = _span(oz, dz, nz * _VOXEL, t, end)
    path, entry, first = 0.0, np.inf, t == 0.0
    if t >= end:
        return (path, entry) if pierce else (np.inf, 0.0)
    at = t + _NUDGE
    x, y, z = (
        _index(ox + dx * at, _VOXEL, 0, nx - 1), _index(oy + dy * at, _VOXEL, 0, ny - 1),
        _index(oz + dz * at, _VOXEL, 0, nz - 1),
    )  # fmt: skip
    tx, ty, tz = _leave(ox, dx, x, _VOXEL), _leave(oy, dy, y, _VOXEL), _leave(oz, dz, z, _VOXEL)
    while True:
        leave = min(min(tx, ty), min(tz, end))
        value = voxels[offset + (x * ny + y) * nz + z]
        if pierce:
            if value != _EMPTY:
                path, entry = path + leave - t, min(entry, t)
        elif value > _GAP and leave > t:
            density = (value - _GAP) * _STEP
            leaf_m, turn = _leaf_in_voxel(ox, oy, oz, dx, dy, dz, t, leave, x, y, z, density, key, first)
            if leaf_m < reach:
                return leaf_m, float(turn)
        if leave >= end:
            break
        if leave == tx:
            x += 1 if dx > 0.0 else -1
            if x < 0 or x >= nx:
                break
            tx = _leave(ox, dx, x, _VOXEL)
        elif leave == ty:
            y += 1 if dy > 0.0 else -1
            if y < 0 or y >= ny:
                break
            ty = _leave(oy, dy, y, _VOXEL)
        else:
            z += 1 if dz > 0.0 else -1
            if z < 0 or z >= nz:
                break
            tz = _leave(oz, dz, z, _VOXEL)
        t = max(t, leave)
    return (path, entry) if pierce else (np.inf, 0.0)


@njit(cache=True, error_model="numpy")
@no_type_check
def _first_leaves(starts, directions, within, pierce, voxels, begin, model_shape, low, model, foot_m, turn, key, circle,
                  corner, count, square_start, square_plants, bottom, top, out_m, out_face, out_path_m):  # fmt: skip
    """For every ray the distance and face of its first leaf; to pierce, where it enters plants and its path there."""
    tested = np.full(len(model), -1, np.int64)
    nx, ny, lowest, highest = count[0], count[1], bottom.min(), top.max()
    for ray in range(directions.shape[0]):
        dx, dy, dz = float(directions[ray, 0]), float(directions[ray, 1]), float(directions[ray, 2])
        ox, oy, oz = starts[ray, 0] - corner[0], starts[ray, 1] - corner[1], float(starts[ray, 2])
        best, face, path, entry = float(within[ray]), -1, 0.0, np.inf
        # the span of the ray over the squares in which plants are sorted
        t, end = _span(ox, dx, nx * _SQUARE, 0.0, best)
        t, end = _span(oy, dy, ny * _SQUARE, t, end)
        t, end = _span(oz - lowest, dz, highest - lowest, t, end)
        walks = t < end
        per_level = 1.0 / max(np.sqrt(dx * dx + dy * dy), 1e-9)
        slope = dz * per_level
        x, y = _index(ox + dx * t, _SQUARE, 0, nx - 1), _index(oy + dy * t, _SQUARE, 0, ny - 1)
        tx, ty = _leave(ox, dx, x, _SQUARE), _leave(oy, dy, y, _SQUARE)
        while walks:
            leave, square = min(min(tx, ty), end), x * ny + y
            near_m, far_m = oz + dz * t, oz + dz * leave
            if max(near_m, far_m) > bottom[square] and min(near_m, far_m) < top[square]:
                for item in range(square_start[square], square_start[square + 1]):
                    plant = square_plants[item]
                    if tested[plant] == ray:
                        continue
                    # the upright cylinder about the plant
                    cx, cy, radius = circle[plant, 0] - ox, circle[plant, 1] - oy, circle[plant, 2]
                    aside = (dx * cy - dy * cx) * per_level
                    if abs(aside) > radius:
                        continue
                    along = (dx * cx + dy * cy) * per_level
                    near_m = oz + slope * max(along - radius, 0.0)
                    far_m = oz + slope * (along + radius)
                    if max(near_m, far_m) < circle[plant, 3] or min(near_m, far_m) > circle[plant, 4]:
                        continue
                    tested[plant] = ray
                    m = model[plant]
                    px, py = ox - foot_m[plant, 0], oy - foot_m[plant, 1]
                    at, more = _through(
                        turn[plant, 0] * px + turn[plant, 1] * py - low[m, 0],
                        turn[plant, 2] * px + turn[plant, 3] * py - low[m, 1],
                        oz - foot_m[plant, 2] - low[m, 2],
                        turn[plant, 0] * dx + turn[plant, 1] * dy, turn[plant, 2] * dx + turn[plant, 3] * dy, dz,
                        voxels, begin[m], model_shape[m, 0], model_shape[m, 1], model_shape[m, 2], key[plant],
                        best, pierce,
                    )  # fmt: skip
                    if pierce:
                        path, entry = path + at, min(entry, more)
                    elif at < best:
                        best, face = at, plant * _TURNS + int(more)
            if leave >= end or leave >= best:
                break
            if leave == tx:
                x += 1 if dx > 0.0 else -1
                walks = 0 <= x < nx
                tx = _leave(ox, dx, x, _SQUARE)
            else:
                y += 1 if dy > 0.0 else -1
                walks = 0 <= y < ny
                ty = _leave(oy, dy, y, _SQUARE)
            t = leave
        if pierce:
            out_m[ray], out_path_m[ray] = entry, path
        else:
            out_m[ray], out_face[ray] = best if face >= 0 else np.inf, face
