"""Matching while messages arrive: bounded memory, an allowed lateness, streams that fall silent.

The watermark is the earliest of the live streams' latest stamps, less the lateness: nothing earlier is expected any
more. A reference is decided when the clusters that it belongs to (see :mod:`farfield.sync.assignment`) lie whole
before the watermark. Where no message is later than the allowed lateness and no cluster is cut, the result is that of
:func:`farfield.sync.match_times`.
"""

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from farfield.errors import ConfigError
from farfield.sync.assignment import assign_in, windows


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
        place, own.arrived = own.arrived, own.arrived + 1
        if own.doubtful is not None:
            return self._resolve(stream, own, (stamp_ns, place))
        if own.latest is not None and abs(stamp_ns - own.latest) > self.jump_ns:
            own.doubtful = (stamp_ns, place)
            return []
        return self._take(stream, own, (stamp_ns, place))

    def close(self) -> list[MatchedGroup]:
        """Give the groups that are left; the matcher is then empty, and may be used again."""
        found = []
        for name, own in self._streams.items():
            if own.doubtful is not None:
                held, own.doubtful = own.doubtful, None
                found += self._take(name, own, held)
        found += self._decided(None)
        for own in self._streams.values():
            own.pending, own.latest, own.silent = [], None, False
        self._watermark = None
        return found

    @property
    def held(self) -> int:
        """Messages that wait: what bounds the memory."""
        return sum(len(own.pending) + (own.doubtful is not None) for own in self._streams.values())

    def _resolve(self, stream: str, own: _StreamBuffer, message: tuple[int, int]) -> list[MatchedGroup]:
        """A stamp stood far from the ones before: the next one goes on from it, or from them."""
        held, own.doubtful = own.doubtful, None
        if held is None or own.latest is None:
            return self._take(stream, own, message)
        if abs(message[0] - own.latest) < abs(message[0] - held[0]):
            self.counts["astray", stream] += 1
            return self._take(stream, own, message)
        if held[0] > own.latest:
            return self._take(stream, own, held) + self._take(stream, own, message)
        self.warnings.append(f"{stream}: its clock was set back by {(own.latest - held[0]) / 1e9:.3f} s")
        return self._begin_anew({stream: held}) + self._take(stream, own, message)

    def _begin_anew(self, first: dict[str, tuple[int, int]]) -> list[MatchedGroup]:
        """End the recording so far; what other streams kept aside that lies before their latest comes after it."""
        for name, other in self._streams.items():
            if other.doubtful is not None and other.latest is not None and other.doubtful[0] < other.latest:
                first[name], other.doubtful = other.doubtful, None
        found = self.close()
        for name, message in first.items():
            found += self._take(name, self._streams[name], message)
        return found

    def _take(self, stream: str, own: _StreamBuffer, message: tuple[int, int]) -> list[MatchedGroup]:
        stamp = message[0]
        if self._watermark is not None and stamp < self._watermark:
            self.counts["late", stream] += 1
            latest = stamp if own.latest is None else own.latest
            self.needed_ns = max(self.needed_ns, latest - stamp, self._watermark + self.lateness_ns - stamp)
            return []
        if own.pending and own.pending[-1][0] < stamp:
            own.pending.append(message)
        elif (place := bisect_left(own.pending, (stamp, -1))) < len(own.pending) and own.pending[place][0] == stamp:
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
        found = [windows(a, b, self.tolerance_ns) for b in columns]
        following = waiting[last][0] if last < len(waiting) else mark  # no reference comes before it
        whole = np.arange(last + 1)
        for column, known in zip(columns, found, strict=True):
            apart = (
                following is None or not known.high[-1] or column[known.high[-1] - 1] < following - self.tolerance_ns
            )
            whole = np.intersect1d(whole, np.append(known.starts, last) if apart else known.starts, assume_unique=True)
        rows = int(whole[-1])
        if not rows and a[-1] - a[0] > self.longest_ns:
            rows = int(np.argmax(np.diff(a))) + 1
            self.counts["cut", self.reference] += 1
        if not rows:
            return []
        partners = [assign_in(a, b, self.tolerance_ns, known) for b, known in zip(columns, found, strict=True)]
        groups = [self._group(waiting[row], [int(partner[row]) for partner in partners]) for row in range(rows)]
        for name, partner, known in zip(self.others, partners, found, strict=True):
            used = int(partner[:rows].max()) + 1
            del self._streams[name].pending[: max(used, int(known.low[rows]) if rows < last else 0)]
        del waiting[:rows]
        self._forget(mark)
        return groups

    def _group(self, message: tuple[int, int], partners: list[int]) -> MatchedGroup:
        chosen = {
            name: None if place < 0 else self._streams[name].pending[place]
            for name, place in zip(self.others, partners, strict=True)
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
