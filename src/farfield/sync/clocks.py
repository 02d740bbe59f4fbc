"""Offset and drift of one clock against another, from pairs of stamps of the same moments.

Model: ``t_b = t_a + offset + drift (t_a - middle) + delay``. Stamps alone show the drift together with that of the
delay, and the offset together with the delay: its mean for symmetric jitter, its least value for a one-sided delay.
Only a moment that both sensors see, or a two-way exchange (:mod:`farfield.sync.exchange`), tells offset and delay
apart; between streams that were paired by nearness the offset is known up to whole periods of the faster one.
"""

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import ConfigError
from farfield.sync.lines import huber, lower_hull, theil_sen

Noise = Literal["auto", "symmetric", "one-sided"]
SKEWED = 0.3
"""From this robust skewness of the residuals on a delay is taken as one-sided; an exponential one has 0.46."""
MAX_PAIRS = 200_000
"""So many pairs are used, evenly chosen, where there are more."""

Seconds = Float[np.ndarray, " _"]


@dataclass(frozen=True, kw_only=True)
class ClockModel:
    """One clock against another, with standard errors.

    Args:
        offset_ns: ``t_b - t_a`` at the middle of the span.
        offset_se_ns: Its standard error.
        drift_ppm: How much faster clock b runs, microseconds a second.
        drift_se_ppm: Its standard error.
        middle_ns: The middle of the span, by clock a.
        span_s: From the first pair to the last.
        pairs: Pairs used.
        jitter_ms: Robust deviation of the residuals.
        bound_ppm: What no estimator can fall below for such symmetric jitter, see :func:`drift_bound_ppm`.
        method: ``huber`` or ``hull``.
        offset_includes: What of the delay the offset includes.
        modulo_ns: The offset is known up to whole multiples of this; None where it is known as it is.
        steps: Places where a clock was set: the fit is of the longest stretch between two.
    """

    offset_ns: float
    offset_se_ns: float
    drift_ppm: float
    drift_se_ppm: float
    middle_ns: int
    span_s: float
    pairs: int
    jitter_ms: float
    bound_ppm: float
    method: str
    offset_includes: str
    modulo_ns: int | None = None
    steps: int = 0

    def to_json(self) -> dict[str, Any]:
        """All of it; None for a standard error that so few pairs do not give."""
        return {name: None if value != value else value for name, value in asdict(self).items()}


def drift_bound_ppm(jitter_s: float, pairs: int, span_s: float) -> float:
    """Least standard deviation of the drift for symmetric Gaussian jitter: ``jitter sqrt(12 / pairs) / span``.

    The Cramer-Rao bound of a straight line through evenly spaced moments, in parts per million; ``nan`` without a span.
    """
    return float(jitter_s * np.sqrt(12 / pairs) / span_s * 1e6) if span_s > 0 and pairs else float("nan")


