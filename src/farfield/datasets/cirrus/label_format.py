"""The annotations of Cirrus, edited in place: JSON value by value, the authors' text line by line."""

import json
import re
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from farfield.datasets.cirrus.labels import boxes_from_labels, parse_labels
from farfield.datasets.cirrus.layout import Labels
from farfield.datasets.cirrus.reader import Cirrus
from farfield.datasets.labels.formats import BoxLabel, Numbers, Value
from farfield.datasets.labels.json_labels import JsonLabels
from farfield.datasets.labels.line_labels import FileSpan, kept_numbers, physical_lines, replaced
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.json_text import append
from farfield.frame import Key
from farfield.geometry.poses import quaternion_from_yaw

_COUNTS = ("point_count_gaussian", "point_count_uniform", "full_position", "full_size")


class CirrusLabelFormat(JsonLabels):
    """The annotation files of a Cirrus data set, read by its mapping.

    A moved box loses its counts of points and the whole body that Farfield's writer noted beside the visible part. The
    authors' text is edited by :mod:`farfield.datasets.cirrus.label_format`.

    Args:
        data: The data set as it was opened, without maps.
    """

    name: ClassVar[str] = "cirrus"
    attributes: Mapping[str, tuple[Value, ...]] = {}

    def __init__(self, data: Cirrus) -> None:
        self.data, self.settings = data, data.mapping.labels

    @cached_property
    def _index(self) -> dict[Key, int]:
        return {key: index for index, key in enumerate(self.data.keys)}

    def path(self, key: Key) -> Path:
        """The annotation of a frame, or where it would stand: beside the Gaussian sweep's folder, under its stem."""
        if key not in self._index:
            raise DatasetError(f"{self.data.root}: expected a frame of this data set, got {'/'.join(key)}")
        entry = self.data.entries[self._index[key]]
        if entry.labels is not None:
            return entry.labels
        number = "".join(letter for letter in entry.key.parent.name if letter.isdigit()) or "1"
        return entry.part.root / f"dataset{number}_annotation" / f"{entry.key.stem}.json"

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All labels of the frame."""
        raw = parse_labels(data, path, self.settings)
        boxes = boxes_from_labels(raw, self.settings)
        rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).tolist()
        return [
            CuboidEntry((self.settings.root, index), Cuboid(label=name, box=tuple(row), track=_track(raw.extra[index])))
            for index, (name, row) in enumerate(zip(raw.classes, rows, strict=True))
        ]

    def empty(self) -> str:
        """A file without labels."""
        return json.dumps({"label_type": "cuboid", self.settings.root: []}, indent=1) + "\n"

    def values(self, cuboid: Cuboid, text: str, existing: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size, quaternion, class and track as the mapping orders them."""
        del text, existing
        entry = self._entry(cuboid)
        values: dict[tuple[str | int, ...], Any] = {
            (name, axis): number
            for name, value in entry.items()
            if isinstance(value, list)
            for axis, number in enumerate(value)
        }
        return values | {(name,): value for name, value in entry.items() if not isinstance(value, list)}

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other labels in some frames."""
        if path.suffix.lower() == ".txt":
            return render_text(data, path, labels, self.settings)
        return super().render(data, path, labels)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """A label more."""
        return append(text, (self.settings.root,), self._entry(cuboid))

    def stale(self) -> Sequence[tuple[str | int, ...]]:
        """Counts of points, and the whole body."""
        return [(name,) for name in _COUNTS]

    def _entry(self, cuboid: Cuboid) -> dict[str, Any]:
        settings = self.settings
        x, y, z, length, width, height, yaw = cuboid.box
        size = {"l": length, "w": width, "h": height}
        angle = (yaw - np.deg2rad(settings.yaw_offset_deg)) / settings.yaw_scale
        quaternion = quaternion_from_yaw(np.array(angle)).tolist()
        entry: dict[str, Any] = {
            settings.class_: cuboid.label,
            settings.position: [x, y, z if settings.position_is == "center" else z - height / 2],
            settings.size: [size[letter] for letter in settings.size_order],
            settings.quaternion: quaternion if settings.quat_order == "xyzw" else [quaternion[3], *quaternion[:3]],
        }
        return entry | ({"track_id": int(cuboid.track)} if cuboid.track.isdecimal() else {})


def _track(label: Mapping[str, Any]) -> str:
    track = label.get("track_id")
    return str(track) if isinstance(track, str | int) and track not in (-1, "") else ""


# The authors' 15-column text, edited line by line.

_IMAGE = slice(3, 8)  # observation angle and the box in the image
_BOX = 8  # columns before h w l x y z angle
_COLUMNS = 15


def render_text(data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]], settings: Labels) -> bytes:
    """The file with other labels, as :meth:`LabelFormat.render` promises.

    Args:
        data: Its bytes as it stands; None for a new one.
        path: The file, for messages.
        labels: The labels of its frame.
        settings: How the authors' columns are read.

    Raises:
        FileFormatError: If ``data`` is damaged.
        ConfigError: If a class holds blanks, which part the columns.
    """
    if not labels:
        return data or b""
    (key,) = labels
    parts = _parts(data or b"", path, key, settings)
    end = b"\r\n" if parts and parts[0].raw.endswith(b"\r\n") else b"\n"
    return replaced(parts, labels, write=partial(_written, path=path, settings=settings, end=end), same=_same, end=end)


def _parts(data: bytes, path: Path, key: Key, settings: Labels) -> list[FileSpan]:
    raw = parse_labels(data, path, settings)
    boxes = boxes_from_labels(raw, settings)
    rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).tolist()
    lines = physical_lines(data)
    if sum(bool(line.split()) for line in lines) != len(rows):
        actual = "line ends of another kind"
        raise FileFormatError(path, where="the file", expected=r"lines that end in \n or \r\n", got=actual)
    parts, index = [], 0
    for line in lines:
        if not line.split():
            parts.append(FileSpan(line))
            continue
        x, y, z, length, width, height, yaw = rows[index]
        box: Numbers = (x, y, z, length, width, height, yaw)
        parts.append(FileSpan(line, key, BoxLabel(id=str(index), label=raw.classes[index], box=box)))
        index += 1
    return parts


def _same(old: BoxLabel, new: BoxLabel) -> bool:
    return old.label == new.label and kept_numbers(old.box, new.box) == old.box


def _written(key: Key, new: BoxLabel, old: FileSpan | None, *, path: Path, settings: Labels, end: bytes) -> bytes:
    """One line; blanks between its columns stay, too."""
    del key
    if len(new.label.split()) != 1:
        raise ConfigError(f"{path}: expected a class without blanks, which part the columns; got {new.label!r}")
    if old is None or old.label is None:
        cells = [new.label, *["0.0"] * (_BOX - 1), *map(repr, _columns(new.box, settings))]
        return " ".join(cells).encode() + end
    pieces = re.split(rb"(\s+)", old.raw)
    first = 2 if not pieces[0] else 0  # blanks before the class
    columns = [first + 2 * column for column in range(_COLUMNS)]
    if new.label != old.label.label:
        pieces[columns[0]] = new.label.encode()
    box = kept_numbers(old.label.box, new.box)
    before, after = (_columns(box, settings) for box in (old.label.box, box))
    for column, was, now in zip(columns[_BOX:], before, after, strict=True):
        if was != now:
            pieces[column] = repr(now).encode()
    if before != after:
        for column in columns[_IMAGE]:
            pieces[column] = pieces[column] if float(pieces[column]) == 0 else b"0"
    return b"".join(pieces)


def _columns(box: Numbers, settings: Labels) -> list[float]:
    """``h w l x y z angle`` of a box, named as the settings say the file names them."""
    x, y, z, length, width, height, yaw = box
    angle = -(yaw - float(np.deg2rad(settings.yaw_offset_deg))) / settings.yaw_scale
    if settings.text_naming == "authors":
        return [height, length, width, -y, height / 2 - z, x, angle]
    return [height, width, length, -y, height / 2 - z, x, angle - float(np.pi) / 2]
