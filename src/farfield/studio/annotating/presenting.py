"""The store's boxes, tracks and findings as the page takes them."""

import math
import threading
from collections.abc import Sequence
from typing import Any

from farfield.annotation.checking import LabelIssue
from farfield.annotation.store import Store, StoredBox
from farfield.datasets.edits import track_cell
from farfield.frame import Key
from farfield.studio.annotating.counting import SortedPoints
from farfield.studio.messages.rows import BoxRow, CheckRow, TrackRow


# Names of tracks as numbers, which is how the page knows them.

_SPELT = 2**30
"""Tracks whose name is no number get numbers from here on, in the order in which they are met."""


class TrackNumbers:
    """Both ways between a track's name in the label files and its number on the page."""

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


class Presenter:
    """Rows of one store.

    Args:
        store: The annotation.
        numbers: Numbers of tracks.
        points: Counts points in boxes.
    """

    def __init__(self, store: Store, numbers: TrackNumbers, points: SortedPoints) -> None:
        self.store, self.numbers, self.points = store, numbers, points

    def boxes(self, index: int) -> tuple[BoxRow, ...]:
        """The boxes of a frame."""
        return tuple(self.box(index, row) for row in self.store.rows(self.store.keys[index]))

    def centres(self, index: int) -> list[tuple[int, float, float, float]]:
        """Number of the track and centre of each box that has a track; no point is counted."""
        labels = [row.label for row in self.store.rows(self.store.keys[index])]
        found = [(self.numbers.number(label.track), label.box) for label in labels]
        return [(track, float(box[0]), float(box[1]), float(box[2])) for track, box in found if track is not None]

    def outlines(self, index: int) -> tuple[BoxRow, ...]:
        """The boxes of a frame; no point is counted, so that no cloud is read."""
        return tuple(self.box(index, row, count=False) for row in self.store.rows(self.store.keys[index]))

    def box(self, index: int, row: StoredBox, *, count: bool = True) -> BoxRow:
        """One box, with the points in it if they are counted."""
        label = row.label
        attributes: Any = dict(label.attributes)
        return BoxRow(
            id=label.id,
            track=self.numbers.number(label.track),
            class_name=label.label,
            box=label.box,
            version=row.version,
            state=label.state,  # type: ignore[arg-type]
            source=label.source or "lidar",  # type: ignore[arg-type]
            attributes=attributes,
            score=label.score,
            points=self.points.inside(index, "lidar", label.box) if count else None,
            radar_points=self.points.inside(index, "radar", label.box) if count else None,
            distance_m=math.hypot(label.box[0], label.box[1]),
            keyframe=label.keyframe,
            visibility=str(attributes["availability"]) if "availability" in attributes else None,
            proposal=row.proposal,
        )

    def tracks(self, drive: str) -> tuple[TrackRow, ...]:
        """The tracks of a drive."""
        found: dict[str, list[tuple[int, StoredBox]]] = {}
        for key in self.store.drives.keys(drive):
            for row in self.store.rows(key):
                if row.label.track and row.label.state != "rejected":
                    found.setdefault(row.label.track, []).append((self.store.index_of[key], row))
        return tuple(self._track(drive, name, boxes) for name, boxes in found.items())

    def track(self, drive: str, name: str) -> TrackRow:
        """One track; one without boxes has no frames."""
        seen = self.store.tracks.seen(drive, name)
        rows = [(self.store.index_of[each.key], self.store.row(each.key, each.name)) for each in seen]
        return self._track(drive, name, [(index, row) for index, row in rows if row is not None])

    def _track(self, drive: str, name: str, boxes: Sequence[tuple[int, StoredBox]]) -> TrackRow:
        cell = track_cell(drive, name)
        value = self.store.value(cell) or {}
        number = self.numbers.number(name)
        assert number is not None  # a track has a name
        return TrackRow(
            track=number,
            class_name=str(value.get("label") or (boxes[0][1].label.label if boxes else "")),
            version=self.store.version(cell),
            size_locked=bool(value.get("locked")),
            size=tuple(value["size"]) if value.get("size") else None,
            frames=tuple(dict.fromkeys(index for index, _ in boxes)),
            keyframes=tuple(dict.fromkeys(index for index, row in boxes if row.label.keyframe)),
            ends=self._frame_named(drive, str(value.get("ends") or "")),
        )

    def _frame_named(self, drive: str, frame: str) -> int | None:
        keys: Sequence[Key] = self.store.drives.keys(drive) if frame else ()
        return next((self.store.index_of[key] for key in keys if key[1] == frame), None)

    def finding(self, found: LabelIssue) -> CheckRow:
        """One finding."""
        return CheckRow(
            id=found.id,
            frame=self.store.index_of[found.frame],
            box=found.box,
            track=self.numbers.number(found.track),
            check=found.check,
            severity=found.severity,
            sentence=found.sentence,
            ignored=found.ignored,
        )
