"""Suburban roads: houses with front gardens, hedges and driveways, one lane each way, a few people."""

from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies import furniture
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.world.land import Land
from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.population import Population
from farfield.simulation.world.road import Bends, ribbon
from farfield.simulation.world.roads.common import CONCRETE, FIRST_M, FOLIAGE, GRASS, RoadBuild
from farfield.simulation.world.roads.street import (
    Street,
    StreetLand,
    add_kerbside,
    add_walkers,
    draw_junctions,
    mark_street,
)
from farfield.simulation.world.roadside import Roadside

BENDS = Bends(1 / 160, (60.0, 250.0), (0.1, 0.7), grade=0.03, bank_gain_m=2.0)
_DRIVE_M = 3.0


def _garden(side: Roadside, population: Population, street: Street, sign: int, first_m: float, length_m: float) -> None:
    """One plot: a house, a hedge or fence with a gap for the driveway, sometimes a car on it, and plants."""
    rng, land = side.rng, side.layout.land
    front = float(street.front_m[0 if sign < 0 else 1])
    set_back, depth = front + float(rng.uniform(5.5, 10)), float(rng.uniform(8, 11))
    wide = length_m - float(rng.uniform(5.0, 7.0))
    side.put(
        furniture.house(wide, depth, rng),
        first_m + 4.0 + wide / 2,
        sign * set_back,
        turn_rad=0.0 if sign > 0 else np.pi,
    )
    drive = first_m + 1.8
    rows, d = drive + np.array([-_DRIVE_M / 2, _DRIVE_M / 2]), sign * np.array([front, set_back + 3.0])
    d = np.sort(np.concatenate([d, d.mean(keepdims=True)]))

    side.place(partial(_driveway, land, rows, d), drive)
    draw, height = rng.random(), float(rng.uniform(0.8, 2.0))
    kind, thick = (FOLIAGE, 0.7) if draw < 0.6 else (int(Material.BRICK), 0.25)
    if draw < 0.8:
        side.wall(first_m + 3.6, length_m - 3.8, sign * (front + 0.6), height, kind, thick)
    if population.rng.random() < 0.5:
        turn = sign * np.pi / 2 * (1 if population.rng.random() < 0.7 else -1)
        population.add_parked(drive, sign * (front + 3.2), turn_rad=turn, raise_m=street.kerb_m + 0.06)


def _driveway(land: Land, rows: Float[np.ndarray, " k"], d: Float[np.ndarray, " n"]) -> Mesh:
    return ribbon(land.road, rows, d, land.rise_m(*np.broadcast_arrays(rows[:, None], d)) + 0.06, CONCRETE)


def build_suburban(plot: RoadBuild) -> RoadLayout:
    """Draw one suburban sequence."""
    rng, speed = plot.rng, float(plot.rng.uniform(7, 14))
    street = Street(
        lanes=1,
        lane_m=float(rng.uniform(3.1, 3.6)),
        parking_m=np.where(rng.random(2) < 0.5, 2.2, 0.0),
        walk_m=rng.uniform(1.5, 2.5, 2),
        junctions_m=draw_junctions(rng, plot.travel_m(speed) + 460.0, 110.0, 300.0),
        side_half_m=3.5,
        front=GRASS,
    )
    road = plot.line(BENDS, speed)
    land, population = StreetLand(road, street, plot.around, 0.3), plot.population(road)
    offset = street.lane_offset_m(0)
    lanes = [
        plot.lane(-offset, 1, float(rng.uniform(30, 120)), speed, street.lane_m, speed, trucks=0.06, trailers=0.04)
    ]
    lanes.append(
        plot.lane(offset, -1, float(rng.uniform(30, 120)), speed, street.lane_m, speed, trucks=0.06, trailers=0.04)
    )
    population.drive(lanes, ego_lane=0, ego_speed_m_s=speed)
    last = plot.travel_m(speed) + 350.0
    layout, side = plot.layout(land, population, speed, breaks_m=street.breaks())
    mark_street(side, road, street)
    around = plot.around
    for sign in (-1, 1):
        s = FIRST_M
        built, plot_m = float(around.uniform(0.6, 0.95)), float(around.uniform(16, 24))
        while s < side.last_m:
            length = plot_m * float(around.uniform(0.85, 1.2))
            if around.random() < built and street.clear(s + length / 2, length / 2 + 1.0):
                _garden(side, population, street, sign, s, length)
            s += length
        front = float(street.front_m[0 if sign < 0 else 1])
        side.plants(sign, front + 20.0, front + 60.0, 0.12)
        side.plants(sign, front + 1.8, front + 4.0, 0.02, bushes=0.8)
        side.lamps(sign, float(street.kerb_at_m[0 if sign < 0 else 1]) + 0.4, float(around.uniform(30, 50)), 6.0, 1.2)
        side.signs(sign, float(street.kerb_at_m[0 if sign < 0 else 1]) + 0.35, 120.0)
    add_kerbside(population, street, last, (0.1, 0.4))
    add_walkers(plot, population, street, last, float(rng.uniform(1, 7)), cyclists=2.0)
    return layout
