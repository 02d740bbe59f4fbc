"""The scene as the radar sees it: point scatterers of surfaces, road users, limbs, detours, mirror images and rain.

A walker's foot stands still while it bears weight, so relative to the body it swings by a quarter of the stride to each
side; knees, hands and elbows follow at 0.5, 0.6 and 0.35 of that, arms against legs. A cyclist's feet turn at 170 mm
cranks, 5 m for each turn; the wheels' rims run at the riding speed.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from farfield.geometry.poses import invert, transform_points
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.materials import Material
from farfield.simulation.radar.casting import CastRays, cast_rays
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.points import ScattererKind, Scatterers, ScatterPoints, cell_snr
from farfield.simulation.radar.propagation import LEAF_DB_M, leaf_factor, rain_clutter, two_way_loss_db
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
    streams = rng.spawn(5)
    # rays over the field of view and at every road user, and the mirrors that they hit
    cast = cast_rays(window, world_T_radar, float(model.axes.range_m[-1]), streams[0])
    mirrors = find_mirrors(cast)
    # scattering points: surfaces, road users with their limbs, posts of rails, mirror images of road users, plants
    users = _road_users(window, model, world_T_radar, cast)
    parts = [_surfaces(cast, weather), users, posts(mirrors, world_T_radar, streams[1])]
    parts += [ghosts(users, mirrors, model.ghost_db), plants(cast, streams[4])]
    # joined where the radar cannot tell them apart, with radial velocities and a power that fluctuates
    velocity_m_s = radar_velocity_m_s(window, world_T_radar) @ world_T_radar[:3, :3]
    echoes = _merged(ScatterPoints.join(parts).seen_from(velocity_m_s), model)
    echoes = replace(echoes, rcs_m2=echoes.rcs_m2 * streams[2].exponential(1.0, len(echoes)))
    # rain, losses on the way, and the strongest of all
    all_echoes = Scatterers.join([echoes, rain_clutter(weather, model, velocity_m_s, streams[3])])
    all_echoes = replace(all_echoes, loss_db=two_way_loss_db(all_echoes.range_m, weather, model, window.time_s))
    return _strongest(all_echoes, model)


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
    rcs_m2 = surface_rcs_m2_m2(cast.material[rows], cosine, weather) * area_m2 * leaf_factor(cast.leafy_m[rows])
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
        # its cross section is shared by equal angles: more from bare metal and from faces turned to the radar
        share = part_share(cast.own_material[rays]) * cast.solid_angle_sr[rays] * (0.1 + cast.own_cosine[rays] ** 2)
        share = np.asarray(share / share.sum())
        body = ScatterPoints.fixed(cast.direction[rays] * cast.own_range_m[rays, None], share, ScattererKind.OBJECT)
        level_m2 = 10 ** (level_db / 10) * leaf_factor(cast.own_leafy_m[rays])
        body = replace(body, rcs_m2=body.rcs_m2 * level_m2, actor=np.full(len(rays), row))
        moving_body = replace(body, velocity_m_s=_body_velocity(window, cast.own_body[rays], body, world_T_radar))
        parts += _visible_and_hidden(
            window, model, cast, rays, moving_body, actor, int(row), float(bottom[2]), radar_T_world
        )
    return ScatterPoints.join(parts)


def _body_velocity(
    window: SceneWindow, body: Int[np.ndarray, " k"], points: ScatterPoints, world_T_radar: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "k 3"]:
    """Velocities of points of bodies in the world, in the radar's axes, turning included where there are knots."""
    out = np.empty_like(points.position_m)
    span_s = window.knots_s[-1] - window.knots_s[0]
    world_m = transform_points(world_T_radar, points.position_m)
    for row in np.unique(body):
        on_body, moved = body == row, window.bodies[row]
        if span_s > 0:
            middle = moved.world_T_body[len(window.knots_s) // 2]
            local = transform_points(invert(middle), world_m[on_body])
            first, last = (transform_points(moved.world_T_body[k], local) for k in (0, -1))
            out[on_body] = (last - first) / span_s
        else:
            out[on_body] = window.velocity_m_s[moved.actor]
    return np.asarray(out @ world_T_radar[:3, :3])


def _visible_and_hidden(
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
    is_visible = (cast.own_range_m[rays] <= cast.range_m[rays] + _SAME_M) | (cast.actor[rays] == row)
    share = float(body.rcs_m2[is_visible].sum() / body.rcs_m2.sum())
    visible = body.take(np.flatnonzero(is_visible))
    if actor.label in _WALKERS and share > 0:
        velocity = radar_T_world[:3, :3] @ window.velocity_m_s[row]
        heading = radar_T_world[:3, :3] @ np.array([np.cos(window.yaw_rad[row]), np.sin(window.yaw_rad[row]), 0.0])
        base = transform_points(radar_T_world, window.bottom_m[row][None])[0]
        limbs = limb_points(actor, base, heading, velocity, window.time_s)
        visible = replace(limbs, rcs_m2=limbs.rcs_m2 * body.rcs_m2.sum() * share, actor=np.full(len(limbs), row))
    parts = [replace(visible, rcs_m2=visible.rcs_m2 * _two_ray(visible, model, ground_m))]
    vehicles = np.array([other.label in _VEHICLES for other in window.actors] + [False])
    under = ~is_visible & vehicles[cast.actor[rays]] & (actor.label in _VEHICLES)
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


def _merged(echoes: Scatterers, model: RadarModel) -> Scatterers:
    """Join what falls into a quarter of a range bin, half a degree of azimuth and 1.5 of elevation, by road user."""
    azimuth, elevation, range_m = np.degrees(echoes.azimuth_rad), np.degrees(echoes.elevation_rad), echoes.range_m
    in_view = (range_m > 0.5) & (range_m < model.axes.range_m[-1] + model.axes.range_step_m) & (echoes.rcs_m2 > 0)
    in_view &= (np.abs(azimuth) < _SEEN_DEG[0]) & (np.abs(elevation) < _SEEN_DEG[1])
    rows = np.flatnonzero(in_view)
    if not rows.size:
        return echoes.take(rows)
    echoes = echoes.take(rows)
    own_speed = np.isin(echoes.kind, (ScattererKind.LIMB, ScattererKind.PLANT))
    speed = np.where(own_speed, np.round(echoes.velocity_m_s / model.axes.doppler_step_m_s), 0)
    keys = [
        echoes.actor, echoes.kind, np.floor(range_m[rows] / (_MERGE_BINS * model.axes.range_step_m)),
        np.floor(azimuth[rows] / _MERGE_AZIMUTH_DEG), np.floor(elevation[rows] / _MERGE_ELEVATION_DEG), speed,
    ]  # fmt: skip
    cells, which = np.unique(np.stack(keys).astype(np.int64), axis=1, return_inverse=True)
    which = which.reshape(-1)
    total = np.bincount(which, echoes.rcs_m2)
    columns = (*echoes.position_m.T, echoes.velocity_m_s)
    *position, velocity = (np.asarray(np.bincount(which, values * echoes.rcs_m2) / total) for values in columns)
    return Scatterers(np.stack(position, axis=1), velocity, total, cells[0], cells[1], np.zeros(len(total)))


def _strongest(echoes: Scatterers, model: RadarModel) -> Scatterers:
    if len(echoes) <= model.max_scatterers:
        return echoes
    order = np.argsort(-cell_snr(echoes, model), kind="stable")[: model.max_scatterers]
    return echoes.take(np.sort(order))


_PLANT_DB, _PLANT_M_S = -12.0, 0.2


def plants(cast: CastRays, rng: np.random.Generator) -> ScatterPoints:
    """Leaves and twigs of the plants that the fan's rays enter: one point a ray, 5 to 20 a cubic metre.

    All of a deep plant together gives -12 dB of the area that the radar lights; from the depth s comes a share that
    falls with the loss there and back. Every point moves with 0.1 to 0.3 m/s. The level is a customary one.

    Args:
        cast: The rays.
        rng: Draws depths and velocities.
    """
    rows = np.flatnonzero((cast.owner < 0) & (cast.leafy_m > 0))
    falls_per_m = 2 * LEAF_DB_M * np.log(10) / 10
    share = 1 - np.exp(-falls_per_m * cast.leafy_m[rows])
    depth_m = -np.log(1 - share * rng.random(len(rows))) / falls_per_m
    range_m = cast.range_in_leaves_m(rows, depth_m)
    rcs_m2 = 10 ** (_PLANT_DB / 10) * share * range_m**2 * cast.solid_angle_sr[rows]
    points = ScatterPoints.fixed(cast.direction[rows] * range_m[:, None], rcs_m2, ScattererKind.PLANT)
    return replace(points, velocity_m_s=rng.normal(0.0, _PLANT_M_S, (len(rows), 3)))


# Mirrors: planes of rails and walls among the rays' hits, the images in them, and the posts of rails

_FLAT = (Material.METAL, Material.CONCRETE, Material.BRICK, Material.GLASS)
_MAX_MIRRORS, _LEAST_RAYS = 8, 10
_ANGLE_DEG, _OFFSET_M = 6.0, 0.75
_MARGIN_M = 1.0
_POST_STEP_M, _POST_GAP_M = 4.0, 3.0
_POST_DB = (0.0, 5.0)
_RAIL_TALL_M, _RAIL_LONG_M = 1.2, 8.0


@dataclass(frozen=True, eq=False)
class Mirror:
    """A standing plane n x + d = 0 in the radar's frame, the radar on its positive side.

    Args:
        normal: Unit normal, shape (3,).
        distance_m: d, the radar's distance from it.
        hits_m: Points that were hit on it, shape (k, 3).
        metal: Whether most of them are metal.
    """

    normal: Float[np.ndarray, " 3"]
    distance_m: float
    hits_m: Float[np.ndarray, "k 3"]
    metal: bool

    @property
    def along(self) -> Float[np.ndarray, " 3"]:
        """Unit vector along the plane, level."""
        along = np.cross([0.0, 0.0, 1.0], self.normal)
        return np.asarray(along / np.linalg.norm(along))


def find_mirrors(cast: CastRays) -> list[Mirror]:
    """Planes that many rays of the fan hit: same direction within 6 degrees, same distance within 0.75 m."""
    rows = np.flatnonzero(
        (cast.owner < 0) & (cast.actor < 0) & np.isfinite(cast.range_m)
        & np.isin(cast.material, _FLAT) & (np.abs(cast.normal[:, 2]) < 0.35)
    )  # fmt: skip
    if rows.size < _LEAST_RAYS:
        return []
    level = cast.normal[rows] * [1.0, 1.0, 0.0]
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    hits = cast.direction[rows] * cast.range_m[rows, None]
    distance = -np.einsum("ij,ij->i", level, hits)
    angle = np.floor(np.degrees(np.arctan2(level[:, 1], level[:, 0])) / _ANGLE_DEG)
    keys = np.stack([angle, np.floor(distance / _OFFSET_M)]).astype(np.int64)
    _, which, count = np.unique(keys, axis=1, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    mirrors = []
    for plane in np.argsort(-count, kind="stable")[:_MAX_MIRRORS]:
        if count[plane] < _LEAST_RAYS:
            break
        on_plane = which == plane
        normal = level[on_plane].mean(axis=0)
        normal /= np.linalg.norm(normal)
        offset = -float(np.mean(hits[on_plane] @ normal))
        metal = float(np.mean(cast.material[rows[on_plane]] == Material.METAL)) > 0.5
        if offset > 0:
            mirrors.append(Mirror(normal, offset, hits[on_plane], metal))
    return mirrors


def _gap_m(mirror: Mirror, along_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Distance along a mirror from places on it to the nearest hit."""
    hit = np.sort(mirror.hits_m @ mirror.along)
    right = np.clip(np.searchsorted(hit, along_m), 1, len(hit) - 1)
    return np.asarray(np.minimum(np.abs(hit[right] - along_m), np.abs(hit[right - 1] - along_m)))


def ghosts(points: ScatterPoints, mirrors: list[Mirror], level_db: float) -> ScatterPoints:
    """Images of road users in mirrors, where the straight way to the image crosses what was hit of the mirror.

    Both ways go by the mirror: the image stands in the mirror's direction at the whole way's length and moves as the
    mirror image of its original.

    Args:
        points: Road users' scattering points.
        mirrors: From :func:`find_mirrors`.
        level_db: Power relative to the original.
    """
    parts = []
    bodies = points.take(np.flatnonzero((points.kind == ScattererKind.OBJECT) | (points.kind == ScattererKind.LIMB)))
    for mirror in mirrors:
        side = bodies.position_m @ mirror.normal + mirror.distance_m
        image = bodies.position_m - 2 * side[:, None] * mirror.normal
        towards = image @ mirror.normal
        step = np.divide(-mirror.distance_m, towards, out=np.full(len(side), np.inf), where=towards < -1e-6)
        crossing = image * np.where(np.isfinite(step), step, 0.0)[:, None]
        up, height = mirror.hits_m[:, 2], crossing[:, 2]
        inside = _gap_m(mirror, crossing @ mirror.along) < _MARGIN_M
        inside &= (height > up.min() - _MARGIN_M) & (height < up.max() + _MARGIN_M)
        rows = np.flatnonzero(inside & (side > 0.3) & (step > 0) & (step < 1))
        velocity = bodies.velocity_m_s - 2 * (bodies.velocity_m_s @ mirror.normal)[:, None] * mirror.normal
        level = bodies.rcs_m2[rows] * 10 ** (level_db / 10)
        kind = np.full(len(rows), int(ScattererKind.GHOST))
        parts.append(ScatterPoints(image[rows], velocity[rows], level, bodies.actor[rows], kind))
    return ScatterPoints.join(parts)


def posts(mirrors: list[Mirror], world_T_radar: Float[np.ndarray, "4 4"], rng: np.random.Generator) -> ScatterPoints:
    """Posts of guard rails every 4 m, 0 to 5 dBsm, where rays hit the rail nearby; counted in the world's frame."""
    parts = []
    for mirror in mirrors:
        hits = mirror.hits_m
        along = hits @ mirror.along
        if not mirror.metal or np.ptp(hits[:, 2]) > _RAIL_TALL_M or np.ptp(along) < _RAIL_LONG_M:
            continue
        shift = float((world_T_radar[:3, :3] @ mirror.along) @ world_T_radar[:3, 3])
        first, last = np.ceil((along.min() + shift) / _POST_STEP_M), np.floor((along.max() + shift) / _POST_STEP_M)
        at = np.arange(first, last + 1) * _POST_STEP_M - shift
        near = _gap_m(mirror, at) < _POST_GAP_M
        position_m = -mirror.distance_m * mirror.normal + at[near, None] * mirror.along
        position_m[:, 2] = float(np.median(hits[:, 2]))
        parts.append(
            ScatterPoints.fixed(position_m, 10 ** (rng.uniform(*_POST_DB, len(position_m)) / 10), ScattererKind.POST)
        )
    return ScatterPoints.join(parts)


# Micro-Doppler of people: points of a walker's and a cyclist's body, swinging as sines

_DEVELOPMENT_M, _CRANK_M, _WHEEL_M = 5.0, 0.17, 0.34


class _LimbPart(NamedTuple):
    height: float  # share of the body's height
    side: float  # share of the body's width, from the middle to the left
    swing: float  # of the foot's
    phase: float  # turns
    share: float  # of the cross section


_WALKER = (
    _LimbPart(0.93, 0.0, 0.0, 0.0, 0.08),
    _LimbPart(0.78, 0.0, 0.0, 0.0, 0.25),
    _LimbPart(0.60, 0.0, 0.0, 0.0, 0.22),
    *(_LimbPart(0.62, side, 0.35, phase, 0.04) for side, phase in ((0.35, 0.5), (-0.35, 0.0))),
    *(_LimbPart(0.46, side, 0.60, phase, 0.03) for side, phase in ((0.38, 0.5), (-0.38, 0.0))),
    *(_LimbPart(0.28, side, 0.50, phase, 0.10) for side, phase in ((0.15, 0.0), (-0.15, 0.5))),
    *(_LimbPart(0.05, side, 1.00, phase, 0.055) for side, phase in ((0.15, 0.0), (-0.15, 0.5))),
)


def limb_points(
    actor: Actor,
    base_m: Float[np.ndarray, " 3"],
    heading: Float[np.ndarray, " 3"],
    velocity_m_s: Float[np.ndarray, " 3"],
    time_s: float,
) -> ScatterPoints:
    """Eleven points of a walker or a cyclist, whose cross sections add up to 1.

    Args:
        actor: Whose body.
        base_m: Middle of its bottom, shape (3,).
        heading: Unit vector ahead, shape (3,), same axes.
        velocity_m_s: Its velocity, shape (3,), same axes.
        time_s: The moment; the phase of an individual's gait comes from its seed.
    """
    seed = actor.seed
    seed_of_gait = np.random.SeedSequence(entropy=seed.entropy, spawn_key=(*seed.spawn_key, 0x6A17))
    start = float(np.random.default_rng(seed_of_gait).random())
    speed = float(np.linalg.norm(velocity_m_s))
    offset, swing, share = (_riding if actor.label == "bicycle" else _walking)(actor, speed, time_s, start)
    up = np.array([0.0, 0.0, 1.0])
    left = np.cross(up, heading)
    axes = np.stack([heading, left / max(float(np.linalg.norm(left)), 1e-9), up])
    still = ScatterPoints.fixed(base_m + offset @ axes, share, ScattererKind.LIMB)
    return ScatterPoints(still.position_m, velocity_m_s + swing @ axes, share, still.actor, still.kind)


_Swing = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]


def _walking(actor: Actor, speed: float, time_s: float, start: float) -> _Swing:
    parts = np.array(_WALKER)
    height, side, swing, phase, share = parts.T
    stride_m = max(actor.cycle_m, 0.7 * actor.size_m[2])
    turn = 2 * np.pi * (speed * time_s / stride_m + start + phase)
    swing_m = stride_m / 4 * swing if speed > 0.1 else np.zeros(len(parts))
    offset = np.stack([swing_m * np.sin(turn), side * actor.size_m[1], height * actor.size_m[2]], axis=1)
    ahead = swing_m * np.cos(turn) * 2 * np.pi * speed / stride_m
    return offset, np.stack([ahead, 0 * ahead, 0 * ahead], axis=1), share


def _riding(actor: Actor, speed: float, time_s: float, start: float) -> _Swing:
    length, width, height = actor.size_m
    body = np.array([[0.0, 0.0, 0.95], [-0.05, 0.0, 0.75], [-0.1, 0.0, 0.6], [0.1, 0.0, 0.45], [-0.1, 0.0, 0.4]])
    crank = 2 * np.pi * (speed * time_s / _DEVELOPMENT_M + start + np.array([0.0, 0.5]))
    feet = np.stack(
        [_CRANK_M * np.sin(crank) - 0.08, 0.2 * width * np.array([1, -1]), 0.3 + _CRANK_M * np.cos(crank)], 1
    )
    pedal = 2 * np.pi * speed / _DEVELOPMENT_M * _CRANK_M
    feet_speed = np.stack([pedal * np.cos(crank), 0 * crank, -pedal * np.sin(crank)], 1)
    rim = speed * time_s / _WHEEL_M + 2 * np.pi * (start + np.array([0.0, 0.5, 0.25, 0.75]))
    hub = length / 2 - _WHEEL_M
    wheels = np.stack(
        [np.array([hub, hub, -hub, -hub]) + _WHEEL_M * np.sin(rim), 0 * rim, _WHEEL_M * (1 + np.cos(rim))], 1
    )
    wheel_speed = np.stack([speed * np.cos(rim), 0 * rim, -speed * np.sin(rim)], 1)
    offset = np.concatenate([body * [1.0, 1.0, height], feet, wheels])
    swing = np.concatenate([np.zeros((5, 3)), feet_speed, wheel_speed])
    share = np.array([0.08, 0.2, 0.2, 0.11, 0.11, 0.07, 0.07, 0.04, 0.04, 0.04, 0.04])
    return offset, swing, share
