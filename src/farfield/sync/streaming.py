"""Matching while messages arrive: bounded memory, an allowed lateness, streams that fall silent.

The watermark is the earliest of the live streams' latest stamps, less the lateness: nothing earlier is expected any
more. A reference is decided when the clusters that it belongs to (see :mod:`farfield.sync.matching`) lie whole
before the watermark. Where no message is later than the allowed lateness and no cluster is cut, the result is that of
:func:`farfield.sync.match_times`.
"""

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int64

from farfield.errors import ConfigError
from farfield.sync.matching import CandidateWindows, assign_in, check, windows

# The same matching for streams that are read in blocks: memory holds a few blocks, however long the recording.
#
# A block's references are matched as far as their clusters are known to be whole; the rest waits for the next block.
# The result is that of :func:`farfield.sync.match_times`, bit for bit, unless a cluster outgrows :data:`LONGEST`.

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
        on_block: Called with each block before anything is left out.

    Attributes:
        times_ns: Stamps read and not yet done with.
        first: Place of the first of them in the stream.
        ended: Whether there are no more.
        left_out: Stamps left out as duplicates or because they run backwards.
    """

    name: str
    blocks: Iterator[Stamps]
    on_block: Callable[[str, Stamps], None] | None = None
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
        if self.on_block is not None:
            self.on_block(self.name, block)
        index = np.arange(self.read, self.read + len(block), dtype=np.int64)
        self.read += len(block)
        if not len(block):
            return
        before = np.iinfo(np.int64).min if self._latest is None else self._latest
        highest = np.maximum.accumulate(np.concatenate([[before], block[:-1]]))
        rising = block > highest if self._latest is not None else np.append(True, block[1:] > highest[1:])
        self.left_out += int((~rising).sum())
        self.times_ns = np.concatenate([self.times_ns, block[rising]])
        self.places = np.concatenate([self.places, index[rising]])
        self._latest = int(max(before, block.max()))

    def drop(self, count: int) -> None:
        """Forget the first ``count`` stamps."""
        self.times_ns, self.places = self.times_ns[count:].copy(), self.places[count:].copy()


def match_blocks(
    streams: Mapping[str, Iterable[Int64[np.ndarray, " _"]]],
    *,
    reference: str,
    tolerance_ns: int | Mapping[str, int],
    on_block: Callable[[str, Int64[np.ndarray, " _"]], None] | None = None,
) -> Iterator[MatchBlock]:
    """Match streams that come in blocks to one of them.

    Stamps that do not rise are left out, unlike in :func:`match_times`, which has all of them at hand.

    Args:
        streams: Blocks of int64 nanoseconds of each stream.
        reference: The stream to which the others are matched.
        tolerance_ns: Largest distance, for all or of each other stream.
        on_block: Called with the name and each block as it is read.

    Yields:
        Rows of the table.

    Raises:
        ConfigError: If there is no such stream, or a tolerance is negative or missing.
    """
    check(streams, reference, None)
    opened = {name: StampStream(name, iter(blocks), on_block) for name, blocks in streams.items()}
    names = [name for name in streams if name != reference]
    tolerances_ns = tolerance_ns if isinstance(tolerance_ns, Mapping) else dict.fromkeys(names, tolerance_ns)
    if missing := [name for name in names if tolerances_ns.get(name, -1) < 0]:
        raise ConfigError(f"tolerance: expected 0 or more for each stream, none for {', '.join(missing)}")
    own = opened.pop(reference)
    while True:
        own.more()
        rows, columns = _ready(own, [opened[name] for name in names], [tolerances_ns[name] for name in names])
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
    boundaries = np.append(np.arange(count), count) if own.ended else np.arange(count)
    candidates = []
    for stream, tolerance in zip(others, tolerances, strict=True):
        stream.until(int(own.times_ns[-1]) + tolerance)
        candidates.append(windows(own.times_ns, stream.times_ns, tolerance))
        boundaries = np.intersect1d(boundaries, np.append(candidates[-1].starts, count), assume_unique=True)
    rows = count // 2 if not boundaries[-1] and count > LONGEST else int(boundaries[-1])
    if not rows:
        return 0, []
    solved = zip(others, tolerances, candidates, strict=True)
    return rows, [(s, assign_in(own.times_ns, s.times_ns, t, w), w) for s, t, w in solved]


def _taken(own: StampStream, rows: int, columns: list[Column]) -> MatchBlock:
    """The first rows as a table; what they used up is dropped."""
    index = np.full((rows, len(columns)), -1, dtype=np.int64)
    residual = np.zeros_like(index)
    for column, (stream, partner, candidates) in enumerate(columns):
        paired = np.flatnonzero(partner[:rows] >= 0)
        chosen = partner[paired]
        index[paired, column] = stream.places[chosen]
        residual[paired, column] = stream.times_ns[chosen] - own.times_ns[paired]
        first_unused = int(chosen[-1]) + 1 if len(chosen) else 0
        stream.drop(max(first_unused, int(candidates.low[rows])) if rows < len(partner) else len(stream.times_ns))
    block = MatchBlock(
        reference_ns=own.times_ns[:rows].copy(),
        reference_index=own.places[:rows].copy(),
        index=index,
        residual_ns=residual,
    )
    own.drop(rows)
    return block


@dataclass(frozen=True)
class MatchedGroup:
    """A message of the reference and what belongs to it.

    Args:
        stamp_ns: Its stamp.
        index: Its place in its stream, counted as messages arrived.
        partners: Stamp and place of each other stream's message, None where there is none.
    """

    stamp_ns: int
    index: int
    partners: dict[str, tuple[int, int] | None]


@dataclass
class _StreamBuffer:
    """Messages of one stream that are not yet used up, in order of their stamps."""

    pending: list[tuple[int, int]] = field(default_factory=list)
    arrived: int = 0
    latest: int | None = None
    interval: int = 0  # about the usual one
    doubtful: tuple[int, int] | None = None  # a stamp far from the last ones: the next one decides
    silent: bool = False

    @property
    def reached(self) -> int | None:
        """How far the stream has come, a stamp that is kept aside included."""
        if self.latest is None or self.doubtful is None:
            return self.latest
        return max(self.latest, self.doubtful[0])


class StreamMatcher:
    """Matches streams to one of them as messages arrive.

    Args:
        names: The streams.
        reference: The one to which the others are matched.
        tolerance_ns: Largest distance.
        lateness_ns: How much earlier than the latest stamp of its stream a message may be; later ones are dropped and
            counted.
        stall_ns: A stream that is so far behind the others, and by three of its own intervals, is silent: nobody waits
            for it until it speaks again.
        jump_ns: A stamp so far from its stream's latest is kept aside until the next one shows whether the clock was
            set or the stamp is astray.
        longest_ns: A cluster that lasts longer is cut, at its widest interval.

    Attributes:
        counts: ``late``, ``duplicate``, ``astray``, ``silent``, ``cut``, by (what, stream).
        needed_ns: The lateness that would have saved all that was late.
        warnings: What became of silent streams and set clocks, in words.

    Raises:
        ConfigError: If the reference is none of the streams, or a time is negative.
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        reference: str,
        tolerance_ns: int,
        lateness_ns: int = 100_000_000,
        stall_ns: int = 1_000_000_000,
        jump_ns: int = 10_000_000_000,
        longest_ns: int = 2_000_000_000,
    ) -> None:
        if reference not in names:
            raise ConfigError(f"reference: expected a stream, one of {', '.join(names)}; got {reference!r}")
        if min(tolerance_ns, lateness_ns, stall_ns, jump_ns, longest_ns) < 0:
            raise ConfigError("StreamMatcher: expected times of 0 or more")
        self.reference, self.others = reference, tuple(name for name in names if name != reference)
        self.tolerance_ns, self.lateness_ns, self.stall_ns = tolerance_ns, lateness_ns, stall_ns
        self.jump_ns, self.longest_ns = jump_ns, longest_ns
        self.counts: Counter[tuple[str, str]] = Counter()
        self.needed_ns = lateness_ns
        self.warnings: list[str] = []
        self._streams = {name: _StreamBuffer() for name in names}
        self._watermark: int | None = None

    def push(self, stream: str, stamp_ns: int) -> list[MatchedGroup]:
        """Take one message; give the groups that are decided by it, in order."""
        own = self._streams[stream]
        index, own.arrived = own.arrived, own.arrived + 1
        if own.doubtful is not None:
            return self._resolve(stream, own, (stamp_ns, index))
        if own.latest is not None and abs(stamp_ns - own.latest) > self.jump_ns:
            own.doubtful = (stamp_ns, index)
            return []
        return self._take(stream, own, (stamp_ns, index))

    def close(self) -> list[MatchedGroup]:
        """Give the groups that are left; the matcher is then empty, and may be used again."""
        groups = []
        for name, own in self._streams.items():
            if own.doubtful is not None:
                message, own.doubtful = own.doubtful, None
                groups += self._take(name, own, message)
        groups += self._decided(None)
        for own in self._streams.values():
            own.pending, own.latest, own.silent = [], None, False
        self._watermark = None
        return groups

    @property
    def held(self) -> int:
        """Messages that wait: what bounds the memory."""
        return sum(len(own.pending) + (own.doubtful is not None) for own in self._streams.values())

    def _resolve(self, stream: str, own: _StreamBuffer, message: tuple[int, int]) -> list[MatchedGroup]:
        """A stamp stood far from the ones before: the next one goes on from it, or from them."""
        doubtful, own.doubtful = own.doubtful, None
        if doubtful is None or own.latest is None:
            return self._take(stream, own, message)
        if abs(message[0] - own.latest) < abs(message[0] - doubtful[0]):
            self.counts["astray", stream] += 1
            return self._take(stream, own, message)
        if doubtful[0] > own.latest:
            return self._take(stream, own, doubtful) + self._take(stream, own, message)
        self.warnings.append(f"{stream}: its clock was set back by {(own.latest - doubtful[0]) / 1e9:.3f} s")
        return self._begin_anew({stream: doubtful}) + self._take(stream, own, message)

    def _begin_anew(self, first: dict[str, tuple[int, int]]) -> list[MatchedGroup]:
        """End the recording so far; what other streams kept aside that lies before their latest comes after it."""
        for name, other in self._streams.items():
            if other.doubtful is not None and other.latest is not None and other.doubtful[0] < other.latest:
                first[name], other.doubtful = other.doubtful, None
        groups = self.close()
        for name, message in first.items():
            groups += self._take(name, self._streams[name], message)
        return groups

    def _take(self, stream: str, own: _StreamBuffer, message: tuple[int, int]) -> list[MatchedGroup]:
        stamp = message[0]
        if self._watermark is not None and stamp < self._watermark:
            self.counts["late", stream] += 1
            latest = stamp if own.latest is None else own.latest
            self.needed_ns = max(self.needed_ns, latest - stamp, self._watermark + self.lateness_ns - stamp)
            return []
        if own.pending and own.pending[-1][0] < stamp:
            own.pending.append(message)
        elif (index := bisect_left(own.pending, (stamp, -1))) < len(own.pending) and own.pending[index][0] == stamp:
            self.counts["duplicate", stream] += 1
            return []
        else:
            insort(own.pending, message)
        if own.latest is not None and stamp > own.latest:
            own.interval += (stamp - own.latest - own.interval) // 8
        own.latest = stamp if own.latest is None else max(own.latest, stamp)
        own.silent = False
        return self._decided(self._watermark) if self._moved() else []

    def _moved(self) -> bool:
        """Move the watermark on; say whether it moved."""
        reached = {name: own.reached for name, own in self._streams.items()}
        front = max(latest for latest in reached.values() if latest is not None)
        start = min((own.pending[0][0] for own in self._streams.values() if own.pending), default=front)
        live = []
        for name, own in self._streams.items():
            latest = reached[name]
            behind = front - (start if latest is None else latest)
            if behind > max(self.stall_ns, 3 * own.interval) and not own.silent:
                own.silent = True
                self._silent(name, latest)
            if not own.silent:
                live.append(latest)
        if any(latest is None for latest in live):
            return False
        mark = min(latest for latest in live if latest is not None) - self.lateness_ns
        if self._watermark is not None and mark <= self._watermark:
            return False
        self._watermark = mark
        return True

    def _silent(self, name: str, latest: int | None) -> None:
        """Note that a stream fell silent: in words the first time, afterwards as a count."""
        self.counts["silent", name] += 1
        if self.counts["silent", name] == 1:
            since = "from the start" if latest is None else f"after {latest} ns"
            self.warnings.append(f"{name}: silent {since}; the others go on without it")

    def _decided(self, mark: int | None) -> list[MatchedGroup]:
        """References decided up to the watermark; all of them where there is none."""
        own = self._streams[self.reference]
        waiting = own.pending
        last = len(waiting) if mark is None else bisect_left(waiting, (mark - self.tolerance_ns, -1))
        if not last:
            self._forget(mark)
            return []
        a = np.array([stamp for stamp, _ in waiting[:last]], dtype=np.int64)
        columns = [np.array([stamp for stamp, _ in self._streams[n].pending], dtype=np.int64) for n in self.others]
        candidates = [windows(a, b, self.tolerance_ns) for b in columns]
        following = waiting[last][0] if last < len(waiting) else mark  # no reference comes before it
        boundaries = np.arange(last + 1)
        for column, windows_of in zip(columns, candidates, strict=True):
            apart = (
                following is None
                or not windows_of.high[-1]
                or column[windows_of.high[-1] - 1] < following - self.tolerance_ns
            )
            boundaries = np.intersect1d(
                boundaries, np.append(windows_of.starts, last) if apart else windows_of.starts, assume_unique=True
            )
        rows = int(boundaries[-1])
        if not rows and a[-1] - a[0] > self.longest_ns:
            rows = int(np.argmax(np.diff(a))) + 1
            self.counts["cut", self.reference] += 1
        if not rows:
            return []
        partners = [
            assign_in(a, b, self.tolerance_ns, windows_of) for b, windows_of in zip(columns, candidates, strict=True)
        ]
        groups = [self._group(waiting[row], [int(partner[row]) for partner in partners]) for row in range(rows)]
        for name, partner, windows_of in zip(self.others, partners, candidates, strict=True):
            first_unused = int(partner[:rows].max()) + 1
            del self._streams[name].pending[: max(first_unused, int(windows_of.low[rows]) if rows < last else 0)]
        del waiting[:rows]
        self._forget(mark)
        return groups

    def _group(self, message: tuple[int, int], partners: list[int]) -> MatchedGroup:
        chosen = {
            name: None if index < 0 else self._streams[name].pending[index]
            for name, index in zip(self.others, partners, strict=True)
        }
        return MatchedGroup(message[0], message[1], chosen)

    def _forget(self, mark: int | None) -> None:
        """Drop what no reference can use any more."""
        if mark is None:
            return
        own = self._streams[self.reference].pending
        first = (min(own[0][0], mark) if own else mark) - self.tolerance_ns
        for name in self.others:
            pending = self._streams[name].pending
            del pending[: bisect_left(pending, (first, -1))]
