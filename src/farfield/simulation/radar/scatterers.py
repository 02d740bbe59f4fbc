"""The scene as the radar sees it: point scatterers of surfaces, road users, limbs, detours, mirror images and rain."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from farfield.geometry.poses import invert, transform_points
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.radar.casting import CastRays, cast_rays
from farfield.simulation.radar.echoes import ScattererKind, Scatterers, cell_snr
from farfield.simulation.radar.limbs import limb_points
from farfield.simulation.radar.mirrors import find_mirrors, ghosts, posts
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.points import ScatterPoints
from farfield.simulation.radar.propagation import rain_clutter, two_way_loss_db
from farfield.simulation.radar.rcs import mean_rcs_dbsm, part_share, slow_db, surface_rcs_m2_m2
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.world.scene import SceneWindow

__all__ = ["ScattererKind", "Scatterers", "radar_velocity_m_s", "scatterers"]

_WALKERS = ("pedestrian", "bicycle")
_VEHICLES = ("vehicle", "large_vehicle", "trailer", "motorcycle")
_MERGE_BINS, _MERGE_AZIMUTH_DEG, _MERGE_ELEVATION_DEG = 0.25, 0.5, 1.5
_SEEN_DEG = (60.0, 25.0)
_SAME_M = 0.05


def scatterers(
    window: SceneWindow,
    model: RadarModel,
    world_T_radar: Float[np.ndarray, "4 4"],
    weather: Weather,
    rng: np.random.Generator,
) -> Scatterers:
    """All that the radar sees at the window's reference moment, at most ``model.max_scatterers``.

    Args:
        window: The scene.
        model: The radar.
        world_T_radar: Its pose then; see :func:`farfield.simulation.radar.model.radar_mount`.
        weather: Wet and white surfaces, losses, rain.
        rng: Draws rays, fluctuation and rain; levels of individuals come from their own seeds.

    Returns:
        Scatterers in the radar's frame, drawn anew for each frame (Swerling's second case: the power of each is
        exponential about its mean).
    """
    streams = rng.spawn(4)
    reach_m = float(model.axes.range_m[-1])
    cast = cast_rays(window, world_T_radar, reach_m, streams[0])
    mirrors = find_mirrors(cast)
    users = _road_users(window, model, world_T_radar, cast)
    parts = [_surfaces(cast, weather), users, posts(mirrors, world_T_radar, streams[1])]
    parts.append(ghosts(users, mirrors, model.ghost_db))
    speed = radar_velocity_m_s(window, world_T_radar) @ world_T_radar[:3, :3]
    seen = _merged(ScatterPoints.join(parts).seen_from(speed), model)
    seen = replace(seen, rcs_m2=seen.rcs_m2 * streams[2].exponential(1.0, len(seen)))
    everything = Scatterers.join([seen, rain_clutter(weather, model, speed, streams[3])])
    everything = replace(everything, loss_db=two_way_loss_db(everything.range_m, weather, model, window.time_s))
    return _strongest(everything, model)


def radar_velocity_m_s(window: SceneWindow, world_T_radar: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 3"]:
    """Velocity of the radar at its mount in the world, turning included where the window has knots."""
    if len(window.knots_s) < 2:
        return window.ego_velocity_m_s
    mount = transform_points(invert(window.world_T_ego_now), world_T_radar[:3, 3][None])[0]
    first, last = (window.world_T_ego[k, :3, :3] @ mount + window.world_T_ego[k, :3, 3] for k in (0, -1))
    return np.asarray((last - first) / (window.knots_s[-1] - window.knots_s[0]))


def _surfaces(cast: CastRays, weather: Weather) -> ScatterPoints:
    """Patches of the fixed surroundings that the fan hit: sigma_0 times the patch's area."""
    rows = np.flatnonzero((cast.owner < 0) & (cast.actor < 0) & np.isfinite(cast.range_m))
    range_m, cosine = cast.range_m[rows], np.maximum(cast.cosine[rows], 1e-3)
    area_m2 = range_m**2 * cast.solid_angle_sr[rows] / cosine
    rcs_m2 = surface_rcs_m2_m2(cast.material[rows], cosine, weather) * area_m2
    return ScatterPoints.fixed(cast.direction[rows] * range_m[:, None], rcs_m2, ScattererKind.SURFACE)


