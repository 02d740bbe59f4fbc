"""Which triangle each pixel sees, what it looks like, and which of those places the sun reaches.

Colours are linear RGB albedos. Car colours follow the shares of new cars in industry surveys (roughly white 0.34, black
0.20, grey 0.18, silver 0.09, blue 0.09, red 0.06, the rest 0.04); the other colours are chosen by eye.
"""

from dataclasses import dataclass
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Float32, Int, Int32, UInt8

from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, transform_points
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.trace import Caster
from farfield.simulation.world.scene import SceneWindow, at_knots

# What a triangle looks like: its colour by material and tint, its normal, and what it emits at night

_Colour = tuple[float, float, float]
CAR_COLOURS: tuple[tuple[float, _Colour], ...] = (
    (0.34, (0.78, 0.78, 0.76)),
    (0.20, (0.016, 0.016, 0.018)),
    (0.18, (0.11, 0.115, 0.12)),
    (0.09, (0.42, 0.43, 0.44)),
    (0.09, (0.02, 0.06, 0.20)),
    (0.06, (0.36, 0.018, 0.02)),
    (0.02, (0.03, 0.12, 0.06)),
    (0.02, (0.30, 0.22, 0.13)),
)
_RANGES: dict[str, tuple[tuple[float, _Colour], ...]] = {
    "CAR_PAINT": CAR_COLOURS,
    "CARGO": (
        (0.5, (0.72, 0.72, 0.70)),
        (0.14, (0.10, 0.17, 0.36)),
        (0.1, (0.42, 0.10, 0.06)),
        (0.1, (0.45, 0.33, 0.14)),
        (0.08, (0.10, 0.24, 0.14)),
        (0.08, (0.32, 0.33, 0.34)),
    ),
    "CLOTH": (
        (0.25, (0.03, 0.03, 0.04)),
        (0.2, (0.06, 0.09, 0.18)),
        (0.15, (0.30, 0.30, 0.29)),
        (0.12, (0.40, 0.06, 0.05)),
        (0.1, (0.12, 0.20, 0.12)),
        (0.1, (0.42, 0.30, 0.16)),
        (0.08, (0.62, 0.60, 0.55)),
    ),
    "SIGN": (
        (0.45, (0.015, 0.19, 0.10)),
        (0.2, (0.02, 0.10, 0.42)),
        (0.2, (0.80, 0.80, 0.78)),
        (0.1, (0.62, 0.42, 0.02)),
        (0.05, (0.55, 0.03, 0.03)),
    ),
    "BRICK": (
        (0.4, (0.30, 0.13, 0.09)),
        (0.25, (0.38, 0.24, 0.16)),
        (0.2, (0.48, 0.40, 0.30)),
        (0.15, (0.24, 0.17, 0.14)),
    ),
    "CONCRETE": ((0.4, (0.33, 0.32, 0.30)), (0.3, (0.40, 0.38, 0.34)), (0.3, (0.27, 0.27, 0.27))),
    "SKIN": ((0.5, (0.50, 0.31, 0.22)), (0.3, (0.34, 0.20, 0.13)), (0.2, (0.14, 0.08, 0.05))),
    "FOLIAGE": ((0.5, (0.055, 0.110, 0.030)), (0.3, (0.080, 0.130, 0.035)), (0.2, (0.035, 0.080, 0.030))),
}
_SINGLE: dict[str, _Colour] = {
    "ASPHALT": (0.095, 0.095, 0.098),
    "LANE_PAINT": (0.62, 0.62, 0.58),
    "GRASS": (0.095, 0.150, 0.045),
    "SOIL": (0.20, 0.145, 0.09),
    "TYRE": (0.018, 0.018, 0.019),
    "GLASS": (0.012, 0.014, 0.015),
    "LAMP": (0.60, 0.60, 0.60),
    "PLATE": (0.72, 0.72, 0.68),
    "METAL": (0.29, 0.30, 0.31),
    "TRIM": (0.025, 0.025, 0.027),
    "SNOW": (0.80, 0.82, 0.86),
    "BARK": (0.11, 0.08, 0.055),
}
_OTHER: _Colour = (0.3, 0.3, 0.3)
_HEAD_LAMP, _TAIL_LAMP, _STREET_LAMP = (1.0, 0.93, 0.82), (0.85, 0.02, 0.015), (1.0, 0.72, 0.38)
_LIT_WINDOW = (1.0, 0.74, 0.42)
_LIT_SHARE = 0.28


