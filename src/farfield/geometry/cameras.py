"""Pinhole cameras with Brown-Conrady distortion: projection and undistortion.

Camera axes: x right, y down, z forward. Pixel centres at integer coordinates, u to the right, v down.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from farfield.geometry.arrays import Locked
from farfield.geometry.boxes import Boxes
from farfield.geometry.poses import transform_points

# lidar (x forward, y left, z up) to camera (x right, y down, z forward) axes, no translation
CAMERA_T_LIDAR_AXES = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
_NO_DISTORTION = np.zeros(5)


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera(Locked):
    """A calibrated camera.

    Args:
        matrix: Intrinsics [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, shape (3, 3).
        distortion: Brown-Conrady coefficients k1, k2, p1, p2, k3 (OpenCV's order), shape (5,).
        camera_T_lidar: Maps lidar coordinates (x forward, y left, z up) to camera coordinates, shape (4, 4).
        width_px: Image width.
        height_px: Image height.
    """

    matrix: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, " 5"] = field(default_factory=lambda: _NO_DISTORTION.copy())
    camera_T_lidar: Float[np.ndarray, "4 4"] = field(default_factory=lambda: CAMERA_T_LIDAR_AXES.copy())
    width_px: int = 0
    height_px: int = 0

    def __post_init__(self) -> None:
        self.lock()

    def project(
        self, points_m: Float[np.ndarray, "n 3"], *, min_depth_m: float = 0.1
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Project lidar points into the image.

        Args:
            points_m: Points in lidar coordinates, shape (n, 3).
            min_depth_m: Points nearer to the image plane than this are not visible.

        Returns:
            Pixels u, v, shape (n, 2) (NaN behind the camera); depths along the optical axis in metres, shape (n,);
            and whether each point falls into the image, shape (n,).
        """
        in_camera = transform_points(self.camera_T_lidar, points_m.astype(np.float64))
        depth = in_camera[:, 2]
        ahead = depth > min_depth_m
        pixels = np.full((len(points_m), 2), np.nan)
        normalised = in_camera[ahead, :2] / depth[ahead, None]
        valid = _within_fold(normalised, self.distortion)
        pixels[ahead] = (
            distort(normalised, self.distortion) * [self.matrix[0, 0], self.matrix[1, 1]] + self.matrix[:2, 2]
        )
        visible = ahead.copy()
        visible[ahead] = valid
        if self.width_px and self.height_px:
            with np.errstate(invalid="ignore"):
                visible &= ((pixels >= -0.5) & (pixels < [self.width_px - 0.5, self.height_px - 0.5])).all(axis=1)
        return pixels, depth, visible

    def rays(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Directions of pixels in lidar coordinates, unit length, shape (n, 3): the inverse of ``project``."""
        normalised = undistort((pixels - self.matrix[:2, 2]) / [self.matrix[0, 0], self.matrix[1, 1]], self.distortion)
        in_camera = np.column_stack([normalised, np.ones(len(pixels))])
        directions = in_camera @ self.camera_T_lidar[:3, :3]
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def distort(normalised: Float[np.ndarray, "n 2"], distortion: Float[np.ndarray, " 5"]) -> Float[np.ndarray, "n 2"]:
    """Apply Brown-Conrady distortion (Brown 1966; OpenCV's order k1, k2, p1, p2, k3) to normalised coordinates."""
    k1, k2, p1, p2, k3 = distortion
    x, y = normalised[:, 0], normalised[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], 1
    )


def undistort(
    distorted: Float[np.ndarray, "n 2"], distortion: Float[np.ndarray, " 5"], *, iterations: int = 20
) -> Float[np.ndarray, "n 2"]:
    """Invert :func:`distort` by Newton's method on the 2 x 2 Jacobian.

    Points beyond the fold of the distortion polynomial have no inverse; they come back as NaN.
    """
    guess = np.array(distorted, dtype=np.float64)
    if not np.any(distortion):
        return guess
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # points without an inverse run away
        for _ in range(iterations):
            error = distort(guess, distortion) - distorted
            (xx, xy), (yx, yy) = _distortion_jacobian(guess, distortion)
            determinant = xx * yy - xy * yx
            guess[:, 0] -= (yy * error[:, 0] - xy * error[:, 1]) / determinant
            guess[:, 1] -= (xx * error[:, 1] - yx * error[:, 0]) / determinant
        residual = np.abs(distort(guess, distortion) - distorted).max(axis=1, initial=0.0)
        tolerance = 1e-12 * np.maximum(1.0, np.abs(distorted).max(axis=1, initial=0.0))
        has_inverse = (residual < tolerance) & _within_fold(guess, distortion)
    guess[~has_inverse] = np.nan
    return guess


def _distortion_jacobian(
    normalised: Float[np.ndarray, "n 2"], distortion: Float[np.ndarray, " 5"]
) -> Float[np.ndarray, "2 2 n"]:
    k1, k2, p1, p2, k3 = distortion
    x, y = normalised[:, 0], normalised[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    growth = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial / d r2, times 2
    mixed = growth * x * y + 2 * (p1 * x + p2 * y)
    xx = radial + growth * x * x + 2 * p1 * y + 6 * p2 * x
    yy = radial + growth * y * y + 6 * p1 * y + 2 * p2 * x
    return np.array([[xx, mixed], [mixed, yy]])


def _within_fold(normalised: Float[np.ndarray, "n 2"], distortion: Float[np.ndarray, " 5"]) -> Bool[np.ndarray, " n"]:
    """Whether the radial polynomial still grows with the radius: beyond its fold far-off points land in the image."""
    fold = fold_radius(distortion)
    if np.isinf(fold):
        return np.ones(len(normalised), dtype=np.bool_)
    return np.hypot(normalised[:, 0], normalised[:, 1]) < fold


def fold_radius(distortion: Float[np.ndarray, " 5"]) -> float:
    """Radius in normalised coordinates from which on the radial polynomial falls; inf where it never does."""
    k1, k2, _, _, k3 = distortion
    if not (k1 or k2 or k3):
        return float("inf")
    slope = np.polynomial.Polynomial([1.0, 3 * k1, 5 * k2, 7 * k3])  # d/dr of r (1 + k1 r^2 + ...), in r^2
    roots = slope.roots()
    turning = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(np.sqrt(turning.min())) if turning.size else float("inf")


# Where boxes appear in a camera's image.


def image_boxes(boxes: Boxes, camera: Camera) -> tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, " n"]]:
    """2D boxes round the projected corners, cut at the image, and the share that is cut off.

    Returns:
        left, top, right, bottom, shape (n, 4), -1 where nothing is seen; truncation in [0, 1], shape (n,).
    """
    pixels, _, _ = camera.project(boxes.corners_m().reshape(-1, 3))
    pixels = pixels.reshape(-1, 8, 2)
    ahead = np.isfinite(pixels).all(axis=(1, 2))
    filled = np.where(ahead[:, None, None], pixels, 0.0)
    low, high = filled.min(axis=1), filled.max(axis=1)
    limit = np.array([camera.width_px or np.inf, camera.height_px or np.inf]) - 1
    low_cut, high_cut = np.clip(low, 0, limit), np.clip(high, 0, limit)
    area, cut = np.prod(high - low, axis=1), np.prod(high_cut - low_cut, axis=1)
    visible = ahead & (cut > 0)
    box_px = np.where(visible[:, None], np.column_stack([low_cut, high_cut]), -1.0)
    truncation = np.where(visible, 1 - cut / np.maximum(area, 1e-9), 1.0)
    return box_px, np.clip(truncation, 0.0, 1.0)
