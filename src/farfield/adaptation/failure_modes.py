"""Failure modes of an adaptation that its log shows, named when they occur.

The limits are those of docs/adaptation.md. What needs another run beside it (collapse against the run without
adversary, a gain of the controls) is not seen here.
"""

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence

Row = Mapping[str, float | int]

_FEWEST = 4  # rows of a log that are needed to speak of its halves
_ROWS = 16  # and of which the first and the last quarter are compared
_EARLY = 50  # steps
_CHANCE, _SURE, _TELLS = 0.52, 0.95, 0.8
_LEFT = 0.7  # of variance and rank in the first quarter
_SWING = 0.35
_TOO_FEW, _TOO_MANY = 0.5, 2.0  # pseudo boxes over those at the beginning


def diagnose_log(rows: Sequence[Row]) -> Iterator[str]:
    """What goes wrong, one sentence each, with what to do.

    Args:
        rows: Of a ``log.jsonl``, in their order; columns that a method does not log are passed over.

    >>> list(diagnose_log([{"step": step, "discriminator_accuracy": 0.99} for step in range(0, 100, 10)]))[0][:31]
    'the discriminator is always rig'
    """
    yield from _of_discriminator(rows)
    yield from _of_features(rows)
    yield from _of_gradients(rows)
    yield from _of_pseudo_boxes(rows)
    mixed = [row["n_eff"] for row in rows if "n_eff" in row]
    if mixed and (mixed[-1] < 1.5 or mixed[-1] > 200):
        what = "a copy of one object" if mixed[-1] < 1.5 else "the class mean"
        yield f"n_eff is {mixed[-1]:.0f}: the mixture is {what}; {'raise' if mixed[-1] < 1.5 else 'lower'} tau"


def _of_discriminator(rows: Sequence[Row]) -> Iterator[str]:
    held = [row for row in rows if "held_accuracy" in row]
    scored = held or [row for row in rows if "discriminator_accuracy" in row]
    name = "held_accuracy" if held else "discriminator_accuracy"
    accuracy = [row[name] for row in scored]
    early = [row for row in rows if row["step"] <= _EARLY and "discriminator_accuracy" in row]
    probes = [row["probe_accuracy"] for row in rows if "probe_accuracy" in row]
    if early and probes and early[-1]["discriminator_accuracy"] < _CHANCE and probes[-1] > _TELLS:
        yield (
            f"the discriminator is at {early[-1]['discriminator_accuracy']:.2f} within {_EARLY} steps, and a fresh "
            f"linear probe tells the domains with {probes[-1]:.2f}: it is weak, the features are not alike; take 3 "
            "times its rate"
        )
    half = accuracy[len(accuracy) // 2 :]
    if len(accuracy) >= _FEWEST and min(half) > _SURE:
        yield (
            f"the discriminator is always right in the last half ({min(half):.2f} and more), so its gradient is gone: "
            "smoothing 0.1, loss least_squares, or a lower rate"
        )
    elif len(accuracy) >= 2 * _FEWEST and _swings(half):
        yield "the discriminator's accuracy swings between 0.5 and 1: an unstable game; lower both rates, and clip"


def _swings(values: Sequence[float | int]) -> bool:
    """Whether a curve goes far up and down again more than once."""
    turns, direction, extreme = 0, 0, values[0]
    for value in values[1:]:
        if abs(value - extreme) >= _SWING:
            step = 1 if value > extreme else -1
            turns += step != direction
            direction, extreme = step, value
        elif direction and (value - extreme) * direction > 0:
            extreme = value
    return turns >= 3


def _of_features(rows: Sequence[Row]) -> Iterator[str]:
    names = sorted({name for row in rows for name in row if name.startswith(("variance_", "rank_"))})
    for name in names:
        first, last = _ends([row[name] for row in rows if name in row])
        if first > 0 and last < _LEFT * first:
            kind, _, domain = name.partition("_")
            yield (
                f"the {kind} of the features of {domain} fell to {last / first:.0%} of what it was: they collapse, if "
                "a run without the loss does not do so too; lower lambda_max or weight"
            )


def _of_gradients(rows: Sequence[Row]) -> Iterator[str]:
    ratios = [row["gradient_ratio"] for row in rows if "gradient_ratio" in row]
    if len(ratios) >= _FEWEST and _mean(ratios[len(ratios) // 2 :]) > 1:
        yield (
            f"the added loss pulls {_mean(ratios[len(ratios) // 2 :]):.1f} times as hard at the shared features as the "
            "detection does: it dominates; halve its weight or lambda_max"
        )


def _of_pseudo_boxes(rows: Sequence[Row]) -> Iterator[str]:
    first, last = _ends([row["pseudo_boxes"] for row in rows if "pseudo_boxes" in row])
    if first > 0 and not _TOO_FEW < last / first < _TOO_MANY:
        word = "more" if last > first else "fewer"
        yield (
            f"the teacher finds {word} and {word} confident pseudo-labels ({first:.1f} a frame at first, {last:.1f} at "
            "last): it may confirm its own mistakes; look at the page, take fewer rounds or steps"
        )


def _ends(values: Sequence[float | int]) -> tuple[float, float]:
    """Means of the first and of the last quarter; alike where there are few rows or what is between them is noise."""
    count = len(values) // 4
    if len(values) < _ROWS:
        return 0.0, 0.0
    first, last = _mean(values[:count]), _mean(values[-count:])
    spread = statistics.variance(values[:count]) + statistics.variance(values[-count:])
    return (first, last) if abs(last - first) > 2 * math.sqrt(spread / count) else (first, first)


def _mean(values: Sequence[float | int]) -> float:
    return math.fsum(values) / len(values)
