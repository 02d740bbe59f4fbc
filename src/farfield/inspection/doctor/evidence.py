"""Which reading of the boxes do the points support?

Every convention that data sets get wrong (order of sizes, unit and sign of the heading, centre or bottom, axes) is a
reading: the same boxes, changed. Changed boxes have the same volume, so the reading that holds more points of objects
is the better one. Each box votes; a reading replaces the one of the file only by a clear majority.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from farfield.frame import Boxes
from farfield.geometry.points import BOX_MARGIN_M
from farfield.geometry.poses import pose_from_yaw
from farfield.inspection.doctor.ground import above_ground

_MIN_POINTS = 4
_MIN_VOTES = 4
_MAJORITY = 0.75
_LEAST_HELD = 0.25  # changes after which fewer boxes hold points explain nothing
_TURNS_DEG = tuple(range(15, 180, 15))


@dataclass(frozen=True)
class BoxConvention:
    """One way to read the boxes: a name, and the change to what was read."""

    name: str
    change: Callable[[Boxes], Boxes]


@dataclass(frozen=True)
class ConventionVotes:
    """How the boxes vote between the file's reading and another one.

    Args:
        name: The other reading.
        votes_for: Boxes that hold clearly more points in the other reading.
        votes_against: Boxes that hold clearly more points as read.
        gain: Mean gain of points held, as a share of each box's better count; above 0 speaks for the other reading.
    """

    name: str
    votes_for: int
    votes_against: int
    gain: float

    @property
    def wins(self) -> bool:
        """Whether the points clearly support the other reading."""
        votes = self.votes_for + self.votes_against
        return self.votes_for >= _MIN_VOTES and self.votes_for >= _MAJORITY * votes and self.gain > 0

    @property
    def loses(self) -> bool:
        """Whether the points clearly support the file's reading."""
        votes = self.votes_for + self.votes_against
        return self.votes_against >= _MIN_VOTES and self.votes_against >= _MAJORITY * votes and self.gain < 0


def _resized(order: tuple[int, ...]) -> Callable[[Boxes], Boxes]:
    return lambda boxes: boxes.replace(size_m=boxes.size_m[:, list(order)])


def _raised(share: float) -> Callable[[Boxes], Boxes]:
    return lambda boxes: boxes.replace(centre_m=boxes.centre_m + boxes.size_m * [0.0, 0.0, share])


def _moved_round(deg: float | int) -> Callable[[Boxes], Boxes]:
    return lambda boxes: boxes.transform(pose_from_yaw(float(np.deg2rad(deg))))


def _turned(deg: float | int) -> Callable[[Boxes], Boxes]:
    return lambda boxes: boxes.replace(yaw_rad=boxes.yaw_rad + np.deg2rad(deg))


SIZE_READINGS = {f"size {''.join(map(str, order))}": order for order in permutations(range(3)) if order != (0, 1, 2)}

READINGS: tuple[BoxConvention, ...] = (
    *(BoxConvention(name, _resized(order)) for name, order in SIZE_READINGS.items()),
    BoxConvention("yaw x 180/pi", lambda boxes: boxes.replace(yaw_rad=boxes.yaw_rad * 180 / np.pi)),
    BoxConvention("yaw x pi/180", lambda boxes: boxes.replace(yaw_rad=boxes.yaw_rad * np.pi / 180)),
    BoxConvention("yaw clockwise", lambda boxes: boxes.replace(yaw_rad=-boxes.yaw_rad)),
    BoxConvention("yaw clockwise from y", lambda boxes: boxes.replace(yaw_rad=np.pi / 2 - boxes.yaw_rad)),
    BoxConvention("raised by h/2", _raised(0.5)),
    BoxConvention("lowered by h/2", _raised(-0.5)),
    BoxConvention("mirrored in y", lambda b: b.replace(centre_m=b.centre_m * [1.0, -1.0, 1.0], yaw_rad=-b.yaw_rad)),
    *(BoxConvention(f"turned by {deg}", _moved_round(deg)) for deg in (90, 180, 270)),
    BoxConvention(
        "camera axes", lambda boxes: boxes.replace(centre_m=boxes.centre_m[:, [2, 0, 1]] * [1.0, -1.0, -1.0])
    ),
)
HEADINGS: tuple[BoxConvention, ...] = tuple(BoxConvention(f"heading {deg}", _turned(deg)) for deg in _TURNS_DEG)


def count_points(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes, readings: Sequence[BoxConvention]
) -> Int[np.ndarray, "m readings"]:
    """Count the object points in every box under the file's reading (column 0) and each other one.

    Args:
        points_m: The whole cloud; ground returns are left out.
        boxes: m boxes as read.
        readings: Other readings.

    Returns:
        Counts, shape (m, 1 + len(readings)).
    """
    sets = [boxes, *(reading.change(boxes) for reading in readings)]
    if len(boxes) == 0 or len(points_m) == 0:
        return np.zeros((len(boxes), len(sets)), dtype=np.int64)
    points = points_m[above_ground(points_m)]
    radius = float(np.linalg.norm(boxes.size_m, axis=1).max()) / 2 + 2 * BOX_MARGIN_M
    centres = np.unique(np.concatenate([some.centre_m for some in sets]).round(3), axis=0)
    nearest, _ = cKDTree(centres).query(points, distance_upper_bound=radius)
    points = points[np.isfinite(nearest)]
    if len(points) == 0:
        return np.zeros((len(boxes), len(sets)), dtype=np.int64)
    return _count(points, Boxes.concatenate(sets)).reshape(len(sets), len(boxes)).T


