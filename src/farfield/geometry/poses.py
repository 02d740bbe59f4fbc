"""Rigid motions as 4 x 4 matrices. ``target_T_source`` maps source coordinates to target coordinates."""

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError

_NOT_ORTHONORMAL = 1e-3  # what calibrations of few digits leave; a longer scale moves a box at 250 m by 0.1 m
_LAST_ROW, _EYE = np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3)


def unrigid(target_T_source: Float[np.ndarray, "..."]) -> str:
    """What keeps a matrix from being a rigid motion, in words; empty where nothing does."""
    pose = np.asarray(target_T_source, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        return "numbers that are not finite" if pose.shape == (4, 4) else f"shape {pose.shape}"
    if np.abs(pose[3] - _LAST_ROW).max() > 1e-6:
        return f"the last row {pose[3].tolist()}"
    if np.abs(pose[:3, :3] @ pose[:3, :3].T - _EYE).max() > _NOT_ORTHONORMAL:
        return f"axes of length {np.round(np.linalg.norm(pose[:3, :3], axis=0), 4).tolist()}, or not at right angles"
    return "a mirror: its determinant is -1" if np.linalg.det(pose[:3, :3]) < 0 else ""


def check_rigid(target_T_source: Float[np.ndarray, "4 4"], what: str) -> None:
    """Refuse what is no rigid motion: boxes and clouds would be mirrored, stretched or lost.

    Args:
        target_T_source: The motion.
        what: Who takes it, for the message.

    Raises:
        ConfigError: If it has a number that is not finite, a scale, shear or mirror, or a last row that is not 0 0 0 1.
    """
    fault = unrigid(target_T_source)
    if fault:
        raise ConfigError(
            f"{what}: expected a rigid motion (a rotation and a translation in metres, 4 x 4, last row 0 0 0 1), got "
            f"{fault}. Take the scale or mirror out of the matrix, or apply it to points and boxes before they are "
            "made into a frame"
        )


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


def exponential(twist: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 4 4"]:
    """Rigid motions of twists (rotation vector, then translation part), shape (n, 6) (Sola et al. 2018, eq. 172)."""
    turn, along = twist[:, :3], twist[:, 3:]
    a, b, c = _coefficients(turn)
    hat, square = _hat(turn)
    eye = np.eye(3)
    motion = np.zeros((len(twist), 4, 4))
    motion[:, :3, :3] = eye + a * hat + b * square
    motion[:, :3, 3] = ((eye + b * hat + c * square) @ along[:, :, None])[:, :, 0]
    motion[:, 3, 3] = 1
    return motion


def logarithm(motion: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 6"]:
    """Twists of rigid motions whose turn is less than half a revolution, shape (n, 6); the inverse of the above."""
    turn = _rotation_vector(motion[:, :3, :3])
    _, b, c = _coefficients(turn)
    hat, square = _hat(turn)
    left = np.eye(3) + b * hat + c * square
    along = np.linalg.solve(left, motion[:, :3, 3:])[:, :, 0]
    return np.concatenate([turn, along], axis=1)


def _coefficients(turn: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``sin x / x``, ``(1 - cos x) / x^2`` and ``(x - sin x) / x^3`` of the angles, each of shape (n, 1, 1)."""
    angle = np.linalg.norm(turn, axis=1)[:, None, None]
    small = angle < 1e-3  # the series' next terms are below 1e-14
    x = np.where(small, 1.0, angle)
    a = np.where(small, 1 - angle**2 / 6, np.sin(x) / x)
    b = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(x)) / x**2)
    c = np.where(small, 1 / 6 - angle**2 / 120, (x - np.sin(x)) / x**3)
    return a, b, c


def _hat(turn: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Matrices of the cross product, and their squares, each of shape (n, 3, 3)."""
    x, y, z = turn.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    hat = np.stack([np.stack(row, -1) for row in rows], -2)
    return hat, hat @ hat


def _rotation_vector(rotation: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Axis times angle, by way of scipy."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec(), dtype=np.float64).reshape(-1, 3)


def quaternion_from_rotation(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 4"]:
    """The quaternion x, y, z, w of a rotation matrix, w >= 0 (Shepperd 1978: by the largest of its numbers)."""
    m = np.asarray(rotation, dtype=np.float64)
    squares = 1 + np.array([1.0, -1.0, -1.0, 1.0]) * m[0, 0]
    squares = squares + np.array([-1.0, 1.0, -1.0, 1.0]) * m[1, 1] + np.array([-1.0, -1.0, 1.0, 1.0]) * m[2, 2]
    largest = int(squares.argmax())
    sums, differences = m + m.T, m - m.T
    rows = (
        (squares[0], sums[0, 1], sums[0, 2], differences[2, 1]),
        (sums[0, 1], squares[1], sums[1, 2], differences[0, 2]),
        (sums[0, 2], sums[1, 2], squares[2], differences[1, 0]),
        (differences[2, 1], differences[0, 2], differences[1, 0], squares[3]),
    )
    quaternion = np.array(rows[largest])
    quaternion /= np.linalg.norm(quaternion)
    return -quaternion if quaternion[3] < 0 else quaternion
