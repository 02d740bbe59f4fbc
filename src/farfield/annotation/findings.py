"""The checks of the annotation as it stands, frame by frame, with the usual sizes of the data set's own boxes."""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from farfield.annotation.checking import (
    CheckedFrame,
    CheckSettings,
    DetectorBox,
    LabelIssue,
    NearbyTrack,
    SensorView,
    SizeRange,
    TrackStep,
    check,
)
from farfield.annotation.motion import TrackFrame, to_world
from farfield.annotation.notes import ignored_findings
from farfield.annotation.store import Store, StoredBox
from farfield.annotation.surroundings import Surroundings
from farfield.datasets.edits import CellEdit, Record, track_cell
from farfield.datasets.labels import BoxLabel
from farfield.errors import FarfieldError
from farfield.frame import Key

_LOG = logging.getLogger(__name__)
_UNREADABLE = "unreadable"
AROUND = 6
"""So many frames before and after are looked at: the longest gap that is said, and one more."""


def settings_of(
    store: Store, views: Sequence[SensorView] = (), sizes: Mapping[str, SizeRange] | None = None
) -> CheckSettings:
    """Limits from the schema: its classes' sizes and speeds, its extent.

    Args:
        store: The annotation.
        views: What the sensors see.
        sizes: Sizes by class from the data set's own statistics, where they are known.
    """
    classes = store.schema.classes
    presets = {name: SizeRange(usual=spec.size_m, types=tuple(spec.types.values())) for name, spec in classes.items()}
    return CheckSettings(
        sizes=presets | dict(sizes or {}),
        fastest_m_s={name: spec.fastest_m_s for name, spec in classes.items()},
        extent=store.extent or "full",
        views=tuple(views),
    )


def findings(
    store: Store,
    key: Key,
    settings: CheckSettings,
    *,
    around: Surroundings | None = None,
    detections: Sequence[DetectorBox] = (),
    before: Sequence[LabelIssue] = (),
) -> list[LabelIssue]:
    """What a person should look at in a frame.

    Args:
        store: The annotation.
        key: The frame.
        settings: Limits, see :func:`settings_of`.
        around: The frame's LiDAR points; None: points are not looked at.
        detections: What a detector found.
        before: What an earlier check found in it: without ``around``, what that found against the points still stands.
    """
    with store.lock:
        located = store.drives.locate(key)
        boxes = [row.label for row in store.rows(key) if row.label.state != "rejected"]
        tracks = {label.track for label in boxes if label.track}
        courses = {track: nearby_track(store, located.drive, track, located.row) for track in tracks}
        reasons = ignored_findings(store)
    scene = CheckedFrame(key=key, row=located.row, around=around, detections=detections, before=before)
    return check(boxes, scene, courses, settings, ignored=reasons)


def nearby_track(store: Store, drive: str, track: str, row: int) -> NearbyTrack:
    """A track in the frames around one; of two boxes in one frame the first counts."""
    members = store.tracks.boxes(drive, track)
    near = {member.row: member for member in reversed(members) if abs(member.row - row) <= AROUND}
    frames: list[tuple[TrackFrame, StoredBox]] = []
    for member in (near[frame_row] for frame_row in sorted(near)):
        box = store.row(member.key, member.name)
        if box is not None and box.label.state != "rejected":
            moment = TrackFrame(member.key, store.drives.time_s(member.key), store.drives.pose(member.key))
            frames.append((moment, box))
    posed = all(moment.world_T_frame is not None for moment, _ in frames)
    rows = store.drives
    steps = [
        TrackStep(
            rows.locate(moment.key).row, moment.time_s, to_world(box.label.box, moment) if posed else box.label.box
        )
        for moment, box in frames
    ]
    locked = bool((store.value(track_cell(drive, track)) or {}).get("locked"))
    return NearbyTrack(steps, len({member.row for member in members}), posed=posed, locked=locked)


CheckFrame = Callable[[Key, bool, Sequence[LabelIssue]], list[LabelIssue]]
"""Checks a frame, with its points or without, given what was found before; see :func:`findings`."""


