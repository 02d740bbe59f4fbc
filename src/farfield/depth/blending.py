"""From a drawn surface to a depth map: holes of a few pixels closed, steps softened, and how sure each pixel is.

Normalised convolution (Knutsson and Westin, CVPR 1993) of 1 / z with a Gaussian: what is known counts, what is not does
not. Over a step in depth the mean of 1 / z lies between near and far; that costs less than to gamble on one of them,
and the doubt says so.
"""

from importlib.util import find_spec

import numpy as np
from jaxtyping import Float32

from farfield.depth.sparse import SLOPE, STEP_M, remove_hidden
from farfield.depth.surface import DepthRaster

SIGMA_PX, RADIUS_PX = 1.5, 4
_LEAST_WEIGHT = 1e-4
_HOLE_M = 0.3  # doubt for each pixel to the nearest that is known


def blend_raster(raster: DepthRaster, *, compiled: bool | None = None) -> DepthRaster:
    """Leave out what is hidden and blend the rest; pixels further than 4 px from all that is known stay empty.

    The doubt becomes the mean of the neighbours', plus their spread in depth, plus 0.3 m for each pixel to them.

    Args:
        raster: What was drawn, depth inf where nothing was.
        compiled: Whether numba does it; where it is installed unless given.

    Returns:
        Depth and doubt, inf where nothing is near, shape (h, w).
    """
    half = np.exp(-0.5 * (np.arange(RADIUS_PX + 1) / SIGMA_PX) ** 2)
    half = (half / (2 * half.sum() - half[0])).astype(np.float32)
    channels = np.zeros((4, *raster.depth_m.shape), dtype=np.float32)
    if find_spec("numba") is not None if compiled is None else compiled:
        from farfield.depth.compiled import blend, channels_of

        channels_of(raster.depth_m, raster.doubt_m, SLOPE, STEP_M, channels)
        depth, far = np.full((2, *raster.depth_m.shape), np.inf, dtype=np.float32)
        blend(channels, half, np.array([_LEAST_WEIGHT, SIGMA_PX, _HOLE_M], dtype=np.float32), depth, far)
        return DepthRaster(depth, far)
    weight, mean, square, doubt = _smoothed(_channels(raster, channels), half)
    filled = weight > _LEAST_WEIGHT
    divisor = np.where(filled, weight, np.float32(1))
    mean = np.where(filled, mean / divisor, np.float32(1))
    spread = np.sqrt(np.maximum(square / divisor - mean * mean, 0)) / (mean * mean)
    away = SIGMA_PX * np.sqrt(-2 * np.log(np.clip(weight, _LEAST_WEIGHT, 1)))
    total = doubt / divisor + spread + np.float32(_HOLE_M) * away
    return DepthRaster(np.where(filled, 1 / mean, np.inf), np.where(filled, total, np.inf))


def _channels(raster: DepthRaster, channels: Float32[np.ndarray, "4 h w"]) -> Float32[np.ndarray, "4 h w"]:
    """Weight, 1 / z, its square and the doubt."""
    shown = remove_hidden(raster.depth_m, (3, 3))
    known = np.isfinite(shown)
    channels[0] = known
    channels[1][known] = 1 / shown[known]
    channels[2] = channels[1] ** 2
    channels[3][known] = raster.doubt_m[known]
    return channels


def _smoothed(channels: Float32[np.ndarray, "4 h w"], half: Float32[np.ndarray, " k"]) -> Float32[np.ndarray, "4 h w"]:
    from scipy import ndimage

    kernel = np.concatenate([half[:0:-1], half])
    for axis in (1, 2):
        channels = ndimage.correlate1d(channels, kernel, axis=axis, mode="constant")
    return channels
