"""KITTI's sampling of precision over recall, which K-Radar's average precision and the scores of tracks share.

KITTI (Geiger et al., CVPR 2012; ``evaluate_object`` of its development kit) takes scores s_0 > s_1 ... at which recall
comes nearest to 0, 1/40 ... 1, counts true and false positives among the detections at or above each, and lets the
precision at a recall be the best one from that threshold on:

    p_i = TP(s_i) / (TP(s_i) + FP(s_i)),   p(i / 40) = max over j >= i of p_j

    R11 = mean of p(0), p(0.1) ... p(1)     R40 = mean of p(1/40) ... p(1)     R41 = mean of p(0), p(1/40) ... p(1)

Under weights of the groups (how often a bootstrap draws each drive) the thresholds stay where they are, and the average
precision changes by what its smooth form S gains or loses, whose precision is interpolated in the weighted recall:

    AP(w) = AP(1) + S(w) - S(1), kept in [0, 1]
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

SAMPLES = 41
RECALL_POINTS = (11, 40, 41)


def sample_thresholds(scores: Float[np.ndarray, " h"], annotated: int) -> tuple[list[float], list[float]]:
    """Scores at which recall comes nearest to 0, 1/40, 2/40 ...; returns them and the recalls reached there.

    Args:
        scores: Scores of the detections that match when all are allowed, falling.
        annotated: Number of annotated boxes.
    """
    ranks: list[int] = []
    recall = 0.0
    while len(ranks) < SAMPLES and (ranks[-1] if ranks else 0) < len(scores):
        ranks.append(_nearest_rank(recall, (ranks[-1] if ranks else 0) + 1, len(scores), annotated))
        recall += 1.0 / (SAMPLES - 1)
    return [float(scores[rank - 1]) for rank in ranks], [rank / annotated for rank in ranks]


def _nearest_rank(recall: float, first: int, last: int, annotated: int) -> int:
    """The first rank from ``first`` on after which recall does not come nearer, by KITTI's own float comparison."""
    rank = min(max(first, int(recall * annotated - 0.5) - 1), last)
    while rank < last and (rank + 1) / annotated - recall < recall - rank / annotated:
        rank += 1
    return rank


def sampled_precision(
    precision: Float[np.ndarray, " t"], recalls: Float[np.ndarray, " t"], annotated: int, *, gaps: bool = False
) -> Float[np.ndarray, "41"]:
    """Precision at recalls 0, 1/40 ... 1: the best one from that threshold on.

    With 41 annotated boxes or more these are the values of KITTI's own code. With fewer it leaves samples at zero
    that it never reaches for want of thresholds, so that a perfect detector falls short of 100; here they take the
    best precision at that recall, unless ``gaps`` is set for those of KITTI's code.

    Args:
        precision: Precision at each threshold.
        recalls: Recall at each threshold.
        annotated: Number of annotated boxes.
        gaps: Leave at 0 the samples for which KITTI's code has no threshold.
    """
    by_threshold = np.zeros(SAMPLES)
    by_threshold[: len(precision)] = precision
    by_threshold = np.maximum.accumulate(by_threshold[::-1])[::-1]
    if gaps:
        return by_threshold
    is_reached = recalls[None] >= np.linspace(0, 1, SAMPLES)[:, None] - 0.5 / annotated - 1e-12
    by_recall = np.where(is_reached, precision[None], 0.0).max(axis=1, initial=0.0)
    return np.maximum(by_threshold, by_recall)


def recall_mean(sampled: Float[np.ndarray, "*rows 41"], points: int) -> Float[np.ndarray, "*rows"]:
    """Mean of the precisions at recalls 0, 0.1 ... 1 (11 points), 1/40 ... 1 (40) or 0, 1/40 ... 1 (41)."""
    return np.asarray({11: sampled[..., ::4], 40: sampled[..., 1:], 41: sampled}[points].mean(axis=-1))


