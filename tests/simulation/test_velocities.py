"""Velocities of simulated annotations: over ground, in the frame's coordinates, those that the bodies drive at."""

from typing import Any

import numpy as np
import pytest

from farfield.frame import Boxes, Frame, transform_frame
from farfield.geometry.poses import invert, pose_from_yaw
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.labels import MOVING_M_S, full_boxes
from farfield.simulation.world.scene import WorldScene
from farfield.testing.datasets import check_moving

SMALL: dict[str, dict[str, Any]] = {
    "cirrus-sim-ideal": {"duration_s": 8.0, "lines": 32, "columns": 300, "stride_s": 0.5},
    "kradar-sim-mini": {"columns": 256, "stride_s": 0.5},
}


@pytest.fixture(scope="module", params=SMALL)
def pair(request: pytest.FixtureRequest) -> tuple[Frame, Frame]:
    preset = find_preset(request.param, **SMALL[request.param])
    first, second = (simulate_frame(preset, seed=12, sequence=0, index=index) for index in (2, 3))
    return first, second


def _whole(frame: Frame) -> Boxes:
    assert frame.annotation is not None
    return frame.annotation.boxes if frame.annotation.full_boxes is None else frame.annotation.full_boxes


def test_bodies_drive_the_differences_of_their_centres() -> None:
    """In coordinates that stand still, seen a hundredth of a second before and after."""
    scene = WorldScene("urban", np.random.SeedSequence(3), duration_s=6.0)
    still_T_world = invert(scene.ego_pose(3.0)) @ pose_from_yaw(0.4)
    before, now, after = (
        full_boxes(w.actors, w.bottom_m, w.yaw_rad, w.velocity_m_s, still_T_world)
        for w in (scene.window(time_s) for time_s in (2.99, 3.0, 3.01))
    )
    ids = np.intersect1d(np.intersect1d(before.track_id, now.track_id), after.track_id)
    first, middle, last = (
        boxes[np.array([boxes.track_id.tolist().index(i) for i in ids])] for boxes in (before, now, after)
    )
    assert (np.linalg.norm(middle.velocity_m_s, axis=1) > 3.0).sum() >= 3
    np.testing.assert_allclose(middle.velocity_m_s, (last.centre_m - first.centre_m) / 0.02, atol=0.02)


def test_annotated_velocities_are_those_between_two_frames(pair: tuple[Frame, Frame]) -> None:
    """Labels stand where points show a car, at another moment in each frame: 50 ms of 25 m/s at most."""
    first, second = (_whole(frame).transform(frame.world_T_frame) for frame in pair)
    past_s = (pair[1].time_ns - pair[0].time_ns) * 1e-9
    _, one, other = np.intersect1d(first.track_id, second.track_id, return_indices=True)
    driven = (second.centre_m[other] - first.centre_m[one]) / past_s
    mean = (first.velocity_m_s[one] + second.velocity_m_s[other]) / 2
    assert (np.linalg.norm(mean, axis=1) > 5.0).sum() >= 2
    np.testing.assert_allclose(mean, driven, atol=0.6)


def test_visible_parts_move_as_their_bodies_and_who_moves_is_annotated(pair: tuple[Frame, Frame]) -> None:
    for frame in pair:
        annotation = frame.annotation
        np.testing.assert_array_equal(annotation.boxes.velocity_m_s, _whole(frame).velocity_m_s)
        assert annotation.boxes.velocity_m_s.shape == (len(annotation), 3)
        speed = np.hypot(*annotation.boxes.velocity_m_s[:, :2].T)
        assert annotation.moving[speed > MOVING_M_S].all()
        assert not annotation.moving[speed < 0.4].any()


def test_velocities_turn_with_the_frame(pair: tuple[Frame, Frame]) -> None:
    frame = pair[0]
    turned = transform_frame(frame, pose_from_yaw(np.pi / 2))
    x, y, z = frame.boxes.velocity_m_s.T
    np.testing.assert_allclose(turned.boxes.velocity_m_s, np.stack([-y, x, z], axis=1), atol=1e-12)
    check_moving(frame)
