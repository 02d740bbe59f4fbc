"""The same matching for streams that are read in blocks: memory holds a few blocks, however long the recording.

A block's references are matched as far as their clusters are known to be whole; the rest waits for the next block. The
result is that of :func:`farfield.sync.match_times`, bit for bit, unless a cluster outgrows :data:`LONGEST`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int64

from farfield.errors import ConfigError
from farfield.sync.assignment import CandidateWindows, assign_in, windows
from farfield.sync.matching import check

LONGEST = 1 << 20
"""References of one cluster after which it is cut, to bound the memory."""

Stamps = Int64[np.ndarray, " _"]
Column = tuple["StampStream", Stamps, CandidateWindows]


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchBlock:
    """Some rows of the table of matches, in the order of time.

    Args:
        reference_ns: Stamps of the reference, shape (n,).
        reference_index: Their places in their stream, shape (n,).
        index: Places of the partners in their streams, -1 where there is none, shape (n, others).
        residual_ns: Partner's stamp minus the reference's; 0 where there is none, shape (n, others).
    """

    reference_ns: Int64[np.ndarray, " n"]
    reference_index: Int64[np.ndarray, " n"]
    index: Int64[np.ndarray, "n others"]
    residual_ns: Int64[np.ndarray, "n others"]


@dataclass
class StampStream:
    """One stream, read as far as it is needed.

    Args:
        name: Its name.
        blocks: Its stamps, block by block.
        seen: Called with each block before anything is left out.

    Attributes:
        times_ns: Stamps read and not yet done with.
        first: Place of the first of them in the stream.
        ended: Whether there are no more.
        left_out: Stamps left out as duplicates or because they run backwards.
    """

    name: str
    blocks: Iterator[Stamps]
    seen: Callable[[str, Stamps], None] | None = None
    times_ns: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    places: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    read: int = 0
    ended: bool = False
    left_out: int = 0
    _latest: int | None = None

    def until(self, time_ns: int) -> None:
        """Read until a stamp later than ``time_ns`` is known, or the end."""
        while not self.ended and (self._latest is None or self._latest <= time_ns):
            self.more()

    def more(self) -> None:
        """Read a block; what does not lie behind all that came before is left out and counted."""
        block = next(self.blocks, None)
        if block is None:
            self.ended = True
            return
        if self.seen is not None:
            self.seen(self.name, block)
        places = np.arange(self.read, self.read + len(block), dtype=np.int64)
        self.read += len(block)
        if not len(block):
            return
        before = np.iinfo(np.int64).min if self._latest is None else self._latest
        highest = np.maximum.accumulate(np.concatenate([[before], block[:-1]]))
        rising = block > highest if self._latest is not None else np.append(True, block[1:] > highest[1:])
        self.left_out += int((~rising).sum())
        self.times_ns = np.concatenate([self.times_ns, block[rising]])
        self.places = np.concatenate([self.places, places[rising]])
        self._latest = int(max(before, block.max()))

    def drop(self, count: int) -> None:
        """Forget the first ``count`` stamps."""
        self.times_ns, self.places = self.times_ns[count:].copy(), self.places[count:].copy()


def match_blocks(
    streams: Mapping[str, Iterable[Int64[np.ndarray, " _"]]],
    *,
    reference: str,
    tolerance_ns: int | Mapping[str, int],
    seen: Callable[[str, Int64[np.ndarray, " _"]], None] | None = None,
) -> Iterator[MatchBlock]:
    """Match streams that come in blocks to one of them.

    Stamps that do not rise are left out, unlike in :func:`match_times`, which has all of them at hand.

    Args:
        streams: Blocks of int64 nanoseconds of each stream.
        reference: The stream to which the others are matched.
        tolerance_ns: Largest distance, for all or of each other stream.
        seen: Called with the name and each block as it is read.

    Yields:
        Rows of the table.

    Raises:
        ConfigError: If there is no such stream, or a tolerance is negative or missing.
    """
    check(streams, reference, None)
    opened = {name: StampStream(name, iter(blocks), seen) for name, blocks in streams.items()}
    names = [name for name in streams if name != reference]
    given = tolerance_ns if isinstance(tolerance_ns, Mapping) else dict.fromkeys(names, tolerance_ns)
    if missing := [name for name in names if given.get(name, -1) < 0]:
        raise ConfigError(f"tolerance: expected 0 or more for each stream, none for {', '.join(missing)}")
    own = opened.pop(reference)
    while True:
        own.more()
        rows, columns = _ready(own, [opened[name] for name in names], [given[name] for name in names])
        if rows:
            yield _taken(own, rows, columns)
        if own.ended and not len(own.times_ns):
            break
    for stream in opened.values():
        stream.until(np.iinfo(np.int64).max)
        stream.drop(len(stream.times_ns))


def _ready(own: StampStream, others: list[StampStream], tolerances: list[int]) -> tuple[int, list[Column]]:
    """How many references are decided, and the partners of all that are read; nothing is solved before some are."""
    count = len(own.times_ns)
    if not count:
        return 0, []
    whole = np.append(np.arange(count), count) if own.ended else np.arange(count)
    found = []
    for stream, tolerance in zip(others, tolerances, strict=True):
        stream.until(int(own.times_ns[-1]) + tolerance)
        found.append(windows(own.times_ns, stream.times_ns, tolerance))
        whole = np.intersect1d(whole, np.append(found[-1].starts, count), assume_unique=True)
    rows = count // 2 if not whole[-1] and count > LONGEST else int(whole[-1])
    if not rows:
        return 0, []
    solved = zip(others, tolerances, found, strict=True)
    return rows, [(s, assign_in(own.times_ns, s.times_ns, t, w), w) for s, t, w in solved]


def _taken(own: StampStream, rows: int, columns: list[Column]) -> MatchBlock:
    """The first rows as a table; what they used up is dropped."""
    index = np.full((rows, len(columns)), -1, dtype=np.int64)
    residual = np.zeros_like(index)
    for column, (stream, partner, found) in enumerate(columns):
        paired = np.flatnonzero(partner[:rows] >= 0)
        chosen = partner[paired]
        index[paired, column] = stream.places[chosen]
        residual[paired, column] = stream.times_ns[chosen] - own.times_ns[paired]
        used = int(chosen[-1]) + 1 if len(chosen) else 0
        stream.drop(max(used, int(found.low[rows])) if rows < len(partner) else len(stream.times_ns))
    matched = MatchBlock(
        reference_ns=own.times_ns[:rows].copy(),
        reference_index=own.places[:rows].copy(),
        index=index,
        residual_ns=residual,
    )
    own.drop(rows)
    return matched
