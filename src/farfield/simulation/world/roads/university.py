"""Campus roads: one lane each way, zebra crossings, lawns with trees, rows of parked cars, many people on foot."""

from functools import partial

import numpy as np

from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.road import Bends
from farfield.simulation.world.roads.common import GRASS, RoadBuild
from farfield.simulation.world.roads.street import (
    Street,
    StreetLand,
    add_kerbside,
    add_walkers,
    draw_junctions,
    mark_street,
    zebra,
)

BENDS = Bends(1 / 90, (60.0, 220.0), (0.1, 0.7), grade=0.03)


def build_university(plot: RoadBuild) -> RoadLayout:
    """Draw one campus sequence."""
    rng, speed = plot.rng, float(plot.rng.uniform(4, 9))
    angled = rng.random(2) < 0.55
    street = Street(
        lanes=1,
        lane_m=float(rng.uniform(3.0, 3.5)),
        parking_m=np.where(angled, 5.2, np.where(rng.random(2) < 0.4, 2.3, 0.0)),
        walk_m=rng.uniform(2.0, 3.5, 2),
        junctions_m=draw_junctions(rng, plot.travel_m(speed) + 460.0, 60.0, 160.0),
        side_half_m=3.2,
        angled=(bool(angled[0]), bool(angled[1])),
        front=GRASS,
    )
    road = plot.line(BENDS, speed)
    land, population = StreetLand(road, street, plot.around, 0.3), plot.population(road)
    offset, gap = street.lane_offset_m(0), float(rng.uniform(25, 90))
    lanes = [plot.lane(-offset, 1, gap, speed, street.lane_m, speed, trucks=0.05)]
    lanes.append(plot.lane(offset, -1, float(rng.uniform(25, 120)), max(speed, 5.0), street.lane_m, speed, trucks=0.05))
    population.drive(lanes, ego_lane=0, ego_speed_m_s=speed)
    last = plot.travel_m(speed) + 350.0
    add_kerbside(population, street, last, (0.4, 0.85))
    add_walkers(plot, population, street, last, float(rng.uniform(8, 25)), cyclists=4.0)
    for s in population.rng.uniform(-250, last, population.rng.poisson(8.0 * (last + 250) / 250)):
        d = float(population.rng.uniform(8, 26)) + float(street.front_m.max())
        far_side = int(population.rng.choice([-1, 1]))
        population.add_along(
            "pedestrian", float(s), far_side * d, int(population.rng.choice([-1, 1])), 1.2, raise_m=street.kerb_m
        )
    layout, side = plot.layout(land, population, speed, breaks_m=street.breaks())
    mark_street(side, road, street)
    around = plot.around
    for sign, index in ((-1, 0), (1, 1)):
        front = float(street.front_m[index])
        s = side.first_m
        while s < side.last_m:
            length = float(around.uniform(25, 70))
            if around.random() < 0.7 and street.clear(s + length / 2, length / 2 + 2.0):
                set_back, height = front + float(around.uniform(12, 34)), float(around.uniform(8, 26))
                side.block(s + length / 2, sign, set_back, length - 6.0, float(around.uniform(14, 28)), height)
            s += length
        for s in side.stations(float(around.uniform(9, 16)), jitter_m=2.0):
            if street.clear(float(s), 3.0):
                side.put(
                    side.trees[int(around.integers(6))],
                    float(s),
                    sign * (front + 1.8),
                    turn_rad=float(around.uniform(0, 6)),
                )
        side.plants(sign, front + 3.0, front + 11.0, 0.05, bushes=0.5)
        side.lamps(sign, float(street.kerb_at_m[index]) + 0.4, float(around.uniform(22, 34)), 5.0, 0.8)
        side.signs(sign, float(street.kerb_at_m[index]) + 0.35, 80.0)
    for junction in street.junctions_m:
        place = float(junction) - street.side_half_m
        side.place(partial(zebra, road, street, place), place)
    return layout
