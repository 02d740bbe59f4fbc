"""What is there and what is missing: sweeps, labels, images, calibration, times and their gaps, segments, pairs."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Int64

from farfield.datasets.cirrus import Cirrus
from farfield.datasets.downloads import archive_sentences
from farfield.datasets.folder import TABLE_NAME, Folder
from farfield.datasets.unread import unread_files
from farfield.files.boxes_csv import zeros_note
from farfield.frame.drive import BREAK_PERIODS
from farfield.inspection.doctor.survey import Finding, Survey
from farfield.sync.stamps import StreamStats, clock_offset_note, health
from farfield.vocabulary.counts import count_of


def check_inventory(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Tell which sensors, labels and calibrations there are, and what could not be read."""
    count = len(survey.dataset)
    facts |= {"frames": count, "sweeps": dict(survey.sensors), "images": dict(survey.images)}
    facts |= {"labelled_frames": len(survey.boxes), "calibrated_cameras": sorted(survey.cameras)}
    if isinstance(survey.dataset.unwrapped, Cirrus):
        yield from _cirrus_folders(survey, survey.dataset.unwrapped)
    else:
        kinds = ", ".join(f"{number} with cloud {name}" for name, number in survey.sensors.items()) or "no clouds"
        yield Finding(
            severity="ok" if survey.sensors else "fail",
            topic="frames",
            what=f"{count_of(count, 'frame')}: {kinds}",
            fix=""
            if survey.sensors
            else "Add the clouds: without them nothing can be trained or detected. Annotations alone are enough for "
            "farfield stats and farfield score.",
        )
    yield _labels(survey)
    yield from _stray_labels(survey)
    yield from _assumptions(survey)
    images = ", ".join(f"{number} of {name}" for name, number in survey.images.items())
    yield Finding(severity="ok", topic="images", what=images or "none (clouds alone are enough)")
    yield _calibration(survey)
    files = survey.dataset.files(0) if len(survey.dataset) else ()
    for what in unread_files(survey.dataset.root, files) if survey.dataset.root.is_dir() else ():
        yield Finding(severity="warn", topic="files", what=what, fix="Convert them, or move them elsewhere.")
    for what in archive_sentences(survey.dataset.root, depth=0):
        yield Finding(severity="warn", topic="archives", what=what, fix="Unpack it where the frames need it.")
    for error in survey.damaged[:5]:
        yield Finding(severity="fail", topic="damaged", what=error, fix="Fix or remove the file.")
    if len(survey.damaged) > 5:
        yield Finding(severity="fail", topic="damaged", what=f"and {len(survey.damaged) - 5} more")


def _calibration(survey: Survey) -> Finding:
    notes = survey.dataset.unwrapped.notes
    if notes:
        fix = "Clouds and pictures are read without it; boxes cannot be drawn into the pictures."
        return Finding(severity="warn", topic="calibration", what="; ".join(notes), fix=fix)
    if survey.cameras or not survey.images:
        what = f"cameras {', '.join(sorted(survey.cameras))}" if survey.cameras else "no calibration"
        return Finding(severity="ok", topic="calibration", what=what)
    fix = "Boxes cannot be drawn into the images."
    if isinstance(survey.dataset.unwrapped, Cirrus | Folder):
        fix += " Put calibration.yaml (matrix, distortion, camera_T_lidar, width, height) into the root."
    return Finding(severity="warn", topic="calibration", what="no calibration", fix=fix)


