"""nuScenes, MAN TruckScenes and T4 by generators that have not seen the reader."""

import numpy as np
import pytest

from .generators.nuscenes_trees import write_nuscenes
from .generators.truth import check_dataset, open_recognised, published_part

DIALECTS = ("nuscenes", "truckscenes", "t4")


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_tree_is_read_as_it_was_written(dialect, tmp_path):
    truth = write_nuscenes(tmp_path, dialect=dialect)
    check_dataset(open_recognised(tmp_path), truth)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_pictures_and_cameras_are_there(dialect, tmp_path):
    write_nuscenes(tmp_path, dialect=dialect, samples=1)
    frame = open_recognised(tmp_path)[0]
    names = [name for name in frame.images if "front" in name.lower()]
    assert len(frame.images) == 2
    assert frame.images[names[0]].shape == (12, 16, 3)
    camera = frame.cameras[names[0]]
    forward = np.array([[30.0, 0.0, 1.0]]) if dialect != "truckscenes" else np.array([[30.0, 12.0, 1.0]])
    _, depth, visible = camera.project(forward)
    assert visible[0]
    assert 24 < depth[0] < 31


def test_the_mini_split_is_by_scene(tmp_path):
    write_nuscenes(tmp_path)
    data = open_recognised(tmp_path)
    parts = {name: set(published_part(data, name).sequences) for name in ("train", "val")}
    assert parts["train"] == {"scene-0061"}
    assert parts["val"] == {"scene-0103"}