@dataclass(frozen=True, eq=False)
class Appearance:
    """Triangles as a camera sees them.

    Args:
        normal: Unit normals in the mesh's frame, shape (f, 3).
        albedo: Linear RGB, shape (f, 3).
        glow: Radiance by which each shines at night, shape (f, 3).
        material: Material, shape (f,).
    """

    normal: Float32[np.ndarray, "f 3"]
    albedo: Float32[np.ndarray, "f 3"]
    glow: Float32[np.ndarray, "f 3"]
    material: UInt8[np.ndarray, " f"]


_KNOWN: WeakKeyDictionary[Caster, Appearance] = WeakKeyDictionary()


def appearance_of(tracer: Caster, *, moving: bool) -> Appearance:
    """Appearance of a tracer's triangles; computed once a tracer.

    Args:
        tracer: What is seen.
        moving: Whether it is a road user (x forward, so that lamps in front are white and behind red) or fixed.
    """
    if tracer not in _KNOWN:
        mesh = tracer.mesh
        _KNOWN[tracer] = Appearance(
            face_normals(mesh), albedo_of(mesh, moving=moving), _glow(mesh, moving), mesh.material.astype(np.uint8)
        )
    return _KNOWN[tracer]


def face_normals(mesh: Mesh) -> Float32[np.ndarray, "f 3"]:
    """Unit normals of a mesh's triangles; their sign follows the order of the corners."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    return (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def albedo_of(mesh: Mesh, *, moving: bool = False) -> Float32[np.ndarray, "f 3"]:
    """Linear RGB of each triangle by its material and tint."""
    colours = np.empty((len(mesh.faces), 3), dtype=np.float32)
    for value in np.unique(mesh.material):
        name, faces = Material(int(value)).name, mesh.material == value
        if name in _RANGES:
            colours[faces] = _pick(_RANGES[name], mesh.tint[faces])
        else:
            shade = 0.85 + 0.3 * mesh.tint[faces, None] if name != "LAMP" else 1.0
            colours[faces] = np.array(_SINGLE.get(name, _OTHER)) * shade
    if moving:
        tail = (mesh.material == Material.LAMP) & (_middle_x(mesh) < 0)
        colours[tail] = (0.28, 0.012, 0.012)
    return colours


def _pick(shares: tuple[tuple[float, _Colour], ...], tint: Float32[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """The colour whose share of [0, 1) holds the tint, a little lighter or darker by where in the share it lies."""
    edges = np.cumsum([share for share, _ in shares])
    index = np.minimum(np.searchsorted(edges, tint, side="right"), len(shares) - 1)
    within = (edges[index] - tint) / np.array([share for share, _ in shares])[index]
    return np.array([colour for _, colour in shares])[index] * (0.85 + 0.3 * within[:, None])


def _middle_x(mesh: Mesh) -> Float[np.ndarray, " f"]:
    return mesh.vertices_m[mesh.faces, 0].mean(axis=1)


def _glow(mesh: Mesh, moving: bool) -> Float32[np.ndarray, "f 3"]:
    glow = np.zeros((len(mesh.faces), 3), dtype=np.float32)
    lamp = mesh.material == Material.LAMP
    if moving:
        ahead = _middle_x(mesh) > 0
        glow[lamp & ahead] = 40.0 * np.array(_HEAD_LAMP)
        glow[lamp & ~ahead] = 3.0 * np.array(_TAIL_LAMP)
    else:
        glow[lamp] = 30.0 * np.array(_STREET_LAMP)
        window = np.flatnonzero(mesh.material == Material.GLASS)  # panes are pairs of triangles
        corner = mesh.vertices_m[mesh.faces[window, 0]]
        chance = np.modf(np.abs(np.sin(corner @ np.array([12.9898, 78.233, 37.719])) * 43758.5453))[0]
        glow[window[chance < _LIT_SHARE]] = 0.5 * np.array(_LIT_WINDOW)
    return glow


_NEAR_M = 0.1
_EDGES = np.array([(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)])


@dataclass(frozen=True, eq=False)
class RayGrid:
    """The distorted rays of an image, in camera axes (x right, y down, z forward).

    Args:
        directions: Unit directions row by row, shape (h w, 3); zero beyond the fold of the distortion.
        height: Rows of rays.
        width: Rays a row.
        column_reach: Least and greatest x / z of each column, shape (2, w).
        row_reach: Least and greatest y / z of each row, shape (2, h).
    """

    directions: Float32[np.ndarray, "n 3"]
    height: int
    width: int
    column_reach: Float[np.ndarray, "2 w"]
    row_reach: Float[np.ndarray, "2 h"]


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """One body at the reference moment: its tracer, pose, road user (-1: fixed), and its first triangle among all."""

    tracer: Caster
    world_T_body: Float[np.ndarray, "4 4"]
    actor: int
    first_face: int


@dataclass(frozen=True, eq=False)
class RayImage:
    """What every ray of a grid hit first.

    Args:
        range_m: Distance, inf where nothing was hit, shape (n,).
        face: Triangle counted over all bodies, -1 where nothing was hit, shape (n,).
        directions: Rays in the world, shape (n, 3).
        origin_m: The camera in the world.
    """

    range_m: Float32[np.ndarray, " n"]
    face: Int32[np.ndarray, " n"]
    directions: Float32[np.ndarray, "n 3"]
    origin_m: Float[np.ndarray, " 3"]


def ray_grid(camera: Camera, supersample: int = 1) -> RayGrid:
    """The rays of a camera's pixels; remembered for the last few intrinsics.

    Args:
        camera: The camera; its pose does not matter here.
        supersample: Rays a pixel along each axis, evenly spread over the pixel.
    """
    shape = (camera.width_px, camera.height_px, supersample)
    return _ray_grid(camera.matrix.tobytes(), camera.distortion.tobytes(), *shape)


@lru_cache(maxsize=4)
def _ray_grid(matrix: bytes, distortion: bytes, width_px: int, height_px: int, supersample: int) -> RayGrid:
    lens = Camera(
        matrix=np.frombuffer(matrix).reshape(3, 3), distortion=np.frombuffer(distortion), camera_T_lidar=np.eye(4)
    )
    height, width = height_px * supersample, width_px * supersample
    u = (np.arange(width) + 0.5) / supersample - 0.5
    directions = np.empty((height, width, 3), dtype=np.float32)
    for row in range(0, height, 64):  # in slices: Newton's method takes some 200 bytes a ray
        v = (np.arange(row, min(row + 64, height)) + 0.5) / supersample - 0.5
        pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        directions[row : row + len(v)] = lens.rays(pixels).reshape(len(v), width, 3)
    np.nan_to_num(directions, copy=False)
    slopes = directions[..., :2] / np.maximum(directions[..., 2:], 1e-3)
    columns, rows = slopes[..., 0], slopes[..., 1]
    return RayGrid(
        directions.reshape(-1, 3),
        height,
        width,
        np.stack([columns.min(axis=0), columns.max(axis=0)]).astype(np.float64),
        np.stack([rows.min(axis=1), rows.max(axis=1)]).astype(np.float64),
    )


def place_bodies(window: SceneWindow) -> list[PlacedBody]:
    """All bodies of a window at its reference moment, their triangles counted in this order."""
    bodies, first = [], 0
    for body in window.bodies:
        bodies.append(
            PlacedBody(body.tracer, at_knots(body.world_T_body, window.knots_s, np.zeros(1))[0], body.actor, first)
        )
        first += len(body.tracer.mesh.faces)
    return bodies


def pixels_towards(grid: RayGrid, corners_m: Float[np.ndarray, "8 3"]) -> tuple[slice, slice, float]:
    """Rows and columns whose rays may hit a box, and a distance that no hit falls below.

    Args:
        grid: The rays.
        corners_m: The box's corners in camera axes, ordered by bits (x, y, z).

    Returns:
        Rows, columns (empty when the box lies outside the image), least distance in metres.
    """
    ahead = corners_m[:, 2] > _NEAR_M
    if not ahead.any():
        return slice(0, 0), slice(0, 0), np.inf
    a, b = corners_m[_EDGES[:, 0]], corners_m[_EDGES[:, 1]]
    crossing = ahead[_EDGES[:, 0]] != ahead[_EDGES[:, 1]]
    a, b = a[crossing], b[crossing]
    cut = a + (b - a) * ((_NEAR_M - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None]
    points = np.concatenate([corners_m[ahead], cut])
    slopes = points[:, :2] / points[:, 2:]
    lower, upper = slopes.min(axis=0), slopes.max(axis=0)
    columns = np.flatnonzero((grid.column_reach[1] >= lower[0]) & (grid.column_reach[0] <= upper[0]))
    rows = np.flatnonzero((grid.row_reach[1] >= lower[1]) & (grid.row_reach[0] <= upper[1]))
    if columns.size == 0 or rows.size == 0:
        return slice(0, 0), slice(0, 0), np.inf
    middle = corners_m.mean(axis=0)
    least = float(np.linalg.norm(middle) - np.linalg.norm(corners_m[0] - middle))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1), least


def cast_image(bodies: list[PlacedBody], grid: RayGrid, world_T_camera: Float[np.ndarray, "4 4"]) -> RayImage:
    """Cast one ray a pixel: every ray at what is fixed, then at each road user within its bounds, nearest first."""
    directions = grid.directions @ world_T_camera[:3, :3].astype(np.float32).T
    image = RayImage(
        np.full(len(directions), np.inf, dtype=np.float32),
        np.full(len(directions), -1, dtype=np.int32),
        directions,
        world_T_camera[:3, 3],
    )
    numbers = np.arange(len(directions), dtype=np.int32).reshape(grid.height, grid.width)
    camera_T_world = invert(world_T_camera)
    road_users = []
    for body in bodies:
        if body.actor < 0:
            _cast_one(image, body, None)
            continue
        corners = transform_points(camera_T_world @ body.world_T_body, body.tracer.corners_m)
        rows, columns, least = pixels_towards(grid, corners)
        if rows.stop > rows.start:
            road_users.append((least, body, rows, columns))
    for least, body, rows, columns in sorted(road_users, key=lambda item: item[0]):
        rays = numbers[rows, columns].reshape(-1)
        _cast_one(image, body, rays[image.range_m[rays] > least])
    return image


def _cast_one(image: RayImage, body: PlacedBody, subset: Int32[np.ndarray, " k"] | None) -> None:
    """Cast the chosen rays, or all, at one body and keep what is nearer than before."""
    if subset is not None and subset.size == 0:
        return
    body_T_world = invert(body.world_T_body)
    start = transform_points(body_T_world, image.origin_m[None])[0]
    rays, turn = image.directions if subset is None else image.directions[subset], body_T_world[:3, :3]
    if not np.array_equal(turn, np.eye(3)):
        rays = rays @ turn.astype(np.float32).T
    starts = np.empty_like(rays)
    starts[:] = start - body.tracer.anchor_m
    hits = body.tracer.cast_anchored(starts, rays, image.range_m if subset is None else image.range_m[subset])
    if subset is None:
        nearer = hits.range_m < image.range_m
        np.copyto(image.range_m, hits.range_m, where=nearer)
        np.copyto(image.face, hits.face + body.first_face, where=nearer, casting="same_kind")
        return
    closer = np.flatnonzero(hits.range_m < image.range_m[subset])
    image.range_m[subset[closer]] = hits.range_m[closer]
    image.face[subset[closer]] = hits.face[closer] + body.first_face


def sunlit(
    bodies: list[PlacedBody],
    image: RayImage,
    index: Int[np.ndarray, " k"],
    sun: Float32[np.ndarray, " 3"],
    normal: Float32[np.ndarray, "k 3"],
) -> Float32[np.ndarray, " k"]:
    """Whether the sun reaches the places that the chosen rays hit: 1 lit, 0 in shadow.

    Args:
        bodies: All bodies.
        image: What the rays hit.
        index: Rays that hit something.
        sun: Unit vector towards the sun.
        normal: Normals there, towards the camera.
    """
    away = image.directions[index] * (image.range_m[index] * np.float32(0.9998))[:, None]
    away += normal * np.float32(0.01)
    lit = np.ones(len(index), dtype=np.float32)
    # the rays in the order of where they pass across the sun's direction, so that few are looked at for a body
    across = np.cross(sun, [0.0, 0.0, 1.0] if abs(sun[2]) < 0.9 else [1.0, 0.0, 0.0]).astype(np.float32)
    across /= np.linalg.norm(across)
    aside = away @ across
    order = np.argsort(aside)
    aside = aside[order]
    for body in bodies:
        body_T_world = invert(body.world_T_body)
        corners = transform_points(body.world_T_body, body.tracer.corners_m) - image.origin_m
        if body.actor < 0:
            near = np.flatnonzero(lit > 0)
        else:
            middle = corners.mean(axis=0).astype(np.float32)
            radius = float(np.linalg.norm(corners[0] - middle)) + 0.1
            at = float(middle @ across)
            beside = order[np.searchsorted(aside, at - radius) : np.searchsorted(aside, at + radius)]
            offset = away[beside] - middle
            depth = offset @ sun
            apart = np.einsum("ij,ij->i", offset, offset) - depth * depth
            near = beside[(apart < radius * radius) & (depth < radius) & (lit[beside] > 0)]
        if near.size:
            start = transform_points(body_T_world, away[near] + image.origin_m)
            ray = np.broadcast_to(body_T_world[:3, :3].astype(np.float32) @ sun, (len(near), 3))
            lit[near[body.tracer.cast_from(start, ray).face >= 0]] = 0.0
    return lit


def mirror_images(
    bodies: list[PlacedBody],
    image: RayImage,
    index: Int[np.ndarray, " k"],
    grid: RayGrid,
    world_T_camera: Float[np.ndarray, "4 4"],
) -> Int32[np.ndarray, " n"]:
    """What the chosen rays hit after a mirror-like bounce off a rough, level road.

    The road's slope is scattered along the line of sight by up to 0.03 rad, the same way at each pixel in every
    picture, which draws mirror images out towards the camera as on wet asphalt.

    Returns:
        Triangles counted over all bodies, -1 where nothing was hit or the ray was not chosen, shape (n,).
    """
    ray = image.directions[index]
    tilt = np.float32(0.06) * (((index * 40503) & 0xFFFF).astype(np.float32) / np.float32(65536) - np.float32(0.5))
    bounced = ray + np.float32(2) * np.abs(ray[:, 2:]) * np.stack([ray[:, 0] * tilt, ray[:, 1] * tilt, 1 + 0 * tilt], 1)
    bounced[:, 2] = np.abs(bounced[:, 2]) + np.float32(2) * tilt
    bounced /= np.linalg.norm(bounced, axis=1, keepdims=True)
    start = ray * image.range_m[index][:, None] + np.array([0, 0, 0.02], dtype=np.float32)
    nearest = np.full(len(index), np.inf, dtype=np.float32)
    face = np.full(len(image.face), -1, dtype=np.int32)
    row, column = np.divmod(index, grid.width)
    camera_T_world = invert(world_T_camera)
    margin = grid.height // 16
    for body in bodies:
        if body.actor < 0:
            near = np.arange(len(index))
        else:  # its image stands on its head below it
            corners = transform_points(camera_T_world @ body.world_T_body, body.tracer.corners_m * [1.0, 1.0, -1.0])
            rows, columns, _ = pixels_towards(grid, corners)
            inside = (row >= rows.start - margin) & (row < rows.stop + margin)
            near = np.flatnonzero(inside & (column >= columns.start) & (column < columns.stop))
        if near.size == 0:
            continue
        body_T_world = invert(body.world_T_body)
        turn = body_T_world[:3, :3].astype(np.float32)
        offset = transform_points(body_T_world, image.origin_m[None])[0] - body.tracer.anchor_m
        hits = body.tracer.cast_anchored(start[near] @ turn.T + offset.astype(np.float32), bounced[near] @ turn.T)
        nearer = np.flatnonzero(hits.range_m < nearest[near])
        nearest[near[nearer]] = hits.range_m[nearer]
        face[index[near[nearer]]] = hits.face[nearer] + body.first_face
    return face


@dataclass(frozen=True, eq=False)
class FaceTable:
    """Appearance of all triangles of all bodies, normals in the world; from ``moving_from`` on they are road users'."""

    normal: Float32[np.ndarray, "f 3"]
    albedo: Float32[np.ndarray, "f 3"]
    glow: Float32[np.ndarray, "f 3"]
    material: UInt8[np.ndarray, " f"]
    moving_from: int


def face_table(bodies: list[PlacedBody], lit: list[bool]) -> FaceTable:
    """Collect the appearances of all bodies.

    Args:
        bodies: The bodies, fixed ones first.
        lit: Whether each one's lamps are on.
    """
    appearances = [appearance_of(body.tracer, moving=body.actor >= 0) for body in bodies]
    normal = [
        look.normal @ body.world_T_body[:3, :3].T.astype(np.float32)
        for look, body in zip(appearances, bodies, strict=True)
    ]
    glow = [
        appearance.glow if on else np.zeros_like(appearance.glow)
        for appearance, on in zip(appearances, lit, strict=True)
    ]
    return FaceTable(
        np.concatenate(normal),
        np.concatenate([appearance.albedo for appearance in appearances]),
        np.concatenate(glow),
        np.concatenate([appearance.material for appearance in appearances]),
        sum(len(body.tracer.mesh.faces) for body in bodies if body.actor < 0),
    )
