"""The town template: one or two lanes each way, parked cars, kerbs, crossings, side streets, buildings, people."""

from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies import furniture
from farfield.simulation.bodies.actors import draw_car, draw_truck
from farfield.simulation.world.layout import Layout, Placement
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, quads
from farfield.simulation.world.population import Lane, Population
from farfield.simulation.world.road import RoadLine, ribbon
from farfield.simulation.world.traffic import STEP_S

_ASPHALT, _CONCRETE, _GRASS, _PAINT = (
    int(m) for m in (Material.ASPHALT, Material.CONCRETE, Material.GRASS, Material.LANE_PAINT)
)


def _choose(truck_share: float, rng: np.random.Generator) -> str:
    draw = rng.random()
    if draw < truck_share:
        return draw_truck(rng, long_haul=False)
    return "motorcycle" if draw > 0.96 else draw_car(rng)


class Street:
    """The dimensions of one street, drawn at random."""

    def __init__(self, rng: np.random.Generator, first_m: float, last_m: float) -> None:
        self.lanes = int(rng.choice([1, 2, 3], p=[0.4, 0.45, 0.15]))
        self.lane_m = rng.uniform(3.0, 3.4)
        self.median_m = float(rng.choice([0.0, 1.5], p=[0.75, 0.25]))
        self.edge_m = self.median_m + self.lanes * self.lane_m
        self.cycle_m = float(rng.choice([0.0, 1.5]))
        self.angled = rng.random(2) < 0.15
        self.parking_m = np.where(self.angled, 5.2, np.where(rng.random(2) < 0.8, 2.3, 0.0))  # right, left
        self.kerb_m = self.edge_m + self.cycle_m + self.parking_m
        self.walk_m = rng.uniform(2.2, 4.5, 2)
        self.side_half_m = rng.uniform(3.6, 6.0)
        stations, s = [], first_m + rng.uniform(20, 120)
        while s < last_m:
            stations.append(float(s))
            s += rng.uniform(70, 200)
        self.junctions_m = np.array(stations)

    def clear(self, s_m: float, reach_m: float) -> bool:
        """Whether a place is further than ``reach_m`` from every side street."""
        return bool((np.abs(self.junctions_m - s_m) > self.side_half_m + reach_m).all())

    def breaks(self) -> tuple[float, ...]:
        """Stations where the kerb begins or ends."""
        near = [self.junctions_m + sign * (self.side_half_m + off) for sign in (-1, 1) for off in (0.0, 0.4)]
        return tuple(float(value) for value in np.concatenate(near))

    def ground(self, road: RoadLine, s_m: Float[np.ndarray, " k"]) -> Mesh:
        """Carriageway, kerbs, pavements, ground up to the buildings; side streets interrupt the kerbs."""
        gap = np.abs(s_m[:, None] - self.junctions_m[None]).min(axis=1)
        step = 0.14 * np.clip((gap - self.side_half_m - 0.01) / 0.38, 0, 1)[:, None]
        right, left = self.kerb_m
        d = np.array([-120.0, -(right + self.walk_m[0]), -right - 0.02, -right, -self.edge_m, self.edge_m])
        d = np.concatenate([d, [left, left + 0.02, left + self.walk_m[1], 120.0]])
        raised = np.array([1, 1, 1, 0, 0, 0, 0, 1, 1, 1.0])
        kind = np.array(
            [_CONCRETE, _CONCRETE, _CONCRETE, _ASPHALT, _ASPHALT, _ASPHALT, _CONCRETE, _CONCRETE, _CONCRETE]
        )
        cells = np.broadcast_to(kind, (len(s_m) - 1, len(kind))).copy()
        cells[(gap[:-1] <= self.side_half_m + 0.1) & (gap[1:] <= self.side_half_m + 0.1)] = _ASPHALT
        return ribbon(road, s_m, d, step * raised, cells)

    def surface(self, road: RoadLine, s_m: Float[np.ndarray, " k"], rng: np.random.Generator) -> Mesh:
        """Ground, lane lines and zebra crossings."""
        line, raise_m = np.array([-0.07, 0.07]), np.full(2, 0.01)
        offsets = sorted({self.median_m, -self.median_m})
        parts = [self.ground(road, s_m), *(ribbon(road, s_m, at + line, raise_m, _PAINT) for at in offsets)]
        for junction in self.junctions_m[(self.junctions_m >= s_m[0]) & (self.junctions_m < s_m[-1])]:
            first = junction - self.side_half_m - 4.5
            stripes = np.arange(-self.edge_m + 0.4, self.edge_m - 0.4, 1.0)
            corner = np.array([[0, 0], [3, 0], [3, 0.5], [0, 0.5]])
            places = np.stack(
                [first + np.tile(corner[:, 0], (len(stripes), 1)), stripes[:, None] + corner[:, 1]], axis=-1
            )
            raised = road.point_m(places[..., 0], places[..., 1]) + np.array([0, 0, 0.01])
            parts.append(quads(raised, _PAINT))
        return Mesh.merge([part.painted(rng) for part in parts])


