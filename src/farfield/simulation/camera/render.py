"""One picture of a scene: rays, light, air, window and sensor."""

import numpy as np
from jaxtyping import Float, Float32, Int, Int32, UInt8

from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, transform_points
from farfield.simulation.bodies.materials import Material
from farfield.simulation.camera.cast import (
    FaceTable,
    PlacedBody,
    RayGrid,
    RayImage,
    cast_image,
    face_table,
    mirror_images,
    pixels_towards,
    place_bodies,
    ray_grid,
    sunlit,
)
from farfield.simulation.camera.kernels import contact, fill_light, shade
from farfield.simulation.camera.lens import Exposure, finish
from farfield.simulation.camera.sky import Sky, make_sky
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.world.scene import SceneWindow

_MOVING_M_S = 0.3  # slower road users have their lamps off
_HEAD_LIGHT, _STREET_LIGHT = 90.0, 7.0
_CONE_COS = float(np.cos(np.radians(25.0)))
_OTHERS_M, _STREET_M = 70.0, 90.0
_MIRROR_M = 80.0  # a wet road mirrors things within so far
_SHADOW_M = 250.0  # shadows farther off are left out


def render(
    window: SceneWindow,
    camera: Camera,
    world_T_lidar: Float[np.ndarray, "4 4"],
    weather: Weather,
    rng: np.random.Generator,
    *,
    supersample: int = 1,
    window_seed: np.random.SeedSequence | None = None,
) -> UInt8[np.ndarray, "h w 3"]:
    """Take one picture at the window's reference moment.

    Args:
        window: The scene.
        camera: The camera; its ``camera_T_lidar`` places it relative to ``world_T_lidar``.
        world_T_lidar: Pose of the frame that the camera is given in.
        weather: Light, air, precipitation, what covers the road and the camera's window.
        rng: Draws drops, flakes and noise of this picture.
        supersample: Rays a pixel along each axis.
        window_seed: Draws where ice covers the camera's window; give one a camera and sequence.

    Returns:
        sRGB picture.

    Raises:
        MissingExtraError: If numba or embreex is not installed.
    """
    image, range_m = radiance(window, camera, world_T_lidar, weather, supersample=supersample)
    turn = camera.camera_T_lidar[:3, :3] @ world_T_lidar[:3, :3].T
    exposure = Exposure(
        camera, turn @ window.ego_velocity_m_s, turn @ np.array([0.0, 0.0, -1.0]), range_m, window.time_s
    )
    seed = np.random.SeedSequence(0) if window_seed is None else window_seed
    return finish(image, exposure, weather, make_sky(weather), rng, seed)


def radiance(
    window: SceneWindow,
    camera: Camera,
    world_T_lidar: Float[np.ndarray, "4 4"],
    weather: Weather,
    *,
    supersample: int = 1,
) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
    """The light that reaches each pixel, and how far what it sees is (inf: sky); see ``render``."""
    sky = make_sky(weather)
    # what each ray hits first
    grid = ray_grid(camera, supersample)
    world_T_camera = world_T_lidar @ invert(camera.camera_T_lidar)
    bodies = place_bodies(window)
    ray_image = cast_image(bodies, grid, world_T_camera)
    # the light that comes from there
    image = _shade(window, bodies, ray_image, grid, world_T_camera, sky)
    # rays joined to pixels
    range_m = ray_image.range_m.reshape(grid.height, grid.width)
    if supersample > 1:
        shape = (camera.height_px, supersample, camera.width_px, supersample)
        return image.reshape(*shape, 3).mean(axis=(1, 3)), range_m.reshape(shape).min(axis=(1, 3))
    return image, range_m