def _road_users(
    window: SceneWindow, model: RadarModel, world_T_radar: Float[np.ndarray, "4 4"], cast: CastRays
) -> ScatterPoints:
    """Every road user that is within reach: what is seen of it, and what shows under the vehicle that hides it."""
    radar_T_world = invert(world_T_radar)
    parts = []
    owners = cast.owner[np.isfinite(cast.own_range_m)]
    for row in np.unique(owners):
        rays = np.flatnonzero((cast.owner == row) & np.isfinite(cast.own_range_m))
        actor = window.actors[row]
        bottom = transform_points(radar_T_world, window.bottom_m[row][None])[0]
        aspect = float(np.arctan2(*(world_T_radar[:3, 3] - window.bottom_m[row])[[1, 0]]) - window.yaw_rad[row])
        level_db = mean_rcs_dbsm(actor, aspect, float(np.linalg.norm(bottom))) + slow_db(actor)
        whole = ScatterPoints.fixed(
            cast.direction[rays] * cast.own_range_m[rays, None], _weights(cast, rays), ScattererKind.OBJECT
        )
        whole = replace(whole, rcs_m2=whole.rcs_m2 * 10 ** (level_db / 10), actor=np.full(len(rays), row))
        moving = replace(whole, velocity_m_s=_body_velocity(window, cast.own_body[rays], whole, world_T_radar))
        parts += _seen_and_hidden(window, model, cast, rays, moving, actor, int(row), float(bottom[2]), radar_T_world)
    return ScatterPoints.join(parts)


