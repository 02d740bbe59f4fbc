"""Mountain roads: hairpin-like bends and grades, a cut slope on one side, guard rail and drop on the other, trees."""

from functools import partial

import numpy as np

from farfield.simulation.bodies import furniture
from farfield.simulation.world.land import FarLand, Land, Strip
from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.road import Bends
from farfield.simulation.world.roads.common import ASPHALT, GRASS, SOIL, RoadBuild
from farfield.simulation.world.roadside import guard_rail, solid_line

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
    return layout
