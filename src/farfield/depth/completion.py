"""Completion of a sparse map pixel by pixel, where rings are not known: a mesh, and two baselines to compare with.

:func:`draw_mesh`: a mesh over the measured pixels, on whose triangles 1 / z is linear. On a plane 1 / z is an affine
function of the pixel, so that a mesh on 1 / z has no error on planes; one on z has. :func:`nearest_depth` takes the
nearest measured pixel, and :func:`ip_basic` follows the rules of IP-Basic (Ku, Harakeh and Waslander, "In Defense of
Classical Image Processing: Fast Depth Completion on the CPU", CRV 2018, section III), written anew from the paper's
description.
"""

from importlib.util import find_spec

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.depth.raster import DepthRaster


def draw_mesh(depth_m: Float[np.ndarray, "h w"], *, max_edge_px: float, compiled: bool | None = None) -> DepthRaster:
    """Fill the Delaunay triangles (Delaunay 1934) of the pixels that have a depth.

    OpenCV makes them where it is installed, in an eighth of the time of Qhull, which does otherwise. Both take either
    diagonal where four pixels lie on one circle.

    Args:
        depth_m: Sparse depths, inf for none, shape (h, w).
        max_edge_px: Triangles with a longer edge stay empty, and so does what lies outside all of them.
        compiled: Whether numba fills them (default: where it is installed).

    Returns:
        Depths, and as doubt the depths' spread over the triangle's corners, times 1.5 less the share of the nearest
        corner: 0 on a corner, all of it in the triangle's middle.
    """
    drawn = DepthRaster(np.full(depth_m.shape, np.inf), np.zeros(depth_m.shape))
    measured = np.isfinite(depth_m)
    drawn.depth_m[measured] = depth_m[measured]
    corners = _triangles(measured)
    if find_spec("numba") is not None if compiled is None else compiled:
        from farfield.depth.compiled import fill

        fill(corners, depth_m, max_edge_px**2, drawn.depth_m, drawn.doubt_m)
    else:
        _fill(_ordered(corners, max_edge_px), depth_m, drawn)
    return drawn


def _triangles(measured: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "n 3 2"]:
    """Columns and rows of the corners of all triangles."""
    rows, columns = np.nonzero(measured)
    if len(rows) < 3:
        return np.zeros((0, 3, 2), dtype=np.int64)
    nodes = np.column_stack([columns, rows])
    return _by_qhull(nodes) if find_spec("cv2") is None else _by_opencv(nodes, measured.shape)


def _by_opencv(nodes: Int[np.ndarray, "n 2"], shape: tuple[int, int]) -> Int[np.ndarray, "t 3 2"]:
    import cv2

    mesh = cv2.Subdiv2D((0, 0, shape[1], shape[0]))
    mesh.insert(nodes.astype(np.float32))  # type: ignore[call-overload]
    return np.rint(mesh.getTriangleList()).astype(np.int64).reshape(-1, 3, 2)


def _by_qhull(nodes: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "t 3 2"]:
    from scipy.spatial import Delaunay, QhullError

    try:
        return nodes[Delaunay(nodes.astype(np.float64)).simplices]
    except QhullError:  # all on one line
        return np.zeros((0, 3, 2), dtype=np.int64)


def _ordered(corners: Int[np.ndarray, "n 3 2"], max_edge_px: float) -> Int[np.ndarray, "m 3 2"]:
    """The triangles with short edges, and their corners from above downwards."""
    edges = corners - corners[:, (1, 2, 0)]
    corners = corners[(edges[..., 0] ** 2 + edges[..., 1] ** 2 <= max_edge_px**2).all(axis=1)]
    for first, second in ((0, 1), (1, 2), (0, 1)):
        lower = corners[:, first, 1] > corners[:, second, 1]
        corners[lower, first], corners[lower, second] = corners[lower, second], corners[lower, first]
    to = corners[:, 1:] - corners[:, :1]
    return corners[to[:, 0, 0] * to[:, 1, 1] != to[:, 0, 1] * to[:, 1, 0]]


