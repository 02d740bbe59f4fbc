"""What stands beside the road: barriers, poles, signs, trees, walls, buildings, bridges."""

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, ellipsoid, quads, tube
from farfield.simulation.world.road import RoadLine, ribbon

_SQUARE = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2


def stand(mesh: Mesh, road: RoadLine, s_m: float, d_m: float, *, turn_rad: float = 0.0, raise_m: float = 0.0) -> Mesh:
    """Put an object on the road's surface at (s, d), its x axis along the road (turned by ``turn_rad``)."""
    place = np.array(s_m)
    x, y, z = road.point_m(place, d_m)
    return mesh.placed(float(x), float(y), float(z) + raise_m, yaw_rad=float(road.heading_rad(place)) + turn_rad)


def jersey_barrier(road: RoadLine, s_m: Float[np.ndarray, " k"], d_m: float, height_m: float) -> Mesh:
    """A concrete safety barrier."""
    d = np.array([-0.3, -0.25, -0.1, -0.07, 0.07, 0.1, 0.25, 0.3]) + d_m
    z = np.array([0.0, 0.08, 0.33, 1.0, 1.0, 0.33, 0.08, 0.0])
    z[[1, 2, 5, 6]] = [0.08, 0.33, 0.33, 0.08]
    return ribbon(road, s_m, d, z * np.where(z >= 1, height_m, 1.0), int(Material.CONCRETE))


def guard_rail(road: RoadLine, s_m: Float[np.ndarray, " k"], d_m: float) -> Mesh:
    """A W-beam of 0.31 m on posts every 4 m."""
    d = np.array([0.0, 0.05, 0.0, 0.05, 0.0]) + d_m
    parts = [ribbon(road, s_m, d, np.array([0.45, 0.53, 0.60, 0.68, 0.76]), int(Material.METAL))]
    post = box([0.1, 0.1, 0.75], [0, 0, 0.375], int(Material.METAL))
    parts += [stand(post, road, float(s), d_m + 0.06) for s in np.arange(s_m[0], s_m[-1] - 0.01, 4.0)]
    return Mesh.merge(parts)


def wall(road: RoadLine, s_m: Float[np.ndarray, " k"], d_m: float, height_m: float, material: int) -> Mesh:
    """A standing wall or hedge of 0.3 m thickness."""
    d = np.array([-0.15, -0.15, 0.15, 0.15]) + d_m
    return ribbon(road, s_m, d, np.array([-0.5, height_m, height_m, -0.5]), material)


def pole(height_m: float, arm_m: float = 0.0) -> Mesh:
    """A lamp post; the arm reaches along +y."""
    parts = [tube([0, 0, 0], [0, 0, height_m], (0.11, 0.06), int(Material.METAL), sides=8)]
    if arm_m:
        parts.append(tube([0, 0, height_m], [0, arm_m, height_m + 0.3], 0.05, int(Material.METAL), sides=5))
        parts.append(box([0.25, 0.7, 0.12], [0, arm_m, height_m + 0.3], int(Material.METAL)))
    return Mesh.merge(parts)


def sign(height_m: float, width_m: float, panel_m: float) -> Mesh:
    """A traffic sign on a post, facing oncoming drivers (towards -x)."""
    post = tube([0, 0, 0], [0, 0, height_m], 0.04, int(Material.METAL), sides=5)
    panel = quads((np.array([-0.06, 0, height_m]) + _SQUARE * [0, width_m, panel_m])[None], int(Material.SIGN))
    return Mesh.merge([post, panel])


def traffic_light(arm_m: float) -> Mesh:
    """A signal post with an arm along +y and two dark heads."""
    head = [box([0.3, 0.35, 1.0], [-0.1, y, 5.2 if y else 2.8], int(Material.TRIM)) for y in (0.0, arm_m)]
    post = tube([0, 0, 0], [0, 0, 5.4], 0.09, int(Material.METAL), sides=6)
    return Mesh.merge([post, tube([0, 0, 5.4], [0, arm_m, 5.6], 0.05, int(Material.METAL), sides=5), *head])


