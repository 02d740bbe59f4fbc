"""Plates are on vehicles: where boxes and a calibration are known, weak hits count only there.

The nuScenes authors ran their detectors at a threshold of high recall and then dropped what overlapped no annotated
vehicle (Caesar et al., 2020, arXiv 1903.11027, section 3.1). Where there is no calibration this step is left out.
"""

import numpy as np
from jaxtyping import Float

from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.privacy.hits import PLATE, ImageBoxes

GROWTH = 1.2
_NEAREST_M = 0.3
_WITHOUT_PLATE = frozenset({"animal", "bicycle", "cyclist", "pedestrian", "person", "rider", "wheeled_pedestrian"})


def vehicles_px(boxes: Boxes, camera: Camera, *, growth: float = GROWTH) -> Float[np.ndarray, "n 4"]:
    """Upright boxes in the picture around the vehicles that it may show, grown about their centres.

    Args:
        boxes: In the coordinates that ``camera`` refers to; persons, animals and bicycles are left out.
        camera: The picture's.
        growth: Factor of width and height.

    Returns:
        Left, top, right, bottom, shape (n, 4), cut at the picture's edges. A vehicle that reaches behind the camera
        goes on to the picture's edge on its side, from top to bottom.
    """
    found = []
    width, height = camera.width_px or np.inf, camera.height_px or np.inf
    for row in range(len(boxes)):
        if str(boxes.label[row]).lower() in _WITHOUT_PLATE:
            continue
        pixels, depth, _ = camera.project(boxes[row : row + 1].corners_m()[0], min_depth_m=_NEAREST_M)
        ahead = depth > _NEAREST_M
        if not ahead.any():
            continue
        low, high = pixels[ahead].min(axis=0), pixels[ahead].max(axis=0)
        if not ahead.all():  # it is beside the camera: what is behind lies farther out still
            outer = (low + high)[0] < width
            low, high = np.array([0.0 if outer else low[0], 0.0]), np.array([high[0] if outer else width, height])
        half = (high - low) / 2 * growth
        centre = (low + high) / 2
        found.append(np.concatenate([centre - half, centre + half]))
    if not found:
        return np.zeros((0, 4))
    cut = np.array(found).clip(0, [width, height, width, height])
    return np.asarray(cut[(cut[:, 2:] > cut[:, :2]).all(axis=1)])


def in_context(hits: ImageBoxes, vehicle_px: Float[np.ndarray, "n 4"], strong: float) -> ImageBoxes:
    """The hits without weak plates whose centre lies in no vehicle.

    Args:
        hits: Faces stay as they are.
        vehicle_px: What :func:`vehicles_px` gave.
        strong: Plates from this score on stay wherever they are.
    """
    centre = (hits.box_px[:, :2] + hits.box_px[:, 2:]) / 2
    low, high = vehicle_px[None, :, :2], vehicle_px[None, :, 2:]
    inside = ((centre[:, None] >= low) & (centre[:, None] <= high)).all(axis=2).any(axis=1)
    return hits[(hits.kind != PLATE) | (hits.score >= strong) | inside]
