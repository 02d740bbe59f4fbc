"""Interpolation where rings are not known: a mesh over the measured pixels, on whose triangles 1 / z is linear.

On a plane 1 / z is an affine function of the pixel, so that a mesh on 1 / z has no error on planes; one on z has.
"""

import numpy as np
from jaxtyping import Float

from farfield.imaging.depth.surface import Raster


def draw_mesh(depth_m: Float[np.ndarray, "h w"], *, max_edge_px: float) -> Raster:
    """Fill the Delaunay triangles (Delaunay 1934; Qhull) of the pixels that have a depth.

    Args:
        depth_m: Sparse depths, inf for none, shape (h, w).
        max_edge_px: Triangles with a longer edge stay empty, and so does what lies outside all of them.

    Returns:
        Depths, and as doubt the depths' spread over the triangle's corners, times 1.5 less the share of the nearest
        corner: 0 on a corner, all of it in the triangle's middle.
    """
    from scipy.spatial import Delaunay, QhullError

    height, width = depth_m.shape
    rows, columns = np.nonzero(np.isfinite(depth_m))
    empty = Raster(depth_m.copy(), np.zeros(depth_m.shape))
    if len(rows) < 4:
        return empty
    corners = np.column_stack([columns, rows]).astype(np.float64)
    try:
        mesh = Delaunay(corners)
    except QhullError:  # all on one line
        return empty
    u, v = np.meshgrid(np.arange(columns.min(), columns.max() + 1), np.arange(rows.min(), rows.max() + 1))
    pixels = np.column_stack([u.reshape(-1), v.reshape(-1)]).astype(np.float64)
    triangle = mesh.find_simplex(pixels)
    edges = np.linalg.norm(corners[mesh.simplices] - corners[np.roll(mesh.simplices, 1, axis=1)], axis=2).max(axis=1)
    inside = np.flatnonzero(triangle >= 0)
    inside = inside[edges[triangle[inside]] <= max_edge_px]
    pixels, triangle = pixels[inside], triangle[inside]
    step = pixels - mesh.transform[triangle, 2]
    two = np.einsum("nij,nj->ni", mesh.transform[triangle, :2], step)
    shares = np.column_stack([two, 1 - two.sum(axis=1)])
    z = depth_m[rows, columns][mesh.simplices]
    inverse, spread = 1 / z, z.max(axis=1) - z.min(axis=1)
    place = (pixels[:, 1] * width + pixels[:, 0]).astype(np.int64)
    drawn = Raster(np.full((height, width), np.inf), np.zeros((height, width)))
    drawn.depth_m.reshape(-1)[place] = 1 / np.maximum((shares * inverse[triangle]).sum(axis=1), 1e-6)
    drawn.doubt_m.reshape(-1)[place] = 1.5 * np.clip(1 - shares.max(axis=1), 0, 1) * spread[triangle]
    return drawn
