"""One data set's annotation behind the windows."""

import itertools
from collections.abc import Mapping, Sequence
from functools import cached_property, partial

from farfield.annotation.checking import CheckSettings, DetectorBox, SizeRange
from farfield.annotation.edits import MADE, add_box, fill, propagate_track
from farfield.annotation.findings import all_findings, findings, settings_of, size_ranges
from farfield.annotation.schema import Extent
from farfield.annotation.store import REDO, UNDO, Author, EditResult, Store
from farfield.datasets.edits import CellEdit, Record
from farfield.datasets.labels import BoxLabel
from farfield.errors import FarfieldError
from farfield.frame import Boxes, Key
from farfield.geometry.iou import pairwise_iou
from farfield.studio.annotating.counting import SortedPoints
from farfield.studio.annotating.fits import Fitter
from farfield.studio.annotating.opening import open_store
from farfield.studio.annotating.planning import plan_of, row_in_drive
from farfield.studio.annotating.presenting import Presenter, TrackNumbers
from farfield.studio.annotating.saves import FORMATS, place_of
from farfield.studio.messages import requests as asked
from farfield.studio.messages.rows import BoxRow, CheckRow, ClassSpec, PlacedRow, RemovedRow, TrackRow
from farfield.studio.options import StudioSettings
from farfield.studio.showing.opened import OpenedDataset
from farfield.studio.showing.rows import boxes_of, numbers, our_class, spec_of
from farfield.studio.threads import ThreadGroup

_LOOKED = 500
"""Frames whose boxes tell the sizes of the data set's classes."""
_SAME_IOU = 0.1
"""A detection that overlaps a box so much is not proposed beside it."""


