"""Depth edges at the moment of the picture: the car's own way during the sweep is taken out, where it is known."""

import numpy as np

from farfield.calibration.depth_edges import deskew_to, lidar_edges
from farfield.frame import Cloud, Frame
from farfield.geometry.deskewing import PoseTrack

START_NS = 1_000_000_000


def ahead(metres: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = metres
    return pose


TRACK = PoseTrack(START_NS + np.array([0, 100_000_000]), np.stack([ahead(0.0), ahead(1.2)]))  # 12 m/s


def board() -> tuple[Cloud, Frame]:
    """One ring that sees a board 10 m ahead before a wall at 30 m, its left 20 ms before its right."""
    azimuth = np.radians(np.arange(-10.0, 10.0, 0.2))
    reach = np.where(np.abs(azimuth) < np.radians(4.1), 10.0, 30.0)
    points = reach[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    lag = np.round(np.linspace(10e6, -10e6, len(azimuth))).astype(np.int64)
    cloud = Cloud(points.astype(np.float32), None, {"time_ns": lag})
    return cloud, Frame(sequence="1", frame_id="0", time_ns=START_NS)


def test_points_stand_where_the_picture_saw_them() -> None:
    cloud, frame = board()
    moved = deskew_to(cloud, TRACK, frame, START_NS)
    assert moved is not None
    way = 12.0 * cloud.extra["time_ns"] * 1e-9
    np.testing.assert_allclose(moved - cloud.points_m, np.column_stack([way, 0 * way, 0 * way]), atol=1e-5)


def test_edges_move_with_their_points() -> None:
    cloud, frame = board()
    ring = np.zeros(len(cloud.points_m), dtype=int)
    raw = lidar_edges(cloud.points_m, ring).upright_m
    found = lidar_edges(cloud.points_m, ring, at_picture_m=deskew_to(cloud, TRACK, frame, START_NS)).upright_m
    assert len(raw) == len(found) == 2
    left, right = (found - raw)[np.argsort(-raw[:, 1])]
    assert left[0] < -0.03 < 0.03 < right[0]  # 4 ms of the way, to either side
    np.testing.assert_allclose((found - raw)[:, 1:], 0, atol=1e-5)


def test_without_times_or_poses_points_stay() -> None:
    cloud, frame = board()
    assert deskew_to(cloud, None, frame, START_NS) is None
    assert deskew_to(Cloud(cloud.points_m, None, {}), TRACK, frame, START_NS) is None
    assert deskew_to(cloud, TRACK, frame, START_NS + 10**9) is None
