"""Odometry of a data set: a track of poses a drive, written beside the data, and the drift to expect of each."""

import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from jaxtyping import Float

from farfield.datasets import Dataset
from farfield.errors import ConfigError
from farfield.files.poses_csv import PoseTable, read_poses, write_poses
from farfield.frame import Drive
from farfield.geometry.deskewing import PoseTrack
from farfield.jobs import HERE, JobJournal, JobOptions, Unit, UnitResult, run
from farfield.jobs.journal import state_of
from farfield.odometry.drift import Drift, drift_of, way_m
from farfield.odometry.drives import DriveOdometry, place
from farfield.odometry.odometry import OdometrySettings
from farfield.odometry.sweeps import DriveSweeps, SweepSettings

FORWARD, BACKWARD = "poses", "backward"
_JOURNAL = ".journal.jsonl"
_SAVED = ".checkpoints"
_VERSION = 1


@dataclass(frozen=True)
class OdometryTrack:
    """The track of one drive.

    Args:
        name: Name of the drive.
        table: Its poses; the first sweep stands at the origin, whatever way is up there.
        backward: The same, found backwards; None where that was not done.
        facts: Medians and counts of the sweeps: ``matched``, ``residual_m``, ``information``.
        cpu_ms: Time of the processor a sweep, reading included; None where it was done before.
    """

    name: str
    table: PoseTable
    backward: PoseTable | None
    facts: dict[str, float]
    cpu_ms: float | None = None

    @property
    def way_m(self) -> float:
        """Length of the track; motions that are not known count nothing."""
        steps = np.diff(way_m(self.table.world_T_frame))
        return float(steps[~self.table.begins[1:]].sum()) if len(self.table) else 0.0

    @property
    def drift(self) -> Drift | None:
        """What to expect of it; None where it is shorter than 10 m or was not placed backwards."""
        if self.backward is None:
            return None
        breaks = self.table.begins | np.concatenate([[False], self.backward.begins[:-1]])  # it is named by the earlier
        breaks[:1] = False
        return drift_of(self.table.world_T_frame, self.backward.world_T_frame, breaks)

    @property
    def pose_track(self) -> PoseTrack:
        """The poses as deskewing takes them.

        Raises:
            ConfigError: If the frames have no times, or there are fewer than two.
        """
        if self.table.times_ns is None:
            raise ConfigError(f"drive {self.name}: expected frames with times, which poses at any moment need")
        return PoseTrack(np.array(self.table.times_ns, dtype=np.int64), self.table.world_T_frame)

    @property
    def findings(self) -> tuple[str, ...]:
        """What is wrong with it, in words."""
        blind = Counter(name for name in self.table.blind if name)
        found = [f"{count} sweeps: not observable along {name}, kept as predicted" for name, count in blind.items()]
        lost, begins = int(self.table.lost.sum()), int(self.table.begins[1:].sum())
        found += [f"{lost} sweeps fit nowhere and were placed by the motion before"] if lost else []
        found += [f"{begins} times no motion is known between two sweeps: a new map begins"] if begins else []
        return tuple(found)

    def to_json(self) -> dict[str, Any]:
        """As JSON takes it."""
        drift = self.drift
        known = None if drift is None else {**asdict(drift), "place_percent": drift.place_percent}
        return {
            "drive": self.name,
            "file": f"{FORWARD}/{file_name(self.name)}",
            "sweeps": len(self.table),
            "way_m": round(self.way_m, 3),
            "expected_drift": known,
            "lost": int(self.table.lost.sum()),
            "begins": int(self.table.begins[1:].sum()),
            "blind": dict(sorted(Counter(name for name in self.table.blind if name).items())),
            **self.facts,
            "findings": list(self.findings),
        }


def file_name(drive: str) -> str:
    """Name of a drive's file, whatever its name."""
    return f"{quote(drive, safe='').replace('.', '%2E') or '%'}.csv"


