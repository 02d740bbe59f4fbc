"""Values between messages and the calibration room's own types."""

from dataclasses import replace

import numpy as np

from farfield.calibration.edges import difference, moved
from farfield.calibration.radar_matching import RadarPose
from farfield.geometry.cameras import Camera
from farfield.studio.messages.calibration import CameraValues, RadarValues

Values = RadarValues | CameraValues


def pose_of(values: RadarValues) -> RadarPose:
    """A radar's pose from a message."""
    return RadarPose(**vars(values))


def radar_values(pose: RadarPose) -> RadarValues:
    """A radar's pose as a message."""
    return RadarValues(**vars(pose))


def camera_of(values: CameraValues, start: Camera) -> Camera:
    """A camera from a message.

    Args:
        values: Intrinsics, and moves from the start.
        start: The camera from which moves are counted.
    """
    matrix = np.array([[values.fx, 0.0, values.cx], [0.0, values.fy, values.cy], [0.0, 0.0, 1.0]])
    there = moved(start, np.array(values.moved, dtype=np.float64))
    return replace(there, matrix=matrix, distortion=np.array(values.distortion, dtype=np.float64))


def camera_values(camera: Camera, start: Camera) -> CameraValues:
    """A camera as a message; arguments as of :func:`camera_of`."""
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    k1, k2, p1, p2, k3 = camera.distortion.tolist()
    a, b, c, x, y, z = difference(camera, start).tolist()
    return CameraValues(fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3), moved=(a, b, c, x, y, z))


def same_lens(one: Camera, other: Camera) -> bool:
    """Whether two cameras have the same focal lengths, centre and distortion."""
    return bool(np.allclose(one.matrix, other.matrix, atol=1e-6) and np.allclose(one.distortion, other.distortion))
