"""The journal of edits: its lines, reading it, where it stands, and the state that its edits add up to.

One line is an edit with all that it changed, behind its checksum.

A line is eight hexadecimal digits (CRC-32 of the rest), a space, compact JSON, a line feed::

    5f1c09aa {"seq":7,"id":"w1-3","time_ns":1764000000000000000,"by":"ann","window":"w1","op":"box.set",
              "changes":[["box","21","00033_00001","4"],3,{...},{...}], ...}

What is edited stands in *cells*: a box of a frame, what holds for a track, a bookmark. A change holds the cell's value
before and after (None: there was or is nothing), so that every edit can be taken back. One line is one edit, however
many cells it changes: a crash keeps all of it or nothing.
"""

import gc
import hashlib
import itertools
import json
import os
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from farfield.datasets.labels.formats import BoxLabel, Numbers
from farfield.errors import ConfigError, DatasetError, FileFormatError, plain
from farfield.files.json_text import plain_json
from farfield.files.limits import open_file
from farfield.files.outputs import check_writable
from farfield.frame import Key
from farfield.vocabulary.counts import count_of

Cell = tuple[str, ...]
"""What is edited: ``("box", sequence, frame, object)``, ``("track", drive, track)``, ``("extent",)``..."""
Json = Any


class CellEdit(NamedTuple):
    """One cell before and after.

    Args:
        cell: The cell.
        base: Version before: the number of the edit that set it last, 0 as the files have it.
        old: Value before; None where there was nothing.
        new: Value after; None where nothing is left.
    """

    cell: Cell
    base: int
    old: Json
    new: Json


class Record(NamedTuple):
    """One edit.

    Args:
        seq: Its number, from 1, without gaps.
        id: The client's name of it, by which a message sent twice is recognised.
        time_ns: When it was made, since 1970.
        by: Annotator.
        window: Window of the browser.
        op: What was done, such as ``box.set``.
        changes: What changed.
        group: Edits of one group are taken back together; None: it is a group of its own.
        undoes: The edits that this one takes back (``op`` ``undo``) or does again (``redo``).
        data: What else belongs to it, such as the files that a ``save`` wrote.
    """

    seq: int
    id: str
    time_ns: int
    by: str
    window: str
    op: str
    changes: tuple[CellEdit, ...] = ()
    group: str | None = None
    undoes: tuple[int, ...] = ()
    data: Mapping[str, Json] | None = None


def box_cell(key: Key, name: str) -> Cell:
    """The cell of a box."""
    return ("box", *key, name)


def track_cell(drive: str, track: str) -> Cell:
    """The cell of what holds for a track in all frames of its drive."""
    return ("track", drive, track)


def encode(record: Record) -> bytes:
    """The line of an edit, as :func:`decode` reads it: one that cannot be read would shut the whole journal.

    Raises:
        ValueError: If a number in it is not finite or beyond 64 bits, or anything else that a line cannot hold.
    """
    fields: dict[str, Json] = {
        "seq": record.seq,
        "id": record.id,
        "time_ns": record.time_ns,
        "by": record.by,
        "window": record.window,
        "op": record.op,
    }
    optional = {"changes": record.changes, "group": record.group, "undoes": record.undoes, "data": record.data}
    fields |= {name: value for name, value in optional.items() if value}
    text = json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()
    line = b"%08x %s\n" % (zlib.crc32(text), text)
    decode(line)
    return line


def decode(line: bytes) -> Record:
    """An edit from its line.

    Raises:
        ValueError: If the line is torn, damaged or holds something else; the message says which.
    """
    if not line.endswith(b"\n"):
        raise ValueError("a line without its end")
    text = line[9:-1]
    if line[8:9] != b" " or line[:8] != b"%08x" % zlib.crc32(text):
        raise ValueError("a line that does not fit its checksum")
    try:
        fields = plain_json(text)
        return _record(fields)
    except (KeyError, TypeError) as error:
        raise ValueError(f"a line that is no edit ({plain(error)})"[:160]) from None


def decode_all(lines: Sequence[bytes]) -> list[Record]:
    """The edits of many lines, parsed at once: three times as fast as one by one.

    Raises:
        ValueError: If one of them is damaged; :func:`decode` says which and why.
    """
    for line in lines:
        if line[-1:] != b"\n" or line[8:9] != b" " or line[:8] != b"%08x" % zlib.crc32(line[9:-1]):
            raise ValueError("a line that does not fit its checksum")
    try:
        records = plain_json(b"[%s]" % b",".join(line[9:-1] for line in lines))
        if len(records) != len(lines):
            raise ValueError("a line that is no edit")
        return [_record(fields) for fields in records]
    except (KeyError, TypeError) as error:
        raise ValueError(f"a line that is no edit ({type(error).__name__})") from None