def _shade(
    window: SceneWindow,
    bodies: list[PlacedBody],
    ray_image: RayImage,
    grid: RayGrid,
    world_T_camera: Float[np.ndarray, "4 4"],
    sky: Sky,
) -> Float32[np.ndarray, "h w 3"]:

    speed = np.linalg.norm(window.velocity_m_s, axis=1)
    on = [body.actor < 0 or bool(speed[body.actor] > _MOVING_M_S) for body in bodies]
    table = face_table(bodies, on)
    lit = _sunlight(bodies, ray_image, table, grid, sky)
    dimmed = _contact_shadows(bodies, ray_image, table, grid, world_T_camera)
    mirrored = _mirrored(bodies, ray_image, table, grid, world_T_camera, sky)
    lamps, ego_lamps = _lamps(window, bodies, on, ray_image) if sky.night else (np.zeros((0, 12), np.float32), 0)
    image = np.empty((len(ray_image.face), 3), dtype=np.float32)
    floor_m = float(ray_image.origin_m[2] - window.world_T_ego_now[2, 3]) + 0.5
    pixel_rad = float(grid.column_reach[1, -1] - grid.column_reach[0, 0]) / grid.width
    shade(
        ray_image.directions, ray_image.range_m, ray_image.face, lit, dimmed, mirrored, grid.width, ray_image.origin_m,
        np.float32(pixel_rad),
        table.normal, table.albedo, table.glow, table.material, table.moving_from, lamps, ego_lamps, floor_m, sky,
        image,
    )  # fmt: skip
    return image.reshape(grid.height, grid.width, 3)


def _sunlight(
    bodies: list[PlacedBody], ray_image: RayImage, table: FaceTable, grid: RayGrid, sky: Sky
) -> Float32[np.ndarray, " n"]:
    """Whether the sun reaches what each ray hit, cast at one pixel in four and spread from there."""
    lit = np.ones(len(ray_image.face), dtype=np.float32)
    if not sky.sun_rgb.any():
        return lit
    first = np.array([0, 2, 1, 3])[np.arange(grid.height) % 4]
    index = (first[:, None] + np.arange(0, grid.width - 3, 4) + np.arange(grid.height)[:, None] * grid.width).reshape(
        -1
    )
    index = index[(ray_image.face[index] >= 0) & (ray_image.range_m[index] < _SHADOW_M)]
    normal = table.normal[ray_image.face[index]]
    facing = np.einsum("ij,ij->i", normal, ray_image.directions[index])
    normal = np.where(facing[:, None] > 0, -normal, normal)
    facing_sun = (normal @ sky.sun > 0) | (table.material[ray_image.face[index]] == Material.FOLIAGE)
    cast = index[facing_sun]
    lit[cast] = sunlit(bodies, ray_image, cast, sky.sun, normal[facing_sun])
    is_sampled = np.zeros(len(lit), dtype=np.bool_)
    is_sampled[index] = True
    out = np.empty_like(lit)
    fill_light(lit, is_sampled, ray_image.range_m, ray_image.face, grid.height, grid.width, out)
    return out


def _one_in_four(grid: RayGrid) -> Int[np.ndarray, " k"]:
    """Pixels at which shadows and mirror images are cast: in each row and each column every fourth."""
    rows = np.arange(grid.height)
    first = np.array([0, 2, 1, 3])[rows % 4]
    numbers: Int[np.ndarray, " k"] = (
        first[:, None] + np.arange(0, grid.width - 3, 4) + rows[:, None] * grid.width
    ).reshape(-1)
    return numbers


def _mirrored(
    bodies: list[PlacedBody],
    ray_image: RayImage,
    table: FaceTable,
    grid: RayGrid,
    world_T_camera: Float[np.ndarray, "4 4"],
    sky: Sky,
) -> Int32[np.ndarray, " n"]:
    """Triangles that a wet road mirrors, at one pixel in four, -1 elsewhere; empty where the road is dry."""
    if sky.water < 0.05:
        return np.zeros(0, dtype=np.int32)
    index = _one_in_four(grid)
    index = index[(ray_image.face[index] >= 0) & (ray_image.range_m[index] < _MIRROR_M)]
    faces = ray_image.face[index]
    paved = np.isin(table.material[faces], (Material.ASPHALT, Material.CONCRETE, Material.LANE_PAINT))
    return mirror_images(bodies, ray_image, index[paved & (np.abs(table.normal[faces, 2]) > 0.9)], grid, world_T_camera)


