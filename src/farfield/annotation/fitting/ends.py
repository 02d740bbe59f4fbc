"""Where an object begins and ends along its axes, from three kinds of evidence.

Points that were hit say that the object reaches at least so far. Rays that went past at the height of its body, and
ended behind it, say that it reaches no farther. An end with both is known, whichever side of it looks at the sensor;
one without rays beyond it is hidden, by the object itself or by what stands in front: there the usual size decides.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from farfield.annotation.fitting.ground import Ground
from farfield.annotation.fitting.prior import Prior, axes, footprint

_LOW_M, _HIGH_M = 0.3, 0.8  # over the ground: above the sills, below the bonnet
_SHORT_M = 0.15  # a ray is free up to so much before its end
_INNER_M = 0.4  # bodies are rounded: so much of the sides is left out
_CORNER_M, _THIN_M = 0.2, 0.4
_SECTOR_M = 3.0  # beside the object, what rays are looked at
_WITHIN_M = 0.1  # a ray that begins so much inside the outermost point still passes it
_PASSED, _SHARE = 8, 0.15
_RAY_STEP_M = 0.15


@dataclass(frozen=True, eq=False, kw_only=True)
class Ends:
    """How far an object was seen along its two axes, from the sensor, and how far beyond that rays passed.

    Args:
        hit_m: Lowest and highest coordinate of its points along each axis, shape (2, 2): axis, end.
        gap_m: From there to the nearest ray that passed beyond, shape (2, 2); infinite where none did.
    """

    hit_m: Float[np.ndarray, "2 2"]
    gap_m: Float[np.ndarray, "2 2"]


def ends_of(
    points_m: Float[np.ndarray, "n 3"],
    object_m: Float[np.ndarray, "k 3"],
    rectangle: Float[np.ndarray, " 5"],
    ground: Ground,
    prior: Prior,
) -> Ends:
    """What hits and passing rays say of an object's ends.

    Args:
        points_m: All points of the frame.
        object_m: The object's own, at least one.
        rectangle: About where it is: x, y, length, width, yaw.
        ground: The ground about it.
        prior: Where the sensor stands.
    """
    turn, ego = axes(float(rectangle[4])), np.array([*prior.ego_m, prior.ego_z_m or 0.0])
    own = (object_m[:, :2] - ego[:2]) @ turn.T
    hit = np.stack([own.min(axis=0), own.max(axis=0)], axis=1)
    middle = turn @ (rectangle[:2] - ego[:2])
    half = rectangle[2:4] / 2
    if prior.ego_z_m is None:
        return Ends(hit_m=hit, gap_m=np.full((2, 2), np.inf))
    ends, drop = _rays(points_m, ego, rectangle, turn)
    low, high = _at_body(ends, drop, ego[2] - ground.z_m(float(rectangle[0]), float(rectangle[1])))
    gap = np.full((2, 2), np.inf)
    inner = max(half[1] - _INNER_M, _THIN_M / 2)
    bands = ((middle[1] - inner, middle[1] + inner), _lengthwise(hit[0]))
    for axis, band in enumerate(bands):
        first, last = _between(np.zeros(len(ends)), ends[:, 1 - axis], *band)
        first, last = np.maximum(first, low), np.minimum(last, high)
        free = first < last
        stretch = np.sort(np.stack([first, last])[:, free] * ends[free, axis], axis=0)
        gap[axis] = _gaps(stretch, hit[axis])
    return Ends(hit_m=hit, gap_m=gap)


def passing_rays(
    points_m: Float[np.ndarray, "n 3"], rectangle: Float[np.ndarray, " 5"], ground: Ground, prior: Prior
) -> Float[np.ndarray, "m 2 2"]:
    """Stretches near an object along which rays passed at the height of its body, shape (m, 2, 2): start and end.

    Of the rays of one direction (0.15 m at the object's range) the longest stretch is taken; none where the sensor's
    height is not certain.

    Args:
        points_m: All points of the frame.
        rectangle: About where the object is, and how large at most: x, y, length, width, yaw.
        ground: The ground about it.
        prior: Where the sensor stands.
    """
    if prior.ego_z_m is None:
        return np.zeros((0, 2, 2))
    ego = np.array([*prior.ego_m, prior.ego_z_m])
    ends, drop = _rays(points_m, ego, rectangle, np.eye(2))
    low, high = _at_body(ends, drop, ego[2] - ground.z_m(float(rectangle[0]), float(rectangle[1])))
    range_m, reach_m = float(np.hypot(*(rectangle[:2] - ego[:2]))), float(np.hypot(*rectangle[2:4]))
    length_m = np.maximum(np.hypot(*ends.T), _SHORT_M)
    low, high = np.maximum(low, (range_m - reach_m) / length_m), np.minimum(high, (range_m + reach_m) / length_m)
    free = high > low
    ends, low, high = ends[free], low[free], high[free]
    direction = np.floor(np.arctan2(ends[:, 1], ends[:, 0]) * range_m / _RAY_STEP_M)
    order = np.lexsort((-(high - low) * length_m[free], direction))
    longest = order[np.flatnonzero(np.diff(direction[order], prepend=-np.inf))]
    return ego[:2] + np.stack([ends * low[:, None], ends * high[:, None]], axis=1)[longest]


def _at_body(
    ends_m: Float[np.ndarray, "m 2"], drop_m: Float[np.ndarray, " m"], height_m: float
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """For which parts of their way rays are at the height of a body, and not yet at their end."""
    low, high = _between(np.full(len(drop_m), height_m), drop_m, _LOW_M, _HIGH_M)
    high = np.minimum(high, 1 - _SHORT_M / np.maximum(np.hypot(*ends_m.T), _SHORT_M))
    return np.maximum(low, 0.0), high


def _lengthwise(hit_m: Float[np.ndarray, " 2"]) -> tuple[float, float]:
    """Where along an object it was seen, without its corners: other rays say nothing of its sides."""
    low, high = float(hit_m[0]) + _CORNER_M, float(hit_m[1]) - _CORNER_M
    if high - low >= _THIN_M:
        return low, high
    if hit_m[1] < 0:  # seen from ahead: the body goes on away from the sensor
        return min(low, high) - _THIN_M, max(low, high)
    return min(low, high), max(low, high) + _THIN_M


def _gaps(stretch_m: Float[np.ndarray, "2 m"], hit_m: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"]:
    """From the outermost points to the second nearest free stretch beyond; none where rays pass through the middle."""
    low, high = stretch_m
    tolerance = min(_WITHIN_M, float(hit_m[1] - hit_m[0]) / 4)
    before, beyond = high <= hit_m[0] + tolerance, low >= hit_m[1] - tolerance
    through = int((~before & ~beyond).sum())
    if through > _PASSED and through > _SHARE * len(low):
        return np.full(2, np.inf)
    gap_m = np.full(2, np.inf)
    if before.sum() > 1:
        gap_m[0] = hit_m[0] - np.partition(high[before], -2)[-2]
    if beyond.sum() > 1:
        gap_m[1] = np.partition(low[beyond], 1)[1] - hit_m[1]
    return np.maximum(gap_m, 0.0)


def _rays(
    points_m: Float[np.ndarray, "n 3"],
    ego_m: Float[np.ndarray, " 3"],
    rectangle: Float[np.ndarray, " 5"],
    turn: Float[np.ndarray, "2 2"],
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """Ends of the rays towards an object along its axes, from the sensor, and how far each rises."""
    away = rectangle[:2] - ego_m[:2]
    range_m = max(float(np.hypot(*away)), 1e-6)
    sight = away / range_m
    x, y = points_m[:, 0] - ego_m[0], points_m[:, 1] - ego_m[1]
    deep, beside = x * sight[0] + y * sight[1], np.abs(y * sight[0] - x * sight[1])
    radius_m = float(np.hypot(*rectangle[2:4])) / 2
    near = np.flatnonzero(
        (deep > range_m - radius_m - 1.0) & (beside < (radius_m + _SECTOR_M) * np.maximum(deep / range_m, 1))
    )
    chosen = points_m[near].astype(np.float64)
    chosen = chosen[np.isfinite(chosen).all(axis=1)] - ego_m
    return chosen[:, :2] @ turn.T, chosen[:, 2]


def _between(
    start: Float[np.ndarray, " m"], step: Float[np.ndarray, " m"], low: float, high: float
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """For which parts of their way rays lie between two values."""
    safe = np.where(np.abs(step) < 1e-9, 1e-9, step)
    both = np.sort(np.stack([(low - start) / safe, (high - start) / safe]), axis=0)
    return both[0], both[1]


# The box's stretch along each axis

_SPREAD = (0.08, 0.08)  # of lengths and widths within a class, as parts of the usual one
_FIXED_SPREAD_M = 0.03
_CERTAIN = 3.0  # spreads beyond which rays that pass contradict the size: then they are not believed
_PASSED_M = 0.2  # bodies are rounded, and mirrors stand out: a box reaches so far (one sigma) into what rays passed
_SEEN_M, _FACE_M = 0.5, 0.02  # an end of the length with a ray so near is seen: its points lie on its face
_NEAR_FACE_M = 0.3  # how far behind the face towards the sensor its first point lies where no ray tells
_STEPS = 61


def place_rectangle(
    ends: Ends, xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, prior: Prior
) -> Float[np.ndarray, " 5"]:
    """The rectangle of an object at a yaw (x, y, length, width, yaw) from its points and the rays past them.

    Along each axis the two ends lie beyond the outermost points and not beyond the nearest ray that passed. Within
    these bounds the usual size, with its spread in the class, decides: the mean of what remains possible is taken.
    Where no ray passed at either end, or the rays contradict the size, it is as :func:`footprint` has it.

    Args:
        ends: Points and passing rays along the two axes.
        xy_m: The object's points seen from above, at least one.
        yaw_rad: The heading.
        prior: Size, and where the sensor stands.
    """
    plain = footprint(xy_m, yaw_rad, prior)
    if not (prior.anchored and prior.grows):
        return plain
    turn, ego = axes(yaw_rad), np.array(prior.ego_m)
    centre, size = turn @ (plain[:2] - ego), plain[2:4].copy()
    for axis in (0, 1):
        stretch = _stretch(ends.hit_m[axis], ends.gap_m[axis], prior, axis)
        if stretch is not None:
            centre[axis] = (stretch[0] + stretch[1]) / 2
            if axis == 0 and not prior.fixed_size:
                size[axis] = stretch[1] - stretch[0]
    x, y = centre @ turn + ego
    return np.array([x, y, *size, yaw_rad])


def _stretch(
    hit_m: Float[np.ndarray, " 2"], gap_m: Float[np.ndarray, " 2"], prior: Prior, axis: int
) -> tuple[float, float] | None:
    """Where an object begins and ends along an axis; None where only the points tell."""
    usual, covered = prior.size_m[axis], float(hit_m[1] - hit_m[0])
    spread = _FIXED_SPREAD_M if prior.fixed_size else _SPREAD[axis] * usual
    if not np.isfinite(gap_m).any() or covered + gap_m.sum() < usual - (_CERTAIN * spread if axis == 0 else np.inf):
        return None
    most = max(usual + _CERTAIN * spread - covered, 0.0)
    before, behind = (np.linspace(0, value, _STEPS) for value in np.minimum(gap_m + 3 * _PASSED_M, most))
    size = covered + before[:, None] + behind[None, :]
    beyond = np.maximum(before[:, None] - gap_m[0], 0) ** 2 + np.maximum(behind[None, :] - gap_m[1], 0) ** 2
    exponent = -0.5 * ((size - usual) / spread) ** 2 - 0.5 * beyond / _PASSED_M**2
    scales = np.where((gap_m < _SEEN_M) & (axis == 0), _FACE_M, np.inf)
    if hit_m[0] > 0:
        scales[0] = min(scales[0], _NEAR_FACE_M)
    elif hit_m[1] < 0:
        scales[1] = min(scales[1], _NEAR_FACE_M)
    exponent = exponent - before[:, None] / scales[0] - behind[None, :] / scales[1]
    weight = np.exp(exponent - exponent.max())
    weight /= weight.sum()
    return float(hit_m[0] - (weight.sum(axis=1) * before).sum()), float(hit_m[1] + (weight.sum(axis=0) * behind).sum())
