"""KITTI's average precision as a protocol: the 2D facts of the annotation make its difficulties."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.metrics.bootstrap import Weighted
from farfield.metrics.detections import Detections, Protocol
from farfield.metrics.frames import has_label
from farfield.metrics.kitti.evaluation import Details, KittiResult, KittiSettings, evaluate_kitti, weighted_kitti
from farfield.metrics.presenting import CurveLine, CurvePanel, HitRule, Presentation, Presenter, panels
from farfield.metrics.result import figure_names, value_at

FACTS = ("truncation", "occlusion", "box_px")


class KittiPresenter(Presenter):
    """How KittiProtocol is shown."""

    per_cent = True

    def title(self, figure: str) -> str:
        """Overlap, recall points and difficulty: ``AP3D R40 moderate``."""
        kind, _, difficulty = figure.removeprefix("ap/").partition("/")
        measure, _, points = kind.partition("_")
        if measure not in _MEASURES or not points:
            return super().title(figure)
        return " ".join([_MEASURES[measure], points.upper(), *([difficulty] if difficulty not in ("", "all") else [])])

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """AP over 40 recalls, then over 11."""
        settings = result.get("settings") or {}
        least = settings.get("min_overlap")
        overlap = f"more than {least:g}" if isinstance(least, int | float) else "enough"
        old = [name for name in figure_names(result) if "_r11/" in name]
        return Presentation(
            about=f"A prediction finds a box that it overlaps by {overlap}, in space (AP3D) or seen from above "
            "(APBEV). R40 is the mean precision at 40 recalls.",
            parts=tuple(sorted(old, key=_rank)),
            parts_title="Over 11 recalls",
            about_parts="R11 is the mean precision at 11 recalls, as until 2019.",
            about_curves="Each line is a difficulty of the annotated objects.",
            glossary=_GLOSSARY,
            finding=HitRule("3d", float(least)) if isinstance(least, int | float) else HitRule("3d", 0.5),
        )

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """A panel for each overlap, in space first."""
        curves = (result.get("curves") or {}).get("overall") or {}
        named = {_MEASURES.get(name, name): curves[name] for name in sorted(curves, key=_measure_rank)}
        return [CurvePanel(panel.title, tuple(sorted(panel.lines, key=_line_rank))) for panel in panels(named)]


class KittiProtocol(Protocol):
    """KITTI's average precision."""

    name = "kitti"
    Settings = KittiSettings
    presenter = KittiPresenter()
    uses = frozenset({"details"})

    def evaluate(self, detections: Detections, settings: KittiSettings) -> KittiResult:
        """AP by overlap, recall points and difficulty; one difficulty, and a note, where there are no 2D facts.

        Raises:
            ConfigError: If no annotated or no predicted box has the 2D facts of its files, so that none counts.
        """
        lacking = _without_facts(detections, settings)
        result = evaluate_kitti(
            detections.boxes,
            detections.annotated,
            settings,
            prediction_details=detections.prediction_details,
            annotation_details=_annotated_facts(detections),
            drives=detections.drives,
        )
        some = [annotation for annotation in detections.annotations.values() if len(annotation)]
        if not some or all(name in annotation.details for annotation in some for name in FACTS):
            return replace(result, notes=(*result.notes, *lacking))
        note = f"boxes are annotated without {', '.join(FACTS)}, so all are of one difficulty, all"
        return replace(result, notes=(*result.notes, *lacking, note))

    def weighted(self, detections: Detections, settings: KittiSettings) -> Weighted:
        """AP of the whole and of each range bin as functions of group weights."""
        return weighted_kitti(
            detections.boxes,
            detections.annotated,
            settings,
            prediction_details=detections.prediction_details,
            annotation_details=_annotated_facts(detections),
            drives=detections.drives,
        )

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """AP over 40 recalls: in space before from above and in the image, moderate before the other difficulties."""
        names = [name for name in figure_names(result) if "_r40/" in name]
        return {name: value_at(result, name) for name in sorted(names, key=_rank)}


def _annotated_facts(detections: Detections) -> Details:
    """The 2D facts of the annotation; an occlusion that is known of no box hides none."""
    facts = {key: facts_of(annotation) for key, annotation in detections.annotations.items()}
    if not _no_occlusion(facts):
        return facts
    return {
        key: columns | {"occlusion": np.zeros_like(columns["occlusion"])} if "occlusion" in columns else columns
        for key, columns in facts.items()
    }


