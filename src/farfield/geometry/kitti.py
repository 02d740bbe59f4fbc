"""KITTI's boxes to ours and back (Geiger et al., CVPR 2012, object devkit readme).

KITTI gives the centre of a box's bottom face in rectified camera coordinates (x right, y down, z ahead), sizes as
height, width, length, and ``rotation_y`` about the camera's y axis, 0 along x.
"""

import numpy as np
from jaxtyping import Float

from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES
from farfield.geometry.poses import transform_points

Parts = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]


def upright_from_camera(
    bottom_m: Float[np.ndarray, "n 3"],
    size_hwl_m: Float[np.ndarray, "n 3"],
    rotation_y_rad: Float[np.ndarray, " n"],
    camera_T_lidar: Float[np.ndarray, "4 4"] | None = None,
) -> Parts:
    """Convert boxes that stand upright in the lidar's frame, whatever the camera's tilt.

    The bottom's centre is moved, half the height is added upwards, and ``rotation_y`` turns clockwise about the
    vertical from the right-hand side. Labels whose headings turn about the lidar's or radar's vertical axis
    (View-of-Delft) mean this, and labels without calibration can mean no other.

    Args:
        bottom_m: Centres of the bottom faces, camera coordinates, shape (n, 3).
        size_hwl_m: Height, width, length, shape (n, 3).
        rotation_y_rad: Angle about the vertical, shape (n,).
        camera_T_lidar: Maps lidar to camera coordinates; None only exchanges the axes: x = z, y = -x, z = -y.

    Returns:
        Centres in lidar coordinates, sizes as length, width, height, and yaws.
    """
    if camera_T_lidar is None:
        x, y, z = bottom_m.T
        centre = np.column_stack([z, -x, -y])
    else:
        centre = transform_points(np.linalg.inv(camera_T_lidar), bottom_m)
    centre[:, 2] += size_hwl_m[:, 0] / 2
    return centre, size_hwl_m[:, ::-1].copy(), -rotation_y_rad - np.pi / 2


def lidar_from_camera(
    bottom_m: Float[np.ndarray, "n 3"],
    size_hwl_m: Float[np.ndarray, "n 3"],
    rotation_y_rad: Float[np.ndarray, " n"],
    camera_T_lidar: Float[np.ndarray, "4 4"] = CAMERA_T_LIDAR_AXES,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Convert boxes from the camera's to the lidar's convention.

    Args:
        bottom_m: Centres of the bottom faces, camera coordinates, shape (n, 3).
        size_hwl_m: Height, width, length, shape (n, 3).
        rotation_y_rad: Angle about the camera's y axis, shape (n,).
        camera_T_lidar: Maps lidar to camera coordinates.

    Returns:
        Centres in lidar coordinates, sizes as length, width, height, and yaws.
    """
    lidar_T_camera = np.linalg.inv(camera_T_lidar)
    centre_in_camera = bottom_m - np.array([0.0, 0.5, 0.0]) * size_hwl_m[:, :1]
    zero = np.zeros_like(rotation_y_rad)
    heading = np.stack([np.cos(rotation_y_rad), zero, -np.sin(rotation_y_rad)], 1) @ lidar_T_camera[:3, :3].T
    yaw = np.arctan2(heading[:, 1], heading[:, 0])
    return transform_points(lidar_T_camera, centre_in_camera), size_hwl_m[:, ::-1].copy(), yaw


def camera_from_lidar(
    centre_m: Float[np.ndarray, "n 3"],
    size_lwh_m: Float[np.ndarray, "n 3"],
    yaw_rad: Float[np.ndarray, " n"],
    camera_T_lidar: Float[np.ndarray, "4 4"] = CAMERA_T_LIDAR_AXES,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Convert boxes from the lidar's to the camera's convention: the inverse of :func:`lidar_from_camera`.

    The camera may be tilted by a few degrees: the heading is projected to its x-z plane, exact to second order.

    Returns:
        Centres of the bottom faces in camera coordinates, sizes as height, width, length, and ``rotation_y``.
    """
    centre_in_camera = transform_points(camera_T_lidar, centre_m)
    bottom = centre_in_camera + np.array([0.0, 0.5, 0.0]) * size_lwh_m[:, 2:]
    heading = np.stack([np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)], 1) @ camera_T_lidar[:3, :3].T
    return bottom, size_lwh_m[:, ::-1].copy(), np.arctan2(-heading[:, 2], heading[:, 0])
