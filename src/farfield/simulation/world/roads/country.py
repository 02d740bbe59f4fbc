"""Roads outside towns: highways, the shoulder of one, and mountain roads."""

from functools import partial

import numpy as np

from farfield.simulation.bodies import furniture
from farfield.simulation.world.furnishing import COUNTRY, ROADSIDE, Furnishing, always_clear
from farfield.simulation.world.land import FarLand, Land, Strip
from farfield.simulation.world.layout import (
    ASPHALT,
    CONCRETE,
    FIRST_M,
    FOLIAGE,
    GRASS,
    SOIL,
    RoadBuild,
    RoadLayout,
    Roadside,
    dashed_line,
    guard_rail,
    jersey_barrier,
    solid_line,
)
from farfield.simulation.world.motion import STEP_S
from farfield.simulation.world.population import Population
from farfield.simulation.world.road import Bends, RoadLine

HIGHWAY_BENDS = Bends(1 / 640, (150.0, 500.0), (0.08, 0.5), grade=0.02, bank_gain_m=8.0)
_STATES = {
    "free": (0.45, (45.0, 90.0), (25.0, 33.0)),
    "busy": (0.38, (24.0, 42.0), (17.0, 28.0)),
    "jam": (0.17, (7.0, 16.0), (3.0, 9.0)),
}


class Highway:
    """The dimensions of one highway, drawn at random."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.lanes = int(rng.choice([2, 3, 4], p=[0.35, 0.4, 0.25]))
        self.lane_m = float(rng.uniform(3.5, 3.75))
        self.median_m = float(rng.choice([0.6, 1.2, 3.0, 6.0], p=[0.4, 0.25, 0.2, 0.15]))  # half of its width
        self.inner_m = self.median_m + float(rng.uniform(0.6, 1.2))
        self.edge_m = self.inner_m + self.lanes * self.lane_m
        self.shoulder_m = self.edge_m + float(rng.uniform(2.7, 3.3))
        self.bank = rng.uniform(-0.25, 0.22, 2)  # slope of the ground beside the shoulder, right and left
        self.rail = rng.random(2) < 0.55
        self.barrier = bool(rng.random() < 0.75)
        self.barrier_m = float(rng.uniform(0.75, 1.05))

    def _side(self, bank: float) -> list[Strip]:
        return [
            Strip(self.median_m, ASPHALT if self.barrier else GRASS),
            Strip(self.inner_m - self.median_m, ASPHALT),
            Strip(self.edge_m - self.inner_m, ASPHALT),
            Strip(self.shoulder_m - self.edge_m, ASPHALT),
            Strip(1.5, GRASS, -0.05, 0.02),
            Strip(2.0, SOIL, -0.45, 0.05),
            Strip(2.5, GRASS, 0.35, 0.06),
            Strip(8.0, GRASS, 8 * bank, 0.10),
            Strip(16.0, GRASS, 5 * bank, 0.25),
        ]

    def land(self, road: RoadLine, rng: np.random.Generator) -> Land:
        """Carriageways, median, shoulders, ditches, embankments and the land beside them."""
        far = (FarLand(GRASS, 0.1 * float(self.bank[0]), 2.0), FarLand(GRASS, 0.1 * float(self.bank[1]), 2.0))
        return Land(road, self._side(float(self.bank[0])), self._side(float(self.bank[1])), far, rng, below_m=0.5)

    def run(self, side: Roadside, road: RoadLine) -> None:
        """Markings, barrier and rails."""
        for sign in (1, -1):
            for offset in (self.inner_m, self.edge_m):
                side.run(partial(solid_line, road, sign * offset))
            for lane in range(1, self.lanes):
                side.run(partial(dashed_line, road, sign * (self.inner_m + lane * self.lane_m), 3.0, 12.5))
        if self.barrier:
            side.run(partial(jersey_barrier, road, 0.0, self.barrier_m))
        else:
            for sign in (1, -1):
                side.run(partial(guard_rail, road, sign * (self.median_m - 0.4)))
        for sign, rail in zip((-1, 1), self.rail, strict=True):
            if rail:
                side.run(partial(guard_rail, road, sign * (self.shoulder_m + 0.4)))

    def furnish(self, side: Roadside, rng: np.random.Generator) -> None:
        """Lamp posts, signs, gantries, bridges, noise walls, trees, and buildings in the distance."""
        out = self.shoulder_m
        lamps, pitch, height = rng.random() < 0.6, rng.uniform(32, 50), rng.uniform(9, 12)
        for sign in (-1, 1):
            if lamps:
                side.lamps(sign, out + 1.2, float(pitch), float(height), 2.0)
            side.signs(sign, out + 0.9, float(rng.uniform(60, 150)))
            walled = rng.random() < 0.3
            height, material = float(rng.uniform(2.5, 4.5)), int(rng.choice([CONCRETE, FOLIAGE]))
            for s in np.arange(FIRST_M, side.last_m, 100.0):
                if walled and rng.random() < 0.85:
                    side.wall(float(s), 100.0, sign * (out + 6.5), height, material)
                elif rng.random() < 0.35:
                    length, depth = float(rng.uniform(12, 50)), float(rng.uniform(10, 30))
                    side.block(
                        float(s) + 50.0,
                        sign,
                        out + float(rng.uniform(26, 60)),
                        length,
                        depth,
                        float(rng.uniform(5, 14)),
                    )
            side.plants(sign, out + 9.0, out + 50.0, float(rng.choice([0.0, 0.03, 0.08, 0.16])))
        panels = [(-(self.inner_m + (lane + 0.5) * self.lane_m), 3.0) for lane in range(self.lanes)]
        for s in side.stations(float(rng.uniform(500, 1000))):
            side.put(furniture.gantry(out + 1.0, panels), float(s), 0.0, over_road=True)
        for s in side.stations(float(rng.uniform(900, 2000))):
            side.put(furniture.bridge(out + 1.0, float(rng.uniform(7, 14))), float(s), 0.0, over_road=True)


def build_highway(plot: RoadBuild, *, on_shoulder: bool = False) -> RoadLayout:
    """Draw one highway sequence; ``on_shoulder`` lets the ego vehicle stand or creep on the right shoulder."""
    rng, around = plot.rng, plot.around
    highway = Highway(rng)
    state = str(rng.choice(list(_STATES), p=[value[0] for value in _STATES.values()]))
    _, gaps, speeds = _STATES[state]
    speed, gap = float(rng.uniform(*speeds)), float(rng.uniform(*gaps))
    creep = 0.0 if rng.random() < 0.6 else float(rng.uniform(0.5, 2.5))
    ego = creep if on_shoulder else speed * float(rng.uniform(0.95, 1.08))
    road = plot.line(HIGHWAY_BENDS, ego)
    land = highway.land(road, around)
    population = plot.population(road, long_haul=True)
    if on_shoulder:
        s_m = creep * STEP_S * np.arange(population.steps)
        population.place_ego(s_m, -(highway.edge_m + highway.shoulder_m) / 2 - 0.3)
    _add_traffic(plot, population, highway, speed=speed, gap=gap, state=state, ego_m_s=ego, on_shoulder=on_shoulder)
    layout, side = plot.layout(land, population, ego)
    highway.run(side, road)
    highway.furnish(side, around)
    if plot.world == "v3":
        furnishing, out = Furnishing(side, plot.stream("furniture"), always_clear), highway.shoulder_m
        for sign in (-1, 1):
            side.verge(sign, out + 0.1, out + 4.5, 0.05)
            furnishing.strip(sign, out + 0.8, out + 5.5, float(furnishing.rng.uniform(20.0, 60.0)), ROADSIDE)
            if furnishing.rng.random() < 0.5:  # against deer
                furnishing.fence(sign, out + 8.5, FIRST_M, side.last_m, "wires")
    return layout


def build_shoulder(plot: RoadBuild) -> RoadLayout:
    """Draw one sequence on a highway's shoulder."""
    return build_highway(plot, on_shoulder=True)


