"""Counts of K-Radar's average precision: one matching a view of the boxes, read off for any set of frames."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.metrics.counts import ThresholdCounts
from farfield.metrics.kradar.frames import KRadarFrames
from farfield.metrics.kradar.matching import OverlapGains, gains
from farfield.metrics.kradar.settings import KRadarSettings
from farfield.metrics.recall import sample_thresholds

MEASURES = ("3d", "bev")


@dataclass(frozen=True, eq=False, kw_only=True)
class ClassMatches:
    """One class, matched at every overlap; the predictions stand in the order of falling scores.

    Args:
        score: Scores of the n predictions, falling.
        frame: Frames of the predictions, shape (n,).
        annotated_frame: Frames of the annotated boxes that must be found, shape (m,).
        gains: What each prediction adds, by measure and overlap.
    """

    score: Float[np.ndarray, " n"]
    frame: Int[np.ndarray, " n"]
    annotated_frame: Int[np.ndarray, " m"]
    gains: dict[tuple[str, float], OverlapGains]


def match(
    data: KRadarFrames,
    settings: KRadarSettings,
    kind: int,
    *,
    predicted_in: Bool[np.ndarray, " n"] | None = None,
    annotated_in: Bool[np.ndarray, " m"] | None = None,
    optional: Bool[np.ndarray, " m"] | None = None,
) -> ClassMatches:
    """Match the boxes of one class, or those of them that lie in a range bin.

    Args:
        data: All frames.
        settings: The options.
        kind: Place of the class among the settings' classes.
        predicted_in: Predictions that take part; None: all.
        annotated_in: Annotated boxes that take part; None: all.
        optional: Annotated boxes that may be found or not; None: none.
    """
    here = data.predicted.kind == kind if predicted_in is None else (data.predicted.kind == kind) & predicted_in
    there = data.annotated.kind == kind if annotated_in is None else (data.annotated.kind == kind) & annotated_in
    predictions, boxes = np.flatnonzero(here), np.flatnonzero(there)
    predictions = predictions[np.argsort(-data.predicted.score[predictions], kind="stable")]
    place, row = np.full(len(data.predicted), -1), np.full(len(data.annotated), -1)
    place[predictions], row[boxes] = np.arange(len(predictions)), np.arange(len(boxes))
    kept = np.flatnonzero(here[data.pair[:, 1]] & there[data.pair[:, 0]])
    box, detection = row[data.pair[kept, 0]], place[data.pair[kept, 1]]
    may = np.zeros(len(boxes), dtype=bool) if optional is None else optional[boxes]
    frame, score = data.annotated.frame[boxes], data.predicted.score[predictions]
    found: dict[tuple[str, float], OverlapGains] = {}
    for measure in MEASURES:
        overlap = data.overlap[measure][kept]
        for iou in settings.ious:
            enough = overlap > iou
            found[measure, iou] = gains(
                box[enough],
                detection[enough],
                overlap[enough],
                frame=frame,
                optional=may,
                score=score,
                order=predictions,
            )
    return ClassMatches(score=score, frame=data.predicted.frame[predictions], annotated_frame=frame[~may], gains=found)


def count(
    matched: ClassMatches, inside: Bool[np.ndarray, " f"] | None, group: Int[np.ndarray, " f"], groups: int
) -> dict[tuple[str, float], ThresholdCounts]:
    """True and false positives of a set of frames at its own thresholds, by measure and overlap.

    Args:
        matched: The matched class.
        inside: Which frames count; None: all.
        group: Resampling group of each frame.
        groups: Number of groups.
    """
    if inside is None:
        rows, boxes = np.arange(len(matched.frame)), matched.annotated_frame
    else:
        rows, boxes = np.flatnonzero(inside[matched.frame]), matched.annotated_frame[inside[matched.annotated_frame]]
    score, owner = matched.score[rows], group[matched.frame[rows]]
    annotated = np.bincount(group[boxes], minlength=groups)
    return {name: _count(gain, rows, score, owner, annotated) for name, gain in matched.gains.items()}


def _count(
    gain: OverlapGains,
    rows: Int[np.ndarray, " r"],
    score: Float[np.ndarray, " r"],
    owner: Int[np.ndarray, " r"],
    annotated: Int[np.ndarray, " g"],
) -> ThresholdCounts:
    total, groups = int(annotated.sum()), len(annotated)
    thresholds, recalls = sample_thresholds(score[gain.found[rows]], total) if total else ([], [])
    reached = np.searchsorted(-score, -np.array(thresholds, dtype=np.float64), side="right")
    step = np.repeat(np.arange(len(thresholds) + 1), np.diff(reached, prepend=0, append=len(rows)))
    cell, shape = step * groups + owner, (len(thresholds) + 1, groups)
    true = _above(cell, gain.true[rows], shape)
    return ThresholdCounts(
        thresholds=thresholds,
        recalls=recalls,
        true=true,
        false=_above(cell, None, shape) - true - _above(cell, gain.excused[rows], shape),
        annotated=annotated,
    )


def _above(
    cell: Int[np.ndarray, " r"], values: Int[np.ndarray, " r"] | None, shape: tuple[int, int]
) -> Float[np.ndarray, "t g"]:
    """Sums of the values (or numbers of rows) at or above each threshold, by group."""
    sums = np.bincount(cell, weights=values, minlength=shape[0] * shape[1])
    return sums.reshape(shape)[:-1].cumsum(axis=0).astype(np.float64)
