"""The protocol ``nuscenes-detection``: nuScenes' detection task whole, in one result for all classes."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Weighted, point_and_intervals
from farfield.metrics.centre.detection_task import (
    ERRORS,
    DetectionTaskSettings,
    bins_of,
    gather_task,
    rank_task,
    task_figures,
    task_parts,
)
from farfield.metrics.detections import Detections, Protocol
from farfield.metrics.frames import BoxesByFrame, labels_of
from farfield.metrics.presenting import CurvePanel, Presentation, Presenter, panels
from farfield.metrics.result import Result, figure_names, table, value_at
from farfield.vocabulary.classes import NUSCENES_DETECTION_CLASSES, NUSCENES_FROM_CIRRUS

_TITLES = {
    "nds": "NDS",
    "map": "mAP",
    "errors/trans_err": "mATE",
    "errors/scale_err": "mASE",
    "errors/orient_err": "mAOE",
    "errors/vel_err": "mAVE",
    "errors/attr_err": "mAAE",
}
_UNITS = {"trans_err": "m", "orient_err": "rad", "vel_err": "m/s"}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DetectionTaskResult(Result):
    """NDS, mAP and the five errors, by range and by class."""

    heading: ClassVar[str] = "nuScenes detection task"

    def __str__(self) -> str:
        parts = ("overall", *self.ranges)
        rows = [[title, *(self.cell(part, name) for part in parts)] for name, title in _TITLES.items()]
        classes = self.settings["classes"]
        by_class = [
            [
                name,
                self.cell("overall", f"ap/{name}/mean"),
                *(_short(self.figures.get(f"class_errors/{name}/{error}")) for error in ERRORS),
                *map(str, self.counts["by_class"][name]),
            ]
            for name in classes
        ]
        head = ["class", "AP", "ATE", "ASE", "AOE", "AVE", "AAE", "annotated", "predictions"]
        title = f"{self.heading}, by range in metres; '-': nothing annotated"
        return f"{title}\n\n{table(['', *parts], rows)}\n\n{table(head, by_class)}\n\n{self.footer()}"


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


class DetectionTaskPresenter(Presenter):
    """How the detection task is shown."""

    def title(self, figure: str) -> str:
        """NDS, mAP, mATE...; of classes by their names."""
        if figure in _TITLES:
            return _TITLES[figure]
        kind, _, rest = figure.partition("/")
        name, _, limit = rest.partition("/")
        words = name.replace("_", " ")
        if kind == "ap":
            return f"AP {words}" if limit == "mean" else f"AP {words}, {limit} m"
        return (
            f"{words}, {_TITLES.get(f'errors/{limit}', limit)[1:]}" if kind == "class_errors" else super().title(figure)
        )

    def unit(self, figure: str) -> str:
        """Metres, radians and metres a second of the errors."""
        return _UNITS.get(figure.rpartition("/")[2], "") if "errors" in figure else ""

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """NDS and mAP with the mean errors, then the APs of the classes."""
        return Presentation(
            figures=tuple(name for name in _TITLES if value_at(result, name) is not None) or ("nds",),
            about="NDS is the mean of mAP, which counts five times, and of 1 less each of the five mean errors "
            "(0 where that is negative). A prediction matches an annotated box whose centre, seen from above, is near.",
            parts=tuple(name for name in figure_names(result) if name.endswith("/mean")),
            parts_title="By class",
            about_parts="AP of each class, the mean over the distances within which a prediction matches.",
            about_curves="Each line allows another distance between the predicted and the annotated centre.",
            glossary=(
                ("AP", "Average precision above a recall and a precision of 0.1."),
                (
                    "mATE, mASE, mAOE",
                    "Mean errors of place (m), size (1 - IoU) and heading (rad) of the matches at 2 m.",
                ),
                ("mAVE, mAAE", "Mean errors of velocity (m/s) and attribute (1 - share that is right)."),
            ),
        )

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """A panel for each class."""
        return panels((result.get("curves") or {}).get("overall") or {})


class DetectionTask(Protocol):
    """nuScenes' detection task: all classes, five errors, NDS."""

    name = "nuscenes-detection"
    Settings = DetectionTaskSettings
    presenter = DetectionTaskPresenter()
    uses = frozenset({"details"})
    classes = NUSCENES_FROM_CIRRUS

    def settings(self, detections: Detections, **options: Any) -> DetectionTaskSettings:
        """The settings; ``label`` is one class."""
        label = options.pop("label", None)
        if label is not None:
            relabel = self.with_own_relabel(options).get("relabel", NUSCENES_FROM_CIRRUS)
            name = NUSCENES_DETECTION_CLASSES.get(label, relabel.get(label, label))
            options["classes"] = (name,)
        settings: DetectionTaskSettings = super().settings(detections, **options)
        return settings

    def labels(self, boxes: BoxesByFrame, **options: Any) -> tuple[str, ...]:
        """The classes of the settings that occur, the most frequent first."""
        options = self.with_own_relabel(options)
        chosen = {name: options[name] for name in ("relabel", "classes", "ranges") if name in options}
        settings = DetectionTaskSettings(**chosen)
        names = dict(NUSCENES_DETECTION_CLASSES) | dict(settings.relabel)
        return tuple(name for name, _ in labels_of(boxes, names) if name in settings.classes)

    def each(self, detections: Detections, *, label: str | None = None, **options: Any) -> list[DetectionTaskSettings]:
        """One result for all classes; refused if none of them is annotated but others are."""
        settings = self.settings(detections, label=label, **options)
        annotated = gather_task(detections, settings).annotated.name
        if not len(annotated) and any(map(len, detections.annotated.values())):
            names = dict(NUSCENES_DETECTION_CLASSES) | dict(settings.relabel)
            present = [name for name, _ in labels_of(detections.annotated, names)]
            if not set(present) & set(settings.classes):
                raise ConfigError(
                    f"{self}: expected annotated boxes of {' or '.join(settings.classes)}, got "
                    f"{', '.join(present[:8])}. Rename with --options relabel=old:new"
                )
        return [settings]

    def evaluate(self, detections: Detections, settings: DetectionTaskSettings) -> DetectionTaskResult:
        """NDS, mAP and errors, by class and by range."""
        scene = gather_task(detections, settings)
        parts = rank_task(scene, settings)
        figures = partial(task_figures, parts, settings, bins_of(settings, detections.reach_m))
        point, intervals = point_and_intervals(figures, scene.n_groups, settings.bootstrap)
        counts = {
            name: {
                "annotated": sum(part.annotated.values()),
                "predictions": sum(part.predicted.values()),
                "by_class": {label: [part.annotated[label], part.predicted[label]] for label in settings.classes},
            }
            for name, part in parts.items()
        }
        return DetectionTaskResult(
            protocol=self.name,
            label=", ".join(settings.classes) if len(settings.classes) < 3 else "all classes",
            settings=settings.to_json(),
            convention=settings.convention(),
            figures=point["overall"],
            ranges={name: values for name, values in point.items() if name not in ("overall", "mean_of_bins")},
            mean_of_bins=point["mean_of_bins"],
            counts={"frames": scene.frames, **counts.pop("overall"), "ranges": counts},
            intervals=intervals,
            grouped_by=scene.grouped_by,
            curves={
                "overall": {
                    label: {str(float(limit)): rankings[limit] for limit in settings.thresholds_m}
                    for label, rankings in parts["overall"].ranking.items()
                }
            },
            notes=scene.notes,
        )

    def weighted(self, detections: Detections, settings: DetectionTaskSettings) -> Weighted:
        """The figures of the whole, of each bin and the mean of the bins as functions of group weights."""
        scene = gather_task(detections, settings)
        parts = task_parts(scene, settings, detections.reach_m)
        return Weighted(parts=parts, groups=tuple(scene.group.tolist()), grouped_by=scene.grouped_by)

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """NDS and mAP."""
        return {name: value_at(result, name) for name in ("nds", "map")}

    def inert(self, settings: Mapping[str, Any]) -> Collection[str]:
        """Besides those of every protocol, the bins: the classes' ranges bound the whole."""
        return [*super().inert(settings), "range_bins_m"]
