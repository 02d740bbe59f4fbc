"""Vehicles that stand in rows, bumper to bumper: along kerbs, at an angle, on lots.

Shares follow nuScenes' attributes by class, as OpenPCDet counts them (pcdet/datasets/nuscenes/nuscenes_utils.py): of
419,826 parked vehicles 79 % are cars, 17 % trucks, buses and construction vehicles, pickups among them, 5 % trailers;
8,326 motorcycles and scooters stand without a rider. Pickups and vans come with the prior of the cars; with the prior
"us" some 3 % of large vehicles beside them make 14 % with the pickups.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.actors import draw_car, draw_size_m, draw_truck
from farfield.simulation.world.land import Land
from farfield.simulation.world.population import Population

LARGE_SHARE, TRAILER_SHARE, MOTORCYCLE_SHARE = 0.09, 0.05, 0.02  # drawn; of wide ones some yield to traffic
_TILT_RAD, _MOST_TILT_RAD = 0.035, 0.09
_STALL_M, _DEPTH_M = 2.6, 5.2


def _draw_kind(population: Population, rng: np.random.Generator, *, large: bool) -> str:
    draw = float(rng.random())
    if draw < MOTORCYCLE_SHARE:
        return "motorcycle"
    if large and draw < MOTORCYCLE_SHARE + TRAILER_SHARE:
        return "trailer"
    if large and draw < MOTORCYCLE_SHARE + TRAILER_SHARE + LARGE_SHARE:
        return draw_truck(rng, long_haul=False, prior=population.sizes)
    return draw_car(rng, population.sizes)


def _tilt_rad(rng: np.random.Generator, length_m: float = 4.5) -> float:
    """By how much a vehicle stands askew: its ends lie as far aside whether it is short or long."""
    tilt = float(np.clip(rng.normal(0.0, _TILT_RAD), -_MOST_TILT_RAD, _MOST_TILT_RAD))
    return tilt * min(1.0, 4.5 / length_m)


class Parking:
    """Parks vehicles beside one road.

    Args:
        population: Takes them; those that would touch others or furniture disappear.
        land: The ground they stand on.
        rng: Draws them.
        clear: Whether a station is further than so many metres from every side street.
    """

    def __init__(
        self,
        population: Population,
        land: Land,
        rng: np.random.Generator,
        clear: Callable[[float, float], bool],
    ) -> None:
        self.population, self.land, self.rng, self.clear = population, land, rng, clear

    def along(self, side: int, kerb_m: float, first_m: float, last_m: float, share: float) -> None:
        """A row along a kerb: gaps of half a metre to two, now and then a vehicle's length.

        Args:
            side: 1 left of the reference line, -1 right.
            kerb_m: Distance of the kerb from the line; the row stands on the road's side of it.
            first_m: Where it begins, as s.
            last_m: Where it ends.
            share: Share of the vehicles that are there.
        """
        rng, s = self.rng, first_m + float(self.rng.uniform(0.0, 4.0))
        while s < last_m:
            kind = _draw_kind(self.population, rng, large=True)
            size = draw_size_m(kind, rng, self.population.sizes)
            middle, gap = s + float(size[0]) / 2, 0.5 + min(float(rng.exponential(0.5)), 2.0)
            s += float(size[0]) + gap
            if rng.random() < share and self.clear(middle, float(size[0]) / 2 + 3.0):
                onward = (side < 0) != (rng.random() < 0.1)
                turn = (0.0 if onward else np.pi) + _tilt_rad(rng, float(size[0]))
                gap_m = float(rng.uniform(0.08, 0.3)) if size[1] < 2.2 else 0.03
                d = side * (kerb_m - gap_m - float(size[1]) / 2)
                self.stand(kind, size, middle, d, turn)

    def across(
        self, side: int, edge_m: float, first_m: float, last_m: float, share: float, *, turn_rad: float = np.pi / 2
    ) -> None:
        """A row of stalls at an angle to the road.

        Args:
            side: 1 left of the reference line, -1 right.
            edge_m: Distance of the stalls' far ends from the line.
            first_m: Where it begins, as s.
            last_m: Where it ends.
            share: Share of the stalls that are taken.
            turn_rad: Angle of the stalls against the road, above 0 to a right angle.
        """
        pitch = _STALL_M / float(np.sin(turn_rad))
        middles = np.arange(first_m + pitch / 2, last_m - pitch / 2 + 0.01, pitch)
        self.stalls(side * (edge_m - _DEPTH_M / 2), side, middles, _DEPTH_M, share, turn_rad=turn_rad)

    def stalls(
        self,
        d_m: float,
        side: int,
        stations_m: Float[np.ndarray, " n"],
        depth_m: float,
        share: float,
        *,
        turn_rad: float = np.pi / 2,
    ) -> None:
        """Fill some of the stalls of a row, most nose in.

        Args:
            d_m: Offset of the row's middle to the left of the reference line.
            side: 1 where the stalls' far ends lie to the left, -1 to the right.
            stations_m: Stations of the stalls' middles.
            depth_m: Depth of the row.
            share: Share of the stalls that are taken.
            turn_rad: Angle of the stalls against the road, above 0 to a right angle.
        """
        rng, nose_in = self.rng, 0.75 if np.pi / 2 - turn_rad < 0.01 else 0.95
        nose = np.pi - turn_rad if side > 0 else -turn_rad  # as one turns in from one's own side
        for s in stations_m:
            if rng.random() < share and self.clear(float(s), 3.0):
                kind = _draw_kind(self.population, rng, large=False)
                size = draw_size_m(kind, rng, self.population.sizes)
                turn = nose + (0.0 if rng.random() < nose_in else np.pi) + _tilt_rad(rng)
                deep = abs(np.sin(turn)) * float(size[0]) + abs(np.cos(turn)) * float(size[1])
                d = d_m + side * (depth_m / 2 - deep / 2 - float(rng.uniform(0.1, 0.6)))
                self.stand(kind, size, float(s) + float(np.clip(rng.normal(0.0, 0.06), -0.12, 0.12)), d, turn)

    def stand(self, kind: str, size_m: np.ndarray, s_m: float, d_m: float, turn_rad: float) -> None:
        """One vehicle on the ground at (s, d), turned against the road."""
        s, d = np.array(s_m), np.array(d_m)
        position = self.land.road.point_m(s, d)
        position[2] += float(self.land.rise_m(s[None], d[None])[0])
        heading = float(self.land.road.heading_rad(s)) + turn_rad
        self.population.add(kind, position, heading, s_m, size_m=size_m)
