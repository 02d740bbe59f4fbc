"""Which annotated boxes were found: for pictures and points-per-box plots, not for scores (those are in metrics)."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool

from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.matching import found_by

VEHICLES = ("vehicle", "large_vehicle")
Key = tuple[str, str]


def of_classes(boxes: Boxes, labels: Collection[str] | None) -> Bool[np.ndarray, " n"]:
    """Which boxes bear one of the labels, shape (n,); all of them if ``labels`` is None."""
    return np.ones(len(boxes), dtype=bool) if labels is None else np.isin(boxes.label, list(labels))


def sure(predictions: Boxes, score_min: float) -> Boxes:
    """The predictions whose score is at least ``score_min``; all of them where there are no scores."""
    return predictions if predictions.score is None else predictions[predictions.score >= score_min]


def annotated_objects(
    predictions: Mapping[Key, Boxes],
    annotations: Mapping[Key, Boxes],
    *,
    labels: Collection[str] | None = VEHICLES,
    score_min: float = 0.3,
    distance_m: float = 2.0,
) -> dict[str, Any]:
    """Collect range, point count and whether found of every annotated object, as JSON values for a report.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotations: Annotated boxes by (sequence, frame); boxes without a known point count are left out.
        labels: Classes that count; None for all.
        score_min: Predictions below it do not find anything.
        distance_m: Largest centre distance in the x-y plane at which a box counts as found.

    Returns:
        Lists ``range_m``, ``point_count``, ``found`` of equal length, and ``score_min`` and ``distance_m``.
    """
    range_m: list[float] = []
    point_count: list[int] = []
    found: list[bool] = []
    for key, annotated in annotations.items():
        annotated = annotated[of_classes(annotated, labels)]
        if annotated.point_count is None:
            continue
        detected = sure(predictions.get(key, Boxes.empty(scored=True)), score_min)
        finder = found_by(detected[of_classes(detected, labels)], annotated, distance_m=distance_m)
        known = annotated.point_count >= 0
        range_m += np.round(annotated.range_m[known], 2).tolist()
        point_count += annotated.point_count[known].tolist()
        found += (finder[known] >= 0).tolist()
    rows = {"range_m": range_m, "point_count": point_count, "found": found}
    return {**rows, "score_min": score_min, "distance_m": distance_m}
