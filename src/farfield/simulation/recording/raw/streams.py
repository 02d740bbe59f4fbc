"""Record the raw streams of simulated drives: resumable, with several processes, a ROS 2 bag a drive.

A unit of work is one file of a bag: all messages that were recorded within some seconds. Beside each bag stands what is
true of the drive, as JSON: times, clocks, poses, errors of the IMUs.
"""

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.errors import DatasetError
from farfield.files.atomic import write_text
from farfield.files.sizes import room, sized
from farfield.frame.provenance import SIMULATION_JOURNAL
from farfield.jobs import JobJournal, JobOptions, Unit, UnitResult, run
from farfield.jobs.folders import STAGING, held
from farfield.jobs.runs import Progress
from farfield.simulation.recording.frames import claim
from farfield.simulation.recording.options import SWEEP_PERIOD_S, Recording, RecordingOptions, silent
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.simulation import Preset
    from farfield.simulation.recording.raw.clocks import Schedule, SensorStream
    from farfield.simulation.rigs.drive import SimulatedDrive

PART_S = 5.0
"""So many seconds stand in one file of a bag."""
BASE, WORLD = "base_link", "map"
STATIC = "tf_static"
POSE_STEP_S = 0.02
_POINT_BYTES, _REST_BYTES = 21, 60_000  # a point of a cloud; pictures, IMUs and poses of a tenth of a second


@dataclass(frozen=True, kw_only=True)
class RawRecorded:
    """What a raw recording wrote.

    Args:
        recording: What was recorded, with all defaults resolved.
        written: How many files of bags were written now.
        bags: The bags, a drive each.
        truths: The true times, clocks and poses of each, JSON.
    """

    recording: Recording
    written: int
    bags: tuple[Path, ...]
    truths: tuple[Path, ...]


def record_streams(
    preset: "str | Preset",
    out: Path | str,
    *,
    sweeps: int | None = None,
    progress: Progress = iter,
    report: Callable[[str], object] | None = None,
    **options: Any,
) -> RawRecorded:
    """Record the raw streams of the Cirrus car.

    Called again, it resumes where it stopped: a file of a bag appears whole or not at all.

    Args:
        preset: A preset of the Cirrus car or its name.
        out: Folder to write into; made if absent.
        sweeps: Sweeps of each LiDAR in all, 10 a second, spread evenly over the drives; the preset's own if None.
        progress: Wraps the numbers of the files that are left, to show progress.
        report: Called with each line of what is going to be done and what was done.
        **options: Fields of :class:`~farfield.simulation.recording.RecordingOptions`.

    Raises:
        ConfigError: If the preset is not of the Cirrus car or is frozen, or the options do not go together.
        DatasetError: If the folder holds something else, or the disk has no room.
        MissingExtraError: If rosbags is not installed.
        BulkError: If the memory does not suffice for so many workers, or files killed their workers twice.
    """
    from farfield.files.bag_writing import store

    report = report or silent
    store()  # fails at once if rosbags is missing
    chosen = RecordingOptions(frames=sweeps, recording=True, **options)
    recording = chosen.resolve(preset, Path(out))
    units, work = units_of(recording), RecordStreams(recording)
    if chosen.dry_run:
        _announce(recording, len(units), len(units), report)
        report(f"{recording.out} gets what it has not yet; nothing is written now")
        return RawRecorded(recording=recording, written=0, bags=(), truths=())
    with held(recording.out):
        # claim the folder, and find what is left to do
        claim(recording)
        setting = json.dumps([asdict(recording.preset), recording.seed, recording.sensors, recording.plan])
        journal = JobJournal(recording.out / SIMULATION_JOURNAL, setting)
        missing = sum(not journal.has(unit) for unit in units)
        _announce(recording, missing, len(units), report)
        if missing:
            _check_room(recording, missing / len(units))
            _clear(recording)
        # simulate and write the files that are missing
        jobs = JobOptions(workers=chosen.workers, engine=chosen.engine, address=chosen.address, progress=progress)
        outcome = run(work, units, jobs, journal=journal)
        # the truth of each drive, then what makes its files a bag
        bags, truths = [], []
        for sequence, sweeps in enumerate(recording.plan):
            bags.append(bag_folder(recording, sequence))
            truths.append(truth_path(recording, sequence))
            _finish(recording, journal, sequence, sweeps)
        journal.finish()
    report(
        f"wrote {count_of(outcome.written, 'file')}, {count_of(len(bags), 'bag')} "
        f"and what is known of them into {recording.out}"
    )
    return RawRecorded(recording=recording, written=outcome.written, bags=tuple(bags), truths=tuple(truths))


def _announce(recording: Recording, missing: int, count: int, report: Callable[[str], object]) -> None:
    report(
        f"preset {recording.preset.name}, seed {recording.seed}: {sum(recording.plan) * SWEEP_PERIOD_S:g} s of raw "
        f"streams in {count_of(len(recording.plan), 'bag')}, {missing} of {count_of(count, 'file')} still to write"
    )
    most = sized(_bytes_needed(recording, missing / count))
    report(f"  {', '.join(streams_of(recording))}; at most {most}; into {recording.out}")


