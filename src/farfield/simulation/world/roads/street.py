"""Streets: carriageway, parking, kerbs, pavements and side streets; shared by the four roads between buildings."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from farfield.simulation.bodies.mesh import Mesh, quads
from farfield.simulation.world.furnishing import KERB, Furnishing
from farfield.simulation.world.land import FarLand, Land, Strip
from farfield.simulation.world.layout import (
    ASPHALT,
    CONCRETE,
    FIRST_M,
    GRASS,
    PAINT,
    RoadBuild,
    Roadside,
    dashed_line,
    solid_line,
)
from farfield.simulation.world.parking import Parking
from farfield.simulation.world.population import Lane, Population
from farfield.simulation.world.road import RoadLine
from farfield.simulation.world.traffic import Signal

_KERB_M = 0.02


@dataclass(frozen=True, eq=False)
class Street:
    """The dimensions of one street.

    Args:
        lanes: Lanes each way.
        lane_m: Width of a lane.
        parking_m: Width of the parking strips, right and left; 0 where there is none.
        walk_m: Width of the pavements, right and left.
        junctions_m: Stations of side streets.
        median_m: Half of the median's width.
        cycle_m: Width of the cycle lanes.
        kerb_m: Height of the kerbs.
        side_half_m: Half of the side streets' width.
        angled: Whether vehicles park at an angle, right and left.
        front: Material of the ground behind the pavements.
    """

    lanes: int
    lane_m: float
    parking_m: Float[np.ndarray, " 2"]
    walk_m: Float[np.ndarray, " 2"]
    junctions_m: Float[np.ndarray, " j"]
    median_m: float = 0.0
    cycle_m: float = 0.0
    kerb_m: float = 0.14
    side_half_m: float = 4.5
    angled: tuple[bool, bool] = (False, False)
    front: int = CONCRETE

    @property
    def edge_m(self) -> float:
        """Where the driving lanes end."""
        return self.median_m + self.lanes * self.lane_m

    @property
    def kerb_at_m(self) -> Float[np.ndarray, " 2"]:
        """Where the kerbs stand, right and left."""
        return self.edge_m + self.cycle_m + self.parking_m

    @property
    def front_m(self) -> Float[np.ndarray, " 2"]:
        """Where the pavements end."""
        return self.kerb_at_m + self.walk_m

    @property
    def strip_m(self) -> Float[np.ndarray, " 2"]:
        """Width of the pavements' strips along the kerbs where furniture stands, right and left, in world "v3"."""
        return np.minimum(1.25, 0.45 * self.walk_m)

    def clear(self, s_m: float, reach_m: float) -> bool:
        """Whether a place is further than ``reach_m`` from every side street."""
        return bool((np.abs(self.junctions_m - s_m) > self.side_half_m + reach_m).all())

    def breaks(self) -> tuple[float, ...]:
        """Stations where the kerb begins or ends."""
        near = [self.junctions_m + sign * (self.side_half_m + off) for sign in (-1, 1) for off in (0.0, 0.4)]
        return tuple(float(value) for value in np.concatenate(near))

    def lane_offset_m(self, index: int) -> float:
        """Middle of a lane, counted from the middle of the street."""
        return self.median_m + (index + 0.5) * self.lane_m


def draw_junctions(
    rng: np.random.Generator, last_m: float, closest_m: float, furthest_m: float
) -> Float[np.ndarray, " j"]:
    """Stations of side streets over the whole stretch."""
    stations, s = [], FIRST_M + float(rng.uniform(20, 120))
    while s < last_m:
        stations.append(s)
        s += float(rng.uniform(closest_m, furthest_m))
    return np.array(stations)