def fit_clock(
    a_ns: Int64[np.ndarray, " n"],
    b_ns: Int64[np.ndarray, " n"],
    *,
    noise: Noise = "auto",
    modulo_ns: int | None = None,
) -> ClockModel:
    """Estimate offset and drift of clock b against clock a, robust against outliers and set clocks.

    Symmetric jitter gets Huber's regression from a Theil-Sen start, one-sided delays the lower convex hull (Moon,
    Skelly, Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999): the line
    under all points with the least sum of residuals.

    Args:
        a_ns: Stamps by clock a, increasing.
        b_ns: Stamps of the same moments by clock b.
        noise: Kind of jitter; ``"auto"`` decides by the skewness of the residuals.
        modulo_ns: The pairs were found by nearness among stamps of this period: differences are unwrapped by it.

    Raises:
        ConfigError: If there are fewer than three pairs, or they do not increase.
    """
    if len(a_ns) != len(b_ns) or len(a_ns) < 3 or (np.diff(a_ns) <= 0).any():
        raise ConfigError(f"fit_clock: expected three pairs or more that increase, got {len(a_ns)} and {len(b_ns)}")
    every = -(-len(a_ns) // MAX_PAIRS)
    difference = b_ns - a_ns
    if modulo_ns is not None:
        difference = unwrapped(difference, modulo_ns)
    a, difference = a_ns[::every], difference[::every]
    kept, steps = _longest_stretch(a, difference)
    a, difference = a[kept], difference[kept]
    middle = int(a[0]) + int(a[-1] - a[0]) // 2
    base = int(np.median(difference))
    x, y = (a - middle) / 1e9, (difference - base) / 1e9
    slope, level = theil_sen(x, y)
    hull = noise == "one-sided" or (
        noise == "auto" and _skewness(y - level - slope * x) > max(SKEWED, 6.4 / len(x) ** 0.5)
    )
    slope, level = lower_hull(x, y) if hull else huber(x, y, slope, level)
    residual = y - level - slope * x
    sigma = float(1.4826 * np.median(np.abs(residual - np.median(residual))))
    slope_se, level_se = _standard_errors(x, y, hull)
    span = float(a[-1] - a[0]) / 1e9
    return ClockModel(
        offset_ns=base + level * 1e9,
        offset_se_ns=level_se * 1e9,
        drift_ppm=slope * 1e6,
        drift_se_ppm=slope_se * 1e6,
        middle_ns=middle,
        span_s=span,
        pairs=len(a),
        jitter_ms=sigma * 1e3,
        bound_ppm=drift_bound_ppm(sigma, len(a), span),
        method="hull" if hull else "huber",
        offset_includes="the least delay" if hull else "the typical delay",
        modulo_ns=modulo_ns,
        steps=steps,
    )


def unwrapped(difference_ns: Int64[np.ndarray, " n"], modulo_ns: int) -> Int64[np.ndarray, " n"]:
    """Differences made continuous: each step of more than half a period is taken as one of a whole period less.

    The first keeps its value.

    Raises:
        ConfigError: If the period is not positive.
    """
    if modulo_ns <= 0:
        raise ConfigError(f"modulo: expected a period above 0, got {modulo_ns} ns")
    turns = np.rint(np.diff(difference_ns) / modulo_ns).astype(np.int64)
    return difference_ns - modulo_ns * np.concatenate([np.zeros(1, np.int64), np.cumsum(turns)])


def _skewness(residual: Seconds) -> float:
    """Robust skewness: how much farther the 90 % quantile lies from the median than the 10 % quantile, in [-1, 1]."""
    low, middle, high = np.quantile(residual, [0.1, 0.5, 0.9])
    return float((high + low - 2 * middle) / max(high - low, 1e-12))


def _longest_stretch(a: Int64[np.ndarray, " n"], difference: Int64[np.ndarray, " n"]) -> tuple[slice, int]:
    """The longest part between two places where a clock was set, and how many places there are.

    The medians of stretches of eight pairs are compared: a step stands out by ten deviations of the medians and five of
    single pairs, and stays.
    """
    group, count = 8, len(a) // 8
    if count < 6:
        return slice(0, len(a)), 0
    stretches = difference[: count * group].reshape(count, group)
    medians = np.median(stretches, axis=1)
    jumps = np.diff(medians)
    spread = 1.4826 * float(np.median(np.abs(jumps - np.median(jumps))))
    single = 1.4826 * float(np.median(np.abs(stretches - medians[:, None])))
    limit = max(10 * spread, 5 * single, 1000.0)
    before, after = np.append(medians[:1], medians[:-2]), np.append(medians[2:], medians[-1:])
    places = np.flatnonzero((np.abs(jumps - np.median(jumps)) > limit) & (np.abs(after - before) > limit / 2))
    places = places[np.append(True, np.diff(places) > 1)] if len(places) else places
    edges = np.concatenate([[0], (places + 1) * group, [len(a)]])
    longest = int(np.argmax(np.diff(edges)))
    begin = int(edges[longest]) + (group if longest else 0)  # the step itself may lie within a stretch
    end = int(edges[longest + 1]) - (group if longest < len(places) else 0)
    return slice(begin, max(end, begin + 3)), len(places)


def _standard_errors(x: Seconds, y: Seconds, hull: bool) -> tuple[float, float]:
    """Standard errors of slope and level: from blocks of the span that are drawn again and again (bootstrap).

    Blocks keep what is correlated in time together; there are at most 60 of them, of at least ten pairs.
    """
    blocks = int(min(60, len(x) // 10))
    if blocks < 4:
        return float("nan"), float("nan")
    parts = np.array_split(np.arange(len(x)), blocks)
    rng = np.random.default_rng(len(x))
    found = []
    for _ in range(60):
        rows = np.sort(np.concatenate([parts[k] for k in rng.integers(0, blocks, blocks)]))
        found.append(lower_hull(x[rows], y[rows]) if hull else huber(x[rows], y[rows], *theil_sen(x[rows], y[rows])))
    slope_se, level_se = np.std(np.array(found), axis=0, ddof=1)
    return float(slope_se), float(level_se)
