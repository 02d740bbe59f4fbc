"""Deskewing against motions that are known in closed form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.geometry.poses import exponential, logarithm, pose_from_yaw, transform_points
from farfield.sync import PoseTrack, deskew, deskew_boxes

twists = arrays(np.float64, (3, 6), elements=st.floats(-1.5, 1.5))


@given(twists)
def test_exponential_and_logarithm_are_inverse(twist: np.ndarray) -> None:
    motion = exponential(twist)
    np.testing.assert_allclose(
        motion[:, :3, :3] @ motion[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-9
    )
    np.testing.assert_allclose(logarithm(motion), twist, atol=1e-7)


def circle(times_s: np.ndarray, speed: float, rate_rad_s: float) -> np.ndarray:
    """Poses of a car in a bend: exactly a screw of constant speed."""
    yaw = rate_rad_s * times_s
    radius = speed / rate_rad_s
    places = np.column_stack([radius * np.sin(yaw), radius * (1 - np.cos(yaw)), np.zeros_like(yaw)])
    return np.array([pose_from_yaw(float(angle), place) for angle, place in zip(yaw, places, strict=True)])


def test_a_bend_is_exact_and_a_chord_would_not_be() -> None:
    ends = np.array([0.0, 0.1])
    track = PoseTrack((ends * 1e9).astype(np.int64), circle(ends, 30, np.radians(30)))
    moments = np.linspace(0, 0.1, 11)
    got = track.at((moments * 1e9).astype(np.int64))
    truth = circle(moments, 30, np.radians(30))
    np.testing.assert_allclose(got, truth, atol=1e-9)
    chord = (track.world_T_sensor[0, :3, 3] + track.world_T_sensor[1, :3, 3]) / 2
    assert np.linalg.norm(chord - truth[5, :3, 3]) == pytest.approx(30 * 0.1 * np.radians(3) / 8, rel=0.01)


def test_a_static_scene_comes_back_to_its_place(rng: np.random.Generator) -> None:
    """30 m/s and 30 degrees a second, accelerating at 5 m/s^2, poses at 100 Hz: within 1 cm at 100 m, from over 1 m."""
    world = rng.uniform([-100, -100, -2], [100, 100, 5], (5000, 3))
    fine = np.arange(0, 0.2001, 0.01)
    arc = (30 * fine + 2.5 * fine**2) / 30  # the same circle, driven faster and faster
    poses = circle(arc, 30, np.radians(30))
    track = PoseTrack((fine * 1e9).astype(np.int64), poses)
    times = rng.integers(0, 1024, 5000) * (100_000_000 // 1024) + 50_000_000
    seconds = times / 1e9
    truth = circle((30 * seconds + 2.5 * seconds**2) / 30, 30, np.radians(30))
    seen = np.array([transform_points(np.linalg.inv(T), p[None])[0] for T, p in zip(truth, world, strict=True)])
    reference = 100_000_000
    moment = np.array([0.1])
    expected = transform_points(
        np.linalg.inv(circle((30 * moment + 2.5 * moment**2) / 30, 30, np.radians(30))[0]), world
    )
    assert np.linalg.norm(seen - expected, axis=1).max() > 1
    found = deskew(seen, times, track, reference_ns=reference)
    assert found.left == 0
    assert np.linalg.norm(found.points_m - expected, axis=1).max() < 0.01
    turned = deskew(seen.astype(np.float32), times, track, reference_ns=reference)
    assert turned.points_m.dtype == np.float32


def test_points_without_a_pose_keep_their_place() -> None:
    track = PoseTrack(np.array([0, 100]), circle(np.array([0.0, 0.1]), 10, 1.0))
    points = np.ones((3, 3))
    found = deskew(points, np.array([50, 151, -60]), track, reference_ns=0)
    assert found.left == 2
    np.testing.assert_array_equal(found.points_m[1:], points[1:])
    assert np.abs(found.points_m[0] - points[0]).max() > 0.1
    with pytest.raises(ConfigError, match="half an interval"):
        deskew(points, np.array([0, 0, 0]), track, reference_ns=400)


def test_tracks_that_are_none_are_refused() -> None:
    poses = circle(np.array([0.0, 0.1]), 10, 1.0)
    with pytest.raises(ConfigError, match="two poses"):
        PoseTrack(np.array([0]), poses[:1])
    with pytest.raises(ConfigError, match="increase"):
        PoseTrack(np.array([5, 5]), poses)
    with pytest.raises(ConfigError, match="rigid"):
        PoseTrack(np.array([0, 5]), poses * 2)


def test_points_of_moving_boxes_return_to_their_bodies(rng: np.random.Generator) -> None:
    """Two cars that pass each other, one that stands, one of unknown velocity, and the road between."""
    centre = np.array([[30.0, 3.0, 0.0], [40.0, -3.0, 0.0], [50.0, 8.0, 0.0], [60.0, 20.0, 0.0]])
    velocity = np.array([[30.0, 0.0], [-25.0, 5.0], [0.0, 0.0], [np.nan, np.nan]])
    boxes = Boxes(centre_m=centre, size_m=np.tile([4.5, 1.9, 1.5], (4, 1)), yaw_rad=np.zeros(4), velocity_m_s=velocity)
    owner = np.repeat(np.arange(4), 200)
    true = centre[owner] + rng.uniform(-0.5, 0.5, (800, 3)) * boxes.size_m[owner]
    times_ns = rng.integers(-50_000_000, 50_000_000, 800)
    flat = np.concatenate([np.nan_to_num(velocity), np.zeros((4, 1))], axis=1)[owner]
    seen = true + flat * times_ns[:, None] / 1e9
    road = np.column_stack([rng.uniform(0, 80, 300), rng.uniform(-10, 10, 300), np.full(300, -1.5)])
    points, times = np.concatenate([seen, road]), np.concatenate([times_ns, np.full(300, 10_000_000)])
    moved = deskew_boxes(points, 7 + times, boxes, reference_ns=7)
    np.testing.assert_allclose(moved[:800], true, atol=1e-9)
    np.testing.assert_array_equal(moved[800:], road)
    assert np.abs(points[:800] - true).max() > 1
    assert len(deskew_boxes(points[:0], times[:0], boxes, reference_ns=7)) == 0


def test_boxes_without_velocities_cannot_tell() -> None:
    boxes = Boxes(centre_m=np.zeros((1, 3)), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1))
    with pytest.raises(ConfigError, match="velocities"):
        deskew_boxes(np.zeros((1, 3)), np.zeros(1, dtype=np.int64), boxes, reference_ns=0)
