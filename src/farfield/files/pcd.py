"""PCD point clouds: ascii, binary and binary_compressed, with any set of fields.

Nothing is allocated from the header alone: the numbers of points and bytes that it claims are compared with the bytes
that the file really has.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Int, UInt8

from farfield.errors import FileFormatError
from farfield.files import ascii_table
from farfield.files.ascii_table import parse_table
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.limits import MAX_BYTES, check_numbers

# The header of PCD files: parsed, checked, written (Point Cloud Library, "The PCD file format", v0.5 to v0.7).

KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
ENCODINGS = ("ascii", "binary", "binary_compressed")
_TYPE_CODES = {"I": "i", "U": "u", "F": "f"}
_SIZES = {"I": (1, 2, 4, 8), "U": (1, 2, 4, 8), "F": (4, 8)}
_MAX_HEADER_BYTES = 1 << 16
_MAX_COUNT = 1 << 16


@dataclass(frozen=True, kw_only=True)
class PcdHeader:
    """What a header says, checked for consistency in itself.

    Args:
        names: Field names; ``_`` is padding.
        dtypes: Scalar dtype of each field, little-endian.
        counts: Elements a point of each field.
        points: Number of points.
        encoding: One of ``ENCODINGS``.
        body: Byte at which the points begin.
        line: Line at which they begin, counted from 1.
    """

    names: tuple[str, ...]
    dtypes: tuple[np.dtype, ...]
    counts: tuple[int, ...]
    points: int
    encoding: str
    body: int
    line: int

    @property
    def field_bytes(self) -> tuple[int, ...]:
        """Bytes that each field takes in one point."""
        return tuple(dtype.itemsize * count for dtype, count in zip(self.dtypes, self.counts, strict=True))

    @property
    def point_bytes(self) -> int:
        """Bytes of one point, padding included."""
        return sum(self.field_bytes)


def parse_header(data: bytes, *, path: Path | str) -> PcdHeader:
    """Parse and check the header of a PCD file.

    Args:
        data: The file's bytes.
        path: The file, for messages.

    Raises:
        FileFormatError: If a line is missing, repeated, unknown or contradicts another.
    """
    entries, body = _entries(data, path=path)
    lines = {key: line for key, (line, _) in entries.items()}
    values = {key: value for key, (_, value) in entries.items()}
    fault = partial(_fault, path, lines, values)
    names = values.get("FIELDS", [])
    if not names or len({n for n in names if n != "_"}) != len([n for n in names if n != "_"]):
        raise fault("FIELDS", "names that differ from one another")
    sizes = values.get("SIZE", ["4"] * len(names))  # v0.5 has neither SIZE nor TYPE: all are float32
    types = values.get("TYPE", ["F"] * len(names))
    counts = values.get("COUNT", ["1"] * len(names))
    for key, column in (("SIZE", sizes), ("TYPE", types), ("COUNT", counts)):
        if len(column) != len(names):
            raise fault(key, f"{len(names)} values, one a field")
    for size, kind in zip(sizes, types, strict=True):
        if kind not in _TYPE_CODES or _natural(size) not in _SIZES[kind]:
            raise fault("TYPE" if kind not in _TYPE_CODES else "SIZE", "I or U of 1, 2, 4, 8 bytes or F of 4, 8")
    held = [name != "_" or count != "0" for name, count in zip(names, counts, strict=True)]  # padding of no bytes
    names, sizes, types, counts = (
        [value for value, keep in zip(column, held, strict=True) if keep] for column in (names, sizes, types, counts)
    )
    if not all(1 <= (_natural(count) or 0) <= _MAX_COUNT for count in counts):
        raise fault("COUNT", f"numbers from 1 to {_MAX_COUNT}, or 0 for padding")
    if values["DATA"] not in ([encoding] for encoding in ENCODINGS):
        raise fault("DATA", " or ".join(ENCODINGS))
    check_numbers(path, f"line {lines.get('COUNT', lines['FIELDS'])}", sum(map(int, counts)))
    return PcdHeader(
        names=tuple(names),
        dtypes=tuple(np.dtype(f"<{_TYPE_CODES[kind]}{size}") for kind, size in zip(types, sizes, strict=True)),
        counts=tuple(int(count) for count in counts),
        points=_points(values, lines, path=path),
        encoding=values["DATA"][0],
        body=body,
        line=lines["DATA"] + 1,
    )


def _fault(
    path: Path | str, lines: Mapping[str, int], values: Mapping[str, list[str]], key: str, expected: str
) -> FileFormatError:
    where, actual = f"line {lines.get(key, lines['DATA'])}", " ".join(values.get(key, ["no such line"]))[:80]
    return FileFormatError(path, where=where, expected=f"{key} to be {expected}", got=actual)


def _entries(data: bytes, *, path: Path | str) -> tuple[dict[str, tuple[int, list[str]]], int]:
    """Split the header into keys with their line number and values; returns also where the body begins."""
    entries: dict[str, tuple[int, list[str]]] = {}
    start, line = 0, 0
    while "DATA" not in entries:
        end, line = data.find(b"\n", start, _MAX_HEADER_BYTES), line + 1
        if end < 0:
            actual = "the end of the file" if len(data) < _MAX_HEADER_BYTES else f"{_MAX_HEADER_BYTES} bytes without it"
            raise FileFormatError(path, where=f"line {line}", expected="a header that ends with DATA", got=actual)
        text = data[start:end].strip()
        words = text.decode("ascii", errors="replace").split()
        start = end + 1
        if not words or words[0].startswith("#"):
            continue
        key = "FIELDS" if words[0] == "COLUMNS" else words[0]  # the older name
        if key not in KEYS or key in entries or not text.isascii():
            expected = f"one of {', '.join(key for key in KEYS if key not in entries)}"
            raise FileFormatError(path, where=f"line {line}", expected=expected, got=repr(text[:80]))
        entries[key] = (line, words[1:])
    return entries, start


def _points(values: Mapping[str, list[str]], lines: Mapping[str, int], *, path: Path | str) -> int:
    sides = {}
    for key in ("WIDTH", "HEIGHT", "POINTS"):
        value = values.get(key)
        sides[key] = _natural(value[0]) if value is not None and len(value) == 1 else None
        if value is not None and sides[key] is None:
            where, actual = f"line {lines[key]}", " ".join(value)[:80]
            raise FileFormatError(path, where=where, expected=f"{key} to be one whole number", got=actual)
    width, height, points = sides["WIDTH"], sides["HEIGHT"], sides["POINTS"]
    grid = None if width is None else width * (1 if height is None else height)
    total = grid if points is None else points
    if total is None or (grid is not None and grid != total):
        expected = "POINTS to be WIDTH x HEIGHT" if total is not None else "WIDTH or POINTS"
        actual = f"{points} points for {width} x {height}" if total is not None else "neither"
        raise FileFormatError(path, where=f"line {lines.get('POINTS', lines['DATA'])}", expected=expected, got=actual)
    return total


def _natural(text: str) -> int | None:
    """A whole number of at most 18 ASCII digits, or None."""
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 18 else None


def format_header(fields: Mapping[str, np.ndarray], points: int, encoding: str, height: int = 1) -> bytes:
    """Write a v0.7 header as PCL does for fields of shape (n,) or (n, count), all of a kind that PCD knows."""
    columns = {
        "FIELDS": list(fields),
        "SIZE": [str(array.dtype.itemsize) for array in fields.values()],
        "TYPE": [array.dtype.kind.upper() for array in fields.values()],
        "COUNT": [str(array.shape[1] if array.ndim == 2 else 1) for array in fields.values()],
    }
    rows = [f"{key} {' '.join(column)}" for key, column in columns.items()]
    shape = [f"WIDTH {points // height}", f"HEIGHT {height}", "VIEWPOINT 0 0 0 1 0 0 0"]
    shape += [f"POINTS {points}", f"DATA {encoding}"]
    return "\n".join(["# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", *rows, *shape, ""]).encode("ascii")


_PADDING_BYTES = 1 << 16  # the Point Cloud Library may leave zeros up to the end of a memory page
_KINDS = frozenset(["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"])


def read_pcd(path: Path | str, *, max_bytes: int = MAX_BYTES, spare_bytes: int = 0) -> dict[str, np.ndarray]:
    """Read a PCD file.

    Args:
        path: The file.
        max_bytes: Largest file, and largest expanded body, that is accepted.
        spare_bytes: So many bytes of any value may follow the points of a binary file, as one does in nuScenes' radar.

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
        end = header.body + header.point_bytes * header.points
        if header.encoding == "binary" and end < len(data) <= end + spare_bytes:
            data = data[:end]
        fields = (_read_ascii if header.encoding == "ascii" else _read_binary)(data, header, path)
    return {name: array for name, array in zip(header.names, fields, strict=True) if name != "_"}


