"""FlatBuffers, read within bounds: tables of fields that stand anywhere in one buffer.

Written from "FlatBuffers: Internals" (flatbuffers.dev/internals). Every offset is checked against the buffer before
it is followed; what lies outside is an error, never memory of another's.
"""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError

_MOST_TABLES = 1 << 20


@dataclass(frozen=True)
class FlatBuffer:
    """A buffer's bytes, and what they are for errors.

    Args:
        path: The file.
        where: Which buffer of it: ``"the chunk at byte 60"``.
        data: The bytes, without a size before them.
    """

    path: Any
    where: str
    data: bytes

    def fault(self, expected: str, got: str) -> FileFormatError:
        """The error for a value of it."""
        return FileFormatError(self.path, where=self.where, expected=expected, got=got, fix="Copy the file anew.")

    def number(self, kind: str, at: int) -> int | float:
        """A little-endian number of :mod:`struct`'s kind at a byte."""
        size = struct.calcsize("<" + kind)
        if not 0 <= at <= len(self.data) - size:
            raise self.fault(f"a number within its {len(self.data)} bytes", f"one at byte {at}")
        value: int | float = struct.unpack_from("<" + kind, self.data, at)[0]
        return value

    def whole(self, kind: str, at: int) -> int:
        """A whole number."""
        return int(self.number(kind, at))

    def root(self) -> "FlatTable":
        """The table that the buffer is."""
        return self.table(self.whole("I", 0))

    def table(self, at: int) -> "FlatTable":
        """The table at a byte, its list of fields checked."""
        fields = at - self.whole("i", at)
        size = self.whole("H", fields)
        if size < 4 or size % 2 or fields + size > len(self.data):
            raise self.fault("a table's list of fields", f"one of {size} bytes at byte {fields}")
        return FlatTable(self, at, fields, size)


@dataclass(frozen=True)
class FlatTable:
    """One table.

    Args:
        buffer: Where it stands.
        at: Its first byte.
        fields: First byte of its list of fields.
        size: Bytes of that list.
    """

    buffer: FlatBuffer
    at: int
    fields: int
    size: int

    def _field(self, slot: int) -> int | None:
        """Where a field stands; None where the table lacks it."""
        entry = 4 + 2 * slot
        offset = self.buffer.whole("H", self.fields + entry) if entry + 2 <= self.size else 0
        return self.at + offset if offset else None

    def whole(self, slot: int, kind: str, usual: int = 0) -> int:
        """A whole number; what is usual where it lacks."""
        at = self._field(slot)
        return usual if at is None else self.buffer.whole(kind, at)

    def _vector(self, slot: int, item_bytes: int) -> tuple[int, int]:
        """First byte and number of the items of a vector; none where it lacks."""
        at = self._field(slot)
        if at is None:
            return 0, 0
        start = at + self.buffer.whole("I", at)
        count = self.buffer.whole("I", start)
        if start + 4 + count * item_bytes > len(self.buffer.data):
            raise self.buffer.fault(f"at most {len(self.buffer.data)} bytes", f"{count} items of {item_bytes}")
        return start + 4, count

    def array(self, slot: int, dtype: str | np.dtype[Any]) -> Shaped[np.ndarray, " n"]:
        """A vector of numbers or structs, shape (n,)."""
        kind = np.dtype(dtype)
        start, count = self._vector(slot, kind.itemsize)
        return np.frombuffer(self.buffer.data, dtype=kind, count=count, offset=start)

    def content(self, slot: int) -> bytes:
        """A vector of bytes."""
        start, count = self._vector(slot, 1)
        return self.buffer.data[start : start + count]

    def text(self, slot: int) -> str:
        """A text."""
        try:
            return self.content(slot).decode()
        except UnicodeDecodeError:
            raise self.buffer.fault("a text in UTF-8", "other bytes") from None

    def tables(self, slot: int) -> "list[FlatTable]":
        """A vector of tables."""
        start, count = self._vector(slot, 4)
        if count > _MOST_TABLES:
            raise self.buffer.fault(f"at most {_MOST_TABLES} tables", f"{count}")
        entries = range(start, start + 4 * count, 4)
        return [self.buffer.table(entry + self.buffer.whole("I", entry)) for entry in entries]
