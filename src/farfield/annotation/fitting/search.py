"""Heading and place of a box by its points.

The heading of a rectangle of which one or two sides were seen: Zhang, Xu, Dong, Dolan: Efficient L-Shape Fitting for
Vehicle Detection Using Laser Scanners, IV 2017, algorithm 2 (search over the angle), 4 (closeness) and 5 (variance).

The place of a box of known size and heading, by the points that it holds and those that it leaves just outside. Score
of a place: points inside, less points in the 0.6 m round it, and half the points within 0.25 m of the two faces towards
the sensor. Counts come from sums over a grid of 0.1 m along the box's axes, so that all places are tried.
"""

import numpy as np
from jaxtyping import Bool, Float

from farfield.annotation.fitting.prior import Prior, axes

CLOSENESS_BELOW = 30
"""With fewer points than these closeness is the better criterion, with more variance."""
_NEAREST_M = 0.05  # distances below it count alike
_MOST_POINTS = 1500  # more add nothing but time
_CELLS = 4.0  # cells to a step: denser clouds are thinned to one point a cell before neighbours are sought
_HOLD, _HOLD_RAD = 0.02, np.deg2rad(4.0)
QUARTER_RAD = np.deg2rad(np.arange(90.0))


def subsample(points_m: Float[np.ndarray, "n c"], most: int = _MOST_POINTS) -> Float[np.ndarray, "m c"]:
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
    xy_m = subsample(xy_m - xy_m.mean(axis=0))
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


def refine_yaw(xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, turns_rad: Float[np.ndarray, " k"]) -> float:
    """A yaw that is known to a few degrees, turned to where the closeness is best.

    The known yaw holds a little: a turn of 4 degrees has to be 2 % closer, which points at one side alone never are.

    Args:
        xy_m: The object's points seen from above.
        yaw_rad: The yaw.
        turns_rad: Turns to try, shape (k,).
    """
    closeness = scores(xy_m, yaw_rad + turns_rad, "closeness")
    penalty = _HOLD * (turns_rad / _HOLD_RAD) ** 2
    return yaw_rad + float(turns_rad[int(np.argmax(closeness / closeness.max() - penalty))])


