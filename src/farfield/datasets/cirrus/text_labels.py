"""The text annotations of Cirrus' authors, edited line by line: columns whose value did not change keep their bytes.

Columns, boxes and the two readings of their names: :mod:`farfield.datasets.cirrus.labels`. The text has no tracks:
those stay in the journal. A box that moved loses its box in the image and its observation angle, which become 0 as in
files that never had them.
"""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from farfield.datasets.cirrus.labels import boxes_from_labels, parse_labels
from farfield.datasets.cirrus.mapping import Labels
from farfield.datasets.labels.contract import BoxLabel, Numbers
from farfield.datasets.labels.lines import FileSpan, kept_numbers, physical_lines, replaced
from farfield.errors import ConfigError, FileFormatError
from farfield.frame import Key

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
        found = "line ends of another kind"
        raise FileFormatError(path, where="the file", expected=r"lines that end in \n or \r\n", found=found)
    parts, place = [], 0
    for line in lines:
        if not line.split():
            parts.append(FileSpan(line))
            continue
        x, y, z, length, width, height, yaw = rows[place]
        box: Numbers = (x, y, z, length, width, height, yaw)
        parts.append(FileSpan(line, key, BoxLabel(id=str(place), label=raw.classes[place], box=box)))
        place += 1
    return parts


def _same(old: BoxLabel, new: BoxLabel) -> bool:
    return old.label == new.label and kept_numbers(old.box, new.box) == old.box


def _written(key: Key, new: BoxLabel, old: FileSpan | None, *, path: Path, settings: Labels, end: bytes) -> bytes:
    """One line; blanks between its columns stay, too."""
    del key
    if len(new.label.split()) != 1:
        raise ConfigError(f"{path}: expected a class without blanks, which part the columns; got {new.label!r}")
    if old is None or old.label is None:
        words = [new.label, *["0.0"] * (_BOX - 1), *map(repr, _columns(new.box, settings))]
        return " ".join(words).encode() + end
    pieces = re.split(rb"(\s+)", old.raw)
    first = 2 if not pieces[0] else 0  # blanks before the class
    columns = [first + 2 * place for place in range(_COLUMNS)]
    if new.label != old.label.label:
        pieces[columns[0]] = new.label.encode()
    kept = kept_numbers(old.label.box, new.box)
    before, after = (_columns(box, settings) for box in (old.label.box, kept))
    for place, one, other in zip(columns[_BOX:], before, after, strict=True):
        if one != other:
            pieces[place] = repr(other).encode()
    if before != after:
        for place in columns[_IMAGE]:
            pieces[place] = pieces[place] if float(pieces[place]) == 0 else b"0"
    return b"".join(pieces)


def _columns(box: Numbers, settings: Labels) -> list[float]:
    """``h w l x y z angle`` of a box, named as the settings say the file names them."""
    x, y, z, length, width, height, yaw = box
    angle = -(yaw - float(np.deg2rad(settings.yaw_offset_deg))) / settings.yaw_scale
    if settings.text_naming == "authors":
        return [height, length, width, -y, height / 2 - z, x, angle]
    return [height, width, length, -y, height / 2 - z, x, angle - float(np.pi) / 2]
