"""The two scores between which a pseudo box is ignored, from what a detector's scores mean where labels are known.

Scores of detectors are not alike: those of a focal loss that has seen few objects stop at 0.5. So the thresholds are
taken from the scores on labelled source frames, class by class, by one rule for both. A box is an object from the
lowest score on at which at least nine in ten boxes *above* it are objects; it is background below the highest score at
which at most one in ten boxes *below* it is one; what lies between is ignored. The rule is ours; where a class has too
few boxes to tell, the literature's 0.6 and 0.25 (ST3D++, arXiv 2108.06682) stand.
"""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.matching import found_by

POSITIVE, NEGATIVE = 0.6, 0.25
_SURE, _BACKGROUND = 0.9, 0.1  # shares of objects above the one and below the other
_FEWEST = 20  # boxes of a class, right ones or all, of which shares are taken


class Thresholds(NamedTuple):
    """Scores by class.

    Attributes:
        positive: From it on a box is an object.
        negative: Below it a box is background.
        measured: Classes whose scores decided; the others have the literature's.
    """

    positive: dict[str, float]
    negative: dict[str, float]
    measured: tuple[str, ...]


def thresholds_of(
    predictions: Mapping[tuple[str, str], Boxes],
    annotated: Mapping[tuple[str, str], Boxes],
    classes: Collection[str],
    *,
    lowest: float,
    distance_m: float = 2.0,
) -> Thresholds:
    """Take the thresholds from what a detector found in labelled frames.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotated: Annotated boxes of the same frames.
        classes: The detector's classes.
        lowest: Lowest score that it gives: no threshold lies below.
        distance_m: A box is an object if its centre lies so near to an annotated one of its class that no better box
            took.
    """
    positive, negative, measured = {}, {}, []
    for name in classes:
        score, right = judged(predictions, annotated, name, distance_m=distance_m)
        upper, lower = sure_from(score, right), background_below(score, right)
        if upper is None or lower is None:
            upper, lower = POSITIVE, NEGATIVE
        else:
            measured.append(name)
        positive[name] = round(max(upper, lowest), 4)
        negative[name] = round(min(max(lower, lowest), positive[name]), 4)
    return Thresholds(positive, negative, tuple(measured))


def judged(
    predictions: Mapping[tuple[str, str], Boxes],
    annotated: Mapping[tuple[str, str], Boxes],
    name: str,
    *,
    distance_m: float = 2.0,
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Scores of a class' boxes in all annotated frames, and whether each is an object, shapes (n,)."""
    scores, rights = [np.zeros(0)], [np.zeros(0, dtype=bool)]
    for key, truth in annotated.items():
        boxes = predictions.get(key, Boxes.empty(scored=True))
        boxes = boxes[np.asarray(boxes.label) == name]
        if boxes.score is None or not len(boxes):
            continue
        finder = found_by(boxes, truth[np.asarray(truth.label) == name], distance_m=distance_m)
        right = np.zeros(len(boxes), dtype=bool)
        right[finder[finder >= 0]] = True
        scores.append(boxes.score)
        rights.append(right)
    return np.concatenate(scores), np.concatenate(rights)


def sure_from(score: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> float | None:
    """The lowest score at and above which nine in ten boxes are objects; None with too few of them.

    Where no score has that many above it, the highest tenth of the objects' scores is sure.
    """
    if right.sum() < _FEWEST:
        return None
    values, below, lower = _below(score, right)
    above, objects = len(score) - below, int(right.sum()) - lower
    enough = (objects >= _SURE * above) & (above >= _FEWEST)  # of few boxes at the top a share says little
    return float(values[enough][0]) if enough.any() else float(np.quantile(score[right], 0.9))


def background_below(score: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> float | None:
    """The highest score below which at most one in ten boxes is an object; None with too few boxes.

    Where there is none, the lowest score: nothing that was found is background.
    """
    if len(score) < _FEWEST:
        return None
    values, below, objects = _below(score, right)
    enough = (objects <= _BACKGROUND * below) & (below >= _FEWEST)
    return float(values[enough][-1]) if enough.any() else float(values[0])


def _below(
    score: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """The scores that occur, ascending, and how many boxes, and how many objects, lie below each, shapes (m,)."""
    values, count = np.unique(score, return_counts=True)
    objects = np.bincount(np.searchsorted(values, score), weights=right, minlength=len(values)).astype(np.int64)
    return values, np.cumsum(count) - count, np.cumsum(objects) - objects
