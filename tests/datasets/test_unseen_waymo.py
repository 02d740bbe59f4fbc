"""Waymo v2's parquet components by a generator that has not seen the reader."""

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from .generators.truth import check_dataset, open_recognised
from .generators.waymo import write_waymo


@pytest.mark.parametrize("part", ["", "validation"])
def test_a_tree_is_read_as_it_was_written(part, tmp_path):
    truth = write_waymo(tmp_path, part=part)
    check_dataset(open_recognised(tmp_path), truth)


def test_a_picture_and_its_camera_are_there(tmp_path):
    write_waymo(tmp_path, frames=1)
    frame = open_recognised(tmp_path)[0]
    (name,) = frame.images
    assert frame.images[name].shape == (12, 16, 3)
    pixels, depth, visible = frame.cameras[name].project(np.array([[30.0, -3.0, 0.5]]))
    assert visible[0]
    assert 28 < depth[0] < 29
    assert pixels[0, 0] > 8  # a little to the right
    assert pixels[0, 1] > 6  # and below