def _add_traffic(
    plot: RoadBuild,
    population: Population,
    highway: Highway,
    *,
    speed: float,
    gap: float,
    state: str,
    ego_m_s: float,
    on_shoulder: bool,
) -> None:
    """Lanes both ways (slower and with more trucks to the right), and a few vehicles standing on the shoulder."""
    rng = population.rng
    oncoming = float(rng.uniform(*_STATES["busy" if state == "free" else "free"][2])) if rng.random() < 0.7 else speed
    onward_gap, trucks = float(rng.uniform(25, 90)), float(rng.uniform(0.03, 0.22))
    lanes = []
    for index in range(highway.lanes):
        share = trucks * (0.15, 0.8, 1.8, 2.2)[index + (2 if highway.lanes == 2 and index else 0)]
        offset = highway.inner_m + (index + 0.5) * highway.lane_m
        for direction, distance, pace in ((1, gap, speed), (-1, onward_gap, oncoming)):
            slower = pace * (1.06 - 0.07 * index)
            lanes.append(
                plot.lane(
                    -direction * offset,
                    direction,
                    distance,
                    slower,
                    highway.lane_m,
                    ego_m_s,
                    trucks=share,
                    trailers=0.06,
                )
            )
    own = -1 if on_shoulder else 2 * int(rng.integers(highway.lanes))
    population.drive(lanes, ego_lane=own, ego_speed_m_s=ego_m_s, surge=0.5 if state == "jam" else 0.0)
    middle = (highway.edge_m + highway.shoulder_m) / 2 + 0.25
    for s in rng.uniform(-150, 420 + plot.travel_m(ego_m_s), rng.poisson(1.0)):
        kind = None if rng.random() < 0.7 else population.draw_truck()
        population.add_parked(float(s), -middle, kind=kind)
        if rng.random() < 0.4:
            population.add_along("pedestrian", float(s) - 6, -(highway.shoulder_m + 0.4), 1, 0.3)
    if rng.random() < 0.08:
        kind = str(rng.choice(["animal", "deer"]))
        population.add_parked(float(rng.uniform(40, 200)), -(highway.shoulder_m + 4), turn_rad=1.2, kind=kind)
    if rng.random() < 0.05:
        population.add_parked(float(rng.uniform(40, 200)), -(highway.shoulder_m - 0.6), kind="object")


