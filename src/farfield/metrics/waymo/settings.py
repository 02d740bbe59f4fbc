"""The options of Waymo's detection metrics; the defaults are those of its own tools."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float32

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.options import check_range_bins, json_options
from farfield.metrics.several_classes import check_classes

WAYMO_CLASSES = ("vehicle", "pedestrian", "sign", "cyclist")
WAYMO_NAMES = {
    "TYPE_VEHICLE": "vehicle",
    "TYPE_PEDESTRIAN": "pedestrian",
    "TYPE_SIGN": "sign",
    "TYPE_CYCLIST": "cyclist",
    "Vehicle": "vehicle",
    "Pedestrian": "pedestrian",
    "Sign": "sign",
    "Cyclist": "cyclist",
    "Car": "vehicle",
    "large_vehicle": "vehicle",
    "bicycle": "cyclist",
}
"""Names that are scored as one of Waymo's types: its own, those of two frameworks, and ours."""


@dataclass(frozen=True, kw_only=True)
class WaymoSettings:
    """Options of Waymo's AP and APH.

    Args:
        classes: Classes that are scored, each for itself.
        relabel: Class names that stand for another.
        vehicle_iou: 3D IoU that a match of class ``vehicle`` must reach.
        other_iou: The same of every other class.
        hard_points: A box without a level of its own is of level 2 if it holds at most so many points, else of level 1.
        cutoffs: Number of score cut-offs from 0 to 1, at each of which boxes are matched anew.
        recall_step: Where recall grows by more than this between two cut-offs, the better precision is repeated.
        range_bins_m: Edges of the half-open range bins; boxes are cut by their own distance in space.
        bootstrap: How intervals are drawn.

    Raises:
        ConfigError: If an option is impossible.
    """

    classes: tuple[str, ...] = WAYMO_CLASSES
    relabel: Mapping[str, str] = field(default_factory=lambda: dict(WAYMO_NAMES))
    vehicle_iou: float = 0.7
    other_iou: float = 0.5
    hard_points: int = 5
    cutoffs: int = 101
    recall_step: float = 0.05
    range_bins_m: tuple[float, ...] = (0.0, 30.0, 50.0, float("inf"))
    bootstrap: Bootstrap = field(default_factory=Bootstrap)

    def __post_init__(self) -> None:
        check_classes(self.classes, self.relabel)
        check_range_bins(self.range_bins_m)
        for name in ("vehicle_iou", "other_iou", "recall_step"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name}: expected a number between 0 and 1, got {getattr(self, name)}")
        if not 2 <= self.cutoffs <= 10_001:
            raise ConfigError(f"cutoffs: expected 2 to 10,001, got {self.cutoffs}")
        if self.hard_points < 0:
            raise ConfigError(f"hard_points: expected 0 or more, got {self.hard_points}")

    @property
    def label(self) -> str:
        """The classes as one phrase."""
        return ", ".join(self.classes)

    @property
    def levels(self) -> tuple[int, ...]:
        """The levels that are scored."""
        return (1, 2)

    @property
    def least_iou(self) -> Float32[np.ndarray, " k"]:
        """The IoU that a match of each class must reach, shape (classes,)."""
        values = [self.vehicle_iou if name == "vehicle" else self.other_iou for name in self.classes]
        return np.array(values, dtype=np.float32)

    @property
    def cutoff_scores(self) -> Float32[np.ndarray, " c"]:
        """The score cut-offs, rising, shape (cutoffs,)."""
        return np.linspace(0.0, 1.0, self.cutoffs).astype(np.float32)

    @property
    def bins_m(self) -> tuple[tuple[float, float], ...]:
        """The half-open range bins as (low, high)."""
        return tuple(pairwise(self.range_bins_m))

    def to_json(self) -> dict[str, Any]:
        """All options as JSON values."""
        return json_options(asdict(self)) | {"matcher": "hungarian"}


@dataclass(frozen=True, kw_only=True)
class WaymoLetSettings(WaymoSettings):
    """Options of the longitudinal error tolerant metrics (LET-3D-AP, Hung et al., 2022).

    Args:
        tolerance: Largest error along the line of sight, as a share of the annotated box's distance from the sensor.
        least_tolerance_m: It is at least this, metres.
        sensor_m: Where the cameras stand, x, y, z in the boxes' coordinates, metres.

    The other arguments are those of :class:`WaymoSettings`.
    """

    vehicle_iou: float = 0.5
    other_iou: float = 0.3
    tolerance: float = 0.1
    least_tolerance_m: float = 0.5
    sensor_m: tuple[float, float, float] = (1.43, 0.0, 2.18)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tolerance < 0 or self.least_tolerance_m <= 0:
            raise ConfigError(
                f"tolerance, least_tolerance_m: expected 0 or more and more than 0, got {self.tolerance}, "
                f"{self.least_tolerance_m}"
            )
        if len(self.sensor_m) != 3:
            raise ConfigError(f"sensor_m: expected x, y, z, got {self.sensor_m}")

    @property
    def levels(self) -> tuple[int, ...]:
        """The levels that are scored: 2, which holds all boxes."""
        return (2,)