@dataclass(frozen=True)
class OdometryTask:
    """The work of one unit: a drive, in one direction.

    Args:
        data: The data set.
        out: The folder to write into.
        sweeps: Which points.
        odometry: Settings of the odometry.
    """

    data: Dataset
    out: Path
    sweeps: SweepSettings
    odometry: OdometrySettings
    memory_bytes: int = 600_000_000

    @property
    def setting(self) -> str:
        """All that decides the result besides the files."""
        maps = self.data.recipe
        return f"odometry {_VERSION} {asdict(self.sweeps)} {asdict(self.odometry)} {maps['options']} {maps['maps']}"

    def __call__(self, unit: Unit) -> UnitResult:
        """Place the sweeps and write their poses."""
        drive, kind = unit.parameters
        began = time.process_time()
        path = self.out / kind / file_name(drive.name)
        saved = self.out / _SAVED / f"{kind}-{path.stem}.npz"
        sweeps = DriveSweeps(self.data, drive, self.sweeps, backward=kind == BACKWARD)
        placed = place(sweeps, self.odometry, saved=saved, mark=state_of(unit.sources, self.setting))
        reference = self.data[int(drive.indices[0])].reference
        path.parent.mkdir(parents=True, exist_ok=True)
        write_poses(path, _table(drive, placed, reference, backward=kind == BACKWARD))
        saved.unlink(missing_ok=True)
        fitted = ~(placed.lost | placed.begins)
        names = ("matched", "residual_m", "information")
        medians = {f"median_{name}": _median(getattr(placed, name)[fitted]) for name in names}
        clock = 1e3 * (time.process_time() - began) / max(len(placed), 1)
        return UnitResult(files=(path,), value=medians, clock=clock)


def _median(values: Float[np.ndarray, " n"]) -> float:
    return round(float(np.median(values)), 6) if len(values) else 0.0


def _table(drive: Drive, placed: DriveOdometry, reference: str, *, backward: bool) -> PoseTable:
    """The poses of a drive in the order of time, from its first sweep."""
    order = slice(None, None, -1 if backward else 1)
    poses = placed.world_T_sensor[order]
    states = np.where(placed.begins, "begins", np.where(placed.lost, "lost", "placed"))[order]
    return PoseTable(
        sequence=drive.keys[0][0],
        frames=tuple(key[1] for key in drive.keys),
        reference=reference,
        times_ns=None if drive.times_ns is None else tuple(drive.times_ns.tolist()),
        world_T_frame=np.linalg.inv(poses[0]) @ poses if backward else poses,
        state=tuple(states.tolist()),
        blind=tuple(placed.blind[order]),
    )


def odometry(
    data: Dataset,
    out: Path | str,
    *,
    sweeps: SweepSettings | None = None,
    settings: OdometrySettings | None = None,
    backward: bool = True,
    overwrite: bool = False,
    bulk: JobOptions = HERE,
) -> list[OdometryTrack]:
    """Find the poses of a data set's sweeps from the sweeps alone, and write them beside it.

    Interrupted, it goes on where it stopped, within a drive too, to the same bytes.

    Args:
        data: The data set; its drives need no times, but are placed better with them.
        out: Folder to write into, not in the data's: ``poses/DRIVE.csv``, ``backward/DRIVE.csv``.
        sweeps: Which points.
        settings: Settings of the odometry.
        backward: Place the sweeps backwards too, to tell the drift.
        overwrite: Forget what was done before.
        bulk: How many workers.

    Returns:
        A track a drive.

    Raises:
        ConfigError: If the data have no drives, or ``out`` lies in their folder.
    """
    out = Path(out)
    if out.resolve().is_relative_to(data.root.resolve()):
        raise ConfigError(f"{out}: expected a folder outside of the data ({data.root}), which stay as they are")
    drives = [drive for drive in data.drives() if len(drive.keys)]
    if not drives:
        raise ConfigError(f"{data.root}: expected drives, but its frames stand in no order: no motion is between them")
    kinds = (FORWARD, BACKWARD) if backward else (FORWARD,)
    units = [_unit(data, drive, kind) for drive in drives for kind in kinds]
    work = OdometryTask(data, out, sweeps or SweepSettings(), settings or OdometrySettings())
    journal = JobJournal(out / _JOURNAL, work.setting, overwrite=overwrite)
    if bulk.workers == 0:  # units are long: each is worth a worker
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        bulk = replace(bulk, workers=min(cores, len(units)))
    clocks = run(work, units, bulk, journal=journal).clocks
    if (out / _SAVED).is_dir() and not any((out / _SAVED).iterdir()):
        (out / _SAVED).rmdir()
    facts: Sequence[Any] = list(journal.values(unit.name for unit in units))
    return [
        OdometryTrack(
            drive.name,
            read_poses(out / FORWARD / file_name(drive.name)),
            read_poses(out / BACKWARD / file_name(drive.name)) if backward else None,
            facts[number * len(kinds)],
            clocks.get(number * len(kinds)),
        )
        for number, drive in enumerate(drives)
    ]


def _unit(data: Dataset, drive: Drive, kind: str) -> Unit:
    sources = tuple(path for index in drive.indices.tolist() for path in data.files(index))
    slim = replace(drive, world_T_frame=None)
    return Unit(f"{kind}/{drive.name}", sources=sources, parameters=(slim, kind))
