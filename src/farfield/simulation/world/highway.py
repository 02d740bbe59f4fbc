"""The highway template: two to four lanes each way, median, rails, poles, gantries, bridges, trees and noise walls."""

from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies import furniture
from farfield.simulation.bodies.actors import draw_car, draw_truck
from farfield.simulation.world.layout import Layout, Placement
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.world.population import Lane, Population
from farfield.simulation.world.road import RoadLine, ribbon
from farfield.simulation.world.traffic import STEP_S

_ASPHALT, _GRASS, _SOIL, _PAINT = (
    int(m) for m in (Material.ASPHALT, Material.GRASS, Material.SOIL, Material.LANE_PAINT)
)
_STATES = {
    "free": (0.45, (45.0, 90.0), (25.0, 33.0)),
    "busy": (0.38, (22.0, 42.0), (17.0, 28.0)),
    "jam": (0.17, (7.0, 16.0), (2.0, 9.0)),
}


def _choose(truck_share: float, rng: np.random.Generator) -> str:
    draw = rng.random()
    if draw < truck_share:
        return draw_truck(rng, long_haul=True)
    return "motorcycle" if draw > 0.975 else draw_car(rng)


class Highway:
    """The dimensions of one highway, drawn at random."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.lanes = int(rng.choice([2, 3, 4], p=[0.35, 0.4, 0.25]))
        self.lane_m = rng.uniform(3.5, 3.75)
        self.median_m = float(rng.choice([0.6, 1.2, 3.0, 6.0], p=[0.4, 0.25, 0.2, 0.15]))  # half of its width
        self.inner_m = self.median_m + rng.uniform(0.6, 1.2)
        self.edge_m = self.inner_m + self.lanes * self.lane_m
        self.shoulder_m = self.edge_m + rng.uniform(2.2, 3.2)
        self.bank = rng.uniform(-0.22, 0.18, 2)  # slope of the ground beside the shoulder, right and left
        self.rail = rng.random(2) < 0.55
        self.barrier = rng.random() < 0.75
        self.barrier_height_m = rng.uniform(0.75, 1.05)

    def ground(self, road: RoadLine, s_m: Float[np.ndarray, " k"], rng: np.random.Generator) -> Mesh:
        """Carriageways, median, shoulders and the land beside them, over the given stations."""
        right = np.array([110.0, 40.0, 16.0, 8.0]) + self.shoulder_m
        inner = [self.shoulder_m, self.edge_m, self.inner_m, self.median_m]
        d = np.concatenate([-right, [-v for v in inner], inner[::-1], right[::-1]])
        bumps = rng.standard_normal((len(s_m), 4)) * [0.3, 0.15, 0.06, 0.03]
        bumps[[0, -1]] = 0.0  # neighbouring pieces meet without a gap
        fall = np.array([18.0, 14.0, 12.0, 7.0])
        right_z, left_z = self.bank[0] * fall + bumps, self.bank[1] * fall[::-1] + bumps[:, ::-1]
        z = np.concatenate([right_z, np.zeros((len(s_m), 8)), left_z], axis=1)
        kind = [_GRASS, _GRASS, _SOIL, _GRASS, _ASPHALT, _ASPHALT, _ASPHALT, _ASPHALT if self.barrier else _GRASS]
        return ribbon(road, s_m, d, z, np.array(kind + kind[-2::-1]))

    def marks(self, road: RoadLine, s_m: Float[np.ndarray, " k"]) -> list[Mesh]:
        """Solid edge lines and dashed lane lines, a centimetre above the asphalt."""
        edge, stripe, raise_m = np.array([-0.08, 0.08]), np.array([-0.07, 0.07]), np.full(2, 0.01)
        parts: list[Mesh] = []
        for side in (1, -1):
            edges = (self.inner_m, self.edge_m)
            parts += [ribbon(road, s_m, side * offset + edge, raise_m, _PAINT) for offset in edges]
            for lane in range(1, self.lanes):
                line = side * (self.inner_m + lane * self.lane_m) + stripe
                dashes = np.arange(s_m[0], s_m[-1] - 3.0, 12.0)
                parts += [ribbon(road, s + np.array([0.0, 3.0]), line, raise_m, _PAINT) for s in dashes]
        return parts

    def surface(self, road: RoadLine, s_m: Float[np.ndarray, " k"], rng: np.random.Generator) -> Mesh:
        """Everything continuous: ground, markings, barrier and rails."""
        parts = [self.ground(road, s_m, rng), *self.marks(road, s_m)]
        if self.barrier:
            parts.append(furniture.jersey_barrier(road, s_m, 0.0, self.barrier_height_m))
        else:
            parts += [furniture.guard_rail(road, s_m, side * (self.median_m - 0.4)) for side in (1, -1)]
        parts += [
            furniture.guard_rail(road, s_m, side * (self.shoulder_m + 0.3))
            for side, rail in zip((-1, 1), self.rail, strict=True)
            if rail
        ]
        return Mesh.merge([part.painted(rng) for part in parts])


def _place_trees(layout: Layout, highway: Highway, first_m: float, last_m: float, rng: np.random.Generator) -> None:
    models = [furniture.tree(rng.uniform(4, 13), rng) for _ in range(8)] + [furniture.bush(rng) for _ in range(4)]
    for side, bank in zip((-1, 1), highway.bank, strict=True):
        density = rng.choice([0.0, 0.02, 0.06, 0.14])
        for s in rng.uniform(first_m, last_m, rng.poisson(density * (last_m - first_m))):
            off = rng.uniform(9.0, 45.0)
            model, turn = models[int(rng.integers(len(models)))], rng.uniform(0, 2 * np.pi)
            build = partial(
                _stand, model, layout.road, float(s), side * (highway.shoulder_m + off), turn, float(bank * 9.0)
            )
            layout.placements.append(Placement(float(s), build))


def _stand(
    model: Mesh, road: RoadLine, s_m: float, d_m: float, turn: float, raise_m: float, _: np.random.Generator
) -> Mesh:
    return furniture.stand(model, road, s_m, d_m, turn_rad=turn, raise_m=raise_m)


def _place_furniture(layout: Layout, highway: Highway, first_m: float, last_m: float, rng: np.random.Generator) -> None:
    """Lamp posts, signs, gantries, bridges, noise walls and buildings in the distance."""
    road, out = layout.road, highway.shoulder_m

    def put(model: Mesh, s_m: float, d_m: float, turn: float = 0.0, raise_m: float = 0.0) -> None:
        layout.placements.append(Placement(s_m, partial(_stand, model, road, s_m, d_m, turn, raise_m)))

    if rng.random() < 0.6:
        lamp, step = furniture.pole(rng.uniform(9, 12), 2.0), rng.uniform(32, 50)
        for s in np.arange(first_m, last_m, step):
            put(lamp, float(s), -(out + 1.0))
            put(lamp, float(s), out + 1.0, np.pi)
    for s in np.arange(first_m + rng.uniform(0, 60), last_m, rng.uniform(50, 150)):
        put(
            furniture.sign(rng.uniform(1.8, 3.0), rng.uniform(0.6, 2.5), rng.uniform(0.6, 1.8)),
            float(s),
            -(out + rng.uniform(0.9, 2.5)),
        )
    for s in np.arange(first_m + rng.uniform(0, 500), last_m, rng.uniform(350, 900)):
        panels = [(-(highway.inner_m + (lane + 0.5) * highway.lane_m), 3.0) for lane in range(highway.lanes)]
        put(furniture.gantry(out + 1.2, panels), float(s), 0.0)
    for s in np.arange(first_m + rng.uniform(0, 1500), last_m, rng.uniform(900, 2500)):
        put(furniture.bridge(out + 1.0, rng.uniform(7, 14)), float(s), 0.0)
    for side in (-1, 1):
        walled = rng.random() < 0.3
        for s in np.arange(first_m, last_m, 100.0):
            if walled and rng.random() < 0.85:
                height, kind = rng.uniform(2.5, 4.5), int(rng.choice([Material.CONCRETE, Material.FOLIAGE]))
                layout.placements.append(
                    Placement(float(s), partial(_wall, road, float(s), side * (out + 5.0), height, kind))
                )
            elif rng.random() < 0.35:
                depth = rng.uniform(10, 30)
                block = furniture.building(rng.uniform(12, 50), depth, rng.uniform(5, 14), rng)
                put(block, float(s) + 50.0, side * (out + rng.uniform(22, 60)), 0.0 if side > 0 else np.pi)


def _wall(road: RoadLine, s_m: float, d_m: float, height_m: float, kind: int, _: np.random.Generator) -> Mesh:
    return furniture.wall(road, np.linspace(s_m, s_m + 100.0, 26), d_m, height_m, kind)


def build_highway(seed: np.random.SeedSequence, *, duration_s: float) -> Layout:
    """Draw one highway sequence.

    Args:
        seed: Spawns the streams of road, traffic, surroundings and bodies.
        duration_s: For how long the traffic must last.
    """
    road_seed, traffic_seed, static_seed, chunk_seed = seed.spawn(4)
    rng, around = np.random.default_rng(road_seed), np.random.default_rng(static_seed)
    highway = Highway(rng)
    state = str(rng.choice(list(_STATES), p=[value[0] for value in _STATES.values()]))
    _, gaps, speeds = _STATES[state]
    speed, gap = rng.uniform(*speeds), rng.uniform(*gaps)
    travel = 1.2 * speed * duration_s
    road = RoadLine.draw(
        rng,
        behind_m=40.0 * duration_s + 500.0,
        ahead_m=120.0 * duration_s + 1500.0,
        curvature_per_m=1 / 1100,
        undulation_m=0.18,
    )
    steps = round(duration_s / STEP_S) + 2
    population = Population(road, steps=steps, rng=np.random.default_rng(traffic_seed))
    _add_traffic(population, highway, speed=speed, gap=gap, duration_s=duration_s, state=state)
    layout = Layout(road, partial(highway.surface, road), population, chunk_seed)
    _place_trees(layout, highway, -100.0, travel + 500.0, around)
    _place_furniture(layout, highway, -100.0, travel + 500.0, around)
    return layout


def _add_traffic(
    population: Population, highway: Highway, *, speed: float, gap: float, duration_s: float, state: str
) -> None:
    """Lanes both ways (slower and with more trucks to the right), and a few vehicles standing on the shoulder."""
    rng = population.rng
    oncoming = rng.uniform(*_STATES["busy" if state == "free" else "free"][2]) if rng.random() < 0.7 else speed
    onward_gap = rng.uniform(25, 90)
    trucks = rng.uniform(0.03, 0.22)
    lanes = []
    for index in range(highway.lanes):
        share = trucks * (0.15, 0.8, 1.8, 2.2)[index + (2 if highway.lanes == 2 and index else 0)]
        offset = highway.inner_m + (index + 0.5) * highway.lane_m
        pace = speed * (1.06 - 0.07 * index)
        ahead = 420.0 + 14.0 * duration_s if state != "jam" else 500.0
        lanes.append(Lane(-offset, 1, -120.0, ahead, gap, pace, partial(_choose, share), 0.06))
        far = 420.0 + (1.1 * speed + 1.2 * oncoming) * duration_s
        pace = oncoming * (1.06 - 0.07 * index)
        lanes.append(Lane(offset, -1, -120.0, far, onward_gap, pace, partial(_choose, share), 0.06))
    ego = 2 * int(rng.integers(highway.lanes))
    population.drive(lanes, ego_lane=ego, ego_speed_m_s=speed * rng.uniform(0.95, 1.08))
    for s in rng.uniform(30, 420 + speed * duration_s, rng.poisson(0.8)):
        middle = (highway.edge_m + highway.shoulder_m) / 2 + 0.3
        kind = draw_car(rng) if rng.random() < 0.7 else draw_truck(rng, long_haul=True)
        population.add_parked(float(s), -middle, kind=kind)
        if rng.random() < 0.4:
            population.add_along("pedestrian", float(s) - 6, -(highway.shoulder_m + 0.0), 1, 0.02)
    if rng.random() < 0.08:
        population.add_parked(float(rng.uniform(40, 200)), -(highway.shoulder_m + 4), turn_rad=1.2, kind="animal")
