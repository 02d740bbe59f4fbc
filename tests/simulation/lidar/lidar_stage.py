"""Small worlds for tests of LiDARs: bodies at given places, a sensor that stands or drives."""

import dataclasses

import numpy as np

from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box
from farfield.simulation.lidar.model import LidarModel
from farfield.simulation.trace import Body, Tracer
from farfield.simulation.world.scene import Window

HERE = np.eye(4)


def quiet(model: LidarModel, **changes: object) -> LidarModel:
    """A sensor without noise, losses, texture and jitter."""
    still = {"texture": 0.0, "dropout": 0.0, "range_noise_m": 0.0, "weak_noise_m": 0.0, "jitter_deg": 0.0}
    return dataclasses.replace(model, **(still | changes))


def coloured(mesh: Mesh, reflectance: float) -> Mesh:
    return dataclasses.replace(mesh, reflectance=np.full(len(mesh.faces), reflectance))


def plate(reflectance: float, *, width_m: float = 1.85, height_m: float = 1.5, material: int = Material.TRIM) -> Mesh:
    return coloured(box([0.01, width_m, height_m], [0, 0, 0], material), reflectance)


def body(mesh: Mesh, *place_m: float, yaw_rad: float = 0.0, actor: int = 0, knots: int = 1) -> Body:
    """A body that stands still."""
    where = pose_from_yaw(yaw_rad, (float(place_m[0]), float(place_m[1]), float(place_m[2])))
    return Body(Tracer(mesh), np.broadcast_to(where, (knots, 4, 4)), actor)


def frozen(*bodies: Body) -> Window:
    """A world that stands still, the sensor in its origin."""
    return moving(list(bodies), np.zeros(3), np.zeros(1))


def moving(bodies: list[Body], ego_velocity_m_s: np.ndarray, knots_s: np.ndarray, *, yaw_rate: float = 0.0) -> Window:
    """A world around a sensor that drives through the origin at the reference time."""
    poses = np.stack([pose_from_yaw(yaw_rate * float(knot), ego_velocity_m_s * knot) for knot in knots_s])
    count = max((item.actor for item in bodies), default=-1) + 1
    actors = [Actor(row, "sedan", (4.5, 1.9, 1.5), np.random.SeedSequence(row)) for row in range(count)]
    still = np.zeros((count, 3))
    return Window(5.0, knots_s, poses, bodies, actors, still, np.zeros(count), still, ego_velocity_m_s)
