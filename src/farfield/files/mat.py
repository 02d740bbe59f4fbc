"""MATLAB v5 files (``save -v6`` and ``-v7``): numeric arrays in and out ("MAT-File Format", The MathWorks, level 5).

Nothing is allocated from a claimed size alone: what the header of an array says is compared with the bytes that follow.
MATLAB stores arrays with the first axis fastest; they come back as such views, and are written from any memory order.
"""

import itertools
import math
import os
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.limits import MAX_TENSOR_BYTES, is_addressable, open_file
from farfield.files.stand_ins import check_itself

_MAX_NAME_BYTES = 63  # MATLAB's namelengthmax
_TEXT = b"MATLAB 5.0 MAT-file, written by Farfield"


@dataclass(frozen=True)
class _Element:
    """One tagged element: its type, its bytes and where they begin."""

    kind: int
    data: memoryview
    offset: int


def read_mat(path: Path | str, name: str, *, max_bytes: int = MAX_TENSOR_BYTES) -> Shaped[np.ndarray, "..."]:
    """Read one real numeric array.

    Args:
        path: The file.
        name: Name of the variable.
        max_bytes: Largest file, and largest expanded array, that is accepted.

    Returns:
        The array in its MATLAB class's dtype and with all its axes (at least two), in Fortran order; it may be
        read-only.

    Raises:
        FileFormatError: If the file is no such file, is damaged, or has no numeric array of this name.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    check_header(data, path)
    names = []
    for element in _elements(memoryview(data)[HEADER_BYTES:], HEADER_BYTES, path):
        if element.kind not in (MATRIX, COMPRESSED):
            continue
        if element.kind == COMPRESSED and (other := _other_name(element, name, path)):
            names.append(other)
            continue
        matrix = _expanded(element, max_bytes, path) if element.kind == COMPRESSED else element
        parts = _elements(matrix.data, matrix.offset, path)
        flags, shape, called = (next(parts, None) for _ in range(3))
        if flags is None or shape is None or called is None:
            raise _fault(path, matrix, "flags, dimensions and a name", f"{len(matrix.data)} bytes")
        text = bytes(called.data[: _MAX_NAME_BYTES + 1]).decode("ascii", errors="replace")
        if text == name:
            return _array(flags, shape, next(parts, None), path)
        names.append(text)
    fix = "" if names else TRUNCATED
    held = ", ".join(names[:8]) or "no array"
    raise FileFormatError(path, where="the file", expected=f"an array {name!r}", got=held, fix=fix)


def _fault(path: Path | str, element: _Element, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"byte {element.offset}", expected=expected, got=actual)


def _elements(data: memoryview, offset: int, path: Path | str) -> Iterator[_Element]:
    """Walk the elements that stand one after another; all but compressed ones are padded to eight bytes."""
    at = 0
    while at + 8 <= len(data):
        kind, size = (int(number) for number in np.frombuffer(data, dtype="<u4", count=2, offset=at))
        start, small = at + 8, kind >> 16
        if small:  # both fit into one tag: size and type as two 16-bit numbers, then up to four bytes
            kind, size, start = kind & 0xFFFF, small, at + 4
            if size > 4:
                expected, where = "at most 4 bytes in a small element", f"byte {offset + at}"
                raise FileFormatError(path, where=where, expected=expected, got=f"{size}")
        if size > len(data) - start:
            expected, actual = f"{size} bytes of an element", f"{len(data) - start} bytes"
            fix = "The file is truncated."
            raise FileFormatError(path, where=f"byte {offset + at}", expected=expected, got=actual, fix=fix)
        yield _Element(kind, data[start : start + size], offset + start)
        end = start + size
        at = at + 8 if small else end if kind == COMPRESSED else end + -end % 8


def _other_name(element: _Element, name: str, path: Path | str) -> str:
    """The name of a packed array, if it is another, of which no more is unpacked; empty where it may be the one."""
    try:
        head = zlib.decompressobj().decompress(bytes(element.data[:4096]), 8 + _MAX_HEAD_BYTES)
        parts = _elements(memoryview(head + bytes(_MAX_HEAD_BYTES))[8:], element.offset, path)
        called = next(itertools.islice(parts, 2, None), None)
    except (zlib.error, FileFormatError):  # which the whole array shows
        return ""
    text = "" if called is None else bytes(called.data[: _MAX_NAME_BYTES + 1]).decode("ascii", errors="replace")
    return text if text != name else ""


def _expanded(element: _Element, max_bytes: int, path: Path | str) -> _Element:
    """Expand a compressed element; what it holds is one element with its own tag."""
    expected = "a compressed array"
    try:
        stream = zlib.decompressobj()
        tag = stream.decompress(bytes(element.data[:4096]), 8)
        kind, size = (int(number) for number in np.frombuffer(tag, dtype="<u4", count=2))
        if size > min(max_bytes, len(element.data) * MAX_EXPANSION):
            raise _fault(path, element, f"at most {max_bytes} bytes and {MAX_EXPANSION}-fold expansion", f"{size}")
        body = zlib.decompressobj().decompress(element.data, 8 + size)
    except (zlib.error, ValueError) as error:
        raise _fault(path, element, expected, str(error)[:120]) from error
    if len(body) != 8 + size or kind != MATRIX:
        raise _fault(path, element, f"an array of {size} bytes", f"{len(body) - 8} bytes of type {kind}")
    return _Element(kind, memoryview(body)[8:], element.offset)


def _array(flags: _Element, shape: _Element, real: _Element | None, path: Path | str) -> Shaped[np.ndarray, "..."]:
    if flags.kind != UINT32 or len(flags.data) != 8:
        raise _fault(path, flags, "8 bytes of array flags", f"{len(flags.data)} bytes of type {flags.kind}")
    word = int(np.frombuffer(flags.data, dtype="<u4", count=1)[0])
    kind = CLASSES.get(word & 0xFF)
    if kind is None or word & COMPLEX_FLAG or real is None or real.kind not in STORED:
        raise _fault(path, flags, "a real numeric array", f"class {word & 0xFF}, flags {word:#x}")
    if shape.kind != INT32 or len(shape.data) % 4 or not 2 <= len(shape.data) // 4 <= MAX_AXES:
        raise _fault(path, shape, f"2 to {MAX_AXES} dimensions", f"{len(shape.data)} bytes of type {shape.kind}")
    sides = [int(side) for side in np.frombuffer(shape.data, dtype="<i4")]
    stored = np.dtype("<" + STORED[real.kind])
    if not is_addressable(sides, 8) or math.prod(sides) * stored.itemsize != len(real.data):
        expected = f"{' x '.join(map(str, sides))} numbers of {stored.itemsize} bytes"
        raise _fault(path, real, expected, f"{len(real.data)} bytes")
    values = np.frombuffer(real.data, dtype=stored).astype("<" + kind, copy=False)  # MATLAB shrinks what fits less
    return values.reshape(sides, order="F")


def write_mat(path: Path | str, name: str, array: Shaped[np.ndarray, "..."], *, compress: bool = False) -> None:
    """Write one real numeric array, all or nothing; the same bytes for the same array.

    Args:
        path: The file to write.
        name: Name of the variable: a letter, then letters, digits and underscores, at most 63.
        array: Integers, float32 or float64, at least two axes.
        compress: Pack it with zlib, as MATLAB does by default.

    Raises:
        ValueError: If the name or the array does not fit the format (a file holds less than 2 GiB an array).
    """
    classes = {kind: number for number, kind in CLASSES.items()}
    types = {kind: number for number, kind in STORED.items()}
    kind = array.dtype.str[1:]
    if not (name.isascii() and name.isidentifier() and not name.startswith("_") and len(name) <= _MAX_NAME_BYTES):
        raise ValueError(f"write_mat: expected a MATLAB variable's name, got {name!r}")
    if kind not in classes or not 2 <= array.ndim <= MAX_AXES or array.nbytes >= 1 << 31:
        raise ValueError(f"write_mat: expected 2 or more axes of numbers, < 2 GiB, got {array.dtype} {array.shape}")
    head = _tagged(UINT32, np.array([classes[kind], 0], dtype="<u4").tobytes())
    head += _tagged(INT32, np.array(array.shape, dtype="<i4").tobytes()) + _tagged(INT8, name.encode("ascii"))
    head += np.array([types[kind], array.nbytes], dtype="<u4").tobytes()
    padding = bytes(-array.nbytes % 8)
    head = np.array([MATRIX, len(head) + array.nbytes + len(padding)], dtype="<u4").tobytes() + head
    with open_atomic(path) as handle:
        handle.write(_TEXT.ljust(116) + bytes(8) + b"\x00\x01IM")
        body: list[Any] = [head, _first_axis_fastest(array), padding]
        if compress:
            packer = zlib.compressobj(1)
            packed = b"".join([*(packer.compress(part) for part in body), packer.flush()])
            body = [np.array([COMPRESSED, len(packed)], dtype="<u4").tobytes(), packed]
        handle.writelines(body)


def _tagged(kind: int, data: bytes) -> bytes:
    return np.array([kind, len(data)], dtype="<u4").tobytes() + data + bytes(-len(data) % 8)


def _first_axis_fastest(array: Shaped[np.ndarray, "..."]) -> memoryview:
    """The bytes of an array in Fortran order; slices of the second axis are turned one by one: they fit the caches."""
    turned = np.empty(array.shape[::-1], dtype=array.dtype.newbyteorder("<"))
    if array.T.flags.c_contiguous:
        turned[...] = array.T
    else:
        for column in range(array.shape[1]):
            turned[..., column, :] = array[:, column].T
    return turned.reshape(-1).view(np.uint8).data


# Numbers of the MATLAB v5 format ("MAT-File Format", The MathWorks, level 5) and its header.

HEADER_BYTES = 128
INT8, INT32, UINT32, MATRIX, COMPRESSED = 1, 5, 6, 14, 15
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Dtype of each type that numbers are stored as."""
CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""Dtype of each numeric array class."""
COMPLEX_FLAG = 0x0800
MAX_AXES = 32
MAX_EXPANSION = 1032
"""No zlib stream expands further."""
TRUNCATED = "The file may be truncated."
_HDF5 = b"\x89HDF"


def check_header(data: bytes, path: Path | str) -> None:
    """Check a file's first 128 bytes.

    Raises:
        FileFormatError: If they are not a little-endian MATLAB v5 file's.
    """
    if data[:4] == _HDF5 or data[:10] == b"MATLAB 7.3":
        fix = "Save it in MATLAB with -v7."
        raise FileFormatError(path, where="byte 0", expected="a MATLAB v5 file", got="a v7.3 (HDF5) file", fix=fix)
    if len(data) < HEADER_BYTES or data[124:128] != b"\x00\x01IM":
        expected = "a little-endian MATLAB v5 header of 128 bytes"
        raise FileFormatError(path, where="byte 124", expected=expected, got=repr(data[124:128]))


# One array of a MATLAB v5 file in blocks, so that it need never be in memory whole.
#
# The file is read, and a compressed array inflated, on a thread of its own while the caller works on the block before.
# What a header claims is compared with the bytes that are there before anything is allocated; a compressed array's
# checksum is verified.

_READ_BYTES = 1 << 20  # of packed bytes at a time
_PIECE_BYTES = 1 << 22  # inflated at a time, at most
_MAX_HEAD_BYTES = 256  # of one of the small elements before an array's numbers
_BUFFERS = 3  # one being filled, one waiting, one in the caller's hands


class _Plain:
    """The file's own bytes."""

    def __init__(self, handle: BinaryIO, count: int, path: Path | str) -> None:
        self.handle, self.left, self.path = handle, count, path

    def fault(self, expected: str, actual: str) -> FileFormatError:
        """What is wrong with the array."""
        return FileFormatError(self.path, where="the array", expected=expected, got=actual, fix=TRUNCATED)

    def fill(self, into: memoryview) -> None:
        """Fill a buffer with the next bytes."""
        count = into.nbytes
        count_read = self.handle.readinto(into) if count <= self.left else self.left  # type: ignore[attr-defined]
        self.left -= count_read
        if count_read < count:
            raise self.fault(f"{count} more bytes", f"{count_read}")

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
def open_mat(path: Path | str, name: str, *, max_bytes: int = MAX_TENSOR_BYTES) -> Iterator[MatStream]:
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
    check_itself(path)
    with open_file(path, max_bytes=max_bytes) as handle:
        size = os.fstat(handle.fileno()).st_size
        check_header(handle.read(HEADER_BYTES), path)
        yield _find(handle, size, name, max_bytes, path)


