"""Collects a scene's road users: lanes of car-following traffic, parked vehicles, walkers and crossers."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.actors import Actor, draw_car, draw_size_m
from farfield.simulation.world.road import RoadLine
from farfield.simulation.world.traffic import STEP_S, Motion, follow, in_conflict

KindChoice = Callable[[np.random.Generator], str]


@dataclass(frozen=True)
class Lane:
    """One lane of moving traffic.

    Args:
        offset_m: Middle of the lane, to the left of the reference line.
        direction: 1 along the reference line, -1 against it.
        first_m: Where the traffic begins, as s.
        last_m: Where it ends.
        gap_m: Mean free distance between bodies.
        speed_m_s: Mean desired speed.
        choose: Draws each vehicle's kind.
        trailer_share: Probability that a car pulls a trailer.
    """

    offset_m: float
    direction: int
    first_m: float
    last_m: float
    gap_m: float
    speed_m_s: float
    choose: KindChoice
    trailer_share: float = 0.0


@dataclass
class _Queue:
    """Vehicles of all lanes before they drive."""

    progress_m: list[float] = field(default_factory=list)
    desired_m_s: list[float] = field(default_factory=list)
    length_m: list[float] = field(default_factory=list)
    leader: list[int] = field(default_factory=list)
    lane: list[int] = field(default_factory=list)
    bodies: list[list[tuple[str, Float[np.ndarray, " 3"], float]]] = field(default_factory=list)


class Population:
    """Road users of one sequence; the first is the ego vehicle.

    Args:
        road: The reference line.
        steps: Number of moments, 0.1 s apart.
        rng: Source of randomness.
    """

    def __init__(self, road: RoadLine, *, steps: int, rng: np.random.Generator) -> None:
        self.road, self.steps, self.rng = road, steps, rng
        self._kind: list[str] = []
        self._size: list[Float[np.ndarray, " 3"]] = []
        self._position: list[Float[np.ndarray, "steps 3"]] = []
        self._yaw: list[Float[np.ndarray, " steps"]] = []
        self._loose: list[bool] = []
        self.ego_s_m: Float[np.ndarray, " steps"] = np.zeros(steps)
        self.ego_d_m = 0.0

    def add(
        self,
        kind: str,
        position_m: Float[np.ndarray, "steps 3"] | Float[np.ndarray, " 3"],
        yaw_rad: Float[np.ndarray, " steps"] | float,
        *,
        loose: bool,
        size_m: Float[np.ndarray, " 3"] | None = None,
    ) -> None:
        """Add one road user with its whole path; ``loose`` ones disappear if they would touch another."""
        self._kind.append(kind)
        self._size.append(draw_size_m(kind, self.rng) if size_m is None else size_m)
        self._position.append(np.broadcast_to(position_m, (self.steps, 3)))
        self._yaw.append(np.broadcast_to(np.asarray(yaw_rad, dtype=np.float64), (self.steps,)))
        self._loose.append(loose)

    def add_parked(self, s_m: float, d_m: float, *, turn_rad: float = 0.0, kind: str | None = None) -> None:
        """Add a standing vehicle on the road's frame; it yields its place if that is taken."""
        place = np.array(s_m)
        heading = float(self.road.heading_rad(place)) + turn_rad + float(self.rng.normal(0, 0.02))
        self.add(kind or draw_car(self.rng), self.road.point_m(place, d_m), heading, loose=True)

    def add_straight(
        self, kind: str, start_m: Float[np.ndarray, " 3"], yaw_rad: float, speed_m_s: float, *, delay_s: float = 0.0
    ) -> None:
        """Add one that moves straight at constant speed after a delay (negative: it moved before already)."""
        run = np.maximum(np.arange(self.steps) * STEP_S - delay_s, 0.0) * speed_m_s
        if delay_s < 0:
            run = (np.arange(self.steps) * STEP_S - delay_s) * speed_m_s
        along = np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])
        self.add(kind, start_m + run[:, None] * along, yaw_rad, loose=True)

    def add_along(self, kind: str, s_m: float, d_m: float, direction: int, speed_m_s: float) -> None:
        """Add one that keeps its offset and speed along the road, such as a pedestrian on the pavement."""
        s = s_m + direction * speed_m_s * STEP_S * np.arange(self.steps)
        yaw = self.road.heading_rad(s) + (0.0 if direction > 0 else np.pi)
        self.add(kind, self.road.point_m(s, d_m), yaw, loose=True)

    def drive(self, lanes: list[Lane], *, ego_lane: int, ego_speed_m_s: float) -> None:
        """Fill the lanes and let them drive; the ego vehicle starts at s = 0 of its lane and becomes actor 0."""
        queue = _Queue()
        for index, lane in enumerate(lanes):
            self._fill(queue, index, lane, ego_speed_m_s if index == ego_lane else None)
        path = follow(
            np.array(queue.progress_m),
            np.array(queue.desired_m_s),
            np.array(queue.length_m),
            np.array(queue.leader),
            steps=self.steps,
        )
        ego = next(row for row, bodies in enumerate(queue.bodies) if bodies[0][0] == "ego")
        self.ego_s_m, self.ego_d_m = path[ego], lanes[ego_lane].offset_m
        for row in [ego, *(r for r in range(len(path)) if r != ego)]:
            lane = lanes[queue.lane[row]]
            wobble = 0.0 if row == ego else float(np.clip(self.rng.normal(0, 0.15), -0.35, 0.35))
            for kind, size, behind_m in queue.bodies[row]:
                s = lane.direction * (path[row] - behind_m)
                yaw = self.road.heading_rad(s) + (0.0 if lane.direction > 0 else np.pi)
                body = "sedan" if kind == "ego" else kind
                self.add(body, self.road.point_m(s, lane.offset_m + wobble), yaw, loose=False, size_m=size)

    def _fill(self, queue: _Queue, index: int, lane: Lane, ego_speed_m_s: float | None) -> None:
        """Fill one lane from its far end backwards, each vehicle led by the one before."""
        rng = self.rng
        ends = sorted((lane.direction * lane.first_m, lane.direction * lane.last_m))
        front, leader = ends[1], -1
        placed_ego = ego_speed_m_s is None
        while front > ends[0]:
            front -= 3.0 + rng.exponential(max(lane.gap_m - 3.0, 1.0))
            bodies, length = self._draw_bodies(lane)
            desired = lane.speed_m_s * float(np.clip(rng.normal(1.0, 0.09), 0.7, 1.3))
            if bodies[0][0] in ("semi", "box", "tanker", "tipper", "flatbed"):
                desired = min(desired, 25.0 * float(rng.uniform(0.92, 1.05)))
            if not placed_ego and front - length < 2.5 + 5.0:
                placed_ego, front = True, min(front, 2.4)
                bodies, length, desired = [("ego", np.array([4.8, 1.9, 1.6]), 0.0)], 4.8, float(ego_speed_m_s or 0.0)
                front = 2.4
            queue.progress_m.append(front - length / 2)
            queue.desired_m_s.append(desired)
            queue.length_m.append(length)
            queue.leader.append(leader)
            queue.lane.append(index)
            queue.bodies.append(bodies)
            leader, front = len(queue.leader) - 1, front - length

    def _draw_bodies(self, lane: Lane) -> tuple[list[tuple[str, Float[np.ndarray, " 3"], float]], float]:
        """One vehicle, or a car with its trailer: (kind, size, how far its middle lies behind the whole's middle)."""
        kind = lane.choose(self.rng)
        size = draw_size_m(kind, self.rng)
        length = float(size[0])
        if kind in ("suv", "pickup", "van") and self.rng.random() < lane.trailer_share:
            towed = draw_size_m("trailer", self.rng)
            whole = length + 0.3 + float(towed[0])
            return [(kind, size, (length - whole) / 2), ("trailer", towed, (whole - float(towed[0])) / 2)], whole
        return [(kind, size, 0.0)], length

    def finish(self, seed: np.random.SeedSequence) -> tuple[list[Actor], Motion]:
        """Take away loose actors that would touch others; give each of the rest its own seed."""
        size = np.stack(self._size)
        position, yaw = np.stack(self._position), np.stack(self._yaw)
        gone = in_conflict(position, yaw, size, np.array(self._loose), margin_m=0.3)
        seeds = seed.spawn(len(size))
        kept = np.flatnonzero(~gone)
        actors = [
            Actor(int(i), self._kind[i], (float(size[i, 0]), float(size[i, 1]), float(size[i, 2])), seeds[i])
            for i in kept
        ]
        return actors, Motion(position[kept], yaw[kept])
