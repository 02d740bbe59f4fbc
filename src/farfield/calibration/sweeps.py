"""Depth edges of a frame's sweep, moved to the moment of its picture.

A rolling LiDAR measures the left of the picture some 10 ms before the middle and the right as much after it. At 12 m/s
that is 13 cm of the car's own way, with another sign on each side: it poses as yaw and as a shift.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from farfield.calibration.depth_jumps import LidarEdges, lidar_edges
from farfield.datasets.base import Dataset
from farfield.frame import Frame
from farfield.frame.cloud import Cloud
from farfield.geometry.deskewing import PoseTrack, deskew

_COLUMNS = ("offset_ns", "time_ns")  # since the frame's time
_NEIGHBOUR_NS = 300_000_000


def sweep_edges(data: Dataset, index: int, *, camera: str, lidar: str | None = None) -> tuple[LidarEdges, bool]:
    """Find the depth jumps of one frame as its camera saw them, and say whether the car's motion was taken out.

    That takes times of the points, and poses of the frame and of a neighbour; without them the points stay.

    Args:
        data: The data set.
        index: The frame.
        camera: Name of the image whose moment counts.
        lidar: Name of the cloud, in the frame's coordinates; the only one unless given.
    """
    frame = data[index]
    cloud = frame.cloud(lidar)
    points = deskew_to(cloud, pose_track(data, index), frame, frame.time_ns_of(camera))
    return lidar_edges(cloud.points_m, cloud.extra.get("ring"), at_picture_m=points), points is not None


def pose_track(data: Dataset, index: int) -> PoseTrack | None:
    """Poses of a frame and its neighbours in time; None where they are not known."""
    around = [data[i] for i in (index - 1, index, index + 1) if 0 <= i < len(data)]
    here = data[index]
    rows = [
        (each.time_ns, each.world_T_frame)
        for each in around
        if each.sequence == here.sequence
        and each.time_ns is not None
        and here.time_ns is not None
        and each.world_T_frame is not None
        and abs(each.time_ns - here.time_ns) < _NEIGHBOUR_NS
    ]
    if len(rows) < 2 or here.world_T_frame is None or any(b[0] <= a[0] for a, b in pairwise(rows)):
        return None
    return PoseTrack(np.array([row[0] for row in rows], dtype=np.int64), np.stack([row[1] for row in rows]))


def deskew_to(
    cloud: Cloud, track: PoseTrack | None, frame: Frame, moment_ns: int | None
) -> Float[np.ndarray, "n 3"] | None:
    """The points of a frame's cloud as they stood at a moment, shape (n, 3); None where times or poses lack."""
    column = next((name for name in _COLUMNS if name in cloud.extra), None)
    if column is None or track is None or frame.time_ns is None or moment_ns is None:
        return None
    if not track.covers(np.array([moment_ns], dtype=np.int64)).all():
        return None
    times = frame.time_ns + cloud.extra[column].astype(np.int64)
    return deskew(cloud.points_m.astype(np.float64), times, track, reference_ns=moment_ns).points_m
