"""Label files of lines, edited line by line: what did not change keeps its bytes; and boxes as CSV.

The columns of the CSV: :mod:`farfield.files.boxes_csv`.
"""

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar, NamedTuple

from farfield.datasets.labels.formats import BoxLabel, Numbers, Value
from farfield.errors import ConfigError
from farfield.files.boxes_csv import parse_boxes_csv
from farfield.frame import Key

# Any file of lines in which some objects change: the others keep their bytes, in their places.

_ALIKE = 1e-9  # metres or radians: a box that went to the page and came back unmoved


class FileSpan(NamedTuple):
    """A stretch of a file: one object's line or lines, or what stands between objects.

    Args:
        raw: Its bytes, with the end of its last line.
        key: The object's frame; None for what is no object.
        label: The object, as ``parse`` gives it.
    """

    raw: bytes
    key: Key | None = None
    label: BoxLabel | None = None


Writes = Callable[[Key, BoxLabel, FileSpan | None], bytes]
"""The line of an object with its end: from its frame, its values and, where the file has it, what stands there now."""


def replaced(
    parts: Sequence[FileSpan],
    labels: Mapping[Key, Sequence[BoxLabel]],
    *,
    write: Writes,
    same: Callable[[BoxLabel, BoxLabel], bool],
    end: bytes = b"\n",
) -> bytes:
    """The file with other labels in some frames, as :meth:`LabelFormat.render` promises.

    New objects stand behind the last of their frame, or at the end. A last line without its end stays so while nothing
    follows it.

    Args:
        parts: The whole file, in order.
        labels: All labels of the frames that changed.
        write: Gives an object's line.
        same: Whether two labels (the file's and the new one) stand in the file alike.
        end: End of a line.
    """
    left = {key: {label.id: label for label in new_labels} for key, new_labels in labels.items()}
    out: list[list[bytes]] = []
    last: dict[Key, int] = {}
    for part in parts:
        out.append([part.raw])
        if part.key is None or part.label is None or part.key not in left:
            continue
        last[part.key] = len(out) - 1
        new = left[part.key].pop(part.label.id, None)
        if new is None:
            out[-1] = []
        elif not same(part.label, new):
            out[-1] = [write(part.key, new, part)]
    out.append([])
    for key, added in left.items():
        out[last.get(key, -1)].extend(write(key, label, None) for label in added.values())
    written = [line for lines in out for line in lines if line]
    closed = [
        line if line.endswith(b"\n") else line + end for line in written[:-1]
    ]  # a line gets an end if another follows
    return b"".join([*closed, *written[-1:]])


def physical_lines(data: bytes) -> list[bytes]:
    r"""The lines of a file with their ends; only ``\n`` ends one, so that all bytes are kept.

    >>> physical_lines(b"a\r\nb")
    [b'a\r\n', b'b']
    """
    pieces = data.split(b"\n")
    return [piece + b"\n" for piece in pieces[:-1]] + ([pieces[-1]] if pieces[-1] else [])


def kept_numbers(old: Numbers, new: Numbers) -> Numbers:
    """The new box, with the old number wherever both differ by less than a nanometre or a full turn.

    >>> kept_numbers((1.0, 0.0, 0.0, 4.0, 2.0, 1.5, 4.0), (1.0, 2.0, 0.0, 4.0, 2.0, 1.5, 4.0 - 2 * math.pi))
    (1.0, 2.0, 0.0, 4.0, 2.0, 1.5, 4.0)
    """
    turn = math.remainder(new[6] - old[6], 2 * math.pi)
    x, y, z, length, width, height = (
        a if abs(b - a) <= _ALIKE else float(b) for a, b in zip(old[:6], new[:6], strict=True)
    )
    return x, y, z, length, width, height, old[6] if abs(turn) <= _ALIKE else float(new[6])


_PLACES = ("x", "y", "z", "l", "w", "h", "yaw_rad")
_NEW_FILE = b"sequence,frame,label,x,y,z,l,w,h,yaw_rad,score,track_id\n"
_BOM = b"\xef\xbb\xbf"


