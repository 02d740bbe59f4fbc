"""Where a box of known size and nearly known yaw stands: by the points it holds, and those it leaves just outside.

Score of a place: points inside, less points in the 0.6 m round it, and half the points within 0.25 m of the two faces
towards the sensor. Counts come from sums over a grid of 0.1 m along the box's axes, so that all places are tried.
"""

import numpy as np
from jaxtyping import Float

from farfield.annotation.fitting.anchoring import axes
from farfield.annotation.fitting.contract import Prior

CELL_M = 0.1
_RING_M, _FACE_M, _FACE_WEIGHT = 0.6, 0.25, 0.5


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
    found = [_search_one(xy_m, np.asarray(at_m, dtype=np.float64), float(yaw), prior, reach_m) for yaw in yaws_rad]
    return np.array([box for box, _ in found]), np.array([score for _, score in found])


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
    """Low ends of a box of so many cells that holds cell 0, its middle no farther than ``reach_m`` from it."""
    starts = 1 - cells + np.arange(cells)
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
