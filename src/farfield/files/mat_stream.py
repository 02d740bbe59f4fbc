"""One array of a MATLAB v5 file in blocks, so that it need never be in memory whole.

The file is read, and a compressed array inflated, on a thread of its own while the caller works on the block before.
What a header claims is compared with the bytes that are there before anything is allocated; a compressed array's
checksum is verified.
"""

import math
import os
import stat
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import MAX_BYTES
from farfield.files.mat_format import (
    CLASSES,
    COMPLEX_FLAG,
    COMPRESSED,
    HEADER_BYTES,
    MATRIX,
    MAX_AXES,
    MAX_EXPANSION,
    STORED,
    TRUNCATED,
    check_header,
)

_READ_BYTES = 1 << 20  # of packed bytes at a time
_PIECE_BYTES = 1 << 22  # inflated at a time, at most
_MAX_HEAD_BYTES = 256  # of one of the small elements before an array's numbers
_BUFFERS = 3  # one being filled, one waiting, one in the caller's hands


class _Plain:
    """The file's own bytes."""

    def __init__(self, handle: BinaryIO, count: int, path: Path | str) -> None:
        self.handle, self.left, self.path = handle, count, path

    def fault(self, expected: str, found: str) -> FileFormatError:
        """What is wrong with the array."""
        return FileFormatError(self.path, where="the array", expected=expected, found=found, mend=TRUNCATED)

    def fill(self, into: memoryview) -> None:
        """Fill a buffer with the next bytes."""
        count = into.nbytes
        got = self.handle.readinto(into) if count <= self.left else self.left  # type: ignore[attr-defined]
        self.left -= got
        if got < count:
            raise self.fault(f"{count} more bytes", f"{got}")

    def seen(self, data: memoryview | bytearray) -> None:
        """Plain arrays have no checksum."""

    def finish(self) -> None:
        """Nor an end that could be checked."""


class _Inflated(_Plain):
    """The bytes that a zlib stream (RFC 1950) in the file expands to.

    The checksum is computed in :meth:`seen`, which the caller's thread runs while this one inflates.
    """

    def __init__(self, handle: BinaryIO, count: int, path: Path | str) -> None:
        super().__init__(handle, count, path)
        self.checksum, self.rest, self.packed = zlib.adler32(b""), memoryview(b""), b""
        head = self._read(2)
        if len(head) < 2 or head[0] & 0x0F != 8 or int.from_bytes(head, "big") % 31 or head[1] & 0x20:
            raise self.fault("a compressed array", repr(head))
        self.stream = zlib.decompressobj(-15)

    def _read(self, count: int) -> bytes:
        data = self.handle.read(min(count, self.left))
        self.left -= len(data)
        return data

    def fill(self, into: memoryview) -> None:
        """Fill a buffer with the next inflated bytes."""
        at, count = 0, into.nbytes
        while at < count:
            if not self.rest:
                self.rest = memoryview(self._inflate())
                if not self.rest:
                    raise self.fault(f"{count - at} more bytes", "the end")
            step = min(len(self.rest), count - at)
            into[at : at + step], self.rest = self.rest[:step], self.rest[step:]
            at += step

    def _inflate(self) -> bytes:
        """Inflate some more; nothing only at the end."""
        data = b""
        try:
            while not data and not self.stream.eof:
                self.packed = self.packed or self._read(_READ_BYTES)
                if not self.packed:
                    break
                data = self.stream.decompress(self.packed, _PIECE_BYTES)
                self.packed = self.stream.unconsumed_tail
        except zlib.error as error:
            raise self.fault("a compressed array", str(error)[:120]) from error
        return data

    def seen(self, data: memoryview | bytearray) -> None:
        """Add to the checksum."""
        self.checksum = zlib.adler32(data, self.checksum)

    def finish(self) -> None:
        """Check that the stream ends here, with the right checksum."""
        if self.rest or self._inflate():
            raise self.fault("the end of the array", "more bytes")
        tail = self.stream.unused_data[:4]
        tail += self._read(4 - len(tail))
        if not self.stream.eof or tail != self.checksum.to_bytes(4, "big"):
            raise self.fault(f"checksum {self.checksum:08x}", tail.hex() or "the end")


