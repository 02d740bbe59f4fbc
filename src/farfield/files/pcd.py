"""PCD point clouds: ascii, binary and binary_compressed, with any set of fields.

Nothing is allocated from the header alone: the numbers of points and bytes that it claims are compared with the bytes
that the file really has.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from farfield.errors import FileFormatError
from farfield.files import lzf, text_table
from farfield.files.atomic import MAX_BYTES, open_atomic, read_bytes
from farfield.files.pcd_header import ENCODINGS, PcdHeader, format_header, parse_header
from farfield.files.table import parse_table

_PADDING_BYTES = 1 << 16  # the Point Cloud Library may leave zeros up to the end of a memory page
_KINDS = frozenset(["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"])


def read_pcd(path: Path | str, *, max_bytes: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """Read a PCD file.

    Args:
        path: The file.
        max_bytes: Largest file, and largest expanded body, that is accepted.

    Returns:
        One array a field in the file's order and dtype, shape (n,), or (n, count) where COUNT is above 1. Padding
        (``_``) is left out. NaN, by which organised clouds mark a missing point, is kept.

    Raises:
        FileFormatError: If the header contradicts itself or the file's size, or the body is damaged.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    header = parse_header(data, path=path)
    if header.encoding == "binary_compressed":
        fields = _read_compressed(data, header, path, max_bytes)
    else:
        fields = (_read_ascii if header.encoding == "ascii" else _read_binary)(data, header, path)
    return {name: array for name, array in zip(header.names, fields, strict=True) if name != "_"}


def _read_ascii(data: bytes, header: PcdHeader, path: Path | str) -> list[np.ndarray]:
    body = data[header.body :]
    if b"\r" in body:
        body = body.replace(b"\r\n", b"\n")
    body = body.rstrip()
    lines = body.count(b"\n") + 1 if body else 0
    if lines != header.points:
        where, found = f"line {header.line}", f"{lines} lines of points"
        mend = "The file is truncated or spliced."
        raise FileFormatError(path, where=where, expected=f"{header.points} points", found=found, mend=mend)
    if lines == 0:
        return _nothing(header)
    columns, first = sum(header.counts), len(body.partition(b"\n")[0].split())
    if first != columns:
        raise FileFormatError(path, where=f"line {header.line}", expected=f"{columns} columns", found=str(first))
    dtypes = [dtype for dtype, count in zip(header.dtypes, header.counts, strict=True) for _ in range(count)]
    table = iter(parse_table(body, dtypes=dtypes, separator=None, path=path, line=header.line))
    fields = []
    for count in header.counts:
        parts = [next(table) for _ in range(count)]
        fields.append(parts[0] if count == 1 else np.stack(parts, axis=1))
    return fields


def _read_binary(data: bytes, header: PcdHeader, path: Path | str) -> list[np.ndarray]:
    size = header.point_bytes * header.points
    _check_size(data, header.body, size, path, f"{header.points} points of {header.point_bytes} bytes")
    if header.points == 0:
        return _nothing(header)
    rows = np.frombuffer(data, dtype=np.uint8, count=size, offset=header.body).reshape(header.points, -1)
    fields, start = [], 0
    for dtype, count, width in zip(header.dtypes, header.counts, header.field_bytes, strict=True):
        column = np.ascontiguousarray(rows[:, start : start + width]).view(dtype)
        fields.append(_shaped(column, count))
        start += width
    return fields


def _read_compressed(data: bytes, header: PcdHeader, path: Path | str, max_bytes: int) -> list[np.ndarray]:
    """Read a body that holds all points of the first field, then all of the second and so on, compressed as a whole."""
    if header.points == 0:
        return _nothing(header)
    start = header.body + 8
    if len(data) < start:
        where, found = f"byte {header.body}", f"{len(data) - header.body} bytes"
        raise FileFormatError(path, where=where, expected="8 bytes with both sizes", found=found)
    packed, size = (int(number) for number in np.frombuffer(data, dtype="<u4", count=2, offset=header.body))
    _check_size(data, start, packed, path, "the compressed size")
    dense = [0 if name == "_" else width for name, width in zip(header.names, header.field_bytes, strict=True)]
    possible = {header.point_bytes * header.points: header.field_bytes, sum(dense) * header.points: tuple(dense)}
    if size not in possible or size > min(packed * lzf.MAX_EXPANSION, max_bytes):
        expected = f"{header.points} points of {header.point_bytes} bytes, at most {lzf.MAX_EXPANSION} times {packed}"
        raise FileFormatError(path, where=f"byte {header.body + 4}", expected=expected, found=f"{size} bytes")
    try:
        body = lzf.decompress(data[start : start + packed], size)
    except lzf.LzfError as error:
        where = f"compressed body at byte {start}"
        raise FileFormatError(path, where=where, expected=f"{size} bytes in LZF", found=str(error)) from error
    fields, offset = [], 0
    for dtype, count, width in zip(header.dtypes, header.counts, possible[size], strict=True):
        items = header.points * width // dtype.itemsize
        column = np.frombuffer(body, dtype=dtype, count=items, offset=offset).reshape(header.points, -1).copy()
        fields.append(_shaped(column, count) if items else column)
        offset += header.points * width
    return fields


