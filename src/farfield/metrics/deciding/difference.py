"""Differences between two rows of a table, paired by seed, and how far they scatter."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import stats

from farfield.errors import ConfigError
from farfield.metrics.deciding.samples import REPLICATES, Scalar, ScoreSample, drawn_values, sample
from farfield.metrics.detections import Detections
from farfield.metrics.protocol import Protocol

LEVEL = 0.95
_OUTLIER = 2.0  # a pair whose own spread is so many times the pooled one keeps its own
_LEAST_DRAWN = 0.5  # share of the draws under which both rows must have a figure


@dataclass(frozen=True)
class Spread:
    """How far differences scatter from seed to seed.

    Args:
        s: Standard deviation.
        df: Degrees of freedom with which it is known.
    """

    s: float
    df: float | int


@dataclass(frozen=True, kw_only=True)
class Difference:
    """The difference of one number between two rows.

    Args:
        by_seed: The difference of each seed; empty where a row has no such figure.
        s_seq: Standard deviation of the mean difference under draws of sequences; None where it has no figure under
            most of the draws.
        groups: Number of sequences that were drawn.
        grouped_by: ``"sequences"``, or ``"frames"`` where there is only one sequence.
        pooled: Spread over seeds of all pairs of the grid, see :func:`pooled`.
        trained: Whether rows were trained, so that they depend on a seed; False for a statistic of the data.
    """

    by_seed: tuple[float, ...]
    s_seq: float | None
    groups: int
    grouped_by: str = "sequences"
    pooled: Spread | None = None
    trained: bool = True

    @property
    def n(self) -> int:
        """Number of seeds."""
        return len(self.by_seed)

    @property
    def estimate(self) -> float | None:
        """Mean difference D; None where there is no figure."""
        return float(np.mean(self.by_seed)) if self.by_seed else None

    @property
    def own(self) -> Spread | None:
        """Spread of this pair's own seeds; None below two seeds."""
        return Spread(float(np.std(self.by_seed, ddof=1)), self.n - 1) if self.n > 1 else None

    @property
    def spread(self) -> Spread | None:
        """The spread that counts: the pooled one, or the pair's own if that is more than twice as large.

        None below two seeds: what one seed gives cannot be told from chance.
        """
        own = self.own
        if own is None or self.pooled is None:
            return own
        return own if own.s > _OUTLIER * self.pooled.s else self.pooled

    @property
    def df(self) -> float:
        """Degrees of freedom of the interval; infinite for one seed, whose interval is over sequences only."""
        if not self.trained:
            return float(max(self.groups - 1, 1))
        return float(self.spread.df) if self.spread else float("inf")

    @property
    def error(self) -> float | None:
        """Standard error of D, sqrt(s_seed^2 / n + s_seq^2); for one seed s_seq alone. None where there is none."""
        if not self.by_seed or self.s_seq is None:
            return None
        s_seed = self.spread.s if self.trained and self.spread else 0.0
        return float(np.sqrt(s_seed**2 / self.n + self.s_seq**2))

    def interval(self, level: float = LEVEL) -> tuple[float, float] | None:
        """D +- t((1 + level) / 2, df) times its standard error; None where there is no figure."""
        if self.estimate is None or self.error is None:
            return None
        reach = float(stats.t.ppf((1 + level) / 2, self.df)) * self.error
        return self.estimate - reach, self.estimate + reach

    def with_pooled(self, spread: Spread | None) -> "Difference":
        """The same with the spread of the grid."""
        return replace(self, pooled=spread)

    def to_json(self) -> dict[str, Any]:
        """All figures as JSON values."""
        spreads = {"own": self.own, "pooled": self.pooled}
        return {
            "estimate": self.estimate,
            "interval": self.interval(),
            "n": self.n,
            "by_seed": list(self.by_seed),
            "s_seed": {name: None if found is None else found.s for name, found in spreads.items()},
            "s_seq": self.s_seq,
            "df": self.df if np.isfinite(self.df) else None,
            "groups": self.groups,
            "grouped_by": self.grouped_by,
            "trained": self.trained,
        }