def _cirrus_folders(survey: Survey, reader: Cirrus) -> Iterator[Finding]:
    """Tell the files of each pattern; of a selection of frames those that belong to them."""
    all_frames = set(survey.dataset.origins) == set(range(len(reader)))
    chosen = [reader.entries[index] for index in dict.fromkeys(survey.dataset.origins)]
    for pattern, pattern_name in (("gaussian", "Gaussian"), ("uniform", "uniform")):
        files = sum(len(part.files[pattern]) for part in reader.parts)
        files = files if all_frames else sum(getattr(entry, pattern) is not None for entry in chosen)
        used = survey.sensors.get(pattern, 0)
        if files == 0:
            yield Finding(
                severity="warn",
                topic=f"{pattern_name} sweeps",
                what=f"no {pattern_name.lower() if pattern_name == 'uniform' else pattern_name} folder",
                fix=f"Only the other pattern can be used. If it is there, name it: layout: {{{pattern}: ...}}.",
            )
            continue
        facts = count_of(files, f"{pattern_name} frame")
        alone = "" if used == files or pattern == "gaussian" else f", {count_of(used, 'frame has', 'frames have')} one"
        yield Finding(severity="ok", topic=f"{pattern_name} sweeps", what=facts + alone)
    parts = reader.parts if all_frames else {(one.part.root, one.part.number): one.part for one in chosen}.values()
    stems = {path.stem for part in reader.parts for path in part.files["gaussian"]}
    orphans = [path for part in parts for path in part.files["labels"] if path.stem not in stems]
    if orphans:
        yield Finding(
            severity="fail" if not survey.boxes else "warn",
            topic="labels",
            what=f"{count_of(len(orphans), 'annotation has', 'annotations have')} no Gaussian sweep of the same name",
            where=orphans[0].name,
            fix="Name the annotation like its Gaussian sweep.",
        )


def _labels(survey: Survey) -> Finding:
    count, boxes = len(survey.dataset), sum(len(part) for part in survey.boxes)
    what = f"{len(survey.boxes)} of {count_of(count, 'frame')} annotated, {count_of(boxes, 'box', 'boxes')}"
    if boxes == 0:
        fix = "Training and scoring need boxes; prediction does not. Check the folder's name and the stems."
        fix += _unread_tables(survey)
        return Finding(severity="fail", topic="labels", what=what, fix=fix)
    if survey.unlabelled:
        fix = "Frames without annotation are left out of training and scoring."
        return Finding(severity="warn", topic="labels", what=what, fix=fix)
    return Finding(severity="ok", topic="labels", what=what)


def _unread_tables(survey: Survey) -> str:
    """Which files beside the clouds may hold the boxes, in a form that is not read."""
    reader = survey.dataset.unwrapped
    if not isinstance(reader, Folder):
        return ""
    tables = [path for path in reader.root.iterdir() if path.suffix.lower() in (".csv", ".json")]
    names = sorted(path.name for path in tables if path.name != TABLE_NAME and path.stem not in reader.frame_ids)
    if not names:
        return ""
    more = f" and {count_of(len(names) - 1, 'more file', 'more files')}" if len(names) > 1 else ""
    verb = "are" if len(names) > 1 else "is"
    return f" {names[0]}{more} {verb} not read: boxes go into {TABLE_NAME}, or a JSON file a frame (docs/own-data.md)."


def _stray_labels(survey: Survey) -> Iterator[Finding]:
    """Annotations of one's own folder that belong to no cloud."""
    reader = survey.dataset.unwrapped
    strays = reader.strays if isinstance(reader, Folder) else ()
    if strays:
        yield Finding(
            severity="warn" if survey.boxes else "fail",
            topic="labels",
            what=f"{count_of(len(strays), 'annotation belongs', 'annotations belong')} to no cloud",
            where=strays[0],
            fix=f"Name them like the clouds, such as {reader.frame_ids[0]}. "
            f"{zeros_note([stray.rpartition(' ')[2] for stray in strays], reader.frame_ids)}".rstrip(),
        )


def _assumptions(survey: Survey) -> Iterator[Finding]:
    """What the reader decided from the data."""
    for kind, sentence in survey.dataset.remarks:
        if kind == "note":  # the calibration's row has the warnings
            yield Finding(severity="warn", topic="reading", what=sentence)


