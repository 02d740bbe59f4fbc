"""Roads between buildings: town streets with signals, suburban roads with front gardens, alleyways between walls."""

from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies import facades, furniture
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.world.furnishing import ALLEY, FRONT, GARDEN, YARD, Furnishing
from farfield.simulation.world.land import Land
from farfield.simulation.world.layout import (
    ASPHALT,
    BRICK,
    CONCRETE,
    FIRST_M,
    FOLIAGE,
    GRASS,
    RoadBuild,
    RoadLayout,
    Roadside,
)
from farfield.simulation.world.parking import Parking
from farfield.simulation.world.planting import plant_fronts
from farfield.simulation.world.population import Population
from farfield.simulation.world.road import Bends, ribbon
from farfield.simulation.world.roads.street import (
    Street,
    StreetLand,
    add_crossers,
    add_kerbside,
    add_walkers,
    draw_junctions,
    furnish_street,
    mark_street,
    park_kerbside,
    signals_of,
    zebra,
)

URBAN_BENDS = Bends(1 / 160, (150.0, 500.0), (0.05, 0.3), grade=0.02)


def _draw_street(rng: np.random.Generator, last_m: float, parked_share: float) -> Street:
    angled = rng.random(2) < 0.15
    parking = np.where(angled, 5.2, np.where(rng.random(2) < parked_share, 2.3, 0.0))
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
        side.add(partial(zebra, road, street, float(junction) - street.side_half_m), near)


def build_urban(plot: RoadBuild) -> RoadLayout:
    """Draw one town sequence."""
    rng = plot.rng
    speed, gap = float(rng.uniform(8, 16)), float(np.exp(rng.uniform(np.log(9), np.log(60))))
    if gap < 14:
        speed = float(rng.uniform(3, 8))
    street = _draw_street(rng, plot.travel_m(speed) + 460.0, 0.8 if plot.world == "v2" else 0.95)
    road = plot.line(URBAN_BENDS, speed)
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
    if plot.world == "v2":
        add_kerbside(population, street, last, (0.3, 0.7))
    people = float(population.rng.choice([2.0, 8.0, 18.0], p=[0.3, 0.45, 0.25]))
    add_walkers(plot, population, street, last, people)
    layout, side = plot.layout(land, population, speed, breaks_m=street.breaks())
    mark_street(side, road, street)
    _furnish(side, street, bool(signals))
    if plot.world == "v3":
        parking = Parking(population, land, plot.stream("parking"), street.clear)
        park_kerbside(parking, street, last, (0.55, 0.97))
        _clutter(Furnishing(side, plot.stream("furniture"), street.clear), parking, street)
    for sign, front in ((-1, 0), (1, 1)):
        plant_fronts(side, sign, float(street.front_m[front]), street.clear)
    return layout


def _clutter(furnishing: Furnishing, parking: Parking, street: Street) -> None:
    """What cars are mistaken for: furniture on pavements, before fronts and on open lots, some of which hold cars."""
    rng = furnishing.rng
    furnish_street(furnishing, street, float(rng.uniform(6.0, 14.0)))
    for side, index in ((-1, 0), (1, 1)):
        front = float(street.front_m[index])
        for first, last in furnishing.open_stretches(side, front + 0.4, front + 9.0, 7.0):
            _use_lot(furnishing, parking, side, front, first, last)
        furnishing.strip(side, front + 0.4, front + 6.0, float(rng.uniform(4.0, 9.0)), FRONT)


def _use_lot(
    furnishing: Furnishing, parking: Parking, side: int, front_m: float, first_m: float, last_m: float
) -> None:
    """An open lot: rows of parked cars, a yard behind a fence, or neither."""
    rng, draw = furnishing.rng, float(furnishing.rng.random())
    fence = str(rng.choice(["railing", "boards", "site", "wires", "rails"]))
    if draw < 0.4:
        share = float(rng.uniform(0.5, 0.95))
        for row in range(int(rng.integers(1, 3))):
            edge, first, last = front_m + 6.2 + 5.4 * row, first_m + 0.5, last_m - 0.5
            right, left = sorted((side * (edge - 5.6), side * edge))
            if furnishing.side.ground.free(first, last, right, left):
                parking.across(side, edge, first, last, share)
                furnishing.side.ground.take(first, last, right, left)
        if rng.random() < 0.5:
            furnishing.fence(side, front_m + 0.35, first_m, last_m, fence, gates=0.3)
    elif draw < 0.8:
        furnishing.fence(side, front_m + 0.35, first_m, last_m, fence, gates=0.2)
        for _ in range(int(rng.poisson((last_m - first_m) / 5.0))):
            model, s = furnishing.draw(YARD), float(rng.uniform(first_m, last_m))
            turn = float(rng.choice([0.0, np.pi / 2, rng.uniform(-0.4, 0.4)]))
            furnishing.stand(model, s, side, front_m + float(rng.uniform(2.0, 9.0)), turn_rad=turn)


# Suburban roads: houses with front gardens, hedges and driveways, one lane each way, a few people