def _check_size(data: bytes, start: int, size: int, path: Path | str, meaning: str) -> None:
    present = len(data) - start
    rest = data[start + size :]
    if present < size or len(rest) >= _PADDING_BYTES or rest.strip(b"\0"):
        mend = "The file is truncated." if present < size else "The file is over-long or its header is wrong."
        expected = f"{size} bytes ({meaning})"
        raise FileFormatError(path, where=f"byte {start}", expected=expected, found=f"{present} bytes", mend=mend)


def _shaped(column: np.ndarray, count: int) -> np.ndarray:
    return column[:, 0] if count == 1 else column


def _nothing(header: PcdHeader) -> list[np.ndarray]:
    shapes = [(0,) if count == 1 else (0, count) for count in header.counts]
    return [np.zeros(shape, dtype=dtype) for shape, dtype in zip(shapes, header.dtypes, strict=True)]


def write_pcd(path: Path | str, fields: Mapping[str, np.ndarray], *, encoding: str = "binary", height: int = 1) -> None:
    """Write a PCD file (v0.7), all or nothing.

    Args:
        path: The file to write.
        fields: Arrays of one length by field name, each of shape (n,) or (n, count): integers, float32, float64 or
            booleans (written as bytes).
        encoding: ``"ascii"``, ``"binary"`` or ``"binary_compressed"``.
        height: Rows of an organised cloud, whose points come row by row; 1 for an unorganised one.

    Raises:
        ValueError: If the encoding is unknown, the height does not divide the number of points, or an array or a name
            does not fit the format.
    """
    if encoding not in ENCODINGS:
        raise ValueError(f"write_pcd: expected encoding to be one of {', '.join(ENCODINGS)}, got {encoding!r}")
    columns = {name: _as_column(name, array) for name, array in fields.items()}
    lengths = {len(array) for array in columns.values()}
    if len(lengths) != 1:
        raise ValueError(f"write_pcd: expected at least one field, all of one length, got lengths {sorted(lengths)}")
    points = lengths.pop()
    if height < 1 or points % height:
        raise ValueError(f"write_pcd: expected a height that divides {points} points, got {height}")
    flat = [array.reshape(points, array.size // max(points, 1)) for array in columns.values()]
    with open_atomic(path) as handle:
        handle.write(format_header(columns, points, encoding, height))
        if encoding == "ascii":
            handle.writelines(_format_ascii(flat))
        elif encoding == "binary":
            handle.write(np.concatenate([array.view(np.uint8) for array in flat], axis=1).tobytes() if points else b"")
        else:
            body = b"".join(array.tobytes() for array in flat)
            packed = lzf.compress(body)
            handle.write(len(packed).to_bytes(4, "little") + len(body).to_bytes(4, "little") + packed)


def _as_column(name: str, values: np.ndarray) -> np.ndarray:
    array = np.asarray(values)
    array = array.astype(np.uint8) if array.dtype == np.bool_ else array
    if array.dtype.str[1:] not in _KINDS or array.ndim not in (1, 2):
        raise ValueError(f"write_pcd: expected numbers of shape (n,) or (n, count) in {name!r}, got {array.dtype}")
    if not name.isascii() or name.split() != [name] or name == "_" or name.startswith("#"):
        raise ValueError(f"write_pcd: expected a field name without blanks in ASCII, got {name!r}")
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))


def _format_ascii(columns: list[np.ndarray]) -> Iterator[bytes]:
    flat = [column for array in columns for column in array.T]
    for start in range(0, len(columns[0]), text_table.ROWS_AT_ONCE):
        parts = [column[start : start + text_table.ROWS_AT_ONCE] for column in flat]
        texts = [text_table.floats(part) if part.dtype.kind == "f" else text_table.integers(part) for part in parts]
        yield text_table.join(texts, " ")
