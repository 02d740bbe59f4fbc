"""Record the raw streams of simulated drives: resumable, with several processes, a ROS 2 bag a drive."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import ConfigError, DatasetError
from farfield.jobs import JobJournal, JobOptions, run
from farfield.jobs.runs import Progress
from farfield.simulation.recording.frames import JOURNAL_NAME
from farfield.simulation.recording.planning import frames_of_sequences
from farfield.simulation.recording.raw.parts import RecordStreams, bag_folder, kinds_of, parts_of, streams_of, units_of
from farfield.simulation.recording.raw.truth import truth_path, write_truth
from farfield.simulation.recording.settings import RecordingOptions, claim

if TYPE_CHECKING:
    from farfield.simulation import Preset

PERIOD_S = 0.1
_POINT_BYTES, _REST_BYTES = 21, 60_000  # a point of a cloud; pictures, IMUs and poses of a tenth of a second


@dataclass(frozen=True, kw_only=True)
class RawRecorded:
    """What a raw recording wrote.

    Args:
        recording: What was asked for, with all defaults resolved.
        written: How many files of bags were written now.
        bags: The bags, a drive each.
        truths: What is known of each, JSON.
    """

    recording: RecordingOptions
    written: int
    bags: tuple[Path, ...]
    truths: tuple[Path, ...]


def record_streams(
    preset: "str | Preset",
    out: Path | str,
    *,
    sweeps: int | None = None,
    sequences: int | None = None,
    sensors: str | Sequence[str] | None = None,
    weather: str | None = None,
    time: str | None = None,
    seed: int | None = None,
    uniform_offset_ms: float | None = None,
    workers: int = 0,
    engine: str = "local",
    dry_run: bool = False,
    progress: Progress = iter,
    report: Callable[[str], object] | None = None,
) -> RawRecorded:
    """Record the raw streams of the Cirrus car.

    Two LiDARs at 10 Hz and a GPS at 1 Hz, fired by its pulses; a camera at 30 Hz (320 pixels wide, JPEG) and two IMUs
    at 100 Hz that run freely; the car's pose at 20 Hz in ``/tf``. Every sensor stamps by a clock of its own, with its
    own offset, drift and jitter, and the computer records by another; beside each bag stands the truth. Called again,
    it goes on where it stopped.

    Args:
        preset: A preset of the Cirrus car or its name.
        out: Folder to write into; made if absent. Each drive has a bag of its name there, in files of 5 seconds.
        sweeps: Sweeps of each LiDAR in all, 10 a second, spread evenly over the drives; the preset's frames if None.
        sequences: Number of drives; the preset's own if None.
        sensors: Which of gaussian, uniform and camera are recorded, as names or as one text with commas; all if None.
        weather: Put every drive into this weather.
        time: Put every drive into this time of day, "day" or "night".
        seed: The preset's own if None.
        uniform_offset_ms: How much later the uniform pattern is taken, in every drive.
        workers: Processes; 0 takes as many as there are cores, files and memory for.
        engine: Where the drives are simulated: a name of ``farfield.jobs.ENGINES``.
        dry_run: Say what would be done, and do nothing.
        progress: Wraps the numbers of the files that are left, to show progress.
        report: Called with each line of what is going to be done and what was done.

    Raises:
        ConfigError: If the preset is not of the Cirrus car or is frozen, or the settings do not go together.
        DatasetError: If the folder holds something else, or the disk has no room.
        MissingExtraError: If rosbags is not installed.
        BulkError: If the memory does not suffice for so many workers, or files killed their workers twice.
    """
    from farfield.files.ros_messages import store
    from farfield.simulation.presets import CIRRUS_SENSORS, check_sensors

    store()  # says at once if rosbags is missing
    changes: dict[str, Any] = {"weather": weather, "time": time}
    if uniform_offset_ms is not None:
        changes["uniform_offset_ms"] = (uniform_offset_ms, uniform_offset_ms)
    chosen = _chosen(preset, {name: value for name, value in changes.items() if value is not None})
    named = sensors.replace(" ", "").split(",") if isinstance(sensors, str) and sensors else sensors
    recording = RecordingOptions(
        preset=chosen,
        seed=chosen.seed if seed is None else seed,
        sensors=check_sensors(chosen, tuple(named or CIRRUS_SENSORS)),
        plan=frames_of_sequences(chosen, sweeps, sequences, frozen=False),
        out=Path(out),
        raw=True,
    )
    if dry_run:
        count = len(units_of(recording))
        _announce(recording, count, count, report or _silent)
        (report or _silent)(f"{recording.out} gets what it has not yet; nothing is written now")
        return RawRecorded(recording=recording, written=0, bags=(), truths=())
    bulk = JobOptions(workers=workers, engine=engine, progress=progress)
    return _run(recording, bulk, report or _silent)


def _chosen(preset: "str | Preset", changes: dict[str, Any]) -> "Preset":
    from farfield.simulation import find_preset
    from farfield.simulation.frozen import FROZEN

    chosen = find_preset(preset, **changes) if isinstance(preset, str) else preset
    if chosen.rig != "cirrus" or chosen.name in FROZEN:
        raise ConfigError(
            f"--recording: expected a preset of the Cirrus car, not frozen, such as cirrus-sim; got {chosen.name}"
        )
    return replace(chosen, stride_s=PERIOD_S)


def _run(recording: RecordingOptions, bulk: JobOptions, report: Callable[[str], object]) -> RawRecorded:
    claim(recording)
    units, work = units_of(recording), RecordStreams(recording)
    setting = json.dumps([asdict(recording.preset), recording.seed, recording.sensors, recording.plan])
    journal = JobJournal(recording.out / JOURNAL_NAME, setting)
    left = sum(not journal.has(unit) for unit in units)
    _announce(recording, left, len(units), report)
    if left:
        _check_room(recording, left / len(units))
        _clear(recording)
    outcome = run(work, units, bulk, journal=journal)
    bags, truths = [], []
    for sequence, sweeps in enumerate(recording.plan):
        bags.append(bag_folder(recording, sequence))
        truths.append(truth_path(recording, sequence))
        _finish(recording, journal, sequence, sweeps)
    journal.finish()
    report(f"wrote {outcome.written} files, {len(bags)} bags and what is known of them into {recording.out}")
    return RawRecorded(recording=recording, written=outcome.written, bags=tuple(bags), truths=tuple(truths))


def _announce(recording: RecordingOptions, left: int, count: int, report: Callable[[str], object]) -> None:
    report(
        f"preset {recording.preset.name}, seed {recording.seed}: {sum(recording.plan) * PERIOD_S:g} s of raw streams "
        f"in {len(recording.plan)} bags, {left} of {count} files still to write"
    )
    room = f"at most {_bytes_needed(recording, left / count) / 1e9:.2f} GB"
    report(f"  {', '.join(streams_of(recording))}; {room}; into {recording.out}")


def _bytes_needed(recording: RecordingOptions, share: float) -> float:
    preset = recording.preset
    sweep = sum(name != "camera" for name in recording.sensors) * preset.lines * preset.columns * _POINT_BYTES
    return share * sum(recording.plan) * (sweep + _REST_BYTES)


def _check_room(recording: RecordingOptions, share: float) -> None:
    """Refuse to begin what cannot be finished.

    Args:
        recording: What is written where.
        share: Part of the files that is left.

    Raises:
        DatasetError: If the folder's disk has less room than the files need.
    """
    needed = _bytes_needed(recording, share)
    free = shutil.disk_usage(recording.out).free
    if needed > free:
        raise DatasetError(
            f"{recording.out}: {sum(recording.plan)} sweeps need about {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are "
            "free. Record less (--frames), fewer sensors (--sensors), or to another disk."
        )


def _clear(recording: RecordingOptions) -> None:
    """Take away what would make an unfinished folder a bag, and files of a longer recording."""
    for sequence, sweeps in enumerate(recording.plan):
        folder = bag_folder(recording, sequence)
        (folder / "metadata.yaml").unlink(missing_ok=True)
        kept = {f"{folder.name}_{part}.mcap" for part in range(parts_of(sweeps))}
        for path in folder.glob("*.mcap") if folder.is_dir() else ():
            if path.name not in kept:
                path.unlink()


def _finish(recording: RecordingOptions, journal: JobJournal, sequence: int, sweeps: int) -> None:
    """The truth of a drive, then what makes its files a bag."""
    from farfield.files.bag_writing import write_bag_metadata

    parts = journal.values([f"{sequence}/{part}" for part in range(parts_of(sweeps))])
    write_truth(recording, sequence)
    write_bag_metadata(bag_folder(recording, sequence), kinds_of(recording), list(parts))


def _silent(line: str) -> None:
    """Say nothing."""
