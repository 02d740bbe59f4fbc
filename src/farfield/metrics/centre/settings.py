"""Every choice that a score by centre distance depends on, with the choices possible.

The Cirrus paper leaves them open, so each is an option, and the chosen setting stands beside every result. Row numbers
are those of the list of ambiguities in ``docs/metrics.md``.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Any, ClassVar, Literal

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.options import check_numbers, check_range_bins, json_options, option_text

_CHOICES: dict[str, tuple[str, ...]] = {
    "distance": ("3d", "bev"),
    "omega_range": ("gt", "pred"),
    "match": ("nearest", "nearest_normalised"),
    "ap": ("nuscenes", "interp101", "area", "voc"),
    "aiou": ("yaw", "scale", "bev"),
    "aiou_mean": ("nuscenes", "tp_mean"),
    "range_assign": ("filter", "match_then_bin"),
    "region": ("window", "range", "none"),
    "ties": ("nearest_first", "stable", "later_first"),
    "scores": ("rank", "raw", "sigmoid", "auto"),
}


@dataclass(frozen=True, kw_only=True)
class CentreSettings:
    """Options of the scores that match boxes by the distance of their centres (DDS, wDDS, nuScenes).

    Args:
        label: The class that is scored (row 5: classes are never averaged).
        relabel: Class names that stand for another (row 12: Cirrus' vehicle includes large_vehicle).
        ignore: Classes whose annotated boxes are neither right nor wrong to find (row 13).
        thresholds_m: Distance thresholds whose AP is averaged.
        epsilons: Values of epsilon in omega = exp(epsilon d); 0 is plain DDS.
        distance: Between centres in ``"3d"`` or in the x-y plane, ``"bev"`` (row 1).
        omega_range: d is the 2D range of the annotated (``"gt"``) or predicted box (``"pred"``) (row 2).
        match: The nearest free box by distance, or by distance over omega (row 3).
        ap: Area under the curve (row 4), see :func:`farfield.metrics.curves.average_precisions`.
        aiou: Aligned IoU with yaw kept, of sizes alone, or in the x-y plane with yaw (row 6).
        aiou_threshold_m: Matches whose aIoU and errors are taken: a threshold, or ``"all"`` for the mean over
            ``thresholds_m`` (row 7). Omega widens it too.
        aiou_mean: nuScenes' recall-averaged running mean, or the plain mean over matches (row 8).
        range_bins_m: Edges of the half-open range bins, 2D range (row 9).
        range_assign: Cut annotated and predicted boxes by their own range and match inside each bin, or match first
            and then count matches where the annotated box is and false positives where they are (row 9).
        region: ``"window"``: ``window_m`` and the outermost bin edges; ``"range"``: the outermost bin edges;
            ``"none"``: everything (rows 10 and 11). The overall score is one pooled evaluation of the region.
        window_m: x from, x to, y from, y to, both ends included.
        min_points: Annotated boxes known to hold fewer points are removed (row 14).
        max_boxes: Only so many predictions a frame count, the best of all classes (row 15).
        ties: Order of equal scores (row 15): ``"nearest_first"``, see :func:`farfield.metrics.frames.nearest_first`, on
            which the order of a file's lines does not bear; or an order of lines, see
            :func:`farfield.metrics.centre.matching.rank_predictions`.
        scores: Confidence used for resampling (row 17): dense rank in (0, 1], as given, logistic, or ``"auto"``:
            logistic if any score lies outside [0, 1], else as given.
        bootstrap: How intervals are drawn.

    Raises:
        ConfigError: If an option is not one of those possible.
    """

    with_aiou: ClassVar[bool] = True  # whether aligned IoU, and with it DDS, is among the figures
    ignores_few: ClassVar[bool] = False  # whether boxes of fewer points than min_points are ignored, not removed
    seam_m: ClassVar[float] = 0.0  # so far outside the window's edges in x annotated boxes are ignored, not removed

    label: str = "vehicle"
    relabel: Mapping[str, str] = field(default_factory=lambda: {"large_vehicle": "vehicle"})
    ignore: tuple[str, ...] = ("unknown",)
    thresholds_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    epsilons: tuple[float, ...] = (0.0, 0.003, 0.006, 0.009)
    distance: Literal["3d", "bev"] = "3d"
    omega_range: Literal["gt", "pred"] = "gt"
    match: Literal["nearest", "nearest_normalised"] = "nearest"
    ap: Literal["nuscenes", "interp101", "area", "voc"] = "nuscenes"
    aiou: Literal["yaw", "scale", "bev"] = "yaw"
    aiou_threshold_m: float | Literal["all"] = 2.0
    aiou_mean: Literal["nuscenes", "tp_mean"] = "nuscenes"
    range_bins_m: tuple[float, ...] = (0.0, 70.0, 150.0, 250.0)
    range_assign: Literal["filter", "match_then_bin"] = "filter"
    region: Literal["window", "range", "none"] = "window"
    window_m: tuple[float, float, float, float] = (0.0, 250.0, -50.0, 50.0)
    min_points: int = 0
    max_boxes: int = 500
    ties: Literal["nearest_first", "stable", "later_first"] = "nearest_first"
    scores: Literal["rank", "raw", "sigmoid", "auto"] = "rank"
    bootstrap: Bootstrap = field(default_factory=Bootstrap)

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise ConfigError(f"{name}: expected one of {', '.join(choices)}, got {getattr(self, name)!r}")
        check_range_bins(self.range_bins_m)
        check_numbers(self)
        if not self.thresholds_m or min(self.thresholds_m) <= 0 or len(set(self.thresholds_m)) < len(self.thresholds_m):
            raise ConfigError(f"thresholds_m: expected different positive distances, got {self.thresholds_m}")
        if not self.epsilons or min(self.epsilons) < 0 or len(set(self.epsilons)) < len(self.epsilons):
            raise ConfigError(f"epsilons: expected different values from 0 on, got {self.epsilons}")
        aiou_m = self.aiou_threshold_m
        if not (aiou_m == "all" or (isinstance(aiou_m, int | float) and aiou_m > 0)):
            raise ConfigError(f"aiou_threshold_m: expected a positive distance or 'all', got {aiou_m!r}")
        if self.max_boxes < 1 or self.min_points < 0:
            limits = f"{self.max_boxes} and {self.min_points}"
            raise ConfigError(f"expected max_boxes of at least 1 and min_points of at least 0, got {limits}")
        if self.label in self.ignore:
            raise ConfigError(f"label: {self.label!r} is also ignored; take it out of ignore to score it")

    @property
    def bins_m(self) -> tuple[tuple[float, float], ...]:
        """The half-open range bins as (low, high)."""
        return tuple(pairwise(self.range_bins_m))

    @property
    def error_thresholds_m(self) -> tuple[float, ...]:
        """Thresholds at whose matches aIoU and errors are taken."""
        return self.thresholds_m if self.aiou_threshold_m == "all" else (float(self.aiou_threshold_m),)

    @property
    def all_thresholds_m(self) -> tuple[float, ...]:
        """Thresholds at which boxes are matched: those whose AP is averaged, then those of the errors."""
        return tuple(dict.fromkeys((*self.thresholds_m, *self.error_thresholds_m)))

    def with_seam(self) -> "CentreSettings":
        """The same settings with a window that is wider by the seam."""
        x_from, x_to, y_from, y_to = self.window_m
        return replace(self, window_m=(x_from - self.seam_m, x_to + self.seam_m, y_from, y_to))

    def to_json(self) -> dict[str, Any]:
        """All options as JSON values."""
        return json_options(asdict(self))

    def convention(self) -> str:
        """The chosen options in one line of ``name=value`` pairs."""
        shown = {name: value for name, value in self.to_json().items() if name not in ("bootstrap", "label")}
        if self.region != "window":
            del shown["window_m"]
        return option_text(shown)
