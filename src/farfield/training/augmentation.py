"""Random changes to training frames: pasting objects, mirroring, turning, scaling. numpy only, one generator."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32

from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.geometry.points import count_points_in_boxes, points_in_boxes
from farfield.training.config import AugmentationConfig

Points = Float32[np.ndarray, "_ 5"]


@dataclass
class ObjectBank:
    """Objects cut out of training frames: their points and their boxes, by class (SECOND, section 3.3.1).

    Args:
        capacity: Objects of each class to keep; later ones replace random earlier ones (reservoir sampling).
    """

    capacity: int
    objects: dict[str, list[tuple[Points, Boxes]]] = field(default_factory=dict)
    seen: dict[str, int] = field(default_factory=dict)

    def add(self, points: Points, boxes: Boxes, *, min_points: int, rng: np.random.Generator) -> None:
        """Cut every box with enough points out of a frame."""
        for index, inside in enumerate(points_in_boxes(points[:, :3], boxes)):
            if len(inside) < min_points:
                continue
            name = str(boxes.label[index])
            kept = self.objects.setdefault(name, [])
            self.seen[name] = self.seen.get(name, 0) + 1
            item = (points[inside].copy(), boxes[index])
            if len(kept) < self.capacity:
                kept.append(item)
            elif (slot := int(rng.integers(self.seen[name]))) < self.capacity:
                kept[slot] = item

    def paste(
        self, points: Points, boxes: Boxes, wanted: dict[str, int], rng: np.random.Generator
    ) -> tuple[Points, Boxes]:
        """Add up to the wanted number of objects of each class, where they stood in their own frame.

        An object keeps its place, so its density and visible side stay right for its range. It is left out where it
        would touch a box of the frame; points of the frame inside its box are removed.
        """
        keep, added = np.ones(len(points), dtype=np.bool_), []
        for name, count in wanted.items():
            pool = self.objects.get(name, [])
            for index in rng.permutation(len(pool))[:count]:
                new_points, new_box = pool[index]
                if len(boxes) and pairwise_iou(new_box, boxes, kind="bev").any():
                    continue
                keep[points_in_boxes(points[:, :3], new_box, margin_m=0.1)[0]] = False
                added.append(new_points)
                boxes = Boxes.concatenate([boxes, new_box])
        return np.concatenate([points[keep], *added]), boxes


def augment(
    points: Points, boxes: Boxes, config: AugmentationConfig, rng: np.random.Generator, bank: ObjectBank | None = None
) -> tuple[Points, Boxes]:
    """Apply all random changes to one frame.

    Args:
        points: x, y, z (metres), intensity, lag (s), shape (n, 5).
        boxes: Annotated boxes; they carry no scores, ids or counts afterwards.
        config: How much of each change.
        rng: The only source of randomness.
        bank: Objects to paste.

    Returns:
        New points and boxes.
    """
    boxes = boxes.replace(score=None, track_id=None, point_count=None)
    if bank is not None and config.pasted:
        points, boxes = bank.paste(points, boxes, config.pasted, rng)
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
