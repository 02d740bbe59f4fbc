"""What the air does to a frame: a dirty window, spray, and echoes of drops, flakes and fog that beat the surface's."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Float32, UInt8

from farfield.simulation.lidar.echoes import LidarEchoes
from farfield.simulation.lidar.model import LidarModel
from farfield.simulation.lidar.rays import Scan
from farfield.simulation.weather.backscatter import FOG_MOR_M, Beam, falling, soft_echo, strongest_particle
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.icing import WindowField, transmission, window_cover_kind
from farfield.simulation.weather.optics import (
    FOG_BACKSCATTER_PER_EXTINCTION,
    extinction_per_m,
    haze_extinction_per_m,
)
from farfield.simulation.weather.spray import Plume

SURFACE, PRECIPITATION, FOG, SPRAY = range(4)
BLANKING_M = (1.5, 3.0)
"""A shot's receiver opens somewhere in between."""

_WORTH = 0.1  # particles weaker than this are neither detected nor in the way


def beam_of(model: LidarModel) -> Beam:
    """A sensor's beam."""
    return Beam(
        model.wavelength_nm, model.reference_range_m, float(np.radians(model.divergence_deg)), pulse_m=model.merge_m
    )


def window_gain(
    scan: Scan, model: LidarModel, weather: Weather, time_s: float, seed: np.random.SeedSequence
) -> Float32[np.ndarray, " shots"]:
    """Two-way transmission of the sensor's window for each shot.

    Args:
        scan: The shots.
        model: The sensor.
        weather: What covers windows.
        time_s: Time since the sequence began.
        seed: The same for all frames of this sensor in a sequence.
    """
    low, high = float(np.degrees(scan.elevation_rad.min())), float(np.degrees(scan.elevation_rad.max()))
    half = 180.0 if model.spinning else model.azimuth_deg
    field = WindowField.draw(seed, window_cover_kind(weather), azimuth_deg=half, elevation_deg=(low, high))
    azimuth, elevation = np.meshgrid(np.degrees(scan.azimuth_rad), np.degrees(scan.elevation_rad))
    once = transmission(field, weather, time_s, model.wavelength_nm, azimuth, elevation)
    return (once**2).astype(np.float32).reshape(-1)


@dataclass(frozen=True, eq=False)
class SprayEffect:
    """Spray in the way: factor on each shot's signal, and the echo of the densest part met (strength 0: none)."""

    gain: Float32[np.ndarray, " shots"]
    range_m: Float32[np.ndarray, " shots"]
    strength: Float32[np.ndarray, " shots"]


def spray(
    scan: Scan,
    model: LidarModel,
    plumes: list[Plume],
    world_T_sensor: Float[np.ndarray, "4 4"],
    range_m: Float32[np.ndarray, " shots"],
) -> SprayEffect:
    """Extinction and echo of the plumes behind fast vehicles, where they stand at the reference time.

    Args:
        scan: The shots.
        model: The sensor.
        plumes: The plumes, in the world.
        world_T_sensor: Pose of the sensor at the reference time.
        range_m: How far each shot's middle gets, inf if it hits nothing.
    """
    count, beam = len(range_m), beam_of(model)
    out = SprayEffect(*(np.zeros(count, dtype=np.float32) for _ in range(3)))
    out.gain[:] = 1
    middle = scan.rays[:, 0].reshape(3, -1)
    for plume in plumes:
        offset = world_T_sensor[:3, :3].T @ (np.array(plume.middle_m) - world_T_sensor[:3, 3])
        distance = float(np.linalg.norm(offset))
        if distance > model.max_range_m:
            continue
        half_angle = np.arctan2(3 * max(plume.spread_m), distance) if distance > 1 else np.pi
        shots = np.flatnonzero(offset.astype(np.float32) @ middle > distance * np.cos(min(half_angle, np.pi)))
        directions = middle[:, shots].T.astype(np.float64) @ world_T_sensor[:3, :3].T
        ends = range_m[shots].astype(np.float64)
        depth, at, density = plume.depth(world_T_sensor[:3, 3], directions, ends)
        out.gain[shots] *= np.exp(-2 * depth).astype(np.float32)
        at = np.maximum(np.minimum(at, ends), model.min_range_m)
        strength = np.pi / 0.1 * (beam.reference_range_m / at) ** 2 * beam.overlap(at) * np.exp(-depth)
        strength *= density * FOG_BACKSCATTER_PER_EXTINCTION * beam.pulse_m * (at < ends - 1.0)
        louder = strength > out.strength[shots]
        out.range_m[shots[louder]], out.strength[shots[louder]] = at[louder], strength[louder]
    return out


