"""Odometry of a whole drive: sweep after sweep, saved on the way, so that a killed one goes on to the same bytes."""

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from farfield.files.atomic import read_bytes, write_bytes
from farfield.odometry.odometry import START_SWEEPS, Odometry, OdometrySettings, OdometrySweep, RegistrationResult
from farfield.odometry.surface_map import SurfaceMap

SAVED_EVERY = 50
BLIND_NAMES = ("turn x", "turn y", "turn z", "x", "y", "z")


@runtime_checkable
class SweepSource(Protocol):
    """Sweeps by number, read when they are asked for; a list will do."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> OdometrySweep: ...


class DriveOdometry:
    """What odometry found of a drive's sweeps, an array a property, in the order in which they were placed.

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


def place(
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
    used = settings or OdometrySettings()
    odometry, rows = _taken_up(saved, mark, used)
    for number in range(len(rows), len(sweeps)):
        sweep = sweeps[number]
        if odometry.begins_at(sweep):
            rows.append(odometry.begin([sweep, *_following(sweeps, number, used.gap_s)]))
        else:
            rows.append(odometry.add(sweep))
        if saved is not None and len(rows) % every == 0:
            _save(saved, mark, odometry, rows)
    return DriveOdometry(rows)


def _following(sweeps: SweepSource, number: int, gap_s: float) -> list[OdometrySweep]:
    """The next few sweeps, up to a pause."""
    found: list[OdometrySweep] = []
    last = sweeps[number]
    for later in range(number + 1, min(number + START_SWEEPS, len(sweeps))):
        sweep = sweeps[later]
        if abs(sweep.time_s - last.time_s) > gap_s:
            break
        found.append(sweep)
        last = sweep
    return found


_FIELDS = ("world_T_sensor", "matched", "residual_m", "information", "blind", "lost", "begins")


def _save(path: Path, mark: str, odometry: Odometry, rows: Sequence[RegistrationResult]) -> None:
    arrays = {f"row_{name}": np.array([getattr(row, name) for row in rows]) for name in _FIELDS}
    arrays |= {f"map_{name}": value for name, value in odometry.surfaces.state().items()}
    arrays |= {f"now_{name}": np.array(value) for name, value in odometry.state().items()}
    packed = io.BytesIO()
    np.savez(packed, mark=np.array(mark), **arrays)  # type: ignore[arg-type]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, packed.getvalue())


def _taken_up(path: Path | None, mark: str, settings: OdometrySettings) -> tuple[Odometry, list[RegistrationResult]]:
    odometry = Odometry(settings)
    if path is None or not path.is_file():
        return odometry, []
    try:
        with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as kept:
            if str(kept["mark"]) != mark:
                return odometry, []
            columns = [kept[f"row_{name}"] for name in _FIELDS]
            state = {name.removeprefix("map_"): kept[name] for name in kept if name.startswith("map_")}
            now = {name.removeprefix("now_"): kept[name] for name in kept if name.startswith("now_")}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):  # damaged: begin anew
        return odometry, []
    odometry.surfaces = SurfaceMap.restored(settings.voxel_m, state)
    odometry.restore(now)
    rows = [
        RegistrationResult(pose, float(matched), float(residual), float(information), blind, bool(lost), bool(begins))
        for pose, matched, residual, information, blind, lost, begins in zip(*columns, strict=True)
    ]
    return odometry, rows
