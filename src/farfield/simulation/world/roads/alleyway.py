"""Alleyways: five to six metres between walls and fronts, one way, people and parked vehicles close by."""

import numpy as np

from farfield.simulation.bodies import furniture
from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.road import Bends
from farfield.simulation.world.roads.common import ASPHALT, BRICK, CONCRETE, FIRST_M, RoadBuild
from farfield.simulation.world.roads.street import Street, StreetLand, add_crossers, draw_junctions

BENDS = Bends(1 / 90, (60.0, 160.0), (0.05, 0.4), grade=0.03)


def build_alleyway(plot: RoadBuild) -> RoadLayout:
    """Draw one alley sequence."""
    rng, speed = plot.rng, float(plot.rng.uniform(2, 5))
    half = float(rng.uniform(2.6, 3.0))
    street = Street(
        lanes=1,
        lane_m=half,
        parking_m=np.zeros(2),
        walk_m=np.full(2, 0.1),
        junctions_m=draw_junctions(rng, plot.travel_m(speed) + 460.0, 40.0, 110.0),
        kerb_m=0.0,
        side_half_m=float(rng.uniform(2.6, 3.4)),
        front=ASPHALT,
    )
    road = plot.line(BENDS, speed)
    land, population = StreetLand(road, street, plot.around), plot.population(road)
    lane_d = -half + 2.0
    lane = plot.lane(lane_d, 1, float(rng.uniform(50, 150)), speed, 2.3, speed)
    population.drive([lane], ego_lane=0, ego_speed_m_s=speed)
    last, people = plot.travel_m(speed) + 250.0, population.rng
    add_crossers(plot, population, street, [], last)
    parked = float(people.uniform(0.1, 0.5))
    for s in np.arange(-250.0, last, 6.5):
        draw, side_draw = people.random(2)
        if not street.clear(float(s), 4.0) or draw > parked:
            continue
        if side_draw < 0.6:
            population.add_parked(float(s), half - 1.05, turn_rad=0.0 if people.random() < 0.6 else np.pi)
        elif side_draw < 0.85:
            population.add_parked(float(s), half - 0.5, kind="motorcycle")
        else:
            population.add_parked(float(s), half - 0.6, kind="object")
    for s in people.uniform(-250, last, people.poisson(8 * (last + 250) / 250)):
        speed_m_s = 0.0 if people.random() < 0.3 else float(people.uniform(0.6, 1.6))
        kind = str(
            people.choice(["pedestrian", "child", "cyclist", "animal", "stroller"], p=[0.7, 0.08, 0.12, 0.06, 0.04])
        )
        d = float(people.choice([-half + 0.45, half - 0.5, half - 0.9]))
        population.add_along(kind, float(s), d, int(people.choice([-1, 1])), speed_m_s)
    layout, side = plot.layout(land, population, speed, breaks_m=street.breaks())
    around = plot.around
    for sign in (-1, 1):
        s = FIRST_M
        while s < side.last_m:
            length, draw = float(around.uniform(6, 18)), around.random()
            if street.clear(s + length / 2, length / 2 + 0.3):
                if draw < 0.65:
                    side.block(
                        s + length / 2,
                        sign,
                        half + 0.12,
                        length,
                        float(around.uniform(7, 13)),
                        float(around.uniform(3.5, 13)),
                    )
                elif draw < 0.93:
                    material = BRICK if around.random() < 0.5 else CONCRETE
                    side.wall(s, length, sign * (half + 0.25), float(around.uniform(1.6, 2.8)), material)
                    side.block(
                        s + length / 2,
                        sign,
                        half + float(around.uniform(4, 7)),
                        length - 2,
                        9.0,
                        float(around.uniform(4, 10)),
                    )
            s += length
        pole = furniture.pole(float(around.uniform(6, 8)), 0.9)
        for post in side.stations(float(around.uniform(25, 40))):
            if sign > 0 and street.clear(float(post), 0.5):
                side.put(pole, float(post), half - 0.1, turn_rad=np.pi)
    return layout
