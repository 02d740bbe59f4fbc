"""K-Radar's label files, edited object by object: what did not change keeps its bytes.

Writing numbers anew would change thousands of lines of the published files: ``repr`` spells 2,834 of them otherwise,
degrees turned to radians and back differ in the last digit of 10,086, and 4,173 files end without a newline.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from farfield.datasets.kradar.labels import LabelLine, format_header, parse_text
from farfield.datasets.kradar.layout import LABEL_TREES
from farfield.datasets.kradar.reader import KRadar
from farfield.datasets.labels.formats import BoxLabel, Numbers, Value
from farfield.datasets.labels.line_labels import FileSpan, replaced
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Key
from farfield.vocabulary.classes import CIRRUS_FROM_KRADAR, KRADAR_FROM_CIRRUS

AVAILABILITY: tuple[Value, ...] = ("R", "L", "L1")
_NEWEST = "v2.1"
_MARK = re.compile(rb"([*#])\s*,")
_VALUES = 7
_ALIKE = 1e-9  # numbers that differ by less are the same: a box that came back from the page


class _ObjectCells(NamedTuple):
    """The cells of one object: before the class, the class, its seven numbers, and what follows the last."""

    before: list[bytes]
    name: bytes
    values: list[bytes]
    end: bytes


class KRadarLabelFormat:
    """The label files of a K-Radar tree, of whichever version a frame has; v2.1 for frames without.

    Boxes are in the os2-64's coordinates. ``availability`` is an attribute; objects seen from above only stay as they
    are. A changed object keeps the cells that did not change.

    Args:
        data: The data set as it was opened, without maps.
    """

    def __init__(self, data: KRadar) -> None:
        self.data = data

    @property
    def name(self) -> str:
        """``kradar-`` and the version of the first label file."""
        versions = (entry.version for entry in self.data.entries if entry.version)
        return f"kradar-{next(versions, _NEWEST)}"

    @property
    def attributes(self) -> Mapping[str, tuple[Value, ...]]:
        """``availability``, where the version has it."""
        return {"availability": AVAILABILITY} if self.name.endswith(".1") else {}

    @property
    def needs_tracks(self) -> bool:
        """Whether each object is written with a track: it is, but for version 1."""
        return not self.name.startswith("kradar-v1")

    @cached_property
    def _index(self) -> dict[Key, int]:
        return {key: index for index, key in enumerate(self.data.keys)}

    def _of(self, key: Key) -> int:
        if key not in self._index:
            raise DatasetError(f"{self.data.root}: expected a frame of this data set, got {'/'.join(key)}")
        return self._index[key]

    def path(self, key: Key) -> Path:
        """Its label file, or where that of a frame without one would stand."""
        entry = self.data.entries[self._of(key)]
        if entry.label is not None:
            return entry.label
        return self.data.roots[0] / LABEL_TREES[_NEWEST][-1].format(seq=entry.sequence) / f"{entry.stem}.txt"

    def parse(self, data: bytes, path: Path, keys: Sequence[Key]) -> Mapping[Key, tuple[BoxLabel, ...]]:
        """The objects with a box, in the file's order."""
        labels = tuple(part.label for part in _parts(data, path, ("", ""))[1] if part.label is not None)
        return dict.fromkeys(keys, labels)

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other objects; see :class:`~farfield.datasets.labels.formats.LabelFormat`."""
        if not labels:
            return data or b""
        (key,) = labels
        version = self.data.entries[self._of(key)].version or _NEWEST
        header, parts = _parts(self._header(key) if data is None else data, path, key)
        body = replaced(parts, labels, write=_LabelWriting(path, version, parts), same=_same)
        between = b"" if header.endswith(b"\n") or not body or parts else b"\n"
        return header + between + body

    def _header(self, key: Key) -> bytes:
        frame = self.data.frame(self._of(key))
        return format_header(frame.indices, frame.time_ns or 0).encode()


def _parts(data: bytes, path: Path, key: Key) -> tuple[bytes, list[FileSpan]]:
    """What stands before the first object, and the objects, each with all that follows it up to the next."""
    lines = iter(parse_text(data, path).lines)  # what is wrong with the file, in its words
    starts = [mark.start() for mark in _MARK.finditer(data)]
    parts: list[FileSpan] = []
    index = 0
    for start, end in zip(starts, [*starts, len(data)][1:], strict=True):
        raw = data[start:end]
        if raw.startswith(b"#"):
            parts.append(FileSpan(raw))
        else:
            parts.append(FileSpan(raw, key, _label(next(lines), index)))
            index += 1
    return data[: starts[0]] if starts else data, parts


def _label(line: LabelLine, index: int) -> BoxLabel:
    x, y, z, degrees, length, width, height = line.values
    box: Numbers = (x, y, z, 2 * length, 2 * width, 2 * height, float(np.deg2rad(degrees)))
    return BoxLabel(
        id=str(index),
        label=line.name,
        box=box,
        track=str(line.numbers[0]) if len(line.numbers) == 1 else "",
        attributes={"availability": line.availability} if line.availability else {},
    )


def _same(old: BoxLabel, new: BoxLabel) -> bool:
    return (
        not _changed(old, new)
        and _name(new.label) == _name(old.label)
        and new.track == old.track
        and new.attributes.get("availability") == old.attributes.get("availability")
    )


def _changed(old: BoxLabel, new: BoxLabel) -> set[int]:
    """Places of the line's seven numbers that differ: x, y, z, yaw, half the length, width and height."""
    was, now = _numbers(old.box), _numbers(new.box)
    turn = abs((now[3] - was[3] + 180) % 360 - 180)
    return {column for column in range(_VALUES) if (turn if column == 3 else abs(now[column] - was[column])) > _ALIKE}


