"""One frame of a LiDAR: every shot cast at its own time, and the cloud that comes back."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, Shaped, UInt8

from farfield.frame import Cloud
from farfield.geometry.poses import invert
from farfield.simulation.lidar.air import SURFACE, select_returns, spray, window_gain
from farfield.simulation.lidar.echoes import (
    LidarEchoes,
    Returns,
    ambient_counts,
    measure,
    reflectivity,
    signal_counts,
    surface_echoes,
)
from farfield.simulation.lidar.model import LidarModel
from farfield.simulation.lidar.rays import NearestHits, Scan, SensorPath, turned
from farfield.simulation.lidar.surfaces import Surfaces
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.optics import extinction_per_m
from farfield.simulation.weather.spray import plumes
from farfield.simulation.world.scene import SceneWindow, at_knots

DRY = Weather()


@dataclass(frozen=True, eq=False)
class SimulatedSweep:
    """What one sensor measured in one frame.

    Args:
        cloud: Points in the sensor's frame at the reference time, by ring and column. ``extra`` holds ring, column,
            time_ns (relative to the reference time), and for spinning sensors reflectivity, ambient, range_mm, signal.
        actor: Row of the road user each point lies on, within ``SceneWindow.actors``; -1 for none.
        kind: What each point comes from: a constant of ``air``: SURFACE 0, PRECIPITATION 1, FOG 2, SPRAY 3.
        aimed: How many shots would have met each road user with a clean window in clear air and no losses; None where
            that was not counted.
    """

    cloud: Cloud
    actor: Int[np.ndarray, " n"]
    kind: UInt8[np.ndarray, " n"]
    aimed: Int[np.ndarray, " actors"] | None = None


def sweep(
    scan: Scan,
    model: LidarModel,
    window: SceneWindow,
    ego_T_sensor: Float[np.ndarray, "4 4"],
    rng: np.random.Generator,
    *,
    weather: Weather | None = None,
    window_seed: np.random.SeedSequence | None = None,
) -> SimulatedSweep:
    """Measure one frame.

    Every ray leaves from where the sensor is at its time and meets each body where it is then. A window with a single
    knot is a frozen world.

    Args:
        scan: The shots.
        model: The sensor.
        window: The scene around the reference time; its knots must span the scan's times, or be one.
        ego_T_sensor: Where the sensor is mounted.
        rng: Draws glass, detection, noise and what the weather scatters.
        weather: What is in the air and on the ground (default: clear and dry).
        window_seed: What draws the dirt and ice on this sensor's window in this sequence (default: clean).
    """
    surface_rng, air_rng = rng.spawn(2)
    # cast every ray; some shots pass through glass
    world_T_sensor = window.world_T_ego @ ego_T_sensor
    casting = NearestHits(scan, window.bodies, world_T_sensor, window.knots_s)
    count = casting.range_m.shape[1]
    passes = np.greater_equal(surface_rng.random(count, dtype=np.float32), model.glass_return)
    casting.see_through(passes)
    # the strongest echo of each shot, from surfaces and from the air
    surfaces = Surfaces.of(casting, model, weather or DRY)
    now = at_knots(world_T_sensor, window.knots_s, np.zeros(1))[0]
    echoes, kind = _echoes(scan, model, window, casting, surfaces, now, weather, window_seed, air_rng)
    # detection, and what is written of each return
    returns = measure(model, echoes.range_m, echoes.strength, surface_rng)
    face = surfaces.face[echoes.ray[returns.shot], returns.shot]
    on_surface = kind[returns.shot] == SURFACE
    points = _points(scan, model, returns, now, world_T_sensor, window.knots_s)
    extra = _columns(scan, model, returns)
    if model.spinning:
        diffuse = np.where(on_surface, surfaces.reflectance.diffuse[face], np.float32(0.3))
        extra["ambient"] = ambient_counts(diffuse, _daylight(weather or DRY), air_rng)
    intensity = (np.round(returns.reflectance.clip(0, 1) * 255) / 255).astype(np.float32)
    # which road user each point lies on, and how many shots were aimed at each
    aimed_at = surfaces.actor[casting.face[0]]
    aimed = np.bincount(
        aimed_at[(aimed_at >= 0) & (casting.range_m[0] < model.max_range_m)], minlength=len(window.actors)
    )
    actor = np.where(on_surface, surfaces.actor[face], -1)
    return SimulatedSweep(Cloud(points, intensity, extra), actor, kind[returns.shot], aimed)


def _echoes(
    scan: Scan,
    model: LidarModel,
    window: SceneWindow,
    casting: NearestHits,
    surfaces: Surfaces,
    world_T_sensor: Float[np.ndarray, "4 4"],
    weather: Weather | None,
    window_seed: np.random.SeedSequence | None,
    rng: np.random.Generator,
) -> tuple[LidarEchoes, UInt8[np.ndarray, " shots"]]:
    """The echo of each shot, of a surface or of something in the air, and which of them it is."""
    dirt = None
    if weather is not None and window_seed is not None:
        dirt = window_gain(scan, model, weather, window.time_s, window_seed)
    sprayed = None
    if weather is not None:
        size = np.array([actor.size_m for actor in window.actors]).reshape(-1, 3)
        label = [actor.label for actor in window.actors]
        spray_plumes = plumes(weather, window.bottom_m, window.yaw_rad, window.velocity_m_s, size, label)
        sprayed = spray(scan, model, spray_plumes, world_T_sensor, casting.range_m[0]) if spray_plumes else None
    gain = surfaces.wet
    for factor in (dirt, sprayed.gain if sprayed else None):
        if factor is not None:
            gain = factor if gain is None else gain * factor
    alpha = extinction_per_m(weather, model.wavelength_nm) if weather else 0.0
    hits = casting.range_m, casting.cosine, surfaces.face
    echoes = surface_echoes(model, surfaces.reflectance, scan.weights, *hits, extinction_per_m=alpha, gain=gain)
    if weather is None:
        return echoes, np.zeros(len(echoes.range_m), dtype=np.uint8)
    range_m, strength, kind = select_returns(model, weather, echoes, casting.range_m[0], dirt, sprayed, rng)
    return LidarEchoes(range_m, strength, echoes.ray), kind


def _points(
    scan: Scan,
    model: LidarModel,
    returns: Returns,
    now: Float[np.ndarray, "4 4"],
    world_T_sensor: Float[np.ndarray, "k 4 4"],
    knots_s: Float[np.ndarray, " k"],
) -> Float32[np.ndarray, "n 3"]:
    """Where the sensor believes its returns to lie, in its frame at the reference time."""
    ring, column = np.divmod(returns.shot, scan.shape[1])
    origin = np.broadcast_to(scan.origin_m, (3, 1, scan.shape[1]))[:, 0, column]
    points = origin + scan.rays[:, 0, ring, column] * returns.range_m
    if not model.compensated or len(knots_s) == 1:
        return np.ascontiguousarray(points.T)
    path = SensorPath((invert(now) @ world_T_sensor)[:, :3], knots_s)
    pose = path.at(scan.times_s[ring, column])
    return turned(pose, points) + pose[:, :, 3]


def _columns(scan: Scan, model: LidarModel, returns: Returns) -> dict[str, Shaped[np.ndarray, " n"]]:
    """The further columns of the cloud."""
    ring, column = np.divmod(returns.shot, scan.shape[1])
    extra: dict[str, Shaped[np.ndarray, " n"]] = {
        "ring": ring.astype(np.uint8),
        "column": column.astype(np.uint16),
        "time_ns": np.round(scan.times_s[ring, column] * 1e9).astype(np.int32),
    }
    if model.beams is not None:
        from_axis = returns.range_m + model.beams.origin_m
        extra["range_mm"] = np.round(np.maximum(from_axis, 0) * 1000).astype(np.uint32)
        extra["reflectivity"] = reflectivity(returns.reflectance)
        extra["signal"] = signal_counts(returns.strength)
    return extra


def _daylight(weather: Weather) -> float:
    """Illumination of the ground, 0 at night to 1 under a sun overhead in a clear sky."""
    return float(max(np.sin(np.radians(weather.sun_elevation_deg)), 0.0) * (1 - 0.6 * weather.cloud_cover))
