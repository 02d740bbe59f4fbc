"""Depth edges of a LiDAR sweep: points at which the range jumps, along its rings and from ring to ring.

Levinson and Thrun, "Automatic online calibration of cameras and lasers" (RSS 2013), section III. The edges are moved to
the moment of the picture: a rolling LiDAR measures the left of the picture some 10 ms before the middle and the right
as much after it. At 12 m/s that is 13 cm of the car's own way, with another sign on each side: it poses as yaw and as a
shift. :func:`sweep_edges` does both for a frame of a data set.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Shaped

from farfield.datasets.base import Dataset
from farfield.frame import Frame
from farfield.frame.cloud import Cloud
from farfield.geometry.deskewing import PoseTrack, deskew

_JUMP_M = 0.5
_LARGEST_JUMP_M = 5.0
_BIN_DEG = 0.42
_NEAREST_M, _FARTHEST_M = 2.0, 60.0
_RING_GAP_RAD, _COLUMN_GAP_RAD = np.radians(0.6), np.radians(1.2)  # between neighbours on a ring, and on a column
_COLUMN_RAD = np.radians(0.18)
_NEIGHBOUR_NS = 300_000_000


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


def sweep_edges(data: Dataset, index: int, *, camera: str, lidar: str | None = None) -> tuple[LidarEdges, bool]:
    """Find the depth edges of one frame as its camera saw them, and say whether the car's motion was taken out.

    That takes times of the points, and poses of the frame and of a neighbour; without them the points stay.

    Args:
        data: The data set.
        index: The frame.
        camera: Name of the image whose moment counts.
        lidar: Name of the cloud, in the frame's coordinates (default: the only one).
    """
    frame = data[index]
    cloud = frame.cloud(lidar)
    points_m = deskew_to(cloud, pose_track(data, index), frame, frame.time_ns_of(camera))
    return lidar_edges(cloud.points_m, cloud.extra.get("ring"), at_picture_m=points_m), points_m is not None


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
    range_m = np.linalg.norm(points, axis=1)
    in_range = (range_m > _NEAREST_M) & (range_m < _FARTHEST_M)
    points, range_m = points[in_range], range_m[in_range]
    shift_m = np.zeros_like(points) if at_picture_m is None else at_picture_m[in_range] - points
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = np.arcsin(points[:, 2] / range_m)
    row = np.floor(np.degrees(elevation) / _BIN_DEG).astype(int) if ring is None else ring[in_range].astype(int)
    upright = _jumps(points, shift_m, range_m, azimuth, row, _RING_GAP_RAD, both=True)
    level = np.zeros((0, 3)), np.zeros(0)
    if ring is not None:  # rebuilt rings are too rough to go from one to the next
        column = np.floor(azimuth / _COLUMN_RAD).astype(int)
        level = _jumps(points, shift_m, range_m, elevation, column, _COLUMN_GAP_RAD, both=False)
    return LidarEdges(upright_m=upright[0], upright_weight=upright[1], level_m=level[0], level_weight=level[1])


def _jumps(
    points_m: Float[np.ndarray, "n 3"],
    shift_m: Float[np.ndarray, "n 3"],
    range_m: Float[np.ndarray, " n"],
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
    # 1. Steps in range between neighbours on a line.
    order = np.lexsort((along, line))
    ranges, step = range_m[order], np.diff(range_m[order])
    beside = (np.diff(line[order]) == 0) & (np.diff(along[order]) < gap_rad)

    # 2. Jumps: large steps beside which the near side is no slope.
    large = np.abs(step) > np.maximum(_JUMP_M, 0.03 * np.minimum(ranges[:-1], ranges[1:]))
    size = np.where(beside, np.abs(step), np.inf)
    before, after = np.append(np.inf, size[:-1]), np.append(size[1:], np.inf)
    no_slope = np.where(step > 0, before, after) < np.abs(step) / 3
    jumps = np.flatnonzero(beside & large & no_slope & ((step > 0) | both))

    # 3. Points half way between the two rays, at the nearer range, moved as the nearer point is.
    rays = points_m[order] / ranges[:, None]
    middle = rays[jumps] + rays[jumps + 1]
    middle *= (np.minimum(ranges[jumps], ranges[jumps + 1]) / np.linalg.norm(middle, axis=1))[:, None]
    near = np.where(step[jumps] > 0, order[jumps], order[jumps + 1])
    return middle + shift_m[near], np.sqrt(np.minimum(np.abs(step[jumps]), _LARGEST_JUMP_M))


def pose_track(data: Dataset, index: int) -> PoseTrack | None:
    """Poses of a frame and its neighbours in time; None where they are not known."""
    here = data[index]
    rows = [
        (frame.time_ns, frame.world_T_frame)
        for frame in (data[i] for i in (index - 1, index, index + 1) if 0 <= i < len(data))
        if frame.sequence == here.sequence
        and frame.time_ns is not None
        and here.time_ns is not None
        and frame.world_T_frame is not None
        and abs(frame.time_ns - here.time_ns) < _NEIGHBOUR_NS
    ]
    if len(rows) < 2 or here.world_T_frame is None or any(b[0] <= a[0] for a, b in pairwise(rows)):
        return None
    return PoseTrack(np.array([row[0] for row in rows], dtype=np.int64), np.stack([row[1] for row in rows]))


def deskew_to(
    cloud: Cloud, track: PoseTrack | None, frame: Frame, moment_ns: int | None
) -> Float[np.ndarray, "n 3"] | None:
    """The points of a frame's cloud as they stood at a moment, shape (n, 3); None where times or poses lack."""
    offsets_s = cloud.offsets_s()
    if offsets_s is None or track is None or frame.time_ns is None or moment_ns is None:
        return None
    if not track.covers(np.array([moment_ns], dtype=np.int64)).all():
        return None
    times = frame.time_ns + np.rint(offsets_s * 1e9).astype(np.int64)
    return deskew(cloud.points_m.astype(np.float64), times, track, reference_ns=moment_ns).points_m
