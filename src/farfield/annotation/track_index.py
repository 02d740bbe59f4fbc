"""Which frames hold which track: built from a drive's label files when it is first asked for, then kept."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from farfield.annotation.drives import DriveTable
from farfield.datasets.edits import Record
from farfield.frame import Key

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
    """Boxes of each track.

    Args:
        rows: Gives the boxes of a frame as they stand.
        drives: The drives.
    """

    def __init__(self, rows: Callable[[Key], Sequence[Any]], drives: DriveTable) -> None:
        self._rows, self._drives = rows, drives
        self._tracks: dict[str, dict[str, set[TrackBox]]] = {}

    def seen(self, drive: str, track: str) -> list[TrackBox]:
        """Boxes of a track in the order of time; of one frame by name."""
        return sorted(self._loaded(drive).get(track, ()))

    def names(self, drive: str) -> list[str]:
        """Tracks of a drive that have a box, numbers first and in their order."""
        return sorted((track for track, seen in self._loaded(drive).items() if seen), key=_by_number)

    def new(self, drive: str) -> str:
        """A track number that the drive does not use."""
        used = [int(track) for track in self._loaded(drive) if track.isascii() and track.isdigit()]
        return str(max(used, default=FIRST_NEW - 1) + 1)

    def _loaded(self, drive: str) -> dict[str, set[TrackBox]]:
        tracks = self._tracks.get(drive)
        if tracks is None:
            tracks = {}
            for row, key in enumerate(self._drives.keys(drive)):
                for found in self._rows(key):
                    _add(tracks, found.label.track, TrackBox(row, key, found.label.id))
            self._tracks[drive] = tracks
        return tracks

    def take(self, record: Record) -> None:
        """Follow an edit, in the drives that were asked for."""
        for change in record.changes:
            if change.cell[0] != "box" or not self._tracks:
                continue
            key, name = (change.cell[1], change.cell[2]), change.cell[3]
            place = self._drives.place(key)
            tracks = self._tracks.get(place.drive)
            if tracks is None:
                continue
            seen = TrackBox(place.row, key, name)
            if change.old is not None:
                tracks.get(change.old.get("track", ""), set()).discard(seen)
            if change.new is not None:
                _add(tracks, change.new.get("track", ""), seen)


def _add(tracks: dict[str, set[TrackBox]], track: str, seen: TrackBox) -> None:
    if track:
        tracks.setdefault(track, set()).add(seen)


def _by_number(track: str) -> tuple[int, int, str]:
    number = track.isascii() and track.isdigit() and len(track) < 18
    return (0, int(track), "") if number else (1, 0, track)
