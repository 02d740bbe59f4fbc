"""What a stream's stamps say about the stream itself: period, gaps, lost, duplicate and misplaced messages."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Int64

from farfield.frame.drive import BREAK_PERIODS

GAP_PERIODS = 1.5
"""An interval longer than so many median periods has lost messages in it."""
MOST_GAPS = 1000

_CLOCK_OFFSETS_S = {18: "GPS and UTC", 19: "GPS and TAI", 37: "TAI and UTC"}
_OFFSET_TOLERANCE_S = 0.25
_WRAP_NS = {f"32 bit{words}": 2**32 * scale for words, scale in ((" of nanoseconds", 1), (" of microseconds", 1000))}

Stamps = Int64[np.ndarray, " _"]


def clock_offset_note(seconds: float) -> str:
    """Which two time scales differ by as much, in words; empty where none do.

    >>> clock_offset_note(-18.05), clock_offset_note(3.0)
    ('GPS and UTC differ by 18 s: were both used?', '')
    """
    whole = round(abs(seconds))
    if whole not in _CLOCK_OFFSETS_S or abs(abs(seconds) - whole) > _OFFSET_TOLERANCE_S:
        return ""
    return f"{_CLOCK_OFFSETS_S[whole]} differ by {whole} s: were both used?"


def wrapped_note(set_back_ns: int, period_ns: int | None) -> str:
    """Of how many bits a counter is that started anew, in words; empty where stamps were set back by another time.

    >>> wrapped_note(2**32 - 100_000_000, 100_000_000)
    'as a counter of 32 bit of nanoseconds that starts anew'
    """
    slack = 3 * (period_ns or 0)
    names = [name for name, wrap in _WRAP_NS.items() if 0 <= wrap - set_back_ns <= slack]
    return f"as a counter of {names[0]} that starts anew" if names else ""


@dataclass(frozen=True, eq=False, kw_only=True)
class StreamStats:
    """A stream by its stamps alone.

    Args:
        count: Stamps, all of them.
        first_ns: The first; None without stamps.
        last_ns: The latest; None without stamps.
        period_ns: Median interval between stamps that rise (of the first million); None for fewer than two.
        tick_ns: Mean interval a message, those lost within intervals of five periods counted: what jitter and losses do
            not bias.
        duplicates: Stamps that equal the one before.
        backwards: Stamps that are earlier than the one before.
        set_back_ns: By how much at most.
        gaps: Intervals longer than :data:`GAP_PERIODS` periods.
        lost: Messages that would fill the gaps.
        longest_gap_ns: Longest interval; None for fewer than two stamps.
        step_ns: Largest step of which all intervals are multiples: how finely the clock was read.
        gap_starts_ns: Where the first thousand gaps begin, shape (k,).
        gap_lengths_ns: How long they are, shape (k,).
    """

    count: int
    first_ns: int | None
    last_ns: int | None
    period_ns: int | None
    tick_ns: float | None
    duplicates: int
    backwards: int
    set_back_ns: int
    gaps: int
    lost: int
    longest_gap_ns: int | None
    step_ns: int | None
    gap_starts_ns: Stamps
    gap_lengths_ns: Stamps

    def to_json(self) -> dict[str, Any]:
        """All of it but the single gaps, with the rate in hertz."""
        rate = None if not self.tick_ns else round(1e9 / self.tick_ns, 6)
        return {name: value for name, value in vars(self).items() if not isinstance(value, np.ndarray)} | {
            "rate_hz": rate
        }


class StreamCounter:
    """Finds a stream's :class:`StreamStats` block by block."""

    def __init__(self) -> None:
        self.count = self.duplicates = self.backwards = self.gaps = self.lost = self.longest = self.step = 0
        self.set_back = 0
        self.covered = self.ticks = 0
        self.first: int | None = None
        self.last: int | None = None
        self.before: int | None = None
        self.period: int | None = None
        self.starts: list[Stamps] = []
        self.lengths: list[Stamps] = []

    def add(self, block: Int64[np.ndarray, " _"]) -> None:
        """Take the next stamps, in the order in which they were written."""
        if not len(block):
            return
        first = self.first is None
        with_before = block if self.before is None else np.concatenate([[self.before], block])
        steps = np.diff(with_before)
        self.duplicates += int((steps == 0).sum())
        self.backwards += int((steps < 0).sum())
        self.set_back = max(self.set_back, -int(steps.min(initial=0)))
        self.count += len(block)
        self.before = int(block[-1])
        highest = np.maximum.accumulate(block if self.last is None else np.concatenate([[self.last], block]))
        self.first, self.last = (int(block[0]) if first else self.first), int(highest[-1])
        rising = np.flatnonzero(np.diff(highest))
        self._intervals(highest[rising], np.diff(highest)[rising])

    def _intervals(self, starts: Stamps, steps: Stamps) -> None:
        if not len(steps):
            return
        if self.period is None:
            self.period = int(np.median(steps[: 1 << 20]))
        self.longest = max(self.longest, int(steps.max()))
        self.step = int(np.gcd.reduce(np.append(steps, self.step)))
        usual = steps[steps < (BREAK_PERIODS + 0.5) * self.period]
        self.covered += int(usual.sum())
        self.ticks += int(np.maximum(np.rint(usual / self.period), 1).sum())
        rows = np.flatnonzero(steps > GAP_PERIODS * self.period)
        self.gaps += len(rows)
        self.lost += int((np.rint(steps[rows] / self.period) - 1).sum())
        room = MOST_GAPS - sum(map(len, self.starts))
        self.starts.append(starts[rows[:room]])
        self.lengths.append(steps[rows[:room]])

    def result(self) -> StreamStats:
        """What was found so far."""
        none = np.zeros(0, dtype=np.int64)
        return StreamStats(
            count=self.count,
            first_ns=self.first,
            last_ns=self.last,
            period_ns=self.period,
            tick_ns=self.covered / self.ticks if self.ticks else None,
            duplicates=self.duplicates,
            backwards=self.backwards,
            set_back_ns=self.set_back,
            gaps=self.gaps,
            lost=self.lost,
            longest_gap_ns=self.longest or None,
            step_ns=self.step or None,
            gap_starts_ns=np.concatenate([none, *self.starts]),
            gap_lengths_ns=np.concatenate([none, *self.lengths]),
        )


