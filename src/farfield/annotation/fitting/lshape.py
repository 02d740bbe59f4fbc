"""The yaw of a rectangle of which one or two sides were seen.

Zhang, Xu, Dong, Dolan: Efficient L-Shape Fitting for Vehicle Detection Using Laser Scanners, IV 2017, algorithm 2
(search over the angle), 4 (closeness) and 5 (variance).
"""

import numpy as np
from jaxtyping import Float

CLOSENESS_BELOW = 30
"""With fewer points than these closeness is the better criterion, with more variance."""
_NEAREST_M = 0.05  # distances below it count alike
_MOST_POINTS = 1500  # more add nothing but time
_HOLD, _HOLD_RAD = 0.02, np.deg2rad(4.0)
QUARTER_RAD = np.deg2rad(np.arange(90.0))


def thinned(points_m: Float[np.ndarray, "n c"], most: int = _MOST_POINTS) -> Float[np.ndarray, "m c"]:
    """At most so many points, evenly through the array."""
    if len(points_m) <= most:
        return points_m
    return points_m[np.linspace(0, len(points_m) - 1, most).astype(np.int64)]


def scores(
    xy_m: Float[np.ndarray, "n 2"], yaws_rad: Float[np.ndarray, " k"], criterion: str
) -> Float[np.ndarray, " k"]:
    """How well a rectangle at each yaw follows the points, shape (k,); larger is better.

    Args:
        xy_m: Points seen from above, shape (n, 2).
        yaws_rad: Directions of the rectangle's first side.
        criterion: ``closeness`` or ``variance``.
    """
    xy_m = thinned(xy_m - xy_m.mean(axis=0))
    first = np.outer(np.cos(yaws_rad), xy_m[:, 0]) + np.outer(np.sin(yaws_rad), xy_m[:, 1])
    second = np.outer(np.cos(yaws_rad), xy_m[:, 1]) - np.outer(np.sin(yaws_rad), xy_m[:, 0])
    to_first, to_second = _to_side(first), _to_side(second)
    if criterion == "closeness":
        return np.asarray((1 / np.maximum(np.minimum(to_first, to_second), _NEAREST_M)).sum(axis=1))
    return -_variance(to_first, to_first < to_second) - _variance(to_second, to_first >= to_second)


def best_yaw(xy_m: Float[np.ndarray, "n 2"], yaws_rad: Float[np.ndarray, " k"] = QUARTER_RAD) -> tuple[float, str]:
    """The best of some yaws, and the criterion that chose it: closeness for few points, variance for many."""
    criterion = "closeness" if len(xy_m) < CLOSENESS_BELOW else "variance"
    return float(yaws_rad[int(np.argmax(scores(xy_m, yaws_rad, criterion)))]), criterion


def turned_yaw(xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, turns_rad: Float[np.ndarray, " k"]) -> float:
    """A yaw that is known to a few degrees, turned to where the closeness is best.

    The known yaw holds a little: a turn of 4 degrees has to be 2 % closer, which points at one side alone never are.

    Args:
        xy_m: The object's points seen from above.
        yaw_rad: The yaw.
        turns_rad: Turns to try, shape (k,).
    """
    found = scores(xy_m, yaw_rad + turns_rad, "closeness")
    held = _HOLD * (turns_rad / _HOLD_RAD) ** 2
    return yaw_rad + float(turns_rad[int(np.argmax(found / found.max() - held))])


def _to_side(along_m: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k n"]:
    """Distance of each point to the nearer of the two sides across an axis."""
    low, high = along_m.min(axis=1, keepdims=True), along_m.max(axis=1, keepdims=True)
    return np.minimum(along_m - low, high - along_m)


def _variance(values: Float[np.ndarray, "k n"], chosen: np.ndarray) -> Float[np.ndarray, " k"]:
    """Variance of the chosen values of each row; 0 where fewer than two are chosen."""
    count = np.maximum(chosen.sum(axis=1), 1)
    mean = np.where(chosen, values, 0).sum(axis=1) / count
    return np.asarray((np.where(chosen, values - mean[:, None], 0) ** 2).sum(axis=1) / count)
