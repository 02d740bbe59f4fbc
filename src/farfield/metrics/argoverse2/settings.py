"""The options of Argoverse 2's detection metrics; the defaults are those of its own kit."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.options import check_range_bins, json_options
from farfield.metrics.several_classes import check_classes

CATEGORIES = (
    "ARTICULATED_BUS",
    "BICYCLE",
    "BICYCLIST",
    "BOLLARD",
    "BOX_TRUCK",
    "BUS",
    "CONSTRUCTION_BARREL",
    "CONSTRUCTION_CONE",
    "DOG",
    "LARGE_VEHICLE",
    "MESSAGE_BOARD_TRAILER",
    "MOBILE_PEDESTRIAN_CROSSING_SIGN",
    "MOTORCYCLE",
    "MOTORCYCLIST",
    "PEDESTRIAN",
    "REGULAR_VEHICLE",
    "SCHOOL_BUS",
    "SIGN",
    "STOP_SIGN",
    "STROLLER",
    "TRUCK",
    "TRUCK_CAB",
    "VEHICULAR_TRAILER",
    "WHEELCHAIR",
    "WHEELED_DEVICE",
    "WHEELED_RIDER",
)
"""The 26 categories of the leaderboard."""


@dataclass(frozen=True, kw_only=True)
class Argoverse2Settings:
    """Options of Argoverse 2's metrics.

    Args:
        classes: Categories that are scored, each for itself, and over which the mean of all is taken.
        relabel: Class names that stand for another.
        thresholds_m: Distances of centres in space below which a detection is a match, metres.
        error_threshold_m: That of them at which errors are taken; without a match it is the translation error.
        max_range_m: Boxes whose centre is as far as this or farther do not count, metres.
        max_boxes: Detections of a sweep and category that count, the best first.
        min_points: Annotated boxes of fewer points do not count.
        range_bins_m: Edges of the half-open range bins; boxes are cut by their own distance in space. A bin may end
            beyond ``max_range_m``: it has its own figures, and ``max_boxes`` are then counted up to its end.
        bootstrap: How intervals are drawn.

    Raises:
        ConfigError: If an option is impossible.
    """

    classes: tuple[str, ...] = CATEGORIES
    relabel: Mapping[str, str] = field(default_factory=dict)
    thresholds_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    error_threshold_m: float = 2.0
    max_range_m: float = 150.0
    max_boxes: int = 100
    min_points: int = 1
    range_bins_m: tuple[float, ...] = (0.0, 50.0, 100.0, 150.0)
    bootstrap: Bootstrap = field(default_factory=Bootstrap)

    def __post_init__(self) -> None:
        check_classes(self.classes, self.relabel)
        check_range_bins(self.range_bins_m)
        rising = all(low < high for low, high in pairwise(self.thresholds_m))
        if not self.thresholds_m or self.thresholds_m[0] <= 0 or not rising:
            raise ConfigError(f"thresholds_m: expected rising distances above 0, got {self.thresholds_m}")
        if self.error_threshold_m not in self.thresholds_m:
            raise ConfigError(
                f"error_threshold_m: expected one of thresholds_m, {self.thresholds_m}, got {self.error_threshold_m}"
            )
        for name, least in (("max_range_m", 0.0), ("max_boxes", 0)):
            if getattr(self, name) <= least:
                raise ConfigError(f"{name}: expected more than 0, got {getattr(self, name)}")
        if self.min_points < 0:
            raise ConfigError(f"min_points: expected 0 or more, got {self.min_points}")

    @property
    def label(self) -> str:
        """The categories as one phrase."""
        return "all 26 categories" if self.classes == CATEGORIES else ", ".join(self.classes)

    @property
    def bins_m(self) -> tuple[tuple[float, float], ...]:
        """The half-open range bins as (low, high)."""
        return tuple(pairwise(self.range_bins_m))

    def to_json(self) -> dict[str, Any]:
        """All options as JSON values, and where boxes count in words."""
        return json_options(asdict(self)) | {"region": f"nearer than {self.max_range_m:g} m"}
