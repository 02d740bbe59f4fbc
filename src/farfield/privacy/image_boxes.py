"""Boxes in a picture that are to be covered, each with a kind and a score."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

FACE, PLATE = "face", "plate"
KINDS = (FACE, PLATE)


@dataclass(frozen=True, eq=False)
class ImageBoxes:
    """Upright boxes in a picture.

    Args:
        box_px: Left, top, right, bottom in pixels, shape (n, 4); right and bottom are not inside.
        score: From 0 to 1, shape (n,).
        kind: ``face`` or ``plate``, shape (n,), str.
    """

    box_px: Float[np.ndarray, "n 4"] = field(default_factory=lambda: np.zeros((0, 4)))
    score: Float[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(0))
    kind: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype="<U8"))

    @classmethod
    def of_kind(cls, kind: str, box_px: Float[np.ndarray, "n 4"], score: Float[np.ndarray, " n"]) -> "ImageBoxes":
        """Boxes of one kind."""
        return cls(np.asarray(box_px, float).reshape(-1, 4), np.asarray(score, float), np.full(len(score), kind, "<U8"))

    @classmethod
    def concatenate(cls, parts: "Sequence[ImageBoxes]") -> "ImageBoxes":
        """The boxes of all parts, in order; none without parts."""
        parts = parts or [cls()]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("box_px", "score", "kind")))

    @classmethod
    def from_rows(cls, rows: Sequence[Sequence[Any]]) -> "ImageBoxes":
        """Boxes from the rows of :meth:`to_rows`."""
        box_px = np.array([row[:4] for row in rows], dtype=float).reshape(-1, 4)
        scores, kinds = [row[4] for row in rows], [row[5] for row in rows]
        return cls(box_px, np.array(scores, dtype=float), np.array(kinds, dtype="<U8"))

    def to_rows(self) -> list[list[Any]]:
        """Left, top, right, bottom, score and kind of each box, as JSON takes them."""
        columns = zip(np.round(self.box_px, 2).tolist(), np.round(self.score, 4).tolist(), self.kind, strict=True)
        return [[*box, score, str(kind)] for box, score, kind in columns]

    def __len__(self) -> int:
        return len(self.score)

    def __getitem__(self, rows: Bool[np.ndarray, " n"] | Int[np.ndarray, " k"] | slice) -> "ImageBoxes":
        return ImageBoxes(self.box_px[rows], self.score[rows], self.kind[rows])

    def scaled(self, factor: float | Float[np.ndarray, "2"]) -> "ImageBoxes":
        """The boxes in a picture that is so many times as large."""
        return replace(self, box_px=self.box_px * np.tile(np.broadcast_to(factor, 2), 2))

    def grown(self, factor: float, least_px: float = 0.0) -> "ImageBoxes":
        """The boxes times a factor about their centres, by at least so many pixels at each side."""
        half = (self.box_px[:, 2:] - self.box_px[:, :2]) / 2
        centre = self.box_px[:, :2] + half
        half = np.maximum(half * factor, half + least_px)
        return replace(self, box_px=np.column_stack([centre - half, centre + half]))

    def touches(self, width: int, height: int) -> Bool[np.ndarray, " n"]:
        """Which boxes have a part in a picture."""
        return np.asarray((self.box_px[:, 2:] > 0).all(axis=1) & (self.box_px[:, :2] < [width, height]).all(axis=1))

    def within(self, width: int, height: int) -> "ImageBoxes":
        """The boxes cut at a picture's edges, without those that lie outside."""
        clipped = replace(self, box_px=self.box_px.clip(0, [width, height, width, height]))
        return clipped[self.touches(width, height)]


def pairwise_iou(a_px: Float[np.ndarray, "n 4"], b_px: Float[np.ndarray, "m 4"]) -> Float[np.ndarray, "n m"]:
    """Intersection over union of all pairs of boxes."""
    low, high = np.maximum(a_px[:, None, :2], b_px[None, :, :2]), np.minimum(a_px[:, None, 2:], b_px[None, :, 2:])
    intersection_px2 = (high - low).clip(min=0).prod(axis=-1)
    a_px2, b_px2 = ((box[:, 2:] - box[:, :2]).clip(min=0).prod(axis=-1) for box in (a_px, b_px))
    return np.asarray(intersection_px2 / np.maximum(a_px2[:, None] + b_px2[None] - intersection_px2, 1e-9))


def suppress_overlapping(boxes: ImageBoxes, iou: float) -> ImageBoxes:
    """The boxes by falling score, without those that overlap a better one of their kind by more than ``iou``."""
    boxes = boxes[np.argsort(-boxes.score, kind="stable")]
    overlaps = (pairwise_iou(boxes.box_px, boxes.box_px) > iou) & (boxes.kind[:, None] == boxes.kind[None])
    stays = np.ones(len(boxes), dtype=bool)
    for row in range(len(boxes)):
        if stays[row]:
            stays[row + 1 :] &= ~overlaps[row, row + 1 :]
    return boxes[stays]


def covered_share(mask: Bool[np.ndarray, "height width"], box_px: Float[np.ndarray, " 4"]) -> float:
    """Share of a box's pixels that a mask covers; 0 for a box outside of the picture."""
    left, top = np.floor(box_px[:2]).clip(min=0).astype(int)
    right, bottom = np.ceil(box_px[2:]).astype(int)
    inside = mask[top:bottom, left:right]
    return float(inside.mean()) if inside.size else 0.0
