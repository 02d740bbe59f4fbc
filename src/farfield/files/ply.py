"""PLY point clouds: ascii, binary little and big endian; the element ``vertex`` with any properties in any order.

Source: Greg Turk, "The PLY Polygon File Format" (1994), https://paulbourke.net/dataformats/ply/. Lists, and elements
other than ``vertex``, are passed over, but their sizes are checked: a file ends where its header says. CloudCompare
calls further columns ``scalar_Intensity``: the ``scalar_`` is left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct

import numpy as np
from jaxtyping import Int, Shaped

from farfield.errors import FileFormatError
from farfield.files.ascii_table import parse_table
from farfield.files.atomic import read_bytes
from farfield.files.limits import MAX_BYTES, check_name, check_numbers

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER_BYTES, _MOST_ELEMENTS, _MOST_ROWS = 1 << 16, 64, 1 << 40
_VERTEX = "vertex"
_SCALAR = "scalar_"
_MOST_PASSED = 1 << 25  # properties of rows whose lists differ in length: a third of a microsecond each
_PLACE_BYTES = 64  # of a property of a vertex: where it begins, and where its bytes lie


@dataclass(frozen=True)
class PlyProperty:
    """One property: a number, or a list of numbers whose length stands before them.

    Args:
        name: Its name.
        dtype: Of the number, or of each of the list, in the file's order of bytes.
        length_dtype: Of the list's length; None for a number.
    """

    name: str
    dtype: np.dtype
    length_dtype: np.dtype | None = None

    @property
    def least_bytes(self) -> int:
        """What it takes in a binary file at least."""
        return (self.dtype if self.length_dtype is None else self.length_dtype).itemsize


@dataclass(frozen=True)
class PlyElement:
    """One element: so many rows of the same properties."""

    name: str
    rows: int
    properties: tuple[PlyProperty, ...]

    @property
    def has_lists(self) -> bool:
        """Whether its rows differ in length."""
        return any(entry.length_dtype is not None for entry in self.properties)

    @property
    def least_bytes(self) -> int:
        """What a row takes in a binary file at least."""
        return sum(entry.least_bytes for entry in self.properties)


@dataclass(frozen=True)
class PlyHeader:
    """What a header says.

    Args:
        encoding: ``ascii``, ``binary_little_endian`` or ``binary_big_endian``.
        elements: In the file's order.
        body: Byte at which the first element begins.
        line: Line at which it begins, counted from 1.
    """

    encoding: str
    elements: tuple[PlyElement, ...]
    body: int
    line: int


def read_ply(path: Path | str, *, max_bytes: int = MAX_BYTES) -> dict[str, Shaped[np.ndarray, " n"]]:
    """Read the vertices of a PLY file.

    Args:
        path: The file.
        max_bytes: Largest file that is accepted.

    Returns:
        One array a property that is a number, shape (n,), in this machine's order of bytes.

    Raises:
        FileFormatError: If the header contradicts itself or the file's size, or the body is damaged.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    header = parse_ply_header(data, path=path)
    columns = _read_ascii(data, header, path) if header.encoding == "ascii" else _read_binary(data, header, path)
    named = {_column_name(name): values for name, values in columns.items()}
    if len(named) < len(columns):
        raise FileFormatError(path, where="the header", expected="names that differ", got=", ".join(columns)[:120])
    return named


def _column_name(name: str) -> str:
    return name[len(_SCALAR) :] if name.startswith(_SCALAR) and len(name) > len(_SCALAR) else name


def parse_ply_header(data: bytes, *, path: Path | str) -> PlyHeader:
    """Parse and check the header of a PLY file; nothing is allocated for what it claims.

    Raises:
        FileFormatError: If a line is unknown, repeated or out of order, or there is no element ``vertex``.
    """
    lines, body = _lines(data, path=path)
    encoding = _encoding(lines, path=path)
    elements: list[PlyElement] = []
    for number, words in enumerate(lines[2:], start=3):
        match words:
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["element", name, count] if _natural(count) is not None and len(elements) < _MOST_ELEMENTS:
                elements.append(PlyElement(check_name(path, f"line {number}", name), _natural(count) or 0, ()))
            case ["property", *rest] if elements:
                entry = _property(rest, _ORDERS[encoding], f"line {number}", path=path)
                last = elements[-1]
                check_numbers(path, f"line {number}", len(last.properties) + 1)
                elements[-1] = PlyElement(last.name, last.rows, (*last.properties, entry))
            case _:
                expected = "element NAME COUNT, property TYPE NAME, property list TYPE TYPE NAME, or a comment"
                raise FileFormatError(path, where=f"line {number}", expected=expected, got=repr(" ".join(words))[:80])
    _check_elements(elements, path=path)
    return PlyHeader(encoding, tuple(elements), body, len(lines) + 2)


