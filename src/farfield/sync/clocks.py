"""Offset and drift of one clock against another, from pairs of stamps of the same moments.

Model: ``t_b = t_a + offset + drift (t_a - middle) + delay``. Stamps alone show the drift together with that of the
delay, and the offset together with the delay: its mean for symmetric jitter, its least value for a one-sided delay.
Only a moment that both sensors see, or a two-way exchange (:mod:`farfield.sync.clocks`), tells offset and delay
apart; between streams that were paired by nearness the offset is known up to whole periods of the faster one.
"""

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import ConfigError
from farfield.files.clock_logs import ClockLog
from farfield.vocabulary.counts import count_of

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
    stretch, steps = _longest_stretch(a, difference)
    a, difference = a[stretch], difference[stretch]
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
    step_rows = np.flatnonzero((np.abs(jumps - np.median(jumps)) > limit) & (np.abs(after - before) > limit / 2))
    step_rows = step_rows[np.append(True, np.diff(step_rows) > 1)] if len(step_rows) else step_rows
    edges = np.concatenate([[0], (step_rows + 1) * group, [len(a)]])
    longest = int(np.argmax(np.diff(edges)))
    begin = int(edges[longest]) + (group if longest else 0)  # the step itself may lie within a stretch
    end = int(edges[longest + 1]) - (group if longest < len(step_rows) else 0)
    return slice(begin, max(end, begin + 3)), len(step_rows)