def _read_ascii(data: bytes, header: PcdHeader, path: Path | str) -> list[np.ndarray]:
    body = data[header.body :]
    if b"\r" in body:
        body = body.replace(b"\r\n", b"\n")
    body = body.rstrip()
    lines = body.count(b"\n") + 1 if body else 0
    if lines != header.points:
        where, actual = f"line {header.line}", f"{lines} lines of points"
        fix = "The file is truncated or spliced."
        raise FileFormatError(path, where=where, expected=f"{header.points} points", got=actual, fix=fix)
    if lines == 0:
        return _nothing(header)
    columns, first = sum(header.counts), len(body.partition(b"\n")[0].split())
    if first != columns:
        raise FileFormatError(path, where=f"line {header.line}", expected=f"{columns} columns", got=str(first))
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
        where, actual = f"byte {header.body}", f"{len(data) - header.body} bytes"
        raise FileFormatError(path, where=where, expected="8 bytes with both sizes", got=actual)
    packed, size = (int(number) for number in np.frombuffer(data, dtype="<u4", count=2, offset=header.body))
    _check_size(data, start, packed, path, "the compressed size")
    dense = [0 if name == "_" else width for name, width in zip(header.names, header.field_bytes, strict=True)]
    possible = {header.point_bytes * header.points: header.field_bytes, sum(dense) * header.points: tuple(dense)}
    if size not in possible or size > min(packed * LZF_MAX_EXPANSION, max_bytes):
        expected = f"{header.points} points of {header.point_bytes} bytes, at most {LZF_MAX_EXPANSION} times {packed}"
        raise FileFormatError(path, where=f"byte {header.body + 4}", expected=expected, got=f"{size} bytes")
    try:
        body = decompress_lzf(data[start : start + packed], size)
    except LzfError as error:
        where = f"compressed body at byte {start}"
        raise FileFormatError(path, where=where, expected=f"{size} bytes in LZF", got=str(error)) from error
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
        fix = "The file is truncated." if present < size else "The file is over-long or its header is wrong."
        expected = f"{size} bytes ({meaning})"
        raise FileFormatError(path, where=f"byte {start}", expected=expected, got=f"{present} bytes", fix=fix)


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
    rows = [array.reshape(points, array.size // max(points, 1)) for array in columns.values()]
    with open_atomic(path) as handle:
        handle.write(format_header(columns, points, encoding, height))
        if encoding == "ascii":
            handle.writelines(_format_ascii(rows))
        elif encoding == "binary":
            handle.write(np.concatenate([array.view(np.uint8) for array in rows], axis=1).tobytes() if points else b"")
        else:
            body = b"".join(array.tobytes() for array in rows)
            packed = compress_lzf(body)
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
    scalars = [column for array in columns for column in array.T]
    for start in range(0, len(columns[0]), ascii_table.ROWS_AT_ONCE):
        parts = [column[start : start + ascii_table.ROWS_AT_ONCE] for column in scalars]
        texts = [ascii_table.floats(part) if part.dtype.kind == "f" else ascii_table.integers(part) for part in parts]
        yield ascii_table.join(texts, " ")


# The LZF compression of PCD's binary_compressed body, in plain Python.
#
# A stream is a sequence of tokens. Control byte c < 32: c + 1 literal bytes follow. Otherwise a copy from the output:
# length (c >> 5) + 2, where 7 << 5 means that one more byte is added to the length; then the low byte of the distance
# minus one, whose upper five bits are in c. So a copy is 3..264 bytes from at most 8192 bytes back.

LZF_MAX_EXPANSION = 88  # three bytes stand for at most 264
_MAX_LITERAL, _MAX_COPY, _MAX_DISTANCE = 32, 264, 8192


class LzfError(ValueError):
    """The stream is damaged; the argument is a message that names the byte within the stream."""


def decompress_lzf(stream: bytes, size: int) -> bytes:
    """Expand a stream.

    Args:
        stream: The compressed bytes.
        size: Number of bytes that must come out; not allocated before they do.

    Raises:
        LzfError: If the stream ends within a token, refers before the beginning, or gives another number of bytes.
    """
    output, position, end = bytearray(), 0, len(stream)
    try:
        while position < end:
            control = stream[position]
            if control < _MAX_LITERAL:
                following = position + control + 2
                output += stream[position + 1 : following]
                position = following
                continue
            length = (control >> 5) + 2
            if length == 9:
                position += 1
                length += stream[position]
            distance = ((control & 31) << 8) + stream[position + 1] + 1
            position += 2
            start = len(output) - distance
            if start < 0:
                raise LzfError(f"byte {position - 2}: a copy from {-start} bytes before the beginning")
            if distance >= length:
                output += output[start : start + length]
            else:
                output += (output[start:] * (length // distance + 1))[:length]
            if len(output) > size:
                break
    except IndexError:
        raise LzfError(f"byte {position}: the stream ends within a token") from None
    if position > end or len(output) != size:
        raise LzfError(f"byte {min(position, end)}: {len(output)} bytes came out instead of {size}")
    return bytes(output)


def compress_lzf(data: bytes) -> bytes:
    """Compress bytes; data without repetitions grow by one byte in 32."""
    following, length, distance = _copies(np.frombuffer(data, dtype=np.uint8))
    output, position, size = bytearray(), 0, len(data)
    while position < size:
        target = following[position] if position < len(following) else size
        while position < target:
            run = min(target - position, _MAX_LITERAL)
            output.append(run - 1)
            output += data[position : position + run]
            position += run
        if position < size:
            copied, back = min(length[position], _MAX_COPY), distance[position] - 1
            if copied < 9:
                output.append((copied - 2) << 5 | back >> 8)
            else:
                output += bytes((7 << 5 | back >> 8, copied - 9))
            output.append(back & 255)
            position += copied
    return bytes(output)


def _copies(data: UInt8[np.ndarray, " n"]) -> tuple[list[int], list[int], list[int]]:
    """For each position: the next one at which a copy may begin, and that copy's length and distance.

    A copy may begin where the same three bytes stood at most 8192 bytes before. Neighbouring positions with the same
    distance make one longer copy.
    """
    count = max(len(data) - 2, 0)
    if count == 0:
        return [], [], []
    triple = data[:-2].astype(np.uint32) << 16 | data[1:-1].astype(np.uint32) << 8 | data[2:]
    order = np.argsort(triple, kind="stable")
    repeated = triple[order[1:]] == triple[order[:-1]]
    distance: Int[np.ndarray, " n"] = np.zeros(count, dtype=np.int64)
    distance[order[1:][repeated]] = (order[1:] - order[:-1])[repeated]
    distance[distance > _MAX_DISTANCE] = 0
    index = np.arange(count)
    changes = np.append(distance[1:] != distance[:-1], True)
    run_end = np.minimum.accumulate(np.where(changes, index, count)[::-1])[::-1]
    begin = np.minimum.accumulate(np.where(distance > 0, index, len(data))[::-1])[::-1]
    return begin.tolist(), (run_end - index + 3).tolist(), distance.tolist()
