"""Plants as rays enter them: how dense the leaves stand in each voxel of a crown, a bush, a hedge, a tussock.

A leafy volume is a turbid medium: along a path L a ray meets no leaf with probability exp(-mu L) (Beer and Lambert).
mu = G Omega PAD: PAD the area of leaves and twigs in a cubic metre, G = 0.5 their mean projection (all directions
alike), Omega = 0.6 to 0.9 their clumping. Clipped hedges have a PAD of 6 to 12, bushes 3 to 6, tall grass 2 to 5, a
street tree's crown 0.8 to 2.5, more in its outer half metre and gathered in clumps of 0.2 to 0.4 m. These are customary
figures; the exact ones here were chosen so that roadsides are as thick and as rough as real ones
(``benchmarks/roadside.py``). Outlines are displaced by noise of 0.1 to 0.4 m, and 10 to 30 % of the blobs are left out.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh

VOXEL_M = 0.16
"""Edge of a voxel of one density: four of the cells in which leaves stand or not."""
DENSITY_PER_M = 0.05
"""What one step of a voxel's value above ``AIR`` adds to mu."""
OUTSIDE, AIR = 0, 1
"""Values of voxels outside a plant, and of gaps within it: a radar's wave is weakened there too."""

_HEDGE_PER_M, _BUSH_PER_M, _CONIFER_PER_M, _GRASS_PER_M = (3.5, 6.0), (2.5, 4.5), (1.2, 2.4), (1.5, 2.5)
_CROWN_PER_M, _SHELL_PER_M, _SHELL_M = 0.7, 1.3, 0.5
_CLUMPS = 0.3  # share of a crown that its clumps fill
_GAPS = (0.1, 0.3)  # share of blobs left out


@dataclass(frozen=True, eq=False)
class Leaves:
    """Density of leaves on a grid of voxels in the plant's own frame: z up, its foot at the origin.

    Args:
        value: ``OUTSIDE``, or 1 + mu / ``DENSITY_PER_M``, shape (x, y, z).
        low_m: Lowest corner of the grid, shape (3,).
    """

    value: UInt8[np.ndarray, "x y z"]
    low_m: Float[np.ndarray, " 3"]

    @classmethod
    def of(cls, per_m: Float[np.ndarray, "x y z"], inside: np.ndarray, low_m: Float[np.ndarray, " 3"]) -> "Leaves":
        """From mu in 1/m of each voxel, and which voxels lie within the plant; the grid is cut to those."""
        spans = [np.flatnonzero(inside.any(axis=axes))[[0, -1]] + [0, 1] for axes in ((1, 2), (0, 2), (0, 1))]
        cut = tuple(slice(int(first), int(last)) for first, last in spans)
        steps = np.clip(np.round(per_m[cut] / DENSITY_PER_M), 0, 254).astype(np.uint8)
        value = np.where(inside[cut], AIR + steps, OUTSIDE).astype(np.uint8)
        return cls(np.ascontiguousarray(value), low_m + VOXEL_M * np.array([first for first, _ in spans]))

    @property
    def high_m(self) -> Float[np.ndarray, " 3"]:
        """Highest corner of the grid."""
        return self.low_m + VOXEL_M * np.array(self.value.shape)

    @property
    def per_m(self) -> Float[np.ndarray, "x y z"]:
        """Density mu of each voxel, 1/m."""
        return DENSITY_PER_M * np.maximum(self.value.astype(np.float64) - AIR, 0.0)


@dataclass(frozen=True, eq=False)
class Plant:
    """A plant's leaves, and what of it is opaque and thin: its trunk; no triangles where it has none."""

    leaves: Leaves
    wood: Mesh


def _grid(
    low_m: np.ndarray, high_m: np.ndarray
) -> tuple[Float[np.ndarray, " 3"], tuple[Float[np.ndarray, "..."], ...]]:
    """Lowest corner of a grid about a span, and the coordinates of its voxels' middles."""
    count = np.ceil((high_m - low_m) / VOXEL_M).astype(int)
    axes = [low + VOXEL_M * (np.arange(n) + 0.5) for low, n in zip(low_m, count, strict=True)]
    return np.asarray(low_m, dtype=np.float64), tuple(np.meshgrid(*axes, indexing="ij", sparse=True))


