"""Which annotated boxes were found: for pictures and points-per-box plots, not for scores (those are in metrics)."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.matching import Limits, greedy_match, rank_predictions

VEHICLES = ("vehicle", "large_vehicle")
Key = tuple[str, str]


def of_classes(boxes: Boxes, labels: Collection[str] | None) -> Bool[np.ndarray, " n"]:
    """Which boxes bear one of the labels, shape (n,); all of them if ``labels`` is None."""
    return np.ones(len(boxes), dtype=bool) if labels is None else np.isin(boxes.label, list(labels))


def sure(predictions: Boxes, score_min: float) -> Boxes:
    """The predictions whose score is at least ``score_min``; all of them where there are no scores."""
    return predictions if predictions.score is None else predictions[predictions.score >= score_min]


def found_by(predictions: Boxes, annotated: Boxes, *, distance_m: float = 2.0) -> Int[np.ndarray, " m"]:
    """For each annotated box the index of the prediction that found it, or -1, shape (m,).

    Predictions take turns by falling score; each takes the nearest free annotated box nearer than ``distance_m``
    between centres in the x-y plane.
    """
    finder = np.full(len(annotated), -1, dtype=np.int64)
    if not len(predictions) or not len(annotated):
        return finder
    score = np.zeros(len(predictions)) if predictions.score is None else predictions.score
    one_frame = np.zeros(len(predictions), dtype=np.int64)
    taken = greedy_match(
        predictions.centre_m[:, :2],
        one_frame,
        rank_predictions(score, one_frame),
        annotated.centre_m[:, :2],
        np.zeros(len(annotated), dtype=np.int64),
        Limits(threshold_m=np.array([distance_m])),
    )[0]
    finder[taken[taken >= 0]] = np.flatnonzero(taken >= 0)
    return finder


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