def _lines(data: bytes, *, path: Path | str) -> tuple[list[list[str]], int]:
    """The words of the header's lines before ``end_header``, and where the body begins."""
    lines: list[list[str]] = []
    start = 0
    while True:
        end, where = data.find(b"\n", start, _MAX_HEADER_BYTES), f"line {len(lines) + 1}"
        if not lines and data[start:end].strip() != b"ply":
            raise FileFormatError(path, where=where, expected="ply", got=repr(data[:12]))
        if end < 0:
            actual = "the end of the file" if len(data) < _MAX_HEADER_BYTES else f"{_MAX_HEADER_BYTES} bytes without it"
            raise FileFormatError(path, where=where, expected="a header that ends with end_header", got=actual)
        text = data[start:end].strip()
        start = end + 1
        words = text.decode("utf-8", errors="replace").split()
        if words == ["end_header"]:
            return lines, start
        is_comment = words[:1] in (["comment"], ["obj_info"])
        if not all(word.isascii() and word.isprintable() for word in words) and not is_comment:
            raise FileFormatError(path, where=where, expected="ASCII", got=repr(text[:80]))
        lines.append(words)


def _encoding(lines: Sequence[Sequence[str]], *, path: Path | str) -> str:
    words = list(lines[1]) if len(lines) > 1 else []
    if len(words) != 3 or words[0] != "format" or words[1] not in _ORDERS or words[2] != "1.0":
        expected, actual = f"format {', '.join(_ORDERS)} 1.0", " ".join(words)[:80] or "no such line"
        raise FileFormatError(path, where="line 2", expected=expected, got=actual)
    return words[1]


def _property(words: Sequence[str], order: str, where: str, *, path: Path | str) -> PlyProperty:
    kinds = [np.dtype(order + _TYPES[word]) for word in words[:-1] if word in _TYPES]
    if len(words) == 2 and len(kinds) == 1:
        return PlyProperty(check_name(path, where, words[1]), kinds[0])
    if len(words) == 4 and words[0] == "list" and len(kinds) == 2 and kinds[0].kind in "iu":
        return PlyProperty(check_name(path, where, words[3]), kinds[1], kinds[0])
    expected = f"a type of {', '.join(_TYPES)} and a name, or a list with a whole number as its length"
    raise FileFormatError(path, where=where, expected=expected, got=repr(" ".join(words))[:80])


def _check_elements(elements: Sequence[PlyElement], *, path: Path | str) -> None:
    names = [element.name for element in elements]
    if names.count(_VERTEX) != 1 or len(set(names)) < len(names):
        actual = ", ".join(names)[:120] or "none"
        raise FileFormatError(path, where="the header", expected="one element vertex, each name once", got=actual)
    for element in elements:
        own = [entry.name for entry in element.properties]
        if len(set(own)) < len(own) or (element.rows and not own) or element.rows > _MOST_ROWS:
            expected = f"properties of {element.name!r} whose names differ, at most {_MOST_ROWS} rows"
            raise FileFormatError(path, where="the header", expected=expected, got=f"{', '.join(own)[:80]}")


