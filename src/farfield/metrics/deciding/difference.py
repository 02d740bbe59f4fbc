"""Differences between two rows of a table, paired by seed, and how far they scatter.

A :class:`ScoreSample` is one number of one run, and the same number under draws of its sequences (:func:`sample`). Two
rows of samples give a :class:`Difference` D: the mean over n seeds of a_s - b_s, with the spread over seeds s_seed and
the standard deviation s_seq of D under the draws, which are the same for both rows and all seeds.
"""

import hashlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.metrics.bootstrap import Draws, Statistics, Weighted, evaluate_once, replicate_weights
from farfield.metrics.detections import PROTOCOLS, Detections, Protocol
from farfield.metrics.frames import frame_order

REPLICATES = 1000
"""Draws of the sequences."""


@dataclass(frozen=True)
class Scalar:
    """One number of a protocol's result: a figure of a part, or a sum of several, each with a factor.

    Args:
        terms: Part (``"overall"``, ``"0-70"``, ``"mean_of_bins"``, ``"weather/fog"``), name of the figure
            (``"dds/0/dds"``, ``"ap/vehicle/3d/0.3"``) and factor of each.
    """

    terms: tuple[tuple[str, str, float], ...]

    def __add__(self, other: "Scalar") -> "Scalar":
        return Scalar(self.terms + other.terms)

    def __sub__(self, other: "Scalar") -> "Scalar":
        return Scalar(self.terms + tuple((part, name, -factor) for part, name, factor in other.terms))

    def __str__(self) -> str:
        texts = [f"{factor:+g} {name} ({part})" for part, name, factor in self.terms]
        return " ".join(texts).removeprefix("+1 ").replace("+1 ", "+ ").replace("-1 ", "- ")

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of the result in which it has a term."""
        return tuple(dict.fromkeys(part for part, _, _ in self.terms))

    def of(self, parts: Mapping[str, Statistics]) -> float | None:
        """Its value among the figures of the parts; None where one of them is None.

        Raises:
            ConfigError: If a part has no such figure.
        """
        rows = {
            part: {name: np.array([np.nan if value is None else value]) for name, value in parts[part].items()}
            for part in self.parts
        }
        value = float(self.under(rows)[0])
        return None if np.isnan(value) else value

    def under(self, parts: Mapping[str, Draws]) -> Float[np.ndarray, " r"]:
        """Its values among the figures of the parts under each row of weights; NaN where one of them is NaN.

        Raises:
            ConfigError: If a part has no such figure.
        """
        total = np.zeros(1)
        for part, name, factor in self.terms:
            if name not in parts[part]:
                raise ConfigError(f"figure of {part}: expected one of {', '.join(parts[part])}; got {name!r}")
            total = total + factor * parts[part][name]
        return total


def figure(name: str, part: str = "overall") -> Scalar:
    """A figure of a result; differences and sums of figures are scalars too.

    >>> str(figure("dds/0/dds", "0-70") - figure("dds/0/dds", "70-150"))
    'dds/0/dds (0-70) - dds/0/dds (70-150)'

    Args:
        name: Its name in the result.
        part: The range bin (``"0-70"``) or condition (``"weather/fog"``) if not of the whole.
    """
    return Scalar(((part, name, 1.0),))


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoreSample:
    """One number of one run.

    Args:
        value: The number; None where nothing is annotated.
        draws: The number under each draw of the sequences, NaN where nothing is annotated among them.
        drawn: What was drawn and how; samples of another ``drawn`` cannot be compared.
        grouped_by: ``"sequences"``, or ``"frames"`` where there is only one sequence.
        groups: How many of them.
    """

    value: float | None
    draws: Float[np.ndarray, " replicates"]
    drawn: str
    grouped_by: str
    groups: int


def sample(
    detections: Detections,
    scalar: Scalar,
    *,
    protocol: str | Protocol = "dds",
    replicates: int = REPLICATES,
    seed: int = 0,
    **settings: Any,
) -> ScoreSample:
    """One number of a run under its own sequences and under draws of them.

    Only the parts that the number needs are evaluated; fewer ``epsilons`` or ``ious`` among the settings save time.

    Args:
        detections: What a detector found.
        scalar: The number.
        protocol: The protocol or its name.
        replicates: How many draws.
        seed: Seed of the draws: equal seeds draw equally from equal frames.
        **settings: Settings of the protocol.

    Raises:
        ConfigError: If the protocol, a setting, a part or a figure is unknown, or the protocol cannot be resampled.
    """
    return samples(detections, {"": scalar}, protocol=protocol, replicates=replicates, seed=seed, **settings)[""]


def samples(
    detections: Detections,
    scalars: Mapping[str, Scalar],
    *,
    protocol: str | Protocol = "dds",
    replicates: int = REPLICATES,
    seed: int = 0,
    frames: Collection[Key] | None = None,
    **settings: Any,
) -> dict[str, ScoreSample]:
    """Several numbers of a run, each part of the result evaluated once a draw.

    Args:
        detections: What a detector found.
        scalars: The numbers by name.
        protocol: The protocol or its name.
        replicates: How many draws.
        seed: Seed of the draws.
        frames: Only these frames count, though sequences are drawn as if all did; None: all.
        **settings: Settings of the protocol.

    Raises:
        ConfigError: As of :func:`sample`.
    """
    chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
    counted = detections.counted()
    resolved = chosen.settings(counted, **settings)
    weighted = chosen.weighted(counted, resolved)
    keys = sorted(counted.annotations, key=frame_order)
    groups, text = max(weighted.groups, default=-1) + 1, repr([*zip(keys, weighted.groups, strict=True)])
    digest = hashlib.sha256(f"{text}{replicates} {seed}".encode()).hexdigest()[:16]
    grouped_by = weighted.grouped_by
    index: Int[np.ndarray, " some"] | None = None
    if frames is not None:
        weighted, index = _of_frames(chosen, counted, resolved, weighted, keys, frames)
    parts = tuple(dict.fromkeys(part for scalar in scalars.values() for part in scalar.parts))
    unknown = [part for part in parts if part not in weighted.parts]
    if unknown:
        raise ConfigError(f"part: expected some of {', '.join(weighted.parts)}; got {', '.join(unknown)}")
    bins_m = getattr(resolved, "bins_m", ())
    # Range bins that begin beyond the detector's reach have no figure in a result either.
    reach_m = np.inf if detections.reach_m is None else detections.reach_m
    beyond = {f"{low_m:g}-{high_m:g}" for low_m, high_m in bins_m if low_m >= reach_m}
    figures = partial(_scalars_under, weighted, scalars, tuple(part for part in parts if part not in beyond), index)
    drawn = replicate_weights(groups, replicates, np.random.default_rng(seed)) if groups else np.zeros((replicates, 0))
    values = evaluate_once(figures, np.concatenate([np.ones((1, groups)), drawn]))[""]
    return {
        name: ScoreSample(
            value=None if np.isnan(values[name][0]) else float(values[name][0]),
            draws=values[name][1:],
            drawn=digest,
            grouped_by=grouped_by,
            groups=groups,
        )
        for name in scalars
    }


def _scalars_under(
    weighted: Weighted,
    scalars: Mapping[str, Scalar],
    parts: Sequence[str],
    index: Int[np.ndarray, " some"] | None,
    weights: Float[np.ndarray, "r g"],
) -> dict[str, Draws]:
    """The numbers by name, under one empty part, for each row of group weights; NaN where they are not known.

    Args:
        weighted: The protocol's figures.
        scalars: The numbers.
        parts: Parts that are evaluated; a number of any other part is not known.
        index: Group of the whole of each group of ``weighted``, where its frames are some of the whole; None: equal.
        weights: Weights of the groups of the whole.
    """
    weights = weights if index is None else weights[:, index]
    if not weights.shape[1]:
        return {"": {name: np.full(len(weights), np.nan) for name in scalars}}
    figures = {part: weighted.parts[part](weights) for part in parts}
    return {
        "": {
            name: scalar.under(figures) if set(scalar.parts) <= set(parts) else np.full(len(weights), np.nan)
            for name, scalar in scalars.items()
        }
    }


def _of_frames(
    protocol: Protocol,
    detections: Detections,
    settings: Any,
    whole_weighted: Weighted,
    keys: Sequence[Key],
    frames: Collection[Key],
) -> tuple[Weighted, Int[np.ndarray, " some"]]:
    """The figures of some frames, and of each of their groups which one of the whole it is."""
    selected = [key for key in keys if key in frames]
    some = replace(
        detections,
        boxes={key: detections.boxes[key] for key in selected},
        annotations={key: detections.annotations[key] for key in selected},
    )
    weighted = protocol.weighted(some, settings)
    group_of = dict(zip(keys, whole_weighted.groups, strict=True))
    index = np.zeros(max(weighted.groups, default=-1) + 1, dtype=np.int64)
    index[list(weighted.groups)] = [group_of[key] for key in selected]
    return weighted, index


def drawn_values(
    value_of: Callable[[Float[np.ndarray, " groups"]], float | None],
    groups: int,
    *,
    replicates: int = REPLICATES,
    seed: int = 0,
) -> Float[np.ndarray, " replicates"]:
    """A number under draws of groups, NaN where it is None."""
    value_of_draw: dict[bytes, float] = {}  # few groups are drawn alike again and again
    values = np.full(replicates, np.nan)
    weights = replicate_weights(groups, replicates, np.random.default_rng(seed)) if groups else np.zeros((0, 0))
    for row, weight in enumerate(weights):
        key = weight.tobytes()
        if key not in value_of_draw:
            value = value_of(weight)
            value_of_draw[key] = np.nan if value is None else value
        values[row] = value_of_draw[key]
    return values


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
        half_width = float(stats.t.ppf((1 + level) / 2, self.df)) * self.error
        return self.estimate - half_width, self.estimate + half_width

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
            "s_seed": {name: None if spread is None else spread.s for name, spread in spreads.items()},
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
        [
            sample(detections, which, protocol=protocol, replicates=replicates, seed=seed, **settings)
            for detections in row
        ]
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
    if len({row.drawn for row in (*a, *b)}) > 1:
        raise ConfigError(
            "expected rows scored on the same frames with the same draws of their sequences, got different ones. Score "
            "both on one set, with equal replicates and seed"
        )
    pairs = [(one.value, other.value) for one, other in zip(a, b, strict=True)]
    differences = [one - other for one, other in pairs if one is not None and other is not None]
    drawn = np.mean([one.draws - other.draws for one, other in zip(a, b, strict=True)], axis=0)
    return Difference(
        by_seed=tuple(differences) if len(differences) == len(pairs) else (),
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
    finite = drawn[np.isfinite(drawn)]
    if len(finite) < max(2, _LEAST_DRAWN * len(drawn)):
        return None
    return float(np.std(finite, ddof=1))


def pooled(differences: Iterable[Difference]) -> Spread | None:
    """Spread over seeds, pooled over pairs of one grid, metric and detector size; None if none has two seeds.

    Args:
        differences: The pairs; those of one seed are passed over.
    """
    own = [spread.own for spread in differences if spread.trained and spread.own is not None]
    df = sum(spread.df for spread in own)
    return Spread(float(np.sqrt(sum(spread.df * spread.s**2 for spread in own) / df)), df) if own else None