SUBURBAN_BENDS = Bends(1 / 160, (60.0, 250.0), (0.1, 0.7), grade=0.03, bank_gain_m=2.0)
_DRIVE_M = 3.0


def _garden(side: Roadside, population: Population, street: Street, sign: int, first_m: float, length_m: float) -> None:
    """One plot: a house, a hedge or fence with a gap for the driveway, sometimes a car on it, and plants."""
    rng, land = side.rng, side.layout.land
    front = float(street.front_m[0 if sign < 0 else 1])
    set_back, depth = front + float(rng.uniform(5.5, 10)), float(rng.uniform(8, 11))
    wide = length_m - float(rng.uniform(5.0, 7.0))
    side.put(
        furniture.house(wide, depth, rng) if side.relief is None else facades.relief_house(wide, depth, side.relief),
        first_m + 4.0 + wide / 2,
        sign * set_back,
        turn_rad=0.0 if sign > 0 else np.pi,
        only_free=False,
    )
    drive = first_m + 1.8
    rows, d = drive + np.array([-_DRIVE_M / 2, _DRIVE_M / 2]), sign * np.array([front, set_back + 3.0])
    d = np.sort(np.concatenate([d, d.mean(keepdims=True)]))

    side.add(partial(_driveway, land, rows, d), drive)
    draw, height = rng.random(), float(rng.uniform(0.8, 2.0))
    kind, thick = (FOLIAGE, 0.7) if draw < 0.6 else (int(Material.BRICK), 0.25)
    fenced = side.relief is not None and side.relief.random() < 0.4  # a fence in its stead
    if draw < 0.8 and not fenced:
        side.wall(first_m + 3.6, length_m - 3.8, sign * (front + 0.6), height, kind, thick)
    if side.relief is not None:
        side.ground.take(drive - _DRIVE_M / 2, drive + _DRIVE_M / 2, *sorted((sign * front, sign * (set_back + 3.0))))
    if population.rng.random() < 0.5:
        turn = sign * np.pi / 2 * (1 if population.rng.random() < 0.7 else -1)
        population.add_parked(drive, sign * (front + 3.2), turn_rad=turn, raise_m=street.kerb_m + 0.06)


def _driveway(land: Land, rows: Float[np.ndarray, " k"], d: Float[np.ndarray, " n"]) -> Mesh:
    return ribbon(land.road, rows, d, land.rise_m(*np.broadcast_arrays(rows[:, None], d)) + 0.06, CONCRETE)


def _gardens(furnishing: Furnishing, parking: Parking, street: Street) -> None:
    """Fences where no hedge stands, what stands in gardens, more cars on driveways, wires along one side."""
    rng = furnishing.rng
    furnishing.wire_poles(int(rng.choice([-1, 1])), float(street.kerb_at_m.max()) + 0.35, float(rng.uniform(28, 42)))
    furnish_street(furnishing, street, float(rng.uniform(9.0, 20.0)))
    for side, index in ((-1, 0), (1, 1)):
        front = float(street.front_m[index])
        for first, last in furnishing.open_stretches(side, front + 0.2, front + 0.9, 6.0):
            name = str(rng.choice(["pickets", "rails", "boards", "railing", "wires"]))
            if rng.random() < 0.7:
                furnishing.fence(side, front + 0.5, first, last, name, gates=0.12)
        furnishing.strip(side, front + 0.9, front + 7.5, float(rng.uniform(5.0, 10.0)), GARDEN)
        for first, last in furnishing.open_stretches(side, front + 1.5, front + 7.0, 9.0):
            if rng.random() < 0.25:  # a forecourt
                parking.across(
                    side, front + 7.0, first + 1.0, min(last - 1.0, first + 14.0), float(rng.uniform(0.4, 0.9))
                )


def build_suburban(plot: RoadBuild) -> RoadLayout:
    """Draw one suburban sequence."""
    rng, speed = plot.rng, float(plot.rng.uniform(7, 14))
    street = Street(
        lanes=1,
        lane_m=float(rng.uniform(3.1, 3.6)),
        parking_m=np.where(rng.random(2) < (0.5 if plot.world == "v2" else 0.8), 2.2, 0.0),
        walk_m=rng.uniform(1.5, 2.5, 2),
        junctions_m=draw_junctions(rng, plot.travel_m(speed) + 460.0, 110.0, 300.0),
        side_half_m=3.5,
        front=GRASS,
    )
    road = plot.line(SUBURBAN_BENDS, speed)
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
        side.verge(sign, front + 0.1, front + 5.5, 0.03)
    if plot.world == "v2":
        add_kerbside(population, street, last, (0.1, 0.4))
    else:
        parking = Parking(population, land, plot.stream("parking"), street.clear)
        park_kerbside(parking, street, last, (0.4, 0.85))
        _gardens(Furnishing(side, plot.stream("furniture"), street.clear), parking, street)
    add_walkers(plot, population, street, last, float(rng.uniform(1, 7)), cyclists=2.0)
    return layout


# Alleyways: five to six metres between walls and fronts, one way, people and parked vehicles close by

ALLEY_BENDS = Bends(1 / 90, (60.0, 160.0), (0.05, 0.4), grade=0.03)


