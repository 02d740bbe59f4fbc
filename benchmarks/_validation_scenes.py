"""Small worlds of given bodies, and a radar model's response to single scatterers, by brute force."""

import dataclasses
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, quads
from farfield.simulation.lidar.model import LidarModel
from farfield.simulation.radar.model import RadarModel, virtual_array
from farfield.simulation.radar.points import Scatterers, cell_snr
from farfield.simulation.radar.synthesis import synthesise
from farfield.simulation.trace import Body, Tracer
from farfield.simulation.world.scene import SceneWindow

# Small worlds of given bodies, to measure a sensor's model in: it stands or drives among plates, cars, on asphalt.


Number = float | int
HERE = np.eye(4)
"""The pose of a sensor in the origin."""


def quiet(model: LidarModel, **changes: Any) -> LidarModel:
    """A sensor without noise, losses, texture and jitter."""
    still = {"texture": 0.0, "dropout": 0.0, "range_noise_m": 0.0, "weak_noise_m": 0.0, "jitter_deg": 0.0}
    return dataclasses.replace(model, **(still | changes))


def coloured(mesh: Mesh, reflectance: Number) -> Mesh:
    """A mesh of one reflectance."""
    return dataclasses.replace(mesh, reflectance=np.full(len(mesh.faces), reflectance))


def plate(
    reflectance: Number, *, width_m: Number = 1.85, height_m: Number = 1.5, material: int = Material.TRIM
) -> Mesh:
    """A thin upright plate that faces along x, round its own origin."""
    return coloured(box([0.01, width_m, height_m], [0, 0, 0], material), reflectance)


def body(mesh: Mesh, *place_m: Number, yaw_rad: Number = 0.0, actor: int = 0, knots: int = 1) -> Body:
    """A body that stands still."""
    where = pose_from_yaw(yaw_rad, (float(place_m[0]), float(place_m[1]), float(place_m[2])))
    return Body(Tracer(mesh), np.broadcast_to(where, (knots, 4, 4)), actor)


def frozen(*bodies: Body) -> SceneWindow:
    """A world that stands still, the sensor in its origin."""
    return moving(list(bodies), np.zeros(3), np.zeros(1))


def moving(
    bodies: list[Body], ego_velocity_m_s: np.ndarray, knots_s: np.ndarray, *, yaw_rate: Number = 0.0
) -> SceneWindow:
    """A world around a sensor that drives through the origin at the reference time."""
    poses = np.stack([pose_from_yaw(yaw_rate * float(knot), ego_velocity_m_s * knot) for knot in knots_s])
    count = max((item.actor for item in bodies), default=-1) + 1
    actors = [Actor(row, "sedan", (4.5, 1.9, 1.5), np.random.SeedSequence(row)) for row in range(count)]
    still = np.zeros((count, 3))
    return SceneWindow(5.0, knots_s, poses, bodies, actors, still, np.zeros(count), still, ego_velocity_m_s)


def fleet(rng: np.random.Generator) -> SceneWindow:
    """Rear ends of 160 cars within 70 degrees and 20 to 70 m, a log-normal paint each, none behind another."""
    cars = []
    for row in range(160):
        azimuth, range_m = np.radians(-68 + 136 * row / 159), rng.uniform(20, 70)
        reflectance = float(np.clip(0.25 * np.exp(0.7 * rng.standard_normal()), 0.03, 1))
        mesh = plate(reflectance, width_m=1.0 * range_m / 50, height_m=1.5)
        place = range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0.0
        cars.append(body(mesh, *(float(value) for value in place), yaw_rad=float(azimuth), actor=row))
    return frozen(*cars)


def patch_of_road(material: Material, *, reflectance: Number) -> SceneWindow:
    """Level ground ahead of a sensor that stands 1.9 m above it."""
    road = quads(np.array([[[3.0, -30, 0], [40, -30, 0], [40, 30, 0], [3, 30, 0]]]), int(material))
    return frozen(body(coloured(road, reflectance), 0, 0, -1.9, actor=-1))


def asphalt() -> Mesh:
    """A wide plane of asphalt, painted."""
    corners = np.array([[[-50.0, -200, 0], [400, -200, 0], [400, 200, 0], [-50, 200, 0]]])
    return painted(quads(corners, int(Material.ASPHALT)))


def painted(mesh: Mesh) -> Mesh:
    """A mesh in the paint of one seed."""
    return mesh.painted(np.random.default_rng(5))


def on_asphalt(*bodies: tuple[Mesh, np.ndarray], fixed: Mesh | None = None) -> SceneWindow:
    """One moment of a drive: the fixed world, by default asphalt, then road users as meshes at their poses."""
    actors = [Actor(i, "sedan", (4.5, 1.8, 1.5), np.random.SeedSequence(i)) for i in range(len(bodies))]
    poses = [world_T_body for _, world_T_body in bodies]
    return SceneWindow(
        time_s=0.0,
        knots_s=np.zeros(1),
        world_T_ego=np.eye(4)[None],
        bodies=[Body(Tracer(fixed or asphalt()), np.eye(4)[None])]
        + [Body(Tracer(mesh), world_T_body[None], row) for row, (mesh, world_T_body) in enumerate(bodies)],
        actors=actors,
        bottom_m=np.array([pose[:3, 3] for pose in poses]).reshape(-1, 3),
        yaw_rad=np.zeros(len(bodies)),
        velocity_m_s=np.tile([5.0, 0.0, 0.0], (len(bodies), 1)),
        ego_velocity_m_s=np.array([20.0, 0.0, 0.0]),
    )


