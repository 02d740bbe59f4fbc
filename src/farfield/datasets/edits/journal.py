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
import tempfile
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from farfield.datasets.labels.formats import BoxLabel, Numbers
from farfield.errors import DatasetError, FileFormatError, plain
from farfield.frame import Key

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
    """The line of an edit.

    Raises:
        ValueError: If a number in it is not finite.
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
    return b"%08x %s\n" % (zlib.crc32(text), text)


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
        fields = json.loads(text)
        return _record(fields)
    except (KeyError, TypeError, RecursionError) as error:
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
        records = json.loads(b"[%s]" % b",".join(line[9:-1] for line in lines))
        if len(records) != len(lines):
            raise ValueError("a line that is no edit")
        return [_record(fields) for fields in records]
    except (KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"a line that is no edit ({type(error).__name__})") from None


def _record(fields: Mapping[str, Json]) -> Record:
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
    if not sound:
        raise TypeError("a field of another kind than it must be")
    return record


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
    return BoxLabel(id=name, label=str(value["label"]), box=numbers(value["box"]), **more)


def numbers(box: Any) -> Numbers:
    """Seven numbers of a box.

    Raises:
        ValueError: If they are not seven numbers.
    """
    if len(box) != 7 or not all(isinstance(number, int | float) for number in box):
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
        with path.open("rb") as handle:
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
        f"The edits of the {line - 1} lines before it are sound: to go on with those, keep a copy and cut the file "
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
        folder.mkdir(exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


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
