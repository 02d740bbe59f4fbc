"""Where boxes appear in a camera's image."""

import numpy as np
from jaxtyping import Float

from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera


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
    seen = ahead & (cut > 0)
    box_px = np.where(seen[:, None], np.column_stack([low_cut, high_cut]), -1.0)
    truncation = np.where(seen, 1 - cut / np.maximum(area, 1e-9), 1.0)
    return box_px, np.clip(truncation, 0.0, 1.0)
