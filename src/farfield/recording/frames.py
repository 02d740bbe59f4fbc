"""Which frames of a recording are missing, how much room they need, and simulating them."""

import errno
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from farfield.errors import DatasetError
from farfield.recording.rigs import writer_for
from farfield.recording.settings import Recording
from farfield.recording.writing import write_whole
from farfield.vocabulary.kradar import OUSTER_LINES
from farfield.vocabulary.patterns import PATTERNS

if TYPE_CHECKING:
    from farfield.frame import Frame

_BLOCK = 10  # frames a job of a worker

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
}
_BYTES_PER_SHOT = {"gaussian": 70, "uniform": 70, "os2-64": 80, "os1-128": 80}
_CACHED = 1.6  # bytes with the binary cache over bytes without


@dataclass(frozen=True)
class Job:
    """Frames of one sequence for one worker."""

    recording: Recording
    sequence: int
    indices: tuple[int, ...]


def missing_jobs(recording: Recording) -> Iterator[Job]:
    """Blocks of frames that are not complete yet."""
    for sequence, frames in enumerate(recording.plan):
        missing = [index for index in range(frames) if not _complete(recording, sequence, index)]
        for first in range(0, len(missing), _BLOCK):
            yield Job(recording, sequence, tuple(missing[first : first + _BLOCK]))


def _complete(recording: Recording, sequence: int, index: int) -> bool:
    """Whether all files of a frame are there; each appeared whole or not at all."""
    from farfield.simulation.sequence import planned_frame

    frame = planned_frame(
        recording.preset, seed=recording.seed, sequence=sequence, index=index, sensors=recording.sensors
    )
    writer = writer_for(recording.preset, recording.out)
    paths = writer.paths(frame)
    if not all(path.is_file() for path in paths.values()):
        return False
    if not recording.cache:
        return True
    from farfield.datasets.cloud_files import cache_path, is_fresh

    return all(is_fresh(cache_path(paths[name], writer.root), paths[name]) for name in frame.clouds if name in paths)


def bytes_needed(recording: Recording, count: int) -> float:
    """How many bytes so many frames take at most."""
    preset = recording.preset
    lines = dict.fromkeys(PATTERNS, preset.lines) | OUSTER_LINES
    shots = {name: count * preset.columns for name, count in lines.items()}
    sizes = [_BYTES[name] if name in _BYTES else shots[name] * _BYTES_PER_SHOT[name] for name in recording.sensors]
    return count * (sum(sizes) + 20_000) * (_CACHED if recording.cache else 1.0)


def check_disk(recording: Recording, count: int) -> None:
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


def simulate_job(job: Job) -> Iterator[str]:
    """Simulate and write the frames of one job; yields what the checksum says of each ("written" if there is none).

    Raises:
        DatasetError: If the disk is full; what was written stays.
    """
    from farfield.simulation.sequence import simulate_frame

    wanted = job.recording
    for index in job.indices:
        frame = simulate_frame(
            wanted.preset, seed=wanted.seed, sequence=job.sequence, index=index, sensors=wanted.sensors
        )
        try:
            write_whole(wanted.preset, frame, wanted.out, cache=wanted.cache)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise DatasetError(
                f"{wanted.out}: the disk is full. The frames written so far are whole and stay; make room and run the "
                "same command again to go on."
            ) from error
        yield _verdict(job, frame, index) if wanted.frozen else "written"


def _verdict(job: Job, frame: "Frame", index: int) -> str:
    from farfield.simulation.frozen import compare, frame_record, frozen_records

    return compare(frame_record(frame), frozen_records(job.recording.preset.name)[job.sequence, index])
