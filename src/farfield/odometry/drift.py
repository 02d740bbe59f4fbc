"""How far a track of poses drifts, from a second one: the same sweeps placed backwards.

Placed backwards, every sweep is fitted to a map that was made from other sweeps, so the two tracks err apart. If they
err alike in size and independently, the difference of the motions that they give over a stretch is sqrt(2) times the
error of either. What both share is not seen: ranges that are all too long, a sensor that is tilted, points without
times, traffic that moves along.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from farfield.geometry.poses import logarithm

STRETCH_M = 100.0
_LEAST_M = 10.0
_STARTS_M = 10.0


@dataclass(frozen=True)
class Drift:
    """Expected error of the motion over a stretch: root mean square over the stretches of a drive.

    Args:
        stretch_m: Length of the stretches.
        place_m: Error of the place at their end.
        turn_deg: Error of the direction.
        stretches: How many there were.
    """

    stretch_m: float
    place_m: float
    turn_deg: float
    stretches: int

    @property
    def place_percent(self) -> float:
        """Error of the place in per cent of the way."""
        return 100 * self.place_m / self.stretch_m

    @property
    def turn_deg_per_100m(self) -> float:
        """Error of the direction in degrees per 100 m."""
        return 100 * self.turn_deg / self.stretch_m


def way_m(poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, " n"]:
    """How far the sensor has come at each pose."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([np.zeros(min(len(poses), 1)), np.cumsum(steps)])


def differences(
    poses: Float[np.ndarray, "n 4 4"],
    others: Float[np.ndarray, "n 4 4"],
    *,
    breaks: Bool[np.ndarray, " n"] | None = None,
    stretch_m: float = STRETCH_M,
) -> tuple[float, Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """How differently two tracks tell the motion over stretches that begin every 10 m.

    Args:
        poses: One track.
        others: The other, of the same sweeps.
        breaks: Sweeps before which a motion is not known: no stretch goes over one.
        stretch_m: Length of a stretch; a shorter drive is one stretch.

    Returns:
        The stretches' length, and of each the differences of place in metres and of direction in degrees; none where
        the drive is shorter than 10 m.
    """
    way = way_m(poses)
    length = min(stretch_m, float(way[-1])) if len(way) else 0.0
    if length < _LEAST_M:
        return length, np.zeros(0), np.zeros(0)
    starts = np.unique(np.searchsorted(way, np.arange(0, way[-1] - length + 1e-6, _STARTS_M)))
    ends = np.minimum(np.searchsorted(way, way[starts] + length - 1e-6), len(way) - 1)
    if breaks is not None:
        piece = np.cumsum(breaks)
        unbroken = piece[starts] == piece[ends]
        starts, ends = starts[unbroken], ends[unbroken]
    own, other = (np.linalg.inv(track[starts]) @ track[ends] for track in (poses, others))
    difference = np.linalg.inv(own) @ other
    turn = np.degrees(np.linalg.norm(logarithm(difference)[:, :3], axis=1))
    return length, np.linalg.norm(difference[:, :3, 3], axis=1), turn


def drift_of(
    forward: Float[np.ndarray, "n 4 4"],
    backward: Float[np.ndarray, "n 4 4"],
    breaks: Bool[np.ndarray, " n"],
) -> Drift | None:
    """The drift that two tracks of the same sweeps, placed in either direction, let expect of each.

    Args:
        forward: Poses of the sweeps.
        backward: Poses of the same, in the same order, found backwards.
        breaks: Sweeps before which a motion is not known, in either.

    Returns:
        None where the drive is shorter than 10 m.
    """
    length, position_error, turn_error = differences(forward, backward, breaks=breaks)
    if not len(position_error):
        return None
    place_m, turn_deg = (float(np.sqrt((values**2).mean() / 2)) for values in (position_error, turn_error))
    return Drift(length, place_m, turn_deg, len(position_error))