def _stand(
    model: Mesh, road: RoadLine, s_m: float, d_m: float, turn: float, raise_m: float, _: np.random.Generator
) -> Mesh:
    return furniture.stand(model, road, s_m, d_m, turn_rad=turn, raise_m=raise_m)


def _place_fixed(layout: Layout, street: Street, first_m: float, last_m: float, rng: np.random.Generator) -> None:
    """Buildings and open lots, lamp posts and trees on the pavements, signs and signals at the side streets."""
    road = layout.road

    def put(model: Mesh, s_m: float, d_m: float, turn: float = 0.0) -> None:
        layout.placements.append(Placement(s_m, partial(_stand, model, road, s_m, d_m, turn, 0.1)))

    trees = [furniture.tree(rng.uniform(4, 9), rng) for _ in range(6)]
    lamp = furniture.pole(rng.uniform(6, 9), 1.5)
    for side, index in ((-1, 0), (1, 1)):
        outward = 0.0 if side > 0 else np.pi
        kerb, walk = float(street.kerb_m[index]), float(street.walk_m[index])
        setback, open_share = rng.uniform(0, 7), rng.uniform(0.1, 0.5)
        s = first_m
        while s < last_m:
            length = rng.uniform(8, 28)
            middle = s + length / 2
            if street.clear(middle, length / 2 + 1.5):
                if rng.random() > open_share:
                    block = furniture.building(
                        length - rng.choice([0.0, 3.0]), rng.uniform(8, 16), rng.uniform(5, 20), rng
                    )
                    put(block, middle, side * (kerb + walk + setback + rng.uniform(0, 1)), outward)
                elif rng.random() < 0.5:
                    put(
                        trees[int(rng.integers(6))],
                        middle,
                        side * (kerb + walk + rng.uniform(2, 14)),
                        rng.uniform(0, 6),
                    )
            s += length
        for post in np.arange(first_m + rng.uniform(0, 20), last_m, rng.uniform(22, 40)):
            if street.clear(float(post), 1.0):
                put(lamp, float(post), side * (kerb + 0.5), np.pi if side > 0 else 0.0)
        if rng.random() < 0.6:
            for post in np.arange(first_m + 8.0, last_m, rng.uniform(9, 22)):
                if street.clear(float(post), 3.0) and rng.random() < 0.75:
                    put(trees[int(rng.integers(6))], float(post), side * (kerb + 1.0), rng.uniform(0, 6))
    signal = rng.random() < 0.5
    for junction in street.junctions_m:
        near = float(junction) - street.side_half_m - 1.0
        model = furniture.traffic_light(3.5) if signal else furniture.sign(2.3, 0.6, 0.6)
        put(model, near, -(street.kerb_m[0] + 0.6))
        put(model, float(junction) + street.side_half_m + 1.0, street.kerb_m[1] + 0.6, np.pi)


def _add_parked(population: Population, street: Street, first_m: float, last_m: float) -> None:
    """Vehicles along the kerbs (parallel or at an angle), and rows on open lots behind the pavements."""
    rng = population.rng
    for side, index in ((-1, 0), (1, 1)):
        share, turn = rng.uniform(0.15, 0.7), rng.choice([1.05, 1.57]) * rng.choice([-1, 1])
        pitch = 3.1 if street.angled[index] else 6.6
        if street.parking_m[index] > 0:
            for s in np.arange(first_m, last_m, pitch):
                if street.clear(float(s), 6.0) and rng.random() < share:
                    straight = 0.0 if side < 0 or rng.random() < 0.1 else np.pi
                    d = side * (street.kerb_m[index] - street.parking_m[index] / 2)
                    kind = (
                        draw_truck(rng, long_haul=False) if rng.random() < 0.03 and not street.angled[index] else None
                    )
                    population.add_parked(
                        float(s) + rng.normal(0, 0.2), d, turn_rad=turn if street.angled[index] else straight, kind=kind
                    )


