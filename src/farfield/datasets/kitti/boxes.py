"""KITTI's camera-frame objects to lidar boxes and back (Geiger et al., CVPR 2012, object devkit readme).

KITTI gives the centre of a box's bottom face in rectified camera coordinates (x right, y down, z ahead), sizes as
height, width, length, and ``rotation_y`` about the camera's y axis, 0 along x.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from farfield.errors import DatasetError
from farfield.frame import Camera
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES
from farfield.geometry.poses import transform_points

_RECTIFIED_PX = {
    721.5377: (1242, 375),  # 2011_09_26
    707.0493: (1224, 370),  # 2011_09_28
    718.3351: (1238, 374),  # 2011_09_29
    707.0912: (1226, 370),  # 2011_09_30
    718.856: (1241, 376),  # 2011_10_03
}
_SAME_FOCAL_PX = 0.01


def camera_from_calib(calib: Mapping[str, np.ndarray]) -> Float[np.ndarray, "4 4"]:
    """Map of lidar to rectified camera coordinates: ``R0_rect @ Tr_velo_to_cam``.

    Args:
        calib: Matrices of a calibration file; KITTI tracking's ``R_rect`` and ``Tr_velo_cam`` do as well.

    Raises:
        DatasetError: If a matrix is missing.
    """
    rectify = next((calib[name] for name in ("R0_rect", "R_rect", "R0") if name in calib), None)
    motion = next((calib[name] for name in ("Tr_velo_to_cam", "Tr_velo_cam") if name in calib), None)
    if rectify is None or motion is None:
        raise DatasetError(f"calibration: expected R0_rect and Tr_velo_to_cam, got {', '.join(calib) or 'nothing'}")
    matrix = np.eye(4)
    matrix[:3] = _shaped(rectify, (3, 3), "R0_rect") @ _shaped(motion, (3, 4), "Tr_velo_to_cam")
    determinant = float(np.linalg.det(matrix[:3, :3]))
    if not 0.9 < determinant < 1.1:
        raise DatasetError(f"calibration: expected R0_rect @ Tr_velo_to_cam to rotate (1), got {determinant:.3g}")
    return matrix


def _shaped(matrix: np.ndarray, shape: tuple[int, int], name: str) -> np.ndarray:
    if matrix.shape != shape:
        raise DatasetError(f"calibration: expected {name} of shape {shape}, got {matrix.shape}")
    return np.asarray(matrix, dtype=np.float64)


def image_size(matrix: Float[np.ndarray, "3 3"]) -> tuple[int, int]:
    """Width and height of the rectified colour images of a calibration, where the image itself is absent.

    KITTI rectified each day's drives to a size of its own, which its focal length tells. The image of another
    calibration is taken to be twice as wide and high as its principal point lies from the corner: near enough to tell
    the field of view.

    >>> image_size(np.array([[721.5377, 0, 609.5593], [0, 721.5377, 172.854], [0, 0, 1]]))
    (1242, 375)
    """
    for focal_px, size in _RECTIFIED_PX.items():
        if abs(matrix[0, 0] - focal_px) < _SAME_FOCAL_PX:
            return size
    return max(round(2 * float(matrix[0, 2])) + 1, 1), max(round(2 * float(matrix[1, 2])) + 1, 1)


def camera_of(calib: Mapping[str, np.ndarray], *, width_px: int = 0, height_px: int = 0) -> Camera:
    """Build the left colour camera (P2) with its pose; P2's fourth column becomes an offset of the camera."""
    if "P2" not in calib:
        raise DatasetError(f"calibration: expected P2, got {', '.join(calib) or 'nothing'}")
    projection = _shaped(calib["P2"], (3, 4), "P2")
    if not abs(np.linalg.det(projection[:, :3])) > 1e-9:
        raise DatasetError(f"calibration: expected an invertible P2, got {projection.tolist()}")
    offset = np.eye(4)
    offset[:3, 3] = np.linalg.solve(projection[:, :3], projection[:, 3])
    return Camera(
        matrix=projection[:, :3].copy(),
        camera_T_lidar=offset @ camera_from_calib(calib),
        width_px=width_px,
        height_px=height_px,
    )


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