def _weights(cast: CastRays, rays: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Shares of a body's cross section: equal angles, more from bare metal and from faces turned to the radar."""
    share = part_share(cast.own_material[rays]) * cast.solid_angle_sr[rays] * (0.1 + cast.own_cosine[rays] ** 2)
    return np.asarray(share / share.sum())


def _body_velocity(
    window: SceneWindow, body: Int[np.ndarray, " k"], points: ScatterPoints, world_T_radar: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "k 3"]:
    """Velocities of points of bodies in the world, in the radar's axes, turning included where there are knots."""
    out = np.empty_like(points.position_m)
    span_s = window.knots_s[-1] - window.knots_s[0]
    world_m = transform_points(world_T_radar, points.position_m)
    for row in np.unique(body):
        mine, moved = body == row, window.bodies[row]
        if span_s > 0:
            middle = moved.world_T_body[len(window.knots_s) // 2]
            local = transform_points(invert(middle), world_m[mine])
            first, last = (transform_points(moved.world_T_body[k], local) for k in (0, -1))
            out[mine] = (last - first) / span_s
        else:
            out[mine] = window.velocity_m_s[moved.actor]
    return np.asarray(out @ world_T_radar[:3, :3])


def _seen_and_hidden(
    window: SceneWindow,
    model: RadarModel,
    cast: CastRays,
    rays: Int[np.ndarray, " k"],
    body: ScatterPoints,
    actor: Actor,
    row: int,
    ground_m: float,
    radar_T_world: Float[np.ndarray, "4 4"],
) -> list[ScatterPoints]:
    """Split a road user's points by what hides them: nothing, another vehicle (a way under it remains), or more."""
    free = (cast.own_range_m[rays] <= cast.range_m[rays] + _SAME_M) | (cast.actor[rays] == row)
    share = float(body.rcs_m2[free].sum() / body.rcs_m2.sum())
    seen = body.take(np.flatnonzero(free))
    if actor.label in _WALKERS and share > 0:
        velocity = radar_T_world[:3, :3] @ window.velocity_m_s[row]
        heading = radar_T_world[:3, :3] @ np.array([np.cos(window.yaw_rad[row]), np.sin(window.yaw_rad[row]), 0.0])
        base = transform_points(radar_T_world, window.bottom_m[row][None])[0]
        limbs = limb_points(actor, base, heading, velocity, window.time_s)
        seen = replace(limbs, rcs_m2=limbs.rcs_m2 * body.rcs_m2.sum() * share, actor=np.full(len(limbs), row))
    parts = [replace(seen, rcs_m2=seen.rcs_m2 * _two_ray(seen, model, ground_m))]
    vehicles = np.array([other.label in _VEHICLES for other in window.actors] + [False])
    under = ~free & vehicles[cast.actor[rays]] & (actor.label in _VEHICLES)
    if under.any():
        image = body.take(np.flatnonzero(under))
        mirrored = image.position_m * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * ground_m]
        lower = image.rcs_m2 * 10 ** (model.bounce_db / 10)
        parts.append(
            replace(image, position_m=mirrored, rcs_m2=lower, kind=np.full(len(image), int(ScattererKind.BOUNCE)))
        )
    return parts


def _two_ray(points: ScatterPoints, model: RadarModel, ground_m: float) -> Float[np.ndarray, " n"]:
    """Power factor of the direct way and the one by the road, |F|^4 over its mean, for the level includes the latter.

    F = 1 + g exp(-4 pi j h_r h_t / (lambda R)); a rough road lowers g by exp(-(4 pi s sin)^2 / (2 lambda^2)).
    """
    radar_m = max(-ground_m, 0.1)
    height_m = np.maximum(points.position_m[:, 2] - ground_m, 0.0)
    range_m = np.maximum(np.linalg.norm(points.position_m, axis=1), 1.0)
    grazing = np.minimum((radar_m + height_m) / range_m, 1.0)
    rough = np.exp(-((4 * np.pi * model.road_roughness_m * grazing / model.wavelength_m) ** 2) / 2)
    g = model.ground_reflection * rough
    factor = 1 + g * np.exp(-4j * np.pi * radar_m * height_m / (model.wavelength_m * range_m))
    return np.asarray(np.abs(factor) ** 4 / ((1 + g**2) ** 2 + 2 * g**2))


def _merged(seen: Scatterers, model: RadarModel) -> Scatterers:
    """Join what falls into a quarter of a range bin, half a degree of azimuth and 1.5 of elevation, by road user."""
    azimuth, elevation, range_m = np.degrees(seen.azimuth_rad), np.degrees(seen.elevation_rad), seen.range_m
    kept = (range_m > 0.5) & (range_m < model.axes.range_m[-1] + model.axes.range_step_m) & (seen.rcs_m2 > 0)
    kept &= (np.abs(azimuth) < _SEEN_DEG[0]) & (np.abs(elevation) < _SEEN_DEG[1])
    rows = np.flatnonzero(kept)
    if not rows.size:
        return seen.take(rows)
    seen = seen.take(rows)
    speed = np.where(seen.kind == ScattererKind.LIMB, np.round(seen.velocity_m_s / model.axes.doppler_step_m_s), 0)
    keys = [
        seen.actor, seen.kind, np.floor(range_m[rows] / (_MERGE_BINS * model.axes.range_step_m)),
        np.floor(azimuth[rows] / _MERGE_AZIMUTH_DEG), np.floor(elevation[rows] / _MERGE_ELEVATION_DEG), speed,
    ]  # fmt: skip
    cells, which = np.unique(np.stack(keys).astype(np.int64), axis=1, return_inverse=True)
    which = which.reshape(-1)
    total = np.bincount(which, seen.rcs_m2)
    columns = (*seen.position_m.T, seen.velocity_m_s)
    *position, velocity = (np.asarray(np.bincount(which, values * seen.rcs_m2) / total) for values in columns)
    return Scatterers(np.stack(position, axis=1), velocity, total, cells[0], cells[1], np.zeros(len(total)))


def _strongest(seen: Scatterers, model: RadarModel) -> Scatterers:
    if len(seen) <= model.max_scatterers:
        return seen
    order = np.argsort(-cell_snr(seen, model), kind="stable")[: model.max_scatterers]
    return seen.take(np.sort(order))
