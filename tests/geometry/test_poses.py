"""Poses and quaternions, checked against SciPy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from farfield.geometry.poses import (
    invert,
    pose,
    pose_from_yaw,
    quaternion_from_yaw,
    rotation_from_quaternion,
    transform_points,
    yaw_from_quaternion,
)


def test_rotations_equal_scipy_s_for_any_norm(rng: np.random.Generator) -> None:
    quaternion_xyzw = rng.normal(size=(200, 4)) * rng.uniform(0.1, 50, (200, 1))
    expected = Rotation.from_quat(quaternion_xyzw).as_matrix()
    np.testing.assert_allclose(rotation_from_quaternion(quaternion_xyzw), expected, atol=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(quaternion_xyzw[7]), expected[7], atol=1e-12)


@pytest.mark.parametrize("quaternion", [[0.0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_quaternions_without_a_direction_are_refused(quaternion: list[float]) -> None:
    with pytest.raises(ValueError, match="finite quaternions that are not zero"):
        rotation_from_quaternion(np.array(quaternion))


def test_yaw_and_quaternion_are_inverses_and_ignore_the_sign() -> None:
    yaw_rad = np.linspace(-np.pi, np.pi, 101)[:-1]
    quaternion = quaternion_from_yaw(yaw_rad)
    np.testing.assert_allclose(yaw_from_quaternion(quaternion), yaw_rad, atol=1e-12)
    np.testing.assert_allclose(np.cos(yaw_from_quaternion(-quaternion) - yaw_rad), 1, atol=1e-12)
    np.testing.assert_allclose(
        quaternion, Rotation.from_rotvec(yaw_rad[:, None] * [0.0, 0.0, 1.0]).as_quat(), atol=1e-12
    )


def test_yaw_is_where_the_x_axis_points_even_when_rolled_and_pitched() -> None:
    rotation = Rotation.from_euler("ZYX", [1.1, 0.2, -0.3])
    ahead = rotation.apply([1.0, 0, 0])
    assert yaw_from_quaternion(rotation.as_quat()) == pytest.approx(np.arctan2(ahead[1], ahead[0]))
    assert yaw_from_quaternion(rotation.as_quat()) == pytest.approx(1.1)


def test_a_pose_maps_the_source_s_origin_to_its_translation() -> None:
    world_T_lidar = pose_from_yaw(np.pi / 2, (10.0, 20.0, 2.0))
    moved = transform_points(world_T_lidar, np.array([[0.0, 0, 0], [1.0, 0, 0]]))
    np.testing.assert_allclose(moved, [[10, 20, 2], [10, 21, 2]], atol=1e-12)


def test_inverse_and_composition(rng: np.random.Generator) -> None:
    a_T_b = pose(Rotation.random(rng=rng).as_matrix(), rng.uniform(-250, 250, 3))
    b_T_c = pose(Rotation.random(rng=rng).as_matrix(), rng.uniform(-250, 250, 3))
    points_m = rng.uniform(-250, 250, (100, 3))
    np.testing.assert_allclose(invert(a_T_b) @ a_T_b, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(invert(a_T_b), np.linalg.inv(a_T_b), atol=1e-10)
    stepwise = transform_points(a_T_b, transform_points(b_T_c, points_m))
    np.testing.assert_allclose(transform_points(a_T_b @ b_T_c, points_m), stepwise, atol=1e-9)


def test_float32_points_are_moved_in_float64() -> None:
    moved = transform_points(pose_from_yaw(0.0, (1e-9, 0.0, 0.0)), np.ones((1, 3), dtype=np.float32))
    assert moved.dtype == np.float64
    assert moved[0, 0] > 1.0
