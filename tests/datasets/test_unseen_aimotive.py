"""aiMotive's data set by a generator that has not seen the reader."""

import pytest

pytest.importorskip("laspy")
pytest.importorskip("lazrs")

from .generators.aimotive import write_aimotive
from .generators.truth import check_dataset, open_recognised


def test_a_tree_is_read_as_it_was_written(tmp_path):
    truth = write_aimotive(tmp_path, packed=True)
    check_dataset(open_recognised(tmp_path), truth)


def test_pictures_of_all_cameras_are_there(tmp_path):
    write_aimotive(tmp_path, frames=1)
    frame = open_recognised(tmp_path)[0]
    assert len(frame.images) == 4
    assert all(frame.images[name].shape == (12, 16, 3) for name in frame.images)
