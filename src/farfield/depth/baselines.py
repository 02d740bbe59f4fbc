"""What depth maps are compared with: the nearest measured pixel, and the rules of IP-Basic.

IP-Basic (Ku, Harakeh and Waslander, "In Defense of Classical Image Processing: Fast Depth Completion on the CPU", CRV
2018, section III), written anew from the paper's description.
"""

import numpy as np
from jaxtyping import Bool, Float

_LEAST_M = 0.1


def nearest_depth(depth_m: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Give every pixel the depth of the nearest pixel that has one; inf stands for none.

    Args:
        depth_m: Depths, inf for none, shape (h, w).
    """
    from scipy import ndimage

    if not np.isfinite(depth_m).any():
        return depth_m
    rows, columns = ndimage.distance_transform_edt(~np.isfinite(depth_m), return_distances=False, return_indices=True)
    return depth_m[rows, columns]


def ip_basic(
    depth_m: Float[np.ndarray, "h w"], *, stretch: int = 1, far_m: float = 100.0, extrapolate: bool = True
) -> Float[np.ndarray, "h w"]:
    """Complete a sparse map by IP-Basic's eight steps, with its Gaussian.

    Invert, dilate with a diamond of 5, close with a square of 5, fill what is empty by a dilation of 7, carry each
    column's top up and fill the rest by a dilation of 31, take the median of 5 and a Gaussian of 5, invert back.

    Args:
        depth_m: Depths, inf for none, shape (h, w).
        stretch: Factor on the heights of all kernels, which are made for 64 lines: 4 for 16 lines.
        far_m: Depth that inverts to 0; farther ones count as empty, as in the paper.
        extrapolate: Whether to do the step that fills up to the top and over 31 pixels.

    Returns:
        Depths, inf where nothing came, shape (h, w).
    """
    from scipy import ndimage

    near = np.where(np.isfinite(depth_m) & (depth_m < far_m - _LEAST_M), far_m - depth_m, 0.0)
    near = ndimage.grey_dilation(near, footprint=_diamond(stretch), mode="constant")
    near = ndimage.maximum_filter(near, size=_size(5, stretch), mode="constant")
    near = ndimage.minimum_filter(near, size=_size(5, stretch), mode="constant", cval=far_m)
    near = _filled(near, _size(7, stretch))
    if extrapolate:
        top = np.argmax(near > _LEAST_M, axis=0)
        above = np.arange(near.shape[0])[:, None] < top
        near = np.where(above, near[top, np.arange(near.shape[1])], near)
        near = _filled(near, _size(31, stretch))
    near = ndimage.median_filter(near, size=5)
    smooth = ndimage.gaussian_filter(near, 1.1, radius=2)  # the sigma that goes with a kernel of 5
    near = np.where(near > _LEAST_M, smooth, near)
    return np.where(near > _LEAST_M, far_m - near, np.inf)


def _filled(near: Float[np.ndarray, "h w"], size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    from scipy import ndimage

    return np.where(near > _LEAST_M, near, ndimage.maximum_filter(near, size=size, mode="constant"))


def _size(pixels: int, stretch: int) -> tuple[int, int]:
    """Height and width of a kernel, both odd."""
    return pixels * stretch - (1 - pixels * stretch % 2), pixels


def _diamond(stretch: int) -> Bool[np.ndarray, "k 5"]:
    height = _size(5, stretch)[0]
    rows = np.abs(np.arange(height) - height // 2)[:, None] / stretch
    return rows + np.abs(np.arange(5) - 2) <= 2
