"""Town streets: one to three lanes each way, signals, parked cars, crossings, side streets, buildings, people."""

from functools import partial

import numpy as np

from farfield.simulation.bodies import furniture
from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.road import Bends
from farfield.simulation.world.roads.common import CONCRETE, RoadBuild
from farfield.simulation.world.roads.street import (
    Street,
    StreetLand,
    add_crossers,
    add_kerbside,
    add_walkers,
    draw_junctions,
    mark_street,
    signals_of,
    zebra,
)
from farfield.simulation.world.roadside import Roadside

BENDS = Bends(1 / 160, (150.0, 500.0), (0.05, 0.3), grade=0.02)


def _draw_street(rng: np.random.Generator, last_m: float) -> Street:
    angled = rng.random(2) < 0.15
    parking = np.where(angled, 5.2, np.where(rng.random(2) < 0.8, 2.3, 0.0))
    return Street(
        lanes=int(rng.choice([1, 2, 3], p=[0.4, 0.45, 0.15])),
        lane_m=float(rng.uniform(3.0, 3.4)),
        parking_m=parking,
        walk_m=rng.uniform(2.2, 4.5, 2),
        junctions_m=draw_junctions(rng, last_m, 70.0, 200.0),
        median_m=float(rng.choice([0.0, 1.5], p=[0.75, 0.25])),
        cycle_m=float(rng.choice([0.0, 1.5])),
        side_half_m=float(rng.uniform(4.0, 6.0)),
        angled=(bool(angled[0]), bool(angled[1])),
        front=CONCRETE,
    )


def _furnish(side: Roadside, street: Street, signalled: bool) -> None:
    """Buildings and open lots, lamp posts and trees on the pavements, signs and signals at the side streets."""
    rng, road = side.rng, side.layout.land.road
    for sign, index in ((-1, 0), (1, 1)):
        kerb, front = float(street.kerb_at_m[index]), float(street.front_m[index])
        setback, open_share = float(rng.uniform(0, 7)), float(rng.uniform(0.1, 0.5))
        s = side.first_m
        while s < side.last_m:
            length = float(rng.uniform(8, 28))
            middle, draw = s + length / 2, rng.random()
            if street.clear(middle, length / 2 + 1.5) and draw > open_share:
                wide, depth = length - float(rng.choice([0.0, 3.0])), float(rng.uniform(8, 16))
                side.block(
                    middle, sign, front + setback + float(rng.uniform(0, 1)), wide, depth, float(rng.uniform(5, 22))
                )
            elif street.clear(middle, 3.0) and draw < 0.5 * open_share:
                side.put(side.trees[int(rng.integers(6))], middle, sign * (front + float(rng.uniform(2, 14))))
            s += length
        posts = side.stations(float(rng.uniform(22, 40)))
        lamp = furniture.pole(float(rng.uniform(6, 9)), 1.5)
        trees = side.stations(float(rng.uniform(9, 22))) if rng.random() < 0.6 else np.zeros(0)
        for post in posts[[street.clear(float(s), 1.0) for s in posts]]:
            side.put(lamp, float(post), sign * (kerb + 0.45), turn_rad=np.pi if sign > 0 else 0.0)
        for post in trees:
            if street.clear(float(post), 3.0) and rng.random() < 0.75:
                side.put(
                    side.trees[int(rng.integers(6))],
                    float(post),
                    sign * (kerb + 0.55),
                    turn_rad=float(rng.uniform(0, 6)),
                )
    for junction in street.junctions_m:
        near, away = float(junction) - street.side_half_m - 1.0, float(junction) + street.side_half_m + 1.0
        model = furniture.traffic_light(3.5) if signalled else furniture.sign(2.3, 0.6, 0.6)
        side.put(model, near, -(float(street.kerb_at_m[0]) + 0.45))
        side.put(model, away, float(street.kerb_at_m[1]) + 0.45, turn_rad=np.pi)
        side.place(partial(zebra, road, street, float(junction) - street.side_half_m), near)


def build_urban(plot: RoadBuild) -> RoadLayout:
    """Draw one town sequence."""
    rng = plot.rng
    speed, gap = float(rng.uniform(8, 16)), float(np.exp(rng.uniform(np.log(9), np.log(60))))
    if gap < 14:
        speed = float(rng.uniform(3, 8))
    street = _draw_street(rng, plot.travel_m(speed) + 460.0)
    road = plot.line(BENDS, speed)
    land, population = StreetLand(road, street, plot.around), plot.population(road)
    lanes, onward = [], float(population.rng.uniform(12, 60))
    for index in range(street.lanes):
        offset = street.lane_offset_m(index)
        lanes.append(plot.lane(-offset, 1, gap, speed, street.lane_m, speed, trucks=0.07, trailers=0.02))
        lanes.append(plot.lane(offset, -1, onward, max(speed, 8.0), street.lane_m, speed, trucks=0.07, trailers=0.02))
    signals = signals_of(street, lanes, population.rng) if population.rng.random() < 0.6 else []
    ego = 2 * int(population.rng.integers(street.lanes))
    population.drive(lanes, ego_lane=ego, ego_speed_m_s=speed, signals=signals)
    last = plot.travel_m(speed) + 350.0
    add_crossers(plot, population, street, signals, last)
    add_kerbside(population, street, last, (0.3, 0.7))
    people = float(population.rng.choice([2.0, 8.0, 18.0], p=[0.3, 0.45, 0.25]))
    add_walkers(plot, population, street, last, people)
    layout, side = plot.layout(land, population, speed, breaks_m=street.breaks())
    mark_street(side, road, street)
    _furnish(side, street, bool(signals))
    return layout