def _add_crossers(population: Population, street: Street, duration_s: float) -> None:
    """Vehicles that cross on the side streets, wait at their ends, or are parked along them."""
    rng, road = population.rng, population.road
    for junction in street.junctions_m:
        place = np.array(junction)
        heading, (x, y, z) = float(road.heading_rad(place)), road.point_m(place, 0.0)
        along = np.array([np.cos(heading), np.sin(heading), 0.0])
        left = np.array([-along[1], along[0], 0.0])
        for side in (1, -1):  # coming from the left moves along -left
            lane = np.array([x, y, z]) + (-0.5 if side > 0 else 0.5) * street.side_half_m * along
            yaw = heading - side * np.pi / 2
            edge = float(street.edge_m + street.cycle_m + 2.5)
            for wait in range(int(rng.choice([0, 1, 2], p=[0.4, 0.4, 0.2]))):
                start = lane + side * (edge + 3 + 6.5 * wait) * left
                population.add(draw_car(rng), start, yaw, loose=True)
            for _ in range(int(rng.poisson(duration_s / 12))):
                delay, speed = -rng.uniform(0, 8) + rng.uniform(0, duration_s), rng.uniform(4, 11)
                start = lane + side * (speed * delay) * left
                population.add_straight(_choose(0.08, rng), start, yaw, speed)
            for row in range(6):
                if rng.random() < 0.35:
                    spot = np.array([x, y, z]) + side * (street.kerb_m.max() + 12 + 6.5 * row) * left
                    spot = spot + rng.choice([-1, 1]) * (street.side_half_m + 1.3) * along
                    population.add(draw_car(rng), spot, heading + rng.choice([-1, 1]) * np.pi / 2, loose=True)


def _add_people(population: Population, street: Street, last_m: float, duration_s: float) -> None:
    """Pedestrians on the pavements and crossings, cyclists at the edge, now and then a wheelchair or a dog."""
    rng, road = population.rng, population.road
    busy = rng.uniform(0.015, 0.09)
    for side, index in ((-1, 0), (1, 1)):
        kerb, walk = float(street.kerb_m[index]), float(street.walk_m[index])
        for s in rng.uniform(-20, last_m, rng.poisson(busy * last_m)):
            kind = str(rng.choice(["pedestrian", "wheelchair", "animal"], p=[0.9, 0.05, 0.05]))
            speed = 0.0 if rng.random() < 0.2 else rng.uniform(0.6, 1.8)
            population.add_along(
                kind, float(s), side * (kerb + rng.uniform(0.9, walk - 0.3)), int(rng.choice([-1, 1])), speed
            )
        for s in rng.uniform(-20, last_m, rng.poisson(0.02 * last_m)):
            d = street.edge_m + street.cycle_m / 2 if street.cycle_m else street.edge_m - 0.5
            population.add_along("cyclist", float(s), side * d, -side, rng.uniform(3.0, 6.5))
    for junction in street.junctions_m:
        for _ in range(int(rng.poisson(busy * 40 * duration_s / 20))):
            side = int(rng.choice([-1, 1]))
            s = np.array(junction - street.side_half_m - rng.uniform(1.6, 4.4))
            start = road.point_m(s, side * (float(street.kerb_m[1 if side > 0 else 0]) + 0.8))
            yaw = float(road.heading_rad(s)) - side * np.pi / 2
            population.add_straight(
                "pedestrian", start, yaw, rng.uniform(0.9, 1.7), delay_s=rng.uniform(-5, duration_s)
            )


def build_urban(seed: np.random.SeedSequence, *, duration_s: float) -> Layout:
    """Draw one town sequence.

    Args:
        seed: Spawns the streams of road, traffic, surroundings and bodies.
        duration_s: For how long the traffic must last.
    """
    road_seed, traffic_seed, static_seed, chunk_seed = seed.spawn(4)
    rng, around = np.random.default_rng(road_seed), np.random.default_rng(static_seed)
    speed, gap = rng.uniform(7, 15), float(np.exp(rng.uniform(np.log(9), np.log(60))))
    if gap < 14:
        speed = rng.uniform(2, 7)
    travel = 1.25 * speed * duration_s
    street = Street(rng, -80.0, travel + 420.0)
    road = RoadLine.draw(
        rng,
        behind_m=40.0 * duration_s + 500.0,
        ahead_m=60.0 * duration_s + 1500.0,
        curvature_per_m=1 / 1400,
        undulation_m=0.16,
    )
    steps = round(duration_s / STEP_S) + 2
    population = Population(road, steps=steps, rng=np.random.default_rng(traffic_seed))
    lanes = []
    for index in range(street.lanes):
        offset = street.median_m + (index + 0.5) * street.lane_m
        lanes.append(Lane(-offset, 1, -60.0, 420.0 + 7 * duration_s, gap, speed, partial(_choose, 0.07), 0.02))
        far, onward = 420.0 + 2.4 * max(speed, 8.0) * duration_s, population.rng.uniform(12, 60)
        lanes.append(Lane(offset, -1, -60.0, far, onward, max(speed, 8.0), partial(_choose, 0.07), 0.02))
    ego = 2 * int(population.rng.integers(street.lanes))
    population.drive(lanes, ego_lane=ego, ego_speed_m_s=speed)
    _add_crossers(population, street, duration_s)
    _add_parked(population, street, -20.0, travel + 400.0)
    _add_people(population, street, travel + 350.0, duration_s)
    layout = Layout(road, partial(street.surface, road), population, chunk_seed, breaks_m=street.breaks())
    _place_fixed(layout, street, -60.0, travel + 420.0, around)
    return layout
