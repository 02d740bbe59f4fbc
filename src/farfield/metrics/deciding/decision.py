"""The decision on a claim: holds, holds not, or undecided; the same after correcting for many claims; and its power.

The interval D +- t(0.975, df) sqrt(s_seed^2 / n + s_seq^2) of a difference D decides. Holm's correction (1979)
multiplies the k-th smallest of m p-values by m - k + 1. The power is the probability of "holds" for a true difference,
D being normal with that variance and s_seed estimated with df degrees of freedom (chi squared).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float
from scipy import integrate, stats

from farfield.errors import ConfigError
from farfield.metrics.deciding.difference import LEVEL, Difference

Kind = Literal["above", "not_below", "equivalent"]
Verdict = Literal["holds", "holds not", "undecided", "no decision"]
SMALL = 0.02
"""Differences within so much of 0 are called small, in the unit of scores from 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """What is claimed of a difference A - B.

    Args:
        kind: ``"above"``: it lies above ``margin`` (0: A scores above B); ``"not_below"``: above ``-margin`` (nothing
            is lost); ``"equivalent"``: within ``margin`` of 0.
        margin: The margin, from 0 on; more than 0 for ``"equivalent"``.

    Raises:
        ConfigError: If the margin does not go with the kind.
    """

    kind: Kind = "above"
    margin: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise ConfigError(f"claim: expected one of {', '.join(get_args(Kind))}; got {self.kind!r}")
        if not self.margin >= 0 or (self.kind == "equivalent" and self.margin == 0):
            raise ConfigError(f"margin of a claim {self.kind}: expected more than 0 (above: from 0), got {self.margin}")

    @property
    def bounds(self) -> tuple[float, float]:
        """Between which values the difference is claimed to lie."""
        low = self.margin if self.kind == "above" else -self.margin
        return low, self.margin if self.kind == "equivalent" else float("inf")


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What a difference says of a claim.

    Args:
        verdict: ``"holds"``, ``"holds not"``, ``"undecided"``, or ``"no decision"`` with a reason.
        difference: The difference.
        hypothesis: What was claimed.
        small: The interval lies within so much of 0 though the claim is undecided; None if it does not.
        p: Two-sided probability of a difference as far from the claim's bounds; None without decision.
        reason: Why there is no decision.
    """

    verdict: Verdict
    difference: Difference
    hypothesis: Hypothesis
    small: float | None = None
    p: float | None = None
    reason: str = ""

    @property
    def words(self) -> str:
        """The verdict as a table shows it: ``"undecided and smaller than 0.02"``, ``"one seed: no decision"``."""
        if self.verdict == "no decision":
            return f"{self.reason}: no decision"
        return self.verdict + ("" if self.small is None else f" and smaller than {self.small:g}")

    def __str__(self) -> str:
        difference, interval = self.difference, self.difference.interval()
        if difference.estimate is None:
            return self.words
        spans = "" if interval is None else f" [{interval[0]:+.3f}, {interval[1]:+.3f}]"
        seeds = f", n {difference.n}" if difference.trained else ""
        return f"{difference.estimate:+.3f}{spans}{seeds}: {self.words}"

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values."""
        claimed = {"kind": self.hypothesis.kind, "margin": self.hypothesis.margin}
        outcome = {"verdict": self.verdict, "words": self.words, "p": self.p, "small": self.small}
        return {**outcome, "claim": claimed, "difference": self.difference.to_json()}


def decide(difference: Difference, hypothesis: Hypothesis | None = None, *, small: float = SMALL) -> Decision:
    """Decide a claim on a difference.

    It holds where the whole interval lies within the claimed bounds, fails where it lies wholly outside them, and
    is undecided else. One seed or one sequence decides nothing.

    Args:
        difference: The difference, with the pooled spread of its grid.
        hypothesis: What is claimed; None: that A lies above B.
        small: An undecided difference whose interval lies within so much of 0 is called small.
    """
    hypothesis = hypothesis or Hypothesis()
    interval = difference.interval()
    reason = _reason(difference)
    if reason or interval is None:
        return Decision(verdict="no decision", difference=difference, hypothesis=hypothesis, reason=reason)
    (low, high), (least, most) = interval, hypothesis.bounds
    verdict: Verdict = "undecided"
    if low > least and high < most:
        verdict = "holds"
    elif high < least or low > most:
        verdict = "holds not"
    near = verdict == "undecided" and -small < low and high < small
    return Decision(
        verdict=verdict,
        difference=difference,
        hypothesis=hypothesis,
        small=small if near else None,
        p=_two_sided(difference, hypothesis),
    )


def _reason(difference: Difference) -> str:
    """Why there is no decision; empty where there is one."""
    if difference.estimate is None:
        return "no figure"
    if difference.s_seq is None:
        return "too few sequences have a figure"
    if difference.grouped_by == "frames" or difference.groups < 2:
        return "one sequence"
    if difference.trained and difference.n < 2:
        return "one seed"
    return ""


def _two_sided(difference: Difference, hypothesis: Hypothesis) -> float:
    """Twice the smaller of the one-sided probabilities that the decision, either way, is by chance."""
    least, most = hypothesis.bounds
    above_least, below_most = _tail(difference, least), _tail(difference, most, below=True)
    holds = max(above_least, below_most)
    fails = min(1 - above_least, 1 - below_most)
    return min(1.0, 2 * min(holds, fails))