def _record(fields: Json) -> Record:
    if not isinstance(fields, dict):
        raise TypeError(f"a {type(fields).__name__} in its place")
    changes = tuple(CellEdit(tuple(cell), base, old, new) for cell, base, old, new in fields.get("changes", ()))
    record = Record(
        fields["seq"],
        fields["id"],
        fields["time_ns"],
        fields["by"],
        fields["window"],
        fields["op"],
        changes,
        fields.get("group"),
        tuple(fields.get("undoes", ())),
        fields.get("data"),
    )
    sound = type(record.seq) is type(record.time_ns) is int
    sound = sound and type(record.id) is type(record.by) is type(record.window) is type(record.op) is str
    for number in record.undoes:
        sound = sound and type(number) is int
    for cell, base, _, _ in changes:
        sound = sound and type(base) is int
        for part in cell:
            sound = sound and type(part) is str
    sound = sound and isinstance(record.group, str | None) and isinstance(record.data, dict | None)
    if not sound:
        raise TypeError("a field of another kind than it must be")
    return record


# What cells and data hold: who reads a journal checks it, so that nothing behind meets a value of another form.

_PARTS = {"box": 4, "track": 3, "bookmark": 3, "ignored": 2, "extent": 1}


def check_values(record: Record) -> None:
    """Check what an edit says of boxes, tracks, notes, saved files and times.

    Raises:
        ValueError: If a cell has other parts than its kind, or a value is none of its kind.
    """
    for cell, _, old, new in record.changes:
        _check_change(cell, old, new)
    _check_data(record.data or {})


def _check_change(cell: Cell, *values: Json) -> None:
    """Check the values of a cell before and after; cells of other kinds may hold anything."""
    kind = cell[0] if cell else ""
    if len(cell) != _PARTS.get(kind, max(1, len(cell))):
        raise ValueError(f"a cell of other parts than it must have, {'/'.join(cell)[:80]!r}")
    for value in values:
        if value is None:
            continue
        if kind == "box":
            if not isinstance(value, dict):
                raise ValueError(f"expected the value of a box, got {str(value)[:80]}")
            label_of(cell[3], value)
        elif kind == "track" and not _is_track(value):
            raise ValueError(f"expected what holds for a track, got {str(value)[:80]}")
        elif kind == "extent" and value not in ("full", "visible"):
            raise ValueError(f"expected full or visible, got {str(value)[:80]}")
        elif kind in ("bookmark", "ignored") and not isinstance(value, str):
            raise ValueError(f"expected a note, got {str(value)[:80]}")


def _is_track(value: Json) -> bool:
    if not isinstance(value, dict) or not value.keys() <= {"locked", "ends", "label", "size"}:
        return False
    texts = all(isinstance(value.get(name, ""), str) for name in ("ends", "label"))
    size = value.get("size", [1, 1, 1])
    return texts and isinstance(size, list) and len(size) == 3 and all(is_number(side) and side > 0 for side in size)


def _check_data(data: Mapping[str, Json]) -> None:
    """Check the files that a save names, and what a box took to annotate."""
    files = data.get("files", {})
    if not isinstance(files, dict) or not all(isinstance(state, str) for state in files.values()):
        raise ValueError(f"expected states of files by name, got {str(files)[:80]}")
    written = data.get("written")
    if written is not None and not _is_save(written):
        raise ValueError(f"expected what a save wrote, got {str(written)[:80]}")
    if "seconds" in data:
        frame = data.get("frame")
        sound = isinstance(frame, list) and len(frame) == 2 and all(isinstance(part, str) for part in frame)
        sound = sound and isinstance(data.get("box"), str) and type(data.get("edits")) is int
        if not (sound and is_number(data["seconds"])):
            raise ValueError(f"expected frame, box, seconds and edits, got {str(data)[:80]}")


def _is_save(value: Json) -> bool:
    if not isinstance(value, dict) or value.keys() != {"seq", "folder", "format", "left"}:
        return False
    counts = all(type(value[name]) is int and value[name] >= 0 for name in ("seq", "left"))
    return counts and isinstance(value["folder"], str) and isinstance(value["format"], str)


