"""Roads at slow pace: campus roads among lawns and people on foot, and parking lots with rows of stalls."""

from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies import furniture
from farfield.simulation.bodies.mesh import Mesh, box, quads
from farfield.simulation.world.furnishing import CAMPUS, CAR_PARK, Furnishing, always_clear
from farfield.simulation.world.land import FarLand, Land, Strip
from farfield.simulation.world.layout import (
    ASPHALT,
    CONCRETE,
    FIRST_M,
    FOLIAGE,
    GRASS,
    PAINT,
    RoadBuild,
    RoadLayout,
    Roadside,
)
from farfield.simulation.world.parking import Parking
from farfield.simulation.world.population import Population
from farfield.simulation.world.road import Bends, RoadLine
from farfield.simulation.world.roads.street import (
    Street,
    StreetLand,
    add_kerbside,
    add_walkers,
    draw_junctions,
    furnish_street,
    mark_street,
    park_kerbside,
    zebra,
)

CAMPUS_BENDS = Bends(1 / 90, (60.0, 220.0), (0.1, 0.7), grade=0.03)


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
    road = plot.line(CAMPUS_BENDS, speed)
    land, population = StreetLand(road, street, plot.around, 0.3), plot.population(road)
    offset, gap = street.lane_offset_m(0), float(rng.uniform(25, 90))
    lanes = [plot.lane(-offset, 1, gap, speed, street.lane_m, speed, trucks=0.05)]
    lanes.append(plot.lane(offset, -1, float(rng.uniform(25, 120)), max(speed, 5.0), street.lane_m, speed, trucks=0.05))
    population.drive(lanes, ego_lane=0, ego_speed_m_s=speed)
    last = plot.travel_m(speed) + 350.0
    if plot.world == "v2":
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
        station_m = float(junction) - street.side_half_m
        side.add(partial(zebra, road, street, station_m), station_m)
    if plot.world == "v3":
        parking = Parking(population, land, plot.stream("parking"), street.clear)
        park_kerbside(parking, street, last, (0.6, 0.97))
        furnishing = Furnishing(side, plot.stream("furniture"), street.clear)
        furnish_street(furnishing, street, float(furnishing.rng.uniform(8.0, 16.0)))
        for sign, index in ((-1, 0), (1, 1)):
            front = float(street.front_m[index])
            side.verge(sign, front + 0.1, front + 5.5, 0.03)
            furnishing.strip(sign, front + 0.4, front + 9.0, float(furnishing.rng.uniform(5.0, 9.0)), CAMPUS)
    return layout


# Parking lots: rows of stalls of 2.5 by 5 m along aisles, 30 to 70 % occupied, people on foot, a creeping ego vehicle

PARKING_LOT_BENDS = Bends(1 / 1500, (200.0, 500.0), (0.02, 0.06), grade=0.015)
STALL_M, DEPTH_M, AISLE_M = 2.5, 5.0, 6.5
_MODULE_M = 2 * DEPTH_M + AISLE_M


def _rows(modules: int) -> list[tuple[float, int]]:
    """Middles of the rows of stalls, and where their vehicles' aisle lies (1 towards growing d)."""
    out: list[tuple[float, int]] = []
    for module in range(-modules, modules + 1):
        middle = module * _MODULE_M
        out += [(middle - (AISLE_M + DEPTH_M) / 2, 1), (middle + (AISLE_M + DEPTH_M) / 2, -1)]
    return out


def _marks(road: RoadLine, rows: list[tuple[float, int]], gap_m: float, s_m: Float[np.ndarray, " k"]) -> Mesh:
    """Lines between the stalls."""
    stalls = np.arange(np.ceil(s_m[0] / STALL_M), np.floor((s_m[-1] - 0.01) / STALL_M) + 1) * STALL_M
    stalls = stalls[~_cross_aisle(stalls + 0.01, gap_m)]
    middles = np.array([d for d, _ in rows])
    s, d = (coordinate.reshape(-1, 1) for coordinate in np.meshgrid(stalls, middles, indexing="ij"))
    along, across = np.array([-0.06, 0.06, 0.06, -0.06]), np.array([-0.5, -0.5, 0.5, 0.5]) * DEPTH_M
    if not len(s):
        return Mesh.merge([])
    return quads(road.point_m(s + along, d + across) + np.array([0.0, 0.0, 0.01]), PAINT)