def health(times_ns: Int64[np.ndarray, " n"]) -> StreamStats:
    """Describe a stream by its stamps, in the order in which they were written."""
    counting = StreamCounter()
    counting.add(times_ns)
    return counting.result()


def cleaned(times_ns: Int64[np.ndarray, " n"]) -> tuple[Stamps, Int64[np.ndarray, " _"]]:
    """Stamps in order without duplicates, and where each stood; of equal ones the first is kept."""
    steps = np.diff(times_ns)
    if not len(steps) or steps.min() > 0:
        return times_ns, np.arange(len(times_ns))
    unique_ns, index = np.unique(times_ns, return_index=True)
    return unique_ns, index.astype(np.int64)


def drives_in(times_ns: Int64[np.ndarray, " n"]) -> list[slice]:
    """Where a stream of increasing stamps falls apart: at intervals longer than :data:`BREAK_PERIODS` periods."""
    steps = np.diff(times_ns)
    cuts = np.flatnonzero(steps > BREAK_PERIODS * np.median(steps)) + 1 if len(steps) else np.zeros(0, np.int64)
    edges = [0, *cuts.tolist(), len(times_ns)]
    return [slice(begin, end) for begin, end in pairwise(edges)]


def apart(streams: Mapping[str, StreamStats], reference: str, tolerance_ns: int) -> dict[str, str]:
    """Streams that share no time with the reference, and what to say of each.

    Args:
        streams: What is known of each.
        reference: The stream to which the others are matched.
        tolerance_ns: So far apart may stamps be and still belong together.
    """
    own, reasons = streams[reference], {}
    for name, other in streams.items():
        if name == reference or own.first_ns is None or own.last_ns is None:
            continue
        if other.first_ns is None or other.last_ns is None:
            reasons[name] = f"{name} has no stamps"
        elif other.first_ns > own.last_ns + tolerance_ns or other.last_ns < own.first_ns - tolerance_ns:
            by_s = (other.first_ns - own.first_ns) / 1e9
            relation = "after" if by_s > 0 else "before"
            reasons[name] = (
                f"{name} does not overlap with {reference}: it begins {abs(by_s):.3f} s {relation} it and shares no "
                "moment; its clock is another one, or it was recorded apart"
            )
            note = clock_offset_note(by_s)
            reasons[name] += f". {note}" if note else ""
    return reasons
