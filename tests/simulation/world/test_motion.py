"""Paths in continuous time, and bodies that would touch."""

import numpy as np
import pytest

from farfield.geometry.iou import bev_intersection_m2
from farfield.simulation.world.motion import STEP_S, Motion, in_conflict


def _motion(x_m: list[float], yaw_rad: list[float]) -> Motion:
    position = np.zeros((1, len(x_m), 3))
    position[0, :, 0] = x_m
    return Motion(position, np.unwrap(np.array([yaw_rad]), axis=1), np.zeros((1, len(yaw_rad), 2)))


def test_uniform_motion_stays_uniform_and_angles_turn_the_short_way() -> None:
    motion = _motion([0, 2, 4, 6], [3.1, -3.1, -3.1 + 0.083185, -3.1 + 0.16637])
    for time_s in (0.0, 0.03, 0.11, 0.25, 0.3):
        assert motion.at(time_s)[0][0, 0] == pytest.approx(20 * time_s)
        assert motion.velocity_m_s(time_s)[0, 0] == pytest.approx(20.0)
    assert abs(motion.at(0.05)[1][0]) == pytest.approx(np.pi, abs=1e-3)


def test_paths_pass_through_their_steps_with_continuous_velocity() -> None:
    rng = np.random.default_rng(1)
    x = np.cumsum(rng.uniform(0, 3, 30))
    motion = _motion(x.tolist(), [0.0] * 30)
    for step in range(1, 28):
        time_s, small = step * STEP_S, 1e-9
        assert motion.at(time_s)[0][0, 0] == pytest.approx(x[step], abs=1e-6)
        before, after = (motion.velocity_m_s(time_s + sign * small)[0, 0] for sign in (-1, 1))
        assert before == pytest.approx(after, abs=1e-4)
        measured = (motion.at(time_s + 0.0301)[0] - motion.at(time_s + 0.0299)[0])[0, 0] / 0.0002
        assert motion.velocity_m_s(time_s + 0.03)[0, 0] == pytest.approx(measured, abs=1e-3)


def test_a_body_tilts_with_the_ground_and_keeps_its_heading() -> None:
    slope = np.tile([0.06, -0.03], (1, 3, 1))
    motion = Motion(np.zeros((1, 3, 3)), np.full((1, 3), 0.7), slope)
    pose = motion.poses(0.1)[0]
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    assert pose[2, 0] / np.hypot(pose[0, 0], pose[1, 0]) == pytest.approx(0.06)
    assert np.arctan2(pose[1, 0], pose[0, 0]) == pytest.approx(0.7)
    assert pose[2, 1] == pytest.approx(-0.03, abs=1e-3)


def test_the_later_of_two_that_would_touch_goes() -> None:
    steps = 50
    x = np.linspace(-20, 20, steps)
    position = np.zeros((4, steps, 3))
    position[0, :, 0], position[1, :, 1] = x, x  # these two meet at the origin
    position[2, :, 1], position[3, :, 0] = 40, -60  # these meet nobody
    yaw = np.zeros((4, steps))
    yaw[1] = np.pi / 2
    size = np.full((4, 3), [4.5, 1.9, 1.5])
    gone = in_conflict(position, yaw, size, np.array([False, True, True, True]), margin_m=0.3)
    assert gone.tolist() == [False, True, False, False]


def test_of_two_parked_in_one_place_the_later_goes() -> None:
    position = np.zeros((3, 12, 3))
    position[1, :, 0], position[2, :, 0] = 3.0, 30.0
    size = np.full((3, 3), [4.5, 1.9, 1.5])
    gone = in_conflict(position, np.zeros((3, 12)), size, np.full(3, True), margin_m=0.3)
    assert gone.tolist() == [False, True, False]


def test_those_that_pass_side_by_side_both_stay() -> None:
    """Rounding leaves areas of about 1e-16 m2 between some rectangles apart; they must not count as touching."""
    position = np.zeros((2, 1, 3))
    position[0, 0, :2], position[1, 0, :2] = (-382.25547974, 119.92049731), (-382.12128335, 123.6646846)
    size = np.array([[5.96054124, 2.02096712, 1.9], [4.36889316, 1.92810665, 1.7]])
    rows = np.column_stack([position[:, 0, :2], size[:, :2], [-0.40014961, 2.74384043]])
    rng, rounded = np.random.default_rng(3), 0
    for _ in range(400):
        offset = np.concatenate([rng.uniform(-400, 400, 2), [0.0]])
        turned = rows[:, 4] + rng.normal(0, 0.002, 2)
        placed = np.column_stack([rows[:, :2] + offset[:2], rows[:, 2:4], turned])
        rounded += bool(0 < bev_intersection_m2(placed[:1], placed[1:])[0] < 1e-12)
        gone = in_conflict(position + offset, turned[:, None], size, np.array([True, True]), margin_m=0.0)
        assert not gone.any()
    assert rounded > 0  # the case occurs among these