def _find(handle: BinaryIO, size: int, name: str, max_bytes: int, path: Path | str) -> MatStream:
    at, names = HEADER_BYTES, []
    while at + 8 <= size:
        handle.seek(at)
        kind, count = _two(handle.read(8))
        if kind >> 16:  # a small element: its data stand in its tag
            at += 8
            continue
        if count > size - at - 8:
            expected, left = f"{count} bytes of an element", f"{size - at - 8} bytes"
            raise FileFormatError(path, where=f"byte {at}", expected=expected, got=left, fix=TRUNCATED)
        if kind in (MATRIX, COMPRESSED):
            source, inside = _opened(handle, kind, count, max_bytes, path)
            flags, flag_bytes = _small_element(source)
            sides, side_bytes = _small_element(source)
            called, name_bytes = _small_element(source)
            if called == name.encode():
                return _stream_of(source, flags, sides, inside - flag_bytes - side_bytes - name_bytes)
            names.append(called[:64].decode("ascii", errors="replace"))
        at += 8 + count + (0 if kind == COMPRESSED else -count % 8)
    held = ", ".join(names[:8]) or "no array"
    fix = "" if names else TRUNCATED
    raise FileFormatError(path, where="the file", expected=f"an array {name!r}", got=held, fix=fix)


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


def _stream_of(source: _Plain, flags: bytes, shape: bytes, left: int) -> MatStream:
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
    if not is_addressable(sides, dtype.itemsize) or math.prod(sides) * dtype.itemsize != size or not 0 <= padding < 8:
        expected = f"{' x '.join(map(str, sides))} numbers of {dtype.itemsize} bytes"
        raise source.fault(expected, f"{size} bytes, {left} with the tag")
    return MatStream(sides, dtype, padding, source)
