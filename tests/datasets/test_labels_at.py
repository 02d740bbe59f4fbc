"""Labels moved to the time of the other sweep: by velocities, by identities, through the reader's option."""

import pickle
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.cirrus import CirrusWriter
from farfield.datasets.maps import LabelsAt, described, make, none_before
from farfield.datasets.recipes import replay
from farfield.errors import DatasetError
from farfield.experiments.schema import experiment_of
from farfield.frame import Annotation, Boxes, Cloud, Frame, Sensor
from farfield.geometry.poses import pose_from_yaw

START = 1_600_000_000_000_000_000
LATER = 80_000_000
SPEED = np.array([20.0, -2.0, 0.0])
EGO = 15.0


def drive(index: int, *, tracks: bool = True, poses: bool = True) -> Frame:
    """A car that drives past us while we drive along x, and one that stands; a frame every half second."""
    time_s = 0.5 * index
    world_T_frame = pose_from_yaw(0.1 * index, (EGO * time_s, 0.0, 0.0))
    world = np.array([np.array([30.0, 5.0, 0.0]) + SPEED * time_s, [50.0, -4.0, 0.0]])
    place = np.concatenate([world, np.ones((2, 1))], axis=1) @ np.linalg.inv(world_T_frame).T
    boxes = Boxes(
        centre_m=place[:, :3],
        size_m=np.array([[4.5, 1.9, 1.5]] * 2),
        yaw_rad=np.full(2, -0.1 * index),
        label="vehicle",
        track_id=np.array([7, 8]) if tracks else None,
    )
    time_ns = START + round(time_s * 1e9)
    sweep = Cloud(np.array([[10.0, 0.0, 0.0]], dtype=np.float32), np.zeros(1, dtype=np.float32))
    return Frame(
        sequence="one",
        frame_id=str(time_ns),
        time_ns=time_ns,
        sensors={
            "gaussian": Sensor(kind="lidar", time_ns=time_ns),
            "uniform": Sensor(kind="lidar", time_ns=time_ns + LATER),
        },
        clouds={"gaussian": sweep, "uniform": sweep},
        load_annotation=partial(Annotation, boxes=boxes, full_boxes=boxes),
        world_T_frame=world_T_frame if poses else None,
    )


def where(frame: Frame) -> np.ndarray:
    """Where the boxes stand in the world."""
    assert frame.world_T_frame is not None
    assert frame.annotation is not None
    return frame.annotation.boxes.transform(frame.world_T_frame).centre_m


def test_identities_and_poses_tell_where_a_car_is_later() -> None:
    frame = drive(3)
    seen = LabelsAt("uniform")(frame, lambda k: drive(3 - k))
    np.testing.assert_allclose(where(seen) - where(frame), [SPEED * LATER / 1e9, np.zeros(3)], atol=1e-9)
    assert seen.annotation is not None
    assert seen.annotation.full_boxes is not None
    np.testing.assert_allclose(seen.annotation.full_boxes.centre_m, seen.annotation.boxes.centre_m)


def test_velocities_of_the_boxes_come_first() -> None:
    frame = drive(3)
    assert frame.annotation is not None
    velocity = np.array([[1.0, 2.0], [np.nan, np.nan]])
    moving = frame.annotation.boxes.replace(velocity_m_s=velocity)
    fast = replace(frame, load_annotation=partial(Annotation, boxes=moving))
    seen = LabelsAt("uniform")(fast, none_before)
    assert seen.annotation is not None
    step = seen.annotation.boxes.centre_m - frame.annotation.boxes.centre_m
    np.testing.assert_allclose(step, [[0.08, 0.16, 0.0], [0.0, 0.0, 0.0]], atol=1e-12)


def test_what_nothing_tells_stays() -> None:
    frame = drive(0)
    for function, before in (("uniform", None), ("gaussian", drive(2)), ("third", drive(2)), ("uniform", drive(-5))):
        seen = LabelsAt(function)(frame, lambda _, before=before: before)
        np.testing.assert_array_equal(where(seen), where(frame))
    jump = drive(40)  # no car goes so far in half a second
    seen = LabelsAt("uniform")(replace(frame, time_ns=jump.time_ns + 500_000_000), lambda _: jump)
    np.testing.assert_allclose(where(seen), where(frame), atol=1e-9)


def test_without_identities_or_poses_it_says_so() -> None:
    for missing, message in (({"tracks": False}, "identities"), ({"poses": False}, "poses")):
        seen = LabelsAt("uniform")(drive(3, **missing), lambda _, missing=missing: drive(2, **missing))
        with pytest.raises(DatasetError, match=message):
            _ = seen.annotation


@pytest.fixture
def written(tmp_path: Path) -> Path:
    writer = CirrusWriter(tmp_path)
    for index in range(4):
        writer.write(drive(index))
    return tmp_path


def test_the_reader_offers_it_and_recipes_carry_it(written: Path) -> None:
    plain, late = open_dataset(written), open_dataset(written, labels_at="uniform")
    assert late.recipe["maps"] == [{"name": "labels_at", "settings": {"cloud": "uniform"}}]
    assert late.fingerprint() != plain.fingerprint()
    step = where(late[2]) - where(plain[2])
    np.testing.assert_allclose(step, [SPEED * LATER / 1e9, np.zeros(3)], atol=1e-4)
    again = late.annotation(2)
    assert again is not None
    np.testing.assert_array_equal(again.boxes.centre_m, late[2].boxes.centre_m)
    np.testing.assert_array_equal(where(pickle.loads(pickle.dumps(late[2]))), where(late[2]))
    replayed = replay(plain, late.recipe)
    np.testing.assert_array_equal(where(replayed[2]), where(late[2]))
    np.testing.assert_array_equal(where(late[0]), where(plain[0]))
    assert described(make("labels_at", {"cloud": "uniform"})) == late.recipe["maps"][0]


def test_an_experiment_says_it_in_its_options(written: Path) -> None:
    tree = {"name": "late", "data": {"path": str(written), "clouds": ["uniform"], "options": {"labels_at": "uniform"}}}
    data = experiment_of(tree).data
    opened = open_dataset(data.path, **data.options)
    assert [function.name for function in opened.maps] == ["labels_at"]