def is_number(value: Json) -> bool:
    """Whether a value of JSON is a number, which truth values are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


# A box of a frame as the journal writes it.

_PLAIN: tuple[tuple[str, Any], ...] = (
    ("track", ""),
    ("state", "accepted"),
    ("source", ""),
    ("attributes", {}),
    ("score", None),
)


def value_of(label: BoxLabel, proposal: Numbers | None = None) -> dict[str, Any]:
    """The journal's value of a label; what is as usual is left out.

    Args:
        label: The label.
        proposal: The detector's box from which it came.
    """
    value: dict[str, Any] = {"label": label.label, "box": [float(number) for number in label.box]}
    for name, usual in _PLAIN:
        present = getattr(label, name)
        if present != usual:
            value[name] = dict(present) if name == "attributes" else present
    if proposal is not None:
        value["proposal"] = [float(number) for number in proposal]
    return value


def label_of(name: str, value: Mapping[str, Any]) -> BoxLabel:
    """The label of a value.

    Raises:
        ValueError: If the value is no box's.
    """
    fields = {"label", "box", "proposal", *(field for field, _ in _PLAIN)}
    if not isinstance(value, Mapping) or not {"label", "box"} <= value.keys() <= fields:
        raise ValueError(f"expected the value of a box, got {str(value)[:80]}")
    more = {field: value[field] for field, _ in _PLAIN if field in value}
    attributes, score = more.get("attributes", {}), more.get("score")
    texts = all(isinstance(more.get(field, ""), str) for field in ("track", "state", "source"))
    plain = isinstance(attributes, dict) and all(isinstance(item, str | int | float) for item in attributes.values())
    if not (texts and plain and isinstance(value["label"], str) and (score is None or is_number(score))):
        raise ValueError(f"expected the value of a box, got {str(value)[:80]}")
    if value.get("proposal") is not None:
        numbers(value["proposal"])
    if score is not None:
        more["score"] = float(score)  # JSON writes 1.0 as 1 where JavaScript wrote it
    return BoxLabel(id=name, label=str(value["label"]), box=numbers(value["box"]), **more)


def numbers(box: Any) -> Numbers:
    """Seven numbers of a box.

    Raises:
        ValueError: If they are not seven numbers.
    """
    if not isinstance(box, list | tuple) or len(box) != 7 or not all(map(is_number, box)):
        raise ValueError(f"expected seven numbers of a box, got {str(box)[:80]}")
    x, y, z, length, width, height, yaw = map(float, box)
    return x, y, z, length, width, height, yaw


# Reading a journal: every line checked, a torn end recognised.

LONGEST_LINE = 64 << 20
_BLOCK = 256  # lines that are parsed at once


class Replay(NamedTuple):
    """What a journal holds.

    Args:
        starts: Where each line begins, in bytes; the edit with number n stands in line n.
        end: Where the next line goes.
        torn: What stands behind ``end``: the rest of a line whose edit was never acknowledged; usually nothing.
    """

    starts: "array[int]"
    end: int
    torn: bytes


def read_journal(path: Path, take: Callable[[Record], None]) -> Replay:
    """Read a journal, handing on each edit in order.

    A last line that is torn (no end, or a checksum that does not fit) was not acknowledged, since that happens after
    the line is on the disk: it is left out.

    Args:
        path: The file.
        take: Called with each edit.

    Raises:
        FileFormatError: If a line before the last is damaged, or an edit does not follow the one before it.
    """
    replay = _Reading(path, take)
    collecting = gc.isenabled()
    gc.disable()  # nothing of an edit is cyclic, and looking for it takes a third of the time
    try:
        with open_file(path, max_bytes=None) as handle:
            lines = iter(lambda: handle.readline(LONGEST_LINE), b"")
            block = list(itertools.islice(lines, _BLOCK))
            while block:
                following = list(itertools.islice(lines, _BLOCK))
                torn = replay.block(block, last=not following)
                if torn:
                    return Replay(replay.starts, replay.end, torn)
                block = following
    finally:
        if collecting:
            gc.enable()
    return Replay(replay.starts, replay.end, b"")


class _Reading:
    """Where reading a journal has come to."""

    def __init__(self, path: Path, take: Callable[[Record], None]) -> None:
        self.path, self.take = path, take
        self.starts, self.end = array("q"), 0

    def block(self, lines: Sequence[bytes], *, last: bool) -> bytes:
        """Take some lines; gives the last one where it is torn."""
        try:
            records = decode_all(lines)
        except ValueError:
            return self._one_by_one(lines, last=last)
        for line, record in zip(lines, records, strict=True):
            self._keep(line, record)
        return b""

    def _one_by_one(self, lines: Sequence[bytes], *, last: bool) -> bytes:
        for number, line in enumerate(lines, start=1):
            try:
                record = decode(line)
            except ValueError as error:
                if number < len(lines) or not last:
                    expected = "an edit behind its checksum"
                    raise _broken(self.path, len(self.starts) + 1, expected, str(error)) from None
                return line
            self._keep(line, record)
        return b""

    def _keep(self, line: bytes, record: Record) -> None:
        due = len(self.starts) + 1
        if record.seq != due:
            raise _broken(self.path, due, f"edit number {due}", f"number {record.seq}")
        try:
            self.take(record)
        except ValueError as error:
            raise _broken(self.path, due, "an edit that fits those before it", str(error)) from None
        self.starts.append(self.end)
        self.end += len(line)


def _broken(path: Path, line: int, expected: str, actual: str) -> FileFormatError:
    fix = (
        f"The edits of the {count_of(line - 1, 'line')} before it are sound: "
        "to go on with those, keep a copy and cut the file "
        f"there (head -n {line - 1})."
    )
    return FileFormatError(path, where=f"line {line}", expected=expected, got=actual, fix=fix)


# Where a journal stands: beside the labels, or in the user's own folder where those cannot be written.

FOLDER = ".farfield-studio"
JOURNAL = "edits.jsonl"


def journal_folder(labels: Path) -> Path:
    """The folder of a data set's journal, made if it is missing.

    It stands beside the labels if something can be written there; else below ``$XDG_DATA_HOME`` (or
    ``~/.local/share``), under a name made of the labels' path.

    Args:
        labels: Folder of the labels.

    Raises:
        DatasetError: If edits stand beside the labels already and cannot be gone on with.
    """
    here = labels.resolve() / FOLDER
    if _writable(here):
        return here
    if (here / JOURNAL).is_file():
        raise DatasetError(
            f"{here / JOURNAL}: expected a journal that can be written to, as it holds edits. Make the folder "
            "writable, or copy the labels with it to where you can write."
        )
    there = user_folder(labels)
    there.mkdir(parents=True, exist_ok=True)
    return there


def user_folder(labels: Path) -> Path:
    """The folder of the user's own for edits of labels that cannot be written beside."""
    base = os.environ.get("XDG_DATA_HOME") or "~/.local/share"
    digest = hashlib.sha256(os.fsencode(labels.resolve())).hexdigest()[:12]
    return Path(base).expanduser() / "farfield" / "studio" / f"{labels.resolve().name}-{digest}"


