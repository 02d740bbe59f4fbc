"""What all echoes err by alike: the depth of each side is no y, and sigma holds what vehicles alone leave open."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from farfield.calibration.least_squares import solve
from farfield.calibration.radar_lidar import SYSTEMATIC, systematic_covariance
from farfield.calibration.radar_matching import (
    PARAMETERS,
    MatchedObjects,
    azimuth_sigma_rad,
    observation_shares,
    polar_residuals,
    whitened_residuals,
)

RIGHT = np.array([-2.5, 0.3, 0.0, 0.02])
POST_M, CAR_M = 0.2, 1.8
FORTY_M = 40.0 - RIGHT[0]  # ahead of the radar, from the LiDAR about which the yaw turns


def highway(rng: np.random.Generator, count: int = 400, *, width_m: float = POST_M) -> MatchedObjects:
    """Objects to 70 m on both sides, each seen once, where they are; speeds that tell the time."""
    lidar = np.column_stack([rng.uniform(8, 70, count), rng.uniform(-12, 12, count), np.zeros(count)])
    speed = np.column_stack([rng.uniform(-40, 10, count), np.zeros(count)])
    radar = lidar + np.column_stack([speed * RIGHT[3], np.zeros(count)]) + [RIGHT[0], RIGHT[1], 0.0]
    return MatchedObjects(
        lidar_m=lidar,
        width_m=np.full(count, width_m),
        velocity_m_s=speed,
        lag_s=np.zeros(count),
        radar_m=radar,
        track=np.arange(count),
        tracked=np.ones(count, dtype=bool),
    )


def solved(pairs: MatchedObjects) -> np.ndarray:
    rows = partial(whitened_residuals, pairs=pairs)
    return solve(rows, RIGHT, PARAMETERS, group=pairs.track, share=observation_shares(pairs, RIGHT)).value - RIGHT


def deeper(pairs: MatchedObjects, left_m: float, right_m: float) -> MatchedObjects:
    """The same with echoes from deeper by so much times the sine of the bearing, on each side."""
    reach = np.hypot(pairs.radar_m[:, 0], pairs.radar_m[:, 1])
    sine = pairs.radar_m[:, 1] / reach
    depth = np.where(sine > 0, left_m, right_m) * np.abs(sine)
    return replace(pairs, radar_m=pairs.radar_m * (1 + depth / reach)[:, None])


def test_where_nothing_is_off_nothing_is_taken_out() -> None:
    pairs = highway(np.random.default_rng(0))
    np.testing.assert_allclose(whitened_residuals(RIGHT, pairs), 0.0, atol=1e-9)


def test_the_depth_of_one_side_is_no_y() -> None:
    pairs = highway(np.random.default_rng(0))
    assert np.abs(solved(pairs)).max() < 1e-6
    x, y, yaw, _ = solved(deeper(pairs, 0.4, -0.2))
    assert abs(y) < 0.005
    assert abs(yaw) < np.radians(0.01)
    assert abs(x) < 0.03


def test_what_is_taken_out_is_a_depth_that_grows_with_the_sine() -> None:
    """Two objects to the left at 30 degrees and none to the right: residuals r leave r less the part told of it."""
    bearing, reach = np.radians(30.0), 40.0
    place = reach * np.array([[np.cos(bearing), np.sin(bearing), 0.0]] * 2)
    pairs = MatchedObjects(
        lidar_m=place * (1 - 0.1 / reach),
        width_m=np.full(2, POST_M),
        velocity_m_s=np.zeros((2, 2)),
        lag_s=np.zeros(2),
        radar_m=place,
        track=np.arange(2),
        tracked=np.ones(2, dtype=bool),
    )
    sigma, prior, sine = 0.2, 0.15, 0.5
    told = 2 * sine**2 / sigma**2 / (2 * sine**2 / sigma**2 + 1 / prior**2)
    left = whitened_residuals(np.zeros(4), pairs)
    np.testing.assert_allclose(left[:, 0], -0.1 / sigma * (1 - told), rtol=1e-6)
    np.testing.assert_allclose(left[:, 1], 0.0, atol=1e-9)


def test_an_azimuth_is_left_as_it_is() -> None:
    pairs = highway(np.random.default_rng(0))
    turned = RIGHT + np.array([0.0, 0.0, np.radians(0.1), 0.0])
    np.testing.assert_allclose(
        whitened_residuals(turned, pairs)[:, 1] * azimuth_sigma_rad(pairs), polar_residuals(turned, pairs)[:, 1]
    )
    assert np.median(polar_residuals(turned, pairs)[:, 1]) == pytest.approx(np.radians(0.1), rel=0.1)


def test_posts_leave_no_more_than_what_is_so_with_all_objects() -> None:
    posts = highway(np.random.default_rng(0))
    np.testing.assert_allclose(systematic_covariance(posts, RIGHT), np.diag(SYSTEMATIC**2), atol=1e-12)


def test_cars_alone_leave_y_and_yaw_open_and_their_place_at_forty_metres_known() -> None:
    cars = highway(np.random.default_rng(0), width_m=CAR_M)
    own = systematic_covariance(cars, RIGHT) - np.diag(SYSTEMATIC**2)
    assert np.sqrt(own[2, 2]) == pytest.approx(np.radians(0.2), rel=0.1)
    assert np.sqrt(own[1, 1]) == pytest.approx(np.hypot(FORTY_M * np.radians(0.2), 0.04), rel=0.2)
    there = np.array([0.0, 1.0, FORTY_M, 0.0])
    assert np.sqrt(there @ own @ there) == pytest.approx(0.04, rel=0.35)


def test_posts_among_the_cars_hold_them() -> None:
    cars = highway(np.random.default_rng(0), width_m=CAR_M)
    alone = np.sqrt(np.diag(systematic_covariance(cars, RIGHT)))[1:3]
    some = replace(cars, width_m=np.where(np.arange(400) % 4, CAR_M, POST_M))
    mixed = np.sqrt(np.diag(systematic_covariance(some, RIGHT)))[1:3]
    assert (SYSTEMATIC[1:3] < mixed).all()
    assert (mixed < 0.7 * alone).all()
