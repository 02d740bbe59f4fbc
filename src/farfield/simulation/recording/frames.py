"""A recording's folder and its frames as units of work: claim, journal, disk room, simulating and writing one."""

import errno
import json
import os
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import DatasetError, plain
from farfield.files.atomic import move_into_place, read_bytes, write_text
from farfield.files.json_text import plain_json
from farfield.files.marks import mark_of
from farfield.files.sizes import room
from farfield.frame.provenance import SIMULATION_FILE, SIMULATION_JOURNAL
from farfield.jobs import JobJournal, Unit, UnitResult
from farfield.jobs.folders import STAGING
from farfield.jobs.journal import state_of
from farfield.simulation.recording.options import Recording
from farfield.simulation.rig import RIGS
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import OUSTER_LINES
from farfield.vocabulary.patterns import PATTERNS

if TYPE_CHECKING:
    from farfield.datasets import Dataset
    from farfield.frame import Frame
    from farfield.simulation import Preset

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
_CACHE_FACTOR = 1.6  # bytes with the binary cache over bytes without


_WORKER_BYTES, _RADAR_WORKER_BYTES = 600_000_000, 1_500_000_000
_RADAR_SENSORS = {"cells", "sparse", "polar3d", "cube", "tesseract"}


def recorded_frames(folder: Path, data: "Dataset") -> int:
    """How many frames are read from a file that ``farfield simulate`` wrote there, by its journal: by names and sizes.

    All of them where the journal was not copied along.

    Args:
        folder: The recording.
        data: Its frames.

    Raises:
        FileFormatError: If the journal is damaged.
    """
    path = folder / SIMULATION_JOURNAL
    if not path.is_file() or not data.stored:
        return len(data)
    sizes = JobJournal(path).file_sizes()
    root = folder.absolute()
    recorded = 0
    for index in range(len(data)):
        files = [file.absolute() for file in data.files(index) if file.absolute().is_relative_to(root)]
        recorded += any(
            sizes.get(file.relative_to(root).as_posix()) == file.stat().st_size for file in files if file.is_file()
        )
    return recorded


def claim(recording: Recording) -> None:
    """Claim the folder for these settings, or make sure that it was claimed for the same ones.

    Sensors and frames may be added later: what a sensor measures does not depend on the others.

    Raises:
        DatasetError: If the folder holds something else.
    """
    out, sensors = recording.out, set(recording.sensors)
    settings = json.loads(json.dumps({"seed": recording.seed, "preset": recording.preset.as_json()}))
    settings |= {"raw": True} if recording.raw else {}
    record = out / SIMULATION_FILE
    before: set[str] = set()
    if record.is_file():
        sequences, before = _claimed(record, settings, recording)
        if sequences >= len(recording.plan) and before >= sensors:
            return
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise DatasetError(f"{out}: expected an empty or absent folder, or one that farfield simulate began")
    out.mkdir(parents=True, exist_ok=True)
    settings["sensors"] = sorted(before | sensors)
    settings["sequences"] = [
        _sequence_record(recording.preset, recording.seed, sequence) for sequence in range(len(recording.plan))
    ]
    write_text(record, json.dumps(settings, indent=1) + "\n")


def _claimed(record: Path, settings: dict[str, Any], recording: Recording) -> tuple[int, set[str]]:
    """Sequences and sensors for which a folder was claimed before, with the same settings."""
    try:
        claimed = plain_json(read_bytes(record))
        count = len(claimed.pop("sequences", []))
        before = set(claimed.pop("sensors", []))
    except (ValueError, AttributeError, TypeError) as error:
        raise DatasetError(f"{record}: expected the settings of a simulation, found: {plain(error)}") from error
    if claimed != settings:
        differ = sorted(key for key in settings | claimed if claimed.get(key) != settings.get(key))
        raise DatasetError(
            f"{recording.out}: expected a data set of preset {recording.preset.name}, seed {recording.seed}, with "
            f"the same settings; {record.name} there differs in: {', '.join(differ) or 'its keys'}. "
            "Name another folder, or remove this one."
        )
    return count, before


def _sequence_record(preset: "Preset", seed: int, sequence: int) -> dict[str, Any]:
    """What was drawn for a sequence: its weather with all rates and coverages, its sensors' offsets."""
    from farfield.simulation.rigs.drive import drive_of

    drive = drive_of(preset, seed, sequence)
    mounting = drive.mounting
    return {
        "name": drive.segment.name,
        "road": drive.segment.road,
        "weather": {k: round(v, 6) if isinstance(v, float) else v for k, v in asdict(drive.weather).items()},
        "lidar_height_m": round(float(mounting.ego_T_lidar[2, 3]), 6),
        "uniform_offset_ms": round(1000 * mounting.uniform_offset_s, 6),
        "radar_offset_ms": round(1000 * mounting.radar_offset_s, 6),
    }


def units_of(recording: Recording) -> list[Unit]:
    """One unit a frame; those of a sequence go together, for its road and traffic are made once."""
    return [
        Unit(f"{sequence}/{index}", parameters=(sequence, index), group=str(sequence))
        for sequence, frames in enumerate(recording.plan)
        for index in range(frames)
    ]


