"""Precision-recall curves and the figures read off them, for one ranking and any weights of its groups.

Weights make the bootstrap cheap: a sequence drawn twice weighs double, so that a replicate is one weighted pass over
the same matches. With unit weights the figures are those of the nuScenes devkit (``calc_ap``, ``calc_tp``).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

RECALL = np.linspace(0.0, 1.0, 101)
FLOOR = 0.1  # nuScenes: recall and precision below it do not count
FIRST = 11  # first of the 101 recalls above the floor


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
        curve = weighted_curve(self)
        if curve is None:
            return None
        values = {"recall": RECALL, "precision": curve.precision, "confidence": curve.confidence}
        return {name: value.tolist() for name, value in values.items()}


@dataclass(frozen=True, eq=False, kw_only=True)
class Curve:
    """A weighted precision-recall curve: at the matches, and interpolated at 101 recalls.

    Args:
        weight: Weight of each match, shape (h,).
        matched: Running sum of ``weight``, shape (h,).
        annotated: Weighted number of annotated boxes.
        precision_at_match: Precision at each match, shape (h,).
        match_confidence: Score of each match, shape (h,).
        precision: Interpolated at recalls 0, 0.01 ... 1; 0 beyond the recall reached, shape (101,).
        confidence: Likewise, shape (101,).
    """

    weight: Float[np.ndarray, " h"]
    matched: Float[np.ndarray, " h"]
    annotated: float
    precision_at_match: Float[np.ndarray, " h"]
    match_confidence: Float[np.ndarray, " h"]
    precision: Float[np.ndarray, "101"]
    confidence: Float[np.ndarray, "101"]


def weighted_curve(ranking: Ranking, group_weight: Float[np.ndarray, " g"] | None = None) -> Curve | None:
    """Build the curve; None where nothing is annotated (under these weights)."""
    group_weight = np.ones(len(ranking.annotated)) if group_weight is None else group_weight
    annotated = float(group_weight @ ranking.annotated)
    if annotated <= 0:
        return None
    hits, row_weight = ranking.hits, group_weight[ranking.group]
    seen = np.cumsum(row_weight)
    weight = row_weight[hits]
    matched = np.cumsum(weight)
    parts = {"weight": weight, "matched": matched, "match_confidence": ranking.confidence[hits]}
    if len(hits) == 0 or matched[-1] <= 0:
        return Curve(annotated=annotated, precision_at_match=matched, precision=_NONE, confidence=_NONE, **parts)
    at_match = np.divide(matched, seen[hits], out=np.ones(len(hits)), where=seen[hits] > 0)
    recall = matched / annotated
    upper = np.searchsorted(recall, RECALL, side="right")
    inside = upper < len(hits)
    upper = np.minimum(upper, len(hits) - 1)
    before = np.maximum(hits[upper] - 1, 0)  # the last prediction ahead of the match
    matched_before, seen_before = matched[upper] - weight[upper], seen[before]
    lead = (hits[upper] > 0) & (seen_before > 0)  # else the curve is level up to its first match
    precision_before = np.divide(matched_before, seen_before, out=at_match[upper].copy(), where=lead)
    confidence_before = ranking.confidence[before]
    share = np.divide(
        RECALL - matched_before / annotated, weight[upper] / annotated, out=np.zeros(101), where=weight[upper] > 0
    )
    beyond = (recall[-1] == RECALL).astype(np.float64)  # at the last recall itself the last value holds, then none

    return Curve(
        annotated=annotated,
        precision_at_match=at_match,
        precision=np.where(
            inside,
            precision_before + (at_match[upper] - precision_before) * share,
            beyond * (matched[-1] / seen[-1]),
        ),
        confidence=np.where(
            inside,
            confidence_before + (ranking.confidence[hits[upper]] - confidence_before) * share,
            beyond * ranking.confidence[-1],
        ),
        **parts,
    )


_NONE = np.zeros(101)


def average_precision(curve: Curve, *, method: str = "nuscenes") -> float:
    """Area under a curve in [0, 1].

    Args:
        curve: The curve.
        method: ``"nuscenes"``: mean of 90 interpolated precisions above recall 0.1, less 0.1, over 0.9 (the area that
            Cirrus calls normalised); ``"interp101"``: mean of all 101; ``"area"``: sum of precision times gain in
            recall; ``"voc"``: the same under the falling envelope.
    """
    if method == "nuscenes":
        return min(float(np.clip(curve.precision[FIRST:] - FLOOR, 0.0, None).mean() / (1.0 - FLOOR)), 1.0)
    if method == "interp101":
        return float(curve.precision.mean())
    precision = curve.precision_at_match
    if method == "voc":
        precision = np.maximum.accumulate(precision[::-1])[::-1]
    return float(curve.weight @ precision / curve.annotated)


def mean_error(curve: Curve, error: Float[np.ndarray, " h"], *, method: str = "nuscenes") -> float:
    """Mean error of the matches; 1, the worst, where there are too few.

    Args:
        curve: The curve of the ranking.
        error: Error of each match in rank order, shape (h,).
        method: ``"nuscenes"``: the running mean, resampled at the confidences of recalls 0.11 ... highest reached, is
            averaged; 1 if recall 0.11 is not reached. ``"tp_mean"``: the plain mean over all matches.
    """
    if len(error) == 0 or curve.matched[-1] <= 0:
        return 1.0
    if method == "tp_mean":
        return float(curve.weight @ error / curve.matched[-1])
    reached = np.flatnonzero(curve.confidence)
    if len(reached) == 0 or reached[-1] < FIRST:
        return 1.0
    mean = np.cumsum(curve.weight * error)
    first = int(np.argmax(curve.matched > 0))
    mean[first:] /= curve.matched[first:]
    mean[:first] = mean[first]
    wanted = curve.confidence[FIRST : reached[-1] + 1]
    return float(np.interp(wanted, curve.match_confidence[::-1], mean[::-1]).mean())
