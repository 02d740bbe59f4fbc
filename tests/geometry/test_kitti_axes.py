"""KITTI's axes: by hand, and the upright reading against the general one where the camera is level."""

import numpy as np
from scipy.spatial.transform import Rotation

from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES
from farfield.geometry.kitti import lidar_from_camera, upright_from_camera
from farfield.geometry.poses import pose


def test_axes_by_hand() -> None:
    bottom, size = np.array([[2.0, 1.5, 20.0]]), np.array([[1.4, 1.8, 4.2]])  # right, below, ahead; height first
    centre, extent, yaw = upright_from_camera(bottom, size, np.array([-np.pi / 2]))
    np.testing.assert_array_equal(centre, [[20.0, -2.0, 0.7 - 1.5]])
    np.testing.assert_array_equal(extent, [[4.2, 1.8, 1.4]])
    np.testing.assert_array_equal(yaw, [0.0])  # -pi/2 about the axis that points down looks ahead


def test_exchanging_the_axes_is_the_bare_camera_to_the_bit(rng: np.random.Generator) -> None:
    bottom, size, turn = rng.normal(size=(50, 3)) * 30, rng.uniform(0.5, 9, (50, 3)), rng.uniform(-3, 3, 50)
    plain, matrix = (upright_from_camera(bottom, size, turn, axes) for axes in (None, CAMERA_T_LIDAR_AXES))
    for one, other in zip(plain, matrix, strict=True):
        np.testing.assert_array_equal(one, other)
    centre, extent, yaw = lidar_from_camera(bottom, size, turn)
    np.testing.assert_allclose(plain[0], centre, atol=1e-12)
    np.testing.assert_array_equal(plain[1], extent)
    np.testing.assert_allclose(np.cos(plain[2] - yaw), 1.0, atol=1e-12)


def test_a_tilted_camera_does_not_tilt_upright_boxes(rng: np.random.Generator) -> None:
    tilt = Rotation.from_euler("y", 0.05).as_matrix()
    camera_T_lidar = CAMERA_T_LIDAR_AXES @ pose(tilt, np.array([0.3, 0.1, -0.2]))
    size, turn = np.array([[1.5, 1.7, 4.0]]), np.array([0.4])
    bottom = rng.normal(size=(1, 3)) * 10
    centre, _, yaw = upright_from_camera(bottom, size, turn, camera_T_lidar)
    back = camera_T_lidar @ np.array([*(centre[0] - [0, 0, 0.75]), 1.0])
    np.testing.assert_allclose(back[:3], bottom[0], atol=1e-12)
    np.testing.assert_array_equal(yaw, -turn - np.pi / 2)