@dataclass(frozen=True)
class CsvLabels:
    """One file of boxes for all frames of a data set.

    A changed box keeps the cells that did not change; its count of points, which no longer holds, is emptied.

    Args:
        file: The file.
        reference: Sensor in whose coordinates the boxes of a new file stand; empty where not known.
    """

    name: ClassVar[str] = "boxes-csv"
    attributes: ClassVar[Mapping[str, tuple[Value, ...]]] = {}
    file: Path
    reference: str = ""

    def path(self, key: Key) -> Path:
        """The one file."""
        del key
        return self.file

    def parse(self, data: bytes, path: Path, keys: Sequence[Key]) -> Mapping[Key, tuple[BoxLabel, ...]]:
        """Boxes of the frames in the file's order."""
        boxes: dict[Key, list[BoxLabel]] = {key: [] for key in keys}
        for part in _parts(data, path, keys)[1]:
            if part.key is not None and part.label is not None:
                boxes[part.key].append(part.label)
        return {key: tuple(labels) for key, labels in boxes.items()}

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other boxes in some frames; new ones stand behind those of their frame."""
        new = _NEW_FILE.replace(b"\n", b",reference\n") if self.reference else _NEW_FILE
        header, parts = _parts(new if data is None else data, path, list(labels))
        end = "\r\n" if parts[0].raw.endswith(b"\r\n") else "\n"
        stands_in = self.reference if data is None else parse_boxes_csv(data, path).stands_in or self.reference
        write = partial(_written, header=header, path=path, end=end, stands_in=stands_in)
        return replaced(parts, labels, write=write, same=_same, end=end.encode())


def _parts(data: bytes, path: Path, keys: Sequence[Key]) -> tuple[list[str], list[FileSpan]]:
    """The header's names and the parts: the header, then the records; blank lines belong to the record before."""
    parse_boxes_csv(data, path)  # what is wrong with the file, in its words
    lines = physical_lines(data)
    reader = csv.reader((line.removeprefix(_BOM).decode() for line in lines), strict=True)
    header = [name.strip() for name in next(reader)]
    key_of = {key if "sequence" in header else ("", key[1]): key for key in keys}
    begin, count = reader.line_num, dict.fromkeys(keys, 0)
    parts = [FileSpan(b"".join(lines[:begin]))]
    for cells in reader:
        raw = b"".join(lines[begin : reader.line_num])
        begin = reader.line_num
        if not cells:
            parts[-1] = parts[-1]._replace(raw=parts[-1].raw + raw)
            continue
        row = dict(zip(header, map(str.strip, cells), strict=True))
        key = key_of.get((row.get("sequence", ""), row["frame"]))
        parts.append(FileSpan(raw) if key is None else FileSpan(raw, key, _label(row, count[key])))
        if key is not None:
            count[key] += 1
    return header, parts


def _label(row: Mapping[str, str], index: int) -> BoxLabel:
    x, y, z, length, width, height, yaw = (float(row[name]) for name in _PLACES)
    box: Numbers = (x, y, z, length, width, height, yaw)
    track, score = row.get("track_id", ""), row.get("score", "")
    return BoxLabel(
        id=str(index),
        label=row["label"],
        box=box,
        track="" if not track or float(track) < 0 else str(int(float(track))),
        score=float(score) if score else None,
    )


def _same(old: BoxLabel, new: BoxLabel) -> bool:
    return (old.label, old.box, old.track) == (new.label, new.box, new.track)


def _written(
    key: Key, new: BoxLabel, old: FileSpan | None, *, header: Sequence[str], path: Path, end: str, stands_in: str
) -> bytes:
    """One record; cells whose value did not change stay as they are spelt."""
    row = {"sequence": key[0], "frame": key[1], "reference": stands_in}
    if old is not None and old.label is not None:
        cells = next(csv.reader(io.StringIO(old.raw.decode(), newline="")))
        row = dict(zip(header, map(str.strip, cells), strict=True)) | {"point_count": ""}
    before = None if old is None else old.label
    if before is None or before.label != new.label:
        row["label"] = new.label
    for column, name in enumerate(_PLACES):
        if before is None or before.box[column] != new.box[column]:
            row[name] = repr(float(new.box[column]))
    if before is None or before.track != new.track:
        row["track_id"] = _track(new, header, path)
    text = io.StringIO()
    csv.writer(text, lineterminator=end).writerow([row.get(name, "") for name in header])
    return text.getvalue().encode()


def _track(label: BoxLabel, header: Sequence[str], path: Path) -> str:
    if label.track and "track_id" not in header:
        fix = "Save into a new folder, whose file has the column, or leave the track empty."
        raise ConfigError(f"{path}: has no column track_id, and a {label.label} has the track {label.track}. {fix}")
    if label.track and not (label.track.isascii() and label.track.isdigit() and int(label.track) < 2**53):
        raise ConfigError(f"{path}: expected a whole number as track of a {label.label}, got {label.track!r}")
    return label.track