def select_returns(
    model: LidarModel,
    weather: Weather,
    echoes: LidarEchoes,
    open_m: Float32[np.ndarray, " shots"],
    gain: Float32[np.ndarray, " shots"] | None,
    sprayed: SprayEffect | None,
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, " shots"], Float32[np.ndarray, " shots"], UInt8[np.ndarray, " shots"]]:
    """Select each shot's return: the strongest of its surface's echo and those of what hangs and falls in the air.

    Args:
        model: The sensor.
        weather: What is in the air.
        echoes: Echoes of surfaces, attenuated.
        open_m: How far each shot's middle gets before it hits something, inf if nothing.
        gain: Two-way transmission of the window for each shot, or None.
        sprayed: Spray, or None.
        rng: Draws the same count of numbers in one weather whatever was hit.

    Returns:
        Range, strength and kind of each shot's echo.
    """
    range_m, strength = echoes.range_m.copy(), echoes.strength.copy()
    kind = np.zeros(len(range_m), dtype=np.uint8)
    beam, extinction = beam_of(model), extinction_per_m(weather, model.wavelength_nm)
    through = np.ones(len(range_m), dtype=np.float32) if gain is None else gain

    offer = partial(_offer, range_m, strength, kind, open_m)
    # drops and flakes: the strongest of each shot, which also shades the surface
    for particles in falling(weather, model.wavelength_nm):
        law = strongest_particle(particles, beam, extinction)
        power, where = law.strength(rng.random(len(range_m)), least=_WORTH), rng.random(len(range_m))
        shots = np.flatnonzero(power > _WORTH)
        at, fill = law.locate(power[shots], where[shots])
        in_way = (at < open_m[shots]) & (kind[shots] == SURFACE)
        strength[shots] *= np.where(in_way, 1 - fill, 1.0).astype(np.float32)
        usable = at > model.min_range_m
        offer(shots[usable], at[usable], (power[shots] * through[shots])[usable], PRECIPITATION)
    # fog: its soft echo from beyond the blanking distance
    if weather.mor_m < FOG_MOR_M:
        soft = soft_echo(beam, haze_extinction_per_m(weather.mor_m, model.wavelength_nm))
        low, high = BLANKING_M
        at, power = soft.beyond(low + (high - low) * rng.random(len(range_m)))
        offer(np.arange(len(range_m)), at, power * through, FOG)
    # spray
    if sprayed is not None:
        shots = np.flatnonzero(sprayed.strength > _WORTH)
        offer(shots, sprayed.range_m[shots], (sprayed.strength * through)[shots], SPRAY)
    return range_m, strength, kind


def _offer(
    range_m: np.ndarray,
    strength: np.ndarray,
    kind: np.ndarray,
    open_m: np.ndarray,
    shots: np.ndarray,
    at_m: np.ndarray,
    power: np.ndarray,
    what: int,
) -> None:
    """Put echoes of the air in place of the shots' own (the first three arrays) where they are stronger."""
    wins = (power > strength[shots]) & (at_m < open_m[shots])
    replaced = shots[wins]
    range_m[replaced], strength[replaced], kind[replaced] = at_m[wins], power[wins], what