def _bytes_needed(recording: Recording, share: float) -> float:
    preset = recording.preset
    sweep = sum(name != "camera" for name in recording.sensors) * preset.lines * preset.columns * _POINT_BYTES
    return share * sum(recording.plan) * (sweep + _REST_BYTES)


def _check_room(recording: Recording, share: float) -> None:
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
            f"{recording.out}: for {count_of(sum(recording.plan), 'sweep')} "
            f"about {room(needed, free)}. Record less (--frames), "
            "fewer sensors (--sensors), or to another disk."
        )


def _clear(recording: Recording) -> None:
    """Remove what would make an unfinished folder a bag, and files of a longer recording."""
    for sequence, sweeps in enumerate(recording.plan):
        folder = bag_folder(recording, sequence)
        (folder / "metadata.yaml").unlink(missing_ok=True)
        names = {f"{folder.name}_{part}.mcap" for part in range(parts_of(sweeps))}
        for path in folder.glob("*.mcap") if folder.is_dir() else ():
            if path.name not in names:
                path.unlink()


def _finish(recording: Recording, journal: JobJournal, sequence: int, sweeps: int) -> None:
    """The truth of a drive, then what makes its files a bag."""
    from farfield.files.bag_writing import write_bag_metadata

    parts = journal.values([f"{sequence}/{part}" for part in range(parts_of(sweeps))])
    write_truth(recording, sequence)
    write_bag_metadata(bag_folder(recording, sequence), kinds_of(recording), list(parts))


def parts_of(sweeps: int) -> int:
    """How many files the bag of a drive of so many sweeps has."""
    return max(1, int(np.ceil(sweeps / 10 / PART_S - 1e-9)))


def units_of(recording: Recording) -> list[Unit]:
    """One unit a file; those of a drive go together, for its world is made once."""
    return [
        Unit(f"{sequence}/{part}", parameters=(sequence, part), group=str(sequence))
        for sequence, sweeps in enumerate(recording.plan)
        for part in range(parts_of(sweeps))
    ]


def bag_folder(recording: Recording, sequence: int) -> Path:
    """The folder of a drive's bag."""
    return recording.out / recording.preset.segment(sequence).name


def streams_of(recording: Recording) -> tuple[str, ...]:
    """The streams that are recorded: the sensors of the recording, and what every car has."""
    from farfield.simulation.recording.raw.clocks import KINDS

    return tuple(name for name in KINDS if name in recording.sensors or name not in ("gaussian", "uniform", "camera"))


def kinds_of(recording: Recording) -> dict[str, str]:
    """Type of the messages of each topic."""
    from farfield.files import bag_writing as ros

    special = {"camera": ros.COMPRESSED, "gps": ros.FIX, "tf": ros.TRANSFORMS}
    kinds = {
        f"/{name}": special.get(name, ros.IMU if name.startswith("imu") else ros.CLOUD)
        for name in streams_of(recording)
    }
    return {**kinds, f"/{STATIC}": ros.TRANSFORMS}


@dataclass(frozen=True)
class RecordStreams:
    """Simulates and writes one file of a bag; its value tells what is in it.

    Args:
        recording: What is written where; its plan counts sweeps.
    """

    recording: Recording
    memory_bytes: int = field(default=700_000_000, init=False)

    def __call__(self, unit: Unit) -> UnitResult:
        """Write one file.

        Raises:
            DatasetError: If the disk is full; what was written stays.
        """
        from farfield.files.bag_writing import write_bag_part
        from farfield.simulation.recording.raw.clocks import schedule
        from farfield.simulation.rigs.drive import drive_of

        recording = self.recording
        sequence, part = unit.parameters
        drive = drive_of(recording.preset, recording.seed, sequence)
        plan = schedule(drive, recording.plan[sequence], streams_of(recording))
        folder = bag_folder(recording, sequence)
        path = folder / f"{folder.name}_{part}.mcap"
        staging = recording.out / f"{STAGING}{os.getpid()}"
        messages = _messages(drive, plan, part, parts_of(recording.plan[sequence]))
        try:
            value = write_bag_part(path, kinds_of(recording), messages, staging)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise DatasetError(
                f"{recording.out}: the disk is full. The files written so far are whole and stay; make room and run "
                "the same command again to go on."
            ) from error
        return UnitResult(files=(path,), value=value)


