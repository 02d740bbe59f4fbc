"""The options of KITTI's average precision."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any, Literal

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.options import check_range_bins, json_options, option_text

DIFFICULTIES: dict[str, tuple[float, int, float]] = {  # least height in pixels, largest occlusion and truncation
    "easy": (40.0, 0, 0.15),
    "moderate": (25.0, 1, 0.30),
    "hard": (25.0, 2, 0.50),
}
NEIGHBOURS = {"Car": ("Van",), "Pedestrian": ("Person_sitting",)}
_STRICT = ("Car", "car", "Van", "vehicle", "Vehicle")


@dataclass(frozen=True, kw_only=True)
class KittiSettings:
    """Options of KITTI's average precision.

    Args:
        label: The class that is scored.
        relabel: Class names that stand for another.
        ignore: Classes whose annotated boxes may be found or not; None takes KITTI's neighbours (Van for Car).
        min_overlap: IoU that a match must exceed; None takes 0.7 for cars and vehicles and 0.5 for all else.
        dontcare: ``"image"``: detections that lie in a DontCare region of the image are not false.
        range_bins_m: Edges of the half-open range bins; both kinds of boxes are cut by their own 2D range.
        region: As for the other protocols.
        window_m: As for the other protocols.
        bootstrap: How intervals are drawn.
    """

    label: str = "Car"
    relabel: Mapping[str, str] = field(default_factory=lambda: {"large_vehicle": "vehicle"})
    ignore: tuple[str, ...] | None = None
    min_overlap: float | None = None
    dontcare: Literal["none", "image"] = "none"
    range_bins_m: tuple[float, ...] = (0.0, 70.0, 150.0, 250.0)
    region: Literal["window", "range", "none"] = "none"
    window_m: tuple[float, float, float, float] = (0.0, 250.0, -50.0, 50.0)
    bootstrap: Bootstrap = field(default_factory=Bootstrap)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ignore", NEIGHBOURS.get(self.label, ()) if self.ignore is None else self.ignore)
        object.__setattr__(self, "min_overlap", self.least_overlap)
        if not 0 < self.least_overlap < 1:
            raise ConfigError(f"min_overlap: expected a number between 0 and 1, got {self.min_overlap}")
        check_range_bins(self.range_bins_m)
        if self.dontcare not in ("none", "image") or self.region not in ("window", "range", "none"):
            raise ConfigError(f"expected dontcare none or image and region window, range or none, got {self}")
        if self.label in (self.ignore or ()):
            raise ConfigError(f"label: {self.label!r} is also ignored; take it out of ignore to score it")

    @property
    def least_overlap(self) -> float:
        """IoU that a match must exceed."""
        return (0.7 if self.label in _STRICT else 0.5) if self.min_overlap is None else self.min_overlap

    @property
    def bins_m(self) -> tuple[tuple[float, float], ...]:
        """The half-open range bins as (low, high)."""
        return tuple(pairwise(self.range_bins_m))

    def to_json(self) -> dict[str, Any]:
        """All options as JSON values."""
        return json_options(asdict(self))

    def convention(self) -> str:
        """The chosen options in one line."""
        shown = {name: value for name, value in self.to_json().items() if name not in ("bootstrap", "label")}
        if self.region != "window":
            del shown["window_m"]
        return "exact rotated IoU; " + option_text(shown)
