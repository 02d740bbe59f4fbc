"""Rigid motions as 4 x 4 matrices. ``target_T_source`` maps source coordinates to target coordinates."""

import numpy as np
from jaxtyping import Float


def pose(rotation: Float[np.ndarray, "3 3"], translation_m: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """Build a pose from a rotation matrix and a translation in metres."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation_m
    return matrix


def pose_from_yaw(
    yaw_rad: float, translation_m: Float[np.ndarray, " 3"] | tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Float[np.ndarray, "4 4"]:
    """Build a pose that turns counter-clockwise about z and then moves."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return pose(
        np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.asarray(translation_m, dtype=np.float64)
    )


def invert(target_T_source: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Invert a rigid motion (transposed rotation, no matrix inversion)."""
    rotation = target_T_source[:3, :3]
    return pose(rotation.T, -rotation.T @ target_T_source[:3, 3])


def transform_points(
    target_T_source: Float[np.ndarray, "4 4"], points_m: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Map points from the source frame to the target frame, shape (n, 3), metres."""
    return points_m @ target_T_source[:3, :3].T + target_T_source[:3, 3]


def rotation_from_quaternion(quaternion_xyzw: Float[np.ndarray, "*shape 4"]) -> Float[np.ndarray, "*shape 3 3"]:
    """Rotation matrices of quaternions in the order x, y, z, w; any non-zero norm.

    Raises:
        ValueError: If a quaternion is zero or not finite.
    """
    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.isfinite(norm).all() or (norm == 0).any():
        raise ValueError("rotation_from_quaternion: expected finite quaternions that are not zero")
    x, y, z, w = np.moveaxis(q / norm, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def yaw_from_quaternion(quaternion_xyzw: Float[np.ndarray, "*shape 4"]) -> Float[np.ndarray, "*shape"]:
    """Yaw in radians of quaternions in the order x, y, z, w: the direction of the turned x axis seen from above."""
    rotation = rotation_from_quaternion(quaternion_xyzw)
    return np.asarray(np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]))


def quaternion_from_yaw(yaw_rad: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape 4"]:
    """Quaternions x, y, z, w of turns about z, shape (..., 4)."""
    half = np.asarray(yaw_rad, dtype=np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], -1)
