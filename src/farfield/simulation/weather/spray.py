"""Spray: the plumes of water that fast vehicles throw up behind them on a wet road."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import erf

from farfield.simulation.weather.conditions import Weather

_LEAST_WATER_MM = 0.3
_LEAST_SPEED_M_S, _FULL_SPEED_M_S = 15.0, 35.0
_LENGTH_M = (5.0, 20.0)
_EXTINCTION_PER_M = (0.01, 0.05)
WHEELED = frozenset({"vehicle", "large_vehicle", "trailer", "motorcycle"})


@dataclass(frozen=True)
class Plume:
    """A cloud of drops whose extinction falls off as a Gaussian.

    Args:
        middle_m: Its middle in the world.
        yaw_rad: Heading of the vehicle.
        spread_m: Standard deviations along the road, across it and upwards.
        extinction_per_m: Extinction in its middle.
    """

    middle_m: tuple[float, float, float]
    yaw_rad: float
    spread_m: tuple[float, float, float]
    extinction_per_m: float

    def depth(
        self,
        start_m: Float[np.ndarray, " 3"],
        directions: Float[np.ndarray, "n 3"],
        range_m: Float[np.ndarray, " n"],
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """What rays meet of the plume up to a distance.

        Args:
            start_m: Where the rays start, in the world.
            directions: Unit directions in the world.
            range_m: How far each goes; inf is allowed.

        Returns:
            Optical depth (the integral of the extinction, in closed form), the distance at which the ray meets the
            densest part, and the extinction there.
        """
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        to_plume = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) / np.array(self.spread_m)[:, None]
        offset = to_plume @ (start_m - np.array(self.middle_m))
        along = directions @ to_plume.T
        a, b, c = (along**2).sum(axis=1), along @ offset, float(offset @ offset)
        densest = np.maximum(-b / a, 0.0)
        peak = self.extinction_per_m * np.exp(-0.5 * (c - b**2 / a))
        root = np.sqrt(a / 2)
        depth = peak * np.sqrt(np.pi / (2 * a)) * (erf(root * (range_m + b / a)) - erf(root * b / a))
        density = self.extinction_per_m * np.exp(-0.5 * (a * densest**2 + 2 * b * densest + c))
        return depth, densest, density


def plumes(
    weather: Weather,
    bottom_m: Float[np.ndarray, "n 3"],
    yaw_rad: Float[np.ndarray, " n"],
    velocity_m_s: Float[np.ndarray, "n 3"],
    size_m: Float[np.ndarray, "n 3"],
    label: Sequence[str],
) -> list[Plume]:
    """The plumes behind all vehicles faster than 15 m/s, where there is water on the road.

    Args:
        weather: Gives the depth of the water.
        bottom_m: Middles of the vehicles' bottoms in the world.
        yaw_rad: Their headings.
        velocity_m_s: Their velocities.
        size_m: Their lengths, widths and heights.
        label: Their classes.
    """
    if weather.water_mm < _LEAST_WATER_MM:
        return []
    speed = np.linalg.norm(velocity_m_s[:, :2], axis=1)
    wheeled = np.array([name in WHEELED for name in label], dtype=bool)
    plumes_behind = []
    for row in np.flatnonzero((speed > _LEAST_SPEED_M_S) & wheeled):
        vigour = min((speed[row] - _LEAST_SPEED_M_S) / (_FULL_SPEED_M_S - _LEAST_SPEED_M_S), 1.0)
        vigour *= min(weather.water_mm, 1.0)
        length = _LENGTH_M[0] + vigour * (_LENGTH_M[1] - _LENGTH_M[0])
        forward = np.array([np.cos(yaw_rad[row]), np.sin(yaw_rad[row]), 0.0])
        height = 0.4 * float(size_m[row, 2])
        middle = bottom_m[row] - forward * (size_m[row, 0] / 2 + length / 2) + np.array([0.0, 0.0, height])
        spread = (float(length) / 4, 0.5 * float(size_m[row, 1]), height)
        extinction = _EXTINCTION_PER_M[0] + vigour * (_EXTINCTION_PER_M[1] - _EXTINCTION_PER_M[0])
        middle_m = (float(middle[0]), float(middle[1]), float(middle[2]))
        plumes_behind.append(Plume(middle_m, float(yaw_rad[row]), spread, float(extinction)))
    return plumes_behind
