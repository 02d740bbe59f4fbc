"""Waymo's detection metrics as protocols: ``waymo`` and, tolerant of errors along the line of sight, ``waymo-let``."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from farfield.frame.annotation import Annotation
from farfield.frame.drive import Key
from farfield.metrics.bootstrap import Weighted
from farfield.metrics.detections import Detections
from farfield.metrics.presenting import CurvePanel, HitRule, Presentation, Presenter, curve_level, panels
from farfield.metrics.result import figure_names, value_at
from farfield.metrics.several_classes import SeveralClassProtocol
from farfield.metrics.waymo.evaluation import (
    LEVEL,
    NO_LABEL_ZONE,
    WaymoFrames,
    WaymoResult,
    gather_waymo,
    waymo_result,
    weighted_waymo,
)
from farfield.metrics.waymo.settings import WaymoLetSettings, WaymoSettings

CAMERA_BOX, TOP_POINTS = "camera_box", "top_points"
"""Details of an annotated box: where it stands when the cameras see it (x, y, z, l, w, h, yaw; NaN: in none of them),
and its points of the LiDAR on the roof."""


class WaymoPresenter(Presenter):
    """How WaymoProtocol is shown."""

    per_cent = True
    words: ClassVar[Mapping[str, str]] = {"ap": "AP", "aph": "APH", "apl": "APL"}

    def title(self, figure: str) -> str:
        """Class, figure and level: ``vehicle APH level 1``."""
        path = figure.removeprefix("ap/").split("/")
        if len(path) < 2 or path[-1] not in self.words:
            return super().title(figure)
        return " ".join(
            [*(word.replace("_", " ") for word in path[:-2]), self.words[path[-1]], path[-2].replace("_", " ")]
        )

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """The figures of level 2 first."""
        names, settings = figure_names(result), result.get("settings") or {}
        iou = settings.get("vehicle_iou")
        rule = HitRule("3d", float(iou)) if isinstance(iou, int | float) else HitRule("3d", 0.7)
        hard = [name for name in names if "/level_2/" in name]
        return Presentation(
            figures=tuple(hard) or tuple(names),
            about=f"Of each frame the pairs match that overlap most: vehicles {rule.limit:g} or more in space, "
            f"others {settings.get('other_iou', 'less')}. AP is the area below the precision over 101 score cut-offs.",
            parts=tuple(name for name in names if name not in hard),
            parts_title="Level 1 only",
            about_parts="Boxes of five points and fewer, or said to be hard, are of level 2 and need not be found.",
            about_curves="Each line is a level.",
            glossary=_GLOSSARY,
            finding=rule,
        )

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """A panel for each class."""
        shown = []
        for label, node in curve_level((result.get("curves") or {}).get("overall"), "overall").items():
            named = {name.replace("_", " "): curve for name, curve in curve_level(node, label).items()}
            shown += [CurvePanel(label.replace("_", " "), panel.lines) for panel in panels(named)]
        return shown


class WaymoLetPresenter(WaymoPresenter):
    """How WaymoLetProtocol is shown."""

    words: ClassVar[Mapping[str, str]] = {"ap": "LET-AP", "aph": "LET-APH", "apl": "LET-APL"}


class WaymoProtocol(SeveralClassProtocol):
    """Waymo's AP and APH at levels 1 and 2."""

    name = "waymo"
    Settings = WaymoSettings
    presenter = WaymoPresenter()
    uses = frozenset({"details"})
    classes: ClassVar[Mapping[str, str]] = {
        "Vehicle": "vehicle",
        "Pedestrian": "pedestrian",
        "Sign": "sign",
        "Cyclist": "cyclist",
    }

    def evaluate(self, detections: Detections, settings: WaymoSettings) -> WaymoResult:
        """AP and APH by class, level and range.

        Raises:
            ConfigError: If scores lie beyond 0 to 1.
        """
        data, notes = self._gathered(detections, settings)
        result = waymo_result(data, settings, len(detections.annotations))
        return replace(result, notes=(*result.notes, *notes))

    def weighted(self, detections: Detections, settings: WaymoSettings) -> Weighted:
        """The figures of the whole and of each range bin as functions of group weights."""
        return weighted_waymo(self._gathered(detections, settings)[0], settings)

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """Every figure: level 2 before 1, that with heading first, as the leaderboard has it."""
        names = sorted(figure_names(result), key=_rank)
        return {name: value_at(result, name) for name in names if name.startswith("ap/")}

    def _annotated(self, detections: Detections) -> tuple[Mapping[Key, Annotation], list[str]]:
        """The annotations as they are scored, and notes."""
        return detections.annotations, []

    def _gathered(self, detections: Detections, settings: WaymoSettings) -> tuple[WaymoFrames, list[str]]:
        annotations, notes = self._annotated(detections)
        data = gather_waymo(
            detections.boxes,
            {key: annotation.boxes for key, annotation in annotations.items()},
            settings,
            prediction_details={key: _only(rows, NO_LABEL_ZONE) for key, rows in detections.prediction_details.items()},
            annotation_details={key: _only(annotation.details, LEVEL) for key, annotation in annotations.items()},
            drives=detections.drives,
        )
        return data, notes