def _standard_errors(x: Seconds, y: Seconds, hull: bool) -> tuple[float, float]:
    """Standard errors of slope and level: from blocks of the span that are drawn again and again (bootstrap).

    Blocks keep what is correlated in time together; there are at most 60 of them, of at least ten pairs.
    """
    blocks = int(min(60, len(x) // 10))
    if blocks < 4:
        return float("nan"), float("nan")
    parts = np.array_split(np.arange(len(x)), blocks)
    rng = np.random.default_rng(len(x))
    fits = []
    for _ in range(60):
        rows = np.sort(np.concatenate([parts[k] for k in rng.integers(0, blocks, blocks)]))
        fits.append(lower_hull(x[rows], y[rows]) if hull else huber(x[rows], y[rows], *theil_sen(x[rows], y[rows])))
    slope_se, level_se = np.std(np.array(fits), axis=0, ddof=1)
    return float(slope_se), float(level_se)


# Straight lines through points with outliers: Theil-Sen, Huber, and the line under all points.

HUBER_K = 1.345
"""Huber's constant: 95 % of least squares' efficiency for Gaussian errors."""
GROUPS = 200
"""Theil-Sen takes the slopes between the medians of so many stretches."""

Values = Float[np.ndarray, " n"]


def theil_sen(x: Values, y: Values) -> tuple[float, float]:
    """Median of the slopes between all pairs of points, or of the medians of :data:`GROUPS` stretches; and the level.

    Args:
        x: Increasing.
        y: As many.

    Returns:
        Slope, and level at ``x = 0``.
    """
    if len(x) > GROUPS:
        size = len(x) // GROUPS
        few = slice(0, size * GROUPS)
        x0, y0 = (np.median(part[few].reshape(GROUPS, size), axis=1) for part in (x, y))
    else:
        x0, y0 = x, y
    first, second = np.triu_indices(len(x0), 1)
    run = x0[second] - x0[first]
    apart = run > 0
    slope = float(np.median((y0[second] - y0[first])[apart] / run[apart])) if apart.any() else 0.0
    return slope, float(np.median(y0 - slope * x0))


def huber(x: Values, y: Values, slope: float, level: float) -> tuple[float, float]:
    """Huber's regression by reweighted least squares from a robust start, its scale from the start's residuals.

    Args:
        x: Where.
        y: What.
        slope: Of the start.
        level: Of the start, at ``x = 0``.

    Returns:
        Slope, and level at ``x = 0``.
    """
    residual = y - level - slope * x
    scale = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    if scale <= 0:
        return slope, level
    for _ in range(30):
        size = np.abs(y - level - slope * x)
        weight = np.minimum(1.0, HUBER_K * scale / np.maximum(size, 1e-300))
        total = weight.sum()
        x_mean, y_mean = float(weight @ x) / total, float(weight @ y) / total
        spread = float(weight @ (x - x_mean) ** 2)
        if spread <= 0:
            return slope, level
        new = float(weight @ ((x - x_mean) * (y - y_mean))) / spread
        change, slope = abs(new - slope), new
        level = y_mean - slope * x_mean
        if change * np.ptp(x) < 1e-6 * scale:
            break
    return float(slope), float(level)


def lower_hull(x: Values, y: Values) -> tuple[float, float]:
    """The line under all points whose distances add up to the least: the edge of the lower hull over the mean of ``x``.

    Args:
        x: Not decreasing; of equal ones the lowest counts.
        y: As many.

    Returns:
        Slope, and level at ``x = 0``.
    """
    chain: list[tuple[float, float]] = []
    for point in zip(x.tolist(), y.tolist(), strict=True):
        if chain and chain[-1][0] == point[0]:
            if point[1] >= chain[-1][1]:
                continue
            chain.pop()
        while len(chain) > 1 and _above(chain[-2], chain[-1], point):
            chain.pop()
        chain.append(point)
    middle = float(x.mean())
    for (x0, y0), (x1, y1) in pairwise(chain):
        if x0 <= middle <= x1:
            slope = (y1 - y0) / (x1 - x0)
            return slope, y0 - slope * x0
    return 0.0, chain[0][1]


def _above(before: tuple[float, float], middle: tuple[float, float], after: tuple[float, float]) -> bool:
    """Whether the middle point lies on or above the line between its neighbours."""
    return (middle[1] - before[1]) * (after[0] - before[0]) >= (after[1] - before[1]) * (middle[0] - before[0])


# Two-way exchanges: what they tell of a clock that one-way stamps cannot, its offset apart from the delay.
#
# IEEE 1588-2019, 11.3: a message leaves the master at ``t1`` and arrives at ``t2``, another leaves at ``t3`` and
# arrives at ``t4``. With equal delays both ways the clock is ahead by ``((t2 - t1) - (t4 - t3)) / 2`` and the delay
# is ``((t2 - t1) + (t4 - t3)) / 2``. What stays unknown is half the difference of the two delays.


@dataclass(frozen=True, kw_only=True)
class ExchangeClock:
    """A clock against its master, from exchanges.

    Args:
        exchanges: How many, of a locked servo.
        unlocked: How many before the servo was locked; they are left out.
        offset_ns: Median offset; None where only summaries stand in the log.
        spread_ns: Robust deviation of the offset, of summaries the median root mean square.
        worst_ns: Largest offset either way.
        delay_ns: Median path delay; None where it is not known.
        asymmetry_limit_ns: The offset cannot be wrong by more: half of both delays together, since neither is negative.
        drift_ppm: What the servo takes off the clock's rate, median; None where it is not known.
    """

    exchanges: int
    unlocked: int
    offset_ns: float | None
    spread_ns: float
    worst_ns: float
    delay_ns: float | None
    asymmetry_limit_ns: float | None
    drift_ppm: float | None

    def to_json(self) -> dict[str, Any]:
        """All of it."""
        return asdict(self)


def two_way(
    t1_ns: Int64[np.ndarray, " n"],
    t2_ns: Int64[np.ndarray, " n"],
    t3_ns: Int64[np.ndarray, " n"],
    t4_ns: Int64[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Offset and delay of each exchange, in nanoseconds, for equal delays both ways.

    Args:
        t1_ns: The master sends, by its clock.
        t2_ns: The other receives, by its own clock.
        t3_ns: The other sends, by its own clock.
        t4_ns: The master receives, by its clock.
    """
    there, back = t2_ns - t1_ns, t4_ns - t3_ns
    return (there - back) / 2, (there + back) / 2


def summarised(log: ClockLog) -> ExchangeClock:
    """What a log of ``ptp4l`` or ``phc2sys`` says of its clock.

    Raises:
        ConfigError: If the servo was never locked.
    """
    rows = np.flatnonzero(log.locked)
    if not len(rows):
        raise ConfigError(
            f"{log.path}: expected a clock that was locked to its master, got {count_of(len(log), 'row')} before"
        )
    offset = log.offset_ns[rows].astype(np.float64)
    median = float(np.median(offset))
    spread = median if log.summary else 1.4826 * float(np.median(np.abs(offset - median)))
    delay = _median(log.delay_ns[rows])
    freq = _median(log.freq_ppb[rows])
    return ExchangeClock(
        exchanges=len(rows),
        unlocked=len(log) - len(rows),
        offset_ns=None if log.summary else median,
        spread_ns=spread,
        worst_ns=float(np.abs(offset).max()),
        delay_ns=delay,
        asymmetry_limit_ns=None if delay is None else max(delay, 0.0),
        drift_ppm=None if freq is None else -freq / 1e3,
    )


def _median(values: Float[np.ndarray, " n"]) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else None
