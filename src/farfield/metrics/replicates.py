"""Figures of one ranking under many weights at once: what :mod:`farfield.metrics.curves` says for one, a row each.

A bootstrap takes the same curve under hundreds of weights. Where no weight falls on an annotated box a row is NaN.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from farfield.metrics.curves import FIRST, FLOOR, RECALL, Ranking

_MOST_NUMBERS = 2_000_000  # of one array: rows are taken in shares of this size


@dataclass(frozen=True, eq=False, kw_only=True)
class Curves:
    """Weighted precision-recall curves of one ranking, a row for each :class:`farfield.metrics.curves.Curve`.

    Args:
        weight: Weight of each match, shape (r, h).
        matched: Running sum of ``weight`` along a row, shape (r, h).
        annotated: Weighted number of annotated boxes, shape (r,).
        precision_at_match: Precision at each match, shape (r, h).
        match_confidence: Score of each match, shape (h,).
        precision: Interpolated at recalls 0, 0.01 ... 1, shape (r, 101).
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
    def known(self) -> Bool[np.ndarray, " r"]:
        """Whether anything is annotated under a row's weights."""
        return self.annotated > 0

    @property
    def found(self) -> Bool[np.ndarray, " r"]:
        """Whether anything is matched under a row's weights."""
        return self.matched[:, -1] > 0 if self.matched.shape[1] else np.zeros(len(self.matched), dtype=bool)


def shares(ranking: Ranking, weights: Float[np.ndarray, "r g"]) -> list[Float[np.ndarray, "s g"]]:
    """The weights in shares whose curves fit into memory."""
    rows = max(1, _MOST_NUMBERS // max(len(ranking.confidence), 101))
    return [weights[first : first + rows] for first in range(0, len(weights), rows)]


def weighted_curves(ranking: Ranking, weights: Float[np.ndarray, "r g"]) -> Curves:
    """Build the curves under each row of group weights."""
    annotated, hits = weights @ ranking.annotated.astype(np.float64), ranking.hits
    row_weight = weights[:, ranking.group]
    seen, weight = np.cumsum(row_weight, axis=1), row_weight[:, hits]
    matched = np.cumsum(weight, axis=1)
    at_match = np.divide(matched, seen[:, hits], out=np.ones_like(matched), where=seen[:, hits] > 0)
    empty = np.zeros((len(weights), len(RECALL)))
    parts = {
        "weight": weight,
        "matched": matched,
        "annotated": annotated,
        "precision_at_match": at_match,
        "match_confidence": ranking.confidence[hits],
    }
    if not len(hits):
        return Curves(precision=empty, confidence=empty, **parts)
    divisor = np.where(annotated > 0, annotated, 1.0)[:, None]
    recall = matched / divisor
    upper = np.stack([np.searchsorted(row, RECALL, side="right") for row in recall])
    inside = upper < len(hits)
    upper = np.minimum(upper, len(hits) - 1)
    place = hits[upper]
    before = np.maximum(place - 1, 0)
    at, own = np.take_along_axis(at_match, upper, axis=1), np.take_along_axis(weight, upper, axis=1)
    matched_before, seen_before = (
        np.take_along_axis(matched, upper, axis=1) - own,
        np.take_along_axis(seen, before, axis=1),
    )
    lead = (place > 0) & (seen_before > 0)
    precision_before = np.divide(matched_before, seen_before, out=at.copy(), where=lead)
    share = np.divide(RECALL - matched_before / divisor, own / divisor, out=empty.copy(), where=own > 0)
    beyond = (recall[:, -1:] == RECALL).astype(np.float64)
    last = np.divide(matched[:, -1:], seen[:, -1:], out=np.zeros((len(weights), 1)), where=seen[:, -1:] > 0)
    confidence_before = ranking.confidence[before]
    precision = np.where(inside, precision_before + (at - precision_before) * share, beyond * last)
    step = (ranking.confidence[place] - confidence_before) * share
    confidence = np.where(inside, confidence_before + step, beyond * ranking.confidence[-1])
    there = (matched[:, -1:] > 0) & (annotated[:, None] > 0)
    return Curves(precision=np.where(there, precision, 0.0), confidence=np.where(there, confidence, 0.0), **parts)


def average_precisions(curves: Curves, *, method: str = "nuscenes") -> Float[np.ndarray, " r"]:
    """Area under each curve, NaN where nothing is annotated; see :func:`farfield.metrics.curves.average_precision`."""
    if method == "nuscenes":
        areas = np.minimum(np.clip(curves.precision[:, FIRST:] - FLOOR, 0.0, None).mean(axis=1) / (1.0 - FLOOR), 1.0)
    elif method == "interp101":
        areas = curves.precision.mean(axis=1)
    else:
        precision = curves.precision_at_match
        if method == "voc":
            precision = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        areas = (curves.weight * precision).sum(axis=1) / np.where(curves.known, curves.annotated, 1.0)
    return np.where(curves.known, areas, np.nan)


def mean_errors(curves: Curves, error: Float[np.ndarray, " h"], *, method: str = "nuscenes") -> Float[np.ndarray, " r"]:
    """Mean error of the matches of each curve, NaN where nothing is annotated, 1 where too few are matched.

    Args:
        curves: The curves.
        error: Error of each match in rank order, shape (h,).
        method: As of :func:`farfield.metrics.curves.mean_error`.
    """
    means = np.where(curves.known, 1.0, np.nan)
    good = curves.known & curves.found
    if not good.any():
        return means
    weighted = curves.weight * error
    if method == "tp_mean":
        means[good] = weighted[good].sum(axis=1) / curves.matched[good, -1]
        return means
    confidence = curves.confidence[good]
    reached = np.where(confidence.any(axis=1), len(RECALL) - np.argmax(confidence[:, ::-1] != 0, axis=1), 0)
    matched = curves.matched[good]
    running = np.divide(np.cumsum(weighted[good], axis=1), matched, out=np.zeros_like(matched), where=matched > 0)
    first = np.argmax(matched > 0, axis=1)[:, None]
    before = np.arange(matched.shape[1]) < first
    running = np.where(before, np.take_along_axis(running, first, axis=1), running)
    resampled = _interpolated(confidence[:, FIRST:], curves.match_confidence[::-1], running[:, ::-1])
    counted = np.arange(FIRST, len(RECALL)) < reached[:, None]
    total = np.where(counted, resampled, 0.0).sum(axis=1)
    means[good] = np.divide(total, counted.sum(axis=1), out=np.ones_like(total), where=reached > FIRST)
    return means


def _interpolated(
    x: Float[np.ndarray, "r k"], knots: Float[np.ndarray, " h"], values: Float[np.ndarray, "r h"]
) -> Float[np.ndarray, "r k"]:
    """``numpy.interp`` of each row: the knots are common to all of them, and may stand twice."""
    left = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 1)
    right = np.minimum(left + 1, len(knots) - 1)
    low, high = np.take_along_axis(values, left, axis=1), np.take_along_axis(values, right, axis=1)
    gap, over = knots[right] - knots[left], x - knots[left]
    slope = np.divide(high - low, gap, out=np.zeros_like(low), where=(gap > 0) & (over > 0))
    return slope * over + low
