"""Which boxes lie in the part of a frame that was annotated, and how many do not."""

import numpy as np
from jaxtyping import Bool

from farfield.frame.annotation import CameraField
from farfield.geometry.boxes import Boxes


def inside_field(boxes: Boxes, region: CameraField) -> Bool[np.ndarray, " n"]:
    """Which boxes have their centre in the field, shape (n,)."""
    return region.contains(boxes.centre_m) if len(boxes) else np.zeros(0, dtype=bool)


class OutsideCounts:
    """Counts of the boxes outside the annotated regions."""

    def __init__(self) -> None:
        self.sums: dict[str, tuple[int, ...]] = {}

    def add(self, region: CameraField, predicted: Bool[np.ndarray, " n"], annotated: Bool[np.ndarray, " m"]) -> None:
        """Count the boxes of a frame; the masks mark those inside."""
        before = self.sums.get(str(region), (0, 0, 0, 0))
        counts = (int((~predicted).sum()), int((~annotated).sum()), len(predicted), len(annotated))
        self.sums[str(region)] = tuple(a + b for a, b in zip(before, counts, strict=True))

    def notes(self) -> list[str]:
        """A sentence for each region with boxes outside it."""
        return [
            f"{predicted} of {all_predicted} predicted and {annotated} of {all_annotated} annotated boxes have their "
            f"centre outside {region}, where nothing was annotated; they do not count"
            for region, (predicted, annotated, all_predicted, all_annotated) in self.sums.items()
            if predicted or annotated
        ]
