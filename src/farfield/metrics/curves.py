"""Precision-recall curves of one ranking under many weights of its groups, and the figures read off them.

A ranking holds predictions by falling score, each with whether it matches an annotated box and with the group (drive)
that it is of. Under weights w of the groups the k-th match, at place h_k of the ranking, stands at

    recall    r_k = sum of w over the first k matches / W,  where W = sum over groups of w times the annotated boxes
    precision p_k = sum of w over the first k matches / sum of w over the first h_k predictions

Precision p(r) and confidence c(r) are interpolated linearly along the ranking at recalls 0, 0.01 ... 1; beyond the last
recall they are 0. Average precision, by ``method``:

    nuscenes    mean over r = 0.11 ... 1 of max(p(r) - 0.1, 0), over 0.9       (calc_ap of the nuScenes devkit)
    interp101   mean of p(r) over r = 0, 0.01 ... 1
    area        sum over k of p_k (r_k - r_{k-1})
    voc         the same with p_k replaced by the largest p of k and later matches (PASCAL VOC)

The mean error of the matches, by ``method``, is 1, the worst, where nothing is matched:

    nuscenes    the weighted running mean of the errors, interpolated at c(0.11) ... c(highest r reached) and averaged;
                1 if recall 0.11 is not reached (calc_tp of the nuScenes devkit)
    tp_mean     the weighted mean over all matches

A bootstrap takes the same curve under hundreds of weights: every array below has one row for each row of weights. The
result itself is the row in which each weight is 1. Where no weight falls on an annotated box a figure is NaN.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

RECALL = np.linspace(0.0, 1.0, 101)
FLOOR = 0.1  # nuScenes: recall and precision below it do not count
FIRST = 11  # first of the 101 recalls above the floor
_MAX_ELEMENTS = 2_000_000  # of one array: weights are taken in chunks of rows


@dataclass(frozen=True, eq=False, kw_only=True)
class TabledCurve:
    """Precision and score by recall as a protocol's own rule samples them, each of shape (c,)."""

    recall: Float[np.ndarray, " c"]
    precision: Float[np.ndarray, " c"]
    confidence: Float[np.ndarray, " c"]

    def sampled(self) -> dict[str, list[float]]:
        """The curve as JSON values."""
        values = {"recall": self.recall, "precision": self.precision, "confidence": self.confidence}
        return {name: value.tolist() for name, value in values.items()}


@dataclass(frozen=True, eq=False, kw_only=True)
class Ranking:
    """The predictions of one class at one threshold, best first, with what each turned out to be.

    Args:
        confidence: Scores, falling, shape (n,).
        is_match: Whether the prediction took an annotated box, shape (n,).
        group: Resampling group (sequence or frame) of each prediction, shape (n,).
        annotated: Number of annotated boxes in each group, shape (g,).
    """

    confidence: Float[np.ndarray, " n"]
    is_match: Bool[np.ndarray, " n"]
    group: Int[np.ndarray, " n"]
    annotated: Int[np.ndarray, " g"]

    @cached_property
    def hits(self) -> Int[np.ndarray, " h"]:
        """Places of the matches in the ranking, shape (h,)."""
        return np.flatnonzero(self.is_match)

    @property
    def recall(self) -> Float[np.ndarray, " n"]:
        """Recall after each prediction, shape (n,): the raw curve."""
        return np.cumsum(self.is_match) / max(int(self.annotated.sum()), 1)

    @property
    def precision(self) -> Float[np.ndarray, " n"]:
        """Precision after each prediction, shape (n,): the raw curve."""
        return np.cumsum(self.is_match) / np.arange(1, len(self.is_match) + 1)

    def sampled(self) -> dict[str, list[float]] | None:
        """Recall, precision and confidence at 101 recalls as JSON values; None where nothing is annotated."""
        curves = weighted_curves(self, np.ones((1, len(self.annotated))))
        if not curves.has_annotated[0]:
            return None
        values = {"recall": RECALL, "precision": curves.precision[0], "confidence": curves.confidence[0]}
        return {name: value.tolist() for name, value in values.items()}