def difference(
    a: Sequence[Detections],
    b: Sequence[Detections],
    scalar: Scalar,
    *,
    b_scalar: Scalar | None = None,
    protocol: str | Protocol = "dds",
    replicates: int = REPLICATES,
    seed: int = 0,
    **settings: Any,
) -> Difference:
    """The difference of one number between two rows.

    To take several numbers of the same runs keep their :func:`sample` and use :func:`difference_of`.

    Args:
        a: What the detectors of one row found, seed by seed.
        b: The same of the other row: the same seeds in the same order, scored on the same frames.
        scalar: The number, see :func:`farfield.metrics.deciding.figure`.
        b_scalar: The other row's number if it is another, such as that of another range.
        protocol: The protocol or its name.
        replicates: Draws of the sequences.
        seed: Seed of the draws.
        **settings: Settings of the protocol.

    Raises:
        ConfigError: If the rows have not as many seeds, or were scored on different frames; or as of ``sample``.
    """
    scalars = (scalar, scalar if b_scalar is None else b_scalar)
    rows = [
        [sample(found, which, protocol=protocol, replicates=replicates, seed=seed, **settings) for found in row]
        for row, which in zip((a, b), scalars, strict=True)
    ]
    return difference_of(*rows)


def difference_of(a: Sequence[ScoreSample], b: Sequence[ScoreSample]) -> Difference:
    """The difference of two rows whose numbers were sampled, seed by seed.

    Raises:
        ConfigError: If the rows have not as many seeds, or not the same frames, draws and seed of the draws.
    """
    if not a or len(a) != len(b):
        raise ConfigError(
            f"expected two rows of as many seeds, at least one, got {len(a)} and {len(b)}: runs are paired"
        )
    if len({each.drawn for each in (*a, *b)}) > 1:
        raise ConfigError(
            "expected rows scored on the same frames with the same draws of their sequences, got different ones. Score "
            "both on one set, with equal replicates and seed"
        )
    pairs = [(one.value, other.value) for one, other in zip(a, b, strict=True)]
    found = [one - other for one, other in pairs if one is not None and other is not None]
    drawn = np.mean([one.draws - other.draws for one, other in zip(a, b, strict=True)], axis=0)
    return Difference(
        by_seed=tuple(found) if len(found) == len(pairs) else (),
        s_seq=_spread_of(drawn),
        groups=a[0].groups,
        grouped_by=a[0].grouped_by,
    )


def measured(
    statistic: Callable[[Float[np.ndarray, " groups"]], float | None],
    groups: int,
    *,
    replicates: int = REPLICATES,
    seed: int = 0,
) -> Difference:
    """A difference between statistics of the data, which no training seed bears on.

    Args:
        statistic: The difference under weights of the sequences (how often each was drawn), shape (groups,).
        groups: Number of sequences.
        replicates: Draws of the sequences.
        seed: Seed of the draws.
    """
    value = statistic(np.ones(groups))
    drawn = drawn_values(statistic, groups, replicates=replicates, seed=seed)
    by_seed = () if value is None else (value,)
    return Difference(by_seed=by_seed, s_seq=_spread_of(drawn), groups=groups, trained=False)


def _spread_of(drawn: Float[np.ndarray, " replicates"]) -> float | None:
    known = drawn[np.isfinite(drawn)]
    if len(known) < max(2, _LEAST_DRAWN * len(drawn)):
        return None
    return float(np.std(known, ddof=1))


def pooled(differences: Iterable[Difference]) -> Spread | None:
    """Spread over seeds, pooled over pairs of one grid, metric and detector size; None if none has two seeds.

    Args:
        differences: The pairs; those of one seed are passed over.
    """
    own = [found.own for found in differences if found.trained and found.own is not None]
    df = sum(found.df for found in own)
    return Spread(float(np.sqrt(sum(found.df * found.s**2 for found in own) / df)), df) if own else None
