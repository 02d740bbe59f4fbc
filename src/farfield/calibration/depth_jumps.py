"""Points of a LiDAR sweep at which the depth jumps, along its rings and from ring to ring.

Levinson and Thrun, "Automatic online calibration of cameras and lasers" (RSS 2013), section III.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

_JUMP_M = 0.5
_LARGEST_JUMP_M = 5.0
_BIN_DEG = 0.42
_REACH_M = 60.0


@dataclass(frozen=True, eq=False, kw_only=True)
class LidarEdges:
    """Points at which the depth jumps, upright and level ones.

    Args:
        upright_m: Jumps along a ring, shape (n, 3).
        upright_weight: Their weights, shape (n,).
        level_m: Jumps from ring to ring, shape (m, 3).
        level_weight: Their weights, shape (m,).
    """

    upright_m: Float[np.ndarray, "n 3"]
    upright_weight: Float[np.ndarray, " n"]
    level_m: Float[np.ndarray, "m 3"]
    level_weight: Float[np.ndarray, " m"]


def lidar_edges(
    points_m: Float[np.ndarray, "n 3"],
    ring: Shaped[np.ndarray, " n"] | None = None,
    *,
    at_picture_m: Float[np.ndarray, "n 3"] | None = None,
) -> LidarEdges:
    """Find depth jumps in a sweep; rings are rebuilt from the elevation where the cloud has none.

    Args:
        points_m: Points in the LiDAR's own frame, each of the moment at which it was measured, shape (n, 3).
        ring: Ring of each point.
        at_picture_m: The same points deskewed to the moment of the picture, shape (n, 3): jumps are found between
            rays as they were sent, and then moved.
    """
    points = points_m.astype(np.float64)
    reach = np.linalg.norm(points, axis=1)
    kept = (reach > 2.0) & (reach < _REACH_M)
    points, reach = points[kept], reach[kept]
    shift = np.zeros_like(points) if at_picture_m is None else at_picture_m[kept] - points
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = np.arcsin(points[:, 2] / reach)
    row = np.floor(np.degrees(elevation) / _BIN_DEG).astype(int) if ring is None else ring[kept].astype(int)
    upright = _jumps(points, shift, reach, azimuth, row, np.radians(0.6), both=True)
    level = np.zeros((0, 3)), np.zeros(0)
    if ring is not None:  # rebuilt rings are too rough to go from one to the next
        column = np.floor(azimuth / np.radians(0.18)).astype(int)
        level = _jumps(points, shift, reach, elevation, column, np.radians(1.2), both=False)
    return LidarEdges(upright_m=upright[0], upright_weight=upright[1], level_m=level[0], level_weight=level[1])


def _jumps(
    points_m: Float[np.ndarray, "n 3"],
    shift_m: Float[np.ndarray, "n 3"],
    reach_m: Float[np.ndarray, " n"],
    along: Float[np.ndarray, " n"],
    line: Shaped[np.ndarray, " n"],
    gap_rad: float,
    *,
    both: bool,
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Edges between neighbours on a line, at the nearer range half way between the two rays, and their weights.

    The near side must be no slope: the step before the jump is at most a third of it (the ground recedes from ring to
    ring). Without ``both``, only what ends upwards counts: below, objects stand on the ground.
    """
    order = np.lexsort((along, line))
    reach, step = reach_m[order], np.diff(reach_m[order])
    beside = (np.diff(line[order]) == 0) & (np.diff(along[order]) < gap_rad)
    far = np.abs(step) > np.maximum(_JUMP_M, 0.03 * np.minimum(reach[:-1], reach[1:]))
    size = np.where(beside, np.abs(step), np.inf)
    before, after = np.append(np.inf, size[:-1]), np.append(size[1:], np.inf)
    flat = np.where(step > 0, before, after) < np.abs(step) / 3
    at = np.flatnonzero(beside & far & flat & ((step > 0) | both))
    rays = points_m[order] / reach[:, None]
    middle = rays[at] + rays[at + 1]
    middle *= (np.minimum(reach[at], reach[at + 1]) / np.linalg.norm(middle, axis=1))[:, None]
    near = np.where(step[at] > 0, order[at], order[at + 1])
    return middle + shift_m[near], np.sqrt(np.minimum(np.abs(step[at]), _LARGEST_JUMP_M))