def _messages(drive: "SimulatedDrive", plan: "Schedule", part: int, parts: int) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time of recording and bytes of the messages of a file, by time of recording."""
    rows = []
    for name, stream in plan.streams.items():
        part_of_message = np.clip((stream.log_ns - plan.epoch_ns) / (PART_S * 1e9), 0, parts - 1).astype(np.int64)
        rows += [(int(stream.log_ns[row]), name, int(row)) for row in np.flatnonzero(part_of_message == part)]
    maker = _MessageMaker(drive, plan)
    if part == 0:
        yield f"/{STATIC}", plan.epoch_ns - 1_000_000_000, maker.static()
    for log_ns, name, row in sorted(rows):
        yield f"/{name}", log_ns, maker.message(plan.streams[name], row)


class _MessageMaker:
    """Measures and serialises single messages; those of IMU and GPS are measured once for all."""

    def __init__(self, drive: "SimulatedDrive", plan: "Schedule") -> None:
        self.drive, self.plan, self._tables = drive, plan, dict[str, Any]()

    def static(self) -> bytes:
        """Where the sensors sit."""
        from farfield.files.bag_writing import serialised, transforms_message
        from farfield.simulation.recording.raw.measure import mounts

        return serialised(transforms_message(self.plan.epoch_ns, BASE, mounts(self.drive)))

    def message(self, stream: "SensorStream", row: int) -> bytes:
        """One message of a stream."""
        from farfield.files import bag_writing as ros
        from farfield.simulation.recording.raw import measure

        name, drive = stream.name, self.drive
        number, time_s, stamp_ns = int(stream.number[row]), float(stream.time_s[row]), int(stream.stamp_ns[row])
        if name in ("gaussian", "uniform"):
            cloud = measure.cloud_of_sweep(drive, name, number, time_s)
            strength = {} if cloud.intensity is None else {"intensity": cloud.intensity}
            columns = {**dict(zip("xyz", cloud.points_m.T, strict=True)), **strength, **cloud.extra}
            message = ros.cloud_message(columns, stamp_ns, name)
        elif name == "camera":
            message = ros.jpeg_message(measure.RawFrame(drive, number, time_s).picture(), stamp_ns, name)
        elif name == "gps":
            latitude, longitude, height = self._table(stream)[row].tolist()
            message = ros.fix_message(latitude, longitude, height, stamp_ns, name)
        elif name == "tf":
            message = ros.transforms_message(stamp_ns, WORLD, {BASE: measure.ego_poses(drive, stream.time_s[[row]])[0]})
        else:
            table = self._table(stream)
            message = ros.imu_message(table.angular_rad_s[row], table.acceleration_m_s2[row], stamp_ns, name)
        return ros.serialised(message)

    def _table(self, stream: "SensorStream") -> Any:
        from farfield.simulation.recording.raw import measure

        if stream.name not in self._tables:
            samples = (stream.number, stream.time_s)
            self._tables[stream.name] = (
                measure.fixes(self.drive, *samples)
                if stream.name == "gps"
                else measure.imu_measured(self.drive, stream.name, *samples)
            )
        return self._tables[stream.name]


def truth_path(recording: Recording, sequence: int) -> Path:
    """The file beside the bag of a drive."""
    return recording.out / f"{recording.preset.segment(sequence).name}_truth.json"


def truth(recording: Recording, sequence: int) -> dict[str, Any]:
    """All that is true of a drive.

    ``streams`` tells of each stream how its clock reads (``offset_ms`` at ``epoch_ns`` and ``drift_ppm`` against GPS
    time, ``jitter_ms``), when each message was taken (``true_ns``; a sweep when it began), which were lost, and the
    least time on the way to the computer, whose clock is ``computer``. ``poses`` are those of the car,
    ``world_T_base`` as rows of 3 x 4; ``mounts`` where the sensors sit in it.
    """
    from farfield.simulation.recording.raw.clocks import schedule
    from farfield.simulation.recording.raw.measure import ORIGIN_DEG, biases_of, mounts, small_camera
    from farfield.simulation.rigs.drive import drive_of

    drive = drive_of(recording.preset, recording.seed, sequence)
    plan = schedule(drive, recording.plan[sequence], streams_of(recording))
    camera = small_camera()
    return {
        "epoch_ns": plan.epoch_ns,
        "span_s": plan.span_s,
        "computer": asdict(plan.host),
        "streams": {name: stream.truth(plan.epoch_ns) for name, stream in plan.streams.items()},
        "mounts": {name: matrix[:3].ravel().tolist() for name, matrix in mounts(drive).items()},
        "imu_biases": {name: biases_of(drive, name) for name in ("imu_front", "imu_rear")},
        "camera": {"matrix": camera.matrix.ravel().tolist(), "distortion": camera.distortion.tolist()},
        "origin_deg": list(ORIGIN_DEG),
        "poses": _poses(drive, plan.epoch_ns, plan.span_s),
    }


def _poses(drive: "SimulatedDrive", epoch_ns: int, span_s: float) -> dict[str, Any]:
    from farfield.simulation.recording.raw.measure import ego_poses

    time_s = np.arange(round((span_s + 0.2) / POSE_STEP_S) + 1) * POSE_STEP_S
    rows = np.round(ego_poses(drive, time_s)[:, :3].reshape(-1, 12), 9)
    return {"time_ns": (epoch_ns + np.rint(time_s * 1e9).astype(np.int64)).tolist(), "world_T_base": rows.tolist()}


def write_truth(recording: Recording, sequence: int) -> Path:
    """Write it."""
    path = truth_path(recording, sequence)
    write_text(path, json.dumps(truth(recording, sequence)) + "\n")
    return path
