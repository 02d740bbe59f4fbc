"""Yaw angles as single numbers: wrapped, and compared by the shorter way round."""

import math


def wrapped(yaw_rad: float) -> float:
    """A yaw in [-pi, pi); one that lies there keeps every bit.

    >>> wrapped(3 * math.pi / 2) == -math.pi / 2
    True
    """
    if -math.pi <= yaw_rad < math.pi:
        return yaw_rad
    turned = (yaw_rad + math.pi) % (2 * math.pi) - math.pi
    return turned if turned < math.pi else -math.pi


def turn(before_rad: float, after_rad: float) -> float:
    """How far a heading turns from one to another, the shorter way, in [-pi, pi).

    >>> round(turn(3.0, -3.0), 3)
    0.283
    """
    return wrapped(after_rad - before_rad)