def _contact_shadows(
    bodies: list[PlacedBody],
    ray_image: RayImage,
    table: FaceTable,
    grid: RayGrid,
    world_T_camera: Float[np.ndarray, "4 4"],
) -> Float32[np.ndarray, " n"]:
    """Share of the sky's light that reaches each place: less on the ground under and beside road users."""
    dimmed = np.ones(len(ray_image.face), dtype=np.float32)
    camera_T_world = invert(world_T_camera)
    for body in bodies:
        if body.actor < 0:
            continue
        corners = body.tracer.corners_m
        half = np.abs(corners).max(axis=0)
        skirt = np.sign(corners) * [*(half[:2] + 0.8), 0.3]
        skirt[:, 2] = np.where(corners[:, 2] > corners[:, 2].mean(), 0.3, -0.3)
        rows, columns, least = pixels_towards(grid, transform_points(camera_T_world @ body.world_T_body, skirt))
        if rows.stop > rows.start and least < 120.0:
            body_T_world = invert(body.world_T_body)
            shift = ray_image.origin_m - body.world_T_body[:3, 3]
            contact(
                dimmed, ray_image.range_m, ray_image.directions, ray_image.face, table.moving_from,
                (rows.start, rows.stop), (columns.start, columns.stop), grid.width, body_T_world[:3, :3], shift, half,
            )  # fmt: skip
    return dimmed


def _lamps(
    window: SceneWindow, bodies: list[PlacedBody], on: list[bool], ray_image: RayImage
) -> tuple[Float32[np.ndarray, "m 12"], int]:
    """Lamps that light the scene at night: the ego vehicle's own two first, then others' and the street's nearest.

    Columns: place relative to the camera, direction, cosine of the cone's edge, RGB, square of its reach, and 1 for a
    head lamp with its cut-off.
    """
    ego = window.world_T_ego_now
    rows = []
    ahead = ego[:3, 0] - 0.02 * ego[:3, 2]
    for side in (0.7, -0.7):
        spot = ego[:3, 3] + ego[:3, :3] @ np.array([2.2, side, 0.7]) - ray_image.origin_m
        rows.append(_lamp(spot, ahead, _CONE_COS, _HEAD_LIGHT, (1.0, 0.93, 0.82), 150.0, 1.0))
    other_lamps = []
    for body, lit in zip(bodies, on, strict=True):
        away = body.world_T_body[:3, 3] - ray_image.origin_m
        if body.actor >= 0 and lit and np.linalg.norm(away) < _OTHERS_M:
            lamp = body.tracer.mesh.material == Material.LAMP
            corners = body.tracer.mesh.vertices_m[body.tracer.mesh.faces[lamp, 0]]
            front = corners[corners[:, 0] > 0]
            if len(front):
                spot = away + body.world_T_body[:3, :3] @ (front.mean(axis=0) + np.array([0.1, 0.0, 0.0]))
                direction = body.world_T_body[:3, 0] - 0.02 * body.world_T_body[:3, 2]
                other_lamps.append(_lamp(spot, direction, _CONE_COS, 2 * _HEAD_LIGHT, (1.0, 0.93, 0.82), 50.0, 1.0))
    rows += sorted(other_lamps, key=lambda row: float(row[:3] @ row[:3]))[:8]
    rows += _street_lamps(bodies, ray_image)
    return np.stack(rows).astype(np.float32), 2


def _lamp(
    place_m: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 3"],
    cone_cos: float,
    power: float,
    rgb: tuple[float, float, float],
    reach_m: float,
    head: float,
) -> Float[np.ndarray, " 12"]:
    unit = direction / np.linalg.norm(direction)
    return np.concatenate([place_m, unit, [cone_cos], power * np.array(rgb), [reach_m**2, head]])


def _street_lamps(bodies: list[PlacedBody], ray_image: RayImage) -> list[Float[np.ndarray, " 12"]]:
    """The nearest lamps of the fixed world, one for all lamp triangles within the same 2 m."""
    lamps = []
    for body in bodies:
        lamp = np.flatnonzero(body.tracer.mesh.material == Material.LAMP)
        if body.actor >= 0 or lamp.size == 0:
            continue
        middle = body.tracer.mesh.vertices_m[body.tracer.mesh.faces[lamp]].mean(axis=1)
        away = transform_points(body.world_T_body, middle) - ray_image.origin_m
        away = away[np.linalg.norm(away, axis=1) < _STREET_M]
        _, first = np.unique(np.round(away / 2.0), axis=0, return_index=True)
        lamps += [
            _lamp(away[i], np.array([0.0, 0.0, -1.0]), 0.25, _STREET_LIGHT, (1.0, 0.72, 0.38), 40.0, 0.0) for i in first
        ]
    return sorted(lamps, key=lambda row: float(row[:3] @ row[:3]))[:8]
