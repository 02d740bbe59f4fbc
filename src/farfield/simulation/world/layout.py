"""What a road's builder makes: the road, its ground and fixed surroundings piece by piece, and its population.

Builders use what all roads share: :class:`RoadBuild` for streams of randomness, stretches of road and traffic, and
:class:`Roadside` for what stands and runs beside the road.
"""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies import facades, furniture, plants
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box
from farfield.simulation.bodies.plants import Leaves, Plant
from farfield.simulation.world.ground import CHUNK_M, GroundSurface, chunk_rows
from farfield.simulation.world.land import HeightNoise, Land
from farfield.simulation.world.motion import STEP_S
from farfield.simulation.world.population import Lane, Obstacle, Population
from farfield.simulation.world.road import Bends, RoadLine, ribbon
from farfield.simulation.world.taken_ground import TakenGround, halves_across, low_bounds_m, rectangle_of

_DEEPEST_M = 0.3  # on a slope a thing's foot sinks so far below the ground at its middle at most
_LARGE_M = 4.0  # what is larger stands on the ground at its middle
_WIDE_M = 20.0  # further from the line a place may lie nearer to another stretch of the road
_PIECE_M = 5.0  # walls in bends are kept clear of in straight pieces of about this length


@dataclass(frozen=True)
class FixedObject:
    """One fixed object.

    Args:
        s_m: Where along the road it belongs.
        build: Builds it on the ground as it was drawn.
        d_m: Its foot's offset to the left; None for what knows its own height.
        reach_m: How far from the foot's middle the ground counts as well.
    """

    s_m: float
    build: Callable[[], Mesh]
    d_m: float | None = None
    reach_m: float = 0.0


@dataclass(frozen=True)
class LeafyPlace:
    """Leaves that rays enter: where along and beside the road they stand, how they are turned, how wide they stand."""

    leaves: Leaves
    s_m: float
    d_m: float
    turn_rad: float = 0.0
    reach_m: float = 0.0