def _noise(shape: tuple[int, ...], size_m: float, rng: np.random.Generator) -> Float[np.ndarray, "x y z"]:
    """Smooth noise of blobs of a size; deviation 1."""
    smooth = gaussian_filter(rng.standard_normal(shape, dtype=np.float32), 0.4 * size_m / VOXEL_M, mode="wrap")
    return smooth / max(float(smooth.std()), 1e-6)


def _outline_m(shape: tuple[int, ...], amplitude_m: float, rng: np.random.Generator) -> Float[np.ndarray, "x y z"]:
    """How far the boundary is displaced: noise of two sizes, the smaller with half of the strength."""
    return amplitude_m * (_noise(shape, 1.0, rng) + 0.5 * _noise(shape, 0.4, rng)) / 1.12


def _blobs_left_out(shape: tuple[int, ...], share: float, rng: np.random.Generator) -> np.ndarray:
    blobs = _noise(shape, 0.3, rng)
    return blobs < np.quantile(blobs, share)


def _filled(
    distance_m: Float[np.ndarray, "x y z"],
    low_m: Float[np.ndarray, " 3"],
    per_m: float,
    amplitude_m: float,
    rng: np.random.Generator,
) -> Leaves:
    """Leaves of about one density within a surface (``distance_m`` < 0), with a ragged outline and gaps."""
    shape = distance_m.shape
    inside = distance_m + _outline_m(shape, amplitude_m, rng) < 0
    inside |= distance_m <= distance_m.min()  # of the smallest plants too something is left
    gaps = _blobs_left_out(shape, float(rng.uniform(*_GAPS)), rng)
    density = per_m * np.exp(0.25 * _noise(shape, 0.5, rng))
    return Leaves.of(np.where(gaps, 0.0, density), inside, low_m)


def hedge(length_m: float, thick_m: float, height_m: float, rng: np.random.Generator) -> Leaves:
    """A clipped hedge along x, its middle at the origin; it reaches 0.4 m into the ground for slopes."""
    x_m, y_m = length_m / 2, thick_m / 2 + 0.3
    low_m, (x, y, z) = _grid(np.array([-x_m, -y_m, -0.4]), np.array([x_m, y_m, height_m + 0.3]))
    distance_m = np.maximum(np.abs(y) - thick_m / 2, z - height_m) + 0 * x
    return _filled(distance_m, low_m, float(rng.uniform(*_HEDGE_PER_M)), 0.1, rng)


def bush(model: Mesh, rng: np.random.Generator) -> Plant:
    """A shrub of three to five lobes on the ground, about as large as a shrub of facets."""
    return _shrub(np.ptp(model.vertices_m, axis=0) / 2, rng)


def shrub(radius_m: float, rng: np.random.Generator) -> Plant:
    """A shrub of about a radius, as high as it is wide or half as high."""
    return _shrub(radius_m * np.array([1.0, rng.uniform(0.7, 1.0), rng.uniform(0.5, 1.0)]), rng)