def _natural(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 18 else None


# Binary bodies.


def _read_binary(data: bytes, header: PlyHeader, path: Path | str) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {}
    start = header.body
    for number, element in enumerate(header.elements):
        least = sum(other.rows * other.least_bytes for other in header.elements[number:])
        if least > len(data) - start:
            expected = f"{least} bytes or more ({', '.join(f'{e.rows} {e.name}' for e in header.elements)})"
            fix = "The file is truncated, or a count of its header is wrong."
            raise FileFormatError(
                path, where=f"byte {start}", expected=expected[:200], got=f"{len(data) - start}", fix=fix
            )
        starts, end = _walk(data, start, element, path) if element.has_lists else (None, 0)
        if starts is None:
            end = start + element.rows * element.least_bytes
        if element.name == _VERTEX:
            columns = _numbers(data, start, element, starts)
        start = end
    if len(data) != start:
        fix = "The file is over-long, or a count of its header is wrong."
        raise FileFormatError(
            path, where=f"byte {start}", expected="the end", got=f"{len(data) - start} bytes more", fix=fix
        )
    return columns


def _numbers(
    data: bytes, start: int, element: PlyElement, starts: list[np.ndarray] | None
) -> dict[str, Shaped[np.ndarray, " n"]]:
    """The properties that are numbers: of rows of one length as they lie there, of others by where each begins."""
    scalars = [(index, entry) for index, entry in enumerate(element.properties) if entry.length_dtype is None]
    columns = {}
    if starts is None:
        rows = np.frombuffer(data, np.uint8, element.rows * element.least_bytes, start)
        rows = rows.reshape(element.rows, element.least_bytes)
        offsets = np.cumsum([0, *(entry.least_bytes for entry in element.properties)]).tolist()
        for index, entry in scalars:
            part = np.ascontiguousarray(rows[:, offsets[index] : offsets[index] + entry.dtype.itemsize])
            columns[entry.name] = _native(part.view(entry.dtype).reshape(-1))
        return columns
    whole = np.frombuffer(data, np.uint8)
    for index, entry in scalars:
        places = starts[index][:, None] + np.arange(entry.dtype.itemsize)
        columns[entry.name] = _native(whole[places].view(entry.dtype).reshape(-1))
    return columns


def _native(values: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, " n"]:
    return values.astype(values.dtype.newbyteorder("="))


def _walk(data: bytes, start: int, element: PlyElement, path: Path | str) -> tuple[list[np.ndarray] | None, int]:
    """Where each property of each row of ``vertex`` begins, for an element with lists, and where the element ends.

    Most lists are of one length, those of triangles: this is tried first; else row after row is passed.
    """
    if not element.rows:
        return [np.zeros(0, np.int64) for _ in element.properties], start
    is_vertex = element.name == _VERTEX
    if is_vertex and element.rows * len(element.properties) * _PLACE_BYTES > MAX_BYTES:
        expected = f"vertices with lists whose places take at most {MAX_BYTES} bytes in memory"
        raise FileFormatError(path, where=f"byte {start}", expected=expected, got=f"{element.rows} vertices")
    offsets = _first_row(data, start, element, path)
    width = offsets.pop()
    if width * element.rows <= len(data) - start and _are_alike(data, start, element, offsets, width):
        rows = start + width * np.arange(element.rows if is_vertex else 0, dtype=np.int64)
        return [rows + offset for offset in offsets], start + width * element.rows
    _check_passed(element, path, f"byte {start}")
    places = np.zeros((len(element.properties), element.rows if is_vertex else 0), dtype=np.int64)
    return list(places), _pass_rows(data, start, element, places, path)


def _check_passed(element: PlyElement, path: Path | str, where: str) -> None:
    if element.rows * len(element.properties) > _MOST_PASSED:
        expected = f"lists of one length, or at most {_MOST_PASSED} properties in rows whose lists differ"
        actual = f"{element.rows} of {element.name} with {len(element.properties)} properties"
        raise FileFormatError(path, where=where, expected=expected, got=actual)


def _first_row(data: bytes, start: int, element: PlyElement, path: Path | str) -> list[int]:
    """Where the properties of the first row begin, from its own begin, and how long it is."""
    places = np.zeros((len(element.properties), 1), dtype=np.int64)
    end = _pass_rows(data, start, PlyElement(element.name, 1, element.properties), places, path)
    return [*(places[:, 0] - start).tolist(), end - start]


def _pass_rows(
    data: bytes, start: int, element: PlyElement, places: Int[np.ndarray, "properties rows"], path: Path | str
) -> int:
    """Pass all rows of an element, noting where each property begins if there is room for it; returns its end."""
    steps = [
        (index, entry.least_bytes, entry.dtype.itemsize, _length_reader(entry), entry.name)
        for index, entry in enumerate(element.properties)
    ]
    at, size, noted = start, len(data), places.shape[1] > 0
    for row in range(element.rows):
        for index, least_bytes, item_bytes, read_length, name in steps:
            if noted:
                places[index, row] = at
            if at + least_bytes > size:
                expected, actual = f"{element.rows} of {element.name}", f"the end of the file in number {row}"
                fix = "The file is truncated, or a count of its header is wrong."
                raise FileFormatError(path, where=f"byte {at}", expected=expected, got=actual, fix=fix)
            length = 0 if read_length is None else read_length(data, at)[0]
            if not 0 <= length * item_bytes <= size - at - least_bytes:
                expected = f"a list {name!r} of {element.name} {row} that fits into the file"
                raise FileFormatError(path, where=f"byte {at}", expected=expected, got=f"{length} numbers")
            at += least_bytes + length * item_bytes
    return at


def _length_reader(entry: PlyProperty) -> Callable[[bytes, int], tuple[int, ...]] | None:
    if entry.length_dtype is None:
        return None
    order = ">" if entry.length_dtype.str.startswith(">") else "<"
    return Struct(order + entry.length_dtype.char).unpack_from


def _are_alike(data: bytes, start: int, element: PlyElement, offsets: Sequence[int], width: int) -> bool:
    """Whether the lists of all rows are as long as those of the first."""
    rows = np.frombuffer(data, np.uint8, element.rows * width, start).reshape(element.rows, width)
    for entry, offset in zip(element.properties, offsets, strict=True):
        if entry.length_dtype is not None:
            part = rows[:, offset : offset + entry.length_dtype.itemsize]
            if (part != part[0]).any():
                return False
    return True


# Bodies of text: one line a row.


def _read_ascii(data: bytes, header: PlyHeader, path: Path | str) -> dict[str, np.ndarray]:
    body = data[header.body :].replace(b"\r\n", b"\n").rstrip()
    lines, rows = body.count(b"\n") + 1 if body else 0, sum(element.rows for element in header.elements)
    if lines != rows:
        expected = f"{rows} lines ({', '.join(f'{e.rows} {e.name}' for e in header.elements)})"
        fix = "The file is truncated or spliced, or a count of its header is wrong."
        raise FileFormatError(path, where=f"line {header.line}", expected=expected[:200], got=str(lines), fix=fix)
    columns: dict[str, np.ndarray] = {}
    start, line = 0, header.line
    for element in header.elements:
        end = _after_lines(body, start, element.rows)
        if element.name == _VERTEX:
            columns = _ascii_vertices(body[start:end].removesuffix(b"\n"), element, path, line)
        start, line = end, line + element.rows
    return columns


def _after_lines(body: bytes, start: int, lines: int) -> int:
    """Where the line after so many begins."""
    if not lines:
        return start
    ends = np.flatnonzero(np.frombuffer(body, np.uint8, offset=start) == ord("\n"))
    return start + int(ends[lines - 1]) + 1 if lines <= len(ends) else len(body)


def _ascii_vertices(text: bytes, element: PlyElement, path: Path | str, line: int) -> dict[str, np.ndarray]:
    scalars = [entry for entry in element.properties if entry.length_dtype is None]
    if not element.rows:
        return {entry.name: np.zeros(0, dtype=entry.dtype) for entry in scalars}
    if element.has_lists:
        _check_passed(element, path, f"line {line}")
        rows = [_without_lists(row, element, path, line + number) for number, row in enumerate(text.split(b"\n"))]
        text = b"\n".join(rows)
    if not scalars:
        return {}
    dtypes = [entry.dtype for entry in scalars]
    table = parse_table(text, dtypes=dtypes, separator=None, path=path, line=line)
    return {entry.name: values for entry, values in zip(scalars, table, strict=True)}


def _without_lists(row: bytes, element: PlyElement, path: Path | str, line: int) -> bytes:
    """A line less its lists."""
    words, at, scalars = row.split(), 0, []
    for entry in element.properties:
        if at >= len(words):
            break
        if entry.length_dtype is None:
            scalars.append(words[at])
            at += 1
            continue
        length = _natural(words[at].decode("ascii", errors="replace"))
        if length is None:
            expected, actual = f"the length of the list {entry.name!r}", repr(words[at][:40])
            raise FileFormatError(path, where=f"line {line}", expected=expected, got=actual)
        at += 1 + length
    else:
        if at == len(words):
            return b" ".join(scalars)
    expected = f"the properties {', '.join(entry.name for entry in element.properties)}"
    raise FileFormatError(path, where=f"line {line}", expected=expected[:200], got=repr(row[:80]))
