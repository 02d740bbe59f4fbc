"""Small worlds of given bodies, to measure a sensor's model in: it stands or drives among plates, cars, on asphalt."""

import dataclasses
from typing import Any

import numpy as np

from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, quads
from farfield.simulation.lidar.model import LidarModel
from farfield.simulation.trace import Body, Tracer
from farfield.simulation.world.scene import SceneWindow

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
