"""A scene at work: what stands where over a short span of continuous time, ready for rays."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError
from farfield.geometry.poses import pose
from farfield.simulation.bodies.actors import Actor, find_prior
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.bodies.people import PHASES
from farfield.simulation.trace import Body, Caster, Tracer
from farfield.simulation.world.ground import CHUNK_M
from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.motion import STEP_S
from farfield.simulation.world.roads import BUILDERS, RoadBuild
from farfield.vocabulary.conditions import SIDES, WORLDS

_STAGE_M = 200.0  # the fixed surroundings are rebuilt each time the ego vehicle has driven so far
_KEPT_TRACERS = 2000  # about 60 MB
_LEAF_PAINT = 0x7EAF  # the stream of plants' reflectances and tints
_MOVES_M = 0.2  # who moves less in the whole sequence stands
ROADS = tuple(BUILDERS)


@dataclass(frozen=True, eq=False)
class SceneWindow:
    """The scene over a short span around one moment.

    Poses are given at ``k`` knots; between them they move linearly (:func:`at_knots`). Row ``i`` of ``actors``,
    ``bottom_m``, ``yaw_rad`` and ``velocity_m_s`` is the road user that bodies with ``actor == i`` belong to.

    Args:
        time_s: The reference moment.
        knots_s: Offsets from it, rising, symmetric, shape (k,); a single knot is 0.
        world_T_ego: Pose of the ego vehicle at each knot: middle of its bottom, x forward, shape (k, 4, 4).
        bodies: Fixed surroundings first, then the road users within view; the ego vehicle is left out.
        actors: Those road users.
        bottom_m: Middles of their bottoms in the world at the reference moment, shape (n, 3).
        yaw_rad: Their headings in the world then, shape (n,).
        velocity_m_s: Their velocities in the world then, shape (n, 3).
        ego_velocity_m_s: The ego vehicle's, shape (3,).
    """

    time_s: float
    knots_s: Float[np.ndarray, " k"]
    world_T_ego: Float[np.ndarray, "k 4 4"]
    bodies: list[Body]
    actors: list[Actor]
    bottom_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    velocity_m_s: Float[np.ndarray, "n 3"]
    ego_velocity_m_s: Float[np.ndarray, " 3"]

    @property
    def world_T_ego_now(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the ego vehicle at the reference moment."""
        return at_knots(self.world_T_ego, self.knots_s, np.zeros(1))[0]