class DriveFindings:
    """Findings of the frames of a drive, brought up to date after edits.

    All frames are first checked without their points, which takes milliseconds a frame, then each with them. An edit
    has the frames around it checked again without points, and with them only where boxes of the frame itself changed:
    no other cloud is read again. Who calls decides when: :meth:`take` is told of an edit, :meth:`check` does one frame.

    Args:
        store: The annotation.
        keys: The frames.
        check_frame: Checks one of them.
    """

    def __init__(self, store: Store, keys: Sequence[Key], check_frame: CheckFrame) -> None:
        self.store, self.keys, self._check_frame = store, tuple(keys), check_frame
        self.issues: dict[Key, list[LabelIssue]] = {}
        self.labels_due = dict.fromkeys(self.keys)
        """Frames that are to be checked without their points, in order."""
        self.points_due = dict.fromkeys(self.keys)
        """Frames of which the points are still to be looked at."""
        self._members, self._turns = frozenset(self.keys), dict[Key, int]()

    def affected(self, record: Record) -> tuple[list[Key], list[Key]]:
        """Frames whose findings an edit may have changed: those whose points are to be looked at again, and all."""
        own: list[Key] = []
        frames: list[Key] = []
        with self.store.lock:
            for change in record.changes:
                match change.cell:
                    case ("box", sequence, frame, _):
                        own.append((sequence, frame))
                        frames += [(sequence, frame), *self._beside((sequence, frame), change)]
                    case ("track", drive, track):
                        frames += [member.key for member in self.store.tracks.boxes(drive, track)]
                    case ("ignored", finding):
                        issues = list(self.issues.items())
                        frames += [key for key, rows in issues if any(issue.id == finding for issue in rows)]
                    case ("extent",):
                        own, frames = list(self.keys), list(self.keys)
        return own, frames

    def take(self, record: Record) -> None:
        """Mark the frames whose findings an edit may have changed."""
        own, frames = self.affected(record)
        self.mark(frames)
        self.mark(own, points=True)

    def mark(self, keys: Iterable[Key], *, points: bool = False) -> None:
        """Mark frames that are to be checked again, with their points or without."""
        due = self.points_due if points else self.labels_due
        due |= dict.fromkeys(key for key in keys if key in self._members)

    def _beside(self, key: Key, change: CellEdit) -> Iterator[Key]:
        """The frames around one that hold the same tracks; of a short track all, as each says how short it is."""
        drive, row = self.store.drives.locate(key)
        for track in {value.get("track", "") for value in (change.old, change.new) if value} - {""}:
            members = self.store.tracks.boxes(drive, track)
            short = len(members) <= CheckSettings.shortest_track
            yield from (member.key for member in members if short or abs(member.row - row) <= AROUND)

    def begin(self, key: Key, *, points: bool) -> int:
        """The check of a frame begins: what is edited from now on marks it anew. The result belongs to this turn."""
        self.labels_due.pop(key, None)
        if points:
            self.points_due.pop(key, None)
        self._turns[key] = self._turns.get(key, 0) + 1
        return self._turns[key]

    def check(self, key: Key, *, points: bool) -> list[LabelIssue]:
        """Check one frame; one that cannot be checked has that as its only finding, whatever went wrong."""
        before = self.issues.get(key, ())
        try:
            issues = self._check_frame(key, points, before)
        except Exception as error:  # noqa: BLE001 - one frame's fault ends no check of the others
            reason = str(error)
            if not isinstance(error, FarfieldError | OSError):
                _LOG.exception("checking frame %s", "/".join(key))
                reason = f"the check met an error of its own ({type(error).__name__})"
            sentence = f"The frame cannot be checked: {reason}"
            return [LabelIssue(check=_UNREADABLE, severity="error", sentence=sentence, frame=key, box=None)]
        return issues if points else [*(issue for issue in before if issue.check == _UNREADABLE), *issues]

    def end(self, key: Key, turn: int, issues: list[LabelIssue], *, points: bool) -> bool:
        """Take the findings of a frame, unless a later check of it has begun; whether they are taken."""
        if self._turns.get(key) != turn:
            self.mark([key] if points else [], points=True)  # the later one may have looked at no points
            return False
        self.issues[key] = issues
        if not points and any(issue.check == _UNREADABLE for issue in issues):
            self.mark([key], points=True)  # whether it still is
        return True


FEWEST = 200
"""Of fewer boxes, the 0.5 and 99.5 per cent points say nothing."""
PARTS = (0.5, 99.5)
ROOM = 0.1
"""Limits stand so much beyond those points: else one box in a hundred of a sound set is found, on each axis."""


def size_ranges(labels: Iterable[BoxLabel], presets: Mapping[str, SizeRange]) -> dict[str, SizeRange]:
    """Sizes by class: those of the presets, with the limits and medians of the boxes where there are enough.

    Args:
        labels: Boxes of the data set, or of a part of it.
        presets: What is taken for usual where nothing else is known.
    """
    by_class: dict[str, list[tuple[float, float, float]]] = {}
    for label in labels:
        if min(label.box[3:6]) > 0 and np.isfinite(label.box[3:6]).all():
            by_class.setdefault(label.label, []).append(label.box[3:6])
    ranges = dict(presets)
    for name, sizes in by_class.items():
        if len(sizes) >= FEWEST:
            low, high = np.percentile(sizes, PARTS, axis=0)
            types = ranges[name].types if name in ranges else ()
            ranges[name] = SizeRange(
                usual=_three(np.median(sizes, axis=0)),
                low=_three((1 - ROOM) * low),
                high=_three((1 + ROOM) * high),
                types=types,
            )
    return ranges


def _three(values: np.ndarray) -> tuple[float, float, float]:
    length, width, height = values.tolist()
    return length, width, height
