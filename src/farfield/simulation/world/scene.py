"""A scene at work: what stands where at a continuous time, ready for rays."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from farfield.geometry.poses import pose, pose_from_yaw
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.world.highway import build_highway
from farfield.simulation.world.layout import CHUNK_M, Layout
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.lidar.sweep import Body
from farfield.simulation.trace import Tracer
from farfield.simulation.world.traffic import STEP_S, Motion
from farfield.simulation.world.urban import build_urban

_STAGE_M = 300.0  # the fixed surroundings are rebuilt each time the ego vehicle has driven so far
_VIEW_M = 360.0


@dataclass(frozen=True, eq=False)
class State:
    """The scene at one moment.

    Args:
        world_T_lidar: Pose of the Gaussian sensor.
        bodies: Fixed surroundings, then the road users within view.
        actors: Those road users.
        bottom_m: Middles of their bottoms in the world, shape (n, 3).
        yaw_rad: Their headings in the world, shape (n,).
    """

    world_T_lidar: Float[np.ndarray, "4 4"]
    bodies: list[Body]
    actors: list[Actor]
    bottom_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]


class Scene:
    """One sequence's world.

    Args:
        template: "highway" or "urban".
        seed: Draws everything; the same seed gives the same world.
        duration_s: How long it lasts.
        sensor_height_m: Height of the sensor above the road.
    """

    def __init__(
        self, template: str, seed: np.random.SeedSequence, *, duration_s: float, sensor_height_m: float
    ) -> None:
        build = {"highway": build_highway, "urban": build_urban}[template]
        layout_seed, actor_seed, self._pose_seed = seed.spawn(3)
        self.template, self.sensor_height_m = template, sensor_height_m
        self.layout: Layout = build(layout_seed, duration_s=duration_s)
        self.actors, self.motion = self.layout.population.finish(actor_seed)
        self._tracers: dict[int, Tracer] = {}
        self._stage: tuple[int, Tracer] | None = None

    def lidar_pose(self, time_s: float) -> Float[np.ndarray, "4 4"]:
        """Pose of the sensor on the ego vehicle's roof: heading and slope of the road, and a little nodding."""
        s = self._ego_s_m(time_s)
        (x, y, z), yaw = (value[0] for value in Motion(self.motion.position_m[:1], self.motion.yaw_rad[:1]).at(time_s))
        wave = np.random.default_rng(self._pose_seed).uniform(0, 2 * np.pi, 2)
        nod = np.radians(0.05) * np.sin(2 * np.pi * np.array([1.1, 0.7]) * time_s + wave)
        pitch = -self.layout.road.slope(s) + nod[0]
        tilt = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        lean = np.array([[1, 0, 0], [0, np.cos(nod[1]), -np.sin(nod[1])], [0, np.sin(nod[1]), np.cos(nod[1])]])
        world_T_car = pose_from_yaw(float(yaw), np.array([x, y, z]))
        return world_T_car @ pose(tilt @ lean, np.array([0.0, 0.0, self.sensor_height_m]))

    def _ego_s_m(self, time_s: float) -> float:
        track = self.layout.population.ego_s_m
        return float(np.interp(time_s / STEP_S, np.arange(len(track)), track))

    def _fixed(self, time_s: float) -> Body:
        stage = int(np.floor(self._ego_s_m(time_s) / _STAGE_M))
        if self._stage is None or self._stage[0] != stage:
            first = int(np.floor((stage * _STAGE_M - 20.0) / CHUNK_M))
            last = int(np.ceil(((stage + 1) * _STAGE_M + _VIEW_M) / CHUNK_M))
            mesh = Mesh.merge([self.layout.chunk(index) for index in range(first, last)])
            anchor = self.layout.road.point_m(np.array((stage + 0.5) * _STAGE_M), 0.0)
            self._stage = (stage, Tracer(mesh, anchor_m=anchor))
        return Body(self._stage[1], np.eye(4))

    def at(self, time_s: float) -> State:
        """The scene at a moment; road users beyond view or behind the sensor are left out."""
        world_T_lidar = self.lidar_pose(time_s)
        position, yaw = self.motion.at(time_s)
        offset = position - world_T_lidar[:3, 3]
        reach = np.array([actor.size_m[0] for actor in self.actors]) / 2
        ahead = offset @ world_T_lidar[:3, 0]
        near = (np.hypot(offset[:, 0], offset[:, 1]) < _VIEW_M) & (ahead > -reach)
        near[0] = False  # the ego vehicle
        chosen = np.flatnonzero(near)
        bodies = [self._fixed(time_s)]
        for row, index in enumerate(chosen):
            if index not in self._tracers:
                self._tracers[int(index)] = Tracer(self.actors[index].build())
            bodies.append(Body(self._tracers[int(index)], pose_from_yaw(float(yaw[index]), position[index]), row))
        return State(world_T_lidar, bodies, [self.actors[i] for i in chosen], position[chosen], yaw[chosen])
