"""The drives of a data set: when and from where frames were seen, and which of them hold which track."""

import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.datasets.edits import Record
from farfield.frame import Drive, Key

RATE_HZ = 10.0
"""Frames a second where no times are known, as most rotating LiDARs have."""


class DriveRowIndex(NamedTuple):
    """A frame's drive and its row in it."""

    drive: str
    row: int


class DriveTable:
    """The drives of a data set; frames of none (KITTI's object set) are a drive each.

    Args:
        data: The data set.
    """

    def __init__(self, data: Dataset) -> None:
        self.data = data
        self._drives: dict[str, Drive] = {drive.name: drive for drive in data.drives()}
        self.names = tuple(self._drives)
        self._place: dict[Key, DriveRowIndex] = {
            key: DriveRowIndex(name, row) for name, drive in self._drives.items() for row, key in enumerate(drive.keys)
        }
        self._index = {key: index for index, key in enumerate(data.keys)}
        self._poses: dict[Key, Float[np.ndarray, "4 4"] | None] = {}

    def locate(self, key: Key) -> DriveRowIndex:
        """A frame's drive and row."""
        return self._place.get(key) or DriveRowIndex("/".join(key), 0)

    def keys(self, drive: str) -> tuple[Key, ...]:
        """Frames of a drive in the order of time."""
        member = self._drives.get(drive)
        if member is not None:
            return member.keys
        return tuple(key for key in self._index if "/".join(key) == drive and key not in self._place)

    def time_s(self, key: Key) -> float:
        """Seconds since the first frame of the drive; by 10 Hz where no times are known."""
        located = self.locate(key)
        drive = self._drives.get(located.drive)
        if drive is None or drive.times_ns is None:
            return located.row / RATE_HZ
        return float(drive.times_ns[located.row] - drive.times_ns[0]) / 1e9

    def pose(self, key: Key) -> Float[np.ndarray, "4 4"] | None:
        """Pose of a frame in the world, or None; the frame's own where the drive has none."""
        located = self.locate(key)
        drive = self._drives.get(located.drive)
        if drive is not None and drive.world_T_frame is not None:
            return drive.world_T_frame[located.row]
        if key not in self._poses:
            self._poses[key] = self.data[self._index[key]].world_T_frame
        return self._poses[key]


FIRST_NEW = 1


class TrackBox(NamedTuple):
    """One box of a track.

    Args:
        row: The frame's row in its drive.
        key: The frame.
        name: The box.
    """

    row: int
    key: Key
    name: str


class TrackIndex:
    """Boxes of each track, from a drive's label files when it is first needed, then kept up to date.

    Args:
        rows: Gives the boxes of a frame as they stand.
        drives: The drives.
    """

    def __init__(self, rows: Callable[[Key], Sequence[Any]], drives: DriveTable) -> None:
        self._rows, self._drives = rows, drives
        self._tracks: dict[str, dict[str, set[TrackBox]]] = {}

    def boxes(self, drive: str, track: str) -> list[TrackBox]:
        """Boxes of a track in the order of time; of one frame by name."""
        return sorted(self._loaded(drive).get(track, ()))

    def names(self, drive: str) -> list[str]:
        """Tracks of a drive that have a box, numbers first and in their order."""
        return sorted((track for track, boxes in self._loaded(drive).items() if boxes), key=_by_number)

    def new(self, drive: str) -> str:
        """A track number that the drive does not use; longer ones than nine digits, which files do not hold, aside."""
        used = [int(track) for track in self._loaded(drive) if track.isascii() and track.isdigit() and len(track) < 10]
        return str(max(used, default=FIRST_NEW - 1) + 1)

    def _loaded(self, drive: str) -> dict[str, set[TrackBox]]:
        tracks = self._tracks.get(drive)
        if tracks is None:
            tracks = {}
            for row, key in enumerate(self._drives.keys(drive)):
                for box in self._rows(key):
                    _add(tracks, box.label.track, TrackBox(row, key, box.label.id))
            self._tracks[drive] = tracks
        return tracks

    def take(self, record: Record) -> None:
        """Follow an edit, in the drives that were asked for."""
        for change in record.changes:
            if change.cell[0] != "box" or not self._tracks:
                continue
            key, name = (change.cell[1], change.cell[2]), change.cell[3]
            located = self._drives.locate(key)
            tracks = self._tracks.get(located.drive)
            if tracks is None:
                continue
            box = TrackBox(located.row, key, name)
            if change.old is not None:
                tracks.get(change.old.get("track", ""), set()).discard(box)
            if change.new is not None:
                _add(tracks, change.new.get("track", ""), box)


def _add(tracks: dict[str, set[TrackBox]], track: str, box: TrackBox) -> None:
    if track:
        tracks.setdefault(track, set()).add(box)


def _by_number(track: str) -> tuple[int, int, str]:
    number = track.isascii() and track.isdigit() and len(track) < 18
    return (0, int(track), "") if number else (1, 0, track)


_SPELT = 2**30
"""Tracks whose name is no number get numbers from here on, in the order in which they occur."""


class TrackNumbers:
    """Both ways between a track's name in the label files and a number, by which pages and tables know it."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._names: dict[int, str] = {}
        self._lock = threading.Lock()

    def number(self, name: str) -> int | None:
        """Number of a track; None for none.

        >>> tracks = TrackNumbers()
        >>> tracks.number("17"), tracks.number(""), tracks.name(tracks.number("a9")), tracks.number("007") == 7
        (17, None, 'a9', False)
        """
        if not name:
            return None
        if name.isascii() and name.isdigit() and len(name) < 10 and str(int(name)) == name and int(name) < _SPELT:
            return int(name)
        with self._lock:
            if name not in self._numbers:
                self._numbers[name] = _SPELT + len(self._numbers)
                self._names[self._numbers[name]] = name
            return self._numbers[name]

    def name(self, number: int | None) -> str:
        """Name of a track; empty for none."""
        if number is None:
            return ""
        return self._names.get(number, str(number))
