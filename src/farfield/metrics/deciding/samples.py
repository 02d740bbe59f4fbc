"""One number of a run, and the same number under draws of its sequences."""

import hashlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.metrics.bootstrap import Statistics, Weighted, replicate_weights
from farfield.metrics.detections import Detections
from farfield.metrics.frames import frame_order
from farfield.metrics.protocol import PROTOCOLS, Protocol

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
        words = [f"{factor:+g} {name} ({part})" for part, name, factor in self.terms]
        return " ".join(words).removeprefix("+1 ").replace("+1 ", "+ ").replace("-1 ", "- ")

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of the result in which it has a term."""
        return tuple(dict.fromkeys(part for part, _, _ in self.terms))

    def of(self, parts: Mapping[str, Statistics]) -> float | None:
        """Its value among the figures of the parts; None where one of them is None.

        Raises:
            ConfigError: If a part has no such figure.
        """
        total = 0.0
        for part, name, factor in self.terms:
            if name not in parts[part]:
                raise ConfigError(f"figure of {part}: expected one of {', '.join(parts[part])}; got {name!r}")
            value = parts[part][name]
            if value is None:
                return None
            total += factor * value
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
    found: Detections,
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
        found: What a detector found.
        scalar: The number.
        protocol: The protocol or its name.
        replicates: How many draws.
        seed: Seed of the draws: equal seeds draw equally from equal frames.
        **settings: Settings of the protocol.

    Raises:
        ConfigError: If the protocol, a setting, a part or a figure is unknown, or the protocol cannot be resampled.
    """
    return samples(found, {"": scalar}, protocol=protocol, replicates=replicates, seed=seed, **settings)[""]


def samples(
    found: Detections,
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
        found: What a detector found.
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
    counted = found.counted()
    resolved = chosen.settings(counted, **settings)
    weighted = chosen.weighted(counted, resolved)
    keys = sorted(counted.annotations, key=frame_order)
    groups, text = max(weighted.groups, default=-1) + 1, repr([*zip(keys, weighted.groups, strict=True)])
    drawn = hashlib.sha256(f"{text}{replicates} {seed}".encode()).hexdigest()[:16]
    known = (weighted.grouped_by, groups)
    place: Int[np.ndarray, " some"] | None = None
    if frames is not None:
        weighted, place = _of_frames(chosen, counted, resolved, weighted, keys, frames)
    parts = tuple(dict.fromkeys(part for scalar in scalars.values() for part in scalar.parts))
    unknown = [part for part in parts if part not in weighted.parts]
    if unknown:
        raise ConfigError(f"part: expected some of {', '.join(weighted.parts)}; got {', '.join(unknown)}")
    beyond = _beyond_reach(resolved, found.reach_m)
    values = _WeightedScores(weighted, scalars, parts, beyond, place)
    whole, draws = values(np.ones(groups)), _drawn(values, groups, len(scalars), replicates, seed)
    return {
        name: ScoreSample(value=whole[row], draws=draws[row], drawn=drawn, grouped_by=known[0], groups=known[1])
        for row, name in enumerate(scalars)
    }


def _of_frames(
    protocol: Protocol, found: Detections, settings: Any, whole: Weighted, keys: Sequence[Key], frames: Collection[Key]
) -> tuple[Weighted, Int[np.ndarray, " some"]]:
    """The figures of some frames, and of each of their groups which one of the whole it is."""
    kept = [key for key in keys if key in frames]
    some = replace(
        found,
        boxes={key: found.boxes[key] for key in kept},
        annotations={key: found.annotations[key] for key in kept},
    )
    weighted = protocol.weighted(some, settings)
    of_key = dict(zip(keys, whole.groups, strict=True))
    place = np.zeros(max(weighted.groups, default=-1) + 1, dtype=np.int64)
    place[list(weighted.groups)] = [of_key[key] for key in kept]
    return weighted, place


def _drawn(
    values: "_WeightedScores", groups: int, count: int, replicates: int, seed: int
) -> Float[np.ndarray, "count draws"]:
    """Numbers under draws of groups, NaN where they are None; few groups are drawn alike again and again."""
    known: dict[bytes, list[float]] = {}
    found = np.full((count, replicates), np.nan)
    weights = replicate_weights(groups, replicates, np.random.default_rng(seed)) if groups else np.zeros((0, 0))
    for column, weight in enumerate(weights):
        key = weight.tobytes()
        if key not in known:
            known[key] = [np.nan if value is None else value for value in values(weight)]
        found[:, column] = known[key]
    return found


def drawn_values(
    value_of: Callable[[Float[np.ndarray, " groups"]], float | None],
    groups: int,
    *,
    replicates: int = REPLICATES,
    seed: int = 0,
) -> Float[np.ndarray, " replicates"]:
    """A number under draws of groups, NaN where it is None."""
    known: dict[bytes, float] = {}  # few groups are drawn alike again and again
    values = np.full(replicates, np.nan)
    weights = replicate_weights(groups, replicates, np.random.default_rng(seed)) if groups else np.zeros((0, 0))
    for row, weight in enumerate(weights):
        key = weight.tobytes()
        if key not in known:
            value = value_of(weight)
            known[key] = np.nan if value is None else value
        values[row] = known[key]
    return values


class _WeightedScores:
    """Numbers under group weights, each None where it is not known."""

    def __init__(
        self,
        weighted: Weighted,
        scalars: Mapping[str, Scalar],
        parts: Sequence[str],
        beyond: Collection[str],
        place: Int[np.ndarray, " some"] | None,
    ) -> None:
        self.weighted, self.place = weighted, place
        self.scalars = [(scalar, any(part in beyond for part in scalar.parts)) for scalar in scalars.values()]
        self.parts = [part for part in parts if part not in beyond]

    def __call__(self, weight: Float[np.ndarray, " groups"]) -> list[float | None]:
        weight = weight if self.place is None else weight[self.place]
        if not len(weight):
            return [None] * len(self.scalars)
        found = {part: self.weighted.parts[part](weight) for part in self.parts}
        return [None if hidden else scalar.of(found) for scalar, hidden in self.scalars]


def _beyond_reach(settings: Any, reach_m: float | None) -> set[str]:
    """Range bins that begin beyond the detector's reach: they have no figure in a result either."""
    bins_m = getattr(settings, "bins_m", ())
    return {f"{low_m:g}-{high_m:g}" for low_m, high_m in bins_m if reach_m is not None and low_m >= reach_m}