def _no_occlusion(facts: Details) -> int:
    """The number of annotated boxes where the occlusion of each is unknown; 0 where that of one is known."""
    columns = [np.asarray(columns["occlusion"]) for columns in facts.values() if "occlusion" in columns]
    values = np.concatenate(columns) if columns else np.zeros(0)
    return len(values) if (values == _HIDDEN_UNKNOWN).all() else 0


def _without_facts(detections: Detections, settings: KittiSettings) -> list[str]:
    """Notes on boxes of which a 2D fact is not known: those that KITTI's rules pass over, and what was done without it.

    Raises:
        ConfigError: If no annotated, or no predicted, box has a 2D box.
    """
    annotated = {key: annotation.details for key, annotation in detections.annotations.items()}
    unknown = _no_occlusion(annotated)
    notes = [_NO_OCCLUSION.format(unknown)] if unknown else []
    sides = (
        ("annotated", detections.annotated, annotated, "box_px"),
        *([] if unknown else [("annotated", detections.annotated, annotated, "occlusion")]),
        ("predicted", detections.boxes, detections.prediction_details, "box_px"),
    )
    for side, boxes_by_frame, details, fact in sides:
        count = lacking = label_count = label_lacking = 0
        for key, boxes in boxes_by_frame.items():
            if key not in annotated or fact not in details.get(key, {}) or not len(boxes):
                continue
            values = np.asarray(details[key][fact])
            without = values == _HIDDEN_UNKNOWN if fact == "occlusion" else values[:, 3] == values[:, 1]
            own = has_label(boxes, settings.label, settings.relabel)
            count, lacking = count + len(boxes), lacking + int(without.sum())
            label_count, label_lacking = label_count + int(own.sum()), label_lacking + int((without & own).sum())
        what = _FACT_WORDS[fact]
        if lacking and lacking == count:
            raise ConfigError(
                f"protocol kitti: expected {what} of {side} boxes, which its difficulties need, found none in all "
                f"{count}: no box would count. Score them by --protocol dds or nuscenes, which need no image"
            )
        if label_lacking:
            notes.append(
                f"{label_lacking} of {label_count} {side} boxes of {settings.label!r} have no {what}: KITTI's rules "
                "leave them out; dds and nuscenes count them"
            )
    return notes


_HIDDEN_UNKNOWN = 3
_NO_OCCLUSION = (
    "the occlusion of all {} annotated boxes is not known (3): easy, moderate and hard are by height and truncation "
    "alone, so that hidden boxes count, which KITTI's own figures leave out"
)
_FACT_WORDS = {"box_px": "2D box in the image (0 0 0 0 or -1 -1 -1 -1)", "occlusion": "known occlusion (3)"}
_MEASURES = {"3d": "AP3D", "bev": "APBEV", "2d": "AP2D", "aos": "AOS"}
_ORDER = ("moderate", "easy", "hard", "all")
_GLOSSARY = (
    (
        "Overlap",
        "The intersection of two boxes over their union (IoU): 1 for equal boxes, 0 for boxes apart.",
    ),
    ("AP3D, APBEV, AP2D", "Average precision of boxes that overlap in space, seen from above, or in the image."),
    ("AOS", "AP2D in which a match counts by how well it faces: 1 for the right heading, 0 for the opposite one."),
    ("R40, R11", "At how many recalls precision is averaged: at 1/40 ... 1, or at 0, 0.1 ... 1."),
    (
        "Difficulty",
        "Easy, moderate and hard objects, by their height in the image, occlusion and truncation; what is harder may "
        "be found or not.",
    ),
)


def _rank(name: str) -> tuple[int, int]:
    difficulty = name.rpartition("/")[2]
    measure = name.removeprefix("ap/").partition("_")[0]
    return [*_MEASURES].index(measure) if measure in _MEASURES else 0, _ORDER.index(
        difficulty
    ) if difficulty in _ORDER else len(_ORDER)


def _measure_rank(measure: str) -> int:
    return [*_MEASURES].index(measure) if measure in _MEASURES else len(_MEASURES)


def _line_rank(line: CurveLine) -> tuple[int, int]:
    return _rank(f"/{line.name}")


def facts_of(annotation: Annotation) -> dict[str, Any]:
    """What KITTI's measure takes of an annotation besides boxes: its 2D facts and the DontCare regions."""
    columns = {name: annotation.details[name] for name in (*FACTS, "alpha_rad") if name in annotation.details}
    regions = {name: annotation.unboxed[name] for name in ("dontcare_px",) if name in annotation.unboxed}
    return columns | regions
