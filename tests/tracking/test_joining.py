"""Tracks joined over gaps: by motion, size and class, never two boxes of one frame."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame import Drive
from farfield.geometry.boxes import Boxes
from farfield.metrics.detections import Detections
from farfield.tracking import track
from farfield.tracking.offline import ANNOTATED, JoinSettings, join_tracks

FRAMES = 80


def drive(*tracks: tuple[range, float, float, float, float, str]) -> Detections:
    """Tracks along x at 10 Hz: frames, place at time 0, y, speed, length, class; numbered from 0 in their order."""
    boxes = {}
    for frame in range(FRAMES):
        here = [(number, *track[1:]) for number, track in enumerate(tracks) if frame in track[0]]
        x = [start + speed * frame / 10 for _, start, _, speed, _, _ in here]
        boxes["a", str(frame)] = Boxes(
            centre_m=np.array([[each, row[2], 0.0] for each, row in zip(x, here, strict=True)]).reshape(-1, 3),
            size_m=np.array([[row[4], 2.0, 1.5] for row in here]).reshape(-1, 3),
            yaw_rad=np.zeros(len(here)),
            label=[row[5] for row in here],
            score=np.ones(len(here)),
            track_id=np.array([row[0] for row in here], dtype=np.int64),
        )
    return Detections(boxes=boxes, annotations={})


def names(tracks: Detections) -> list[int]:
    found = [part.track_id for part in tracks.boxes.values() if part.track_id is not None]
    return sorted(set(np.concatenate(found).tolist()))


CAR = (range(30), 0.0, 0.0, 10.0, 4.5, "car")


def test_a_car_that_was_hidden_for_three_seconds_is_one() -> None:
    seen = drive(CAR, (range(60, 80), 4.0, 1.0, 10.0, 4.6, "car"))
    found = join_tracks(seen)
    assert names(seen) == [0, 1]
    assert names(found) == [0]
    for key, part in seen.boxes.items():
        np.testing.assert_array_equal(found.boxes[key].centre_m, part.centre_m)


@pytest.mark.parametrize(
    ("other", "settings"),
    [
        pytest.param((range(60, 80), 0.0, 0.0, 10.0, 6.0, "car"), JoinSettings(), id="larger"),
        pytest.param((range(60, 80), 0.0, 0.0, 10.0, 4.5, "truck"), JoinSettings(), id="of another class"),
        pytest.param((range(60, 80), 0.0, 0.0, 10.0, 4.5, "car"), JoinSettings(longest_s=3.0), id="away for longer"),
        pytest.param((range(60, 80), 30.0, 0.0, 10.0, 4.5, "car"), JoinSettings(), id="somewhere else"),
        pytest.param((range(25, 80), 1.0, 0.0, 10.0, 4.5, "car"), JoinSettings(), id="seen at the same time"),
    ],
)
def test_what_is_something_else_stays_so(other: tuple, settings: JoinSettings) -> None:
    assert names(join_tracks(drive(CAR, other), settings)) == [0, 1]


def test_the_pairs_of_a_drive_are_chosen_together() -> None:
    """Both ends are near the first begin; only the crossing-free assignment serves both."""
    one, two = (range(30), 0.0, 0.0, 10.0, 4.5, "car"), (range(30), 0.0, 3.0, 10.0, 4.5, "car")
    seen = drive(one, two, (range(50, 80), 0.0, 2.0, 10.0, 4.5, "car"), (range(50, 80), 0.0, 5.0, 10.0, 4.5, "car"))
    found = join_tracks(seen)
    assert found.boxes["a", "60"].track_id is not None
    assert dict(zip(found.boxes["a", "60"].centre_m[:, 1], found.boxes["a", "60"].track_id, strict=True)) == {
        2: 0,
        5: 1,
    }


def test_three_parts_become_one_and_single_boxes_have_no_speed() -> None:
    seen = drive(
        (range(20), 0.0, 0.0, 10.0, 4.5, "car"),
        (range(30, 31), 0.0, 0.0, 10.0, 4.5, "car"),
        (range(50, 80), 0.0, 0.0, 10.0, 4.5, "car"),
    )
    assert names(join_tracks(seen)) == [0]
    assert names(join_tracks(drive())) == []


def test_with_poses_places_are_compared_in_the_world() -> None:
    """A parked car, seen from a turning one: only in the world is it where it was."""
    seen = drive((range(30), 20.0, 0.0, 0.0, 4.5, "car"), (range(60, 80), 20.0, 0.0, 0.0, 4.5, "car"))
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 1, 3] = np.where(np.arange(FRAMES) < 45, 0.0, 60.0)
    keys = tuple(("a", str(frame)) for frame in range(FRAMES))
    times = (np.arange(FRAMES) * 100_000_000).astype(np.int64)
    moved = replace(
        seen, drives=(Drive(name="a", keys=keys, indices=np.arange(FRAMES), times_ns=times, world_T_frame=poses),)
    )
    assert names(join_tracks(seen)) == [0]
    assert names(join_tracks(moved)) == [0, 1]


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="longest_s: expected a positive number"):
        JoinSettings(longest_s=0.0)
    with pytest.raises(ConfigError, match="1 box or more"):
        JoinSettings(boxes=0)
    with pytest.raises(ConfigError, match="1 box or more"):
        JoinSettings(size_boxes=0)


def changed(tracks: Detections, frames: range, **fields: object) -> Detections:
    """The only track's box drawn otherwise in some frames."""
    boxes = dict(tracks.boxes)
    for frame in frames:
        boxes["a", str(frame)] = boxes["a", str(frame)].replace(**fields)
    return replace(tracks, boxes=boxes)


