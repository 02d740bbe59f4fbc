"""Odometry of a data set: a track of poses a drive, written beside the data, and the drift to expect of each.

:func:`odometry` is the whole: units of work of a drive and a direction, of which each reads its sweeps
(:class:`DriveSweeps`), registers them (:func:`register_sweeps`) and writes their poses.
"""

import io
import time
import zipfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable
from urllib.parse import quote

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.datasets import Dataset
from farfield.errors import ConfigError, FileFormatError
from farfield.files.archives import check_archive
from farfield.files.atomic import read_bytes, write_bytes
from farfield.files.poses_csv import PoseTable, read_poses, write_poses
from farfield.frame import Cloud, Drive, Frame
from farfield.geometry.deskewing import PoseTrack
from farfield.geometry.poses import transform_points
from farfield.jobs import HERE, JobJournal, JobOptions, Unit, UnitResult, run
from farfield.jobs.folders import held
from farfield.jobs.journal import state_of
from farfield.jobs.process import usable_cores
from farfield.odometry.drift import Drift, drift_of, way_m
from farfield.odometry.odometry import START_SWEEPS, Odometry, OdometrySettings, OdometrySweep, RegistrationResult
from farfield.odometry.surface_map import SurfaceMap
from farfield.vocabulary.counts import count_of

FORWARD, BACKWARD = "poses", "backward"
_JOURNAL = ".journal.jsonl"
_SAVED = ".checkpoints"
_VERSION = 1


# The sweeps of a drive, read one by one, with the time of each point where it is known

Turning = Literal["no", "clockwise", "counterclockwise"]
_MOVED = ("argoverse2",)  # formats whose points have times, and were moved to the sweep's moment
_TICK_S = 1e-4  # a car at 40 m/s moves 4 mm


@dataclass(frozen=True)
class SweepSettings:
    """Which points of a frame, and when they were measured.

    Args:
        cloud: Name of the cloud (default: the one in whose coordinates the frame stands, else the first).
        deskew: Move points to the sweep's moment, where their times are known.
        turning: How the scanner turns, seen from above, where points have no times: the beam looks along x at the
            sweep's moment.
        step_s: Seconds between sweeps where frames have no times.
    """

    cloud: str | None = None
    deskew: bool = True
    turning: Turning = "no"
    step_s: float = 0.1

    def __post_init__(self) -> None:
        if not 0 < self.step_s < 1e4:
            raise ConfigError(f"step_s: expected seconds between sweeps, got {self.step_s:g}")