# A radar model's response to single scatterers: the tensor by brute force, the point spread, the Doppler spectrum.


def scatterers_of_snr(
    range_m: Float[np.ndarray, " n"],
    azimuth_deg: float | Float[np.ndarray, " n"],
    elevation_deg: float | Float[np.ndarray, " n"],
    velocity_m_s: float | Float[np.ndarray, " n"],
    snr: float,
    model: RadarModel,
) -> Scatterers:
    """Scatterers that alone give cells of this signal to noise ratio."""
    azimuth, elevation = np.radians(np.broadcast_to(azimuth_deg, np.shape(range_m))), np.radians(elevation_deg)
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    position = np.asarray(range_m)[:, None] * np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=1)
    velocity = np.broadcast_to(velocity_m_s, np.shape(range_m)).astype(float)
    unit = Scatterers.of(position, velocity, np.ones(len(position)))
    return replace(unit, rcs_m2=snr / cell_snr(unit, model))


def sampled_tensor(
    scatterers: Scatterers, model: RadarModel, phase_rad: Float[np.ndarray, " n"], *, walk: bool = False
) -> Float[np.ndarray, "d r e a"]:
    """The tensor by brute force, power over noise: every channel's beat signal is sampled, then come FFTs and beams.

    The slow check of ``synthesise``, for a small radar.

    Args:
        scatterers: What reflects.
        model: The radar.
        phase_rad: Phase of each scatterer.
        walk: Whether scatterers move through range while the chirps of a frame are sent.
    """
    axes, array = model.axes, virtual_array(model)
    samples, chirps = np.arange(len(axes.range_m)), np.arange(len(axes.doppler_m_s))
    signal = np.zeros((len(samples), len(chirps), model.elevation_elements, model.azimuth_elements), dtype=complex)
    for i, snr in enumerate(cell_snr(scatterers, model)):
        direction = scatterers.position_m[i] / scatterers.range_m[i]
        moved = scatterers.velocity_m_s[i] * model.loop_s * (chirps + 0.5 - len(chirps) / 2) if walk else 0.0 * chirps
        turns = 1 / (axes.range_step_m * len(samples))
        from_middle = samples[:, None] - (len(samples) - 1) / 2  # the carrier is the middle of the sweep
        beat = np.exp(2j * np.pi * turns * (samples[:, None] * scatterers.range_m[i] + from_middle * moved))
        turn = scatterers.velocity_m_s[i] / axes.velocity_span_m_s - axes.doppler_m_s[0] / axes.velocity_span_m_s
        rows = np.exp(1j * (np.pi * array.azimuth_slot * direction[1] + array.azimuth_error_rad))
        columns = np.exp(1j * (np.pi * array.elevation_slot * direction[2] + array.elevation_error_rad))
        echo = beat * np.exp(2j * np.pi * chirps * turn)
        level = np.sqrt(snr / model.channels) / array.gain * np.exp(1j * phase_rad[i])
        signal += level * echo[:, :, None, None] * columns[:, None] * rows
    cells = np.fft.fft(np.fft.fft(signal, axis=0), axis=1) / (len(samples) * len(chirps))
    u_az, u_el = np.sin(np.radians(axes.azimuth_deg)), np.sin(np.radians(axes.elevation_deg))
    rows = np.exp(-1j * np.pi * np.outer(u_az, array.azimuth_slot)) / np.sqrt(model.azimuth_elements)
    columns = np.exp(-1j * np.pi * np.outer(u_el, array.elevation_slot)) / np.sqrt(model.elevation_elements)
    return np.abs(np.einsum("qe,ja,rdea->drqj", columns, rows, cells)) ** 2


def point_spread_db(
    offset_bins: Float[np.ndarray, " n"], axis: Literal["range", "doppler"], model: RadarModel
) -> Float[np.ndarray, " n"]:
    """Power in one cell, in dB of the peak, as a target moves away from the cell's centre along range or Doppler."""
    exact = replace(model, truncation_db=-np.inf, range_migration=False)
    axes = exact.axes
    levels = []
    for offset in offset_bins:
        range_m = axes.range_m[100] + (offset * axes.range_step_m if axis == "range" else 0.0)
        speed = offset * axes.doppler_step_m_s if axis == "doppler" else 0.0
        one = scatterers_of_snr(np.array([range_m]), 0.0, 0.0, speed, 1.0, exact)
        cell = synthesise(one, exact, np.zeros(1))
        levels.append(np.sum(cell.re[100, 32].astype(float) ** 2 + cell.im[100, 32].astype(float) ** 2))
    return 10 * np.log10(np.array(levels) * virtual_array(exact).gain ** 2)


def doppler_spectrum(velocity_m_s: float, model: RadarModel) -> Float[np.ndarray, " d"]:
    """Power of one target ahead over the Doppler bins."""
    one = scatterers_of_snr(np.array([30.0]), 0.0, 0.0, velocity_m_s, 1e3, model)
    cell = synthesise(one, model, np.zeros(1))
    return (cell.re**2 + cell.im**2).sum(axis=(0, 2))
