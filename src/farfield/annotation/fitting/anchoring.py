"""From the stretch that points cover along a box's axes to the whole box: the prior's size, put where it belongs."""

import numpy as np
from jaxtyping import Float

from farfield.annotation.fitting.contract import Prior

_LEAST_M = 0.1
_POINTS_ACROSS, _WHOLE = 100, 0.8


def axes(yaw_rad: float) -> Float[np.ndarray, "2 2"]:
    """Unit vectors along and across a heading, one a row."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[cos, sin], [-sin, cos]])


def footprint(xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, prior: Prior) -> Float[np.ndarray, " 5"]:
    """The rectangle of an object at a yaw: x, y, length, width, yaw.

    Its size is the larger of the prior's and the measured one along each axis. Along an axis on which all points lie to
    one side of the sensor, the face towards the sensor stays and the box grows away from it; otherwise, and for all
    that is not anchored, it grows about the middle of the points. So it does across where 100 points cover most of
    the width: both sides were seen then, and only mirrors are missing.

    Args:
        xy_m: The object's points seen from above, at least one.
        yaw_rad: The heading.
        prior: Size, and whether it is anchored.
    """
    turn, ego = axes(yaw_rad), np.array(prior.ego_m)
    along = (xy_m - ego) @ turn.T
    low, high = along.min(axis=0), along.max(axis=0)
    size, centre = _sizes(high - low, prior), (low + high) / 2
    if prior.anchored:
        anchored = np.where(low > 0, low + size / 2, np.where(high < 0, high - size / 2, centre))
        across = len(xy_m) >= _POINTS_ACROSS and high[1] - low[1] >= _WHOLE * prior.size_m[1]
        centre = np.where([False, across], centre, anchored)
    x, y = centre @ turn + ego
    return np.array([x, y, *size, yaw_rad])


def _sizes(measured: Float[np.ndarray, " 2"], prior: Prior) -> Float[np.ndarray, " 2"]:
    wanted = np.array(prior.size_m[:2])
    if prior.fixed_size:
        return wanted
    return np.maximum(measured, wanted if prior.grows else _LEAST_M)


def excess_m(xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, prior: Prior) -> float:
    """By how much the points reach beyond the prior's length and width at a yaw: tells a length from a width."""
    along = xy_m @ axes(yaw_rad).T
    return float(np.maximum(np.ptp(along, axis=0) - np.array(prior.size_m[:2]), 0).sum())


def along_length(xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, prior: Prior) -> float:
    """The yaw or the one a quarter turn from it: where the prior is exceeded less, else along the longer side."""
    turned = yaw_rad + np.pi / 2
    excess = excess_m(xy_m, yaw_rad, prior), excess_m(xy_m, turned, prior)
    if abs(excess[0] - excess[1]) > 1e-9:
        return yaw_rad if excess[0] < excess[1] else turned
    length, width = np.ptp(xy_m @ axes(yaw_rad).T, axis=0)
    return yaw_rad if length >= width else turned
