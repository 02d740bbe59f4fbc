"""What a detector's scores mean where labels are known, and the two scores between which a pseudo-label is ignored.

Scores of detectors are not alike: those of a focal loss that has seen few objects stop at 0.5. So the thresholds are
taken from the scores on labelled source frames, class by class: isotonic regression gives the share of objects among
boxes of each score (Zadrozny and Elkan, KDD 2002). From the score on where it reaches four in five a box is an object,
below the one where it passes one in five it is background, and what lies between is ignored. The shares are ours; where
a class has too few boxes to tell, the literature's 0.6 and 0.25 (ST3D++, arXiv 2108.06682) stand.
"""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import isotonic_regression

from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.matching import found_by

POSITIVE, NEGATIVE = 0.6, 0.25
_OBJECT, _BACKGROUND = 0.8, 0.2  # shares of objects among boxes of a score
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
    """Take the thresholds from what a detector detects in labelled frames.

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
        score, right = scored_matches(predictions, annotated, name, distance_m=distance_m)
        upper, lower = confident_from(score, right), background_below(score, right)
        if upper is None or lower is None:
            upper, lower = POSITIVE, NEGATIVE
        else:
            measured.append(name)
        positive[name] = round(max(upper, lowest), 4)
        negative[name] = round(min(max(lower, lowest), positive[name]), 4)
    return Thresholds(positive, negative, tuple(measured))


def scored_matches(
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


def confident_from(score: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> float | None:
    """The score from which at least four in five boxes of a score are objects; None with too few objects.

    It is at most the score that a tenth of the objects reaches: fewer would leave little to learn.
    """
    if right.sum() < _FEWEST:
        return None
    values, share = calibrated(score, right)
    confident = values[share >= _OBJECT]
    best_tenth = float(np.quantile(score[right], 0.9))
    return min(float(confident[0]), best_tenth) if len(confident) else best_tenth


def background_below(score: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> float | None:
    """The score below which at most one in five boxes of a score is an object; None with too few boxes.

    Where every score is higher, the lowest of them: nothing that was found is background.
    """
    if len(score) < _FEWEST:
        return None
    values, share = calibrated(score, right)
    possible = values[share > _BACKGROUND]
    return float(possible[0]) if len(possible) else float(values[-1])


def calibrated(
    score: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """The scores that occur, ascending, and the share of objects among boxes of each, shapes (m,).

    The shares rise with the score: isotonic regression, each score weighing as many boxes as have it.
    """
    values, count = np.unique(score, return_counts=True)
    objects = np.bincount(np.searchsorted(values, score), weights=right, minlength=len(values))
    share = isotonic_regression(objects / count, weights=count).x
    return values, np.asarray(share, dtype=np.float64)
