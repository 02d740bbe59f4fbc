"""MATLAB v5 files (``save -v6`` and ``-v7``): numeric arrays in and out ("MAT-File Format", The MathWorks, level 5).

Nothing is allocated from a claimed size alone: what the header of an array says is compared with the bytes that follow.
MATLAB stores arrays with the first axis fastest; they come back as such views, and are written from any memory order.
"""

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import MAX_BYTES, open_atomic, read_bytes
from farfield.files.mat_format import (
    CLASSES,
    COMPLEX_FLAG,
    COMPRESSED,
    HEADER_BYTES,
    INT8,
    INT32,
    MATRIX,
    MAX_AXES,
    MAX_EXPANSION,
    STORED,
    TRUNCATED,
    UINT32,
    check_header,
)

_MAX_NAME_BYTES = 63  # MATLAB's namelengthmax
_TEXT = b"MATLAB 5.0 MAT-file, written by Farfield"


@dataclass(frozen=True)
class _Element:
    """One tagged element: its type, its bytes and where they begin."""

    kind: int
    data: memoryview
    offset: int


def read_mat(path: Path | str, name: str, *, max_bytes: int = MAX_BYTES) -> Shaped[np.ndarray, "..."]:
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
    found = []
    for element in _elements(memoryview(data)[HEADER_BYTES:], HEADER_BYTES, path):
        matrix = _expanded(element, max_bytes, path) if element.kind == COMPRESSED else element
        if matrix.kind != MATRIX:
            continue
        parts = _elements(matrix.data, matrix.offset, path)
        flags, shape, called = (next(parts, None) for _ in range(3))
        if flags is None or shape is None or called is None:
            raise _fault(path, matrix, "flags, dimensions and a name", f"{len(matrix.data)} bytes")
        text = bytes(called.data[: _MAX_NAME_BYTES + 1]).decode("ascii", errors="replace")
        if text == name:
            return _array(flags, shape, next(parts, None), path)
        found.append(text)
    mend = "" if found else TRUNCATED
    held = ", ".join(found[:8]) or "no array"
    raise FileFormatError(path, where="the file", expected=f"an array {name!r}", found=held, mend=mend)


def _fault(path: Path | str, element: _Element, expected: str, found: str) -> FileFormatError:
    return FileFormatError(path, where=f"byte {element.offset}", expected=expected, found=found)


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
                raise FileFormatError(path, where=where, expected=expected, found=f"{size}")
        if size > len(data) - start:
            expected, found = f"{size} bytes of an element", f"{len(data) - start} bytes"
            mend = "The file is truncated."
            raise FileFormatError(path, where=f"byte {offset + at}", expected=expected, found=found, mend=mend)
        yield _Element(kind, data[start : start + size], offset + start)
        end = start + size
        at = at + 8 if small else end if kind == COMPRESSED else end + -end % 8


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
    if min(sides) < 0 or math.prod(sides) * stored.itemsize != len(real.data):
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
        for place in range(array.shape[1]):
            turned[..., place, :] = array[:, place].T
    return turned.reshape(-1).view(np.uint8).data
