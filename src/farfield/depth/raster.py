"""Depths by pixel: points projected, what is hidden left out, and a drawn raster blended into a map.

A LiDAR beside a camera looks past the silhouettes that the camera sees: points of the background then fall into the
pixels of near objects. :func:`blend_raster` is a normalised convolution (Knutsson and Westin, CVPR 1993) of 1 / z with
a Gaussian: pixels with a depth count, others do not. Over a step in depth the mean of 1 / z lies between near and far;
that costs less than to gamble on one of them, and the doubt says so.
"""

from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32

from farfield.geometry.cameras import Camera

NEAREST_M = 0.5
"""Points nearer to the image plane than this are left out: they are the car's own."""
SLOPE, STEP_M = 0.05, 0.4
"""A depth is hidden by one nearby that is nearer by more than 5 % and 0.4 m; the slope spares grazing ground."""
SIGMA_PX, RADIUS_PX = 1.5, 4
_LEAST_WEIGHT = 1e-4
_HOLE_M = 0.3  # doubt for each pixel to the nearest that has a depth


class DepthRaster(NamedTuple):
    """Depths by pixel.

    Args:
        depth_m: Depth along the optical axis, inf for none, shape (h, w).
        doubt_m: How far what it was interpolated from disagrees, 0 where it was measured, shape (h, w).
    """

    depth_m: Float[np.ndarray, "h w"]
    doubt_m: Float[np.ndarray, "h w"]


def sparse_depth(points_m: Float[np.ndarray, "n 3"], camera: Camera) -> Float[np.ndarray, "h w"]:
    """Depth along the optical axis of the nearest point in each pixel; inf where there is none.

    Args:
        points_m: Points in the coordinates that the camera's pose refers to, shape (n, 3).
        camera: The camera, with its size; the whole distortion is applied.

    Returns:
        Metres, shape (height, width). Pixels are rounded: their centres stand at whole numbers.
    """
    pixels, depth, visible = camera.project(points_m, min_depth_m=NEAREST_M)
    uv = np.rint(pixels[visible]).astype(np.int64)
    nearest = np.full(camera.height_px * camera.width_px, np.inf)
    np.minimum.at(nearest, uv[:, 1] * camera.width_px + uv[:, 0], depth[visible])
    return nearest.reshape(camera.height_px, camera.width_px)


def remove_hidden(depth_m: Float[np.ndarray, "h w"], window: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Leave out depths that something nearer hides, by the least depth in a window round each.

    Args:
        depth_m: Depths, inf for none, shape (h, w).
        window: Rows and columns of the window: of a sparse map 0.7 of the spacing of its lines, of a dense one 3.
    """
    from scipy import ndimage

    least = ndimage.minimum_filter(depth_m, size=window, mode="nearest")
    return np.where(is_visible(depth_m, least), depth_m, np.inf)


def is_visible(depth_m: Float[np.ndarray, "*n"], surface_m: Float[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
    """Whether depths do not lie behind a surface: beyond 5 % and 0.4 m of it. A surface at inf hides nothing."""
    return depth_m <= (1 + SLOPE) * surface_m + STEP_M


def blend_raster(raster: DepthRaster, *, compiled: bool | None = None) -> DepthRaster:
    """Leave out what is hidden and blend the rest; pixels further than 4 px from all that have a depth stay empty.

    The doubt becomes the mean of the neighbours', plus their spread in depth, plus 0.3 m for each pixel to them.

    Args:
        raster: What was drawn, depth inf where nothing was.
        compiled: Whether numba does it (default: where it is installed).

    Returns:
        Depth and doubt, inf where nothing is near, shape (h, w).
    """
    half = np.exp(-0.5 * (np.arange(RADIUS_PX + 1) / SIGMA_PX) ** 2)
    half = (half / (2 * half.sum() - half[0])).astype(np.float32)
    channels = np.zeros((4, *raster.depth_m.shape), dtype=np.float32)
    if find_spec("numba") is not None if compiled is None else compiled:
        from farfield.depth.compiled import blend, channels_of

        channels_of(raster.depth_m, raster.doubt_m, SLOPE, STEP_M, channels)
        depth, doubt = np.full((2, *raster.depth_m.shape), np.inf, dtype=np.float32)
        blend(channels, half, np.array([_LEAST_WEIGHT, SIGMA_PX, _HOLE_M], dtype=np.float32), depth, doubt)
        return DepthRaster(depth, doubt)

    # 1. Weight, 1 / z, its square and the doubt of what is visible.
    visible_m = remove_hidden(raster.depth_m, (3, 3))
    has_depth = np.isfinite(visible_m)
    channels[0] = has_depth
    channels[1][has_depth] = 1 / visible_m[has_depth]
    channels[2] = channels[1] ** 2
    channels[3][has_depth] = raster.doubt_m[has_depth]

    # 2. Convolve, and divide by the weight.
    weight, mean, square, doubt = _convolve(channels, half)
    filled = weight > _LEAST_WEIGHT
    divisor = np.where(filled, weight, np.float32(1))
    mean = np.where(filled, mean / divisor, np.float32(1))

    # 3. Doubt: the neighbours', their spread in depth, and how far away they are.
    spread = np.sqrt(np.maximum(square / divisor - mean * mean, 0)) / (mean * mean)
    away = SIGMA_PX * np.sqrt(-2 * np.log(np.clip(weight, _LEAST_WEIGHT, 1)))
    total = doubt / divisor + spread + np.float32(_HOLE_M) * away
    return DepthRaster(np.where(filled, 1 / mean, np.inf), np.where(filled, total, np.inf))


def _convolve(channels: Float32[np.ndarray, "4 h w"], half: Float32[np.ndarray, " k"]) -> Float32[np.ndarray, "4 h w"]:
    """With a symmetric kernel, along rows and columns; ``half`` is it from its middle outwards."""
    from scipy import ndimage

    kernel = np.concatenate([half[:0:-1], half])
    for axis in (1, 2):
        channels = ndimage.correlate1d(channels, kernel, axis=axis, mode="constant")
    return channels
