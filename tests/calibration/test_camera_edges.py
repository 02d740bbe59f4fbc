"""LiDAR to camera on a drawn scene: picked pairs with outliers, edges aligned from a degree away."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.calibration.camera_edges import (
    EdgeResiduals,
    align_edges,
    camera_difference,
    edge_residuals,
    edge_score,
    edge_uncertainty,
    edge_views,
    move_camera,
)
from farfield.calibration.camera_pairs import calibrate_pairs
from farfield.calibration.depth_edges import lidar_edges
from farfield.errors import ConfigError
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, transform_points

CAMERA = Camera(matrix=np.array([[300.0, 0, 320], [0, 300.0, 180], [0, 0, 1]]), width_px=640, height_px=360)


def scene(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture, sweep and rings of boards of different grey before a wall."""
    boards = [
        (x, y, y + rng.uniform(1, 2.5), z, z + rng.uniform(0.8, 2), rng.uniform(0, 255))
        for x, y, z in zip(rng.uniform(6, 22, 14), rng.uniform(-12, 10, 14), rng.uniform(-2, 2, 14), strict=True)
    ]
    u, v = np.meshgrid(np.arange(640.0), np.arange(360.0))
    rays = CAMERA.rays(np.column_stack([u.ravel(), v.ravel()]))
    _, grey = cast(rays, boards, transform_points(invert(CAMERA.camera_T_lidar), np.zeros((1, 3)))[0])
    azimuth, ring = np.meshgrid(np.radians(np.arange(-50, 50, 0.18)), np.arange(64))
    elevation = np.radians(-22.5 + 45 * ring / 63)
    flat = np.cos(elevation)
    shots = np.column_stack([a.ravel() for a in (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation))])
    reach, _ = cast(shots, boards, np.zeros(3))
    return np.repeat(grey.reshape(360, 640, 1), 3, 2).astype(np.uint8), shots * reach[:, None], ring.ravel()


def cast(rays: np.ndarray, boards: list[tuple[float, ...]], origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    reach, grey = (40 - origin[0]) / rays[:, 0], np.full(len(rays), 128.0)
    for x, left, right, low, high, shade in boards:
        along = (x - origin[0]) / rays[:, 0]
        at = origin + rays * along[:, None]
        hit = (at[:, 1] > left) & (at[:, 1] < right) & (at[:, 2] > low) & (at[:, 2] < high) & (along < reach)
        reach[hit], grey[hit] = along[hit], shade
    return reach, grey


@pytest.fixture(scope="module")
def scenes() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    return [scene(np.random.default_rng(seed)) for seed in range(8)]


def test_edges_bring_a_camera_back(scenes: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    start = move_camera(CAMERA, np.array([*np.radians([0.6, -0.8, 0.7]), 0.06, -0.05, 0.08]))
    edges = [lidar_edges(points, ring) for _, points, ring in scenes]
    views = edge_views([picture for picture, _, _ in scenes], edges, start)
    found = align_edges(start, views)
    away = camera_difference(found, CAMERA)
    assert (np.degrees(np.abs(away[:3])) < [0.45, 0.15, 0.2]).all()  # rings are 0.7 degrees apart: pitch is worst
    assert np.abs(away[3:]).max() < 0.1
    assert edge_score(found, views).mean() > edge_score(start, views).mean()
    residuals = edge_residuals(found, views)
    assert residuals.median_px is not None
    assert residuals.median_px < 1.5
    sigma, _ = edge_uncertainty(found, views)
    assert (sigma > 0).all()


def test_edge_residuals_tell_less_than_half_a_pixel(scenes: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    edges = [lidar_edges(points, ring) for _, points, ring in scenes]
    views = edge_views([picture for picture, _, _ in scenes], edges, CAMERA)
    columns = {name: getattr(views, name)[views.axis == 0] for name in ("points_m", "frame", "axis", "weight")}
    upright = replace(views, **columns)
    medians = []
    for right_px in (-0.2, 0.0, 0.2, 0.4):
        matrix = CAMERA.matrix + np.array([[0, 0, right_px], [0, 0, 0], [0, 0, 0]])
        medians.append(float(np.median(edge_residuals(replace(CAMERA, matrix=matrix), upright).across_px)))
    assert np.diff(medians) == pytest.approx([-0.2] * 3, abs=0.08)


def test_the_median_residual_counts_each_edge_as_the_score_does() -> None:
    across = np.array([-1.0, 3.0, 0.5, 4.0])
    for weight, median in (([1, 1, 1, 0], 1.0), ([1, 5, 1, 1], 3.0), ([1, 1, 6, 1], 0.5)):
        assert EdgeResiduals(across_px=across, weight=np.array(weight, dtype=float)).median_px == median
    assert EdgeResiduals(across_px=np.zeros(0), weight=np.zeros(0)).median_px is None


def test_a_jump_is_an_edge_and_a_slope_is_none() -> None:
    azimuth, ring = np.meshgrid(np.radians(np.arange(-20, 20, 0.18)), np.arange(-20, -2))
    down = np.radians(-ring * 0.7)
    reach = 1.7 / np.sin(down)
    flat = reach * np.cos(down)
    ground = np.column_stack([a.ravel() for a in (flat * np.cos(azimuth), flat * np.sin(azimuth), -1.7 + 0 * down)])
    found = lidar_edges(ground, ring.ravel() + 20)
    assert len(found.upright_m) == 0
    assert len(found.level_m) == 0


def picks(rng: np.random.Generator, count: int, noise_px: float) -> tuple[np.ndarray, np.ndarray]:
    points = np.column_stack([rng.uniform(6, 30, 400), rng.uniform(-20, 20, 400), rng.uniform(-2, 5, 400)])
    points = points[CAMERA.project(points)[2]][:count]
    return points, CAMERA.project(points)[0] + rng.normal(0, noise_px, (count, 2))


def test_eight_pairs_are_enough() -> None:
    pytest.importorskip("cv2")
    turns = []
    for seed in range(12):
        points, pixels = picks(np.random.default_rng(seed), 8, 1.0)
        found = calibrate_pairs(points, pixels, replace(CAMERA, camera_T_lidar=np.eye(4)))
        turns.append(np.degrees(np.linalg.norm(camera_difference(found.camera, CAMERA)[:3])))
    assert np.median(turns) < 0.5


def test_a_wrong_pick_does_not_pull() -> None:
    pytest.importorskip("cv2")
    points, pixels = picks(np.random.default_rng(3), 20, 1.0)
    pixels[:4] += 80
    found = calibrate_pairs(points, pixels, replace(CAMERA, camera_T_lidar=np.eye(4)))
    assert not found.inlier[:4].any()
    assert np.degrees(np.linalg.norm(camera_difference(found.camera, CAMERA)[:3])) < 0.5


def test_a_guessed_focal_length_is_found() -> None:
    pytest.importorskip("cv2")
    points, pixels = picks(np.random.default_rng(4), 16, 0.3)
    matrix = CAMERA.matrix * np.array([[1.25, 1, 1], [1, 1.25, 1], [1, 1, 1]])
    found = calibrate_pairs(points, pixels, replace(CAMERA, matrix=matrix, camera_T_lidar=np.eye(4)), focal=True)
    assert abs(found.camera.matrix[0, 0] / 300 - 1) < 0.03


def test_too_few_pairs_are_refused() -> None:
    with pytest.raises(ConfigError, match="expected 12 points"):
        calibrate_pairs(*picks(np.random.default_rng(0), 8, 1.0), CAMERA, focal=True)