def _shrub(radii: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Plant:
    low_m, (x, y, z) = _grid(
        np.array([*(-1.3 * radii[:2] - 0.3), -0.2]), np.array([*(1.3 * radii[:2] + 0.3), 2.2 * radii[2] + 0.3])
    )
    distance_m = np.full(np.broadcast_shapes(x.shape, y.shape, z.shape), np.inf)
    for _ in range(int(rng.integers(3, 6))):
        share, middle = rng.uniform(0.5, 0.85, 3), rng.uniform(-0.45, 0.45, 2) * radii[:2]
        a, b, c = share * radii
        level = np.sqrt(((x - middle[0]) / a) ** 2 + ((y - middle[1]) / b) ** 2 + ((z - c) / c) ** 2)
        distance_m = np.minimum(distance_m, (level - 1) * min(a, b, c))
    return Plant(_filled(distance_m, low_m, float(rng.uniform(*_BUSH_PER_M)), 0.15, rng), Mesh.merge([]))


def tall_grass(length_m: float, width_m: float, height_m: float, rng: np.random.Generator) -> Plant:
    """A strip of tall grass along x: tussocks of many heights up to about ``height_m``."""
    half = np.array([length_m, width_m]) / 2
    low_m, (x, y, z) = _grid(np.array([*-half, -0.32]), np.array([*half, 1.3 * height_m + VOXEL_M]))
    tussocks = 0.75 + 0.35 * _noise((x.shape[0], y.shape[1], 1), 0.5, rng)
    edge = np.clip((half[1] - np.abs(y)) / 0.4, 0.3, 1.0)
    distance_m = z - height_m * tussocks * edge
    return Plant(_filled(distance_m, low_m, float(rng.uniform(*_GRASS_PER_M)), 0.05, rng), Mesh.merge([]))


def tree(model: Mesh, rng: np.random.Generator, *, conifer: bool = False) -> Plant:
    """A tree whose crown rays enter, as high as a tree of facets and on the same trunk.

    Args:
        model: The tree of facets: its bark stays, its height and spread are taken.
        rng: Draws the crown.
        conifer: Whether the crown is a cone down to the ground.
    """
    corners, faces = np.unique(model.faces[model.material == Material.BARK], return_inverse=True)
    wood = Mesh.of(model.vertices_m[corners], faces.reshape(-1, 3), int(Material.BARK))
    height_m = float(model.vertices_m[:, 2].max())
    return Plant(_conifer(height_m, rng) if conifer else _crown(height_m, rng), wood)


def _crown(height_m: float, rng: np.random.Generator) -> Leaves:
    """Five to eight balls about a middle, denser in the outer half metre, the leaves gathered in clumps."""
    spread, radius = 0.17 * height_m, rng.uniform(0.13, 0.22, int(rng.integers(5, 9))) * height_m
    middle = np.column_stack(
        [*rng.uniform(-spread, spread, (2, len(radius))), rng.uniform(0.45, 0.8, len(radius)) * height_m]
    )
    reach = radius[:, None] + 0.4
    low_m, (x, y, z) = _grid((middle - reach).min(axis=0), (middle + reach).max(axis=0))
    distance_m = np.full(np.broadcast_shapes(x.shape, y.shape, z.shape), np.inf, dtype=np.float32)
    for (a, b, c), r in zip(middle, radius, strict=True):
        distance_m = np.minimum(distance_m, np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) - r)
    distance_m = distance_m + _outline_m(distance_m.shape, float(rng.uniform(0.15, 0.35)), rng)
    mean = np.where(distance_m > -_SHELL_M, _SHELL_PER_M, _CROWN_PER_M)
    clumps = ~_blobs_left_out(distance_m.shape, 1 - _CLUMPS, rng)
    return Leaves.of(np.where(clumps, mean / _CLUMPS, 0.0), distance_m < 0, low_m)


def _conifer(height_m: float, rng: np.random.Generator) -> Leaves:
    """A cone down to the ground, its branches in tiers."""
    wide, pitch_m = float(rng.uniform(0.17, 0.23)) * height_m, float(rng.uniform(0.5, 0.8))
    low_m, (x, y, z) = _grid(np.array([-wide - 0.3, -wide - 0.3, 0.0]), np.array([wide + 0.3, wide + 0.3, height_m]))
    tier = 0.25 * np.abs((z / pitch_m) % 1.0 - 0.5)
    distance_m = np.hypot(x, y) - wide * (1 - z / height_m) * np.clip(z / (0.1 * height_m), 0.2, 1.0) + tier
    return _filled(distance_m, low_m, float(rng.uniform(*_CONIFER_PER_M)), 0.2, rng)
