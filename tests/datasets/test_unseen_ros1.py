"""ROS 1 bags by a generator that has not seen the reader."""

import pytest

pytest.importorskip("rosbags")

from .generators.ros1 import write_ros1
from .generators.truth import check_dataset, open_recognised


def test_a_bag_is_read_as_it_was_written(tmp_path):
    truth = write_ros1(tmp_path / "drive.bag")
    check_dataset(open_recognised(tmp_path), truth)