class DriveSweeps:
    """The sweeps of one drive, in the order of time or backwards.

    Args:
        data: The data set.
        drive: The drive.
        settings: Which points.
        backward: The last one first.
    """

    def __init__(self, data: Dataset, drive: Drive, settings: SweepSettings, *, backward: bool = False) -> None:
        self.data, self.drive, self.settings = data, drive, settings
        self.order = list(range(len(drive.keys)))[:: -1 if backward else 1]
        self.times_s = times_of(drive, settings.step_s)
        steps = np.abs(np.diff(self.times_s))
        self.period_s = float(np.median(steps)) if len(steps) else settings.step_s

    def __len__(self) -> int:
        return len(self.order)

    def __getitem__(self, index: int, /) -> OdometrySweep:
        return self._sweep(self.order[index])

    def _sweep(self, row: int) -> OdometrySweep:
        frame = self.data[int(self.drive.indices[row])]
        name = cloud_of(frame, self.settings.cloud)
        cloud, sensor = frame.cloud(name), frame.sensors.get(name)
        points = cloud.points_m.astype(np.float64)
        finite = np.isfinite(points).all(1)
        offset = self._offsets_s(cloud, points)
        if sensor is not None and not sensor.in_frame:
            if sensor.frame_T_sensor is None:
                raise ConfigError(
                    f"odometry: where {name} stands on the car is not known (frame {frame.key}); take another --cloud"
                )
            points = transform_points(sensor.frame_T_sensor, points)
        return OdometrySweep(points[finite], float(self.times_s[row]), None if offset is None else offset[finite])

    def _offsets_s(self, cloud: Cloud, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"] | None:
        if not self.settings.deskew:
            return None
        if self.settings.turning != "no":
            sign = -1 if self.settings.turning == "clockwise" else 1
            offset = sign * np.arctan2(points_m[:, 1], points_m[:, 0]) / (2 * np.pi) * self.period_s
        elif self.data.unwrapped.name in _MOVED or (measured := cloud.offsets_s()) is None:
            return None
        else:
            offset = measured
        return np.round(offset / _TICK_S) * _TICK_S


def cloud_of(frame: Frame, name: str | None) -> str:
    """Name of the cloud that odometry reads.

    Raises:
        ConfigError: If the frame has none of that name, or none.
    """
    own = frame.reference.removesuffix("'")
    chosen = name or (own if own in frame.clouds else next(iter(frame.clouds), None))
    if chosen is None or chosen not in frame.clouds:
        raise ConfigError(f"odometry: frame {frame.key} has no cloud {name or ''}; it has {', '.join(frame.clouds)}")
    return chosen


def times_of(drive: Drive, step_s: float) -> Float[np.ndarray, " n"]:
    """Seconds since a drive's first sweep; at constant steps where times are not known.

    Raises:
        ConfigError: If times do not increase.
    """
    if drive.times_ns is None:
        return np.arange(len(drive.keys)) * step_s
    times: Int[np.ndarray, " n"] = drive.times_ns
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        raise ConfigError(
            f"odometry: expected times that increase, but in drive {drive.name} frame {drive.keys[late[0] + 1][1]} is "
            f"not later than {drive.keys[late[0]][1]}; `farfield doctor` tells more"
        )
    return (times - times[0]) * 1e-9


# One drive: sweep after sweep, saved on the way, so that a killed one continues to the same bytes

SAVED_EVERY = 50
BLIND_NAMES = ("turn x", "turn y", "turn z", "x", "y", "z")


@runtime_checkable
class SweepSource(Protocol):
    """Sweeps by number, read when they are asked for; a list will do."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> OdometrySweep: ...


class DriveOdometry:
    """What odometry found of a drive's sweeps, an array a property, in the order in which they were driven.

    Args:
        rows: A row a sweep.
    """

    def __init__(self, rows: Sequence[RegistrationResult]) -> None:
        self.world_T_sensor: Float[np.ndarray, "n 4 4"] = np.array([row.world_T_sensor for row in rows])
        self.world_T_sensor = self.world_T_sensor.reshape(-1, 4, 4)
        self.matched, self.residual_m, self.information = (
            np.array([getattr(row, name) for row in rows], dtype=np.float64)
            for name in ("matched", "residual_m", "information")
        )
        self.lost: Bool[np.ndarray, " n"] = np.array([row.lost for row in rows], dtype=bool)
        self.begins: Bool[np.ndarray, " n"] = np.array([row.begins for row in rows], dtype=bool)
        self.blind = tuple(blind_name(row.blind) for row in rows)

    def __len__(self) -> int:
        return len(self.matched)


def blind_name(direction: Float[np.ndarray, " 6"]) -> str:
    """Name of the axis that a direction which nothing observes is nearest to; empty for none."""
    return BLIND_NAMES[int(np.abs(direction).argmax())] if direction.any() else ""


def register_sweeps(
    sweeps: SweepSource,
    settings: OdometrySettings | None = None,
    *,
    saved: Path | None = None,
    mark: str = "",
    every: int = SAVED_EVERY,
) -> DriveOdometry:
    """Place the sweeps of a drive one after another; the first stands at the origin.

    Args:
        sweeps: The sweeps, in the order of time or backwards; read once each but for the first few.
        settings: Settings of the odometry.
        saved: File in which the state is saved on the way, and from which it is taken up; removed by the caller.
        mark: All that decides the result; a state that was saved under another mark is left.
        every: Sweeps between two savings.

    Returns:
        A row a sweep.
    """
    options = settings or OdometrySettings()
    odometry, rows = _restore(saved, mark, options)
    for number in range(len(rows), len(sweeps)):
        sweep = sweeps[number]
        if odometry.needs_new_map(sweep):
            rows.append(odometry.start_map([sweep, *_following(sweeps, number, options.gap_s)]))
        else:
            rows.append(odometry.register_sweep(sweep))
        if saved is not None and len(rows) % every == 0:
            _save(saved, mark, odometry, rows)
    return DriveOdometry(rows)


def _following(sweeps: SweepSource, number: int, gap_s: float) -> list[OdometrySweep]:
    """The next few sweeps, up to a pause."""
    following: list[OdometrySweep] = []
    last = sweeps[number]
    for later in range(number + 1, min(number + START_SWEEPS, len(sweeps))):
        sweep = sweeps[later]
        if abs(sweep.time_s - last.time_s) > gap_s:
            break
        following.append(sweep)
        last = sweep
    return following


_FIELDS = ("world_T_sensor", "matched", "residual_m", "information", "blind", "lost", "begins")


def _save(path: Path, mark: str, odometry: Odometry, rows: Sequence[RegistrationResult]) -> None:
    arrays = {f"row_{name}": np.array([getattr(row, name) for row in rows]) for name in _FIELDS}
    arrays |= {f"map_{name}": value for name, value in odometry.surfaces.state().items()}
    arrays |= {f"now_{name}": np.array(value) for name, value in odometry.state().items()}
    packed = io.BytesIO()
    np.savez(packed, mark=np.array(mark), **arrays)  # type: ignore[arg-type]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, packed.getvalue())


def _restore(path: Path | None, mark: str, settings: OdometrySettings) -> tuple[Odometry, list[RegistrationResult]]:
    odometry = Odometry(settings)
    if path is None or not path.is_file():
        return odometry, []
    try:
        packed = io.BytesIO(read_bytes(path))
        check_archive(path, packed)
        packed.seek(0)
        with np.load(packed, allow_pickle=False) as saved:
            if str(saved["mark"]) != mark:
                return odometry, []
            columns = [saved[f"row_{name}"] for name in _FIELDS]
            state = {name.removeprefix("map_"): saved[name] for name in saved if name.startswith("map_")}
            now = {name.removeprefix("now_"): saved[name] for name in saved if name.startswith("now_")}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, FileFormatError):  # damaged: begin anew
        return odometry, []
    odometry.surfaces = SurfaceMap.restored(settings.voxel_m, state)
    odometry.restore(now)
    rows = [
        RegistrationResult(pose, float(matched), float(residual), float(information), blind, bool(lost), bool(begins))
        for pose, matched, residual, information, blind, lost, begins in zip(*columns, strict=True)
    ]
    return odometry, rows


# The drives of a data set


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
        """What to expect of it; None where it is shorter than 10 m or was not drive_odometry backwards."""
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
        findings = [
            f"{count_of(count, 'sweep')}: not observable along {name}, kept as predicted"
            for name, count in blind.items()
        ]
        lost, begins = int(self.table.lost.sum()), int(self.table.begins[1:].sum())
        findings += (
            [f"{count_of(lost, 'sweep fits', 'sweeps fit')} nowhere and were moved by the motion before"]
            if lost
            else []
        )
        findings += (
            [f"{count_of(begins, 'time')} no motion is known between two sweeps: a new map begins"] if begins else []
        )
        return tuple(findings)

    def to_json(self) -> dict[str, Any]:
        """As JSON takes it."""
        drift = self.drift
        expected = None if drift is None else {**asdict(drift), "place_percent": drift.place_percent}
        return {
            "drive": self.name,
            "file": f"{FORWARD}/{file_name(self.name)}",
            "sweeps": len(self.table),
            "way_m": round(self.way_m, 3),
            "expected_drift": expected,
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
        drive_odometry = register_sweeps(sweeps, self.odometry, saved=saved, mark=state_of(unit.sources, self.setting))
        reference = self.data[int(drive.indices[0])].reference
        path.parent.mkdir(parents=True, exist_ok=True)
        write_poses(path, _table(drive, drive_odometry, reference, backward=kind == BACKWARD))
        saved.unlink(missing_ok=True)
        fitted = ~(drive_odometry.lost | drive_odometry.begins)
        medians = {
            f"median_{name}": round(float(np.median(getattr(drive_odometry, name)[fitted])), 6) if fitted.any() else 0.0
            for name in ("matched", "residual_m", "information")
        }
        clock = 1e3 * (time.process_time() - began) / max(len(drive_odometry), 1)
        return UnitResult(files=(path,), value=medians, clock=clock)


def _table(drive: Drive, drive_odometry: DriveOdometry, reference: str, *, backward: bool) -> PoseTable:
    """The poses of a drive in the order of time, from its first sweep."""
    order = slice(None, None, -1 if backward else 1)
    poses = drive_odometry.world_T_sensor[order]
    states = np.where(drive_odometry.begins, "begins", np.where(drive_odometry.lost, "lost", "placed"))[order]
    return PoseTable(
        sequence=drive.keys[0][0],
        frames=tuple(key[1] for key in drive.keys),
        reference=reference,
        times_ns=None if drive.times_ns is None else tuple(drive.times_ns.tolist()),
        world_T_frame=np.linalg.inv(poses[0]) @ poses if backward else poses,
        state=tuple(states.tolist()),
        blind=tuple(drive_odometry.blind[order]),
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

    Interrupted, it resumes where it stopped, within a drive too, to the same bytes.

    Args:
        data: The data set; its drives need no times, but are drive_odometry better with them.
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
    units = [
        Unit(
            f"{kind}/{drive.name}",
            sources=tuple(path for index in drive.indices.tolist() for path in data.files(index)),
            parameters=(replace(drive, world_T_frame=None), kind),
        )
        for drive in drives
        for kind in kinds
    ]
    work = OdometryTask(data, out, sweeps or SweepSettings(), settings or OdometrySettings())
    with held(out):
        journal = JobJournal(out / _JOURNAL, work.setting, overwrite=overwrite)
        if bulk.workers == 0:  # units are long: each is worth a worker
            bulk = replace(bulk, workers=min(usable_cores(), len(units)))
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