def at_knots(
    poses: Float[np.ndarray, "k 4 4"], knots_s: Float[np.ndarray, " k"], time_s: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 4 4"]:
    """Poses at any times within the span, linear between knots (an angle of 0.01 rad between knots errs by 1e-5)."""
    if len(knots_s) == 1:
        return np.broadcast_to(poses[0], (len(time_s), 4, 4))
    before = np.clip(np.searchsorted(knots_s, time_s, side="right") - 1, 0, len(knots_s) - 2)
    share = ((time_s - knots_s[before]) / (knots_s[before + 1] - knots_s[before]))[:, None, None]
    return poses[before] + share * (poses[before + 1] - poses[before])


class WorldScene:
    """One sequence's world.

    Args:
        road: One of ``ROADS``.
        seed: Draws everything; the same seed gives the same world whatever sensors look at it.
        duration_s: How long it lasts.
        sizes: Named prior of the road users' sizes: "us", "korea" or "kitti".
        traffic: On which side it keeps: "right", or "left", which is the mirror image of the road and its traffic.
        world: What stands beside and on the road: "v2" or "v3", as :class:`farfield.simulation.presets.Preset` has it.

    Raises:
        ConfigError: If there is no such road, prior, side or world.
    """

    def __init__(
        self,
        road: str,
        seed: np.random.SeedSequence,
        *,
        duration_s: float,
        sizes: str = "us",
        traffic: str = "right",
        world: str = "v2",
    ) -> None:
        if road not in BUILDERS:
            raise ConfigError(f"road: expected one of {', '.join(ROADS)}; got {road!r}")
        if traffic not in SIDES:
            raise ConfigError(f"traffic: expected one of {', '.join(SIDES)}; got {traffic!r}")
        if world not in WORLDS:
            raise ConfigError(f"world: expected one of {', '.join(WORLDS)}; got {world!r}")
        find_prior(sizes)
        layout_seed, actor_seed, pose_seed = seed.spawn(3)
        self.road, self.duration_s, self.sizes, self.world = road, duration_s, sizes, world
        self.layout: RoadLayout = BUILDERS[road](RoadBuild(layout_seed, duration_s, sizes, world))
        self.traffic = traffic
        self.actors, self.motion = self.layout.population.finish(actor_seed, world)
        self.motion = self.motion.mirrored() if traffic == "left" else self.motion
        self._sway = np.random.default_rng(pose_seed).uniform(0, 2 * np.pi, 2)
        self._rows = {actor.track_id: row for row, actor in enumerate(self.actors)}
        self._tracers: dict[tuple[int, int], Tracer] = {}
        self._chunks: dict[int, Mesh] = {}
        self._stage: tuple[tuple[int, float], list[Caster]] | None = None

    def ego_pose(self, time_s: float) -> Float[np.ndarray, "4 4"]:
        """Pose of the ego vehicle: middle of its bottom on the road, its heading, the road's slopes, some nodding."""
        still = self.motion.poses(time_s, rows=slice(0, 1))[0]
        nod = np.radians(0.05) * np.sin(2 * np.pi * np.array([1.1, 0.7]) * time_s + self._sway)
        (sin, lean_sin), (cos, lean_cos) = np.sin(nod), np.cos(nod)
        tilt = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
        lean = np.array([[1, 0, 0], [0, lean_cos, -lean_sin], [0, lean_sin, lean_cos]])
        return still @ pose(tilt @ lean, np.zeros(3))

    def _ego_s_m(self, time_s: float) -> float:
        track = self.layout.population.ego_s_m
        return float(np.interp(time_s / STEP_S, np.arange(len(track)), track))

    def _fixed(self, time_s: float, reach_m: float, behind_m: float, knots: int) -> list[Body]:
        """The fixed surroundings: triangles, and in the world "v3" the leaves of plants."""
        stage = int(np.floor(self._ego_s_m(time_s) / _STAGE_M))
        if self._stage is None or self._stage[0] != (stage, behind_m):
            first = int(np.floor((stage * _STAGE_M - behind_m) / CHUNK_M))
            last = int(np.ceil(((stage + 1) * _STAGE_M + reach_m) / CHUNK_M))
            built = self._chunks  # those of the stage before; what recurs is not built again
            self._chunks = {i: built[i] if i in built else self.layout.chunk(i) for i in range(first, last)}
            mesh = Mesh.merge(list(self._chunks.values()))
            anchor = self.layout.land.road.point_m(np.array((stage + 0.5) * _STAGE_M), 0.0)
            if self.traffic == "left":
                mesh, anchor = mesh.mirrored(), anchor * [1.0, -1.0, 1.0]
            leaves = self._leaves(self.layout.plants_between(first * CHUNK_M, last * CHUNK_M), anchor)
            self._stage = ((stage, behind_m), [Tracer(mesh, anchor_m=anchor), *leaves])
        return [Body(fixed, np.broadcast_to(np.eye(4), (knots, 4, 4))) for fixed in self._stage[1]]

    def _leaves(self, rows: list[int], anchor_m: Float[np.ndarray, " 3"]) -> list[Caster]:
        """The leaves of some plants; nothing where there are none."""
        if not rows:
            return []
        from farfield.simulation.foliage import Foliage, PlacedLeaves, leaf_reflectances

        flip = np.array([1.0, -1.0, 1.0] if self.traffic == "left" else [1.0, 1.0, 1.0])
        seed, plants = self.layout.seed, self.layout.plants
        rng = np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, _LEAF_PAINT)))
        reflectance, tint = leaf_reflectances(len(plants), rng), rng.random(len(plants))
        placed = [
            PlacedLeaves(plants[row].leaves, row, axes_m * flip, reflectance[row], tint[row])
            for row, axes_m in zip(rows, self.layout.axes_m(rows), strict=True)
        ]
        return [Foliage(placed, seed=int(seed.generate_state(1, np.uint64)[0]), anchor_m=anchor_m)]

    def window(
        self, time_s: float, *, half_span_s: float = 0.0, reach_m: float = 360.0, behind_m: float = 20.0
    ) -> SceneWindow:
        """The scene from ``half_span_s`` before a moment to as long after it.

        Args:
            time_s: The reference moment, 0 <= time_s <= duration_s.
            half_span_s: Half of the span, such as 0.06 for a sweep of 0.1 s and what follows it; 0 stands still.
            reach_m: How far ahead to look.
            behind_m: How far behind; a sensor that looks all around needs its own range here.
        """
        knots_s = np.linspace(-half_span_s, half_span_s, 9) if half_span_s else np.zeros(1)
        moments = np.clip(time_s + knots_s, 0.0, self.duration_s + STEP_S)
        world_T_ego = np.stack([self.ego_pose(float(moment)) for moment in moments])
        position, yaw = self.motion.at(time_s)
        world_T_ego_now = self.ego_pose(time_s)
        offset = position - world_T_ego_now[:3, 3]
        ahead = offset @ world_T_ego_now[:3, 0]
        half_length_m = np.array([actor.size_m[0] for actor in self.actors]) / 2
        near = (np.hypot(offset[:, 0], offset[:, 1]) < reach_m) & (ahead > -half_length_m - behind_m)
        near[0] = False
        index_in_view = np.flatnonzero(near)
        paths = np.stack([self.motion.poses(float(moment), rows=index_in_view) for moment in moments])
        bodies = self._fixed(time_s, reach_m, behind_m, len(knots_s))
        for row, index in enumerate(index_in_view):
            bodies.append(Body(self._tracer(int(index), time_s), paths[:, row], row))
        actors = [self.actors[index] for index in index_in_view]
        velocity = self.motion.velocity_m_s(time_s)
        return SceneWindow(
            time_s,
            knots_s,
            world_T_ego,
            bodies,
            actors,
            position[index_in_view],
            yaw[index_in_view],
            velocity[index_in_view],
            velocity[0],
        )

    def gait_phase(self, row: int, time_s: float) -> float | None:
        """Phase of a walker's gait in [0, 1): it follows the distance walked.

        Args:
            row: Index into the scene's own ``actors``; not into a window's.
            time_s: The moment.

        Returns:
            The phase, or None for rigid bodies and for those that stand through the whole sequence.
        """
        actor = self.actors[row]
        if not actor.cycle_m or self.motion.travelled_m(row, self.duration_s) < _MOVES_M:
            return None
        first = (actor.track_id * 0.618034) % 1.0
        return (first + self.motion.travelled_m(row, time_s) / actor.cycle_m) % 1.0

    def row_of(self, track_id: int) -> int:
        """Index into ``actors`` of the road user with a track id, such as one of a window's."""
        return self._rows[track_id]

    def _tracer(self, index: int, time_s: float) -> Tracer:
        phase = self.gait_phase(index, time_s)
        key = (index, -1 if phase is None else int(phase * PHASES))
        if key not in self._tracers:
            shape = None if phase is None else (key[1] + 0.5) / PHASES
            mesh = self.actors[index].build(shape)
            self._tracers[key] = Tracer(mesh.mirrored() if self.world == "v3" and self.traffic == "left" else mesh)
        self._tracers[key] = self._tracers.pop(key)  # the latest stands last
        while len(self._tracers) > _KEPT_TRACERS:
            del self._tracers[next(iter(self._tracers))]
        return self._tracers[key]