def _cross_aisle(s_m: Float[np.ndarray, " n"], pitch_m: float) -> np.ndarray:
    """Whether stations lie in one of the aisles across the rows."""
    return np.asarray(np.mod(s_m, pitch_m) < 3 * STALL_M)


def _fill(population: Population, rows: list[tuple[float, int]], pitch_m: float, last_m: float) -> None:
    """Park vehicles in 30 to 70 % of the stalls, nose in or out."""
    rng, share = population.rng, float(population.rng.uniform(0.3, 0.7))
    for d, aisle in rows:
        for s in np.arange(np.ceil(-130.0 / STALL_M), last_m / STALL_M) * STALL_M + STALL_M / 2:
            draw, nose, shift = rng.random(3)
            if draw > share or _cross_aisle(np.array([s]), pitch_m)[0]:
                continue
            turn = np.pi / 2 * (-aisle if nose < 0.75 else aisle)
            population.add_parked(float(s), d - aisle * 0.3 * float(shift), turn_rad=turn)


def _people(population: Population, last_m: float, duration_s: float) -> None:
    """People along and across the aisles, some with carts, prams or children; cars looking for a place."""
    rng = population.rng
    kinds = ["pedestrian", "child", "wheelchair", "stroller", "object", "animal"]
    for s in rng.uniform(-250, last_m, rng.poisson(12 * (last_m + 250) / 250)):
        module = int(rng.integers(-2, 3))
        kind = str(rng.choice(kinds, p=[0.74, 0.09, 0.03, 0.05, 0.06, 0.03]))
        d = module * _MODULE_M + float(rng.choice([-1, 1])) * float(rng.uniform(2.2, 2.9))
        speed = 0.0 if kind == "object" or rng.random() < 0.25 else float(rng.uniform(0.7, 1.6))
        population.add_along(kind, float(s), d, int(rng.choice([-1, 1])), speed)
    for s in rng.uniform(-100, last_m, rng.poisson(0.1 * duration_s)):
        direction, delay = int(rng.choice([-1, 1])), float(rng.uniform(-5, duration_s))
        population.add_crossing(
            "pedestrian", float(s), -direction * 3.0, direction, float(rng.uniform(0.9, 1.5)), delay_s=delay
        )
    for module in (-2, -1, 1, 2):
        for s in rng.uniform(-200, last_m, rng.poisson(0.8)):
            direction = int(rng.choice([-1, 1]))
            d = module * _MODULE_M - direction * 1.5
            population.add_along(population.draw_car(), float(s), d, direction, float(rng.uniform(1, 4)))


def build_parking_lot(plot: RoadBuild) -> RoadLayout:
    """Draw one sequence in a parking lot."""
    rng, speed = plot.rng, float(plot.rng.uniform(1.0, 3.2))
    modules, pitch = int(rng.choice([1, 2])), STALL_M * int(rng.integers(22, 36))
    road, rows = plot.line(PARKING_LOT_BENDS, speed), _rows(modules)
    edge = modules * _MODULE_M + AISLE_M / 2 + DEPTH_M
    half = [
        Strip(edge, ASPHALT),
        Strip(0.5, ASPHALT),
        Strip(0.02, CONCRETE, 0.12),
        Strip(2.0, CONCRETE),
        Strip(12.0, GRASS, 0.0, 0.1),
    ]
    land = Land(road, half, half, (FarLand(GRASS, 0.0, 1.0), FarLand(GRASS, 0.0, 1.0)), plot.around)
    population = plot.population(road)
    lanes = [plot.lane(-1.55, 1, 60.0, speed, 2.6, speed, kind=""), plot.lane(1.55, -1, 70.0, 2.5, 2.6, speed)]
    population.drive(lanes, ego_lane=0, ego_speed_m_s=speed)
    last = plot.travel_m(speed) + 260.0
    _people(population, last, plot.duration_s)
    if plot.world == "v2":
        _fill(population, rows, pitch, last - 160.0)
    layout, side = plot.layout(land, population, speed)
    side.run(partial(_marks, road, rows, float(pitch)))
    _furnish(side, edge, float(pitch), modules)
    if plot.world == "v3":
        furnishing = Furnishing(side, plot.stream("furniture"), always_clear)
        _carts(furnishing, rows, float(pitch))
        for sign in (-1, 1):
            furnishing.strip(sign, edge + 0.8, edge + 2.5, float(furnishing.rng.uniform(6.0, 12.0)), CAR_PARK)
            furnishing.strip(sign, edge + 3.5, edge + 9.0, float(furnishing.rng.uniform(8.0, 16.0)), CAR_PARK)
        stalls = partial(_between_aisles, float(pitch))
        _park(Parking(population, land, plot.stream("parking"), stalls), rows, last - 160.0)
    return layout


