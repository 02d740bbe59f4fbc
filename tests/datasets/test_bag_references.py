"""Which of several clouds of a bag frames go by, and that it is said."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")
import bag_messages as rosbag

from farfield.datasets import open_dataset

START, MS = rosbag.START, 1_000_000
POINTS = np.zeros(5, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")]))


def drive(folder: Path, **period_ms: int) -> Path:
    """A second of clouds of some topics."""
    rows: list = []
    for name, period in period_ms.items():
        topic = "/" + name.replace("__", "/")
        rows += [(topic, START + at * MS, rosbag.cloud(POINTS, START + at * MS, name)) for at in range(0, 1000, period)]
    return rosbag.write_bag(folder, sorted(rows, key=lambda row: row[1]), mcap=True)


@pytest.mark.parametrize("other", ["camera__depth__color__points", "cloud_registered", "local_map"])
def test_a_lidar_comes_before_depth_cameras_and_maps_of_more_messages(tmp_path: Path, other: str) -> None:
    data = open_dataset(drive(tmp_path / "drive", velodyne_points=100, **{other: 33}))
    assert (len(data), data[0].reference) == (10, "velodyne_points")
    topic = "/" + other.replace("__", "/")
    assert data.assumptions == (f"frames go by the cloud /velodyne_points, not by {topic}; cloud= says another",)
    named = open_dataset(tmp_path / "drive", cloud=topic)
    assert (len(named), named.assumptions) == (31, ())


def test_one_lidar_and_a_radar_leave_nothing_to_say(tmp_path: Path) -> None:
    data = open_dataset(drive(tmp_path / "drive", points=100, radar=50))
    assert (len(data), data.assumptions) == (10, ())
