"""Doppler: plain argmax, ego-motion unwrapping of a folded static world, and of a turning vehicle."""

import numpy as np
import pytest

from farfield.radar.axes import KRADAR_AXES, RadarAxes
from farfield.radar.doppler import (
    radar_velocity,
    unwrap,
    wrapped_mean_velocity,
    wrapped_peak_velocity,
)
from farfield.radar.products import Moments, doppler_cube, moments, polar3d, zyx_cube

SMALL = RadarAxes(np.arange(20) * 0.5, np.arange(-4.0, 5.0), np.arange(-2.0, 4.0), np.arange(-4, 4) * 0.25)


def scene(rng, count=500):
    points = rng.uniform([2, -40, -2], [100, 40, 5], (count, 3))
    return points, points / np.linalg.norm(points, axis=1, keepdims=True)


def test_peak_is_numpys_argmax_and_mean_is_the_polar_maps(rng):
    tensor = rng.exponential(1e11, SMALL.shape).astype(np.float32)
    expected = SMALL.doppler_m_s[tensor.argmax(axis=0)]
    np.testing.assert_allclose(wrapped_peak_velocity(tensor, SMALL), expected, rtol=1e-7)
    mean = wrapped_mean_velocity(moments(tensor, SMALL))
    np.testing.assert_array_equal(mean, polar3d(tensor, SMALL)[1].transpose(0, 2, 1))


def test_two_echoes_beside_the_fold_differ_in_mean_and_peak():
    tensor = np.zeros(SMALL.shape, dtype=np.float32)
    tensor[1, 3, 2, 5], tensor[7, 3, 2, 5] = 2.0, 3.0
    assert wrapped_peak_velocity(tensor, SMALL)[3, 2, 5] == pytest.approx(0.75)
    assert wrapped_mean_velocity(moments(tensor, SMALL))[3, 2, 5] == pytest.approx((2 * -0.75 + 3 * 0.75) / 5)


def test_a_static_world_folds_and_unfolds_to_zero(rng):
    points, direction = scene(rng)
    ego = np.array([27.8, -0.4, 0.1])  # 100 km/h: seven folds
    true = -direction @ ego
    found = unwrap(KRADAR_AXES.fold(true), points, ego)
    np.testing.assert_allclose(found.velocity_m_s, true, atol=1e-9)
    np.testing.assert_allclose(found.compensated_m_s, 0.0, atol=1e-9)
    assert found.folds.min() == -7


def test_movers_within_half_a_span_keep_their_speed_and_faster_ones_cannot(rng):
    points, direction = scene(rng)
    ego, span = np.array([15.0, 0.0, 0.0]), KRADAR_AXES.velocity_span_m_s
    for own, seen in ((1.5, 1.5), (-1.9, -1.9), (3.0, 3.0 - span)):
        found = unwrap(KRADAR_AXES.fold(own - direction @ ego), points, ego)
        np.testing.assert_allclose(found.compensated_m_s, seen, atol=1e-9)


def test_the_radar_of_a_turning_vehicle_moves_sideways():
    mount = np.eye(4)
    mount[:3, 3] = 3.0, 0.5, 0.4
    forward, turn = np.array([10.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.2])
    np.testing.assert_allclose(radar_velocity(forward, turn, mount), [10 - 0.1, 0.6, 0.0])
    mount[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # looks to the left
    np.testing.assert_allclose(radar_velocity(forward, turn, mount), [0.6, -9.9, 0.0], atol=1e-12)
    step_s = 1e-6  # the same from the motion of the mounting point over a moment
    moved = np.array([[np.cos(0.2 * step_s), -np.sin(0.2 * step_s)], [np.sin(0.2 * step_s), np.cos(0.2 * step_s)]])
    velocity = (moved @ mount[:2, 3] - mount[:2, 3]) / step_s + forward[:2]
    np.testing.assert_allclose(radar_velocity(forward, turn, mount)[:2], mount[:2, :2].T @ velocity, atol=1e-6)


def test_a_point_at_the_radar_stands_still():
    found = unwrap(np.array([1.0]), np.zeros((1, 3)), np.array([20.0, 0, 0]))
    assert found.folds.tolist() == [0]
    assert found.velocity_m_s.tolist() == [1.0]


def test_doppler_cube_is_the_ratio_of_interpolated_sums(rng):
    shape = KRADAR_AXES.shape[1:]
    power = rng.exponential(1e11, shape).astype(np.float32)
    velocity = rng.uniform(-1.9, 1.8, shape).astype(np.float32)
    cube = doppler_cube(power, power * velocity)
    valid = zyx_cube(power) >= 0
    assert set(np.unique(cube[~valid])) == {-10.0}
    np.testing.assert_allclose(cube[valid], zyx_cube(power * velocity)[valid] / zyx_cube(power)[valid], rtol=1e-5)
    same = doppler_cube(power, power * np.float32(0.75))
    np.testing.assert_allclose(same[valid], 0.75, rtol=1e-6)
    none = doppler_cube(np.zeros_like(power), np.zeros_like(power))
    assert set(np.unique(none[valid])) == {0.0}


def test_no_power_has_no_velocity():
    zero = np.zeros((2, 2, 2), dtype=np.float32)
    assert not wrapped_mean_velocity(Moments(zero, zero, zero)).any()