@dataclass(frozen=True, eq=False, kw_only=True)
class KittiCurve:
    """Precision and recall at KITTI's sampled thresholds, each of shape (thresholds,)."""

    recall: Float[np.ndarray, " t"]
    precision: Float[np.ndarray, " t"]
    confidence: Float[np.ndarray, " t"]

    def sampled(self) -> dict[str, list[float]]:
        """The curve as JSON values."""
        values = {"recall": self.recall, "precision": self.precision, "confidence": self.confidence}
        return {name: value.tolist() for name, value in values.items()}


@dataclass(frozen=True, eq=False, kw_only=True)
class ThresholdCounts:
    """True and false positives by threshold and resampling group.

    Args:
        thresholds: Scores, falling.
        recalls: Recalls reached there.
        true: True positives, shape (thresholds, groups).
        false: False positives, shape (thresholds, groups).
        annotated: Boxes that must be found, shape (groups,).
        worth: What the true positives are worth where not 1 each, shape (thresholds, groups); precision is then that
            over all detections.
    """

    thresholds: list[float]
    recalls: list[float]
    true: Float[np.ndarray, "t g"]
    false: Float[np.ndarray, "t g"]
    annotated: Int[np.ndarray, " g"]
    worth: Float[np.ndarray, "t g"] | None = None

    def average_precisions(
        self, weights: Float[np.ndarray, "r g"], points: Sequence[int], *, gaps: bool = False
    ) -> dict[int, Float[np.ndarray, " r"]]:
        """Average precisions under each row of group weights, by number of recall points; NaN: nothing is annotated.

        Args:
            weights: Rows of group weights; under weights of 1 it is KITTI's own average precision.
            points: Some of :data:`RECALL_POINTS`.
            gaps: As of :func:`sampled_precision`.
        """
        total, ones = int(self.annotated.sum()), np.ones((1, len(self.annotated)))
        if total == 0:
            return {number: np.full(len(weights), np.nan) for number in points}
        sampled = sampled_precision(self._precision(ones)[0], np.array(self.recalls), total, gaps=gaps)
        smooth = np.concatenate([self._smooth(ones), self._smooth(weights)])
        figures = {}
        for number in points:
            point = recall_mean(sampled, number)
            means = recall_mean(smooth, number)
            start, drawn = means[0], means[1:]
            # Where the smooth form stays the same the figure does, to the last digit.
            figures[number] = np.where(drawn == start, point, np.clip(point + drawn - start, 0.0, 1.0))
        return figures

    def curve(self) -> KittiCurve | None:
        """The raw curve, or None where nothing is annotated."""
        if not self.annotated.sum():
            return None
        return KittiCurve(
            recall=np.array(self.recalls),
            precision=self._precision(np.ones((1, len(self.annotated))))[0],
            confidence=np.array(self.thresholds, dtype=np.float64),
        )

    def _precision(self, weights: Float[np.ndarray, "r g"]) -> Float[np.ndarray, "r t"]:
        """Precision at the thresholds under group weights; 0 where nothing was predicted."""
        true, false = weights @ self.true.T, weights @ self.false.T
        worth = true if self.worth is None else weights @ self.worth.T
        return np.divide(worth, true + false, out=np.zeros_like(true), where=true + false > 0)

    def _smooth(self, weights: Float[np.ndarray, "r g"]) -> Float[np.ndarray, "r 41"]:
        """Precisions at recalls 0, 1/40 ... 1, interpolated in recall; NaN where nothing is annotated."""
        total = weights @ self.annotated.astype(np.float64)
        sampled = np.zeros((len(weights), SAMPLES))
        if self.thresholds:
            recall = np.maximum.accumulate(weights @ self.true.T, axis=1) / np.where(total > 0, total, 1.0)[:, None]
            best = np.maximum.accumulate(self._precision(weights)[:, ::-1], axis=1)[:, ::-1]
            grid = np.linspace(0, 1, SAMPLES)
            for row in np.flatnonzero(total > 0):
                sampled[row] = np.interp(grid, recall[row], best[row], right=0.0)
        sampled[total <= 0] = np.nan
        return sampled
