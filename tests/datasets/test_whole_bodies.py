"""Boxes of whole bodies in the place of visible parts: where they are known, where not, and what travels with them."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import Dataset, open_dataset
from farfield.datasets.maps import WholeBodies, make, none_before
from farfield.datasets.recipes import replay
from farfield.errors import DatasetError
from farfield.frame import Annotation, Boxes, Constant, Frame


@pytest.fixture
def visible(simulated_cirrus: Path) -> Dataset:
    return open_dataset(simulated_cirrus)


def test_boxes_are_those_of_the_bodies_and_all_else_stays(visible: Dataset, simulated_cirrus: Path) -> None:
    whole = open_dataset(simulated_cirrus, whole_bodies=True)
    before, after = visible.annotation(0), whole.annotation(0)
    assert before is not None
    assert after is not None
    assert before.full_boxes is not None
    assert (before.extent, after.extent) == ("visible", "full")
    assert len(after) == len(before) > 0
    np.testing.assert_array_equal(after.boxes.centre_m, before.full_boxes.centre_m)
    np.testing.assert_array_equal(after.boxes.size_m, before.full_boxes.size_m)
    volume = [np.prod(each.boxes.size_m, axis=1) for each in (before, after)]
    assert (volume[1] > 1.2 * volume[0]).any()  # else there would be nothing to tell
    for name in ("label", "track_id", "point_count"):
        np.testing.assert_array_equal(getattr(after.boxes, name), getattr(before.boxes, name))
    assert after.original_label == before.original_label
    assert whole.fingerprint() != visible.fingerprint()
    again = pickle.loads(pickle.dumps(whole[0]))
    np.testing.assert_array_equal(again.boxes.size_m, after.boxes.size_m)


def test_what_a_detector_learnt_is_seen_again_where_it_is_known(
    visible: Dataset, simulated_cirrus: Path, tmp_path: Path
) -> None:
    recipe = open_dataset(simulated_cirrus, whole_bodies=True).recipe
    assert recipe["maps"] == [{"name": "whole_bodies", "settings": {}}]
    seen = replay(visible, recipe).annotation(0)
    assert seen is not None
    assert seen.extent == "full"
    np.save(tmp_path / "a.npy", np.zeros((4, 4), dtype=np.float32))
    loose = open_dataset(tmp_path)
    assert replay(loose, recipe) is loose  # a folder of clouds has no such thing


def test_whole_bodies_stay_and_unknown_ones_are_an_error(visible: Dataset) -> None:
    frame, mapped = visible[0], make("whole_bodies", {})
    annotation = frame.annotation
    assert annotation is not None
    full = replace(frame, load_annotation=Constant(Annotation(boxes=annotation.boxes)))
    assert mapped(full, none_before).annotation is full.annotation
    bare = replace(frame, load_annotation=Constant(replace(annotation, full_boxes=None)))
    with pytest.raises(DatasetError, match="tell the whole bodies of its objects"):
        _ = mapped(bare, none_before).annotation
    empty = replace(frame, load_annotation=Constant(Annotation(boxes=Boxes.empty(), extent="visible")))
    found = mapped(empty, none_before).annotation
    assert found is not None
    assert found.extent == "full"
    assert mapped(replace(frame, load_annotation=None), none_before).annotation is None


def test_it_fits_where_the_first_objects_tell_their_bodies(visible: Dataset) -> None:
    class Unknown:
        view_options = ("whole_bodies",)

        def __len__(self) -> int:
            return 2

        def has_annotation(self, index: int) -> bool:
            return bool(index)

        def annotation(self, index: int) -> Annotation:
            boxes = Boxes(centre_m=np.zeros((1, 3)), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1), label=["vehicle"])
            return Annotation(boxes=boxes, extent="visible")

    assert WholeBodies().fits(visible)
    assert not WholeBodies().fits(Unknown())
    assert isinstance(visible[0], Frame)
