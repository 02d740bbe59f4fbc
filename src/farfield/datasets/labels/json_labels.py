"""Label files in JSON, edited value by value: what did not change keeps its bytes, also within an object."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Shaped

from farfield.datasets.labels.formats import BoxLabel, Numbers, Value
from farfield.datasets.labels.line_labels import kept_numbers
from farfield.errors import ConfigError
from farfield.files import datumaro, openlabel, sustechpoints
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.json_text import plain_json, remove, set_value, span
from farfield.frame import Annotation, Boxes, Key
from farfield.vocabulary.classes import CIRRUS_FROM_TOOLS, normalised_class

_BOM = "\ufeff"


class JsonLabels(ABC):
    """What the JSON formats have in common: :class:`~farfield.datasets.labels.formats.LabelFormat` but for ``path``.

    A format says how its cuboids are found, what an entry says of one, and how one more is put in.
    """

    name: ClassVar[str]
    attributes: Mapping[str, tuple[Value, ...]] = {}

    @abstractmethod
    def path(self, key: Key) -> Path:
        """The file of a frame."""

    @abstractmethod
    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of a file with the ways to them."""

    @abstractmethod
    def empty(self) -> str:
        """A file without objects."""

    @abstractmethod
    def values(self, cuboid: Cuboid, text: str, existing: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """What an entry says of a cuboid, by the way to it within the entry."""

    @abstractmethod
    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """A file's text with a cuboid more."""

    def of_frame(self, placed: CuboidEntry, key: Key) -> bool:
        """Whether a cuboid is a frame's; a file that holds one frame names none."""
        name = placed.cuboid.frame
        if name in ("", key[1]):
            return True
        return name.isdecimal() and key[1].isdecimal() and int(name) == int(key[1])

    def in_file(self, key: Key) -> str:
        """A frame's name in its file."""
        return key[1]

    def prepared(self, text: str, existing: CuboidEntry | None, cuboid: Cuboid) -> str:
        """A file's text that can hold a cuboid; formats that list their classes add one here."""
        del existing, cuboid
        return text

    def stale(self) -> Sequence[tuple[str | int, ...]]:
        """What no longer holds of a box that was moved, such as its count of points."""
        return ()

    def parse(self, data: bytes, path: Path, keys: Sequence[Key]) -> Mapping[Key, tuple[BoxLabel, ...]]:
        """Labels of the frames in the file's order."""
        placed = self.placed(data, path)
        return {key: tuple(_labels([entry for entry in placed if self.of_frame(entry, key)])) for key in keys}

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other labels in some frames."""
        text = self.empty() if data is None else data.decode("utf-8")
        placed = [] if data is None else self.placed(data, path)
        gone: list[tuple[str | int, ...]] = []
        added: list[Cuboid] = []
        for key, new_labels in labels.items():
            left = {label.id: label for label in new_labels}
            for number, existing in enumerate([entry for entry in placed if self.of_frame(entry, key)]):
                new = left.pop(str(number), None)
                moves = new is not None and self.moves(existing.cuboid, new)
                if new is None or moves:
                    gone.append(existing.steps)
                if new is not None and moves:
                    added.append(_cuboid(new, existing.cuboid))
                elif new is not None:
                    text = self._changed(text, existing, new)
            frame = self.in_file(key)
            added += [_cuboid(label, Cuboid(frame=frame, label="", box=label.box)) for label in left.values()]
        for steps in sorted(gone, reverse=True):
            text = remove(text, steps)
        for cuboid in added:
            text = self.with_new(self.prepared(text, None, cuboid), cuboid)
        return text.encode()

    def moves(self, old: Cuboid, new: BoxLabel) -> bool:
        """Whether an object has to leave its place in the file, such as for another track."""
        del old, new
        return False

    def _changed(self, text: str, existing: CuboidEntry, new: BoxLabel) -> str:
        cuboid = _cuboid(new, existing.cuboid)
        if cuboid == existing.cuboid:
            return text
        text = self.prepared(text, existing, cuboid)
        before, after = (self.values(state, text, existing) for state in (existing.cuboid, cuboid))
        for steps, value in after.items():
            if steps not in before or before[steps] != value:
                text = set_value(text, (*existing.steps, *steps), value)
        if cuboid.box != existing.cuboid.box:
            for steps in self.stale():
                text = remove(text, (*existing.steps, *steps))
        return text


def _labels(placed: Sequence[CuboidEntry]) -> list[BoxLabel]:
    return [
        BoxLabel(id=str(number), label=cuboid.label, box=cuboid.box, track=cuboid.track, attributes=cuboid.attributes)
        for number, cuboid in enumerate(entry.cuboid for entry in placed)
    ]


def _cuboid(label: BoxLabel, old: Cuboid) -> Cuboid:
    box: Numbers = kept_numbers(old.box, label.box)
    attributes = dict(old.attributes) | dict(label.attributes)
    if not label.label:
        raise ConfigError(f"label {label.id}: expected a class, got none")
    return replace(old, label=label.label, box=box, track=label.track, attributes=attributes)


# The formats of annotation tools: OpenLABEL, SUSTechPOINTS and Datumaro (CVAT).


def file_name(sequence: str) -> str:
    """A sequence's name as that of a file or folder.

    >>> file_name("a/b c"), file_name("..")
    ('a_b_c', '_')
    """
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in sequence).lstrip(".") or "_"


@dataclass(frozen=True)
class SustechLabels(JsonLabels):
    """``<sequence>/label/<frame>.json`` below a folder, or ``label/<frame>.json`` where it is one scene.

    Args:
        folder: The folder.
        scene: Whether the folder is the scene itself.
    """

    name: ClassVar[str] = "sustechpoints"
    folder: Path
    scene: bool = False

    def path(self, key: Key) -> Path:
        """The file of a frame."""
        return (self.folder if self.scene else self.folder / file_name(key[0])) / "label" / f"{file_name(key[1])}.json"

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the frame."""
        return sustechpoints.parse_sustechpoints(data, path)

    def empty(self) -> str:
        """An empty list."""
        return "[]\n"

    def values(self, cuboid: Cuboid, text: str, existing: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size, yaw, class and track."""
        del text, existing
        return sustechpoints.values(cuboid)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """An entry more."""
        return sustechpoints.with_new(text, cuboid)


@dataclass(frozen=True)
class OpenLabels(JsonLabels):
    """One OpenLABEL file a sequence, ``<sequence>.json``.

    An object is of one class in all frames: changing it in one changes it in all.

    Args:
        folder: Where the files stand.
        paths: The file of each frame, by sequence and frame; of others by the folder.
        frames: Each frame's name in its file, where that is not its own.
    """

    name: ClassVar[str] = "openlabel"
    folder: Path
    paths: Mapping[Key, Path] = field(default_factory=dict)
    frames: Mapping[Key, str] = field(default_factory=dict)

    def path(self, key: Key) -> Path:
        """The file of a frame's sequence."""
        return self.paths.get(key, self.folder / f"{file_name(key[0])}.json")

    def in_file(self, key: Key) -> str:
        """A frame's name in its file."""
        return self.frames.get(key, key[1])

    def of_frame(self, placed: CuboidEntry, key: Key) -> bool:
        """Whether a cuboid is a frame's."""
        return placed.cuboid.frame == self.frames[key] if key in self.frames else super().of_frame(placed, key)

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the sequence."""
        return openlabel.parse_openlabel(data, path)

    def empty(self) -> str:
        """A file without frames."""
        return openlabel.format_openlabel([], [])

    def values(self, cuboid: Cuboid, text: str, existing: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """The numbers of ``val``, 9 or 10 as they stand."""
        nine = existing is not None and span(text, (*existing.steps, "val", 9)) is None
        return openlabel.values_of_nine(cuboid) if nine else openlabel.values(cuboid)

    def prepared(self, text: str, existing: CuboidEntry | None, cuboid: Cuboid) -> str:
        """The object's class."""
        if existing is None or existing.cuboid.label == cuboid.label:
            return text
        return openlabel.with_class(text, existing.cuboid.track, cuboid.label)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """A cuboid more."""
        return openlabel.with_new(text, cuboid)

    def moves(self, old: Cuboid, new: BoxLabel) -> bool:
        """Another track is another object."""
        return old.track != new.track


@dataclass(frozen=True)
class DatumaroLabels(JsonLabels):
    """``<sequence>/annotations/default.json`` below a folder, or one file for all.

    Args:
        folder: The folder, or the one file if its name ends in ``.json``.
    """

    name: ClassVar[str] = "cvat"
    folder: Path

    def path(self, key: Key) -> Path:
        """The file of a frame's sequence."""
        if self.folder.suffix == ".json":
            return self.folder
        return self.folder / file_name(key[0]) / "annotations" / "default.json"

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the sequence."""
        return datumaro.parse_datumaro(data, path)

    def empty(self) -> str:
        """A file without items."""
        return datumaro.format_datumaro([], [])

    def values(self, cuboid: Cuboid, text: str, existing: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size, yaw, class, track and attributes."""
        del existing
        return datumaro.values(cuboid, datumaro.class_names(plain_json(text), self.folder))

    def prepared(self, text: str, existing: CuboidEntry | None, cuboid: Cuboid) -> str:
        """A class that the file does not know yet."""
        del existing
        return datumaro.with_class(text, cuboid.label)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """An annotation more."""
        return datumaro.with_new(text, replace(cuboid, frame=file_name(cuboid.frame)))


# What annotation tools say of a frame, as an annotation.


def annotation_of(cuboids: Sequence[Cuboid]) -> Annotation:
    """Boxes with our class names and tracks as numbers: whole numbers as they are, other names as stable ones.

    Attributes are details, rows by their names, and so is :data:`TRACK_NAME` where some track is no number.
    """
    rows = np.array([cuboid.box for cuboid in cuboids], dtype=np.float64).reshape(-1, 7)
    boxes = Boxes(
        centre_m=rows[:, :3],
        size_m=rows[:, 3:6],
        yaw_rad=rows[:, 6],
        label=[normalised_class(cuboid.label, CIRRUS_FROM_TOOLS) for cuboid in cuboids],
        track_id=np.array([_track(cuboid.track) for cuboid in cuboids], dtype=np.int64),
    )
    names = dict.fromkeys(name for cuboid in cuboids for name in cuboid.attributes)
    details = {name: column_of([cuboid.attributes.get(name) for cuboid in cuboids]) for name in names}
    if any(cuboid.track and not _is_number(cuboid.track) for cuboid in cuboids):
        details |= {TRACK_NAME: np.array([cuboid.track for cuboid in cuboids])}
    return Annotation(boxes=boxes, original_label=tuple(cuboid.label for cuboid in cuboids), details=details)


TRACK_NAME = "track_name"
"""The detail of an annotation that holds tracks' names as a tool writes them; ``track_id`` has numbers of them."""


def column_of(values: Sequence[Value | None]) -> Shaped[np.ndarray, " n"]:
    """An attribute's values as an array: flags where all are, numbers (NaN: none there), else texts (empty: none).

    >>> column_of([1, None]).tolist(), column_of([True, False]).tolist(), column_of(["a", None, 2]).tolist()
    ([1.0, nan], [True, False], ['a', '', '2'])
    """
    there = [value for value in values if value is not None]
    if len(there) == len(values) and all(isinstance(value, bool) for value in there):
        return np.array(values, dtype=bool)
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in there):
        return np.array([np.nan if value is None else float(value) for value in values])
    return np.array(["" if value is None else str(value) for value in values])


def _track(track: str) -> int:
    if not track:
        return -1
    if _is_number(track):
        return int(track)
    return int.from_bytes(hashlib.sha256(track.encode()).digest()[:7], "big")


def _is_number(track: str) -> bool:
    return track.isascii() and track.isdigit() and len(track) < 18
