"""What the stamps say: gaps, doubled and backward ones, breaks, and sensors that are out of step with the frames."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int64

from farfield.frame.drive import BREAK_PERIODS
from farfield.inspection.doctor.findings import Finding, counted
from farfield.inspection.doctor.survey import Survey
from farfield.sync.stamps import StreamStats, health

FEWEST = 5
"""A sensor's step is judged where so many of its stamps follow each other."""
FRAMES = "frames"


@dataclass(frozen=True, kw_only=True)
class StampOffset:
    """One sensor against the frames' times, over all drives.

    Args:
        median_ms: Typical distance, later positive.
        spread_ms: From the 5 % to the 95 % quantile of the distances.
        wander_ms: How much the distance changes from the first to the last fifth of a drive, at most.
        elsewhere: Frames to whose time the sensor's stamp of a neighbouring frame is nearer.
        frames: Frames that have both.
        apart: Drives in which it shares no moment with the frames.
        period_ms: Its own median interval; None for single stamps.
    """

    median_ms: float
    spread_ms: float
    wander_ms: float
    elsewhere: int
    frames: int
    apart: int
    period_ms: float | None


def stamps(found: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Tell streams whose stamps double, run backwards or break off, and sensors out of step with the frames."""
    streams = _streams(found)
    if not streams:
        return
    single = {name: {drive: health(times[:, 1]) for drive, times in by.items()} for name, by in streams.items()}
    steps = {
        name: _stamp_offset(streams[name], streams[FRAMES]) for name in streams if name != FRAMES and FRAMES in streams
    }
    facts["stamps"] = {name: _figures(by, steps.get(name)) for name, by in single.items()}
    findings = [finding for name, by in single.items() for finding in _stream_findings(name, by)]
    findings += [
        finding for name, step in steps.items() if step is not None for finding in _offset_findings(name, step)
    ]
    yield from findings
    if not findings:
        worst = max((abs(step.median_ms) for step in steps.values() if step is not None), default=0.0)
        sensors = f", sensors within {worst:.1f} ms of their frames" if steps else ""
        yield Finding(severity="ok", topic="stamps", what=f"{counted(len(single), 'stream')} in order{sensors}")


def _streams(found: Survey) -> dict[str, dict[str, Int64[np.ndarray, "n 2"]]]:
    """Place among the frames and stamp of each stream's messages, by stream and drive."""
    rows: dict[str, dict[str, list[tuple[int, int]]]] = {}
    drives = found.dataset.sequences
    for place, (time_ns, sensors) in enumerate(zip(found.times_ns, found.sensor_times_ns, strict=True)):
        known = sensors if time_ns is None else {FRAMES: time_ns, **sensors}
        for name, stamp_ns in known.items():
            rows.setdefault(name, {}).setdefault(drives[place], []).append((place, stamp_ns))
    return {name: {drive: np.array(pairs, dtype=np.int64) for drive, pairs in by.items()} for name, by in rows.items()}


def _figures(by: Mapping[str, StreamStats], step: StampOffset | None) -> dict[str, Any]:
    longest = max((each.longest_gap_ns or 0 for each in by.values() if each.gaps), default=0)
    alone = {
        "duplicates": sum(each.duplicates for each in by.values()),
        "backwards": sum(each.backwards for each in by.values()),
        "gaps": sum(each.gaps for each in by.values()),
        "longest_gap_s": longest / 1e9,
    }
    return alone | ({} if step is None else dict(vars(step)))


def _stream_findings(name: str, by: Mapping[str, StreamStats]) -> Iterator[Finding]:
    """What is wrong with a stream by itself."""
    words = {"duplicates": "twice the same", "backwards": "earlier than the one before"}
    for what, said in words.items():
        counts = {drive: getattr(each, what) for drive, each in by.items() if getattr(each, what)}
        if counts:
            total = sum(counts.values())
            mend = "Times must grow within a drive: look for doubled files, or for a clock that was set."
            text = f"{name}: {counted(total, 'stamp')} {said}, of {sum(each.count for each in by.values())}"
            yield Finding(severity="warn", topic="stamps", what=text, where=_named(counts), mend=mend)
    breaks = {drive: each.longest_gap_ns or 0 for drive, each in by.items() if _breaks(each)}
    if breaks and name == FRAMES:
        drive = max(breaks, key=lambda key: breaks[key])
        text = f"a break of {breaks[drive] / 1e9:.1f} s within a drive; {counted(len(breaks), 'drive')} with one"
        mend = "What stands before and after belongs to two drives: sweeps and tracks across it are wrong."
        yield Finding(severity="warn", topic="stamps", what=text, where=drive, mend=mend)


def _breaks(each: StreamStats) -> bool:
    return bool(each.longest_gap_ns and each.period_ns and each.longest_gap_ns > BREAK_PERIODS * each.period_ns)


def _named(counts: Mapping[str, int]) -> str:
    shown = ", ".join(list(counts)[:3])
    return shown + (", ..." if len(counts) > 3 else "")


def _stamp_offset(
    sensor: Mapping[str, Int64[np.ndarray, "n 2"]], frames: Mapping[str, Int64[np.ndarray, "m 2"]]
) -> StampOffset | None:
    """A sensor against the frames; None where they have no frame in common."""
    offsets, wander, elsewhere, apart, periods = [], [0.0], 0, 0, []
    for drive, rows in sensor.items():
        if drive not in frames:
            continue
        places, own, theirs = np.intersect1d(rows[:, 0], frames[drive][:, 0], return_indices=True)
        if not len(places):
            continue
        stamp, time = rows[own, 1], frames[drive][theirs, 1]
        offset = (stamp - time) / 1e6
        offsets.append(offset)
        steps = np.diff(stamp)[np.diff(places) == 1]
        if len(steps) >= FEWEST:
            period = float(np.median(steps)) / 1e6
            periods.append(period)
            fifth = max(len(offset) // 5, 1)
            wander.append(abs(float(np.median(offset[-fifth:]) - np.median(offset[:fifth]))))
            elsewhere += _nearer_to_neighbour(stamp, time)
        apart += int(stamp.min() > time.max() or stamp.max() < time.min()) if len(stamp) >= FEWEST else 0
    if not offsets:
        return None
    every = np.concatenate(offsets)
    low, high = np.quantile(every, [0.05, 0.95])
    return StampOffset(
        median_ms=float(np.median(every)),
        spread_ms=float(high - low),
        wander_ms=max(wander),
        elsewhere=elsewhere,
        frames=len(every),
        apart=apart,
        period_ms=float(np.median(periods)) if periods else None,
    )


def _nearer_to_neighbour(stamp: Int64[np.ndarray, " n"], time: Int64[np.ndarray, " n"]) -> int:
    """Frames to which the stamp of a neighbouring frame is nearer than their own."""
    own = np.abs(stamp - time)
    before, after = np.abs(stamp[:-1] - time[1:]), np.abs(stamp[1:] - time[:-1])
    nearer = np.zeros(len(stamp), dtype=bool)
    nearer[1:] |= before < own[1:]
    nearer[:-1] |= after < own[:-1]
    return int(nearer.sum())


def _offset_findings(name: str, step: StampOffset) -> Iterator[Finding]:
    """What is wrong with a sensor against the frames."""
    sync = "`farfield sync` on the recording matches them anew."
    if step.apart:
        text = f"{name} shares no moment with its frames in {counted(step.apart, 'drive')}"
        mend = f"Its clock is another one, or the wrong files were paired. {sync}"
        yield Finding(severity="warn", topic="stamps", what=text, mend=mend)
        return
    if step.elsewhere > 0.02 * step.frames:
        text = (
            f"{name} is out of step: in {step.elsewhere} of {step.frames} frames a neighbour's stamp is nearer; "
            f"typically {step.median_ms:+.1f} ms from its frame"
        )
        yield Finding(severity="warn", topic="stamps", what=text, mend=f"It was not matched by nearness. {sync}")
    if step.period_ms and step.wander_ms > 0.25 * step.period_ms:
        text = f"{name} drifts: its distance from the frames changes by {step.wander_ms:.1f} ms within a drive"
        mend = f"Their clocks run apart, or one of them runs freely. {sync}"
        yield Finding(severity="warn", topic="stamps", what=text, mend=mend)