def check_timing(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Tell frame rate, segments, pauses, and how far apart the two patterns are."""
    sequences = survey.dataset.sequences
    facts["sequences"] = len(set(sequences))
    times = survey.times_ns
    if not times or any(time is None for time in times):
        yield Finding(severity="ok", topic="times", what=f"no times; {count_of(facts['sequences'], 'sequence')}")
    else:
        yield _rate(np.array(times, dtype=np.int64), sequences, facts)
    if survey.pair_dt_ms:
        yield _pairs(np.array(survey.pair_dt_ms), len(survey.dataset), facts)
    elif survey.sensors.keys() >= {"gaussian", "uniform"}:
        yield Finding(severity="warn", topic="pairing", what="patterns paired by order: the names hold no times")


def _rate(times_ns: np.ndarray, sequences: tuple[str, ...], facts: dict[str, Any]) -> Finding:
    same = np.array(sequences[1:]) == np.array(sequences[:-1])
    steps_s = np.diff(times_ns)[same] / 1e9
    facts["segments"] = {name: sequences.count(name) for name in dict.fromkeys(sequences)}
    lengths = count_of(len(facts["segments"]), "segment")
    if len(steps_s) == 0:
        return Finding(severity="ok", topic="times", what=f"single frames, {lengths}")
    if (steps_s <= 0).any():
        fix = "Times must grow within a sequence; look for doubled files."
        return Finding(severity="warn", topic="times", what="times do not grow", fix=fix)
    period = float(np.median(steps_s))
    missing = int((steps_s > 1.5 * period).sum())
    facts |= {"frame_rate_hz": round(1 / period, 3), "gaps": missing}
    what = f"{1 / period:.1f} Hz, {lengths}, {count_of(missing, 'gap')} within"
    return Finding(severity="ok", topic="times", what=what)


def _pairs(dt_ms: np.ndarray, frames: int, facts: dict[str, Any]) -> Finding:
    edges = np.array([0, 10, 25, 50, 75, 100, np.inf])
    counts, _ = np.histogram(np.abs(dt_ms), edges)
    names = [f"{low:g}-{high:g}" for low, high in pairwise(edges)]
    histogram = {name: int(count) for name, count in zip(names, counts, strict=True) if count}
    facts["pair_dt_ms"] = {"median": float(np.median(dt_ms)), "histogram": histogram}
    shown = ", ".join(f"{count} at {name} ms" for name, count in histogram.items())
    what = f"{len(dt_ms)} of {count_of(frames, 'frame')} paired; |uniform - Gaussian|: {shown}"
    if len(dt_ms) < 0.9 * frames:
        fix = "Raise pairing: {max_dt_ms: ...} in the mapping, or use mode: order."
        return Finding(severity="warn", topic="pairing", what=what, fix=fix)
    slow = np.median(np.abs(dt_ms)) > 50
    fix = "Boxes belong to the Gaussian sweep: at 30 m/s an object moves 2 m in 68 ms." if slow else ""
    return Finding(severity="warn" if slow else "ok", topic="pairing", what=what, fix=fix)


# What the stamps say: gaps, doubled and backward ones, breaks, and sensors that are out of step with the frames.

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


def check_stamps(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Tell streams whose stamps double, run backwards or break off, and sensors out of step with the frames."""
    streams = _streams(survey)
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
        yield Finding(severity="ok", topic="stamps", what=f"{count_of(len(single), 'stream')} in order{sensors}")


def _streams(survey: Survey) -> dict[str, dict[str, Int64[np.ndarray, "n 2"]]]:
    """Place among the frames and stamp of each stream's messages, by stream and drive."""
    rows: dict[str, dict[str, list[tuple[int, int]]]] = {}
    drives = survey.dataset.sequences
    for index, (time_ns, sensors) in enumerate(zip(survey.times_ns, survey.sensor_times_ns, strict=True)):
        stamps = sensors if time_ns is None else {FRAMES: time_ns, **sensors}
        for name, stamp_ns in stamps.items():
            rows.setdefault(name, {}).setdefault(drives[index], []).append((index, stamp_ns))
    return {name: {drive: np.array(pairs, dtype=np.int64) for drive, pairs in by.items()} for name, by in rows.items()}


def _figures(by: Mapping[str, StreamStats], step: StampOffset | None) -> dict[str, Any]:
    longest = max((stats.longest_gap_ns or 0 for stats in by.values() if stats.gaps), default=0)
    alone = {
        "duplicates": sum(stats.duplicates for stats in by.values()),
        "backwards": sum(stats.backwards for stats in by.values()),
        "gaps": sum(stats.gaps for stats in by.values()),
        "longest_gap_s": longest / 1e9,
    }
    return alone | ({} if step is None else dict(vars(step)))


def _stream_findings(name: str, by: Mapping[str, StreamStats]) -> Iterator[Finding]:
    """What is wrong with a stream by itself."""
    faults = {"duplicates": "twice the same", "backwards": "earlier than the one before"}
    for what, fault in faults.items():
        counts = {drive: getattr(stats, what) for drive, stats in by.items() if getattr(stats, what)}
        if counts:
            total = sum(counts.values())
            fix = "Times must grow within a drive: look for doubled files, or for a clock that was set."
            text = f"{name}: {count_of(total, 'stamp')} {fault}, of {sum(stats.count for stats in by.values())}"
            where = ", ".join(list(counts)[:3]) + (", ..." if len(counts) > 3 else "")
            yield Finding(severity="warn", topic="stamps", what=text, where=where, fix=fix)
    breaks = {
        drive: stats.longest_gap_ns
        for drive, stats in by.items()
        if stats.longest_gap_ns and stats.period_ns and stats.longest_gap_ns > BREAK_PERIODS * stats.period_ns
    }
    if breaks and name == FRAMES:
        drive = max(breaks, key=lambda key: breaks[key])
        text = f"a break of {breaks[drive] / 1e9:.1f} s within a drive; {count_of(len(breaks), 'drive')} with one"
        note = clock_offset_note((breaks[drive] - (by[drive].period_ns or 0)) / 1e9)
        text += f". {note}" if note else ""
        fix = "What stands before and after belongs to two drives: sweeps and tracks across it are wrong."
        yield Finding(severity="warn", topic="stamps", what=text, where=drive, fix=fix)


def _stamp_offset(
    sensor: Mapping[str, Int64[np.ndarray, "n 2"]], frames: Mapping[str, Int64[np.ndarray, "m 2"]]
) -> StampOffset | None:
    """A sensor against the frames; None where they have no frame in common."""
    offsets, wander, elsewhere, apart, periods = [], [0.0], 0, 0, []
    for drive, rows in sensor.items():
        if drive not in frames:
            continue
        indices, own, frame_rows = np.intersect1d(rows[:, 0], frames[drive][:, 0], return_indices=True)
        if not len(indices):
            continue
        stamp, time = rows[own, 1], frames[drive][frame_rows, 1]
        offset = (stamp - time) / 1e6
        offsets.append(offset)
        steps = np.diff(stamp)[np.diff(indices) == 1]
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
        text = f"{name} shares no moment with its frames in {count_of(step.apart, 'drive')}"
        fix = f"Its clock is another one, or the wrong files were paired. {sync}"
        yield Finding(severity="warn", topic="stamps", what=text, fix=fix)
        return
    if step.elsewhere > 0.02 * step.frames:
        text = (
            f"{name} is out of step: in {step.elsewhere} of "
            f"{count_of(step.frames, 'frame')} a neighbour's stamp is nearer; "
            f"typically {step.median_ms:+.1f} ms from its frame"
        )
        yield Finding(
            severity="warn", topic="stamps", what=text, fix=f"Match each frame with the nearest stamp. {sync}"
        )
    if step.period_ms and step.wander_ms > 0.25 * step.period_ms:
        text = f"{name} drifts: its distance from the frames changes by {step.wander_ms:.1f} ms within a drive"
        fix = f"Their clocks run apart, or one of them runs freely. {sync}"
        yield Finding(severity="warn", topic="stamps", what=text, fix=fix)
