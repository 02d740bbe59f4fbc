"""Targets of anchors from a frame's annotation: numpy alone, so that it travels to the loader's workers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from farfield.detectors.anchors.grid import AnchorGrid, AnchorTargets
from farfield.detectors.anchors.matching import match_by_overlap
from farfield.detectors.contract import range_weights
from farfield.geometry.boxes import Boxes


@dataclass(frozen=True, eq=False, kw_only=True)
class AnchorAssigner:
    """Assigns anchors to a frame's boxes.

    Args:
        grid: The anchors.
        matching: By the distance of their cells from a box's centre, or by overlap with it.
        positive_m: With ``"distance"``, cells this near to a centre are positive.
        ignore_m: With ``"distance"``, cells this near are ignored where they are not positive.
        far_weight: Extra weight of a box per 100 m of range.
    """

    grid: AnchorGrid
    matching: Literal["distance", "iou"] = "distance"
    positive_m: float = 1.0
    ignore_m: float = 2.0
    far_weight: float = 0.0

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> AnchorTargets:
        """Targets of one frame; its points are not looked at."""
        del inputs
        weights = range_weights(boxes, self.far_weight)
        if self.matching == "iou":
            return match_by_overlap(self.grid, boxes, weights=weights)
        return self.grid.assign(boxes, positive_m=self.positive_m, ignore_m=self.ignore_m, weights=weights)