def journal_of(recording: Recording) -> JobJournal:
    """What was written before with these very settings; frames of before there was a journal are entered."""
    setting = json.dumps([recording.preset.as_json(), recording.seed, recording.sensors, recording.cache])
    path = recording.out / SIMULATION_JOURNAL
    begun = any(path.name not in (SIMULATION_FILE, SIMULATION_JOURNAL) for path in recording.out.iterdir())
    journal = JobJournal(path, setting)
    for unit in units_of(recording) if begun else ():
        if not journal.has(unit) and (paths := _complete(recording, *unit.parameters)):
            files = {path.relative_to(recording.out).as_posix(): mark_of(path) for path in paths}
            journal.add(unit, state_of(unit.sources, setting), files)
    journal.commit()
    return journal


def _complete(recording: Recording, sequence: int, index: int) -> list[Path]:
    """The files of a frame if all are there, each of which appeared whole or not at all; else none."""
    from farfield.simulation.sequence import planned_frame

    frame = planned_frame(
        recording.preset, seed=recording.seed, sequence=sequence, index=index, sensors=recording.sensors
    )
    writer = RIGS[recording.preset.rig].writer(recording.out, recording.preset)
    paths = writer.paths(frame)
    if not all(path.is_file() for path in paths.values()):
        return []
    if not recording.cache:
        return [*paths.values()]
    from farfield.frame.cloud import cache_path, is_fresh

    caches = {paths[name]: cache_path(paths[name], writer.root) for name in frame.clouds if name in paths}
    fresh = all(is_fresh(cache, path) for path, cache in caches.items())
    return [*paths.values(), *caches.values()] if fresh else []


def bytes_needed(recording: Recording, count: int) -> float:
    """How many bytes so many frames take at most."""
    preset = recording.preset
    lines = dict.fromkeys((*PATTERNS, "lidar"), preset.lines) | OUSTER_LINES
    shots = {name: count * preset.columns for name, count in lines.items()}
    sizes = [_BYTES[name] if name in _BYTES else shots[name] * _BYTES_PER_SHOT[name] for name in recording.sensors]
    return count * (sum(sizes) + 20_000) * (_CACHE_FACTOR if recording.cache else 1.0)


def check_disk(recording: Recording, count: int) -> None:
    """Refuse to begin what cannot be finished.

    Raises:
        DatasetError: If the folder's disk has less room than the frames need.
    """
    free, needed = shutil.disk_usage(recording.out).free, bytes_needed(recording, count)
    if round(needed) > free:
        raise DatasetError(
            f"{recording.out}: for {count_of(count, 'frame')} about "
            f"{room(needed, free)}. Write fewer frames (--frames), fewer "
            "sensors (--sensors), or to another disk."
        )


@dataclass(frozen=True)
class Simulate:
    """Simulates and writes a frame; its value says what the checksum says of it, if there is one.

    Args:
        recording: What is written where.
        memory_bytes: What a worker needs at most.
    """

    recording: Recording
    memory_bytes: int = field(init=False)

    def __post_init__(self) -> None:
        radar = _RADAR_SENSORS & {*self.recording.sensors}
        object.__setattr__(self, "memory_bytes", _RADAR_WORKER_BYTES if radar else _WORKER_BYTES)

    def __call__(self, unit: Unit) -> UnitResult:
        """Simulate one frame.

        Raises:
            DatasetError: If the disk is full; what was written stays.
        """
        from farfield.simulation.frozen import compare, frame_record, frozen_records
        from farfield.simulation.sequence import simulate_frame

        recording = self.recording
        sequence, index = unit.parameters
        frame = simulate_frame(
            recording.preset, seed=recording.seed, sequence=sequence, index=index, sensors=recording.sensors
        )
        try:
            files = write_whole(recording.preset, frame, recording.out, cache=recording.cache)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise DatasetError(
                f"{recording.out}: the disk is full. The frames written so far are whole and stay; make room and run "
                "the same command again to go on."
            ) from error
        if not recording.frozen:
            return UnitResult(files=files)
        verdict = compare(frame_record(frame), frozen_records(recording.preset.name)[sequence, index])
        return UnitResult(files=files, value=verdict)


# Folders whose files are moved last, in this order.
_LABELS = ("dataset1_annotation", "info_label", "KRadar_revised_visibility", "label_2", "frame_record")


def write_whole(preset: "Preset", frame: "Frame", out: Path, *, cache: bool = False) -> tuple[Path, ...]:
    """Write a frame beside the data set, then move its files to their places, the labels last.

    Args:
        preset: What the frame was simulated with; its rig says which layout is written.
        frame: The frame.
        out: Folder of the data set.
        cache: Also write the binary cache of its clouds.

    Returns:
        Its files.
    """
    staging = out / f"{STAGING}{os.getpid()}"
    shutil.rmtree(staging, ignore_errors=True)
    try:
        writer = RIGS[preset.rig].writer(staging, preset)
        paths = writer.write(frame)
        written = [*paths.values()]
        if cache:
            from farfield.frame.cloud import write_rows_cache

            written += [write_rows_cache(paths[name], writer.root) for name in frame.clouds]
        files = [path for path in sorted(staging.rglob("*")) if path.is_file()]
        for path in sorted(files, key=_label_rank):
            target = out / path.relative_to(staging)
            target.parent.mkdir(parents=True, exist_ok=True)
            move_into_place(path, target)
        return tuple(out / path.relative_to(staging) for path in written)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _label_rank(path: Path) -> int:
    """Order in which files are moved: labels, by which readers count frames, come last."""
    return max((_LABELS.index(part) + 1 for part in path.parts if part in _LABELS), default=0)
