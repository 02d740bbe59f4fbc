"""Bootstrap intervals over sequences: what a score would have been, had other sequences been driven.

Frames of one drive resemble each other, so whole sequences are drawn with replacement (Efron & Tibshirani, 1993, ch. 6
and 13); the frames of a single sequence are drawn only where there is but one. A draw is a vector of weights, how often
each of the g groups came, so nothing is matched again. A protocol gives its figures as functions of rows of weights:

    figures(weights of shape (r, g)) -> r values of each figure, NaN where nothing is annotated under a row's weights

The result is the row in which each weight is 1; the interval of a figure holds its values under the drawn rows between
the quantiles (1 - level) / 2 and (1 + level) / 2.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Statistics = dict[str, float | None]
Draws = Mapping[str, Float[np.ndarray, " r"]]
"""Figures by name, a value for each row of weights; NaN where nothing is annotated."""

Interval = list[float] | None
WeightedFigures = Callable[[Float[np.ndarray, "r g"]], Draws]
"""Figures of one part of a result (all ranges, a range bin, a condition) as a function of rows of group weights."""


@dataclass(frozen=True)
class Bootstrap:
    """How intervals are drawn.

    Args:
        replicates: Number of resamplings; 0 gives no intervals.
        level: Probability that the interval covers, in (0, 1).
        seed: Seed of the generator.
    """

    replicates: int = 200
    level: float = 0.95
    seed: int = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Weighted:
    """The figures of a protocol as functions of how often each group of frames was drawn.

    Args:
        parts: By part (``"overall"``, ``"0-70"``, ``"weather/fog"``) what gives its figures under rows of group
            weights, shape (r, g); where every weight is 1 they are those of the result.
        groups: Group of each annotated frame, in the order of :func:`farfield.metrics.frames.frame_order`.
        grouped_by: ``"sequences"``, or ``"frames"`` where there is only one sequence.
    """

    parts: Mapping[str, WeightedFigures]
    groups: tuple[int, ...]
    grouped_by: str


def replicate_weights(groups: int, replicates: int, rng: np.random.Generator) -> Float[np.ndarray, "replicates groups"]:
    """Draw ``groups`` groups with replacement for each replicate; returns how often each came, (replicates, groups)."""
    return rng.multinomial(groups, np.full(groups, 1.0 / groups), size=replicates).astype(np.float64)


def point_and_intervals(
    figures: Callable[[Float[np.ndarray, "r g"]], Mapping[str, Draws]], groups: int, settings: Bootstrap
) -> tuple[dict[str, Statistics], dict[str, dict[str, Interval]]]:
    """The figures of a result and their percentile intervals, by part and name.

    Args:
        figures: Figures by part and name under rows of group weights.
        groups: Number of groups.
        settings: How to draw.

    Returns:
        Figures under weights of 1, None where nothing is annotated; and [low, high] of each, None where fewer than two
        groups or draws with a value allow no interval.
    """
    weights = np.ones((1, groups))
    if groups >= 2 and settings.replicates >= 2:
        drawn = replicate_weights(groups, settings.replicates, np.random.default_rng(settings.seed))
        weights = np.concatenate([weights, drawn])
    values = {part: dict(named) for part, named in evaluate_once(figures, weights).items()}
    point = {
        part: {name: None if np.isnan(rows[0]) else float(rows[0]) for name, rows in named.items()}
        for part, named in values.items()
    }
    intervals = {
        part: {name: percentile_interval(rows[1:], settings.level) for name, rows in named.items()}
        for part, named in values.items()
    }
    return point, intervals


def evaluate_once(
    figures: Callable[[Float[np.ndarray, "r g"]], Mapping[str, Draws]], weights: Float[np.ndarray, "r g"]
) -> dict[str, dict[str, Float[np.ndarray, " r"]]]:
    """Figures under rows of weights, each different row evaluated once: few groups are drawn alike again and again."""
    different, index = np.unique(weights, axis=0, return_inverse=True)
    index = index.reshape(-1)
    return {part: {name: values[index] for name, values in named.items()} for part, named in figures(different).items()}


def percentile_interval(values: Float[np.ndarray, " r"], level: float, *, least: int = 2) -> Interval:
    """[low, high] round the middle share ``level`` of the values; None below ``least`` that are not NaN."""
    values = values[~np.isnan(values)]
    if len(values) < least:
        return None
    tail = (1.0 - level) / 2
    return [float(bound) for bound in np.quantile(values, [tail, 1 - tail])]
