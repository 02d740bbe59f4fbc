"""A journal read from its file: every line checked, a torn end recognised."""

import gc
import itertools
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from farfield.datasets.edits.records import Record, decode, decode_all
from farfield.errors import FileFormatError

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
        for place, line in enumerate(lines, start=1):
            try:
                record = decode(line)
            except ValueError as error:
                if place < len(lines) or not last:
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


def _broken(path: Path, line: int, expected: str, found: str) -> FileFormatError:
    mend = (
        f"The edits of the {line - 1} lines before it are sound: to go on with those, keep a copy and cut the file "
        f"there (head -n {line - 1})."
    )
    return FileFormatError(path, where=f"line {line}", expected=expected, found=found, mend=mend)