def _fill(corners: Int[np.ndarray, "n 3 2"], depth_m: Float[np.ndarray, "h w"], drawn: DepthRaster) -> None:
    """Row by row of each triangle, from its left edge to its right one; ``compiled.fill`` says the same."""
    z = depth_m[corners[..., 1], corners[..., 0]].T
    (x0, x1, x2), (y0, y1, y2) = corners.T.astype(np.float64)
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    second, third = np.stack([y2 - y0, x0 - x2]) / area, np.stack([y0 - y1, x1 - x0]) / area  # shares a pixel
    steps = [(1 / z[1] - 1 / z[0]) * second + (1 / z[2] - 1 / z[0]) * third, second, third]
    facet, down = _repeat_rows((y2 - y0 + 1).astype(np.int64))
    left, length = _spans(corners[facet], y0[facet] + down)
    across = left - x0[facet]
    along = _repeat_rows(length)[1]
    pixel = np.repeat(((y0[facet] + down) * drawn.depth_m.shape[1] + left).astype(np.int64), length) + along
    inverse, two, three = (
        np.repeat(right[facet] * across + below[facet] * down, length) + np.repeat(right[facet], length) * along
        for right, below in steps
    )
    inverse += np.repeat(1 / z[0][facet], length)
    nearest = np.clip(np.maximum(np.maximum(two, three), 1 - two - three), 0, 1)
    drawn.depth_m.reshape(-1)[pixel] = 1 / np.maximum(inverse, 1e-6)
    drawn.doubt_m.reshape(-1)[pixel] = 1.5 * (1 - nearest) * np.repeat((z.max(axis=0) - z.min(axis=0))[facet], length)


def _spans(
    corners: Int[np.ndarray, "m 3 2"], y: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """The first column of a triangle in a row, and how many it has there."""
    (x0, x1, x2), (y0, y1, y2) = corners.T.astype(np.float64)
    upper = y < y1
    first, last = np.where(upper, y0, y1), np.where(upper, y1, y2)
    start, end = np.where(upper, x0, x1), np.where(upper, x1, x2)
    one = x0 + (x2 - x0) * (y - y0) / (y2 - y0)
    other = start + (end - start) * (y - first) / np.maximum(last - first, 1)
    left, right = np.ceil(np.minimum(one, other) - 1e-6), np.floor(np.maximum(one, other) + 1e-6)
    return left, np.maximum(right - left + 1, 0).astype(np.int64)


def _repeat_rows(counts: Int[np.ndarray, " n"]) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Each row as often as its count says, and the number within it."""
    rows = np.repeat(np.arange(len(counts)), counts)
    return rows, np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)


# Baselines

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

    # 1. Invert.
    near = np.where(np.isfinite(depth_m) & (depth_m < far_m - _LEAST_M), far_m - depth_m, 0.0)

    # 2. Dilate with a diamond.
    height = _kernel_size(5, stretch)[0]
    rows = np.abs(np.arange(height) - height // 2)[:, None] / stretch
    near = ndimage.grey_dilation(near, footprint=(rows + np.abs(np.arange(5) - 2)) <= 2, mode="constant")

    # 3. Close small holes.
    near = ndimage.maximum_filter(near, size=_kernel_size(5, stretch), mode="constant")
    near = ndimage.minimum_filter(near, size=_kernel_size(5, stretch), mode="constant", cval=far_m)

    # 4. Fill small holes.
    near = _fill_empty(near, _kernel_size(7, stretch))

    # 5. and 6. Carry each column's top up, and fill large holes.
    if extrapolate:
        top = np.argmax(near > _LEAST_M, axis=0)
        above = np.arange(near.shape[0])[:, None] < top
        near = np.where(above, near[top, np.arange(near.shape[1])], near)
        near = _fill_empty(near, _kernel_size(31, stretch))

    # 7. Median and Gaussian.
    near = ndimage.median_filter(near, size=5)
    smooth = ndimage.gaussian_filter(near, 1.1, radius=2)  # the sigma that goes with a kernel of 5
    near = np.where(near > _LEAST_M, smooth, near)

    # 8. Invert back.
    return np.where(near > _LEAST_M, far_m - near, np.inf)


def _fill_empty(near: Float[np.ndarray, "h w"], size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    from scipy import ndimage

    return np.where(near > _LEAST_M, near, ndimage.maximum_filter(near, size=size, mode="constant"))


def _kernel_size(pixels: int, stretch: int) -> tuple[int, int]:
    """Height and width of a kernel, both odd."""
    return pixels * stretch - (1 - pixels * stretch % 2), pixels