@dataclass(eq=False)
class RoadLayout:
    """A road and what stands beside it, built in pieces of ``CHUNK_M``.

    Args:
        land: The ground, and with it the reference line.
        population: Its road users.
        seed: Draws paint of the fixed objects.
        running: Build what runs along the road (markings, rails, walls) over given stations.
        placements: The fixed objects.
        plants: What rays enter; none in the world "v2".
        ground: Where the ground's triangles lie, on which things stand; None in the world "v2", where they stand on the
            ground as it was drawn.
        breaks_m: Stations at which the ground changes and needs a row of its own.
    """

    land: Land
    population: Population
    seed: np.random.SeedSequence
    running: list[Callable[[Float[np.ndarray, " k"]], Mesh]] = field(default_factory=list)
    placements: list[FixedObject] = field(default_factory=list)
    plants: list[LeafyPlace] = field(default_factory=list)
    ground: GroundSurface | None = None
    breaks_m: tuple[float, ...] = ()

    def plants_between(self, first_m: float, last_m: float) -> list[int]:
        """Rows of the plants that belong to a stretch."""
        return [row for row, plant in enumerate(self.plants) if first_m <= plant.s_m < last_m]

    def axes_m(self, rows: Sequence[int]) -> Float[np.ndarray, "n 3 3"]:
        """Where some plants stand in the world: of each its origin, and the ends of its x and y axes of 1 m."""
        frame = Mesh.of(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), int(Material.FOLIAGE))
        some = [self.plants[row] for row in rows]
        axes = [self.land.stand(frame, plant.s_m, plant.d_m, turn_rad=plant.turn_rad).vertices_m for plant in some]
        return np.stack(axes) + self.lifts_m(some)[:, None, None] * np.array([0.0, 0.0, 1.0])

    def lifts_m(self, things: Sequence[FixedObject | LeafyPlace]) -> Float[np.ndarray, " n"]:
        """How much higher the ground's triangles lie under things than the ground as it was drawn.

        On a slope the lowest ground under a thing counts, so that it does not stick out on the lower side, but at most
        ``_DEEPEST_M`` below the middle.
        """
        out = np.zeros(len(things))
        rows = [row for row, thing in enumerate(things) if thing.d_m is not None]
        if self.ground is None or not rows:
            return out
        s, d, reach = np.array([[things[row].s_m, things[row].d_m, things[row].reach_m] for row in rows]).T
        around = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        at_s, at_d = (middle[:, None] + reach[:, None] * aside for middle, aside in zip((s, d), around.T, strict=True))
        road = self.land.road
        z = self.ground.height_m(road.point_m(at_s, at_d)[..., :2].reshape(-1, 2)).reshape(at_s.shape)
        lowest = np.fmin.reduce(z, axis=1)
        foot_m = np.maximum(lowest, z[:, 0] - _DEEPEST_M)
        drawn_m = road.point_m(s, d)[:, 2] + self.land.rise_m(s, d)
        out[rows] = np.where(np.isfinite(foot_m), foot_m - drawn_m, 0.0)
        return out

    def chunk(self, index: int) -> Mesh:
        """The fixed surroundings between ``index`` and ``index + 1`` times ``CHUNK_M``; always the same ones."""
        key = index if index >= 0 else 100_000 - index
        rng = np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=(*self.seed.spawn_key, key)))
        first, last = index * CHUNK_M, (index + 1) * CHUNK_M
        rows = chunk_rows(index, self.breaks_m)
        ground = (
            [self.land.strips(rows), self.land.beyond(first, last)]
            if self.ground is None
            else self.ground.pieces(index)
        )
        parts = [*ground, *(build(rows) for build in self.running)]
        objects = [fixed for fixed in self.placements if first <= fixed.s_m < last]
        for fixed, lift_m in zip(objects, self.lifts_m(objects), strict=True):
            mesh = fixed.build()
            parts.append(replace(mesh, vertices_m=mesh.vertices_m + np.array([0.0, 0.0, lift_m])) if lift_m else mesh)
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
        relief: Draws the relief of fronts, walls and verges; None leaves them flat, as in world "v2".
        leaf_rng: Draws plants that rays enter; None for plants of opaque facets.

    Attributes:
        ground: What stands on which ground; kept where there is relief.
    """

    def __init__(
        self,
        layout: RoadLayout,
        rng: np.random.Generator,
        first_m: float,
        last_m: float,
        relief: np.random.Generator | None = None,
        leaf_rng: np.random.Generator | None = None,
    ) -> None:
        self.layout, self.rng, self.first_m, self.last_m, self.leaf_rng = layout, rng, first_m, last_m, leaf_rng
        self.relief, self.ground = relief, TakenGround()
        trees = [furniture.tree(rng.uniform(4, 12), rng) for _ in range(6)]
        conifers = [furniture.tree(rng.uniform(5, 15), rng, conifer=True) for _ in range(4)]
        bushes = [furniture.bush(rng) for _ in range(4)]
        self.trees: Sequence[Mesh | Plant] = trees
        self.conifers: Sequence[Mesh | Plant] = conifers
        self.bushes: Sequence[Mesh | Plant] = bushes
        if leaf_rng is not None:
            self.trees = [plants.tree(model, leaf_rng) for model in trees]
            self.conifers = [plants.tree(model, leaf_rng, conifer=True) for model in conifers]
            self.bushes = [plants.bush(model, leaf_rng) for model in bushes]

    def put(
        self,
        model: Mesh | Plant,
        s_m: float,
        d_m: float,
        *,
        turn_rad: float = 0.0,
        raise_m: float = 0.0,
        only_free: bool = True,
        over_road: bool = False,
    ) -> None:
        """Stand one object on the ground; of a plant its wood, with its leaves around.

        With relief it takes the ground under it, and road users keep clear of it.

        Args:
            model: The object.
            s_m: Its station.
            d_m: Its offset to the left.
            turn_rad: How far it is turned against the road.
            raise_m: Height of its foot above the ground.
            only_free: With relief, leave it out where something stands already.
            over_road: Whether it stands with its ends on both sides of the road.
        """
        reach_m = 0.0
        if self.relief is not None:
            feet = halves_across(_foot(model)) if over_road else [_foot(model)]
            rectangles = [rectangle_of(foot, s_m, d_m, turn_rad) for foot in feet]
            if only_free and not all(self.ground.free(*rectangle) for rectangle in rectangles):
                return
            if abs(d_m) > _WIDE_M and self._is_astray(s_m, d_m):
                return
            for foot, rectangle in zip(feet, rectangles, strict=True):
                self.ground.take(*rectangle)
                self._keep_clear(foot, s_m, d_m, turn_rad)
            wide_m = float(np.ptp(low_bounds_m(feet[0]), axis=0).max())
            reach_m = 0.0 if over_road or wide_m > _LARGE_M else wide_m / 4
        if isinstance(model, Plant):
            self.layout.plants.append(LeafyPlace(model.leaves, s_m, d_m, turn_rad, reach_m))
            if not len(model.wood.faces):
                return
            model = model.wood
        build = partial(self.layout.land.stand, model, s_m, d_m, turn_rad=turn_rad, raise_m=raise_m)
        self.layout.placements.append(FixedObject(s_m, build, d_m, reach_m))

    def _is_astray(self, s_m: float, d_m: float) -> bool:
        """Whether a place lies nearer to another stretch of the road than to its own, as within a bend."""
        land = self.layout.land
        _, nearest_m = land.locate(land.road.point_m(np.array([s_m]), d_m)[:, :2])
        return bool(abs(nearest_m[0]) < abs(d_m) - 2.0)

    def _keep_clear(self, model: Mesh, s_m: float, d_m: float, turn_rad: float) -> None:
        """Let road users keep clear of a model's own rectangle."""
        low, high = low_bounds_m(model)
        road, s = self.layout.land.road, np.array(s_m)
        yaw = float(road.heading_rad(s)) + turn_rad
        middle, cos, sin = (low + high) / 2, np.cos(yaw), np.sin(yaw)
        aside = np.array([cos * middle[0] - sin * middle[1], sin * middle[0] + cos * middle[1], 0.0])
        obstacle = Obstacle(road.point_m(s, d_m) + aside, yaw, np.append(high - low, 1.0))
        self.layout.population.obstacles.append(obstacle)

    def _take_along(self, first_m: float, last_m: float, d_m: float, thick_m: float) -> None:
        """Take the ground under something long beside the road, of which road users keep clear."""
        self.ground.take(first_m, last_m, d_m - thick_m / 2, d_m + thick_m / 2)
        ends, road = np.linspace(first_m, last_m, int((last_m - first_m) / _PIECE_M) + 2), self.layout.land.road
        for s, length_m in zip((ends[1:] + ends[:-1]) / 2, np.diff(ends), strict=True):
            size_m, middle = np.array([length_m, thick_m, 1.0]), np.asarray(s)
            obstacle = Obstacle(road.point_m(middle, d_m), float(road.heading_rad(middle)), size_m)
            self.layout.population.obstacles.append(obstacle)

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
            height_m, width_m = self.rng.uniform(1.8, 3.0), self.rng.uniform(0.5, 1.6)
            model = furniture.sign(height_m, width_m, self.rng.uniform(0.5, 1.2))
            near_m = d_m if self.relief is None else d_m + max(width_m / 2 - 0.3, 0.0)  # no board over the kerb
            self.put(model, float(s), side * (near_m + self.rng.uniform(0.0, 1.0)), turn_rad=0.0 if side < 0 else np.pi)

    def run(self, piece: "partial[Mesh]") -> None:
        """Add something that runs along the whole road; ``piece`` builds it over given stations."""
        self.layout.running.append(piece)

    def wall(
        self, s_m: float, length_m: float, d_m: float, height_m: float, material: int, thick_m: float = 0.3
    ) -> None:
        """A piece of wall or hedge along the road."""
        rows = np.linspace(s_m, s_m + length_m, max(2, int(length_m / 4) + 1))
        if material == FOLIAGE and self.leaf_rng is not None:
            self.hedge(rows, d_m, height_m, thick_m)
            return
        if self.relief is not None:
            self._take_along(s_m, s_m + length_m, d_m, thick_m + 0.3)  # with its piers
            seed = int(self.relief.integers(2**32))
            self.add(partial(_rough_wall, self.layout.land, rows, d_m, thick_m, height_m, material, seed), s_m)
            return
        d = np.array([-0.5, -0.5, 0.5, 0.5]) * thick_m + d_m
        self.add(partial(_wall, self.layout.land, rows, d, height_m, material), s_m)

    def hedge(self, rows: Float[np.ndarray, " k"], d_m: float, height_m: float, thick_m: float) -> None:
        """A hedge that rays enter, in straight pieces between stations, where nothing stands; the pieces are alike."""
        assert self.leaf_rng is not None
        step_m = float(rows[1] - rows[0])
        leaves = plants.hedge(1.05 * step_m, thick_m, height_m, self.leaf_rng)
        for index, s in enumerate(rows[:-1]):
            piece = (float(s), float(s) + step_m, d_m - thick_m / 2, d_m + thick_m / 2)
            if self.ground.free(*piece):
                self.layout.plants.append(LeafyPlace(leaves, float(s) + step_m / 2, d_m, np.pi * (index % 2)))
                self._take_along(float(s), float(s) + step_m, d_m, thick_m)

    def block(
        self,
        s_m: float,
        side: int,
        d_m: float,
        length_m: float,
        depth_m: float,
        height_m: float,
        *,
        overhang_m: float = 1.2,
    ) -> None:
        """A building whose front stands at a distance from the reference line; balconies may hang over the ground."""
        if self.relief is None:
            model = furniture.building(length_m, depth_m, height_m, self.rng)
        else:
            model = facades.relief_building(length_m, depth_m, height_m, self.relief, overhang_m=overhang_m)
        self.put(model, s_m, side * d_m, turn_rad=0.0 if side > 0 else np.pi, only_free=False)

    def verge(self, side: int, near_m: float, far_m: float, rough_m: float) -> None:
        """Uneven ground between two distances from the reference line: grass over ruts and molehills."""
        if self.relief is not None:
            noise = HeightNoise(self.relief, shortest_m=1.2, longest_m=6.0)
            piece = partial(_verge, self.layout.land, noise, side, near_m, far_m, rough_m)
            self.run(piece)
            if self.layout.ground is not None:
                self.layout.ground.verges.append(piece)


