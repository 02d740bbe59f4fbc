"""A recording's streams matched to one of them: the table, and what it says of clocks, gaps and losses."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import ConfigError
from farfield.files.ascii_table import ROWS_AT_ONCE, Text, integers, join
from farfield.files.atomic import open_atomic, read_bytes
from farfield.sync.clocks import MAX_PAIRS, ClockModel, ExchangeClock, fit_clock
from farfield.sync.sources import RecordedStreams
from farfield.sync.stamps import StreamCounter, StreamStats, apart, wrapped_note
from farfield.sync.streaming import MatchBlock, match_blocks
from farfield.vocabulary.counts import count_of

SPEED_M_S = 30.0
"""Residuals are also given as the way at this speed: that of a car that comes towards us."""
FEWEST_PAIRS = 20
WHOLE_RATIO = 0.02
"""Rates whose ratio is farther from a whole number, in periods of the faster stream, have no common trigger."""


@dataclass(frozen=True, eq=False, kw_only=True)
class StreamPair:
    """One stream against the reference.

    Args:
        tolerance_ns: Largest distance.
        matched: References with a partner.
        lost: References without one, of those within the time that both streams cover.
        outside: References before or after all of the stream's stamps.
        unused: Stamps of the stream that no reference took.
        worst_ns: Largest distance of a pair.
        times_ns: Stamps of the reference, of the pairs or of evenly chosen ones, shape (k,).
        residual_ns: Partner's stamp minus the reference's of these, shape (k,).
        clock: Offset and drift; None where stamps do not tell.
        untold: Why there is no clock, or what it leaves open.
    """

    tolerance_ns: int
    matched: int
    lost: int
    outside: int
    unused: int
    worst_ns: int
    times_ns: Int64[np.ndarray, " k"]
    residual_ns: Int64[np.ndarray, " k"]
    clock: ClockModel | None
    untold: str

    @property
    def usual(self) -> str:
        """The median of the residuals in words, ``4.000 ms later`` or ``7.000 ms earlier``; empty without pairs."""
        if not len(self.residual_ns):
            return ""
        middle = float(np.median(self.residual_ns)) / 1e6
        return f"{abs(middle):.3f} ms {'earlier' if middle < 0 else 'later'}"

    def to_json(self) -> dict[str, Any]:
        """All but the single residuals, with their quantiles in milliseconds and the way at :data:`SPEED_M_S`."""
        size = np.abs(self.residual_ns) / 1e6
        named = {"median_ms": 0.5, "p95_ms": 0.95}
        quantiles = {name: float(np.quantile(size, q)) if len(size) else None for name, q in named.items()}
        return {
            "tolerance_ms": self.tolerance_ns / 1e6,
            "matched": self.matched,
            "lost": self.lost,
            "outside": self.outside,
            "unused": self.unused,
            "residual": {
                **quantiles,
                "mean_ms": float(np.mean(self.residual_ns)) / 1e6 if len(size) else None,
                "worst_ms": self.worst_ns / 1e6 if len(size) else None,
                "worst_m_at_30_m_s": self.worst_ns / 1e9 * SPEED_M_S if len(size) else None,
            },
            "clock": None if self.clock is None else self.clock.to_json(),
            "untold": self.untold,
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class SyncResult:
    """What was found in one recording.

    Args:
        name: The recording's.
        reference: The stream to which the others were matched.
        streams: Each stream by itself.
        pairs: Each other stream against the reference.
        exchanges: What logs of two-way exchanges say, by file.
        arrivals: The computer's clock against each stream's, from stamps and times of recording of the same messages.
        findings: What is out of step, in words.
    """

    name: str
    reference: str
    streams: Mapping[str, StreamStats]
    pairs: Mapping[str, StreamPair]
    exchanges: Mapping[str, ExchangeClock]
    arrivals: Mapping[str, ClockModel]
    findings: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """All of it."""
        return {
            "name": self.name,
            "reference": self.reference,
            "streams": {name: health.to_json() for name, health in self.streams.items()},
            "pairs": {name: pair.to_json() for name, pair in self.pairs.items()},
            "exchanges": {name: exchange.to_json() for name, exchange in self.exchanges.items()},
            "arrivals": {name: clock.to_json() for name, clock in self.arrivals.items()},
            "findings": list(self.findings),
        }


@dataclass
class _PairAccumulator:
    """Pairs of one stream, as they come."""

    every: int
    matched: int = 0
    outside: int = 0
    worst: int = 0
    times: list[np.ndarray] | None = None
    residuals: list[np.ndarray] | None = None

    def add(self, rows: MatchBlock, column: int, health: StreamStats) -> None:
        paired = np.flatnonzero(rows.index[:, column] >= 0)
        residual = rows.residual_ns[paired, column]
        self.matched += len(paired)
        self.worst = max(self.worst, int(np.abs(residual).max(initial=0)))
        first, last = health.first_ns, health.last_ns
        beyond = (rows.reference_ns < (first or 0)) | (rows.reference_ns > (last or 0))
        self.outside += int((beyond & (rows.index[:, column] < 0)).sum()) if first is not None else len(beyond)
        sampled = paired[rows.reference_index[paired] % self.every == 0]
        self.times = [*(self.times or []), rows.reference_ns[sampled]]
        self.residuals = [*(self.residuals or []), rows.residual_ns[sampled, column]]


def describe(recording: RecordedStreams) -> dict[str, StreamStats]:
    """Each stream of a recording by its own stamps; reads all of them once."""
    streams = {}
    for name, source in recording.streams.items():
        counting = StreamCounter()
        for block in source.blocks():
            counting.add(block)
        streams[name] = counting.result()
    return streams


def best_reference(streams: Mapping[str, StreamStats]) -> str:
    """The slowest stream with three stamps or more that shares time with most others: each of its messages finds one.

    Raises:
        ConfigError: If there is none.
    """
    usable = [name for name, health in streams.items() if health.period_ns and health.count > 2]
    if not usable:
        raise ConfigError(f"expected a stream of three stamps or more, got {', '.join(streams) or 'no stream'}")
    shared = {name: len(streams) - len(apart(streams, name, 0)) for name in usable}
    return max(usable, key=lambda name: (shared[name], streams[name].period_ns or 0))


def reference_of(name: str, streams: Mapping[str, StreamStats], to: str | None) -> str:
    """The stream to which the others of a recording are matched.

    Args:
        name: Of the recording.
        streams: Its streams.
        to: The one that was asked for; None takes :func:`best_reference`.

    Raises:
        ConfigError: If there is no such stream, or only one.
    """
    reference = best_reference(streams) if to is None else to
    if reference not in streams or len(streams) < 2:
        names = ", ".join(streams)
        raise ConfigError(f"{name}: expected a stream to match to and one more, of {names}; got {reference!r}")
    return reference


def synchronise(
    recording: RecordedStreams,
    *,
    to: str | None = None,
    tolerance_ns: int | None = None,
    exchanges: Mapping[str, ExchangeClock] | None = None,
    row: Callable[[Sequence[str], MatchBlock], None] | None = None,
) -> SyncResult:
    """Match a recording's streams to one of them.

    Args:
        recording: The streams; each is read twice, block by block.
        to: The stream to which the others are matched; None takes :func:`best_reference`.
        tolerance_ns: Largest distance; None takes half the period of the faster stream of each pair.
        exchanges: What logs of two-way exchanges say.
        row: Called with the names of the other streams and rows of the table, in order.

    Raises:
        ConfigError: If there is no such stream, or only one.
    """
    streams = describe(recording)
    reference = reference_of(recording.name, streams, to)
    others = [name for name in streams if name != reference]
    tolerances = {name: _tolerance(streams[reference], streams[name], tolerance_ns) for name in others}
    every = -(-streams[reference].count // MAX_PAIRS)
    gathered = {name: _PairAccumulator(every) for name in others}
    ordered = {name: recording.streams[name].blocks() for name in streams}
    leaders = _leaders(recording, streams, reference)
    followers = {name: np.concatenate(list(recording.streams[name].blocks())) for name in leaders}
    for rows in match_blocks(ordered, reference=reference, tolerance_ns=tolerances):
        _follow(rows, others, reference, leaders, followers)
        for column, name in enumerate(others):
            gathered[name].add(rows, column, streams[name])
        if row is not None:
            row(others, rows)
    pairs = {
        name: _pair(gathered[name], streams[reference], streams[name], tolerances[name], leaders.get(name, ""))
        for name in others
    }
    findings = _findings(recording, streams, reference, pairs, tolerances)
    return SyncResult(
        name=recording.name,
        reference=reference,
        streams=streams,
        pairs=pairs,
        exchanges=dict(exchanges or {}),
        arrivals=_arrivals(recording),
        findings=tuple(findings),
    )


def _leaders(recording: RecordedStreams, streams: Mapping[str, StreamStats], reference: str) -> dict[str, str]:
    """Streams whose messages are those of another one, row by row, and that other: the reference or a main stream."""
    leaders = {}
    for name, source in recording.streams.items():
        of_sensor = [other for other in streams if source.sensor and recording.streams[other].sensor == source.sensor]
        main = source.sensor if source.sensor in of_sensor else next(iter(of_sensor), name)
        leader = reference if reference in of_sensor else main
        if leader != name and streams[leader].count == streams[name].count:
            leaders[name] = leader
    return {name: leader for name, leader in leaders.items() if name != reference}


def _follow(
    rows: MatchBlock,
    others: Sequence[str],
    reference: str,
    leaders: Mapping[str, str],
    followers: Mapping[str, Int64[np.ndarray, " _"]],
) -> None:
    """Give streams that follow another the partner's row of that one; writes into the rows."""
    for name, leader in leaders.items():
        column = others.index(name)
        index = rows.reference_index if leader == reference else rows.index[:, others.index(leader)]
        later_ns = followers[name][np.maximum(index, 0)] - rows.reference_ns
        rows.index[:, column] = index
        rows.residual_ns[:, column] = np.where(index >= 0, later_ns, 0)


