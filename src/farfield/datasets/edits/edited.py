"""Frames with the annotation as it was edited in the studio; the label files stay as they are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from farfield.datasets.edits.merging import EditedObject, merged
from farfield.datasets.edits.places import FOLDER, JOURNAL
from farfield.datasets.edits.reading import read_journal
from farfield.datasets.edits.records import Cell, Record
from farfield.datasets.maps.contract import Earlier
from farfield.errors import ConfigError
from farfield.frame import Annotation, Boxes, Frame, Key


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
        count = len(read_journal(self.path, _passed_over).starts)
        if self.upto is None:
            object.__setattr__(self, "upto", count)
        elif self.upto > count:
            raise ConfigError(f"{self.path}: expected {self.upto} edits or more, got {count}")

    @property
    def path(self) -> Path:
        """The journal's file."""
        candidates = (self.edits, self.edits / JOURNAL, self.edits / FOLDER / JOURNAL)
        found = next((path for path in candidates if path.is_file()), None)
        if found is None:
            raise ConfigError(f"{self.edits}: expected {JOURNAL}, which `farfield annotate` writes, or its folder")
        return found

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
        found = merged(key, before, touched)
        return found if annotation is not None or edits.extent is None else replace(found, extent=edits.extent)  # type: ignore[arg-type]

    @cached_property
    def _edits(self) -> _Edits:
        taken = _AppliedEdits(self.upto or 0)
        read_journal(self.path, taken)
        return _Edits(taken.boxes, tuple(reversed(taken.saves)), taken.extent)

    def __getstate__(self) -> dict[str, Any]:
        return {"edits": self.edits, "upto": self.upto}


def _passed_over(record: Record) -> None:
    del record


class _AppliedEdits:
    """Gathers the edits up to one of them; saves count all, as the files may have been saved later."""

    def __init__(self, upto: int) -> None:
        self.upto = upto
        self.boxes: dict[Key, dict[str, _History]] = {}
        self.saves: list[int] = []
        self.extent: str | None = None

    def __call__(self, record: Record) -> None:
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
