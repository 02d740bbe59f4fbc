"""The frames of a recording as units of work: which there are, how much room they need, simulating one."""

import errno
import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from farfield.errors import DatasetError
from farfield.frame.provenance import SIMULATION_FILE
from farfield.jobs import JobJournal, Unit, UnitResult
from farfield.jobs.journal import mark_of, state_of
from farfield.simulation.recording.rigs import writer_for
from farfield.simulation.recording.settings import RecordingOptions
from farfield.simulation.recording.writing import write_whole
from farfield.vocabulary.kradar import OUSTER_LINES
from farfield.vocabulary.patterns import PATTERNS

if TYPE_CHECKING:
    from farfield.frame import Frame

JOURNAL_NAME = ".farfield_simulate.jsonl"

# Bytes a frame by sensor, generously; an Ouster's point takes 80 bytes of ASCII, a Luminar's 70.
_BYTES = {
    "camera": 400_000,
    "cam-front": 5_000_000,
    "cam-left": 5_000_000,
    "cam-right": 5_000_000,
    "cam-rear": 5_000_000,
    "cells": 1_200_000,
    "sparse": 5_000_000,
    "polar3d": 16_300_000,
    "cube": 60_100_000,
    "tesseract": 260_000_000,
    "polar": 260_000,
    "cartesian": 1_200_000,
}
_BYTES_PER_SHOT = {"gaussian": 70, "uniform": 70, "os2-64": 80, "os1-128": 80, "lidar": 20}
_CACHED = 1.6  # bytes with the binary cache over bytes without


_WORKER_BYTES, _RADAR_WORKER_BYTES = 600_000_000, 1_500_000_000
_RADAR_SENSORS = {"cells", "sparse", "polar3d", "cube", "tesseract"}


def units_of(recording: RecordingOptions) -> list[Unit]:
    """One unit a frame; those of a sequence go together, for its road and traffic are made once."""
    return [
        Unit(f"{sequence}/{index}", parameters=(sequence, index), group=str(sequence))
        for sequence, frames in enumerate(recording.plan)
        for index in range(frames)
    ]


def journal_of(recording: RecordingOptions) -> JobJournal:
    """What was written before with these very settings; frames of before there was a journal are entered."""
    setting = json.dumps([recording.preset.said(), recording.seed, recording.sensors, recording.cache])
    path = recording.out / JOURNAL_NAME
    begun = any(path.name not in (SIMULATION_FILE, JOURNAL_NAME) for path in recording.out.iterdir())
    journal = JobJournal(path, setting)
    for unit in units_of(recording) if begun else ():
        if not journal.has(unit) and (paths := _complete(recording, *unit.parameters)):
            files = {path.relative_to(recording.out).as_posix(): mark_of(path) for path in paths}
            journal.add(unit, state_of(unit.sources, setting), files)
    journal.commit()
    return journal


def _complete(recording: RecordingOptions, sequence: int, index: int) -> list[Path]:
    """The files of a frame if all are there, each of which appeared whole or not at all; else none."""
    from farfield.simulation.sequence import planned_frame

    frame = planned_frame(
        recording.preset, seed=recording.seed, sequence=sequence, index=index, sensors=recording.sensors
    )
    writer = writer_for(recording.preset, recording.out)
    paths = writer.paths(frame)
    if not all(path.is_file() for path in paths.values()):
        return []
    if not recording.cache:
        return [*paths.values()]
    from farfield.datasets.cloud_files import cache_path, is_fresh

    cached = {paths[name]: cache_path(paths[name], writer.root) for name in frame.clouds if name in paths}
    fresh = all(is_fresh(cache, path) for path, cache in cached.items())
    return [*paths.values(), *cached.values()] if fresh else []


def bytes_needed(recording: RecordingOptions, count: int) -> float:
    """How many bytes so many frames take at most."""
    preset = recording.preset
    lines = dict.fromkeys((*PATTERNS, "lidar"), preset.lines) | OUSTER_LINES
    shots = {name: count * preset.columns for name, count in lines.items()}
    sizes = [_BYTES[name] if name in _BYTES else shots[name] * _BYTES_PER_SHOT[name] for name in recording.sensors]
    return count * (sum(sizes) + 20_000) * (_CACHED if recording.cache else 1.0)


def check_disk(recording: RecordingOptions, count: int) -> None:
    """Refuse to begin what cannot be finished.

    Raises:
        DatasetError: If the folder's disk has less room than the frames need.
    """
    free, needed = shutil.disk_usage(recording.out).free, bytes_needed(recording, count)
    if round(needed) > free:
        raise DatasetError(
            f"{recording.out}: {count} frames need about {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are free. Write "
            "fewer frames (--frames), fewer sensors (--sensors), or to another disk."
        )


@dataclass(frozen=True)
class Simulate:
    """Simulates and writes a frame; its value says what the checksum says of it, if there is one.

    Args:
        recording: What is written where.
        memory_bytes: What a worker needs at most.
    """

    recording: RecordingOptions
    memory_bytes: int = field(init=False)

    def __post_init__(self) -> None:
        radar = _RADAR_SENSORS & {*self.recording.sensors}
        object.__setattr__(self, "memory_bytes", _RADAR_WORKER_BYTES if radar else _WORKER_BYTES)

    def __call__(self, unit: Unit) -> UnitResult:
        """Simulate one frame.

        Raises:
            DatasetError: If the disk is full; what was written stays.
        """
        from farfield.simulation.sequence import simulate_frame

        wanted, (sequence, index) = self.recording, unit.parameters
        frame = simulate_frame(wanted.preset, seed=wanted.seed, sequence=sequence, index=index, sensors=wanted.sensors)
        try:
            files = write_whole(wanted.preset, frame, wanted.out, cache=wanted.cache)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise DatasetError(
                f"{wanted.out}: the disk is full. The frames written so far are whole and stay; make room and run the "
                "same command again to go on."
            ) from error
        return UnitResult(files=files, value=_verdict(wanted, frame, sequence, index) if wanted.frozen else None)


def _verdict(recording: RecordingOptions, frame: "Frame", sequence: int, index: int) -> str:
    from farfield.simulation.frozen import compare, frame_record, frozen_records

    return compare(frame_record(frame), frozen_records(recording.preset.name)[sequence, index])
