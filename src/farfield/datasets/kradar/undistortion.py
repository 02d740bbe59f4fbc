"""How K-Radar's development kit straightens its pictures, with its slip, so that its projections can be reproduced.

The kit replaces the camera matrix K by the one of the straightened picture, K' (``getOptimalNewCameraMatrix`` with
alpha 0), and then gives K' also as the *input* matrix of ``initUndistortRectifyMap``. So a pixel of the straightened
picture is fetched from K' distort(ray) instead of K distort(ray): its pictures are a little off, and points projected
with K' fit them less well than they would fit pictures straightened without the slip.

Farfield's own projections use the raw pictures and :meth:`~farfield.geometry.cameras.Camera.project`, which needs none
of this.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, UInt8

from farfield.frame import Camera
from farfield.geometry.cameras import distort, undistort

_GRID = 9


def straightened_matrix(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """Camera matrix of a straightened picture of the same size that shows seen pixels only (alpha 0).

    The picture's border, sampled in a 9 x 9 grid, is straightened; the largest upright rectangle inside is scaled to
    the picture, as OpenCV's ``getOptimalNewCameraMatrix(matrix, distortion, size, alpha=0)`` does.

    Raises:
        ValueError: If the camera has no size, or its distortion cannot be undone within its picture.
    """
    width, height = camera.width_px, camera.height_px
    if width < 2 or height < 2:
        raise ValueError(f"straightened_matrix: expected a camera with its picture's size, got {width} x {height}")
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    x, y = undistort(_normalised(camera.matrix, pixels), camera.distortion).T.reshape(2, _GRID, _GRID)
    left, right, top, bottom = x[:, 0].max(), x[:, -1].min(), y[0].max(), y[-1].min()
    if not (left < right and top < bottom):  # also where a corner has no inverse and is NaN
        raise ValueError(f"straightened_matrix: the distortion {camera.distortion.tolist()} folds the picture over")
    fx, fy = (width - 1) / (right - left), (height - 1) / (bottom - top)
    return np.array([[fx, 0.0, -fx * left], [0.0, fy, -fy * top], [0.0, 0.0, 1.0]])


def straightened_camera(camera: Camera) -> Camera:
    """The camera without distortion that the development kit projects points with."""
    return replace(camera, matrix=straightened_matrix(camera), distortion=np.zeros(5))


def straightening_map(camera: Camera, *, devkit: bool) -> Float32[np.ndarray, "height width 2"]:
    """Where each pixel of the straightened picture is fetched from: column and row in the raw picture.

    Args:
        camera: The raw picture's camera.
        devkit: Repeat the development kit's slip: K' where K belongs.

    Returns:
        As OpenCV's ``initUndistortRectifyMap`` (its two maps stacked).
    """
    new = straightened_matrix(camera)
    u, v = np.meshgrid(np.arange(camera.width_px, dtype=np.float64), np.arange(camera.height_px, dtype=np.float64))
    bent = distort(_normalised(new, np.column_stack([u.ravel(), v.ravel()])), camera.distortion)
    used = new if devkit else camera.matrix
    source = bent * [used[0, 0], used[1, 1]] + used[:2, 2]
    return source.reshape(camera.height_px, camera.width_px, 2).astype(np.float32)


def straighten(
    image: UInt8[np.ndarray, "height width 3"], camera: Camera, *, devkit: bool = False
) -> UInt8[np.ndarray, "height width 3"]:
    """Straighten a picture, linear between pixels, black outside.

    Args:
        image: The raw picture of one eye.
        camera: Its camera.
        devkit: As in :func:`straightening_map`.
    """
    height, width = image.shape[:2]
    source = straightening_map(replace(camera, width_px=width, height_px=height), devkit=devkit).astype(np.float64)
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0))).astype(np.float32)
    column, row = (np.clip(source[..., axis], -1.0, limit) + 1.0 for axis, limit in ((0, width), (1, height)))
    left, top = np.minimum(column.astype(int), width), np.minimum(row.astype(int), height)
    right_share, low_share = (column - left)[..., None], (row - top)[..., None]
    upper = padded[top, left] * (1 - right_share) + padded[top, left + 1] * right_share
    lower = padded[top + 1, left] * (1 - right_share) + padded[top + 1, left + 1] * right_share
    return np.rint(upper * (1 - low_share) + lower * low_share).astype(np.uint8)


def _normalised(matrix: Float[np.ndarray, "3 3"], pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    return (pixels - matrix[:2, 2]) / [matrix[0, 0], matrix[1, 1]]
