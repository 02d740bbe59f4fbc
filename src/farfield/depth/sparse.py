"""The depths that were measured: points projected to pixels, without those that lie behind what the camera sees.

A LiDAR beside a camera looks past the silhouettes that the camera sees: points of the background then fall into the
pixels of near objects.
"""

import numpy as np
from jaxtyping import Bool, Float

from farfield.geometry.cameras import Camera

NEAREST_M = 0.5
"""Points nearer to the image plane than this are left out: they are the car's own."""

SLOPE, STEP_M = 0.05, 0.4
"""A depth is hidden by one nearby that is nearer by more than 5 % and 0.4 m; the slope spares grazing ground."""


def sparse_depth(points_m: Float[np.ndarray, "n 3"], camera: Camera) -> Float[np.ndarray, "h w"]:
    """Depth along the optical axis of the nearest point in each pixel; inf where there is none.

    Args:
        points_m: Points in the coordinates that the camera's pose refers to.
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
