"""Argoverse 1 by a generator that has not seen the reader."""

import numpy as np

from .generators.argoverse1 import write_argoverse1
from .generators.truth import check_dataset, open_recognised


def test_a_tree_is_read_as_it_was_written(tmp_path):
    truth = write_argoverse1(tmp_path)
    check_dataset(open_recognised(tmp_path), truth)


def test_the_camera_looks_forward(tmp_path):
    write_argoverse1(tmp_path, frames=1)
    frame = open_recognised(tmp_path)[0]
    (name,) = frame.images
    assert frame.images[name].shape == (12, 16, 3)
    pixels, depth, visible = frame.cameras[name].project(np.array([[30.0, -3.0, 0.5]]))
    assert visible[0]
    assert 28 < depth[0] < 29
    assert pixels[0, 0] > 8