@dataclass(frozen=True, eq=False, kw_only=True)
class Curves:
    """Weighted precision-recall curves of one ranking, a row for each row of weights.

    Args:
        weight: Weight of each match, shape (r, h).
        matched: Running sum of ``weight`` along a row, shape (r, h).
        annotated: Weighted number of annotated boxes, shape (r,).
        precision_at_match: Precision at each match, shape (r, h).
        match_confidence: Score of each match, shape (h,).
        precision: Interpolated at recalls 0, 0.01 ... 1; 0 beyond the recall reached, shape (r, 101).
        confidence: Likewise, shape (r, 101).
    """

    weight: Float[np.ndarray, "r h"]
    matched: Float[np.ndarray, "r h"]
    annotated: Float[np.ndarray, " r"]
    precision_at_match: Float[np.ndarray, "r h"]
    match_confidence: Float[np.ndarray, " h"]
    precision: Float[np.ndarray, "r 101"]
    confidence: Float[np.ndarray, "r 101"]

    @property
    def has_annotated(self) -> Bool[np.ndarray, " r"]:
        """Whether anything is annotated under a row's weights."""
        return self.annotated > 0

    @property
    def has_matches(self) -> Bool[np.ndarray, " r"]:
        """Whether anything is matched under a row's weights."""
        return self.matched[:, -1] > 0 if self.matched.shape[1] else np.zeros(len(self.matched), dtype=bool)