@dataclass
class MatStream:
    """An array that is read once, in its own order: the first axis runs fastest.

    Args:
        shape: Its axes.
        dtype: What its numbers are stored as; MATLAB stores doubles that are small integers as such.
        padding: Bytes after the numbers.
        source: Where the numbers come from.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    padding: int
    source: _Plain

    def blocks(self, columns: int) -> Iterator[Shaped[np.ndarray, "n first"]]:
        """Read the array as rows of its first axis: row k is the k-th column of the file.

        Args:
            columns: Rows of a block; the last block may have fewer.

        Yields:
            Blocks of shape (rows, shape[0]). They are overwritten: use one before asking for the next.

        Raises:
            FileFormatError: If the array is cut short or damaged.
        """
        total = math.prod(self.shape[1:]) if self.shape[0] else 0
        counts = [min(columns, total - start) for start in range(0, total, columns)]
        ring = [np.empty((max(counts, default=0), self.shape[0]), dtype=self.dtype) for _ in range(_BUFFERS)]
        with ThreadPoolExecutor(1) as reader:
            blocks = [ring[number % _BUFFERS][:count] for number, count in enumerate(counts)]
            jobs = [reader.submit(self.source.fill, _bytes_of(block)) for block in blocks[:1]]
            for number, block in enumerate(blocks):
                jobs += [reader.submit(self.source.fill, _bytes_of(later)) for later in blocks[number + 1 : number + 2]]
                jobs.pop(0).result()
                self.source.seen(_bytes_of(block))
                yield block
        _take(self.source, self.padding)
        self.source.finish()


def _bytes_of(block: np.ndarray) -> memoryview:
    return block.reshape(-1).view(np.uint8).data


@contextmanager
def open_mat(path: Path | str, name: str, *, max_bytes: int = MAX_BYTES) -> Iterator[MatStream]:
    """Open one real numeric array of a MATLAB v5 file for reading in blocks.

    Args:
        path: The file.
        name: Name of the variable.
        max_bytes: Largest file, and largest expanded array, that is accepted.

    Yields:
        The array, of which nothing but the header has been read; valid while the context is open.

    Raises:
        FileFormatError: If the file is no such file, is damaged, or has no numeric array of this name.
    """
    with Path(path).open("rb") as handle:
        status = os.fstat(handle.fileno())
        if not stat.S_ISREG(status.st_mode) or status.st_size > max_bytes:
            expected, found = f"a regular file of at most {max_bytes} bytes", f"{status.st_size} bytes"
            raise FileFormatError(path, where="the file", expected=expected, found=found)
        check_header(handle.read(HEADER_BYTES), path)
        yield _find(handle, status.st_size, name, max_bytes, path)


def _find(handle: BinaryIO, size: int, name: str, max_bytes: int, path: Path | str) -> MatStream:
    at, found = HEADER_BYTES, []
    while at + 8 <= size:
        handle.seek(at)
        kind, count = _two(handle.read(8))
        if kind >> 16:  # a small element: its data stand in its tag
            at += 8
            continue
        if count > size - at - 8:
            expected, left = f"{count} bytes of an element", f"{size - at - 8} bytes"
            raise FileFormatError(path, where=f"byte {at}", expected=expected, found=left, mend=TRUNCATED)
        if kind in (MATRIX, COMPRESSED):
            source, inside = _opened(handle, kind, count, max_bytes, path)
            flags, flag_bytes = _small_element(source)
            sides, side_bytes = _small_element(source)
            called, name_bytes = _small_element(source)
            if called == name.encode():
                return _array(source, flags, sides, inside - flag_bytes - side_bytes - name_bytes)
            found.append(called[:64].decode("ascii", errors="replace"))
        at += 8 + count + (0 if kind == COMPRESSED else -count % 8)
    held = ", ".join(found[:8]) or "no array"
    mend = "" if found else TRUNCATED
    raise FileFormatError(path, where="the file", expected=f"an array {name!r}", found=held, mend=mend)


def _opened(handle: BinaryIO, kind: int, count: int, max_bytes: int, path: Path | str) -> tuple[_Plain, int]:
    """The contents of an array's element, and how many bytes they claim to be."""
    if kind == MATRIX:
        return _Plain(handle, count, path), count
    source = _Inflated(handle, count, path)
    inner, size = _two(_take(source, 8))
    if inner != MATRIX or size > min(max_bytes, count * MAX_EXPANSION):
        expected = f"an array of at most {max_bytes} bytes and {MAX_EXPANSION}-fold expansion"
        raise source.fault(expected, f"type {inner}, {size} bytes")
    return source, size


def _two(tag: bytes) -> tuple[int, int]:
    return int.from_bytes(tag[:4], "little"), int.from_bytes(tag[4:8], "little")


def _take(source: _Plain, count: int) -> bytes:
    data = bytearray(count)
    source.fill(memoryview(data))
    source.seen(data)
    return bytes(data)


def _small_element(source: _Plain) -> tuple[bytes, int]:
    """The data of one of an array's first elements, and how many bytes it took with its tag and padding."""
    word = int.from_bytes(_take(source, 4), "little")
    if word >> 16:
        return _take(source, 4)[: word >> 16], 8
    size = int.from_bytes(_take(source, 4), "little")
    if size > _MAX_HEAD_BYTES:
        raise source.fault(f"at most {_MAX_HEAD_BYTES} bytes of an array's header", f"{size}")
    padded = size + -size % 8
    return _take(source, padded)[:size], 8 + padded


def _array(source: _Plain, flags: bytes, shape: bytes, left: int) -> MatStream:
    """Compare what the header says with the room there is for the numbers."""
    word = int.from_bytes(flags[:4], "little")
    number = int.from_bytes(_take(source, 4), "little")
    small = number >> 16
    size = small or int.from_bytes(_take(source, 4), "little")
    kind = number & 0xFFFF if small else number
    if len(flags) != 8 or word & 0xFF not in CLASSES or word & COMPLEX_FLAG or kind not in STORED:
        raise source.fault("a real numeric array", f"class {word & 0xFF}, flags {word:#x}, type {kind}")
    if len(shape) % 4 or not 2 <= len(shape) // 4 <= MAX_AXES:
        raise source.fault(f"2 to {MAX_AXES} dimensions", f"{len(shape)} bytes of them")
    sides = tuple(int(side) for side in np.frombuffer(shape, dtype="<i4"))
    dtype = np.dtype("<" + STORED[kind])
    padding = left - (4 if small else 8) - size
    if min(sides) < 0 or math.prod(sides) * dtype.itemsize != size or not 0 <= padding < 8:
        expected = f"{' x '.join(map(str, sides))} numbers of {dtype.itemsize} bytes"
        raise source.fault(expected, f"{size} bytes, {left} with the tag")
    return MatStream(sides, dtype, padding, source)
