"""The detection metrics of nuScenes as a named protocol, for one class of any data set.

Centre distance in the x-y plane; AP above recall and precision 0.1 at 0.5, 1, 2 and 4 m; translation (metres), scale
(1 - IoU of sizes) and orientation error (radians) of the matches at 2 m; score ties broken as the devkit does (later
index first). Velocity and attributes are not scored, hence no NDS.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from farfield.frame.drive import Drive
from farfield.metrics.centre.protocol import CentreProtocol, evaluate_centre
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.frames import BoxesByFrame
from farfield.metrics.result import Result, table, value_at

if TYPE_CHECKING:
    from farfield.metrics.detections import Detections


@dataclass(frozen=True, kw_only=True)
class NuScenesSettings(CentreSettings):
    """The nuScenes detection configuration (see :class:`CentreSettings` for the options)."""

    with_aiou: ClassVar[bool] = False

    label: str = "car"
    ignore: tuple[str, ...] = ()
    epsilons: tuple[float, ...] = (0.0,)
    distance: Literal["3d", "bev"] = "bev"
    region: Literal["window", "range", "none"] = "none"
    ties: Literal["stable", "later_first"] = "later_first"
    scores: Literal["rank", "raw", "sigmoid", "auto"] = "auto"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class NuScenesResult(Result):
    """AP by threshold and the true-positive errors, by range."""

    def __str__(self) -> str:
        counts = self.counts["ranges"] | {"overall": self.counts}
        names = ["map", *(name for name in self.figures if name.startswith(("ap/", "errors/")))]
        rows = []
        for name in names:
            shown = name.replace("ap/", "AP at ").replace("errors/", "").replace("map", "mAP")
            rows.append([shown + (" m" if name.startswith("ap/") else ""), *(self.cell(p, name) for p in counts)])
        rows += [[name, *(str(part[name]) for part in counts.values())] for name in ("annotated", "predictions")]
        title = f"nuScenes detection metrics of {self.label!r}, by range in metres; '-': nothing annotated"
        return f"{title}\n\n{table(['', *counts], rows)}\n\n{self.footer()}"


def evaluate_nuscenes(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: NuScenesSettings | None = None,
    *,
    drives: Sequence[Drive] = (),
    reach_m: float | None = None,
) -> NuScenesResult:
    """Score predictions as the nuScenes devkit does.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes the protocol's.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.
        reach_m: Range bins that begin here or beyond are not in the mean of the bins.

    Returns:
        Figures named ``ap/THRESHOLD``, ``errors/NAME`` and ``map``.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    settings = settings or NuScenesSettings()
    found = evaluate_centre(predictions, annotations, settings, protocol=NuScenes.name, drives=drives, reach_m=reach_m)
    return NuScenesResult(**found)


class NuScenes(CentreProtocol):
    """The detection metrics of nuScenes."""

    name = "nuscenes"
    Settings = NuScenesSettings

    def evaluate(self, found: "Detections", settings: NuScenesSettings) -> NuScenesResult:
        """AP by threshold and errors, by range."""
        return evaluate_nuscenes(found.boxes, found.annotated, settings, drives=found.drives, reach_m=found.reach_m)

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """The mean AP."""
        return {"map": value_at(result, "map")}