def _numbers(box: Numbers) -> tuple[float, ...]:
    x, y, z, length, width, height, yaw = map(float, box)
    return x, y, z, float(np.rad2deg(yaw)), length / 2, width / 2, height / 2


def _name(label: str) -> str:
    return KRADAR_FROM_CIRRUS.get(label, label)


@dataclass(frozen=True)
class _LabelWriting:
    """Writes the line of one object."""

    path: Path
    version: str
    parts: Sequence[FileSpan]

    def __call__(self, key: Key, new: BoxLabel, old: FileSpan | None) -> bytes:
        del key
        cells = self._new(new) if old is None else _cells(old.raw)
        before = None if old is None else old.label
        values = list(cells.values)
        for column in range(_VALUES) if before is None else _changed(before, new):
            values[column] = f" {_numbers(new.box)[column]!r}".encode()
        name = cells.name
        if before is None or _name(before.label) != _name(new.label):
            name = f" {self._class(new.label)}".encode()
        head = list(cells.before)
        if before is not None and new.track != before.track:
            head[-1] = f" {self._track(new)}".encode()
        if before is not None and new.attributes.get("availability") != before.attributes.get("availability"):
            if len(head) != 3 or "availability" not in before.attributes:
                raise ConfigError(f"{self.path}: labels of version {self.version} have no availability")
            head[1] = f" {self._availability(new)}".encode()
        return b",".join([*head, name, *values]) + cells.end

    def _new(self, label: BoxLabel) -> _ObjectCells:
        if self.version.startswith("v1"):
            numbers = [f" {len(self.parts) + int(label.id) if label.id.isdigit() else len(self.parts)}".encode()] * 2
        else:
            numbers = [f" {self._track(label)}".encode()]
        flag = [f" {self._availability(label)}".encode()] if self.version.endswith(".1") else []
        return _ObjectCells([b"*", *flag, *numbers], b"", [b""] * _VALUES, b"\n")

    def _class(self, label: str) -> str:
        name = _name(label)
        if name not in CIRRUS_FROM_KRADAR:
            classes = ", ".join(CIRRUS_FROM_KRADAR)
            raise ConfigError(f"{self.path}: expected a class of K-Radar ({classes}), got {label!r}")
        return name

    def _track(self, label: BoxLabel) -> str:
        if not re.fullmatch(r"[0-9]{1,9}", label.track):
            raise ConfigError(
                f"{self.path}: expected a whole number as track of a {label.label}, got {label.track!r}; "
                f"labels of version {self.version} give each object one"
            )
        return label.track

    def _availability(self, label: BoxLabel) -> str:
        value = label.attributes.get("availability", "R")
        if value not in AVAILABILITY:
            raise ConfigError(f"{self.path}: expected availability R, L or L1 of a {label.label}, got {value!r}")
        return str(value)


def _cells(raw: bytes) -> _ObjectCells:
    """The cells of an object's text, with the blanks before each."""
    text = raw.rstrip().rstrip(b",").rstrip()
    cells = text.split(b",")
    return _ObjectCells(cells[: -_VALUES - 1], cells[-_VALUES - 1], cells[-_VALUES:], raw[len(text) :])
