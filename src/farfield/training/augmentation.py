"""Random changes to training frames: pasting objects, mirroring, turning, scaling. numpy only, one generator."""

import numpy as np

from farfield.geometry.boxes import Boxes
from farfield.geometry.points import count_points_in_boxes
from farfield.training.bank import ObjectBank, Points
from farfield.training.config import AugmentationConfig


def augment(
    points: Points, boxes: Boxes, config: AugmentationConfig, rng: np.random.Generator, bank: ObjectBank | None = None
) -> tuple[Points, Boxes]:
    """Apply all random changes to one frame.

    Args:
        points: x, y, z (metres), intensity, lag (s) and further columns, shape (n, 5 + k).
        boxes: Annotated boxes; they carry no scores, ids or counts afterwards.
        config: How much of each change.
        rng: The only source of randomness.
        bank: Objects to paste.

    Returns:
        New points and boxes.
    """
    boxes = boxes.replace(score=None, track_id=None, point_count=None)
    if bank is not None and config.pasted:
        points, boxes = bank.paste(points, boxes, config.pasted, rng, bands_m=config.pasted_bands_m)
    mirror = rng.random() < config.flip_probability
    turn = rng.uniform(-config.rotation_rad, config.rotation_rad)
    factor = rng.uniform(1 - config.scale, 1 + config.scale)
    side = -1.0 if mirror else 1.0
    cos, sin = np.cos(turn), np.sin(turn)
    linear = factor * np.array([[cos, -sin * side, 0], [sin, cos * side, 0], [0, 0, 1]])
    rise = np.array([0.0, 0.0, rng.uniform(-config.height_m, config.height_m)])
    moved = points.copy()
    moved[:, :3] = points[:, :3] @ linear.T.astype(np.float32) + rise.astype(np.float32)
    boxes = boxes.replace(
        centre_m=boxes.centre_m @ linear.T + rise, size_m=boxes.size_m * factor, yaw_rad=boxes.yaw_rad * side + turn
    )
    return _thinned(moved, boxes, config.thinning, rng) if config.thinning else (moved, boxes)


def _thinned(points: Points, boxes: Boxes, most: float, rng: np.random.Generator) -> tuple[Points, Boxes]:
    """Drop a random share of the points, and the boxes that had points and have none any more."""
    kept = points[rng.random(len(points)) >= rng.uniform(0, most)]
    before, after = (count_points_in_boxes(part[:, :3], boxes, margin_m=0.05) for part in (points, kept))
    return kept, boxes[(after > 0) | (before == 0)]
