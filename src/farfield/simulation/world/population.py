"""Collects a scene's road users: lanes of car-following traffic, parked vehicles, walkers and crossers."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.simulation.bodies.actors import Actor, draw_car, draw_size_m, draw_truck
from farfield.simulation.world.motion import STEP_S, Motion, in_conflict
from farfield.simulation.world.road import RoadLine
from farfield.simulation.world.traffic import DriverSet, LaneChange, Signal, drive

_EGO_SIZE_M = np.array([4.8, 1.9, 1.6])
_TRUCKS = ("box", "semi", "flatbed", "tanker", "tipper")
_HITCH_M, _MARGIN_M = 0.5, 0.25
_STANDING = 0.72  # a standing person is so long, as a share of one in mid stride


def choose_kind(truck_share: float, long_haul: bool, prior: str, rng: np.random.Generator) -> str:
    """The kind of the next vehicle of a lane: a large one, a motorcycle, or a car."""
    draw = rng.random()
    if draw < truck_share:
        return draw_truck(rng, long_haul=long_haul, prior=prior)
    return "motorcycle" if draw > 0.97 else draw_car(rng, prior)


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
        width_m: Its width.
        truck_share: Share of large vehicles.
        trailer_share: Probability that a car pulls a trailer.
        kind: The kind of all its vehicles, unless they are drawn.
    """

    offset_m: float
    direction: int
    first_m: float
    last_m: float
    gap_m: float
    speed_m_s: float
    width_m: float
    truck_share: float = 0.0
    trailer_share: float = 0.0
    kind: str = ""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Something fixed on the ground: loose road users that would touch it disappear.

    Args:
        position_m: Middle of its bottom, shape (3,).
        yaw_rad: Its heading.
        size_m: Length, width, height, shape (3,).
    """

    position_m: Float[np.ndarray, " 3"]
    yaw_rad: float
    size_m: Float[np.ndarray, " 3"]


@dataclass
class _Queue:
    """Vehicles of all lanes before they drive."""

    progress_m: list[float] = field(default_factory=list)
    desired_m_s: list[float] = field(default_factory=list)
    length_m: list[float] = field(default_factory=list)
    lane: list[int] = field(default_factory=list)
    bodies: list[list[tuple[str, Float[np.ndarray, " 3"], float]]] = field(default_factory=list)


def _smooth(share: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """A step from 0 to 1 without jumps in its first two derivatives."""
    u = np.clip(share, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2)


class Population:
    """Road users of one sequence; the first is the ego vehicle.

    Args:
        road: The reference line.
        steps: Number of moments, 0.1 s apart.
        rng: Source of randomness.
        sizes: Name of the size prior.
        long_haul: Whether large vehicles are those of long-haul roads.

    Attributes:
        obstacles: What road users keep clear of.
    """

    def __init__(
        self, road: RoadLine, *, steps: int, rng: np.random.Generator, sizes: str = "us", long_haul: bool = False
    ) -> None:
        self.road, self.steps, self.rng, self.sizes, self.long_haul = road, steps, rng, sizes, long_haul
        self._kind: list[str] = []
        self._size: list[Float[np.ndarray, " 3"]] = []
        self._position: list[Float[np.ndarray, "steps 3"]] = []
        self._yaw: list[Float[np.ndarray, " steps"]] = []
        self._slope: list[Float[np.ndarray, "steps 2"]] = []
        self._loose: list[bool] = []
        self.obstacles: list[Obstacle] = []
        self.ego_s_m: Float[np.ndarray, " steps"] = np.zeros(steps)
        self.changes: list[LaneChange] = []

    def draw_car(self) -> str:
        """A car's kind under the prior."""
        return draw_car(self.rng, self.sizes)

    def draw_truck(self) -> str:
        """A large vehicle's kind under the prior."""
        return draw_truck(self.rng, long_haul=self.long_haul, prior=self.sizes)

    def draw_size_m(self, kind: str) -> Float[np.ndarray, " 3"]:
        """A body's size under the prior."""
        return draw_size_m(kind, self.rng, self.sizes)

    def add(
        self,
        kind: str,
        position_m: Float[np.ndarray, "steps 3"] | Float[np.ndarray, " 3"],
        yaw_rad: Float[np.ndarray, " steps"] | float,
        at_s_m: Float[np.ndarray, " steps"] | float,
        *,
        loose: bool = True,
        size_m: Float[np.ndarray, " 3"] | None = None,
    ) -> None:
        """Add one road user with its whole path; ``loose`` ones disappear if they would touch another.

        Args:
            kind: Its body.
            position_m: Where it is at each step, or always.
            yaw_rad: Its heading at each step, or always.
            at_s_m: The station whose slopes it stands on.
            loose: Whether it yields.
            size_m: Its size, unless drawn.
        """
        self._kind.append(kind)
        self._size.append(self.draw_size_m(kind) if size_m is None else size_m)
        self._position.append(np.broadcast_to(position_m, (self.steps, 3)))
        yaw, station = np.asarray(yaw_rad, dtype=np.float64), np.asarray(at_s_m, dtype=np.float64)
        along, left = self.road.slopes(station)
        turn = yaw - self.road.heading_rad(station)
        slope = np.stack([along * np.cos(turn) + left * np.sin(turn), left * np.cos(turn) - along * np.sin(turn)], -1)
        self._yaw.append(np.broadcast_to(yaw, (self.steps,)))
        self._slope.append(np.broadcast_to(slope, (self.steps, 2)))
        self._loose.append(loose)

    def add_parked(
        self, s_m: float, d_m: float, *, turn_rad: float = 0.0, kind: str | None = None, raise_m: float = 0.0
    ) -> None:
        """Add a standing road user on the road's frame; it yields its place if that is taken."""
        station_m = np.array(s_m)
        heading = float(self.road.heading_rad(station_m)) + turn_rad + float(self.rng.normal(0, 0.02))
        body = kind or self.draw_car()
        size = self.draw_size_m(body)
        if body in ("pedestrian", "child"):
            size = size * np.array([_STANDING, 1.0, 1.0])
        self.add(body, self.road.point_m(station_m, d_m) + np.array([0, 0, raise_m]), heading, s_m, size_m=size)

    def add_crossing(
        self,
        kind: str,
        s_m: float,
        from_d_m: float,
        direction: int,
        speed_m_s: float,
        *,
        delay_s: float = 0.0,
        turn_rad: float = 0.0,
        raise_m: float = 0.0,
    ) -> None:
        """Add one that crosses the road at constant speed after a delay (negative: it has moved before already).

        Args:
            kind: Its body.
            s_m: Station it crosses at.
            from_d_m: Offset it starts from.
            direction: 1 towards the left, -1 towards the right.
            speed_m_s: Its speed.
            delay_s: How long it waits.
            turn_rad: Angle of its way against the road's normal.
            raise_m: Height of its way above the road's surface.
        """
        station_m = np.array(s_m)
        heading = float(self.road.heading_rad(station_m)) + direction * np.pi / 2 + turn_rad
        time = np.arange(self.steps) * STEP_S - delay_s
        run = (np.maximum(time, 0.0) if delay_s > 0 else time) * speed_m_s
        along = np.array([np.cos(heading), np.sin(heading), 0.0])
        start = self.road.point_m(station_m, from_d_m) + np.array([0.0, 0.0, raise_m])
        self.add(kind, start + run[:, None] * along, heading, s_m)

    def add_along(
        self, kind: str, s_m: float, d_m: float, direction: int, speed_m_s: float, *, raise_m: float = 0.0
    ) -> None:
        """Add one that keeps its offset and speed along the road, such as a pedestrian on the pavement."""
        if speed_m_s == 0.0:
            self.add_parked(s_m, d_m, turn_rad=float(self.rng.uniform(-np.pi, np.pi)), kind=kind, raise_m=raise_m)
            return
        s = s_m + direction * speed_m_s * STEP_S * np.arange(self.steps)
        yaw = self.road.heading_rad(s) + (0.0 if direction > 0 else np.pi)
        self.add(kind, self.road.point_m(s, d_m) + np.array([0.0, 0.0, raise_m]), yaw, s)

    def place_ego(self, s_m: Float[np.ndarray, " steps"], d_m: float) -> None:
        """Let the ego vehicle follow stations of its own instead of a lane's traffic; call this before any other."""
        self.ego_s_m = s_m
        heading = self.road.heading_rad(s_m)
        self.add("sedan", self.road.point_m(s_m, d_m), heading, s_m, loose=False, size_m=_EGO_SIZE_M)

    def drive(
        self,
        lanes: Sequence[Lane],
        *,
        ego_lane: int = -1,
        ego_speed_m_s: float = 0.0,
        signals: Sequence[Signal] = (),
        surge: float = 0.0,
    ) -> None:
        """Fill the lanes and let them drive; the ego vehicle starts at s = 0 of its lane and becomes actor 0.

        Args:
            lanes: The lanes.
            ego_lane: Index of the ego vehicle's, or -1 if it has been placed already.
            ego_speed_m_s: Its desired speed.
            signals: Stop lines.
            surge: Depth of stop-and-go waves.
        """
        queue = _Queue()
        for index, lane in enumerate(lanes):
            self._fill(queue, index, lane, ego_speed_m_s if index == ego_lane else None)
        ego = next((row for row, bodies in enumerate(queue.bodies) if bodies[0][0] == "ego"), -1)
        result = drive(self._drivers(queue, ego, surge), _beside(lanes), steps=self.steps, signals=list(signals))
        self.changes = result.changes
        if ego >= 0:
            self.ego_s_m = result.progress_m[ego]
        moves: dict[int, list[LaneChange]] = {}
        for change in result.changes:
            moves.setdefault(change.row, []).append(change)
        rows = [row for row in range(len(queue.bodies)) if row != ego]
        for row in [ego, *rows] if ego >= 0 else rows:
            self._add_driven(queue.bodies[row], result.progress_m[row], lanes, queue.lane[row], moves.get(row, []))

    def _drivers(self, queue: _Queue, ego: int, surge: float) -> DriverSet:
        """The published parameters (T 1.8 s, s0 2 m, a 1 m/s2, b 3 m/s2), each within 20 %."""
        n, rng = len(queue.lane), self.rng
        around = rng.uniform(0.8, 1.2, (4, n))
        large = np.array([bodies[0][0] in (*_TRUCKS, "bus") for bodies in queue.bodies])
        return DriverSet(
            progress_m=np.array(queue.progress_m),
            lane=np.array(queue.lane),
            length_m=np.array(queue.length_m),
            desired_m_s=np.array(queue.desired_m_s),
            headway_s=1.8 * around[0] * (0.75 if surge else 1.0),
            standstill_m=2.0 * around[1],
            accelerate_m_s2=np.where(large, 0.7, 1.0) * around[2],
            brake_m_s2=3.0 * around[3],
            steady=np.arange(n) == ego,
            surge=surge,
        )

    def _add_driven(
        self,
        bodies: list[tuple[str, Float[np.ndarray, " 3"], float]],
        progress_m: Float[np.ndarray, " steps"],
        lanes: Sequence[Lane],
        first_lane: int,
        changes: list[LaneChange],
    ) -> None:
        """One vehicle, or a car and its trailer, along its lane and through its lane changes."""
        lane = lanes[first_lane]
        spare = (lane.width_m - max(float(size[1]) for _, size, _ in bodies)) / 2 - 0.15
        wobble = float(np.clip(self.rng.normal(0, 0.15), -0.35, 0.35))
        wobble = 0.0 if bodies[0][0] == "ego" else float(np.clip(wobble, min(-spare, 0.0), max(spare, 0.0)))
        for kind, size, behind_m in bodies:
            own = progress_m - behind_m
            offset, rate = np.full(self.steps, lane.offset_m + wobble), np.zeros(self.steps)
            for change in changes:
                step_m = lanes[change.after].offset_m - lanes[change.before].offset_m
                ends = [(own + shift - change.start_m) / change.length_m for shift in (0.0, 0.05)]
                offset = offset + step_m * _smooth(ends[0])
                rate = rate + step_m * (_smooth(ends[1]) - _smooth(ends[0])) / 0.05
            s = lane.direction * own
            yaw = self.road.heading_rad(s) + np.arctan2(rate, lane.direction)
            body = "sedan" if kind == "ego" else kind
            self.add(body, self.road.point_m(s, offset), yaw, s, loose=False, size_m=size)

    def _fill(self, queue: _Queue, index: int, lane: Lane, ego_speed_m_s: float | None) -> None:
        """Fill one lane from its far end backwards, each vehicle led by the one before."""
        rng = self.rng
        ends = sorted((lane.direction * lane.first_m, lane.direction * lane.last_m))
        front = ends[1]
        placed_ego = ego_speed_m_s is None
        while front > ends[0] or not placed_ego:
            front -= 3.0 + rng.exponential(max(lane.gap_m - 3.0, 1.0))
            bodies, length = self._draw_bodies(lane)
            desired = lane.speed_m_s * float(np.clip(rng.normal(1.0, 0.09), 0.7, 1.3))
            if bodies[0][0] in _TRUCKS:
                desired = min(desired, 25.0 * float(rng.uniform(0.92, 1.05)))
            if not placed_ego and front - length < 2.5 + 5.0:
                placed_ego, front = True, float(_EGO_SIZE_M[0]) / 2
                bodies, length, desired = (
                    [("ego", _EGO_SIZE_M, 0.0)],
                    float(_EGO_SIZE_M[0]),
                    float(ego_speed_m_s or 0.0),
                )
            queue.progress_m.append(front - length / 2)
            queue.desired_m_s.append(desired)
            queue.length_m.append(length)
            queue.lane.append(index)
            queue.bodies.append(bodies)
            front -= length

    def _draw_bodies(self, lane: Lane) -> tuple[list[tuple[str, Float[np.ndarray, " 3"], float]], float]:
        """One vehicle, or a car with its trailer: (kind, size, how far its middle lies behind the whole's middle)."""
        kind = lane.kind or choose_kind(lane.truck_share, self.long_haul, self.sizes, self.rng)
        size = self.draw_size_m(kind)
        length = float(size[0])
        if kind in ("suv", "pickup", "van") and self.rng.random() < lane.trailer_share:
            towed = self.draw_size_m("trailer")
            total_m = length + _HITCH_M + float(towed[0])
            return [(kind, size, (length - total_m) / 2), ("trailer", towed, (total_m - float(towed[0])) / 2)], total_m
        return [(kind, size, 0.0)], length

    def finish(self, seed: np.random.SeedSequence, world: str = "v2") -> tuple[list[Actor], Motion]:
        """Take away loose actors that would touch others; give each of the rest its own seed, and the world's body."""
        size = np.stack(self._size)
        position, yaw = np.stack(self._position), np.unwrap(np.stack(self._yaw), axis=1)
        removed = self._removed(position, yaw, size)
        seeds = seed.spawn(len(size))
        remaining = np.flatnonzero(~removed)
        actors = [
            Actor(int(i), self._kind[i], (float(size[i, 0]), float(size[i, 1]), float(size[i, 2])), seeds[i], world)
            for i in remaining
        ]
        return actors, Motion(position[remaining], yaw[remaining], np.stack(self._slope)[remaining])

    def _removed(
        self,
        position_m: Float[np.ndarray, "n steps 3"],
        yaw_rad: Float[np.ndarray, "n steps"],
        size_m: Float[np.ndarray, "n 3"],
    ) -> Bool[np.ndarray, " n"]:
        """Loose road users that would touch another that stays, or an obstacle."""
        loose, count = np.array(self._loose), len(size_m)
        obstacles = self._obstacles_near(position_m[loose], size_m[loose])
        if obstacles:
            fixed = np.stack([obstacle.position_m for obstacle in obstacles])[:, None].repeat(self.steps, axis=1)
            turned = np.array([[obstacle.yaw_rad] for obstacle in obstacles]).repeat(self.steps, axis=1)
            position_m, yaw_rad = np.concatenate([position_m, fixed]), np.concatenate([yaw_rad, turned])
            size_m = np.concatenate([size_m, [obstacle.size_m for obstacle in obstacles]])
            loose = np.append(loose, np.zeros(len(fixed), dtype=bool))
        return in_conflict(position_m, yaw_rad, size_m, loose, margin_m=_MARGIN_M)[:count]

    def _obstacles_near(
        self, position_m: Float[np.ndarray, "n steps 3"], size_m: Float[np.ndarray, "n 3"]
    ) -> list[Obstacle]:
        """Those obstacles whose circles meet the circle about a road user and its whole way."""
        if not self.obstacles or not len(size_m):
            return []
        low, high = position_m[..., :2].min(axis=1), position_m[..., :2].max(axis=1)
        middle, reach = (low + high) / 2, np.hypot(*(high - low).T) / 2 + np.hypot(*size_m[:, :2].T) / 2 + 2 * _MARGIN_M
        fixed = np.stack([obstacle.position_m[:2] for obstacle in self.obstacles])
        radius = np.array([np.hypot(*obstacle.size_m[:2]) / 2 for obstacle in self.obstacles])
        apart = np.hypot(*(fixed[:, None] - middle).transpose(2, 0, 1))
        near = (apart < radius[:, None] + reach).any(axis=1)
        return [obstacle for obstacle, is_near in zip(self.obstacles, near, strict=True) if is_near]


def _beside(lanes: Sequence[Lane]) -> Int[np.ndarray, "2 lanes"]:
    """The lanes to the left and to the right of each, of the same direction and next to it."""
    out = np.full((2, len(lanes)), -1)
    for i, lane in enumerate(lanes):
        for j, other in enumerate(lanes):
            aside = (other.offset_m - lane.offset_m) * lane.direction
            if other.direction == lane.direction and not (lane.kind or other.kind) and 2.0 < abs(aside) < 4.5:
                out[0 if aside > 0 else 1, i] = j
    return out
