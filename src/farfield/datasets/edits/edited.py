"""Frames with the annotation as it was edited in the studio; the label files stay as they are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from pydantic import BaseModel, ConfigDict, Field

from farfield.datasets.edits.journal import FOLDER, JOURNAL, Cell, Record, check_values, label_of, read_journal
from farfield.datasets.frame_maps import Earlier
from farfield.datasets.labels.formats import BoxLabel
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Annotation, Boxes, Frame, Key
from farfield.geometry.boxes import wrap_angle_rad
from farfield.vocabulary.classes import (
    CIRRUS_FROM_ANY_KRADAR,
    CIRRUS_FROM_ARGOVERSE2,
    CIRRUS_FROM_KITTI,
    CIRRUS_FROM_VIEW_OF_DELFT,
    normalised_class,
)


class EditedSettings(BaseModel):
    """Settings of :class:`Edited`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    edits: Path
    upto: int | None = Field(default=None, ge=0)


class _History(NamedTuple):
    """A cell's values: before the first edit, and after each."""

    first: Any
    values: list[tuple[int, Any]]

    def at(self, seq: int) -> Any:
        """The value after an edit."""
        return next((value for number, value in reversed(self.values) if number <= seq), self.first)


class _Edits(NamedTuple):
    boxes: Mapping[Key, Mapping[str, _History]]
    saves: Sequence[int]
    extent: str | None