class AnnotationService:
    """The store with all that the windows need of it.

    Args:
        opened: The open data set.
        settings: What the studio was started with.
    """

    def __init__(self, opened: OpenedDataset, settings: StudioSettings) -> None:
        self.opened, self.settings = opened, settings
        self.store: Store = open_store(opened.data, settings)
        self.numbers = TrackNumbers()
        self.points = SortedPoints(opened.frame)
        self.shown = Presenter(self.store, self.numbers, self.points)
        self.fitter = Fitter(self.store, opened, self.numbers)
        self.editor = ThreadGroup(1, "edit")
        self.saved_seq = self.store.state.seq

    @property
    def seq(self) -> int:
        """Number of the last edit."""
        return self.store.state.seq

    @property
    def extent(self) -> Extent | None:
        """What the boxes hold, once it is declared."""
        return self.store.extent

    @property
    def classes(self) -> tuple[ClassSpec, ...]:
        """The classes that can be set."""
        known = self.store.schema.classes.items()
        return tuple(spec_of(name, each.size_m, dict(each.types), place) for place, (name, each) in enumerate(known))

    @property
    def formats(self) -> tuple[str, ...]:
        """Formats in which labels can be saved, their own first."""
        return tuple(dict.fromkeys((self.store.files.format.name, *FORMATS)))

    @property
    def in_place(self) -> bool:
        """Whether saves go into the label files themselves."""
        return place_of(self.store, self.settings) is None

    @property
    def saves_to(self) -> str:
        """Where saves go, in words."""
        place = place_of(self.store, self.settings)
        return "the data set's label files" if place is None else place.name

    def can(self, by: str, what: str) -> bool:
        """Whether an annotator can undo or redo something."""
        return self.store.history.last(by, REDO if what == "redo" else UNDO) is not None

    def rows(self, index: int) -> tuple[BoxRow, ...]:
        """The boxes of a frame."""
        return self.shown.boxes(index)

    def outlines(self, index: int) -> tuple[BoxRow, ...]:
        """The boxes of a frame, without their points."""
        return self.shown.outlines(index)

    def centres(self, index: int) -> list[tuple[int, float, float, float]]:
        """Track number, x, y, z of the boxes of a frame."""
        return self.shown.centres(index)

    def drive_of(self, index: int) -> str:
        """The drive of a frame."""
        return self.store.drives.place(self.store.keys[index]).drive

    def tracks(self, index: int = 0) -> tuple[TrackRow, ...]:
        """The tracks of a frame's drive."""
        return self.shown.tracks(self.drive_of(index)) if len(self.store.keys) else ()

    def edit(self, author: Author, request: asked.Edit, drive: str) -> EditResult:
        """Make an edit that a window sent."""
        if isinstance(request, asked.TrackPropagate):
            return self._propagate(author, request, drive)
        plan = plan_of(request, drive, self.numbers)
        return self.store.edit(author, request.id, request.op, plan, group=getattr(request, "group", None))

    def _propagate(self, author: Author, request: asked.TrackPropagate, drive: str) -> EditResult:
        store, name = self.store, self.numbers.name(request.track)
        first, last = (row_in_drive(store, frame, drive) for frame in (request.first, request.last))
        refit = self.fitter.again if request.fit else None
        found = propagate_track(store, drive, name, first, last, refit)
        plan = partial(fill, drive=drive, track=name, boxes=found.boxes, source="propagated", prefix=request.id)
        return store.edit(author, request.id, request.op, plan, data={"message": found.message})

    def changed(self, record: Record) -> tuple[list[PlacedRow], list[RemovedRow], list[TrackRow]]:
        """Boxes and tracks that an edit touched, as they stand now."""
        placed: list[PlacedRow] = []
        removed: list[RemovedRow] = []
        tracks: dict[tuple[str, str], None] = {}
        for change in record.changes:
            if change.cell[0] == "track":
                tracks[change.cell[1], change.cell[2]] = None
            if change.cell[0] != "box":
                continue
            key, name = (change.cell[1], change.cell[2]), change.cell[3]
            tracks |= dict.fromkeys(self._tracks_of(key, change))
            row, index = self.store.row(key, name), self.store.index_of[key]
            if row is None:
                removed.append(RemovedRow(frame=index, id=name))
            else:
                placed.append(PlacedRow(frame=index, row=self.shown.box(index, row)))
        return placed, removed, [self.shown.track(*track) for track in tracks]

    def _tracks_of(self, key: Key, change: CellEdit) -> list[tuple[str, str]]:
        """Tracks whose frames an edit of a box may have changed; none where it moved a keyframe."""
        old, new = change.old or {}, change.new or {}
        if change.old is not None and change.new is not None and _stands_for(old) == _stands_for(new):
            return []
        drive = self.store.drives.place(key).drive
        return [(drive, name) for name in dict.fromkeys((old.get("track"), new.get("track"))) if name]

    def checks(self, index: int, detections: Boxes | None = None) -> tuple[CheckRow, ...]:
        """Findings of a frame."""
        found = findings(
            self.store,
            self.store.keys[index],
            self._limits,
            around=self.points.around(index, "lidar"),
            detections=[] if detections is None else self._detected(detections),
        )
        return tuple(self.shown.finding(each) for each in found)

    def all_checks(self) -> tuple[CheckRow, ...]:
        """Findings of all frames, without points."""
        return tuple(self.shown.finding(each) for each in all_findings(self.store, self._limits))

    @property
    def _limits(self) -> CheckSettings:
        """Limits of the checks: what the schema says, with the sizes of the data set's own boxes."""
        return settings_of(self.store, sizes=self._sizes)

    @cached_property
    def _sizes(self) -> dict[str, SizeRange]:
        """Sizes by class as the label files have them, of frames from beginning to end."""
        keys = self.store.keys
        looked = keys[:: max(1, -(-len(keys) // _LOOKED))]
        labels = itertools.chain.from_iterable(self._labels(key) for key in looked)
        presets = settings_of(self.store).sizes
        return {name: found for name, found in size_ranges(labels, presets).items() if found.low is not None}

    def _labels(self, key: Key) -> Sequence[BoxLabel]:
        try:
            with self.store.lock:
                return self.store.files.labels(key)
        except FarfieldError:
            return ()  # said when the frame is opened

    def _detected(self, boxes: Boxes) -> Sequence[DetectorBox]:
        scores = [1.0] * len(boxes) if boxes.score is None else boxes.score.tolist()
        return [
            DetectorBox(self._spelt(str(boxes.label[row])), numbers(boxes, row), score)
            for row, score in enumerate(scores)
        ]

    def _spelt(self, label: str) -> str:
        """A detector's class as the label files spell it; its own word where they have none."""
        return next((name for name in self.store.schema.classes if our_class(name) == our_class(label)), label)

    def propose(self, author: Author, id: str, index: int, boxes: Boxes, group: str) -> EditResult | None:
        """Add a detector's boxes as proposals, but those that overlap a box that is there; None if none is left."""
        key = self.store.keys[index]
        present = boxes_of(self.shown.boxes(index))
        if len(present) and len(boxes):
            boxes = boxes[pairwise_iou(boxes, present, kind="bev").max(axis=1) < _SAME_IOU]
        values = [self._proposal(boxes, row) for row in range(len(boxes))]
        values = [value for value in values if value["label"] in self.store.schema.classes]
        if not values:
            return None
        plan = partial(_added, key=key, values=values, prefix=id)
        return self.store.edit(author, id, "box.add", plan, group=group)

    def _proposal(self, boxes: Boxes, row: int) -> dict[str, object]:
        box = [float(value) for value in numbers(boxes, row)]
        value: dict[str, object] = {"label": self._spelt(str(boxes.label[row])), "box": box, "proposal": list(box)}
        value |= {"state": "proposed", "source": "detector"}
        return value if boxes.score is None else value | {"score": float(boxes.score[row])}

    def close(self) -> None:
        """Let the journal go."""
        self.editor.end(wait=True)
        self.store.close()


def _stands_for(value: Mapping[str, object]) -> tuple[object, ...]:
    """What of a box's value the page's list of tracks depends on: track, class, whether it is a keyframe."""
    made = value.get("source") in (*MADE, "detector")
    return value.get("track", ""), value.get("label"), value.get("state", "accepted") in ("edited", "accepted"), made


def _added(store: Store, key: Key, values: Sequence[dict[str, object]], prefix: str) -> Sequence[CellEdit]:
    added = (add_box(store, key, f"{prefix}.{place}"[-64:], value) for place, value in enumerate(values))
    return list(itertools.chain.from_iterable(added))