def test_sizes_are_compared_at_the_ends() -> None:
    """A car drawn longer while it was near: before and behind its absence it is the same to the millimetre."""
    seen = drive(CAR, (range(60, 80), 0.0, 0.0, 10.0, 4.5, "car"))
    exact = JoinSettings(size=0.001, size_boxes=8)
    grown = changed(seen, range(20), size_m=np.array([[5.2, 2.0, 1.5]]))
    assert names(join_tracks(grown, exact)) == [0]
    assert names(join_tracks(grown, replace(exact, size_boxes=None))) == [0, 1]
    assert names(join_tracks(changed(seen, range(22, 30), size_m=np.array([[4.6, 2.0, 1.5]])), exact)) == [0, 1]


def test_classes_are_compared_at_the_ends() -> None:
    """A van that was a car in its first frames is the van that comes back, and no car."""
    back = (range(60, 80), 0.0, 0.0, 10.0, 4.5)
    assert names(join_tracks(changed(drive(CAR, (*back, "van")), range(10, 30), label=["van"]))) == [0]
    assert names(join_tracks(changed(drive(CAR, (*back, "car")), range(10, 30), label=["van"]))) == [0, 1]


def test_boxes_that_people_drew_are_joined_by_their_size_over_long_absences() -> None:
    """Away for 3 s and turned off: 14 m from where it would have come to, and of just the size of one of the two."""
    seen = drive(CAR, (range(60, 80), 4.0, 14.0, 10.0, 4.5, "car"), (range(60, 80), 0.0, 2.0, 10.0, 4.55, "car"))
    found = join_tracks(seen, ANNOTATED).boxes["a", "60"]
    assert found.track_id is not None
    assert dict(zip(found.centre_m[:, 1], found.track_id.tolist(), strict=True)) == {14.0: 0, 2.0: 2}


def test_the_preset_for_drawn_boxes_tracks_a_box_through_a_slip_of_its_class() -> None:
    """One frame's class is wrong, two frames are missing: one object in the end; `unposed` makes a second one of it."""
    seen = changed(drive((range(40), 0.0, 0.0, 10.0, 4.5, "car")), range(10, 11), label=["van"])
    boxes = {key: part.replace(track_id=None) for key, part in seen.boxes.items()}
    boxes |= {("a", str(frame)): boxes["a", "0"][:0] for frame in (20, 21)}
    found = replace(seen, boxes=boxes)
    assert len(names(join_tracks(track(found, "unposed", min_hits=1), ANNOTATED))) > 1
    online = track(found, "annotated")
    assert len(names(online)) == 2
    assert len(names(join_tracks(online, ANNOTATED))) == 1