def _count(points_m: Float[np.ndarray, "n 3"], boxes: Boxes) -> Int[np.ndarray, " m"]:
    """Points inside each of many boxes, all pairs of a box and a point near it at once."""
    reach = np.hypot(*(boxes.size_m[:, :2].T / 2 + BOX_MARGIN_M))
    near = cKDTree(points_m[:, :2]).query_ball_point(boxes.centre_m[:, :2], reach, return_sorted=False)
    owner = np.repeat(np.arange(len(boxes)), [len(indices) for indices in near])
    if len(owner) == 0:
        return np.zeros(len(boxes), dtype=np.int64)
    offset = points_m[np.concatenate(near).astype(np.intp)] - boxes.centre_m[owner]
    cos, sin = np.cos(boxes.yaw_rad)[owner], np.sin(boxes.yaw_rad)[owner]
    x, y = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
    half = boxes.size_m[owner] / 2 + BOX_MARGIN_M
    inside = (np.abs(x) <= half[:, 0]) & (np.abs(y) <= half[:, 1]) & (np.abs(offset[:, 2]) <= half[:, 2])
    return np.bincount(owner[inside], minlength=len(boxes))


def convention_votes(counts: Int[np.ndarray, "m k"], readings: Sequence[BoxConvention]) -> list[ConventionVotes]:
    """Let the boxes vote on every reading.

    Args:
        counts: What :func:`count_points` gave, over all boxes of all frames.
        readings: The other readings, in the order of the columns.
    """
    return [_vote(reading.name, counts[:, 0], counts[:, 1 + k]) for k, reading in enumerate(readings)]


def _vote(name: str, base: Int[np.ndarray, " m"], other: Int[np.ndarray, " m"]) -> ConventionVotes:
    best = np.maximum(base, other)
    valid = best >= _MIN_POINTS
    clear = _clearly_apart(base, other) & valid
    gain = ((other - base) / np.maximum(best, 1))[valid]
    return ConventionVotes(
        name,
        int((clear & (other > base)).sum()),
        int((clear & (other < base)).sum()),
        float(gain.mean()) if len(gain) else 0.0,
    )


def _clearly_apart(a: Int[np.ndarray, " m"], b: Int[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    return np.abs(a - b) >= np.maximum(2.0, 0.2 * np.maximum(a, b))


def misfit_share(counts: Int[np.ndarray, "m k"], size_m: Float[np.ndarray, "m 3"]) -> tuple[float, int]:
    """Share of elongated boxes with points that some heading, at least 30 degrees off, fits much better.

    Args:
        counts: Columns as read and for each of :data:`HEADINGS`.
        size_m: Sizes of the boxes.

    Returns:
        The share, and the number of boxes it rests on.
    """
    far_off = [k for k, deg in enumerate(_TURNS_DEG) if 30 <= deg <= 150]
    best = counts[:, 1:][:, far_off].max(axis=1)
    long, short = size_m[:, :2].max(axis=1), size_m[:, :2].min(axis=1)
    valid = (np.maximum(best, counts[:, 0]) >= 10) & (long > 1.5 * short)
    if not valid.any():
        return 0.0, 0
    return float((best > 1.4 * counts[:, 0])[valid].mean()), int(valid.sum())


def misfit_is_clear(share: float, boxes: int, *, expected: float = 0.4) -> bool:
    """Whether more boxes misfit than ``expected``, by the lower end of Wilson's 95 % interval (Wilson 1927).

    Args:
        share: Share of boxes that another heading fits much better.
        boxes: Number of boxes it rests on.
        expected: Share that sound data may reach: partly seen and crowded objects misfit too.
    """
    if boxes < 8:
        return False
    z2 = 1.96**2
    centre = share + z2 / (2 * boxes)
    spread = 1.96 * math.sqrt(share * (1 - share) / boxes + z2 / (4 * boxes**2))
    return (centre - spread) / (1 + z2 / boxes) > expected


def supported_changes(
    points: Sequence[Float[np.ndarray, "_ 3"]], boxes: Sequence[Boxes]
) -> list[tuple[ConventionVotes, BoxConvention]]:
    """Find the changes that the points support, the most helpful first, each on top of those before.

    Args:
        points: Cloud of each frame.
        boxes: Boxes of each frame as read.

    Returns:
        Winning ballots and their readings; empty where the points support the file's reading.
    """
    changes: list[tuple[ConventionVotes, BoxConvention]] = []
    current = list(boxes)
    for _ in range(3):
        counts = np.concatenate([count_points(p, b, READINGS) for p, b in zip(points, current, strict=True)])
        winners = [
            (ballot, reading)
            for ballot, reading in zip(convention_votes(counts, READINGS), READINGS, strict=True)
            if ballot.wins
        ]
        if not winners:
            break
        winner = max(winners, key=lambda pair: pair[0].gain)
        changes.append(winner)
        current = [winner[1].change(b) for b in current]
    return changes if changes and held_share(points, current) >= _LEAST_HELD else []


def held_share(points: Sequence[Float[np.ndarray, "_ 3"]], boxes: Sequence[Boxes]) -> float:
    """Share of boxes, nearer than 70 m if there are some, that hold at least one object point."""
    held = np.concatenate([count_points(p, b, ())[:, 0] > 0 for p, b in zip(points, boxes, strict=True)])
    near = np.concatenate([b.range_m < 70.0 for b in boxes])
    return float((held[near] if near.any() else held).mean()) if len(held) else 0.0