def _tolerance(own: StreamStats, other: StreamStats, tolerance_ns: int | None) -> int:
    if tolerance_ns is not None:
        return tolerance_ns
    periods = [health.period_ns for health in (own, other) if health.period_ns]
    return -(-min(periods) // 2) if periods else 0


def _pair(
    gathered: _PairAccumulator, own: StreamStats, other: StreamStats, tolerance_ns: int, leader: str
) -> StreamPair:
    none = np.zeros(0, dtype=np.int64)
    times = np.concatenate([none, *(gathered.times or [])])
    residual = np.concatenate([none, *(gathered.residuals or [])])
    if leader:
        clock, untold = None, f"stamps of one sensor's messages, matched row by row as {leader}: one clock, no drift"
    elif len(residual) and not residual.any():
        clock, untold = None, "the same stamps as the reference's: one clock, no drift"
    else:
        clock, untold = _clock(times, residual, own, other)
    rows = own.count - own.duplicates - own.backwards
    return StreamPair(
        tolerance_ns=tolerance_ns,
        matched=gathered.matched,
        lost=max(rows - gathered.matched - gathered.outside, 0),
        outside=gathered.outside,
        unused=other.count - gathered.matched,
        worst_ns=gathered.worst,
        times_ns=times,
        residual_ns=residual,
        clock=clock,
        untold=untold,
    )


def _clock(
    times: Int64[np.ndarray, " k"], residual: Int64[np.ndarray, " k"], own: StreamStats, other: StreamStats
) -> tuple[ClockModel | None, str]:
    """Offset and drift of a stream where its rate and the reference's have a whole ratio, and what is left open."""
    if len(times) < FEWEST_PAIRS or not own.tick_ns or not other.tick_ns:
        return None, f"{count_of(len(times), 'pair')}: too few for an offset and a drift"
    fast, slow = sorted((own.tick_ns, other.tick_ns))
    away = abs(slow / fast - round(slow / fast))
    if away > WHOLE_RATIO:
        return None, (
            f"rates of {1e9 / own.tick_ns:.3f} and {1e9 / other.tick_ns:.3f} Hz have no whole ratio: the "
            "streams run freely, and stamps alone show no offset between their clocks"
        )
    clock = fit_clock(times, times + residual, modulo_ns=round(fast))
    return clock, (
        f"the offset includes {clock.offset_includes} and is known up to multiples of {fast / 1e6:.3f} ms; stamps "
        "alone tell neither apart (a two-way exchange, or a moment that both sensors see, does)"
    )


def _arrivals(recording: RecordedStreams) -> dict[str, ClockModel]:
    """One-way: what the offset includes of the delay stays unknown."""
    clocks = {}
    for name, source in recording.streams.items():
        if source.arrived_ns is not None and len(source.arrived_ns) >= FEWEST_PAIRS:
            times = np.concatenate(list(source.blocks()))
            rising = np.append(True, np.diff(times) > 0)
            if rising.sum() >= FEWEST_PAIRS:
                clocks[name] = fit_clock(times[rising], source.arrived_ns[rising])
    return clocks


def _findings(
    recording: RecordedStreams,
    streams: Mapping[str, StreamStats],
    reference: str,
    pairs: Mapping[str, StreamPair],
    tolerances: Mapping[str, int],
) -> list[str]:
    """What a user must know of a recording, worst first."""
    alone = apart(streams, reference, max(tolerances.values(), default=0))
    findings = list(alone.values())
    for name, pair in pairs.items():
        possible = min(pair.matched + pair.lost, streams[name].count)
        if name not in alone and pair.matched < 0.9 * possible:
            findings.append(
                f"{name}: {count_of(pair.matched, 'pair')} with {reference}, where {possible} would be possible"
            )
    for name, source in recording.streams.items():
        main = source.sensor
        if main and main != name and main in streams and streams[main].count != streams[name].count:
            findings.append(
                f"{name}: {streams[name].count} and {count_of(streams[main].count, 'stamp')} "
                f"of the same messages of {main}; rows "
                "are missing, so they are matched by time"
            )
    for name, health in streams.items():
        if health.duplicates:
            findings.append(f"{name}: {count_of(health.duplicates, 'stamp stands', 'stamps stand')} there twice")
        if health.backwards:
            wrapped = wrapped_note(health.set_back_ns, health.period_ns)
            findings.append(
                f"{name}: {count_of(health.backwards, 'stamp runs', 'stamps run')} backwards"
                f"{f', {wrapped},' if wrapped else ''} and {'is' if health.backwards == 1 else 'are'} left out until "
                "it is later again"
            )
        if health.gaps and health.longest_gap_ns is not None and health.period_ns:
            longest = health.longest_gap_ns / 1e9
            findings.append(
                f"{name}: {count_of(health.gaps, 'gap')}, about "
                f"{count_of(health.lost, 'message')} lost, longest {longest:.3f} s"
            )
        if recording.streams[name].note:
            findings.append(f"{name}: {recording.streams[name].note}")
    return findings


def over_time(
    times_ns: Int64[np.ndarray, " n"], values: Float[np.ndarray, " n"], stretches: int = 200
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """Middle of each stretch of a recording in seconds from the start, and the 10, 50 and 90 % quantiles in it."""
    parts = np.array_split(np.arange(len(times_ns)), min(stretches, max(len(times_ns) // 5, 1)))
    quantiles = partial(np.quantile, q=[0.1, 0.5, 0.9])
    middle = np.array([float(times_ns[part].mean() - times_ns[0]) / 1e9 for part in parts])
    return middle, np.array([quantiles(values[part]) for part in parts]).reshape(-1, 3)


# The table of matches as CSV, a row a message of the reference, written as the rows come.


class MatchTable:
    """Rows of matches as text: of each stream the message and, in nanoseconds, how much later it is.

    Args:
        handle: Where they go.
        reference: Name of the stream to which the others are matched.
        labels: Names of a stream's messages, where they are not counted from 0.
    """

    def __init__(self, handle: BinaryIO, reference: str, labels: Mapping[str, Sequence[str]]) -> None:
        self.handle, self.reference, self.begun = handle, reference, False
        self.labels = {name: _texts(names) for name, names in labels.items()}

    def add(self, others: Sequence[str], rows: MatchBlock) -> None:
        """Write some rows; the header comes before the first."""
        if not self.begun:
            heads = [f"{self.reference}_frame", f"{self.reference}_ns"]
            heads += [f"{name}_{what}" for name in others for what in ("frame", "later_ns")]
            self.handle.write(
                (",".join(head.replace(",", "_") for head in heads) + "\n").encode(errors="backslashreplace")
            )
            self.begun = True
        for begin in range(0, len(rows.reference_ns), ROWS_AT_ONCE):
            part = slice(begin, begin + ROWS_AT_ONCE)
            columns = [self._named(self.reference, rows.reference_index[part]), integers(rows.reference_ns[part])]
            for column, name in enumerate(others):
                index = rows.index[part, column]
                later = integers(rows.residual_ns[part, column])
                later[index < 0] = 0
                columns += [self._named(name, index), later]
            self.handle.write(join(columns, ","))

    def _named(self, stream: str, index: Int64[np.ndarray, " n"]) -> Text:
        """The messages' names; nothing where there is none."""
        names = self.labels.get(stream)
        text = integers(np.maximum(index, 0)) if names is None else names[np.maximum(index, 0)]
        text[index < 0] = 0
        return text


def _texts(names: Sequence[str]) -> Text:
    """Words as rows of codes; commas and line ends, which a table has no room for, become low lines."""
    plain = [
        name.translate({ord(","): "_", ord("\n"): "_", ord("\r"): "_"}).encode(errors="backslashreplace")
        for name in names
    ]
    lines = np.array(plain or [b"0"], dtype=np.bytes_)
    return lines.view(np.uint8).reshape(len(lines), -1)


@contextmanager
def match_table(path: Path, reference: str, labels: Mapping[str, Sequence[str]]) -> Iterator[MatchTable]:
    """A table that appears under its name when the block ends without an error."""
    with open_atomic(path) as handle:
        yield MatchTable(handle, reference, labels)


def read_match_table(path: Path | str) -> dict[str, list[str]]:
    """The columns of a table of matches, as text; a cell without a partner is empty."""
    rows = [line.split(",") for line in read_bytes(path).decode("utf-8").splitlines()]
    return dict(zip(rows[0], map(list, zip(*rows[1:], strict=True)), strict=True)) if len(rows) > 1 else {}