def _tail(difference: Difference, bound: float, *, below: bool = False) -> float:
    """Probability of a difference as far above a bound (or below it), were the bound the truth."""
    if np.isinf(bound):
        return 0.0
    distance = (difference.estimate or 0.0) - bound
    distance = -distance if below else distance
    error = difference.error or 0.0
    if error == 0:
        return 0.5 if distance == 0 else float(distance < 0)
    return float(stats.t.sf(distance / error, difference.df))


def holm(decisions: Sequence[Decision], *, level: float = LEVEL) -> list[Decision]:
    """The same decisions corrected for their number (Holm 1979): a verdict stays where its adjusted p stays small.

    Args:
        decisions: All decisions of a report; those without one are not counted.
        level: Level of the intervals, 0.95: all wrong verdicts together are to be as rare as 1 - level.

    Returns:
        Decisions in the same order with adjusted ``p``; verdicts that do not survive are undecided.
    """
    tested = [number for number, decision in enumerate(decisions) if decision.p is not None]
    ordered = sorted(tested, key=lambda number: decisions[number].p or 0.0)
    adjusted, largest = list(decisions), 0.0
    for rank, number in enumerate(ordered):
        decision = decisions[number]
        largest = min(1.0, max(largest, (len(ordered) - rank) * (decision.p or 0.0)))
        lost = decision.verdict in ("holds", "holds not") and largest >= 1 - level
        adjusted[number] = replace(decision, p=largest, verdict="undecided" if lost else decision.verdict)
    return adjusted


# Power: how likely a claim is to be decided with so many seeds and sequences

_TAIL = 1e-9  # of the distribution of the estimated spread, left out on either side


def power(
    true: float | int,
    *,
    s_seed: float,
    s_seq: float,
    n: int,
    df: float | int | None = None,
    hypothesis: Hypothesis | None = None,
    level: float = LEVEL,
) -> float:
    """Probability that the rule says "holds" if the difference is truly so large.

    The mean difference is normal with variance s_seed^2 / n + s_seq^2; s_seed is estimated with ``df`` degrees of
    freedom, independently of the mean; s_seq is taken as known.

    Args:
        true: The true difference, such as the published one.
        s_seed: Spread of the difference over seeds.
        s_seq: Spread over draws of the sequences.
        n: Number of seeds.
        df: Degrees of freedom with which s_seed is known; None: the pair's own, n - 1.
        hypothesis: What is claimed; None: that the difference lies above 0.
        level: Level of the interval.

    Raises:
        ConfigError: If there are fewer than two seeds and no pooled spread, or a spread is negative.
    """
    freedom = _freedom(s_seed, s_seq, n, df)
    least, most = (hypothesis or Hypothesis()).bounds
    error = float(np.sqrt(s_seed**2 / n + s_seq**2))
    if error == 0:
        return float(least < true < most)
    decided = partial(_decided, true, least, most, error, s_seed, s_seq, n, freedom, level)
    if np.isinf(freedom) or s_seed == 0:
        return float(decided(np.array(freedom if np.isfinite(freedom) else 1.0)))
    low, high = float(stats.chi2.ppf(_TAIL, freedom)), float(stats.chi2.ppf(1 - _TAIL, freedom))
    weighted = partial(_weighted, decided, freedom)
    probability, _ = integrate.quad(weighted, low, high, limit=200, points=[freedom], epsabs=1e-7, epsrel=1e-7)
    return float(min(max(probability, 0.0), 1.0))


def half_width(*, s_seed: float, s_seq: float, n: int, df: float | int | None = None, level: float = LEVEL) -> float:
    """Half of the interval's width, with the spreads as they are; arguments and errors are those of :func:`power`."""
    freedom = _freedom(s_seed, s_seq, n, df)
    return float(stats.t.ppf((1 + level) / 2, freedom) * np.sqrt(s_seed**2 / n + s_seq**2))


def _freedom(s_seed: float, s_seq: float, n: int, df: float | int | None) -> float:
    freedom = n - 1 if df is None else df
    if n < 1 or freedom <= 0 or min(s_seed, s_seq) < 0:
        raise ConfigError(
            f"power: expected spreads from 0 on and two seeds or a pooled spread with its df, got s_seed {s_seed}, "
            f"s_seq {s_seq}, n {n}, df {df}"
        )
    return float(freedom)


def _weighted(decided: "partial[Float[np.ndarray, '']]", freedom: float, squares: float) -> float:
    return float(decided(np.array(squares)) * stats.chi2.pdf(squares, freedom))


def _decided(
    true: float | int,
    least: float,
    most: float,
    error: float,
    s_seed: float,
    s_seq: float,
    n: int,
    freedom: float,
    level: float,
    squares: Float[np.ndarray, ""],
) -> Float[np.ndarray, ""]:
    """Probability of "holds" where the estimated variance is ``s_seed^2 squares / freedom``."""
    share = 1.0 if np.isinf(freedom) else squares / freedom
    half_width_of_interval = stats.t.ppf((1 + level) / 2, freedom) * np.sqrt(s_seed**2 * share / n + s_seq**2)
    low, high = least + half_width_of_interval, most - half_width_of_interval
    return np.asarray(np.maximum(stats.norm.cdf((high - true) / error) - stats.norm.cdf((low - true) / error), 0.0))
