"""Streams matched to one of them, all stamps at once: nearest in time, one to one, in order, at the least cost."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from inspect import unwrap
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int64

from farfield.errors import ConfigError
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
    own, own_index = cleaned(times_ns[reference])
    names = tuple(name for name in times_ns if name != reference)
    index = np.full((len(own), len(names)), -1, dtype=np.int64)
    residual = np.zeros_like(index)
    costs, tolerances = {}, {}
    for column, name in enumerate(names):
        other, other_index = cleaned(times_ns[name])
        tolerance = default_tolerance_ns(own, other) if tolerance_ns is None else tolerance_ns
        partner = assign(own, other, tolerance)
        rows = np.flatnonzero(partner >= 0)
        index[rows, column] = other_index[partner[rows]]
        residual[rows, column] = other[partner[rows]] - own[rows]
        costs[name], tolerances[name] = cost_ns(own, other, partner, tolerance), tolerance
    return StampMatches(
        reference=reference,
        names=names,
        reference_ns=own,
        reference_index=own_index,
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


# The least costly matching of one stream's stamps to another's, exactly.
#
# Each stamp ``a`` of the reference gets at most one stamp ``b`` within the tolerance, each ``b`` at most one ``a``,
# and pairs do not cross in time. The cost is the sum of ``|a - b|`` over the pairs plus the tolerance for each ``a``
# without a partner. ``|a - b|`` has the Monge property (Hoffman, "On simple linear programming problems", 1963), so
# among all one-to-one matchings the cheapest is found among those that do not cross: a dynamic program over both
# streams, as for the alignment of two sequences. It falls into independent clusters: reference stamps whose windows
# of candidates overlap. In a cluster in which no two claim the same nearest candidate, the nearest ones are the
# optimum, and no program runs.

MAX_CELLS = 1 << 28
"""Candidates of one cluster that the dynamic program takes: a byte each."""
_COMPILED_FROM = 1 << 18  # cells below which compiling costs more than it saves

Stamps = Int64[np.ndarray, " _"]


class CandidateWindows(NamedTuple):
    """Candidates of each reference stamp: ``b[low:high]``, and the first row of each cluster of overlapping windows."""

    low: Stamps
    high: Stamps
    starts: Stamps


def windows(a_ns: Int64[np.ndarray, " n"], b_ns: Int64[np.ndarray, " m"], tolerance_ns: int) -> CandidateWindows:
    """Candidates of each reference stamp within the tolerance, and where clusters begin; both streams increase."""
    low = np.searchsorted(b_ns, a_ns - tolerance_ns, side="left").astype(np.int64)
    high = np.searchsorted(b_ns, a_ns + tolerance_ns, side="right").astype(np.int64)
    fresh = np.ones(len(a_ns), dtype=np.bool_)
    fresh[1:] = low[1:] >= high[:-1]
    return CandidateWindows(low, high, np.flatnonzero(fresh).astype(np.int64))


def assign(a_ns: Int64[np.ndarray, " n"], b_ns: Int64[np.ndarray, " m"], tolerance_ns: int) -> Int64[np.ndarray, " n"]:
    """Index of the partner in ``b_ns`` of each reference stamp, -1 where it has none; the cost is the least possible.

    A stamp exactly between two candidates takes the earlier one.

    Args:
        a_ns: Stamps of the reference, increasing, without duplicates.
        b_ns: Stamps of the other stream, increasing, without duplicates.
        tolerance_ns: Largest distance of a pair, and the cost of a reference stamp without a partner.

    Raises:
        ConfigError: If the tolerance joins so many candidates that one cluster outgrows :data:`MAX_CELLS`.
    """
    return assign_in(a_ns, b_ns, tolerance_ns, windows(a_ns, b_ns, tolerance_ns))


def assign_in(
    a_ns: Int64[np.ndarray, " n"], b_ns: Int64[np.ndarray, " m"], tolerance_ns: int, candidates: CandidateWindows
) -> Int64[np.ndarray, " n"]:
    """As :func:`assign`, with the windows known."""
    if not len(a_ns) or not len(b_ns):
        return np.full(len(a_ns), -1, dtype=np.int64)
    partner = nearest(a_ns, b_ns, candidates)
    claimed = np.zeros(len(a_ns), dtype=np.bool_)
    claimed[1:] = (partner[1:] == partner[:-1]) & (partner[1:] >= 0)
    if not claimed.any():
        return partner
    for first, last in _clusters(claimed, candidates.starts):
        _solve(a_ns, b_ns, candidates, first, last, tolerance_ns, partner)
    return partner


def nearest(
    a_ns: Int64[np.ndarray, " n"], b_ns: Int64[np.ndarray, " m"], candidates: CandidateWindows
) -> Int64[np.ndarray, " n"]:
    """Index of the nearest candidate of each reference stamp, the earlier of two, -1 where there is none.

    Several may claim the same one: this is a lower bound of the cost, and no matching.
    """
    after = np.searchsorted(b_ns, a_ns, side="left")
    right, left = np.minimum(after, len(b_ns) - 1), np.maximum(after - 1, 0)
    chosen = np.where(np.abs(a_ns - b_ns[left]) <= np.abs(b_ns[right] - a_ns), left, right)
    return np.where(candidates.high > candidates.low, chosen, -1).astype(np.int64)


def cost_ns(
    a_ns: Int64[np.ndarray, " n"],
    b_ns: Int64[np.ndarray, " m"],
    partner: Int64[np.ndarray, " n"],
    tolerance_ns: int,
) -> int:
    """Cost of a matching: distances of the pairs, and the tolerance for each reference stamp without a partner."""
    paired = partner >= 0
    return int(np.abs(a_ns[paired] - b_ns[partner[paired]]).sum()) + tolerance_ns * int((~paired).sum())


def _clusters(claimed: Bool[np.ndarray, " n"], starts: Stamps) -> list[tuple[int, int]]:
    """First and last-but-one row of each cluster in which a candidate is claimed twice."""
    ends = np.append(starts[1:], len(claimed))
    which = np.unique(np.searchsorted(starts, np.flatnonzero(claimed), side="right") - 1)
    return list(zip(starts[which].tolist(), ends[which].tolist(), strict=True))


def _solve(
    a_ns: Stamps, b_ns: Stamps, candidates: CandidateWindows, first: int, last: int, tolerance_ns: int, partner: Stamps
) -> None:
    """Write the best partners of one cluster's rows into ``partner``."""
    low, high = candidates.low[first:last], candidates.high[first:last]
    begin, end = int(low[0]), int(high[-1])
    offsets = np.concatenate([[0], np.cumsum(high - low + 1)]).astype(np.int64)
    if (cells := int(offsets[-1])) > MAX_CELLS:
        raise ConfigError(
            f"tolerance of {tolerance_ns / 1e6:g} ms: expected one that leaves at most {MAX_CELLS} candidates in a "
            f"cluster, got {cells}. Take a smaller tolerance, such as half the faster stream's period."
        )
    numbers: list[Int[np.ndarray, " _"]] = [a_ns[first:last], b_ns[begin:end], low - begin, high - begin, offsets]
    if cells >= _COMPILED_FROM and find_spec("numba") is not None:
        rows = np.empty(last - first, dtype=np.int64)
        _compiled()(*numbers, tolerance_ns, np.empty(cells, dtype=np.uint8), rows)
    else:  # on lists: several times as fast as on arrays where nothing is compiled
        listed = [0] * (last - first)
        a, b, lows, highs, begins = (part.tolist() for part in numbers)
        align(a, b, lows, highs, begins, tolerance_ns, bytearray(cells), listed)
        rows = np.array(listed, dtype=np.int64)
    partner[first:last] = np.where(rows >= 0, rows + begin, -1)


