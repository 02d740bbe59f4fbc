"""Streams matched to one of them, all stamps at once: nearest in time, one to one, in order, at the least cost."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from farfield.errors import ConfigError
from farfield.sync.assignment import assign, cost_ns
from farfield.sync.stamps import cleaned


@dataclass(frozen=True, eq=False, kw_only=True)
class StampMatches:
    """What belongs together: a row a message of the reference, in the order of time.

    Args:
        reference: The stream to which the others are matched.
        names: The others.
        reference_ns: Stamps of the reference, increasing, shape (n,).
        reference_index: Where each stood in what was given, shape (n,).
        index: Where the partner stands in its stream, -1 where there is none, shape (n, others).
        residual_ns: Partner's stamp minus the reference's; 0 where there is none, shape (n, others).
        cost_ns: Least sum of distances, the tolerance for each without a partner, of each other stream.
        tolerance_ns: Largest distance, of each other stream.
    """

    reference: str
    names: tuple[str, ...]
    reference_ns: Int64[np.ndarray, " n"]
    reference_index: Int64[np.ndarray, " n"]
    index: Int64[np.ndarray, "n others"]
    residual_ns: Int64[np.ndarray, "n others"]
    cost_ns: Mapping[str, int]
    tolerance_ns: Mapping[str, int]

    def __len__(self) -> int:
        return len(self.reference_ns)


def match_times(
    times_ns: Mapping[str, Int64[np.ndarray, " _"]], *, reference: str, tolerance_ns: int | None = None
) -> StampMatches:
    """Match streams to one of them.

    Each other stream is matched on its own; a message is used once, pairs do not cross, and the sum of the distances
    plus the tolerance for each reference message without a partner is the least possible (:mod:`assignment`). Of equal
    stamps in one stream the first is used; stamps out of order are taken in order.

    Args:
        times_ns: Stamps of each stream, int64 nanoseconds.
        reference: The stream to which the others are matched.
        tolerance_ns: Largest distance; None takes half the median period of the faster stream of each pair.

    Raises:
        ConfigError: If there is no such stream, or the tolerance is negative.
    """
    check(times_ns, reference, tolerance_ns)
    own, places = cleaned(times_ns[reference])
    names = tuple(name for name in times_ns if name != reference)
    index = np.full((len(own), len(names)), -1, dtype=np.int64)
    residual = np.zeros_like(index)
    costs, tolerances = {}, {}
    for column, name in enumerate(names):
        other, stood = cleaned(times_ns[name])
        tolerance = default_tolerance_ns(own, other) if tolerance_ns is None else tolerance_ns
        partner = assign(own, other, tolerance)
        rows = np.flatnonzero(partner >= 0)
        index[rows, column] = stood[partner[rows]]
        residual[rows, column] = other[partner[rows]] - own[rows]
        costs[name], tolerances[name] = cost_ns(own, other, partner, tolerance), tolerance
    return StampMatches(
        reference=reference,
        names=names,
        reference_ns=own,
        reference_index=places,
        index=index,
        residual_ns=residual,
        cost_ns=costs,
        tolerance_ns=tolerances,
    )


def check(names: Mapping[str, object], reference: str, tolerance_ns: int | None) -> None:
    """Refuse a reference that is none of the streams, and a tolerance below 0.

    Raises:
        ConfigError: In these cases.
    """
    if reference not in names:
        raise ConfigError(f"reference: expected a stream, one of {', '.join(names)}; got {reference!r}")
    if tolerance_ns is not None and tolerance_ns < 0:
        raise ConfigError(f"tolerance: expected 0 or more, got {tolerance_ns / 1e6:g} ms")


def default_tolerance_ns(a_ns: Int64[np.ndarray, " n"], b_ns: Int64[np.ndarray, " m"]) -> int:
    """Half the shorter median period of two streams, rounded up: farther away another message of one is nearer."""
    periods = [float(np.median(np.diff(times))) for times in (a_ns, b_ns) if len(times) > 1]
    return int(np.ceil(min(periods) / 2)) if periods else 0
