"""Pictures of a calibration before and after: edges in the image, both sensors from above."""

import numpy as np
from jaxtyping import Float, UInt8

from farfield.calibration.bird import bird_map
from farfield.calibration.jobs import CameraJob, RadarJob
from farfield.calibration.radar_matching import RadarPose
from farfield.geometry.cameras import Camera

_SCALE = 4
_BEFORE, _AFTER = (255, 64, 64), (64, 255, 64)


def camera_calibration_picture(job: CameraJob) -> UInt8[np.ndarray, "height width 3"]:
    """The first frame twice, one above the other, with the LiDAR's depth edges: red before, green after."""
    own = job.views.points_m[job.views.frame == 0]
    halves = [
        _draw_edges(job.picture, camera, own, ink) for camera, ink in ((job.before, _BEFORE), (job.after, _AFTER))
    ]
    return np.concatenate(halves)


def _draw_edges(
    picture: UInt8[np.ndarray, "height width 3"],
    camera: Camera,
    points_m: Float[np.ndarray, "n 3"],
    ink: tuple[int, int, int],
) -> UInt8[np.ndarray, "height width 3"]:
    image = (picture * 0.7).astype(np.uint8)
    pixels, _, visible = camera.project(points_m)
    column, row = np.clip(pixels[visible].round().astype(int), 0, [image.shape[1] - 2, image.shape[0] - 2]).T
    for down in (0, 1):
        for right in (0, 1):
            image[row + down, column + right] = ink
    return image


def radar_calibration_picture(job: RadarJob) -> UInt8[np.ndarray, "height width 3"]:
    """The middle frame's radar power (blue) under the LiDAR's points, from above; before left, after right."""
    middle = len(job.moments) // 2
    halves = [
        _draw_from_above(job, middle, pose, ink) for pose, ink in ((job.before, _BEFORE), (job.found.pose, _AFTER))
    ]
    return np.concatenate([halves[0], np.full((len(halves[0]), 8, 3), 255, np.uint8), halves[1]], axis=1)


def _draw_from_above(
    job: RadarJob, index: int, pose: RadarPose, ink: tuple[int, int, int]
) -> UInt8[np.ndarray, "height width 3"]:
    lidar = job.moments[index]
    radar = next((each for each in job.moments if each.number == lidar.number + pose.frames), lidar)
    power = np.clip(bird_map(radar.echoes_m, radar.power_db) / 25.0, 0.0, 1.0)
    cos, sin = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
    x, y = lidar.points_m[:, 0], lidar.points_m[:, 1]
    at = np.column_stack([cos * x - sin * y + pose.x_m, sin * x + cos * y + pose.y_m])
    image = np.zeros((*(_SCALE * np.array(power.shape)), 3), dtype=np.uint8)
    image[..., 2] = np.kron(255 * power, np.ones((_SCALE, _SCALE))).astype(np.uint8)
    image[..., 1] = image[..., 2] // 2
    cell = np.floor(at * _SCALE / 0.4).astype(int) + np.array([0, image.shape[1] // 2])
    inside = ((cell >= 0) & (cell < image.shape[:2])).all(axis=1)
    image[cell[inside, 0], cell[inside, 1]] = ink
    return image[::-1, ::-1].copy()  # ahead is up, left is left
