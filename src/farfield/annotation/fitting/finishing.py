"""From a rectangle to a box: bottom on the ground, top by the points, and the sign of the heading."""

import numpy as np
from jaxtyping import Bool, Float

from farfield.annotation.fitting.anchoring import axes
from farfield.annotation.fitting.contract import Box, HeadingFrom, Prior
from farfield.annotation.fitting.ground import Ground
from farfield.geometry.boxes import wrap_angle_rad

_POINTS_FOR_TOP = 8
_TOP_QUANTILE = 0.98
_LEAST_HEIGHT_M = 0.3


def inside(
    xy_m: Float[np.ndarray, "n 2"], rectangle: Float[np.ndarray, " 5"], margin_m: float = 0.0
) -> Bool[np.ndarray, " n"]:
    """Whether points seen from above lie in a rectangle (x, y, length, width, yaw), shape (n,)."""
    local = (xy_m - rectangle[:2]) @ axes(float(rectangle[4])).T
    return np.asarray((np.abs(local) <= rectangle[2:4] / 2 + margin_m).all(axis=1))


def stood_on(
    rectangle: Float[np.ndarray, " 5"], points_m: Float[np.ndarray, "n 3"], ground: Ground, prior: Prior
) -> Box:
    """A box on the ground under its centre.

    Its top is the 98 % quantile of its points' heights where there are eight or more, and the prior's height otherwise
    or where the size is fixed.

    Args:
        rectangle: x, y, length, width, yaw.
        points_m: The object's points.
        ground: The ground near it.
        prior: What is known of the object.
    """
    x, y, length, width, yaw = rectangle.tolist()
    height = prior.size_m[2]
    if len(points_m) >= _POINTS_FOR_TOP and not prior.fixed_size:
        top = float(np.quantile(ground.heights_m(points_m), _TOP_QUANTILE))
        height = max(top, _LEAST_HEIGHT_M)
    return x, y, ground.z_m(x, y) + height / 2, length, width, height, float(wrap_angle_rad(np.array(yaw)))


def headed(yaw_rad: float, prior: Prior, drawn_rad: float | None = None) -> tuple[float, HeadingFrom]:
    """The yaw or its opposite, by the drag's direction, the track's or the lane's, in this order; else as it is.

    >>> from farfield.annotation.fitting.contract import prior_of
    >>> headed(3.0, prior_of("Sedan"), drawn_rad=0.1)
    (-0.14159265358979312, 'drag')
    """
    known: tuple[tuple[float | None, HeadingFrom], ...] = (
        (drawn_rad, "drag"),
        (prior.yaw_rad, "track"),
        (prior.lane_rad, "lane"),
    )
    for direction, source in known:
        if direction is not None:
            return (yaw_rad if np.cos(yaw_rad - direction) >= 0 else yaw_rad - np.pi), source
    return yaw_rad, "ask"
