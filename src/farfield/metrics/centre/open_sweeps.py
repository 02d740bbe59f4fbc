"""The protocol of Open Sweeps: vehicles found within 2 m and 70 m, those of five points and more.

It is AP of nuScenes by centre distance, with what that leaves open set once: large vehicles count as vehicles; what is
annotated as ``unknown`` (doubtful objects, the measuring car) or holds fewer points is neither right nor wrong to find;
and each sweep is looked at ahead, 0 to 70 m and 50 m to both sides, and once more turned by half a turn. Where these
halves meet an object counts in the half that has its centre, and may be predicted up to 2 m in the other. Intervals
draw places.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from farfield.metrics.centre.evaluation import evaluate_centre
from farfield.metrics.centre.nuscenes import NuScenes, NuScenesResult, NuScenesSettings
from farfield.metrics.detections import Detections

REACH_M = 70.0
LEAST_POINTS = 5


@dataclass(frozen=True, kw_only=True)
class OpenSweepsSettings(NuScenesSettings):
    """The settings of Open Sweeps (see :class:`~farfield.metrics.centre.settings.CentreSettings`)."""

    ignores_few: ClassVar[bool] = True
    seam_m: ClassVar[float] = 2.0

    label: str = "vehicle"
    relabel: Mapping[str, str] = field(default_factory=lambda: {"large_vehicle": "vehicle"})
    ignore: tuple[str, ...] = ("unknown",)
    thresholds_m: tuple[float, ...] = (2.0,)
    range_bins_m: tuple[float, ...] = (0.0, 30.0, REACH_M)
    region: Literal["window", "range", "none"] = "window"
    window_m: tuple[float, float, float, float] = (0.0, REACH_M, -50.0, 50.0)
    min_points: int = LEAST_POINTS
    scores: Literal["rank", "raw", "sigmoid", "auto"] = "raw"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class OpenSweepsResult(NuScenesResult):
    """AP at 2 m and the errors of the matches, by range."""

    heading: ClassVar[str] = "AP at 2 m on Open Sweeps"


class OpenSweepsProtocol(NuScenes):
    """AP of vehicles at 2 m within 70 m, of five points and more."""

    name = "open-sweeps"
    Settings = OpenSweepsSettings

    def evaluate(self, detections: Detections, settings: NuScenesSettings) -> OpenSweepsResult:
        """AP and the errors of the matches, by range."""
        return OpenSweepsResult(
            **evaluate_centre(
                detections.boxes,
                detections.annotated,
                settings,
                protocol=self.name,
                drives=detections.drives,
                reach_m=detections.reach_m,
            )
        )
