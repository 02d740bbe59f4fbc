"""Which way is up: clouds whose z points down, cameras that lie on their side or whose pose is the inverse."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from farfield.errors import FarfieldError
from farfield.frame import Camera
from farfield.inspection.doctor.findings import Finding
from farfield.inspection.doctor.survey import Survey

_LEAST_POINTS = 1_000
_LAYER_M = 0.2
_BESIDE_M = 0.5
_STANDING = 0.7  # cosine between the image's down and the ground's: 45 degrees


def clouds_upright(found: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Look for the densest layer, the ground: the rest of a cloud stands above it."""
    del facts
    points = [sample.points_m for sample in found.samples]
    z = np.concatenate(points)[:, 2] if points else np.zeros(0)
    z = z[np.isfinite(z)]
    if len(z) < _LEAST_POINTS:
        return
    low, high = np.percentile(z, [0.1, 99.9])
    counts, edges = np.histogram(z, np.arange(low, high + 2 * _LAYER_M, _LAYER_M))
    ground = float(edges[counts.argmax()] + _LAYER_M / 2)
    above, below = float((z > ground + _BESIDE_M).mean()), float((z < ground - _BESIDE_M).mean())
    if ground > _BESIDE_M and below > 0.02 and above < 0.2 * below:
        what = (
            f"the densest layer lies {ground:.1f} m above the sensor, {below:.0%} of the points below it and "
            f"{above:.0%} above: z seems to point down"
        )
        mend = "z points up and y left: from axes x ahead, y right, z down change the sign of y and z, of boxes too."
        yield Finding(severity="fail", topic="axes", what=what, mend=mend)


def cameras_upright(found: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Hold the cameras' poses against the ground: an image's lower edge points down."""
    del facts
    try:
        cameras = found.dataset[0].cameras if found.cameras and len(found.dataset) else {}
    except (FarfieldError, OSError, ValueError):
        return  # the survey has reported it
    for name, camera in cameras.items():
        down, inverse = _down(camera)
        if down > _STANDING:
            continue
        what = f"camera {name} lies on its side or its head (cosine between its down and the ground's: {down:.2f})"
        if inverse > _STANDING:
            what += "; it is upright if camera_T_lidar is inverted: the file holds lidar_T_camera"
        mend = "Give camera_T_lidar, which takes the lidar's points (z up) to the camera (x right, y down, z ahead)."
        yield Finding(severity="fail", topic="calibration", what=what, mend=mend)


def _down(camera: Camera) -> tuple[float, float]:
    """Cosine between the image's downward axis and the lidar's, of the pose and of its inverse."""
    turn = camera.camera_T_lidar[:3, :3]
    return float(-turn[1, 2]), float(-turn[2, 1])
