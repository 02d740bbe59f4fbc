"""Cameras: OpenCV's convention, round trips, the fold of the distortion polynomial."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES, Camera, distort, undistort
from farfield.geometry.poses import pose, rotation_from_quaternion

MATRIX = np.array([[1173.0, 0, 970.0], [0, 1174.0, 320.0], [0, 0, 1.0]])
BARREL = np.array([-0.3, 0.1, 0.001, -0.0005, -0.02])
PINCUSHION = np.array([0.15, 0.02, -0.001, 0.002, 0.003])


def camera(distortion: np.ndarray | None = None) -> Camera:
    mounting = pose(rotation_from_quaternion(np.array([0.02, -0.01, 0.03, 1.0])), np.array([0.1, 0.9, -1.1]))
    return Camera(
        matrix=MATRIX,
        distortion=np.zeros(5) if distortion is None else distortion,
        camera_T_lidar=mounting @ CAMERA_T_LIDAR_AXES,
        width_px=1920,
        height_px=650,
    )


def test_axes_by_hand() -> None:
    """A point ahead, to the left and above appears left of and above the principal point."""
    plain = Camera(matrix=MATRIX)
    pixels, depth_m, visible = plain.project(np.array([[10.0, 2.0, 1.0]]))
    np.testing.assert_allclose(pixels, [[970 - 1173 * 0.2, 320 - 1174 * 0.1]])
    assert depth_m.tolist() == [10.0]
    assert visible.all()


def test_distortion_term_by_term() -> None:
    """The formula of OpenCV's documentation, written out for one point (x, y) = (0.3, -0.2)."""
    point, x, y, r2 = np.array([[0.3, -0.2]]), 0.3, -0.2, 0.13
    cases = {
        0: (x * 0.1 * r2, y * 0.1 * r2),
        1: (x * 0.1 * r2**2, y * 0.1 * r2**2),
        2: (0.1 * 2 * x * y, 0.1 * (r2 + 2 * y * y)),
        3: (0.1 * (r2 + 2 * x * x), 0.1 * 2 * x * y),
        4: (x * 0.1 * r2**3, y * 0.1 * r2**3),
    }
    for index, (dx, dy) in cases.items():
        coefficients = np.zeros(5)
        coefficients[index] = 0.1
        np.testing.assert_allclose(distort(point, coefficients), [[x + dx, y + dy]], atol=1e-15)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([BARREL, PINCUSHION, np.zeros(5)]))
def test_undistort_inverts_distort(seed: int, distortion: np.ndarray) -> None:
    normalised = np.random.default_rng(seed).uniform(-0.55, 0.55, (40, 2))
    np.testing.assert_allclose(undistort(distort(normalised, distortion), distortion), normalised, atol=1e-10)


@pytest.mark.parametrize("distortion", [np.zeros(5), BARREL, PINCUSHION], ids=["none", "barrel", "pincushion"])
def test_rays_pass_through_the_points_that_were_projected(rng: np.random.Generator, distortion: np.ndarray) -> None:
    eye = camera(distortion)
    points_m = np.column_stack([rng.uniform(5, 250, 500), rng.uniform(-100, 100, 500), rng.uniform(-20, 20, 500)])
    pixels, depth_m, visible = eye.project(points_m)
    assert visible.sum() > 100
    centre_m = -eye.camera_T_lidar[:3, :3].T @ eye.camera_T_lidar[:3, 3]
    direction = points_m - centre_m
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    np.testing.assert_allclose(eye.rays(pixels[visible]), direction[visible], atol=1e-9)
    in_camera = points_m @ eye.camera_T_lidar[:3, :3].T + eye.camera_T_lidar[:3, 3]
    np.testing.assert_allclose(depth_m, in_camera[:, 2])


def test_behind_the_camera_is_nan_and_invisible() -> None:
    pixels, depth_m, visible = Camera(matrix=MATRIX).project(np.array([[-5.0, 0, 0], [0.05, 0, 0], [5.0, 0, 0]]))
    assert visible.tolist() == [False, False, True]
    assert np.isnan(pixels[:2]).all()
    np.testing.assert_allclose(depth_m, [-5.0, 0.05, 5.0])


def test_the_image_ends_half_a_pixel_beyond_its_outer_pixel_centres() -> None:
    plain = Camera(matrix=np.diag([1.0, 1.0, 1.0]), width_px=10, height_px=4)
    targets = np.array([[-0.5, 0], [-0.51, 0], [9.49, 3.49], [9.51, 0], [0, 3.51]])
    points_m = np.column_stack([np.ones(5), -targets[:, 0], -targets[:, 1]])
    assert plain.project(points_m)[2].tolist() == [True, False, True, False, False]


def test_points_beyond_the_fold_are_invisible_and_have_no_ray() -> None:
    """With k1 = -0.3 the radius r (1 - 0.3 r^2) turns back at r = 1 / sqrt(0.9): what lies outside folds inwards."""
    barrel = np.array([-0.3, 0, 0, 0, 0])
    fold = 1 / np.sqrt(0.9)
    wide = Camera(matrix=MATRIX, distortion=barrel, width_px=4000, height_px=4000)
    points_m = np.array([[1.0, -(fold - 0.01), 0], [1.0, -(fold + 0.01), 0], [1.0, -1.8, 0]])
    pixels, _, visible = wide.project(points_m)
    assert visible.tolist() == [True, False, False]
    assert np.isfinite(pixels).all()
    furthest = fold * (1 - 0.3 * fold**2)
    inside, outside = undistort(np.array([[furthest - 1e-4, 0.0], [furthest + 1e-3, 0.0]]), barrel)
    assert inside[0] == pytest.approx(fold, abs=0.02)
    assert inside[0] < fold
    assert np.isnan(outside).all()


def test_undistort_never_answers_with_a_point_beyond_the_fold() -> None:
    """Newton's method may land on the polynomial's other branch; such an answer is refused."""
    distortion = np.array([-0.4, 0.05, 0.002, -0.001, 0.01])
    grid = np.stack(np.meshgrid(np.linspace(-3, 3, 41), np.linspace(-3, 3, 41)), -1).reshape(-1, 2)
    found = undistort(grid, distortion)
    good = np.isfinite(found).all(axis=1)
    assert 0 < good.sum() < len(grid)
    np.testing.assert_allclose(distort(found[good], distortion), grid[good], atol=1e-9)
    slope = np.polynomial.Polynomial([1, 0, 3 * -0.4, 0, 5 * 0.05, 0, 7 * 0.01])
    fold = min(root.real for root in slope.roots() if abs(root.imag) < 1e-9 and root.real > 0)
    assert np.hypot(*found[good].T).max() < fold


def test_no_points_and_no_pixels() -> None:
    pixels, depth_m, visible = camera(BARREL).project(np.zeros((0, 3)))
    assert pixels.shape == (0, 2)
    assert depth_m.shape == visible.shape == (0,)
    assert camera(BARREL).rays(np.zeros((0, 2))).shape == (0, 3)


def test_each_camera_has_its_own_default_arrays() -> None:
    one, other = Camera(matrix=MATRIX), Camera(matrix=MATRIX)
    assert one.distortion is not other.distortion
    assert one.camera_T_lidar is not other.camera_T_lidar
