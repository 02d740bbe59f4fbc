"""A protocol of one's own: the share of annotated boxes that any prediction comes near to."""

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from farfield.geometry.boxes import Boxes
from farfield.metrics import Detections, Protocol, Result


class Recall(Protocol):
    """Recall at a distance: whatever its score, a prediction finds the boxes of its class near to it."""

    name: ClassVar[str] = "recall"

    @dataclass(frozen=True, kw_only=True)
    class Settings:
        """What can be chosen: keywords of ``score``, and ``--options NAME=VALUE`` of ``farfield score``.

        Args:
            label: The class; by default the most annotated one.
            distance_m: A box is found by a prediction whose centre is nearer than this on the ground.
        """

        label: str = "vehicle"
        distance_m: float = 2.0

    def evaluate(self, found: Detections, settings: Any) -> Result:
        """Score one class over all annotated frames."""
        hits = [
            found_boxes(found.boxes[key], annotation.boxes, settings.label, settings.distance_m)
            for key, annotation in found.annotations.items()
        ]
        every = np.concatenate([np.zeros(0, dtype=np.bool_), *hits])
        return Result(
            protocol=self.name,
            label=settings.label,
            settings=asdict(settings),
            convention=self.convention_text(asdict(settings)),
            figures={"recall": float(every.mean()) if len(every) else None},
            counts={"annotated": len(every), "frames": len(hits)},
        )


def found_boxes(predicted: Boxes, annotated: Boxes, label: str, distance_m: float) -> np.ndarray:
    """Whether each annotated box of a class has a prediction of that class near it, shape (n,)."""
    here, there = (boxes.centre_m[boxes.label == label, :2] for boxes in (annotated, predicted))
    gap_m = np.linalg.norm(here[:, None] - there[None], axis=2)
    return gap_m.min(axis=1, initial=np.inf) < distance_m