class WaymoLetProtocol(WaymoProtocol):
    """The longitudinal error tolerant LET-3D-APL, LET-3D-AP and LET-3D-APH, for detectors that see by cameras."""

    name = "waymo-let"
    Settings = WaymoLetSettings
    presenter = WaymoLetPresenter()

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """Every figure, LET-3D-APL first."""
        names = sorted(figure_names(result), key=lambda name: (not name.endswith("/apl"), _rank(name)))
        return {name: value_at(result, name) for name in names if name.startswith("ap/")}

    def _annotated(self, detections: Detections) -> tuple[Mapping[Key, Annotation], list[str]]:
        """Boxes where the cameras see them, where these are known: the others do not count."""
        annotations, hidden = {}, 0
        if not any(CAMERA_BOX in annotation.details for annotation in detections.annotations.values()):
            return detections.annotations, [
                "where boxes stand when the cameras see them is not known: they are scored as they stand for the "
                "LiDAR, and boxes in no camera's view count too"
            ]
        for key, annotation in detections.annotations.items():
            camera_box = np.asarray(annotation.details.get(CAMERA_BOX, np.zeros((0, 7))), dtype=np.float64).reshape(
                -1, 7
            )
            if len(camera_box) != len(annotation.boxes):
                camera_box = np.full((len(annotation.boxes), 7), np.nan)
            visible = np.asarray(np.isfinite(camera_box).all(axis=1))
            hidden += int((~visible).sum())
            part, rows = annotation[visible], camera_box[visible]
            boxes = part.boxes.replace(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6])
            if TOP_POINTS in part.details:
                boxes = boxes.replace(point_count=np.asarray(part.details[TOP_POINTS], dtype=np.int64))
            annotations[key] = part.replaced(boxes)
        notes = [f"{hidden} annotated boxes are in no camera's view and do not count"] if hidden else []
        return annotations, notes


def _only(details: Mapping[str, Any], name: str) -> dict[str, Any]:
    return {name: details[name]} if name in details else {}


_ORDER = ("aph", "ap", "apl")
_GLOSSARY = (
    ("Level", "Level 1: objects of more than five points. Level 2: these and the harder ones."),
    ("APH", "AP in which a match counts by how well it faces: 1 for the right heading, 0 for the opposite one."),
    ("APL", "AP in which a match counts by how right its distance from the camera is."),
)


def _rank(name: str) -> tuple[int, int]:
    last = name.rpartition("/")[2]
    return int("/level_2/" not in name), _ORDER.index(last) if last in _ORDER else len(_ORDER)