def _foot(model: Mesh | Plant) -> Mesh:
    """What stands on the ground of an object: of a plant its wood, or its leaves where it has none."""
    if not isinstance(model, Plant):
        return model
    if len(model.wood.faces):
        return model.wood
    low_m, high_m = model.leaves.low_m, model.leaves.high_m
    return box((high_m - low_m).tolist(), ((low_m + high_m) / 2).tolist(), FOLIAGE)


def _wall(
    land: Land, rows: Float[np.ndarray, " k"], d: Float[np.ndarray, " n"], height_m: float, material: int
) -> Mesh:
    base = land.rise_m(*np.broadcast_arrays(rows[:, None], d))
    return ribbon(land.road, rows, d, base + np.array([-0.5, height_m, height_m, -0.5]), material)


def _rough_wall(
    land: Land,
    rows: Float[np.ndarray, " k"],
    d_m: float,
    thick_m: float,
    height_m: float,
    material: int,
    seed: int,
) -> Mesh:
    """A wall of rough stones, thicker at its foot, with piers every four rows; panels where it is high or long."""
    fine = height_m < 2.2 and rows[-1] - rows[0] < 40.0
    pitch, level = (0.5, 0.4) if fine else (2.0, 1.0)
    s = np.linspace(rows[0], rows[-1], max(2, round((rows[-1] - rows[0]) / pitch) + 1))
    levels = np.linspace(0.0, height_m, max(2, round(height_m / level) + 1))
    z = np.concatenate([[-0.5], levels, levels[::-1], [-0.5]])
    aside = np.where(np.arange(len(z)) < len(z) // 2, -0.5, 0.5)
    rng = np.random.default_rng(seed)
    rough = rng.normal(0.0, 0.02 if material == CONCRETE else 0.035, (len(s), len(z)))
    pier = np.where(np.arange(len(s)) % 4 == 0, 0.06, 0.0)[:, None] * np.sign(aside)
    d = d_m + aside * thick_m + rough + pier
    base = land.rise_m(*np.broadcast_arrays(s[:, None], d))
    top = np.where(np.isclose(z, height_m), rng.normal(0.0, 0.03, (len(s), 1)), 0.0)
    return ribbon(land.road, s, d, base + z + top, material)


def _verge(
    land: Land,
    noise: HeightNoise,
    side: int,
    near_m: float,
    far_m: float,
    rough_m: float,
    s_m: Float[np.ndarray, " k"],
) -> Mesh:
    s = np.linspace(s_m[0], s_m[-1], round((s_m[-1] - s_m[0]) / 0.8) + 1)
    d = np.sort(side * np.linspace(near_m, far_m, max(2, round((far_m - near_m) / 0.8) + 1)))
    along, across = np.broadcast_arrays(s[:, None], d)
    edge = np.clip((np.abs(across) - near_m) / 0.5, 0.0, 1.0)  # it begins below the edge of the road
    share = edge * land.open_share(s)[:, None]
    lift = share * rough_m * (0.6 + noise(along, across)) - 0.04 * (1.0 - share)
    return ribbon(land.road, s, d, land.rise_m(along, across) + lift, GRASS)


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
        world: "v2" or "v3"; what "v3" adds draws from streams of its own, so that "v2" stays as it is.
    """

    seed: np.random.SeedSequence
    duration_s: float
    sizes: str
    world: str = "v2"
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
        relief = self.stream("relief") if self.world == "v3" else None
        leaf_rng = self.stream("plants") if self.world == "v3" else None
        layout.ground = GroundSurface(land, breaks_m) if self.world == "v3" else None
        return layout, Roadside(layout, self.around, FIRST_M, self.travel_m(ego_m_s) + 420.0, relief, leaf_rng)

    def stream(self, name: str) -> np.random.Generator:
        """A stream of randomness of its own for something that "v2" lacks."""
        key = (*self.seed.spawn_key, zlib.crc32(name.encode()))
        return np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=key))

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