def align(
    a: Sequence[int],
    b: Sequence[int],
    low: Sequence[int],
    high: Sequence[int],
    offsets: Sequence[int],
    tolerance: int,
    choice: Any,
    out: Any,
) -> None:
    """The dynamic program of one cluster, for lists or, compiled, for arrays.

    ``D[i, j]``, the least cost of the first ``i`` references with the first ``j`` candidates, is the least of
    ``D[i - 1, j] + tolerance``, ``D[i, j - 1]`` and ``D[i - 1, j - 1] + |a_i - b_j|``; only ``j`` from ``low`` to
    ``high`` of a row is kept. At equal cost a pair is kept, and an earlier candidate before a later one.

    Args:
        a: References of the cluster.
        b: Candidates of the cluster.
        low: First candidate of each reference.
        high: One behind its last candidate.
        offsets: Where a row's choices begin.
        tolerance: Cost of a reference without a partner.
        choice: Room for a byte a cell: 0 leaves the candidate, 1 the reference, 2 pairs them.
        out: Partner of each reference, written here.
    """
    width = len(b) + 1
    before = [0] * width
    last = width - 1  # the costs of the row above are constant from here on
    for i in range(len(a)):
        start, stop, base = low[i], high[i], offsets[i]
        edge = before[last]
        diagonal = before[start] if start < last else edge
        best = diagonal + tolerance
        choice[base] = 1
        before[start] = best
        for j in range(start + 1, stop + 1):
            above = before[j] if j < last else edge
            distance = a[i] - b[j - 1]
            paired = diagonal + (distance if distance >= 0 else -distance)
            code = 0
            if paired < best:
                best, code = paired, 2
            if above + tolerance < best:
                best, code = above + tolerance, 1
            choice[base + j - start] = code
            before[j] = best
            diagonal = above
        last = stop
    i, j = len(a) - 1, high[len(a) - 1]
    while i >= 0:
        j = min(j, high[i])
        code = choice[offsets[i] + j - low[i]]
        if code == 0:
            j -= 1
            continue
        out[i] = j - 1 if code == 2 else -1
        j -= 1 if code == 2 else 0
        i -= 1


@cache
def _compiled() -> Any:
    from numba import njit

    return njit(unwrap(align))