def _between_aisles(pitch_m: float, s_m: float, reach_m: float) -> bool:  # noqa: ARG001
    """Whether a stall's middle lies in none of the aisles across the rows."""
    return not _cross_aisle(np.array([s_m]), pitch_m)[0]


def _park(parking: Parking, rows: list[tuple[float, int]], last_m: float) -> None:
    """Fill 55 to 95 % of the stalls."""
    share = float(parking.rng.uniform(0.55, 0.95))
    for d, aisle in rows:
        parking.stalls(d, -aisle, np.arange(-52, int(last_m / STALL_M)) * STALL_M + STALL_M / 2, DEPTH_M, share)


def _carts(furnishing: Furnishing, rows: list[tuple[float, int]], pitch_m: float) -> None:
    """Shelters for shopping carts in some of the stalls, and skips and cones in a few."""
    for s in furnishing.side.stations(float(furnishing.rng.uniform(30.0, 60.0))):
        d, aisle = rows[int(furnishing.rng.integers(len(rows)))]
        stall = (np.floor(s / STALL_M) + 0.5) * STALL_M
        kind = str(furnishing.rng.choice(["carts", "skip", "cones"], p=[0.75, 0.1, 0.15]))
        model = furnishing.model(kind)
        if np.ptp(model.vertices_m[:, 0]) < DEPTH_M - 0.2 and _between_aisles(pitch_m, float(stall), 0.0):
            furnishing.stand(model, float(stall), -aisle, -aisle * d, turn_rad=np.pi / 2, spare_m=0.1)


def _furnish(side: Roadside, edge_m: float, pitch_m: float, modules: int) -> None:
    """Lamps and trees between the rows, hedges and buildings around."""
    rng = side.rng
    lamp = furniture.pole(float(rng.uniform(7, 10)), 1.2)
    kerbed = box([1.8, 4.0, 0.35], [0.0, 0.0, -0.025], CONCRETE)
    islands = [(module + 0.5) * _MODULE_M for module in range(-modules, modules)]
    first = np.floor(FIRST_M / pitch_m) * pitch_m
    for s in np.arange(first, side.last_m, pitch_m):
        for d in islands:
            model = lamp if rng.random() < 0.5 else side.trees[int(rng.integers(6))]
            side.put(model, float(s) + 1.0, d)
            if side.relief is not None:
                side.put(kerbed, float(s) + 1.0, d, only_free=False)
            side.put(lamp, float(s) + STALL_M * round(pitch_m / 2 / STALL_M), d)
    for sign in (-1, 1):
        side.plants(sign, edge_m + 3.5, edge_m + 12.0, 0.08)
        hedge, built = rng.random() < 0.6, rng.random() < 0.6
        for s in np.arange(FIRST_M, side.last_m, 50.0):
            if hedge and rng.random() < 0.85:
                side.wall(float(s), 50.0, sign * (edge_m + 2.9), 1.1, FOLIAGE, 0.8)
            if built and rng.random() < 0.7:
                side.block(
                    float(s) + 25.0, sign, edge_m + 16.0, 48.0, float(rng.uniform(20, 35)), float(rng.uniform(6, 12))
                )