# Mountain roads: hairpin-like bends and grades, a cut slope on one side, guard rail and drop on the other, trees

CURVATURE_PER_M, GRADE = 1 / 60, 0.06


def _strips(edge_m: float, shoulder_m: float, cut: bool, steep: float) -> list[Strip]:
    """Half of the section: a ditch and a rising slope, or a verge and a drop."""
    road = [Strip(edge_m, ASPHALT), Strip(shoulder_m, ASPHALT)]
    if cut:
        slope = [(6.0, SOIL, 0.4), (10.0, GRASS, 0.6), (18.0, GRASS, 1.0)]
        rising = [Strip(width, material, width * steep, rough) for width, material, rough in slope]
        return [*road, Strip(0.6, SOIL, -0.25), Strip(0.6, SOIL, 0.25), *rising]
    falling = [
        Strip(width, GRASS, -width * 0.7 * steep, rough) for width, rough in ((8.0, 0.3), (12.0, 0.6), (14.0, 1.0))
    ]
    return [*road, Strip(1.2, GRASS, -0.05, 0.02), *falling]


def build_mountain(plot: RoadBuild) -> RoadLayout:
    """Draw one mountain sequence."""
    rng, speed = plot.rng, float(plot.rng.uniform(8, 13.5))
    climb = float(rng.uniform(-0.035, 0.035))
    bends = Bends(CURVATURE_PER_M, (25.0, 130.0), (0.3, 1.5), grade=GRADE, climb=climb, bank_gain_m=2.5)
    lane_m, shoulder = float(rng.uniform(3.2, 3.6)), float(rng.uniform(0.5, 1.1))
    cut_side, steep = int(rng.choice([-1, 1])), float(rng.uniform(0.45, 0.9))
    road = plot.line(bends, speed)
    halves = [_strips(lane_m, shoulder, side == cut_side, steep) for side in (-1, 1)]
    far = [FarLand(GRASS, 0.3 if side == cut_side else -0.15, 4.0) for side in (-1, 1)]
    land, population = (
        Land(road, halves[0], halves[1], (far[0], far[1]), plot.around, below_m=1.5),
        plot.population(road),
    )
    gap = float(np.exp(rng.uniform(np.log(20), np.log(120))))
    lanes = [plot.lane(-lane_m / 2, 1, gap, speed, lane_m, speed, trucks=0.05)]
    lanes.append(plot.lane(lane_m / 2, -1, float(rng.uniform(40, 150)), speed, lane_m, speed, trucks=0.05))
    population.drive(lanes, ego_lane=0, ego_speed_m_s=speed)
    last, people = plot.travel_m(speed) + 350.0, population.rng
    edge = lane_m + shoulder
    for s in people.uniform(-250, last, people.poisson(1.5)):
        population.add_along("cyclist", float(s), -(lane_m + 0.15), 1, float(people.uniform(2.5, 5)))
    for s in people.uniform(-250, last, people.poisson(2.0)):
        population.add_along("pedestrian", float(s), float(people.choice([-1, 1])) * (edge + 0.6), 1, 1.2, raise_m=-0.1)
    for s in people.uniform(-150, last, people.poisson(0.7)):
        population.add_parked(float(s), -cut_side * (edge + 1.0), turn_rad=float(people.uniform(-3, 3)), kind="deer")
    layout, side = plot.layout(land, population, speed)
    for offset in (0.0, lane_m, -lane_m):
        side.run(partial(solid_line, road, offset))
    side.run(partial(guard_rail, road, -cut_side * (edge + 0.35)))
    around = plot.around
    for sign in (-1, 1):
        cut = sign == cut_side
        side.plants(
            sign, edge + (3.5 if cut else 3.0), edge + 34.0, float(around.uniform(0.12, 0.3)), conifers=0.5, bushes=0.25
        )
        side.plants(sign, edge + 40.0, edge + 110.0, 0.12, conifers=0.7, bushes=0.0)
        side.signs(sign, edge + 0.8, float(around.uniform(70, 160)))
    post = furniture.pole(0.9)
    for s in side.stations(12.0):
        side.put(post, float(s), cut_side * (edge + 0.15))
    if plot.world == "v3":
        furnishing = Furnishing(side, plot.stream("furniture"), always_clear)
        for sign in (-1, 1):
            near = edge + (1.4 if sign == cut_side else 0.9)
            side.verge(sign, near, near + 4.0, 0.06)
            furnishing.strip(sign, near, near + 4.0, float(furnishing.rng.uniform(10.0, 25.0)), COUNTRY)
        furnishing.wire_poles(cut_side, edge + 3.0, 40.0)
    return layout
