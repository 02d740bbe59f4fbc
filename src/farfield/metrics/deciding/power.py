"""How likely a claim is to be decided: what a grid of so many seeds and sequences can show."""

from functools import partial

import numpy as np
from jaxtyping import Float
from scipy import integrate, stats

from farfield.errors import ConfigError
from farfield.metrics.deciding.decision import Hypothesis
from farfield.metrics.deciding.difference import LEVEL

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
    found, _ = integrate.quad(weighted, low, high, limit=200, points=[freedom], epsabs=1e-7, epsrel=1e-7)
    return float(min(max(found, 0.0), 1.0))


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
    reach = stats.t.ppf((1 + level) / 2, freedom) * np.sqrt(s_seed**2 * share / n + s_seq**2)
    low, high = least + reach, most - reach
    return np.asarray(np.maximum(stats.norm.cdf((high - true) / error) - stats.norm.cdf((low - true) / error), 0.0))
