"""The detection metrics of nuScenes (Caesar et al., CVPR 2020, section 3.1), for one class of any data set.

A prediction matches the nearest free annotated box if their centres in the x-y plane are nearer than a threshold t:

    AP(t) = mean over recalls r = 0.11 ... 1 of max(p(r) - 0.1, 0), over 0.9
    mAP   = mean of AP(t) over t = 0.5, 1, 2, 4 m
    translation error  distance of the centres, metres         } means over the matches at 2 m: the running mean by
    scale error        1 - IoU of the sizes, aligned           } confidence, averaged over the recalls from 0.11 to the
    orientation error  difference of the headings, radians     } highest one reached

Of equal scores the nearer box comes first, so that no figure depends on the order of a file's lines; the devkit puts
the later line first, as ``ties="later_first"`` does, and its mean errors change with that order. Velocity and
attributes are not scored, hence no NDS.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from farfield.frame.drive import Drive
from farfield.metrics.centre.evaluation import evaluate_centre
from farfield.metrics.centre.protocol import CentrePresenter, CentreProtocol, distance_words, distances
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.detections import Detections
from farfield.metrics.frames import BoxesByFrame
from farfield.metrics.presenting import Presentation
from farfield.metrics.result import Result, table, value_at


@dataclass(frozen=True, kw_only=True)
class NuScenesSettings(CentreSettings):
    """The nuScenes detection configuration (see :class:`CentreSettings` for the options)."""

    with_aiou: ClassVar[bool] = False

    label: str = "car"
    ignore: tuple[str, ...] = ()
    epsilons: tuple[float, ...] = (0.0,)
    distance: Literal["3d", "bev"] = "bev"
    region: Literal["window", "range", "none"] = "none"
    ties: Literal["nearest_first", "stable", "later_first"] = "nearest_first"
    scores: Literal["rank", "raw", "sigmoid", "auto"] = "auto"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class NuScenesResult(Result):
    """AP by threshold and the true-positive errors, by range."""

    heading: ClassVar[str] = "nuScenes detection metrics"

    def __str__(self) -> str:
        counts = self.counts["ranges"] | {"overall": self.counts}
        names = ["map", *(name for name in self.figures if name.startswith(("ap/", "errors/")))]
        rows = []
        for name in names:
            shown = name.replace("ap/", "AP at ").replace("errors/", "").replace("map", "mAP")
            rows.append([shown + (" m" if name.startswith("ap/") else ""), *(self.cell(p, name) for p in counts)])
        rows += [[name, *(str(part[name]) for part in counts.values())] for name in ("annotated", "predictions")]
        title = f"{self.heading} of {self.label!r}, by range in metres; '-': nothing annotated"
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
    fields = evaluate_centre(predictions, annotations, settings, protocol=NuScenes.name, drives=drives, reach_m=reach_m)
    return NuScenesResult(**fields)


class NuScenesPresenter(CentrePresenter):
    """How NuScenes is shown."""

    def title(self, figure: str) -> str:
        """mAP, AP with its distance, the errors in full."""
        return {"map": "mAP", **_ERRORS}.get(figure, super().title(figure))

    def setting_title(self, name: str) -> str:
        """The distance at which errors are taken by what it is here."""
        return {"aiou_threshold_m": "error_threshold_m"}.get(name, name)

    def unit(self, figure: str) -> str:
        """Metres and radians of the errors."""
        return {"errors/trans_err": "m", "errors/orient_err": "rad"}.get(figure, "")

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """Mean AP and the APs, then the errors of what was detections."""
        limit = (result.get("settings") or {}).get("aiou_threshold_m", 2.0)
        within = f" within {limit:g} m" if isinstance(limit, int | float) else ""
        return Presentation(
            figures=("map", *distances(result)),
            about="mAP is the mean of the APs, each for another largest distance between predicted and annotated "
            "centre, seen from above.",
            parts=tuple(f"errors/{name}" for name in result.get("errors") or ()),
            parts_title="Errors of what was found",
            about_parts=f"Means over the matches{within}: distance of the centres, 1 less the overlap of the sizes, "
            "difference of the headings. Smaller is better; 1 stands where too little was detections.",
            about_curves="Each line allows another distance between the predicted and the annotated centre.",
            glossary=(
                (
                    "AP",
                    "Average precision: the area under the precision-recall curve above a recall and a precision of "
                    f"0.1, for predictions whose centre lies within {distance_words(result)} of the annotated one.",
                ),
                ("mAP", "The mean of the APs over these distances, of one class."),
            ),
        )


class NuScenes(CentreProtocol):
    """The detection metrics of nuScenes."""

    name = "nuscenes"
    Settings = NuScenesSettings
    presenter = NuScenesPresenter()

    def evaluate(self, detections: Detections, settings: NuScenesSettings) -> NuScenesResult:
        """AP by threshold and errors, by range."""
        return evaluate_nuscenes(
            detections.boxes, detections.annotated, settings, drives=detections.drives, reach_m=detections.reach_m
        )

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """The mean AP."""
        return {"map": value_at(result, "map")}

    def inert(self, settings: Mapping[str, Any]) -> Collection[str]:
        """Besides those of every protocol: how boxes are aligned, and how a distance that does not grow would."""
        names = [*super().inert(settings), "aiou", "aiou_mean"]
        grows = any(settings.get("epsilons") or ())
        return names if grows else [*names, "epsilons", "omega_range"]


_ERRORS = {
    "errors/trans_err": "translation error",
    "errors/scale_err": "scale error",
    "errors/orient_err": "orientation error",
}
