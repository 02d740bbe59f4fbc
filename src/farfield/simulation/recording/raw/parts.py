"""The files of a raw recording as units of work: all messages that were recorded within some seconds."""

import errno
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.errors import DatasetError
from farfield.jobs import Unit, UnitResult
from farfield.jobs.folders import STAGING
from farfield.simulation.recording.settings import RecordingOptions

if TYPE_CHECKING:
    from farfield.simulation.raw.clocks import Schedule, SensorStream
    from farfield.simulation.rigs.drive import SimulatedDrive

PART_S = 5.0
"""So many seconds stand in one file of a bag."""
BASE, WORLD = "base_link", "map"
STATIC = "tf_static"


def parts_of(sweeps: int) -> int:
    """How many files the bag of a drive of so many sweeps has."""
    return max(1, int(np.ceil(sweeps / 10 / PART_S - 1e-9)))


def units_of(recording: RecordingOptions) -> list[Unit]:
    """One unit a file; those of a drive go together, for its world is made once."""
    return [
        Unit(f"{sequence}/{part}", parameters=(sequence, part), group=str(sequence))
        for sequence, sweeps in enumerate(recording.plan)
        for part in range(parts_of(sweeps))
    ]


def bag_folder(recording: RecordingOptions, sequence: int) -> Path:
    """The folder of a drive's bag."""
    return recording.out / recording.preset.segment(sequence).name


def streams_of(recording: RecordingOptions) -> tuple[str, ...]:
    """The streams that are recorded: the sensors that were asked for, and what every car has."""
    from farfield.simulation.raw.clocks import KINDS

    return tuple(name for name in KINDS if name in recording.sensors or name not in ("gaussian", "uniform", "camera"))


def kinds_of(recording: RecordingOptions) -> dict[str, str]:
    """Type of the messages of each topic."""
    from farfield.files import ros_messages as ros

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

    recording: RecordingOptions
    memory_bytes: int = field(default=700_000_000, init=False)

    def __call__(self, unit: Unit) -> UnitResult:
        """Write one file.

        Raises:
            DatasetError: If the disk is full; what was written stays.
        """
        from farfield.files.bag_writing import write_bag_part
        from farfield.simulation.raw.clocks import schedule
        from farfield.simulation.rigs.drive import drive_of

        wanted, (sequence, part) = self.recording, unit.parameters
        drive = drive_of(wanted.preset, wanted.seed, sequence)
        plan = schedule(drive, wanted.plan[sequence], streams_of(wanted))
        folder = bag_folder(wanted, sequence)
        path = folder / f"{folder.name}_{part}.mcap"
        staging = wanted.out / f"{STAGING}{os.getpid()}"
        messages = _messages(drive, plan, part, parts_of(wanted.plan[sequence]))
        try:
            value = write_bag_part(path, kinds_of(wanted), messages, staging)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise DatasetError(
                f"{wanted.out}: the disk is full. The files written so far are whole and stay; make room and run the "
                "same command again to go on."
            ) from error
        return UnitResult(files=(path,), value=value)


def _messages(drive: "SimulatedDrive", plan: "Schedule", part: int, parts: int) -> Any:
    """Topic, time of recording and bytes of the messages of a file, by time of recording."""
    rows = []
    for name, stream in plan.streams.items():
        place = np.clip((stream.log_ns - plan.epoch_ns) / (PART_S * 1e9), 0, parts - 1).astype(np.int64)
        rows += [(int(stream.log_ns[row]), name, int(row)) for row in np.flatnonzero(place == part)]
    made = _MessageMakers(drive, plan)
    if part == 0:
        yield f"/{STATIC}", plan.epoch_ns - 1_000_000_000, made.static()
    for log_ns, name, row in sorted(rows):
        yield f"/{name}", log_ns, made.message(plan.streams[name], row)


class _MessageMakers:
    """Measures and serialises single messages; those of IMU and GPS are measured once for all."""

    def __init__(self, drive: "SimulatedDrive", plan: "Schedule") -> None:
        self.drive, self.plan, self._tables = drive, plan, dict[str, Any]()

    def static(self) -> bytes:
        """Where the sensors sit."""
        from farfield.files.ros_messages import serialised, transforms_message
        from farfield.simulation.raw.measure import mounts

        return serialised(transforms_message(self.plan.epoch_ns, BASE, mounts(self.drive)))

    def message(self, stream: "SensorStream", row: int) -> bytes:
        """One message of a stream."""
        from farfield.files import ros_messages as ros
        from farfield.simulation.raw import measure

        name, drive = stream.name, self.drive
        number, time_s, stamp_ns = int(stream.number[row]), float(stream.time_s[row]), int(stream.stamp_ns[row])
        if name in ("gaussian", "uniform"):
            cloud = measure.cloud_of_sweep(drive, name, number, time_s)
            strength = {} if cloud.intensity is None else {"intensity": cloud.intensity}
            columns = {**dict(zip("xyz", cloud.points_m.T, strict=True)), **strength, **cloud.extra}
            made = ros.cloud_message(columns, stamp_ns, name)
        elif name == "camera":
            made = ros.jpeg_message(measure.RawMoment(drive, number, time_s).picture(), stamp_ns, name)
        elif name == "gps":
            latitude, longitude, height = self._table(stream)[row].tolist()
            made = ros.fix_message(latitude, longitude, height, stamp_ns, name)
        elif name == "tf":
            made = ros.transforms_message(stamp_ns, WORLD, {BASE: measure.ego_poses(drive, stream.time_s[[row]])[0]})
        else:
            table = self._table(stream)
            made = ros.imu_message(table.angular_rad_s[row], table.acceleration_m_s2[row], stamp_ns, name)
        return ros.serialised(made)

    def _table(self, stream: "SensorStream") -> Any:
        from farfield.simulation.raw import measure

        if stream.name not in self._tables:
            given = (stream.number, stream.time_s)
            self._tables[stream.name] = (
                measure.fixes(self.drive, *given)
                if stream.name == "gps"
                else measure.imu_measured(self.drive, stream.name, *given)
            )
        return self._tables[stream.name]
