"""The options of the scores of tracks."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

from farfield.errors import ConfigError
from farfield.metrics.kitti.settings import NEIGHBOURS
from farfield.metrics.options import check_range_bins


@dataclass(frozen=True, kw_only=True)
class TrackingSettings:
    """Options of the scores of tracks.

    Args:
        label: The class that is scored.
        relabel: Class names that stand for another.
        ignore: Classes whose annotated boxes may be found or not; None takes KITTI's neighbours (Van for Car).
        similarity: How alike two boxes are: ``"3d"`` and ``"bev"`` IoU, or ``"centre"``: 1 at the same place of x and
            y, 0 at ``distance_m`` and beyond.
        iou: Similarity that a match needs at least, for CLEAR and identity F1; HOTA takes all from 0.05 to 0.95.
        distance_m: For ``"centre"``: where the similarity is 0.
        least_track_score: Tracks whose mean score is lower are left out; None keeps all.
        count_ignored: Whether matches with ignored boxes help to place AB3DMOT's thresholds, as its code has it.
        range_bins_m: Edges of the half-open range bins: annotated boxes and matches count where the annotated box is,
            false ones where they are themselves. No track is cut.
    """

    label: str = "Car"
    relabel: Mapping[str, str] = field(default_factory=dict)
    ignore: tuple[str, ...] | None = None
    similarity: Literal["3d", "bev", "centre"] = "3d"
    iou: float = 0.25
    distance_m: float = 4.0
    least_track_score: float | None = None
    count_ignored: bool = True
    range_bins_m: tuple[float, ...] = (0.0, 70.0, 150.0, 250.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ignore", NEIGHBOURS.get(self.label, ()) if self.ignore is None else self.ignore)
        if not 0 < self.iou < 1:
            raise ConfigError(f"iou: expected a number between 0 and 1, got {self.iou}")
        if self.similarity not in ("3d", "bev", "centre"):
            raise ConfigError(f"similarity: expected 3d, bev or centre, got {self.similarity!r}")
        if not self.distance_m > 0:
            raise ConfigError(f"distance_m: expected a positive number, got {self.distance_m}")
        check_range_bins(self.range_bins_m)
        if self.label in (self.ignore or ()):
            raise ConfigError(f"label: {self.label!r} is also ignored; take it out of ignore to score it")

    @property
    def bins_m(self) -> dict[str, tuple[float, float]]:
        """The half-open range bins as (low, high) by name."""
        return {f"{low:g}-{high:g}": (low, high) for low, high in pairwise(self.range_bins_m)}
