"""A journal read from its file: every line checked, a torn end recognised."""

from array import array
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from farfield.datasets.edits.records import Record, decode
from farfield.errors import FileFormatError

LONGEST_LINE = 64 << 20


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
    starts, end = array("q"), 0
    with path.open("rb") as handle:
        for line in iter(lambda: handle.readline(LONGEST_LINE), b""):
            try:
                record = decode(line)
            except ValueError as error:
                if handle.read(1):
                    raise _broken(path, len(starts) + 1, "an edit behind its checksum", str(error)) from None
                return Replay(starts, end, line)
            if record.seq != len(starts) + 1:
                raise _broken(path, len(starts) + 1, f"edit number {len(starts) + 1}", f"number {record.seq}")
            try:
                take(record)
            except ValueError as error:
                raise _broken(path, record.seq, "an edit that fits those before it", str(error)) from None
            starts.append(end)
            end += len(line)
    return Replay(starts, end, b"")


def _broken(path: Path, line: int, expected: str, found: str) -> FileFormatError:
    mend = (
        f"The edits of the {line - 1} lines before it are sound: to go on with those, keep a copy and cut the file "
        f"there (head -n {line - 1})."
    )
    return FileFormatError(path, where=f"line {line}", expected=expected, found=found, mend=mend)