def _gapped_alley_fronts(side: Roadside, street: Street, half_m: float, sign: int) -> None:
    """World v2's: straight houses in bends too, and nothing where a side street is near."""
    rng = side.rng
    s = FIRST_M
    while s < side.last_m:
        length, draw = float(rng.uniform(6, 18)), rng.random()
        if street.clear(s + length / 2, length / 2 + 0.3):
            if draw < 0.65:
                side.block(
                    s + length / 2,
                    sign,
                    half_m + 0.12,
                    length,
                    float(rng.uniform(7, 13)),
                    float(rng.uniform(3.5, 13)),
                    overhang_m=0.0,
                )
            elif draw < 0.93:
                material = BRICK if rng.random() < 0.5 else CONCRETE
                side.wall(s, length, sign * (half_m + 0.25), float(rng.uniform(1.6, 2.8)), material)
                side.block(
                    s + length / 2,
                    sign,
                    half_m + float(rng.uniform(4, 7)),
                    length - 2,
                    9.0,
                    float(rng.uniform(4, 10)),
                )
        s += length


_PIECE_M, _ALLEY_SPARE_M = 10.0, 0.12


def _alley_fronts(side: Roadside, street: Street, half_m: float, sign: int) -> None:
    """Houses and walls side by side from one side street to the next, no part of them within the alley."""
    rng, first = side.rng, side.first_m
    for junction in (*street.junctions_m, np.inf):
        last = min(float(junction) - street.side_half_m - 0.3, side.last_m)
        if last - first > 1.0:
            count = max(1, round((last - first) / _PIECE_M))
            ends = np.linspace(first, last, count + 1)
            ends[1:-1] += rng.uniform(-0.3, 0.3, count - 1) * (last - first) / count
            for index in range(count):
                at_corner = index in (0, count - 1)  # a house: its flank stands along the side street
                draw = 0.0 if at_corner and ends[index + 1] - ends[index] > 3.0 else float(rng.random())
                _alley_front(side, half_m, sign, float(ends[index]), float(ends[index + 1]), draw)
        first = float(junction) + street.side_half_m + 0.3


def _alley_front(side: Roadside, half_m: float, sign: int, first_m: float, last_m: float, draw: float) -> None:
    """One house at the edge of an alley, or a wall with a house behind it."""
    rng, middle, road = side.rng, (first_m + last_m) / 2, side.layout.land.road
    if draw < 0.65 and last_m - first_m > 3.0:
        at = road.point_m(np.linspace(first_m, last_m, 9), sign * (half_m + _ALLEY_SPARE_M))[:, :2]
        heading = float(road.heading_rad(np.array(middle)))
        outward = sign * (at - at[4]) @ np.array([-np.sin(heading), np.cos(heading)])
        set_back = half_m + _ALLEY_SPARE_M + max(float(outward.max()), 0.0)  # a straight front cuts a bend short
        length = float(np.linalg.norm(at[-1] - at[0]))
        height = float(rng.uniform(3.5, 13))
        side.block(middle, sign, set_back, length, float(rng.uniform(7, 13)), height, overhang_m=0.0)
        return
    material = BRICK if rng.random() < 0.5 else CONCRETE
    height = float(rng.uniform(1.6, 2.8))
    side.wall(first_m, last_m - first_m, sign * (half_m + 0.3), height, material)
    if last_m - first_m > 5.0:
        behind = half_m + float(rng.uniform(4, 7))
        side.block(middle, sign, behind, last_m - first_m - 2.0, 9.0, float(rng.uniform(4, 10)))


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
    road = plot.line(ALLEY_BENDS, speed)
    land, population = StreetLand(road, street, plot.around), plot.population(road)
    lane_d = -half + 2.0
    lane = plot.lane(lane_d, 1, float(rng.uniform(50, 150)), speed, 2.3, speed)
    population.drive([lane], ego_lane=0, ego_speed_m_s=speed)
    last, people = plot.travel_m(speed) + 250.0, population.rng
    add_crossers(plot, population, street, [], last)
    parked = float(people.uniform(0.1, 0.5)) if plot.world == "v2" else 0.0
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
        if plot.world == "v2":
            _gapped_alley_fronts(side, street, half, sign)
        else:
            _alley_fronts(side, street, half, sign)
        pole = furniture.pole(float(around.uniform(6, 8)), 0.9)
        for post in side.stations(float(around.uniform(25, 40))):
            if sign > 0 and street.clear(float(post), 0.5):
                side.put(pole, float(post), half - 0.1, turn_rad=np.pi, only_free=False)
    if plot.world == "v3":
        parking = Parking(population, land, plot.stream("parking"), street.clear)
        furnishing = Furnishing(side, plot.stream("furniture"), street.clear)
        furnishing.strip(1, half - 0.85, half, float(furnishing.rng.uniform(6.0, 12.0)), ALLEY, spare_m=0.03)
        furnishing.strip(-1, half - 0.5, half, float(furnishing.rng.uniform(15.0, 30.0)), ALLEY, spare_m=0.03)
        parking.along(1, half - 0.1, -250.0, last, float(parking.rng.uniform(0.3, 0.8)))
    return layout