def _writable(folder: Path) -> bool:
    try:
        check_writable(folder)  # before the folder is made: on a full disk none is left
        folder.mkdir(exist_ok=True)
    except (OSError, ConfigError):
        return False
    return True


# What the edits add up to: the present value of every cell that was touched.


class CellState(NamedTuple):
    """A cell as it stands.

    Args:
        value: Its value; None where nothing is left.
        version: Number of the edit that set it last.
        by: Who made that edit.
        born: Number of the edit that touched it first.
        original: Whether the files have it, as opposed to one that was added.
    """

    value: Any
    version: int
    by: str
    born: int
    original: bool


class EditState:
    """The present value of every cell that was touched; what is not in it is as the files have it."""

    def __init__(self) -> None:
        self._cells: dict[Cell, CellState] = {}
        self._frames: dict[Key, dict[str, Cell]] = {}
        self.seq = 0

    def apply(self, record: Record) -> None:
        """Take an edit in; nothing of it if it does not fit.

        Raises:
            ValueError: If a value before is not the one that stands here, or the edit is out of turn.
        """
        if record.seq != self.seq + 1:
            raise ValueError(f"edit {record.seq} where {self.seq + 1} is due")
        for change in record.changes:
            present = self._cells.get(change.cell)
            if present is not None and present.value != change.old:
                raise ValueError(f"an edit of {'/'.join(change.cell)} that starts from another value")
        for change in record.changes:
            present = self._cells.get(change.cell)
            born = record.seq if present is None else present.born
            original = change.old is not None if present is None else present.original
            self._cells[change.cell] = CellState(change.new, record.seq, record.by, born, original)
            if present is None and change.cell[0] == "box":
                _, sequence, frame, name = change.cell
                self._frames.setdefault((sequence, frame), {})[name] = change.cell
        self.seq = record.seq

    def get(self, cell: Cell) -> CellState | None:
        """A cell as it stands; None where it was never touched."""
        return self._cells.get(cell)

    def touched(self, key: Key) -> dict[str, CellState]:
        """The boxes of a frame that were touched, by name, in the order in which they were."""
        return {name: self._cells[cell] for name, cell in self._frames.get(key, {}).items()}

    def frames(self) -> tuple[Key, ...]:
        """Frames in which a box was touched."""
        return tuple(self._frames)

    def of_kind(self, kind: str) -> Iterator[tuple[Cell, CellState]]:
        """All touched cells of a kind, such as ``"bookmark"``."""
        return ((cell, standing) for cell, standing in self._cells.items() if cell[0] == kind)
