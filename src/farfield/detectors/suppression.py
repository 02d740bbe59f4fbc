"""Rotated non-maximum suppression with the exact IoU of :mod:`farfield.geometry.iou`, in numpy. Needs no torch."""

import numpy as np
from jaxtyping import Int
from scipy.spatial import cKDTree

from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou

LEAST_IOU = 1e-9
"""Overlap that counts as none: what rounding makes of boxes that lie apart."""


def rotated_nms(boxes: Boxes, *, iou_threshold: float, limit: int = 500) -> Int[np.ndarray, " k"]:
    """Greedy suppression in bird's-eye view, whatever the labels.

    Args:
        boxes: Scored boxes.
        iou_threshold: A box that overlaps a better one by more than this, and by more than rounding, is dropped.
        limit: Keep at most this many.

    Returns:
        Indices of the kept boxes, best first, shape (k,).

    Raises:
        ValueError: If the boxes carry no scores.
    """
    if boxes.score is None:
        raise ValueError("rotated_nms: expected boxes with scores")
    if len(boxes) == 0:
        return np.zeros(0, dtype=np.int64)
    order = np.argsort(-boxes.score, kind="stable")
    ranked = boxes[order]
    radius_m = np.hypot(*ranked.size_m[:, :2].T) / 2
    pairs = cKDTree(ranked.centre_m[:, :2]).query_pairs(2 * radius_m.max(), output_type="ndarray")
    better, worse = pairs.min(axis=1), pairs.max(axis=1)
    overlap = paired_iou(ranked[better], ranked[worse], kind="bev") > max(iou_threshold, LEAST_IOU)
    better, worse = better[overlap], worse[overlap]
    by_better = np.argsort(better, kind="stable")
    better, worse = better[by_better], worse[by_better]
    alive = np.ones(len(ranked), dtype=np.bool_)
    starts, ends = (np.searchsorted(better, np.unique(better), side=side) for side in ("left", "right"))
    for start, end in zip(starts, ends, strict=True):
        if alive[better[start]]:
            alive[worse[start:end]] = False
    return order[np.flatnonzero(alive)[:limit]]
