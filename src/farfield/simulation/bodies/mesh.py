"""Triangle meshes and the few primitives that all objects are built from."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from jaxtyping import Float, Float32, Int

from farfield.simulation.bodies.materials import Material, draw_reflectance

Triple = Sequence[float | int]  # x, y, z

_UNTINTED = np.zeros(0, dtype=np.float32)
_BOX_ENDS = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]])
_BOX_SIDES = np.array([[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]])
_BOX_FACES = np.concatenate([_BOX_ENDS, _BOX_SIDES])
_BOX_SIGNS = np.array(
    [[1, 1, -1], [-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]]
)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with a material and a reflectance each.

    Args:
        vertices_m: Vertices, shape (v, 3), metres.
        faces: Vertex indices of each triangle, shape (f, 3).
        material: Material of each triangle, shape (f,).
        reflectance: Diffuse reflectance of each triangle, shape (f,); NaN until ``painted``.
        tint: Where in its material's range of colours each triangle lies, in [0, 1), shape (f,); one value for each
            material of an object, 0 until ``painted``.
    """

    vertices_m: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    material: Int[np.ndarray, " f"]
    reflectance: Float[np.ndarray, " f"]
    tint: Float32[np.ndarray, " f"] = field(default_factory=lambda: _UNTINTED)

    def __post_init__(self) -> None:
        if self.tint is _UNTINTED:
            object.__setattr__(self, "tint", np.zeros(len(self.faces), dtype=np.float32))

    @classmethod
    def of(
        cls,
        vertices_m: Float[np.ndarray, "v 3"],
        faces: Int[np.ndarray, "f 3"],
        material: Int[np.ndarray, " f"] | int,
    ) -> "Mesh":
        """Make a mesh without reflectances; one material may stand for all faces."""
        materials = np.broadcast_to(np.asarray(material, dtype=np.int64), (len(faces),)).copy()
        return cls(np.asarray(vertices_m, dtype=np.float64), faces, materials, np.full(len(faces), np.nan))

    @classmethod
    def merge(cls, parts: Sequence["Mesh"]) -> "Mesh":
        """Join meshes into one."""
        if not parts:
            return cls.of(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), 0)
        offsets = np.cumsum([0] + [len(part.vertices_m) for part in parts[:-1]])
        return cls(
            np.concatenate([part.vertices_m for part in parts]),
            np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
            np.concatenate([part.material for part in parts]),
            np.concatenate([part.reflectance for part in parts]),
            np.concatenate([part.tint for part in parts]),
        )

    def painted(self, rng: np.random.Generator) -> "Mesh":
        """Draw this object's reflectances and tints, one of each for every material."""
        reflectance = draw_reflectance(self.material, rng)
        tint = rng.random(len(Material), dtype=np.float32)[self.material]
        return replace(self, reflectance=reflectance, tint=tint)

    def mirrored(self) -> "Mesh":
        """The same on the other side of the x-z plane; triangles keep their outer side."""
        return replace(self, vertices_m=self.vertices_m * [1.0, -1.0, 1.0], faces=self.faces[:, ::-1])

    def placed(self, x_m: float, y_m: float, z_m: float = 0.0, *, yaw_rad: float = 0.0) -> "Mesh":
        """Turn about z, then move."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        x, y, z = self.vertices_m.T
        vertices = np.stack([cos * x - sin * y + x_m, sin * x + cos * y + y_m, z + z_m], axis=1)
        return replace(self, vertices_m=vertices)

    def fitted(self, size_m: Float[np.ndarray, " 3"], *, like: "Mesh | None" = None) -> "Mesh":
        """Scale to a length, width and height exactly; the origin becomes the middle of the bottom.

        Args:
            size_m: Length, width, height, shape (3,).
            like: Move and scale as this mesh would be, such as the same body in its widest pose.
        """
        frame = (self if like is None else like).vertices_m
        lower, upper = frame.min(axis=0), frame.max(axis=0)
        middle = np.array([(lower[0] + upper[0]) / 2, (lower[1] + upper[1]) / 2, lower[2]])
        vertices = (self.vertices_m - middle) * (size_m / (upper - lower))
        return replace(self, vertices_m=vertices)


def box(size_m: Triple, centre_m: Triple, material: int) -> Mesh:
    """A box with its faces along the axes (12 triangles)."""
    return Mesh.of(_BOX_SIGNS * np.asarray(size_m) / 2 + np.asarray(centre_m), _BOX_FACES, material)


def quads(corners_m: Float[np.ndarray, "q 4 3"], material: Int[np.ndarray, " q"] | int) -> Mesh:
    """Separate quadrilaterals, two triangles each; corners in order around each of them."""
    first = 4 * np.arange(len(corners_m))[:, None]
    faces = (first + np.array([0, 1, 2, 0, 2, 3])).reshape(-1, 3)
    materials = np.broadcast_to(np.asarray(material, dtype=np.int64), (len(corners_m),))
    return Mesh.of(corners_m.reshape(-1, 3), faces, np.repeat(materials, 2))


def grid(
    points_m: Float[np.ndarray, "k n 3"], material: Int[np.ndarray, "k1 n1"] | int, *, closed: bool = False
) -> Mesh:
    """Surface through k rows of n points; ``closed`` joins each row's end to its beginning.

    Args:
        points_m: Rows of points, shape (k, n, 3).
        material: One material, or one a cell, shape (k - 1, n - 1), or (k - 1, n) when closed.
        closed: Whether the rows are rings.
    """
    k, n = points_m.shape[:2]
    materials = np.broadcast_to(np.asarray(material, dtype=np.int64), (k - 1, n if closed else n - 1))
    return Mesh.of(points_m.reshape(-1, 3), _grid_faces(k, n, closed), np.repeat(materials.reshape(-1), 2))


@cache
def _grid_faces(k: int, n: int, closed: bool) -> Int[np.ndarray, "f 3"]:
    row, column = np.meshgrid(np.arange(k - 1) * n, np.arange(n if closed else n - 1), indexing="ij")
    a, b = row + column, row + (column + 1) % n
    return _kept(np.stack([np.stack([a, b, b + n], -1), np.stack([a, b + n, a + n], -1)], axis=2).reshape(-1, 3))


def _kept(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """Faces that many meshes share: nobody may write into them."""
    faces.flags.writeable = False
    return faces


def fan(ring_m: Float[np.ndarray, "n 3"], material: int) -> Mesh:
    """Close a ring of points with triangles around its middle."""
    return Mesh.of(np.concatenate([ring_m, ring_m.mean(axis=0)[None]]), _fan_faces(len(ring_m)), material)


@cache
def _fan_faces(n: int) -> Int[np.ndarray, "f 3"]:
    index = np.arange(n)
    return _kept(np.stack([index, (index + 1) % n, np.full(n, n)], axis=1))


def loft(rings_m: Float[np.ndarray, "k n 3"], material: Int[np.ndarray, "k1 n"] | int, cap: int) -> Mesh:
    """A closed body through rings of points, with both ends capped: a closed grid and two fans."""
    k, n = rings_m.shape[:2]
    first, last = rings_m[0], rings_m[-1]
    ends = [first, first.mean(axis=0)[None], last, last.mean(axis=0)[None]]
    side = np.broadcast_to(np.asarray(material, dtype=np.int64), (k - 1, n)).reshape(-1)
    return Mesh.of(
        np.concatenate([rings_m.reshape(-1, 3), *ends]),
        _loft_faces(k, n),
        np.concatenate([np.repeat(side, 2), np.full(2 * n, cap, dtype=np.int64)]),
    )


@cache
def _loft_faces(k: int, n: int) -> Int[np.ndarray, "f 3"]:
    fan = _fan_faces(n)
    return _kept(np.concatenate([_grid_faces(k, n, True), fan + k * n, fan + k * n + n + 1]))


def tube(
    start_m: Triple,
    end_m: Triple,
    radius_m: float | tuple[float, float],
    material: int,
    *,
    sides: int = 8,
    round_ends: bool = False,
) -> Mesh:
    """A cylinder or cone frustum between two points; ``round_ends`` makes it a capsule.

    Args:
        start_m: Middle of one end.
        end_m: Middle of the other end.
        radius_m: One radius, or those of the start and the end.
        material: Material of all faces.
        sides: Number of corners of its section.
        round_ends: Add a smaller ring and a tip at each end, inside the given length.
    """
    start, end = np.asarray(start_m, dtype=np.float64), np.asarray(end_m, dtype=np.float64)
    r0, r1 = radius_m if isinstance(radius_m, tuple) else (radius_m, radius_m)
    axis = (end - start) / np.linalg.norm(end - start)
    x, y, z = (float(value) for value in axis)
    side = np.array([y, -x, 0.0] if abs(z) < 0.9 else [0.0, z, -y])
    side /= np.linalg.norm(side)
    u, v, w = (float(value) for value in side)
    angle = 2 * np.pi * np.arange(sides) / sides
    other = np.array([y * w - z * v, z * u - x * w, x * v - y * u])
    circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
    if round_ends:
        centres = [start, start + 0.6 * r0 * axis, end - 0.6 * r1 * axis, end]
        radii = [0.5 * r0, r0, r1, 0.5 * r1]
    else:
        centres, radii = [start, end], [r0, r1]
    rings = np.stack([centre + radius * circle for centre, radius in zip(centres, radii, strict=True)])
    return loft(rings, material, material)


def ring_tube(centre_m: Triple, radius_m: float, thickness_m: float, material: int, *, sides: int = 12) -> Mesh:
    """A standing ring in the x-z plane (a bicycle's tyre): a torus with four-cornered sections."""
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    section = np.array([[0.0, 0.5], [0.5, 0.0], [0.0, -0.5], [-0.5, 0.0]]) * thickness_m
    radius = radius_m - thickness_m / 2 + section[:, 0]
    x = np.cos(angle)[:, None] * radius
    z = np.sin(angle)[:, None] * radius
    y = np.broadcast_to(section[:, 1], x.shape)
    return grid(np.stack([x, y, z], axis=-1) + np.asarray(centre_m), material, closed=True)


def ellipsoid(centre_m: Triple, radii_m: Triple, material: int, *, sides: int = 8, rows: int = 5) -> Mesh:
    """An ellipsoid of ``rows`` rings with ``sides`` corners each."""
    polar = np.linspace(0.0, np.pi, rows + 2)[1:-1]
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    xy = np.sin(polar)[:, None, None] * ring[None]
    z = np.broadcast_to(np.cos(polar)[:, None, None], (rows, sides, 1))
    return loft(np.concatenate([xy, z], axis=2) * np.asarray(radii_m) + np.asarray(centre_m), material, material)


def wheel(x_m: float, outer_y_m: float, radius_m: float, width_m: float) -> Mesh:
    """A wheel that touches the ground at z = 0, its outer side at ``outer_y_m``: tyre, and a metal rim."""
    unit = _unit_wheel()
    side = float(np.sign(outer_y_m))
    vertices = unit.vertices_m * [radius_m, side * width_m, radius_m] + [x_m, outer_y_m, radius_m]
    return replace(unit, vertices_m=vertices)


@cache
def _unit_wheel() -> Mesh:
    """A wheel of radius and width 1: its outer side at y = 0, its middle at z = 0."""
    tyre = tube([0, -1, 0], [0, 0, 0], 1.0, Material.TYRE, sides=12)
    rim = tube([0, 0, 0], [0, 0.02, 0], 0.55, Material.METAL, sides=8)
    return Mesh.merge([tyre, rim])
