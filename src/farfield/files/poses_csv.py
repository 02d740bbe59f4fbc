"""Poses of sweeps as CSV: a row a sweep, position and quaternion, and how well it is known."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.files.remote_paths import as_path

COLUMNS = ("sequence", "frame", "reference", "time_ns", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "state", "blind")
STATES = ("placed", "lost", "begins")
"""Placed by fitting; lost, and placed by the motion before; at the beginning of a map, where no motion is known."""


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Poses of the sweeps of one drive, in the order of time.

    Args:
        sequence: Name of the drive.
        frames: Name of each sweep's frame.
        reference: Name of the coordinates that the poses place: a frame's ``reference``.
        times_ns: When, in nanoseconds; None where a time is not known.
        world_T_frame: Poses, shape (n, 4, 4).
        state: One of :data:`STATES` each.
        blind: Name of the direction that nothing observed: ``x``, ``y``, ``z``, ``turn x``...; empty where all were.
    """

    sequence: str
    frames: tuple[str, ...]
    reference: str
    times_ns: tuple[int, ...] | None
    world_T_frame: Float[np.ndarray, "n 4 4"]
    state: tuple[str, ...]
    blind: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def lost(self) -> Bool[np.ndarray, " n"]:
        """Which sweeps were placed by prediction alone."""
        return np.array([state == "lost" for state in self.state], dtype=bool)

    @property
    def begins(self) -> Bool[np.ndarray, " n"]:
        """Before which sweeps no motion is known; the first always."""
        return np.array([state == "begins" for state in self.state], dtype=bool)


def write_poses(path: Path | str, table: PoseTable) -> None:
    """Write poses to the micrometre, all or nothing."""
    from scipy.spatial.transform import Rotation

    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    quaternion = Rotation.from_matrix(table.world_T_frame[:, :3, :3]).as_quat() if len(table) else np.zeros((0, 4))
    quaternion = quaternion * np.where(quaternion[:, 3:] < 0, -1, 1)
    for number, frame in enumerate(table.frames):
        time = "" if table.times_ns is None else table.times_ns[number]
        translation = [f"{value + 0.0:.6f}" for value in np.round(table.world_T_frame[number, :3, 3], 6)]
        turn = [f"{value + 0.0:.9f}" for value in np.round(quaternion[number], 9)]
        flags = (table.state[number], table.blind[number])
        rows.writerow([table.sequence, frame, table.reference, time, *translation, *turn, *flags])
    write_text(Path(path), text.getvalue())


def read_poses(path: Path | str) -> PoseTable:
    """Read poses.

    Raises:
        FileFormatError: If the file is no table of poses: other columns, a number that is none or not finite, a
            quaternion of zeros, sweeps of several drives, or a sweep that stands there twice.
    """
    from scipy.spatial.transform import Rotation

    path = as_path(path)
    try:
        lines = read_bytes(path).decode("utf-8").splitlines()
        rows = list(csv.reader(lines))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileFormatError(path, where="the file", expected="CSV in UTF-8", got=plain(error)) from error
    if not rows or tuple(rows[0]) != COLUMNS:
        actual = ",".join(rows[0])[:80] if rows else "nothing"
        raise FileFormatError(path, where="line 1", expected=",".join(COLUMNS), got=actual)
    for number, row in enumerate(rows[1:], start=2):
        _check(path, number, row)
    body = rows[1:]
    frames = tuple(row[1] for row in body)
    for what, values in (("drive", {row[0] for row in body}), ("reference", {row[2] for row in body})):
        if len(values) != 1:
            raise FileFormatError(path, where="the file", expected=f"sweeps of one {what}", got=f"{len(values)}")
    if len(set(frames)) < len(frames):
        raise FileFormatError(path, where="the file", expected="each frame once", got="one that stands there twice")
    numbers = np.array([row[4:11] for row in body], dtype=np.float64)
    poses = np.tile(np.eye(4), (len(body), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = Rotation.from_quat(numbers[:, 3:]).as_matrix(), numbers[:, :3]
    times = None if any(row[3] == "" for row in body) else tuple(int(row[3]) for row in body)
    states, blind = (tuple(row[column] for row in body) for column in (11, 12))
    return PoseTable(body[0][0], frames, body[0][2], times, poses, states, blind)


def _check(path: Path, line: int, row: Sequence[str]) -> None:
    where = f"line {line}"
    if len(row) != len(COLUMNS):
        raise FileFormatError(path, where=where, expected=f"{len(COLUMNS)} columns", got=f"{len(row)}")
    try:
        if "_" in "".join(row[3:11]):  # Python takes 1_0 for 10
            raise ValueError
        numbers = np.array(row[4:11], dtype=np.float64)
        time_fits = row[3] == "" or abs(int(row[3])) < 1 << 63
    except ValueError:
        numbers, time_fits = np.zeros(0), False
    if not (time_fits and len(numbers) and np.isfinite(numbers).all() and 0.9 < np.linalg.norm(numbers[3:]) < 1.1):
        expected = "a time in nanoseconds, a place and a unit quaternion"
        raise FileFormatError(path, where=where, expected=expected, got=",".join(row[3:11])[:100])
    if row[11] not in STATES:
        raise FileFormatError(path, where=f"{where}, state", expected=" or ".join(STATES), got=row[11][:40])