def row_chunks(weights: Float[np.ndarray, "r g"], length: int) -> list[Float[np.ndarray, "s g"]]:
    """The weights in chunks of rows whose curves fit into memory.

    Args:
        weights: Weights of the groups.
        length: Number of predictions of the longest ranking.
    """
    rows = max(1, _MAX_ELEMENTS // max(length, len(RECALL)))
    return [weights[first : first + rows] for first in range(0, len(weights), rows)]


def weighted_curves(ranking: Ranking, weights: Float[np.ndarray, "r g"]) -> Curves:
    """Build the curves of a ranking under each row of group weights."""
    # Sums of weights along the ranking give recall and precision at each match.
    annotated = weights @ ranking.annotated.astype(np.float64)
    hits = ranking.hits
    row_weight = weights[:, ranking.group]
    predicted = np.cumsum(row_weight, axis=1)
    weight = row_weight[:, hits]
    matched = np.cumsum(weight, axis=1)
    at_match = np.divide(matched, predicted[:, hits], out=np.ones_like(matched), where=predicted[:, hits] > 0)
    parts = {
        "weight": weight,
        "matched": matched,
        "annotated": annotated,
        "precision_at_match": at_match,
        "match_confidence": ranking.confidence[hits],
    }
    empty = np.zeros((len(weights), len(RECALL)))
    if not len(hits):
        return Curves(precision=empty, confidence=empty, **parts)
    # Each sampled recall lies between the prediction ahead of a match ("before") and that match ("upper").
    divisor = np.where(annotated > 0, annotated, 1.0)[:, None]
    recall = matched / divisor
    upper = np.stack([np.searchsorted(row, RECALL, side="right") for row in recall])
    is_reached = upper < len(hits)
    upper = np.minimum(upper, len(hits) - 1)
    before = np.maximum(hits[upper] - 1, 0)
    precision_at_upper = np.take_along_axis(at_match, upper, axis=1)
    weight_of_upper = np.take_along_axis(weight, upper, axis=1)
    matched_before = np.take_along_axis(matched, upper, axis=1) - weight_of_upper
    predicted_before = np.take_along_axis(predicted, before, axis=1)
    leads = (hits[upper] > 0) & (predicted_before > 0)  # else the curve is level up to its first match
    precision_before = np.divide(matched_before, predicted_before, out=precision_at_upper.copy(), where=leads)
    confidence_before = ranking.confidence[before]
    share = np.divide(
        RECALL - matched_before / divisor, weight_of_upper / divisor, out=empty.copy(), where=weight_of_upper > 0
    )
    # At the last recall itself the last value holds, then none.
    at_end = (recall[:, -1:] == RECALL).astype(np.float64)
    last = np.divide(matched[:, -1:], predicted[:, -1:], out=np.zeros((len(weights), 1)), where=predicted[:, -1:] > 0)
    precision = np.where(is_reached, precision_before + (precision_at_upper - precision_before) * share, at_end * last)
    step = (ranking.confidence[hits[upper]] - confidence_before) * share
    confidence = np.where(is_reached, confidence_before + step, at_end * ranking.confidence[-1])
    exists = (matched[:, -1:] > 0) & (annotated[:, None] > 0)
    return Curves(precision=np.where(exists, precision, 0.0), confidence=np.where(exists, confidence, 0.0), **parts)


def average_precisions(curves: Curves, *, method: str = "nuscenes") -> Float[np.ndarray, " r"]:
    """Area under each curve in [0, 1], NaN where nothing is annotated, shape (r,).

    Args:
        curves: The curves.
        method: ``"nuscenes"`` (which the Cirrus paper calls normalised), ``"interp101"``, ``"area"`` or ``"voc"``, see
            the formulas above.
    """
    if method == "nuscenes":
        areas = np.minimum(np.clip(curves.precision[:, FIRST:] - FLOOR, 0.0, None).mean(axis=1) / (1.0 - FLOOR), 1.0)
    elif method == "interp101":
        areas = curves.precision.mean(axis=1)
    else:
        precision = curves.precision_at_match
        if method == "voc":
            precision = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        areas = (curves.weight * precision).sum(axis=1) / np.where(curves.has_annotated, curves.annotated, 1.0)
    return np.where(curves.has_annotated, areas, np.nan)


def mean_errors(curves: Curves, error: Float[np.ndarray, " h"], *, method: str = "nuscenes") -> Float[np.ndarray, " r"]:
    """Mean error of the matches of each curve, NaN where nothing is annotated, 1 where too few are matched.

    Args:
        curves: The curves.
        error: Error of each match in rank order, shape (h,); NaN where it is not known: such matches are passed over,
            the running mean ahead of the first known one is 0, and 1 where none is known, as in the devkit.
        method: ``"nuscenes"`` or ``"tp_mean"``, see the formulas above.
    """
    means = np.where(curves.has_annotated, 1.0, np.nan)
    rows = curves.has_annotated & curves.has_matches
    if not rows.any():
        return means
    has_error = ~np.isnan(error)
    weighted, matched = (curves.weight * np.where(has_error, error, 0.0))[rows], curves.matched[rows]
    counted = matched if has_error.all() else np.cumsum((curves.weight * has_error)[rows], axis=1)
    is_known = counted[:, -1] > 0
    if method == "tp_mean":
        means[rows] = np.divide(weighted.sum(axis=1), counted[:, -1], out=np.ones(len(counted)), where=is_known)
        return means
    # The running mean by match; ahead of the first match that has weight it is that match's error.
    running = np.divide(np.cumsum(weighted, axis=1), counted, out=np.zeros_like(matched), where=counted > 0)
    running[~is_known] = 1.0
    first = np.argmax(matched > 0, axis=1)[:, None]
    is_ahead = np.arange(matched.shape[1]) < first
    running = np.where(is_ahead, np.take_along_axis(running, first, axis=1), running)
    # Sampled at the confidences of recalls 0.11 up to the highest one reached, and averaged.
    confidence = curves.confidence[rows]
    highest = np.where(confidence.any(axis=1), len(RECALL) - np.argmax(confidence[:, ::-1] != 0, axis=1), 0)
    sampled = _interpolate_rows(confidence[:, FIRST:], curves.match_confidence[::-1], running[:, ::-1])
    is_counted = np.arange(FIRST, len(RECALL)) < highest[:, None]
    total = np.where(is_counted, sampled, 0.0).sum(axis=1)
    means[rows] = np.divide(total, is_counted.sum(axis=1), out=np.ones_like(total), where=highest > FIRST)
    return means


def _interpolate_rows(
    x: Float[np.ndarray, "r k"], knots: Float[np.ndarray, " h"], values: Float[np.ndarray, "r h"]
) -> Float[np.ndarray, "r k"]:
    """``numpy.interp`` of each row: the knots are common to all of them, and may stand twice."""
    left = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 1)
    right = np.minimum(left + 1, len(knots) - 1)
    low = np.take_along_axis(values, left, axis=1)
    high = np.take_along_axis(values, right, axis=1)
    gap, offset = knots[right] - knots[left], x - knots[left]
    slope = np.divide(high - low, gap, out=np.zeros_like(low), where=(gap > 0) & (offset > 0))
    return slope * offset + low