def gantry(half_span_m: float, panels: list[tuple[float, float]]) -> Mesh:
    """A sign gantry across the road; each panel is (offset along y, width)."""
    posts = [tube([0, y, -0.5], [0, y, 6.8], 0.2, int(Material.METAL), sides=6) for y in (-half_span_m, half_span_m)]
    beam = box([0.5, 2 * half_span_m, 0.6], [0, 0, 6.6], int(Material.METAL))
    boards = [np.array([-0.32, y, 6.6]) + _SQUARE * [0, width, 2.4] for y, width in panels]
    return Mesh.merge([*posts, beam, *([quads(np.stack(boards), int(Material.SIGN))] if boards else [])])


def bridge(half_span_m: float, width_m: float) -> Mesh:
    """An overpass: deck, parapets and two rows of pillars."""
    deck = box([width_m, 2 * half_span_m + 40, 1.2], [0, 0, 6.6], int(Material.CONCRETE))
    sides = [
        box([0.3, 2 * half_span_m + 40, 1.0], [x, 0, 7.6], int(Material.CONCRETE)) for x in (-width_m / 2, width_m / 2)
    ]
    spots = [(x, y) for x in (-width_m / 3, width_m / 3) for y in (-half_span_m, half_span_m)]
    pillars = [tube([x, y, -1], [x, y, 6.2], 0.5, int(Material.CONCRETE), sides=8) for x, y in spots]
    return Mesh.merge([deck, *sides, *pillars])


def tree(height_m: float, rng: np.random.Generator) -> Mesh:
    """A trunk and a crown of loose random facets on three to five blobs, so that rays pass between the leaves."""
    trunk = tube(
        [0, 0, -0.5], [0, 0, 0.5 * height_m], (0.05 * height_m**0.7, 0.03 * height_m**0.7), int(Material.BARK), sides=6
    )
    blobs = int(rng.integers(3, 6))
    spread = 0.16 * height_m
    middle = np.stack([*(rng.uniform(-spread, spread, (2, blobs))), rng.uniform(0.5, 0.8, blobs) * height_m], axis=1)
    radius = rng.uniform(0.14, 0.24, (blobs, 1, 1)) * height_m
    outward = rng.standard_normal((blobs, 30, 3))
    outward *= rng.uniform(0.55, 1.0, (blobs, 30, 1)) / np.linalg.norm(outward, axis=2, keepdims=True)
    centre = middle[:, None] + radius * outward
    leaf = centre[:, :, None] + 0.5 * radius[..., None] * rng.uniform(-1, 1, (blobs, 30, 3, 3))
    vertices = leaf.reshape(-1, 3)
    crown = Mesh.of(vertices, np.arange(len(vertices)).reshape(-1, 3), int(Material.FOLIAGE))
    return Mesh.merge([trunk, crown])


def bush(rng: np.random.Generator) -> Mesh:
    """A low shrub."""
    return ellipsoid(
        [0, 0, 0.4],
        [rng.uniform(0.5, 1.4), rng.uniform(0.5, 1.2), rng.uniform(0.4, 1.1)],
        int(Material.FOLIAGE),
        sides=7,
        rows=3,
    )


def building(length_m: float, depth_m: float, height_m: float, rng: np.random.Generator) -> Mesh:
    """A block with rows of windows towards the street; x along the street, front at y = 0, body at y > 0."""
    skin = int(rng.choice([Material.BRICK, Material.CONCRETE]))
    body = box([length_m, depth_m, height_m + 1], [0, depth_m / 2, (height_m - 1) / 2], skin)
    columns, rows = max(1, int(length_m / rng.uniform(2.2, 3.5))), max(1, int(height_m / 3.1))
    x = (np.arange(columns) + 0.5) / columns * length_m - length_m / 2
    z = 1.6 + 3.1 * np.arange(rows)
    wide, tall = 0.55 * length_m / columns, rng.uniform(1.2, 1.9)
    spots = np.stack(np.meshgrid(x, z[z + tall / 2 < height_m], indexing="ij"), axis=-1).reshape(-1, 2)
    centre = np.stack([spots[:, 0], np.full(len(spots), -0.03), spots[:, 1]], axis=1)
    panes = centre[:, None] + np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) / 2 * [wide, 0, tall]
    return Mesh.merge([body, quads(panes, int(Material.GLASS))]) if len(spots) else body
