"""Random changes to training frames: pasting objects, mirroring, turning, scaling. numpy only, one generator."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from farfield.geometry.boxes import BOX_MARGIN_M, Boxes, count_points_in_boxes
from farfield.training.bank import ObjectBank, Points
from farfield.training.config import AugmentationConfig, SparseNear


@dataclass(frozen=True, eq=False, kw_only=True)
class Augmentation:
    """One draw of a frame's random motion, to be applied alike to all that the frame holds.

    Args:
        mirror: Whether left and right change places.
        turn_rad: Turn about z, counter-clockwise.
        factor: Scale of the scene.
        rise_m: Height that is added.
    """

    mirror: bool
    turn_rad: float
    factor: float
    rise_m: float

    @property
    def linear(self) -> Float[np.ndarray, "3 3"]:
        """The motion without its rise: what a place is multiplied with, shape (3, 3)."""
        side = -1.0 if self.mirror else 1.0
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return self.factor * np.array([[cos, -sin * side, 0], [sin, cos * side, 0], [0, 0, 1]])

    def points(self, points: Points) -> Points:
        """The points moved; x, y and z stand first, further columns stay."""
        moved = points.copy()
        rise = np.array([0.0, 0.0, self.rise_m]).astype(np.float32)
        moved[:, :3] = points[:, :3] @ self.linear.T.astype(np.float32) + rise
        return moved

    def boxes(self, boxes: Boxes) -> Boxes:
        """The boxes moved, with their sizes, headings and velocities."""
        linear, side, velocity = self.linear, -1.0 if self.mirror else 1.0, boxes.velocity_m_s
        if velocity is not None:
            velocity = velocity @ linear[: velocity.shape[1], : velocity.shape[1]].T
        return boxes.replace(
            centre_m=boxes.centre_m @ linear.T + np.array([0.0, 0.0, self.rise_m]),
            size_m=boxes.size_m * self.factor,
            yaw_rad=boxes.yaw_rad * side + self.turn_rad,
            velocity_m_s=velocity,
        )


def draw_change(config: AugmentationConfig, rng: np.random.Generator) -> Augmentation:
    """Draw the motion of one frame."""
    return Augmentation(
        mirror=bool(rng.random() < config.flip_probability),
        turn_rad=rng.uniform(-config.rotation_rad, config.rotation_rad),
        factor=rng.uniform(1 - config.scale, 1 + config.scale),
        rise_m=rng.uniform(-config.height_m, config.height_m),
    )


def augment(
    points: Points,
    boxes: Boxes,
    config: AugmentationConfig,
    rng: np.random.Generator,
    bank: ObjectBank | None = None,
    weather: Callable[[Points, Boxes], tuple[Points, Boxes]] | None = None,
) -> tuple[Points, Boxes]:
    """Apply all random changes to one frame.

    Args:
        points: x, y, z (metres), lag (s) and further columns, shape (n, 4 + k).
        boxes: Annotated boxes; they carry no scores, ids or counts afterwards.
        config: How much of each change.
        rng: The only source of randomness.
        bank: Objects to paste.
        weather: Lays the frame's weather over points and boxes, where the sensor measured them.

    Returns:
        New points and boxes.
    """
    boxes = boxes.replace(score=None, track_id=None, point_count=None)
    if bank is not None and config.pasted:
        points, boxes = bank.paste(points, boxes, config.pasted, rng, bands_m=config.pasted_bands_m)
    if weather is not None:
        points, boxes = weather(points, boxes)
    change = draw_change(config, rng)
    points, boxes = change.points(points), change.boxes(boxes)
    if config.thinning:
        points, boxes = _kept(points, boxes, rng.random(len(points)) >= rng.uniform(0, config.thinning))
    if config.sparse_near is not None:
        points, boxes = _kept(points, boxes, sparse_near(points, boxes, config.sparse_near, rng))
    return points, boxes


def sparse_near(points: Points, boxes: Boxes, config: SparseNear, rng: np.random.Generator) -> Bool[np.ndarray, " n"]:
    """Which points stay where near ones are to be as sparse as a far object's.

    A scanner's points on a surface fall with the square of the range, so a point at r stays with probability
    c (r / R)^2, where R is the range of one of the frame's far objects, drawn at random. c is how much fewer points far
    objects have than that law gives from near ones, for they are hidden more: over many frames near objects get the
    numbers of points of far ones.

    Args:
        points: x, y, z first, shape (n, 3 + k).
        boxes: The frame's; those in ``config.far_m`` are far.
        config: Ranges and share of the frames.
        rng: The only source of randomness.
    """
    box_m = np.hypot(*boxes.centre_m[:, :2].T)
    far = (box_m >= config.far_m[0]) & (box_m < config.far_m[1])
    if not far.any() or rng.random() >= config.probability:
        return np.ones(len(points), dtype=bool)
    range_m, drawn_m = np.hypot(points[:, 0], points[:, 1]), rng.choice(box_m[far])
    counts = count_points_in_boxes(points[:, :3], boxes, margin_m=BOX_MARGIN_M)
    near, far = (part & (counts > 0) for part in (box_m < config.near_m, far))
    surface = np.log(np.maximum(counts, 1) * np.square(box_m))
    fewer = np.exp(min(surface[far].mean() - surface[near].mean(), 0.0)) if near.any() and far.any() else 1.0
    share = np.where(range_m < config.near_m, fewer * np.square(range_m / drawn_m), 1.0)
    return np.asarray(rng.random(len(points)) < share)


def _kept(points: Points, boxes: Boxes, stays: Bool[np.ndarray, " n"]) -> tuple[Points, Boxes]:
    """The points that stay, without the boxes that had points and have none any more."""
    kept = points[stays]
    before, after = (count_points_in_boxes(part[:, :3], boxes, margin_m=BOX_MARGIN_M) for part in (points, kept))
    return kept, boxes[(after > 0) | (before == 0)]
