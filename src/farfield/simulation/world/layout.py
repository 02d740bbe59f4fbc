"""What a road's builder makes: the road, its ground and fixed surroundings piece by piece, and its population.

Builders use what all roads share: :class:`RoadBuild` for streams of randomness, stretches of road and traffic, and
:class:`Roadside` for what stands and runs beside the road.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies import furniture
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box
from farfield.simulation.world.land import Land
from farfield.simulation.world.motion import STEP_S
from farfield.simulation.world.population import Lane, Population
from farfield.simulation.world.road import Bends, RoadLine, ribbon

CHUNK_M = 100.0


@dataclass(frozen=True)
class FixedObject:
    """One fixed object: where along the road it belongs, and what builds it."""

    s_m: float
    build: Callable[[], Mesh]


@dataclass(eq=False)
class RoadLayout:
    """A road and what stands beside it, built in pieces of ``CHUNK_M``.

    Args:
        land: The ground, and with it the reference line.
        population: Its road users.
        seed: Draws paint of the fixed objects.
        running: Build what runs along the road (markings, rails, walls) over given stations.
        placements: The fixed objects.
        breaks_m: Stations at which the ground changes and needs a row of its own.
    """

    land: Land
    population: Population
    seed: np.random.SeedSequence
    running: list[Callable[[Float[np.ndarray, " k"]], Mesh]] = field(default_factory=list)
    placements: list[FixedObject] = field(default_factory=list)
    breaks_m: tuple[float, ...] = ()

    def chunk(self, index: int) -> Mesh:
        """The fixed surroundings between ``index`` and ``index + 1`` times ``CHUNK_M``; always the same ones."""
        key = index if index >= 0 else 100_000 - index
        rng = np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=(*self.seed.spawn_key, key)))
        first, last = index * CHUNK_M, (index + 1) * CHUNK_M
        inner = [s for s in self.breaks_m if first < s < last]
        rows = np.unique(np.concatenate([np.linspace(first, last, 26), inner]))
        parts = [self.land.strips(rows), self.land.beyond(first, last), *(build(rows) for build in self.running)]
        parts += [fixed.build() for fixed in self.placements if first <= fixed.s_m < last]
        return Mesh.merge([part.painted(rng) for part in parts if len(part.faces)])


# What stands and runs beside a road: barriers, lines, lamps, signs, trees, hedges, houses

_PAINT, _METAL = int(Material.LANE_PAINT), int(Material.METAL)
_RAISED = np.full(2, 0.01)


def jersey_barrier(road: RoadLine, d_m: float, height_m: float, s_m: Float[np.ndarray, " k"]) -> Mesh:
    """A concrete safety barrier."""
    d = np.array([-0.3, -0.25, -0.1, -0.07, 0.07, 0.1, 0.25, 0.3]) + d_m
    z = np.array([0.0, 0.08, 0.33, height_m, height_m, 0.33, 0.08, 0.0])
    return ribbon(road, s_m, d, z, int(Material.CONCRETE))


def guard_rail(road: RoadLine, d_m: float, s_m: Float[np.ndarray, " k"]) -> Mesh:
    """A W-beam of 0.31 m on posts every 4 m."""
    d = np.array([0.0, 0.05, 0.0, 0.05, 0.0]) + d_m
    parts = [ribbon(road, s_m, d, np.array([0.45, 0.53, 0.60, 0.68, 0.76]), _METAL)]
    post = box([0.1, 0.1, 1.05], [0, 0, 0.225], _METAL)
    for s in np.arange(s_m[0], s_m[-1] - 0.01, 4.0):
        x, y, z = road.point_m(np.array(s), d_m + 0.06)
        parts.append(post.placed(float(x), float(y), float(z), yaw_rad=float(road.heading_rad(np.array(s)))))
    return Mesh.merge(parts)


def solid_line(road: RoadLine, d_m: float, s_m: Float[np.ndarray, " k"]) -> Mesh:
    """A painted line of 0.15 m, a centimetre above the asphalt."""
    return ribbon(road, s_m, d_m + np.array([-0.075, 0.075]), _RAISED, _PAINT)


def dashed_line(road: RoadLine, d_m: float, dash_m: float, pitch_m: float, s_m: Float[np.ndarray, " k"]) -> Mesh:
    """A broken line."""
    first = np.ceil(s_m[0] / pitch_m) * pitch_m
    dashes = np.arange(first, s_m[-1] - dash_m, pitch_m)
    line = d_m + np.array([-0.07, 0.07])
    return Mesh.merge([ribbon(road, s + np.array([0.0, dash_m]), line, _RAISED, _PAINT) for s in dashes])


class Roadside:
    """Adds fixed objects to a layout.

    Args:
        layout: Takes them.
        rng: Draws places and shapes.
        first_m: Where the surroundings begin, as s.
        last_m: Where they end.
    """

    def __init__(self, layout: RoadLayout, rng: np.random.Generator, first_m: float, last_m: float) -> None:
        self.layout, self.rng, self.first_m, self.last_m = layout, rng, first_m, last_m
        self.trees = [furniture.tree(rng.uniform(4, 12), rng) for _ in range(6)]
        self.conifers = [furniture.tree(rng.uniform(5, 15), rng, conifer=True) for _ in range(4)]
        self.bushes = [furniture.bush(rng) for _ in range(4)]

    def put(self, model: Mesh, s_m: float, d_m: float, *, turn_rad: float = 0.0, raise_m: float = 0.0) -> None:
        """Stand one object on the ground."""
        self.add(partial(self.layout.land.stand, model, s_m, d_m, turn_rad=turn_rad, raise_m=raise_m), s_m)

    def add(self, build: "partial[Mesh]", s_m: float) -> None:
        """Add an object that knows its place in the world."""
        self.layout.placements.append(FixedObject(s_m, build))

    def stations(self, pitch_m: float, *, jitter_m: float = 0.0) -> Float[np.ndarray, " n"]:
        """Stations at regular distances over the whole stretch, from a random beginning."""
        s = np.arange(self.first_m + self.rng.uniform(0, pitch_m), self.last_m, pitch_m)
        return s + self.rng.uniform(-0.5, 0.5, len(s)) * jitter_m

    def plants(
        self, side: int, near_m: float, far_m: float, per_m: float, *, conifers: float = 0.2, bushes: float = 0.3
    ) -> None:
        """Scatter trees and shrubs between two distances from the reference line."""
        rng, count = self.rng, int(self.rng.poisson(per_m * (self.last_m - self.first_m)))
        for s, d, draw, pick, turn in zip(*rng.uniform(size=(5, count)), strict=True):
            models = self.conifers if draw < conifers else self.bushes if draw < conifers + bushes else self.trees
            station_m = self.first_m + s * (self.last_m - self.first_m)
            self.put(
                models[int(pick * len(models))], station_m, side * (near_m + d * (far_m - near_m)), turn_rad=6.28 * turn
            )

    def lamps(self, side: int, d_m: float, pitch_m: float, height_m: float, arm_m: float) -> None:
        """Lamp posts whose arms reach towards the road."""
        lamp = furniture.pole(height_m, arm_m)
        for s in self.stations(pitch_m):
            self.put(lamp, float(s), side * d_m, turn_rad=np.pi if side > 0 else 0.0)

    def signs(self, side: int, d_m: float, pitch_m: float) -> None:
        """Signs of many sizes that face the traffic of their side."""
        for s in self.stations(pitch_m, jitter_m=0.6 * pitch_m):
            model = furniture.sign(self.rng.uniform(1.8, 3.0), self.rng.uniform(0.5, 1.6), self.rng.uniform(0.5, 1.2))
            self.put(model, float(s), side * (d_m + self.rng.uniform(0.0, 1.0)), turn_rad=0.0 if side < 0 else np.pi)

    def run(self, piece: "partial[Mesh]") -> None:
        """Add something that runs along the whole road; ``piece`` builds it over given stations."""
        self.layout.running.append(piece)

    def wall(
        self, s_m: float, length_m: float, d_m: float, height_m: float, material: int, thick_m: float = 0.3
    ) -> None:
        """A piece of wall or hedge along the road."""
        rows = np.linspace(s_m, s_m + length_m, max(2, int(length_m / 4) + 1))
        d = np.array([-0.5, -0.5, 0.5, 0.5]) * thick_m + d_m
        self.add(partial(_wall, self.layout.land, rows, d, height_m, material), s_m)

    def block(self, s_m: float, side: int, d_m: float, length_m: float, depth_m: float, height_m: float) -> None:
        """A building whose front stands at a distance from the reference line."""
        model = furniture.building(length_m, depth_m, height_m, self.rng)
        self.put(model, s_m, side * d_m, turn_rad=0.0 if side > 0 else np.pi)


def _wall(
    land: Land, rows: Float[np.ndarray, " k"], d: Float[np.ndarray, " n"], height_m: float, material: int
) -> Mesh:
    base = land.rise_m(*np.broadcast_arrays(rows[:, None], d))
    return ribbon(land.road, rows, d, base + np.array([-0.5, height_m, height_m, -0.5]), material)


# What all builders share: materials, streams of randomness, stretches of road and traffic

ASPHALT, CONCRETE, GRASS, SOIL, PAINT, BRICK, FOLIAGE = (
    int(m)
    for m in (
        Material.ASPHALT,
        Material.CONCRETE,
        Material.GRASS,
        Material.SOIL,
        Material.LANE_PAINT,
        Material.BRICK,
        Material.FOLIAGE,
    )
)
FIRST_M = -420.0  # surroundings begin so far behind the ego vehicle's start
_BEHIND_M, _AHEAD_M = 300.0, 450.0


@dataclass(eq=False)
class RoadBuild:
    """One sequence being built: its four streams, its duration and its prior of sizes.

    Args:
        seed: Spawns the streams of road, traffic, surroundings and paint.
        duration_s: For how long the traffic must last.
        sizes: Name of the size prior.
    """

    seed: np.random.SeedSequence
    duration_s: float
    sizes: str
    rng: np.random.Generator = field(init=False)
    around: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        road, traffic, around, self._paint_seed = self.seed.spawn(4)
        self.rng, self.around, self._traffic = (np.random.default_rng(stream) for stream in (road, around, traffic))

    def line(self, bends: Bends, ego_m_s: float) -> RoadLine:
        """A road long enough for everything that moves on it."""
        ahead = (2.0 * ego_m_s + 45.0) * self.duration_s + 1500.0
        return RoadLine.draw(self.rng, behind_m=45.0 * self.duration_s + 900.0, ahead_m=ahead, bends=bends)

    def population(self, road: RoadLine, *, long_haul: bool = False) -> Population:
        """Nobody yet."""
        steps = round(self.duration_s / STEP_S) + 2
        return Population(road, steps=steps, rng=self._traffic, sizes=self.sizes, long_haul=long_haul)

    def travel_m(self, ego_m_s: float) -> float:
        """How far the ego vehicle may come."""
        return 1.1 * ego_m_s * self.duration_s

    def layout(
        self, land: Land, population: Population, ego_m_s: float, breaks_m: tuple[float, ...] = ()
    ) -> tuple[RoadLayout, Roadside]:
        """An empty layout, and what fills it from ``FIRST_M`` to 420 m beyond the ego vehicle's end."""
        layout = RoadLayout(land, population, self._paint_seed, breaks_m=breaks_m)
        return layout, Roadside(layout, self.around, FIRST_M, self.travel_m(ego_m_s) + 420.0)

    def lane(
        self,
        offset_m: float,
        direction: int,
        gap_m: float,
        speed_m_s: float,
        width_m: float,
        ego_m_s: float,
        *,
        trucks: float = 0.0,
        trailers: float = 0.0,
        kind: str = "",
    ) -> Lane:
        """A lane filled so far that the ego vehicle's surroundings stay full for the whole duration."""
        if direction > 0:
            first = _BEHIND_M + max(0.0, 1.2 * speed_m_s - 0.6 * ego_m_s) * self.duration_s
            last = _AHEAD_M + max(0.0, 1.1 * ego_m_s - 0.6 * speed_m_s) * self.duration_s
        else:
            first, last = _BEHIND_M, _AHEAD_M + (1.1 * ego_m_s + 1.15 * speed_m_s) * self.duration_s
        return Lane(offset_m, direction, -first, last, gap_m, speed_m_s, width_m, trucks, trailers, kind)