@dataclass(frozen=True)
class Edited:
    """Each frame with its boxes as edits left them: proposals that nobody accepted, and rejected ones, left out.

    The journal keeps every edit, so a number names one state of the annotation for ever: ``upto`` is the number of the
    last edit that counts. Boxes stand in the reader's own coordinates: this map goes before those that move frames.

    Args:
        edits: The journal (``edits.jsonl``), its folder, or the folder of labels beside which it stands.
        upto: The last edit that counts; None: the last that the journal has now, which is then the setting.

    Raises:
        ConfigError: If there is no journal, or it has fewer edits.
        FileFormatError: If the journal is damaged.
        DatasetError: When an annotation is read whose label file is not the one that was edited.
    """

    name: ClassVar[str] = "edited"
    Settings: ClassVar[type[BaseModel]] = EditedSettings
    edits: Path
    upto: int | None = None

    def __post_init__(self) -> None:
        count = len(read_journal(self.path, check_values).starts)
        if self.upto is None:
            object.__setattr__(self, "upto", count)
        elif self.upto > count:
            raise ConfigError(f"{self.path}: expected {self.upto} edits or more, got {count}")

    @property
    def path(self) -> Path:
        """The journal's file."""
        candidates = (self.edits, self.edits / JOURNAL, self.edits / FOLDER / JOURNAL)
        path = next((path for path in candidates if path.is_file()), None)
        if path is None:
            raise ConfigError(f"{self.edits}: expected {JOURNAL}, which `farfield annotate` writes, or its folder")
        return path

    def settings(self) -> Mapping[str, Any]:
        """Where the journal stands, and the last edit that counts."""
        return {"edits": str(self.edits), "upto": self.upto}

    def fits(self, dataset: Any) -> bool:
        """Whether the journal edits frames of the data set, and no map has moved them."""
        still = all(getattr(function, "keeps_annotation", False) for function in dataset.maps)
        return still and not self._edits.boxes.keys().isdisjoint(dataset.keys)

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its edited annotation."""
        del earlier
        if frame.key not in self._edits.boxes:
            return frame
        return replace(frame, load_annotation=_AnnotationMerge(frame, self))

    def merge(self, key: Key, annotation: Annotation | None) -> Annotation:
        """An annotation with the edits of its frame."""
        edits = self._edits
        touched = {
            name: EditedObject(history.at(self.upto or 0), [*(history.at(seq) for seq in edits.saves), history.first])
            for name, history in edits.boxes.get(key, {}).items()
        }
        before = Annotation(boxes=Boxes.empty()) if annotation is None else annotation
        annotated = merged(key, before, touched)
        return annotated if annotation is not None or edits.extent is None else replace(annotated, extent=edits.extent)  # type: ignore[arg-type]

    @cached_property
    def _edits(self) -> _Edits:
        applied = _AppliedEdits(self.upto or 0)
        read_journal(self.path, applied)
        return _Edits(applied.boxes, tuple(reversed(applied.saves)), applied.extent)

    def __getstate__(self) -> dict[str, Any]:
        return {"edits": self.edits, "upto": self.upto}


class _AppliedEdits:
    """Gathers the edits up to one of them; saves count all, as the files may have been saved later."""

    def __init__(self, upto: int) -> None:
        self.upto = upto
        self.boxes: dict[Key, dict[str, _History]] = {}
        self.saves: list[int] = []
        self.extent: str | None = None

    def __call__(self, record: Record) -> None:
        check_values(record)
        if record.op == "save" and (record.data or {}).get("files"):
            self.saves.append(record.seq)
        for cell, _, old, new in record.changes:
            if cell[0] == "box":
                self._box(cell, record.seq, old, new)
            elif cell == ("extent",) and record.seq <= self.upto:
                self.extent = new

    def _box(self, cell: Cell, seq: int, old: Any, new: Any) -> None:
        frame = self.boxes.setdefault((cell[1], cell[2]), {})
        frame.setdefault(cell[3], _History(old, [])).values.append((seq, new))


@dataclass(frozen=True, eq=False)
class _AnnotationMerge:
    """Loads an annotation with its edits."""

    frame: Frame
    edited: Edited

    def __call__(self) -> Annotation:
        return self.edited.merge(self.frame.key, self.frame.annotation)


# An annotation with edited boxes in place of those that were read.

ALIKE = 1e-6
_ALIASES = CIRRUS_FROM_ARGOVERSE2 | CIRRUS_FROM_ANY_KRADAR | CIRRUS_FROM_VIEW_OF_DELFT | CIRRUS_FROM_KITTI
_STANDING = ("edited", "accepted")
_SEEN, _DEFAULT_VISIBILITY = "availability", "R"


class EditedObject(NamedTuple):
    """An object that was edited.

    Args:
        value: Its value now; None: it is gone.
        written: The values that a label file may hold of it, the likeliest first; None: the file has it not.
    """

    value: Mapping[str, Any] | None
    written: Sequence[Mapping[str, Any] | None]


def merged(key: Key, annotation: Annotation, touched: Mapping[str, EditedObject]) -> Annotation:
    """The annotation with edited objects in their places, removed ones gone, added ones behind.

    What the journal does not know of a box that was changed is not known any more: its count of points.

    Args:
        key: The frame, for messages.
        annotation: As the label file was read.
        touched: Objects that were edited, by name, in the order in which they were first.

    Raises:
        DatasetError: If a file does not hold an object that was edited, in any state that was ever written.
    """
    rows = _AnnotationRows(annotation.boxes)
    row_of = {name: rows.take(key, edited.written) for name, edited in touched.items()}
    gone = [row for row in row_of.values() if row is not None]
    keep = [row for row in range(len(annotation)) if row not in gone]
    labels = {
        name: label_of(name, edited.value)
        for name, edited in touched.items()
        if edited.value is not None and edited.value.get("state", "accepted") in _STANDING
    }
    source: list[_Source] = [(row, None) for row in keep]
    source += [(row_of[name], label) for name, label in labels.items()]
    return _assembled(annotation, sorted(source, key=_rank))


class _AnnotationRows:
    """Rows of an annotation, each to be found once by its numbers."""

    def __init__(self, boxes: Boxes) -> None:
        self._table = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])
        self._track = boxes.track_id
        self._free = np.ones(len(boxes), dtype=bool)

    def take(self, key: Key, written: Sequence[Mapping[str, Any] | None]) -> int | None:
        for value in written:
            if value is not None and value.get("state", "accepted") in _STANDING:
                row = self._find(np.array(value["box"], dtype=np.float64), str(value.get("track", "")))
                if row is not None:
                    self._free[row] = False
                    return row
        if all(value is not None and value.get("state", "accepted") in _STANDING for value in written):
            box = ", ".join(f"{number:.2f}" for number in (written[0] or {})["box"][:3])
            raise DatasetError(
                f"frame {'/'.join(key)}: a box that was edited (at {box}) is not among those that the label file "
                "holds. Put back the file that was edited, or put this map before those that move frames."
            )
        return None

    def _find(self, box: Float[np.ndarray, " 7"], track: str) -> int | None:
        """The row of a box; of two alike that of its track."""
        off = self._table - box
        off[:, 6] = wrap_angle_rad(off[:, 6])
        rows = np.flatnonzero(self._free & (np.abs(off) < ALIKE).all(axis=1)).tolist()
        named = [row for row in rows if self._track is not None and str(self._track[row]) == track]
        return next(iter([*named, *rows]), None)


_Source = tuple[int | None, BoxLabel | None]
"""The row that a box had, if it had one, and its label, if it was edited."""


def _rank(source: _Source) -> float:
    return float("inf") if source[0] is None else float(source[0])


def _assembled(annotation: Annotation, source: Sequence[_Source]) -> Annotation:
    rows = np.array([0 if row is None else row for row, _ in source], dtype=np.int64)
    new = np.array([row is None for row, _ in source], dtype=bool)
    labels = [label for _, label in source]
    cut = annotation[rows] if len(annotation) else _blank(annotation, len(rows))
    boxes = _boxes(cut.boxes, labels, new)
    visible = (
        None
        if cut.visibility is None
        else [_visibility(old, label, added) for old, label, added in zip(cut.visibility, labels, new, strict=True)]
    )
    names = (
        None
        if cut.original_label is None
        else [old if label is None else label.label for old, label in zip(cut.original_label, labels, strict=True)]
    )
    moving = (
        None
        if cut.moving is None
        else np.array(
            [_moving(old, label, added) for old, label, added in zip(cut.moving, labels, new, strict=True)], dtype=bool
        )
    )
    return replace(
        cut,
        boxes=boxes,
        visibility=visible,
        original_label=names,
        moving=moving,
        full_boxes=None if cut.full_boxes is None else _own(cut.full_boxes, boxes, labels),
        details={name: _unknown(values, new) for name, values in cut.details.items()},
    )


def _blank(annotation: Annotation, count: int) -> Annotation:
    """As many rows of nothing: of an annotation without boxes, only what stands beside them is kept."""
    ones = np.ones((count, 3))
    boxes = Boxes(centre_m=ones, size_m=ones, yaw_rad=np.zeros(count), label=["unknown"] * count)
    return Annotation(
        boxes=boxes,
        visibility=[_DEFAULT_VISIBILITY] * count if annotation.visibility is not None else None,
        original_label=["unknown"] * count,
        extent=annotation.extent,
        unboxed=annotation.unboxed,
        region=annotation.region,
        version=annotation.version,
    )


def _boxes(before: Boxes, labels: Sequence[BoxLabel | None], new: np.ndarray) -> Boxes:
    table = np.column_stack([before.centre_m, before.size_m, before.yaw_rad])
    names = np.asarray(before.label).astype(object)
    changed = [row for row, label in enumerate(labels) if label is not None]
    for row in changed:
        label = labels[row]
        assert label is not None
        table[row] = label.box
        names[row] = normalised_class(label.label, _ALIASES)
    counts = before.point_count
    edited = np.array([label is not None for label in labels], dtype=bool)
    velocity = before.velocity_m_s
    return Boxes(
        centre_m=table[:, :3],
        size_m=table[:, 3:6],
        yaw_rad=table[:, 6],
        label=[str(name) for name in names],
        score=None,
        track_id=_tracks(before.track_id, labels),
        point_count=None if counts is None else np.where(edited, -1, counts),
        velocity_m_s=None if velocity is None else np.where(new[:, None], np.nan, velocity),
    )


def _tracks(before: Int[np.ndarray, " n"] | None, labels: Sequence[BoxLabel | None]) -> Int[np.ndarray, " n"] | None:
    """Identities; names of tracks that are no numbers identify nothing here."""
    if before is None and not any(label is not None and label.track for label in labels):
        return None
    tracks = np.full(len(labels), -1, dtype=np.int64) if before is None else before.copy()
    for row, label in enumerate(labels):
        if label is not None:
            number = label.track if label.track.isascii() and label.track.isdigit() and len(label.track) < 18 else "-1"
            tracks[row] = int(number)
    return tracks


def _visibility(old: str, label: BoxLabel | None, new: bool | np.bool_) -> str:
    value = None if label is None else label.attributes.get(_SEEN)
    return str(value) if value is not None else _DEFAULT_VISIBILITY if new else old


def _moving(old: bool | np.bool_, label: BoxLabel | None, new: bool | np.bool_) -> bool:
    value = None if label is None else label.attributes.get("moving")
    return value if isinstance(value, bool) else bool(old) and not new


def _own(full: Boxes, boxes: Boxes, labels: Sequence[BoxLabel | None]) -> Boxes:
    """Whole bodies; of a box that was edited only itself is known."""
    edited = np.array([label is not None for label in labels], dtype=bool)
    return full.replace(
        centre_m=np.where(edited[:, None], boxes.centre_m, full.centre_m),
        size_m=np.where(edited[:, None], boxes.size_m, full.size_m),
        yaw_rad=np.where(edited, boxes.yaw_rad, full.yaw_rad),
        label=boxes.label,
        track_id=None if full.track_id is None or boxes.track_id is None else boxes.track_id,
    )


def _unknown(values: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Rows of details, where those of added boxes are not known: NaN, -1, or nothing."""
    rows = values.copy()
    rows[new] = np.nan if values.dtype.kind == "f" else -1 if values.dtype.kind == "i" else values.dtype.type()
    return rows
