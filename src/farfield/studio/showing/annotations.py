"""The annotation that windows share, as the page takes it: boxes, tracks, findings, fits and changes as rows."""

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from farfield.annotation.annotator import Annotator, Gesture
from farfield.annotation.checking import LabelIssue
from farfield.annotation.drives import TrackNumbers
from farfield.annotation.edits import TOOL_SOURCES
from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.saving import FORMATS, save_sibling, save_words
from farfield.annotation.schema import ClassPreset
from farfield.annotation.store import REDO, UNDO, Store, StoredBox
from farfield.datasets.edits import CellEdit, Record, box_cell, track_cell
from farfield.errors import ConfigError, FarfieldError
from farfield.frame import Key
from farfield.studio.messages import requests
from farfield.studio.messages.replies import Candidate, Conflict, Fitted, LabelState
from farfield.studio.messages.rows import BoxRow, CheckRow, ClassSpec, PlacedRow, RemovedRow, TrackRow
from farfield.studio.options import StudioSettings
from farfield.studio.showing.opened import OpenedDataset, plain_error
from farfield.studio.showing.radar import snapped
from farfield.studio.showing.rows import box_id, class_specs
from farfield.studio.threads import ThreadGroup


class SaveChoice(NamedTuple):
    """Where labels are written to.

    Args:
        folder: A name beside the usual folder; None for the usual one.
        format: Another format than the labels' own; empty for their own.
        at_exit: Whether they are also written when the studio ends.
    """

    folder: str | None = None
    format: str = ""
    at_exit: bool = False


