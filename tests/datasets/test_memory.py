"""Frames in memory are a data set like any other."""

import pickle

import numpy as np
import pytest

from farfield.datasets import InMemory, in_memory
from farfield.datasets.maps import Sweeps
from farfield.datasets.recipes import replay
from farfield.frame import Boxes, Frame


def _frames(count: int = 3) -> list[Frame]:
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.arange(count)
    return [
        Frame.of(np.full((4, 3), 10.0), Boxes.empty(), frame_id=str(i), time_ns=i * 10**8, world_T_frame=poses[i])
        for i in range(count)
    ]


def test_frames_are_those_of_the_list() -> None:
    frames = _frames()
    data = in_memory(frames)
    assert [frame is given for frame, given in zip(data, frames, strict=True)] == [True] * 3
    assert data.keys == (("memory", "0"), ("memory", "1"), ("memory", "2"))
    assert data.files(0) == ()
    assert data[-1] is frames[2]
    with pytest.raises(IndexError):
        data[3]


def test_a_data_set_stays_itself() -> None:
    data = in_memory(_frames())
    assert in_memory(data) is data
    selected = data.select([1])
    assert in_memory(selected) is selected


def test_nothing_identifies_it() -> None:
    data = in_memory(_frames())
    for view in (data, data.select([0, 2]), data.turned(90)):
        assert view.fingerprint() == ""
        assert not view.stored
        assert view.root.name == ""


def test_a_plain_list_has_no_drives_and_one_in_order_has() -> None:
    assert in_memory(_frames()).drives() == ()
    (drive,) = in_memory(_frames(), in_order=True).drives()
    assert drive.keys == (("memory", "0"), ("memory", "1"), ("memory", "2"))
    assert drive.times_ns is not None
    np.testing.assert_array_equal(drive.times_ns, [0, 10**8, 2 * 10**8])
    assert drive.world_T_frame is not None
    np.testing.assert_array_equal(drive.world_T_frame[:, 0, 3], [0, 1, 2])


def test_maps_see_the_frames_before_where_these_stand_in_order() -> None:
    in_order = InMemory(_frames(), in_order=True).mapped(Sweeps(3))
    assert [len(frame.cloud()) for frame in in_order] == [4, 8, 12]
    assert [len(frame.cloud()) for frame in InMemory(_frames()).mapped(Sweeps(3))] == [4, 4, 4]


def test_a_recipe_leaves_it_as_it_is() -> None:
    data = in_memory(_frames())
    recipe = {"maps": [{"name": "sweeps", "settings": {"count": 2}}]}
    assert replay(data, recipe) is data


def test_it_pickles() -> None:
    data = pickle.loads(pickle.dumps(in_memory(_frames(), in_order=True)))
    assert len(data) == 3
    assert len(data.drives()) == 1
