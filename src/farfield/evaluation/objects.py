"""Which annotated boxes were found: for pictures and points-per-box plots, not for scores (those are in metrics)."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool

from farfield.geometry.boxes import Boxes
from farfield.metrics.presenting import HitRule
from farfield.vocabulary.scores import SHOWN_SCORE

VEHICLES = ("vehicle", "large_vehicle")
Key = tuple[str, str]


def of_classes(boxes: Boxes, labels: Collection[str] | None) -> Bool[np.ndarray, " n"]:
    """Which boxes bear one of the labels, shape (n,); all of them if ``labels`` is None."""
    return np.ones(len(boxes), dtype=bool) if labels is None else np.isin(boxes.label, list(labels))


def confident(predictions: Boxes, score_min: float) -> Boxes:
    """The predictions whose score is at least ``score_min``; all of them where there are no scores."""
    return predictions if predictions.score is None else predictions[predictions.score >= score_min]


def shown_predictions(predictions: Boxes | None, score_min: float) -> tuple[Boxes | None, str]:
    """The predictions that a picture shows, and what it says of the others; nothing where it shows all."""
    if predictions is None:
        return None, ""
    shown = confident(predictions, score_min)
    if len(shown) == len(predictions):
        return shown, ""
    return shown, f"{len(shown)} of {len(predictions)} boxes: score {score_min:g} or more"


def annotated_objects(
    predictions: Mapping[Key, Boxes],
    annotations: Mapping[Key, Boxes],
    *,
    labels: Collection[str] | None = VEHICLES,
    score_min: float = SHOWN_SCORE,
    finding: HitRule | None = None,
    kind: str = "lidar",
) -> dict[str, Any]:
    """Collect range, point count and whether found of every annotated object, as JSON values for a report.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotations: Annotated boxes by (sequence, frame); boxes without a known point count are left out.
        labels: Classes that count; None for all.
        score_min: Predictions below it do not find anything.
        finding: When a box counts as found; within 2 m unless given.
        kind: Of which sensor the points are.

    Returns:
        Lists ``range_m``, ``point_count``, ``found`` of equal length, ``score_min``, and ``finding`` in words.
    """
    finding = finding or HitRule()
    range_m: list[float] = []
    point_count: list[int] = []
    found: list[bool] = []
    for key, annotated in annotations.items():
        annotated = annotated[of_classes(annotated, labels)]
        if annotated.point_count is None:
            continue
        detected = confident(predictions.get(key, Boxes.empty(scored=True)), score_min)
        finder = finding.found_by(detected[of_classes(detected, labels)], annotated)
        known = annotated.point_count >= 0
        range_m += np.round(annotated.range_m[known], 2).tolist()
        point_count += annotated.point_count[known].tolist()
        found += (finder[known] >= 0).tolist()
    rows = {"range_m": range_m, "point_count": point_count, "found": found}
    return {**rows, "score_min": score_min, "finding": str(finding), "kind": kind}
