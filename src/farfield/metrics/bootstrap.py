"""Bootstrap intervals over sequences: what a score would have been, had other sequences been driven.

Frames of one drive resemble each other, so whole sequences are drawn with replacement; the frames of a single sequence
are drawn only where there is but one. A replicate is a vector of weights, one a group, so nothing is matched again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Statistics = dict[str, float | None]
Many = Mapping[str, Float[np.ndarray, " replicates"]]


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
        parts: By part (``"overall"``, ``"0-70"``, ``"weather/fog"``) what gives its figures under group weights; with
            every weight 1 they are those of the result, but for rounding.
        groups: Group of each annotated frame, in the order of :func:`farfield.metrics.frames.frame_order`.
        grouped_by: ``"sequences"``, or ``"frames"`` where there is only one sequence.
    """

    parts: Mapping[str, Callable[[Float[np.ndarray, " groups"]], Statistics]]
    groups: tuple[int, ...]
    grouped_by: str


def replicate_weights(groups: int, replicates: int, rng: np.random.Generator) -> Float[np.ndarray, "replicates groups"]:
    """Draw ``groups`` groups with replacement for each replicate; returns how often each came, (replicates, groups)."""
    return rng.multinomial(groups, np.full(groups, 1.0 / groups), size=replicates).astype(np.float64)


def intervals(
    statistics: Callable[[Float[np.ndarray, " groups"]], Statistics],
    groups: int,
    settings: Bootstrap,
    *,
    many: Callable[[Float[np.ndarray, "replicates groups"]], Many] | None = None,
) -> dict[str, list[float] | None]:
    """Percentile interval of every statistic.

    Args:
        statistics: Named figures under given group weights; None where nothing was annotated among them.
        groups: Number of groups.
        settings: How to draw.
        many: The same figures under each row of weights, NaN for None, where that is faster than one by one.

    Returns:
        [low, high] by name; None where fewer than two groups or replicates allow no interval.
    """
    if groups < 2 or settings.replicates < 2:
        return dict.fromkeys(statistics(np.ones(groups)))
    weights = replicate_weights(groups, settings.replicates, np.random.default_rng(settings.seed))
    drawn = _one_by_one(statistics, weights) if many is None else _all_at_once(many, weights)
    tail = (1.0 - settings.level) / 2
    return {
        name: [float(v) for v in np.quantile(values, [tail, 1 - tail])] if len(values) > 1 else None
        for name, values in drawn.items()
    }


def _one_by_one(
    statistics: Callable[[Float[np.ndarray, " groups"]], Statistics], weights: Float[np.ndarray, "replicates groups"]
) -> dict[str, list[float]]:
    """The values of each figure that are known, in the order of the replicates."""
    drawn: dict[str, list[float]] = {}
    known: dict[bytes, Statistics] = {}  # few groups are drawn alike again and again: of two in three ways only
    for weight in weights:
        key = weight.tobytes()
        if key not in known:
            known[key] = statistics(weight)
        for name, value in known[key].items():
            drawn.setdefault(name, []).extend([] if value is None else [value])
    return drawn


def _all_at_once(
    many: Callable[[Float[np.ndarray, "replicates groups"]], Many], weights: Float[np.ndarray, "replicates groups"]
) -> dict[str, list[float]]:
    """The same from figures of all replicates that differ."""
    different, place = np.unique(weights, axis=0, return_inverse=True)
    found = {name: values[place.reshape(-1)] for name, values in many(different).items()}
    return {name: values[~np.isnan(values)].tolist() for name, values in found.items()}