def _to_side(along_m: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k n"]:
    """Distance of each point to the nearer of the two sides across an axis."""
    low, high = along_m.min(axis=1, keepdims=True), along_m.max(axis=1, keepdims=True)
    return np.minimum(along_m - low, high - along_m)


def _variance(values: Float[np.ndarray, "k n"], chosen: np.ndarray) -> Float[np.ndarray, " k"]:
    """Variance of the chosen values of each row; 0 where fewer than two are chosen."""
    count = np.maximum(chosen.sum(axis=1), 1)
    mean = np.where(chosen, values, 0).sum(axis=1) / count
    return np.asarray((np.where(chosen, values - mean[:, None], 0) ** 2).sum(axis=1) / count)


# The place

CELL_M = 0.1
_RING_M, _FACE_M, _FACE_WEIGHT = 0.6, 0.25, 0.5
_BESIDE = 2  # cells: a hand that means a face presses so far beside it


def search(
    xy_m: Float[np.ndarray, "n 2"],
    at_m: tuple[float, float],
    yaws_rad: Float[np.ndarray, " k"],
    prior: Prior,
    *,
    reach_m: float = np.inf,
) -> tuple[Float[np.ndarray, "k 5"], Float[np.ndarray, " k"]]:
    """The best place of a box at each yaw, of those that hold the pointer's.

    Args:
        xy_m: Points over the ground, seen from above.
        at_m: The pointer: x and y.
        yaws_rad: Headings to try.
        prior: The size.
        reach_m: How far the box's middle may be from the pointer along each of its axes.

    Returns:
        Rectangles (x, y, length, width, yaw), and the score of each.
    """
    best = [_search_one(xy_m, np.asarray(at_m, dtype=np.float64), float(yaw), prior, reach_m) for yaw in yaws_rad]
    return np.array([box for box, _ in best]), np.array([score for _, score in best])


def _search_one(
    xy_m: Float[np.ndarray, "n 2"], at_m: Float[np.ndarray, " 2"], yaw_rad: float, prior: Prior, reach_m: float
) -> tuple[Float[np.ndarray, " 5"], float]:
    turn, size = axes(yaw_rad), np.array(prior.size_m[:2])
    local = (xy_m - at_m) @ turn.T
    sums = _sums(local, size)
    cells = np.maximum(np.round(size / CELL_M).astype(np.int64), 1)
    margin = _margin(size)
    starts = [margin[axis] + _starts(int(cells[axis]), reach_m) for axis in (0, 1)]  # low corners
    ring, face = round(_RING_M / CELL_M), max(round(_FACE_M / CELL_M), 1)
    low = [starts[0][:, None], starts[1][None, :]]
    high = [low[0] + cells[0], low[1] + cells[1]]
    inside = _counted(sums, low[0], high[0], low[1], high[1])
    around = _counted(sums, low[0] - ring, high[0] + ring, low[1] - ring, high[1] + ring) - inside
    ego = (np.array(prior.ego_m) - at_m) @ turn.T
    faces = np.zeros(inside.shape)
    for axis in (0, 1):
        edges = [list(low), list(high)]
        towards_low = ego[axis] < (low[axis] + high[axis] - 2 * margin[axis]) * CELL_M / 2
        strip_low = np.where(towards_low, low[axis], high[axis] - face)
        edges[0][axis], edges[1][axis] = strip_low, strip_low + face
        faces = faces + _counted(sums, edges[0][0], edges[1][0], edges[0][1], edges[1][1])
    score = inside - around + _FACE_WEIGHT * faces
    row, column = np.unravel_index(_central(score), score.shape)
    corner = (np.array([starts[0][row], starts[1][column]]) - margin) * CELL_M
    x, y = (corner + cells * CELL_M / 2) @ turn + at_m
    return np.array([x, y, *size, yaw_rad]), float(score[row, column])


def _starts(cells: int, reach_m: float) -> np.ndarray:
    """Low ends of a box of so many cells that holds cell 0 or ends just beside it, its middle no farther than reach."""
    starts = 1 - cells - _BESIDE + np.arange(cells + 2 * _BESIDE)
    return starts[np.abs(starts + cells / 2) * CELL_M <= max(reach_m, CELL_M)]


def _central(score: Float[np.ndarray, "a b"]) -> int:
    """The best place; of equal ones that nearest to their middle, not whichever comes first."""
    best = np.argwhere(score >= score.max() - 1e-9)
    middle = best[int(np.argmin(((best - best.mean(axis=0)) ** 2).sum(axis=1)))]
    return int(np.ravel_multi_index((int(middle[0]), int(middle[1])), score.shape))


def _margin(size_m: Float[np.ndarray, " 2"]) -> np.ndarray:
    """Cells from the grid's edge to the pointer: a box and its ring on either side."""
    return np.ceil((size_m + _RING_M) / CELL_M).astype(np.int64) + 3


def _sums(local_m: Float[np.ndarray, "n 2"], size_m: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "a b"]:
    """Sums of counts over all cells below each corner of the grid, whose middle is the pointer."""
    margin = _margin(size_m)
    cell = np.floor(local_m / CELL_M).astype(np.int64) + margin
    cell = cell[((cell >= 0) & (cell < 2 * margin)).all(axis=1)]
    counts = np.zeros(tuple(2 * margin + 1))
    np.add.at(counts, (cell[:, 0] + 1, cell[:, 1] + 1), 1.0)
    return np.sqrt(counts).cumsum(axis=0).cumsum(axis=1)


def _counted(
    sums: Float[np.ndarray, "a b"], low_u: np.ndarray, high_u: np.ndarray, low_v: np.ndarray, high_v: np.ndarray
) -> np.ndarray:
    return np.asarray(sums[high_u, high_v] - sums[low_u, high_v] - sums[high_u, low_v] + sums[low_u, low_v])


# The points that hang together with the one under the pointer.


def link_radius_m(range_m: float, *, small: bool) -> float:
    """How far neighbours may lie apart: it grows with the range, as the beams part; less for people."""
    if small:
        return 0.3 + 0.003 * range_m
    return float(np.clip(0.45 + 0.006 * range_m, 0.45, 1.6))


def cluster_at(
    points_m: Float[np.ndarray, "n 3"], at_m: tuple[float, float], radius_m: float
) -> Bool[np.ndarray, " n"]:
    """Which points are linked, by steps of at most ``radius_m``, with the one nearest to a place, shape (n,).

    Args:
        points_m: Points without the ground, shape (n, 3).
        at_m: x and y of the place.
        radius_m: Largest step.
    """
    from scipy.sparse import coo_array  # scipy takes a third of the studio's start
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(points_m) == 0:
        return np.zeros(0, dtype=np.bool_)
    cell_m = radius_m / _CELLS
    cells = np.floor(points_m / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    code = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, first, member = np.unique(code, return_index=True, return_inverse=True)
    cell = cells[first]
    pairs = cKDTree((cell + 0.5) * cell_m).query_pairs(radius_m, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(cell), len(cell)))
    _, component = connected_components(links, directed=False)
    nearest = int(np.argmin(np.hypot(points_m[:, 0] - at_m[0], points_m[:, 1] - at_m[1])))
    of_point = component[member.ravel()]
    return np.asarray(of_point == of_point[nearest])