class AnnotationService:
    """One data set's annotation behind the windows.

    Args:
        opened: The open data set.
        settings: What the studio was started with.
    """

    def __init__(self, opened: OpenedDataset, settings: StudioSettings) -> None:
        self.opened = opened
        self.annotator = Annotator(
            opened.data,
            frame=opened.frame,
            classes=settings.classes,
            extent=settings.extent,
            edits=settings.edits,
            out=settings.out,
            to=settings.to,
            write=settings.write,
        )
        self.store: Store = self.annotator.store
        self.numbers = TrackNumbers()
        self.editor = ThreadGroup(1, "edit")
        self.choice = SaveChoice(format=settings.to, at_exit=settings.save_at_exit)

    @property
    def seq(self) -> int:
        """Number of the last edit."""
        return self.store.state.seq

    @property
    def classes(self) -> tuple[ClassSpec, ...]:
        """The classes that can be set."""
        classes = self.store.schema.classes.items()
        return class_specs([ClassPreset(name, spec.size_m, spec.types, spec.source) for name, spec in classes])

    @property
    def formats(self) -> tuple[str, ...]:
        """Formats in which labels can be saved, their own first."""
        return tuple(dict.fromkeys((self.store.files.format.name, *FORMATS)))

    @property
    def in_place(self) -> bool:
        """Whether saves go into the label files themselves."""
        return self.annotator.save_folder is None

    def labels(self, answers: str = "") -> LabelState:
        """What the label files hold of the journal, and what the next save does."""
        store, choice, written = self.store, self.choice, self.store.written
        target = save_sibling(store, choice.folder, self.annotator.save_folder)
        return LabelState(
            answers=answers,
            unwritten=store.unwritten,
            written_ns=None if written is None else str(written.time_ns),
            folder="" if written is None else written.folder,
            format="" if written is None else written.format,
            left=0 if written is None else written.left,
            next_folder=save_words(store, target, choice.format),
            next_format=choice.format or store.files.format.name,
            name=choice.folder,
            itself=self.in_place,
            at_exit=choice.at_exit,
        )

    def choose(self, choice: "SaveChoice") -> None:
        """Choose where the next save goes, and in which format.

        Raises:
            ConfigError: If there is no such format, or the name is that of no folder.
        """
        if choice.format and choice.format not in self.formats:
            raise ConfigError(f"format: expected one of {', '.join(self.formats)}, got {choice.format!r}")
        save_sibling(self.store, choice.folder, self.annotator.save_folder)
        self.choice = choice

    def undoable(self, by: str) -> tuple[bool, bool]:
        """Whether an annotator can undo and redo something."""
        history = self.store.history
        return history.last(by, UNDO) is not None, history.last(by, REDO) is not None

    # Boxes and tracks

    def rows(self, index: int) -> tuple[BoxRow, ...]:
        """The boxes of a frame."""
        return tuple(self.box_row(index, row) for row in self.store.rows(self.store.keys[index]))

    def outlines(self, index: int) -> tuple[BoxRow, ...]:
        """The boxes of a frame; no point is counted, so that no cloud is read."""
        return tuple(self.box_row(index, row, count=False) for row in self.store.rows(self.store.keys[index]))

    def centres(self, index: int) -> list[tuple[int, float, float, float]]:
        """Number of the track and centre of each box that has a track; no point is counted."""
        labels = [row.label for row in self.store.rows(self.store.keys[index])]
        tracks = [(self.numbers.number(label.track), label.box) for label in labels]
        return [(track, float(box[0]), float(box[1]), float(box[2])) for track, box in tracks if track is not None]

    def box_row(self, index: int, row: StoredBox, *, count: bool = True) -> BoxRow:
        """One box, with the points in it if they are counted."""
        label = row.label
        attributes: Any = dict(label.attributes)
        return BoxRow(
            id=box_id(index, label.id),
            track=self.numbers.number(label.track),
            class_name=label.label,
            box=label.box,
            version=row.version,
            state=label.state,  # type: ignore[arg-type]
            source=label.source or "lidar",  # type: ignore[arg-type]
            attributes=attributes,
            score=label.score,
            points=self.annotator.points.count(index, "lidar", label.box) if count else None,
            radar_points=self.annotator.points.count(index, "radar", label.box) if count else None,
            distance_m=math.hypot(label.box[0], label.box[1]),
            keyframe=label.keyframe,
            visibility=str(attributes["availability"]) if "availability" in attributes else None,
            proposal=row.proposal,
        )

    def stored_row(self, index: int, row: StoredBox, *, count: bool = True) -> BoxRow:
        """A box that an edit concerns: it stands without its points where the frame cannot be read now."""
        try:
            return self.box_row(index, row, count=count)
        except (FarfieldError, OSError):
            return self.box_row(index, row, count=False)

    def box_name(self, index: int, id: str) -> str:
        """The name within its frame of a box that the page knows by an identity.

        Raises:
            RefusedError: If it is the identity of a box of another frame, or none.
        """
        frame, _, name = id.partition(":")
        if not name or not frame.isdecimal():
            raise RefusedError("box", f"expected the identity of a box, such as {index}:0, got {id!r}")
        if int(frame) != index:
            raise RefusedError("frame", f"box {id} belongs to frame {frame}: it was not shown in frame {index}")
        return name

    def require_shown(self, index: int, id: str, base: int) -> None:
        """Refuse an edit that starts from a box as it no longer is.

        Args:
            index: The frame that was shown.
            id: The box.
            base: Its version that was shown.

        Raises:
            RefusedError: If the frame has no such box.
            ConflictError: If it was changed since.
        """
        key, name = self.store.keys[index], self.box_name(index, id)
        row = self.store.row(key, name)
        cell = box_cell(key, name)
        if row is None and self.store.state.get(cell) is None:
            raise RefusedError("box", f"frame {index} has no box {id!r}")
        self.store.change(cell, None, base=base)

    def drive_of(self, index: int) -> str:
        """The drive of a frame."""
        return self.store.drives.locate(self.store.keys[index]).drive

    def tracks(self, index: int = 0) -> tuple[TrackRow, ...]:
        """The tracks of a frame's drive."""
        if not len(self.store.keys):
            return ()
        drive = self.drive_of(index)
        tracks: dict[str, list[tuple[int, StoredBox]]] = {}
        for key in self.store.drives.keys(drive):
            for row in self.store.rows(key):
                if row.label.track and row.label.state != "rejected":
                    tracks.setdefault(row.label.track, []).append((self.store.index_of[key], row))
        return tuple(self._track_row(drive, name, boxes) for name, boxes in tracks.items())

    def track_row(self, drive: str, name: str) -> TrackRow:
        """One track; one without boxes has no frames."""
        members = self.store.tracks.boxes(drive, name)
        rows = [(self.store.index_of[member.key], self.store.row(member.key, member.name)) for member in members]
        return self._track_row(drive, name, [(index, row) for index, row in rows if row is not None])

    def _track_row(self, drive: str, name: str, boxes: Sequence[tuple[int, StoredBox]]) -> TrackRow:
        cell = track_cell(drive, name)
        value = self.store.value(cell) or {}
        number = self.numbers.number(name)
        assert number is not None  # a track has a name
        last_frame = str(value.get("ends") or "")
        keys: Sequence[Key] = self.store.drives.keys(drive) if last_frame else ()
        return TrackRow(
            track=number,
            class_name=str(value.get("label") or (boxes[0][1].label.label if boxes else "")),
            version=self.store.version(cell),
            size_locked=bool(value.get("locked")),
            size=tuple(value["size"]) if value.get("size") else None,
            frames=tuple(dict.fromkeys(index for index, _ in boxes)),
            keyframes=tuple(dict.fromkeys(index for index, row in boxes if row.label.keyframe)),
            ends=next((self.store.index_of[key] for key in keys if key[1] == last_frame), None),
        )

    # Edits

    def changed(
        self, record: Record, shown: Container[int]
    ) -> tuple[list[PlacedRow], list[RemovedRow], list[TrackRow]]:
        """Boxes and tracks that an edit touched, as they stand now.

        Args:
            record: The edit.
            shown: Numbers of the frames that windows show. Of an edit of several frames points are counted in these
                only: an edit of a whole drive reads no cloud that nobody looks at.
        """
        alone = len({change.cell[1:3] for change in record.changes if change.cell[0] == "box"}) == 1
        placed: list[PlacedRow] = []
        removed: list[RemovedRow] = []
        tracks: dict[tuple[str, str], None] = {}
        for change in record.changes:
            if change.cell[0] == "track":
                tracks[change.cell[1], change.cell[2]] = None
            if change.cell[0] != "box":
                continue
            key, name = (change.cell[1], change.cell[2]), change.cell[3]
            tracks |= dict.fromkeys(self._changed_tracks(key, change))
            row, index = self.store.row(key, name), self.store.index_of[key]
            if row is None:
                removed.append(RemovedRow(frame=index, id=box_id(index, name)))
            else:
                placed.append(PlacedRow(frame=index, row=self.stored_row(index, row, count=alone or index in shown)))
        return placed, removed, [self.track_row(*track) for track in tracks]

    def _changed_tracks(self, key: Key, change: CellEdit) -> list[tuple[str, str]]:
        """Tracks whose frames an edit of a box may have changed; none where it moved a keyframe."""
        old, new = change.old or {}, change.new or {}
        if change.old is not None and change.new is not None and _track_facts(old) == _track_facts(new):
            return []
        drive = self.store.drives.locate(key).drive
        return [(drive, name) for name in dict.fromkeys((old.get("track"), new.get("track"))) if name]

    def conflict(self, id: str, error: ConflictError) -> Conflict:
        """That an edit came too late, with what is there now."""
        by = error.by or "somebody"
        if error.cell[0] == "track":
            sentence = f"track {error.cell[2]} was changed by {by} meanwhile"
            track = self.track_row(error.cell[1], error.cell[2])
            return Conflict(id=id, by=error.by, sentence=sentence, track=track)
        key = (error.cell[1], error.cell[2])
        row, index = self.store.row(key, error.cell[3]), self.store.index_of[key]
        present = None if row is None else self.stored_row(index, row)
        sentence = f"{by} {'removed' if row is None else 'changed'} this box meanwhile"
        return Conflict(id=id, by=error.by, sentence=sentence, frame=index, present=present)

    # Checks and fits

    def check_row(self, issue: LabelIssue) -> CheckRow:
        """One finding."""
        index = self.store.index_of[issue.frame]
        return CheckRow(
            id=issue.id,
            frame=index,
            box=None if issue.box is None else box_id(index, issue.box),
            track=self.numbers.number(issue.track),
            check=issue.check,
            severity=issue.severity,
            sentence=plain_error(issue.sentence, self.opened.data),
            ignored=issue.ignored,
            at=issue.xy_m,
        )

    def fit(self, request: requests.Fit) -> Fitted:
        """Find the box that a gesture means.

        Raises:
            ConfigError: If the gesture lacks numbers.
        """
        gesture = Gesture(
            kind=request.kind,
            at=request.at,
            class_name=request.class_name,
            type_name=request.type_name,
            track=None if request.track is None else self.numbers.name(request.track),
            box=request.around,
            keep_size=request.keep_size,
        )
        if gesture.kind == "peak":
            frame = self.opened.frame(request.frame)
            at = snapped(frame, lambda: self.opened.radar_power(request.frame), gesture.at)
            gesture = replace(gesture, at=at)
        try:
            fit = self.annotator.fit(request.frame, gesture)
        except ValueError as error:
            return Fitted(id=request.id, frame=request.frame, box=None, sentence=str(error))
        return Fitted(
            id=request.id,
            frame=request.frame,
            box=fit.box,
            points=fit.points,
            candidates=tuple(Candidate(box=other.box, score=float(other.score)) for other in fit.candidates),
            ms=round(fit.ms, 2),
            sentence=fit.note,
            source="radar" if request.kind == "peak" else "lidar",
        )

    def close(self) -> None:
        """Let the journal go."""
        self.editor.end(wait=True)
        self.annotator.close()


def _track_facts(value: Mapping[str, object]) -> tuple[object, ...]:
    """What of a box's value the page's list of tracks depends on: track, class, whether it is a keyframe."""
    by_tool = value.get("source") in (*TOOL_SOURCES, "detector")
    return value.get("track", ""), value.get("label"), value.get("state", "accepted") in ("edited", "accepted"), by_tool
