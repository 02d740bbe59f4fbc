"""What KITTI measures in the image: overlap of 2D boxes, and headings as the camera sees them."""

import numpy as np
from jaxtyping import Float, Int

from farfield.geometry.boxes import Boxes

NO_ALPHA = -10.0
"""KITTI's value of an observation angle that is not given."""


def image_overlap_px(
    annotated_px: Float[np.ndarray, "m 4"], predicted_px: Float[np.ndarray, "n 4"], pair: Int[np.ndarray, "p 2"]
) -> Float[np.ndarray, " p"]:
    """Area that the boxes of each pair share in the image, square pixels.

    Args:
        annotated_px: Boxes as left, top, right, bottom.
        predicted_px: Likewise.
        pair: A row of either.
    """
    a, b = annotated_px[pair[:, 0]], predicted_px[pair[:, 1]]
    sides = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    return np.asarray(np.maximum(sides, 0.0).prod(axis=1))


def image_iou(
    annotated_px: Float[np.ndarray, "m 4"], predicted_px: Float[np.ndarray, "n 4"], pair: Int[np.ndarray, "p 2"]
) -> Float[np.ndarray, " p"]:
    """Intersection over union in the image; the arguments are those of :func:`image_overlap_px`."""
    shared = image_overlap_px(annotated_px, predicted_px, pair)
    areas = [np.maximum(box[:, 2:] - box[:, :2], 0.0).prod(axis=1) for box in (annotated_px, predicted_px)]
    union = areas[0][pair[:, 0]] + areas[1][pair[:, 1]] - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)


def heading_similarity(
    annotated: Boxes,
    predicted: Boxes,
    pair: Int[np.ndarray, "p 2"],
    annotated_rad: Float[np.ndarray, " m"] | None = None,
    predicted_rad: Float[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, " p"]:
    """(1 + cos d) / 2 of each pair, d the difference of the headings as seen from the origin.

    Args:
        annotated: m boxes.
        predicted: n boxes.
        pair: A row of either.
        annotated_rad: KITTI's ``alpha`` of the annotated boxes; unless both sides give all of theirs, those are taken
            that follow from the boxes' yaw and place, which differ from the same angle by its sign and origin alone.
        predicted_rad: Likewise of the predicted boxes.
    """
    if not alphas_given(annotated_rad, predicted_rad) or annotated_rad is None or predicted_rad is None:
        annotated_rad, predicted_rad = (
            boxes.yaw_rad - np.arctan2(boxes.centre_m[:, 1], boxes.centre_m[:, 0]) for boxes in (annotated, predicted)
        )
    return (1.0 + np.cos(annotated_rad[pair[:, 0]] - predicted_rad[pair[:, 1]])) / 2.0


def alphas_given(annotated_rad: Float[np.ndarray, " m"] | None, predicted_rad: Float[np.ndarray, " n"] | None) -> bool:
    """Whether both sides give KITTI's ``alpha`` of every box."""
    sides = (annotated_rad, predicted_rad)
    return all(side is not None and not (side == NO_ALPHA).any() for side in sides)
