"""What stands beside the road: poles, signs, trees, buildings, bridges, each in a frame of its own."""

import numpy as np

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, ellipsoid, quads, tube

_SQUARE = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2


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


def tree(height_m: float, rng: np.random.Generator, *, conifer: bool = False) -> Mesh:
    """A trunk and a crown of loose random facets, so that rays pass between the leaves.

    Args:
        height_m: About its height.
        rng: Draws its shape.
        conifer: Whether the crown is a cone down to the ground instead of three to five blobs.
    """
    trunk = tube(
        [0, 0, -1.0], [0, 0, 0.5 * height_m], (0.05 * height_m**0.7, 0.03 * height_m**0.7), int(Material.BARK), sides=6
    )
    if conifer:
        z = height_m * rng.uniform(0.12, 1.0, 140)
        angle, radius_m = rng.uniform(0, 2 * np.pi, 140), 0.2 * (height_m - z) * rng.uniform(0.4, 1.0, 140)
        centre = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), z], axis=1)
        size = np.full((140, 1, 1), 0.07 * height_m)
    else:
        blobs, spread = int(rng.integers(3, 6)), 0.16 * height_m
        middle = np.stack(
            [*(rng.uniform(-spread, spread, (2, blobs))), rng.uniform(0.5, 0.8, blobs) * height_m], axis=1
        )
        radius = rng.uniform(0.14, 0.24, (blobs, 1, 1)) * height_m
        outward = rng.standard_normal((blobs, 30, 3))
        outward *= rng.uniform(0.55, 1.0, (blobs, 30, 1)) / np.linalg.norm(outward, axis=2, keepdims=True)
        centre = (middle[:, None] + radius * outward).reshape(-1, 3)
        size = np.repeat(0.5 * radius, 30, axis=1).reshape(-1, 1, 1)
    vertices = (centre[:, None] + size * rng.uniform(-1, 1, (len(centre), 3, 3))).reshape(-1, 3)
    vertices[:, 2] = np.maximum(vertices[:, 2], 0.1)
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


def house(length_m: float, depth_m: float, rng: np.random.Generator) -> Mesh:
    """A house of one or two floors with a gabled roof and windows; x along the street, front at y = 0."""
    eaves = float(rng.choice([2.9, 5.4])) + rng.uniform(0, 0.4)
    walls = building(length_m, depth_m, eaves, rng)
    ridge, over = eaves + rng.uniform(0.25, 0.45) * depth_m, 0.4
    x, y = length_m / 2 + over, (-over, depth_m / 2, depth_m + over)
    low = eaves - 0.15
    slopes = [
        [[-x, y[0], low], [x, y[0], low], [x, y[1], ridge], [-x, y[1], ridge]],
        [[-x, y[2], low], [x, y[2], low], [x, y[1], ridge], [-x, y[1], ridge]],
    ]
    gables = [[[e, 0, eaves], [e, depth_m, eaves], [e, y[1], ridge], [e, y[1], ridge]] for e in (-x + over, x - over)]
    roof = quads(np.array(slopes), int(Material.BRICK))
    door = quads(
        np.array([[[-0.5, -0.04, 0], [0.5, -0.04, 0], [0.5, -0.04, 2.1], [-0.5, -0.04, 2.1]]]), int(Material.TRIM)
    )
    return Mesh.merge([walls, roof, quads(np.array(gables, dtype=np.float64), int(Material.BRICK)), door])
