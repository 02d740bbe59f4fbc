"""True and false positives at sampled thresholds, and the precisions and curves read off them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from farfield.metrics.recall import SAMPLES, sampled_precision

RECALL_POINTS = (11, 40, 41)


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


def recall_mean(sampled: Float[np.ndarray, "41"], points: int) -> float:
    """Mean of the precisions at recalls 0, 0.1 ... 1 (11 points), 1/40 ... 1 (40) or 0, 1/40 ... 1 (41)."""
    return float({11: sampled[::4], 40: sampled[1:], 41: sampled}[points].mean())


@dataclass(frozen=True, eq=False, kw_only=True)
class ThresholdCounts:
    """True and false positives by threshold and resampling group.

    Args:
        thresholds: Scores, falling.
        recalls: Recalls reached there.
        true: True positives, shape (thresholds, groups).
        false: False positives, shape (thresholds, groups).
        annotated: Boxes that must be found, shape (groups,).
    """

    thresholds: list[float]
    recalls: list[float]
    true: Float[np.ndarray, "t g"]
    false: Float[np.ndarray, "t g"]
    annotated: Int[np.ndarray, " g"]

    def precision(self, weight: Float[np.ndarray, " g"]) -> Float[np.ndarray, " t"]:
        """Precision at the thresholds under group weights; 0 where nothing was predicted."""
        true, false = self.true @ weight, self.false @ weight
        return np.divide(true, true + false, out=np.zeros(len(true)), where=true + false > 0)

    def sampled(self, *, gaps: bool = False) -> Float[np.ndarray, "41"] | None:
        """Precision at recalls 0, 1/40 ... 1, or None where nothing is annotated.

        Args:
            gaps: Leave at 0 the samples for which KITTI's code has no threshold, see :func:`sampled_precision`.
        """
        total = int(self.annotated.sum())
        if total == 0:
            return None
        precision = self.precision(np.ones(len(self.annotated)))
        return sampled_precision(precision, np.array(self.recalls), total, gaps=gaps)

    def smooth(self, weight: Float[np.ndarray, " g"]) -> Float[np.ndarray, "41"] | None:
        """Precisions under group weights, interpolated in recall: the thresholds stay, so only its changes are used."""
        total = float(self.annotated @ weight)
        if total <= 0:
            return None
        if not self.thresholds:
            return np.zeros(SAMPLES)
        recall = np.maximum.accumulate(self.true @ weight) / total
        best = np.maximum.accumulate(self.precision(weight)[::-1])[::-1]
        return np.interp(np.linspace(0, 1, SAMPLES), recall, best, right=0.0)

    def curve(self) -> KittiCurve | None:
        """The raw curve, or None where nothing is annotated."""
        if not self.annotated.sum():
            return None
        return KittiCurve(
            recall=np.array(self.recalls),
            precision=self.precision(np.ones(len(self.annotated))),
            confidence=np.array(self.thresholds, dtype=np.float64),
        )


def shifted(point: float | None, drawn: float | None, start: float | None) -> float | None:
    """A figure moved by what its smooth form gains or loses under resampling, kept in [0, 1]."""
    return None if point is None or drawn is None or start is None else min(max(point + drawn - start, 0.0), 1.0)