class StreetLand(Land):
    """A street's ground: side streets interrupt the kerbs, and are paved."""

    def __init__(self, road: RoadLine, street: Street, rng: np.random.Generator, hills_m: float = 0.08) -> None:
        self.street = street
        halves = [
            [
                Strip(street.edge_m, ASPHALT),
                Strip(float(street.kerb_at_m[i]) - street.edge_m + 0.001, ASPHALT),
                Strip(_KERB_M, CONCRETE, street.kerb_m),
                Strip(float(street.walk_m[i]) - _KERB_M, CONCRETE),
                Strip(6.0, street.front, 0.0, 0.03),
                Strip(18.0, street.front, 0.0, 0.05),
                Strip(22.0, street.front, 0.0, 0.05),
            ]
            for i in (0, 1)
        ]
        super().__init__(road, halves[0], halves[1], (FarLand(GRASS, 0.0, hills_m), FarLand(GRASS, 0.0, hills_m)), rng)

    def _kerb_share(self, s_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """How much of the kerb's height there is: none across side streets."""
        if not len(self.street.junctions_m):
            return np.ones_like(s_m)
        gap = np.abs(s_m[..., None] - self.street.junctions_m).min(axis=-1)
        return np.asarray(np.clip((gap - self.street.side_half_m - 0.01) / 0.38, 0.0, 1.0))

    def rise_m(self, s_m: Float[np.ndarray, "*shape"], d_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Height over the road's surface: the whole street is lower where side streets join."""
        return super().rise_m(s_m, d_m) * self._kerb_share(s_m)

    def open_share(self, s_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """None of it across side streets."""
        return self._kerb_share(s_m)

    def section(self, s_m: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, "k n"], Int[np.ndarray, "k1 n1"]]:
        """Heights and materials: asphalt across side streets."""
        height, material = super().section(s_m)
        open_here = self._kerb_share(s_m) < 0.1
        cells = np.broadcast_to(material, (len(s_m) - 1, material.shape[-1])).copy()
        cells[open_here[:-1] & open_here[1:]] = ASPHALT
        return height, cells


def mark_street(side: Roadside, road: RoadLine, street: Street) -> None:
    """Centre line or lines, lane lines, edges of cycle lanes."""
    offsets = {street.median_m, -street.median_m}
    for offset in sorted(offsets):
        side.run(partial(solid_line, road, offset))
    for sign in (1, -1):
        for lane in range(1, street.lanes):
            side.run(partial(dashed_line, road, sign * (street.median_m + lane * street.lane_m), 3.0, 10.0))
        if street.cycle_m:
            side.run(partial(solid_line, road, sign * street.edge_m))


def zebra(road: RoadLine, street: Street, s_m: float) -> Mesh:
    """A crossing of stripes 3 m long before station ``s_m``."""
    stripes = np.arange(-street.edge_m + 0.4, street.edge_m - 0.4, 1.0)
    corner = np.array([[0, 0], [3, 0], [3, 0.5], [0, 0.5]])
    along = s_m - 4.5 + np.tile(corner[:, 0], (len(stripes), 1))
    raised = road.point_m(along, stripes[:, None] + corner[:, 1]) + np.array([0, 0, 0.012])
    return quads(raised, PAINT)


def signals_of(street: Street, lanes: list[Lane], rng: np.random.Generator) -> list[Signal]:
    """Stop lines of all lanes before the side streets, with one cycle of 30 to 60 s a junction."""
    out: list[Signal] = []
    for junction in street.junctions_m:
        period, shift, red = float(rng.uniform(30, 60)), float(rng.uniform(0, 60)), float(rng.uniform(0.3, 0.5))
        for index, lane in enumerate(lanes):
            line = lane.direction * float(junction) - street.side_half_m - 5.5
            out.append(Signal(index, line, shift, period, red * period))
    return out


def park_kerbside(parking: Parking, street: Street, last_m: float, share: tuple[float, float]) -> None:
    """Rows of vehicles along the kerbs, parallel or at an angle, as world "v3" has them."""
    rng = parking.rng
    for side, index in ((-1, 0), (1, 1)):
        taken, kerb = float(rng.uniform(*share)), float(street.kerb_at_m[index])
        if street.parking_m[index] <= 0:
            continue
        if street.angled[index]:
            turn = float(rng.choice([1.05, np.pi / 2]))
            parking.across(side, kerb, FIRST_M + 60.0, last_m, taken, turn_rad=turn)
        else:
            parking.along(side, kerb, FIRST_M + 60.0, last_m, taken)


def furnish_street(furnishing: Furnishing, street: Street, pitch_m: float) -> None:
    """Furniture between kerbs and those who walk, every ``pitch_m`` on average."""
    for side, index in ((-1, 0), (1, 1)):
        kerb = float(street.kerb_at_m[index])
        furnishing.strip(side, kerb + 0.2, kerb + float(street.strip_m[index]), pitch_m, KERB)


def add_kerbside(population: Population, street: Street, last_m: float, share: tuple[float, float]) -> None:
    """Vehicles along the kerbs, parallel or at an angle."""
    rng = population.rng
    for side, index in ((-1, 0), (1, 1)):
        filled, turn = rng.uniform(*share), float(rng.choice([1.05, 1.57]) * rng.choice([-1, 1]))
        angled = street.angled[index]
        if street.parking_m[index] <= 0:
            continue
        d = side * float(street.kerb_at_m[index] - street.parking_m[index] / 2)
        for s in np.arange(FIRST_M + 60.0, last_m, 3.1 if angled else 6.6):
            if street.clear(float(s), 6.0) and rng.random() < filled:
                straight = 0.0 if (side < 0) != (rng.random() < 0.1) else np.pi
                kind = population.draw_truck() if rng.random() < 0.03 and not angled else None
                station_m = float(s) + float(rng.normal(0, 0.2))
                population.add_parked(station_m, d, turn_rad=turn if angled else straight, kind=kind)


def add_crossers(plot: RoadBuild, population: Population, street: Street, signals: list[Signal], last_m: float) -> None:
    """Vehicles that cross on the side streets (while the street's own signal is red), wait there, or are parked."""
    rng = population.rng
    for number, junction in enumerate(street.junctions_m):
        if not -260 < junction < last_m:
            continue
        per_junction = len(signals) // max(len(street.junctions_m), 1)
        signal = signals[number * per_junction] if signals else None
        for direction in (1, -1):  # towards the left, towards the right
            s = float(junction) + direction * 0.5 * street.side_half_m
            edge = street.edge_m + street.cycle_m + 5.5
            for wait in range(int(rng.choice([0, 1, 2], p=[0.4, 0.4, 0.2]))):
                turn = direction * np.pi / 2
                population.add_parked(s, -direction * (edge + 6.5 * wait), turn_rad=turn)
            for _ in range(int(rng.poisson(plot.duration_s / 15))):
                moment, speed = float(rng.uniform(-8, plot.duration_s)), float(rng.uniform(5, 11))
                if signal is not None:
                    moment += (
                        2.5 - (moment + signal.shift_s) % signal.period_s + float(rng.uniform(0, signal.red_s - 5))
                    )
                start = -direction * speed * moment
                population.add_crossing(population.draw_car(), s, start, direction, speed, delay_s=-1e-3)
            for row in range(6):
                if rng.random() < 0.35:
                    d = direction * (float(street.front_m.max()) + 8 + 6.5 * row)
                    station_m = float(junction) + float(rng.choice([-1, 1])) * (street.side_half_m - 1.2)
                    population.add_parked(station_m, d, turn_rad=float(rng.choice([-1, 1])) * np.pi / 2)


def add_walkers(
    plot: RoadBuild, population: Population, street: Street, last_m: float, people: float, cyclists: float = 2.0
) -> None:
    """People on the pavements and crossings, cyclists, now and then a wheelchair, a pram or a dog.

    Args:
        plot: The sequence.
        population: Takes them.
        street: Where they walk.
        last_m: Where they end, as s.
        people: Mean count of pedestrians over 250 m of street.
        cyclists: Mean count of cyclists over 250 m.
    """
    rng, first, raised = population.rng, -280.0, street.kerb_m
    span = last_m - first
    kinds, shares = ["pedestrian", "child", "wheelchair", "stroller", "animal"], [0.84, 0.07, 0.03, 0.03, 0.03]
    for s in rng.uniform(first, last_m, rng.poisson(people * span / 250)):
        index = int(rng.integers(2))
        side, walk = (-1, 1)[index], float(street.walk_m[index])
        kind, heading = str(rng.choice(kinds, p=shares)), int(rng.choice([-1, 1]))
        speed = 0.0 if rng.random() < 0.2 else float(rng.uniform(0.7, 1.8))
        nearest, furthest = min(0.8, 0.4 * walk), max(walk - 0.4, 0.5 * walk)
        if plot.world == "v3":  # beside the furniture
            nearest = min(float(street.strip_m[index]) + 0.4, furthest)
        d = float(street.kerb_at_m[index]) + float(rng.uniform(nearest, furthest))
        group = int(rng.choice([1, 2, 3], p=[0.7, 0.2, 0.1])) if kind == "pedestrian" else 1
        for mate in range(group):
            station_m = float(s) + 0.3 * mate
            population.add_along(kind, station_m, side * (d + 0.85 * mate), heading, speed, raise_m=raised)
    for s in rng.uniform(first, last_m, rng.poisson(cyclists * span / 250)):
        side = int(rng.choice([-1, 1]))
        if street.cycle_m:
            d, lift = street.edge_m + street.cycle_m / 2, 0.0
        else:  # a shared path on the pavement
            d, lift = float(street.front_m[0 if side < 0 else 1]) - 0.5, raised
        population.add_along("cyclist", float(s), side * d, -side, float(rng.uniform(3.0, 6.5)), raise_m=lift)
    for junction in street.junctions_m:
        for _ in range(int(rng.poisson(people * plot.duration_s / 120)) if -260 < junction < last_m else 0):
            direction = int(rng.choice([-1, 1]))
            s = float(junction) - street.side_half_m - float(rng.uniform(1.8, 4.2))
            start = -direction * (float(street.kerb_at_m[0 if direction > 0 else 1]) - 0.3)
            delay = float(rng.uniform(-8, plot.duration_s))
            population.add_crossing("pedestrian", s, start, direction, float(rng.uniform(0.9, 1.7)), delay_s=delay)
