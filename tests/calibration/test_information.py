"""Normalised information distance on a drawn wall: least at the truth, one where nothing is in common."""

import numpy as np

from farfield.calibration.camera_edges import move_camera
from farfield.calibration.checking import information_distance
from farfield.geometry.cameras import Camera

CAMERA = Camera(matrix=np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]]), width_px=320, height_px=240)


def wall(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A picture of 12-pixel patches, points on them, and the patches' grey seen by the LiDAR, squared and noisy."""
    grey = np.kron(rng.uniform(20, 235, (20, 27)), np.ones((12, 12)))[:, :320]
    pixels = rng.uniform([1, 1], [318, 238], (6000, 2))
    points = 20.0 * CAMERA.rays(pixels)
    column, row = np.floor(pixels).astype(int).T
    return grey.astype(np.uint8)[..., None].repeat(3, 2), points, grey[row, column] ** 2 + rng.normal(0, 30, 6000)


def test_it_is_least_at_the_truth() -> None:
    frames = [wall(np.random.default_rng(seed)) for seed in range(3)]
    columns = [list(each) for each in zip(*frames, strict=True)]
    right = information_distance(CAMERA, *columns)
    for turn in ([0.5, 0, 0], [-0.5, 0, 0], [0, 0.5, 0], [0, -0.5, 0]):
        assert (
            information_distance(move_camera(CAMERA, np.array([*np.radians(turn), 0, 0, 0])), *columns) > right + 0.01
        )


def test_nothing_in_common_is_one() -> None:
    picture, points, strength = wall(np.random.default_rng(0))
    assert information_distance(CAMERA, [picture], [-points], [strength]) == 1.0
    shuffled = np.random.default_rng(1).permutation(strength)
    assert information_distance(CAMERA, [picture], [points], [shuffled]) > 0.95
