"""Scores that mean the same at every range and for few points as for many: a temperature and an offset a band.

A calibrated score is sigmoid(logit(score) / temperature + offset) (Platt 1999; Guo et al. 2017), fitted where labels
are known, on frames that were not learnt from. Needs no torch.
"""

from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field
from scipy.optimize import minimize
from scipy.special import expit, logit

from farfield.files.yaml_text import PlainSettings

RANGES_M, POINTS = (0.0, 70.0, 150.0), (0, 5, 20)
"""Where the bands of range and of points begin."""
_FEWEST = 30  # right boxes, and false ones, of a band that is fitted for itself
_TINY = 1e-6
_TEMPERATURE, _OFFSET = (0.2, 5.0), (-5.0, 5.0)

Temperature = Annotated[float, Field(ge=_TEMPERATURE[0], le=_TEMPERATURE[1])]
Offset = Annotated[float, Field(ge=_OFFSET[0], le=_OFFSET[1])]


class ScoreBands(PlainSettings):
    """A temperature and an offset for each band of range and of points."""

    ranges_m: tuple[float, ...] = Field(RANGES_M, min_length=1, max_length=16, description="where each band begins")
    points: tuple[int, ...] = Field(POINTS, min_length=1, max_length=16, description="where each band begins")
    temperature: tuple[tuple[Temperature, ...], ...] = Field(description="of each band: ranges, then points")
    offset: tuple[tuple[Offset, ...], ...] = Field(description="of each band: ranges, then points")

    def __call__(
        self, score: Float[np.ndarray, " n"], range_m: Float[np.ndarray, " n"], points: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Calibrated scores of boxes, shape (n,).

        Args:
            score: What the network gave.
            range_m: Range of each box on the ground.
            points: Points in it.
        """
        row, column = bands_of(range_m, points, self.ranges_m, self.points)
        temperature, offset = (np.array(table)[row, column] for table in (self.temperature, self.offset))
        return np.asarray(expit(logit(np.clip(score, _TINY, 1 - _TINY)) / temperature + offset))

    def least_score(self, calibrated: float) -> float:
        """The network's score that some band lifts to a calibrated one, and none lower."""
        strength = logit(np.clip(calibrated, _TINY, 1 - _TINY))
        least = expit((strength - np.array(self.offset)) * np.array(self.temperature)).min()
        return float(least) if min(calibrated, least) > _TINY else 0.0  # scores below count as that one


def bands_of(
    range_m: Float[np.ndarray, " n"],
    points: Int[np.ndarray, " n"],
    ranges_m: tuple[float, ...] = RANGES_M,
    starts: tuple[int, ...] = POINTS,
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """The band of range and the band of points of each box."""
    row, column = np.searchsorted(ranges_m, range_m, side="right"), np.searchsorted(starts, points, side="right")
    return np.maximum(row - 1, 0), np.maximum(column - 1, 0)


def fitted_bands(
    score: Float[np.ndarray, " n"],
    right: Float[np.ndarray, " n"],
    range_m: Float[np.ndarray, " n"],
    points: Int[np.ndarray, " n"],
) -> ScoreBands:
    """Fit the bands to boxes of which is known whether each is an object; a band with too few takes what fits all.

    Args:
        score: Scores of boxes.
        right: 1 of an object, 0 of a false box.
        range_m: Range of each.
        points: Points in each.
    """
    row, column = bands_of(range_m, points)
    of_all = _fit(score, right)
    table = [[of_all for _ in POINTS] for _ in RANGES_M]
    for i in range(len(RANGES_M)):
        for j in range(len(POINTS)):
            band = (row == i) & (column == j)
            if min(right[band].sum(), (1 - right[band]).sum()) >= _FEWEST:
                table[i][j] = _fit(score[band], right[band])
    return ScoreBands(
        temperature=tuple(tuple(cell[0] for cell in cells) for cells in table),
        offset=tuple(tuple(cell[1] for cell in cells) for cells in table),
    )


def _fit(score: Float[np.ndarray, " n"], right: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Temperature and offset of the least cross-entropy; 1 and 0 where boxes are too few to tell."""
    if min(right.sum(), (1 - right).sum()) < _FEWEST:
        return 1.0, 0.0
    strength = logit(np.clip(score, _TINY, 1 - _TINY))
    limits = [(np.log(_TEMPERATURE[0]), np.log(_TEMPERATURE[1])), _OFFSET]
    best = minimize(_cross_entropy, [0.0, 0.0], args=(strength, right), bounds=limits, method="L-BFGS-B")
    return float(np.clip(np.exp(best.x[0]), *_TEMPERATURE)), float(np.clip(best.x[1], *_OFFSET))


def _cross_entropy(
    parameters: Float[np.ndarray, " 2"], strength: Float[np.ndarray, " n"], right: Float[np.ndarray, " n"]
) -> float:
    calibrated = strength / np.exp(parameters[0]) + parameters[1]
    return float(np.mean(np.logaddexp(0.0, calibrated) - right * calibrated))


def calibration_error(score: Float[np.ndarray, " n"], right: Float[np.ndarray, " n"], *, bins: int = 10) -> float:
    """Expected calibration error: mean distance of score and share of objects over bins of the score, by their boxes.

    Args:
        score: Scores from 0 to 1.
        right: 1 of an object, 0 of a false box.
        bins: Bins of equal width (Guo et al. 2017, equation 5).
    """
    number = np.minimum((score * bins).astype(np.int64), bins - 1)
    gap = np.bincount(number, weights=score - right, minlength=bins)
    return float(np.abs(gap).sum() / max(len(score), 1))
