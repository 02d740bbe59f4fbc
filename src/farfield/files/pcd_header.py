"""The header of PCD files: parsed, checked, written (Point Cloud Library, "The PCD file format", v0.5 to v0.7)."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from farfield.errors import FileFormatError

KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
ENCODINGS = ("ascii", "binary", "binary_compressed")
_KINDS = {"I": "i", "U": "u", "F": "f"}
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
        if kind not in _KINDS or _natural(size) not in _SIZES[kind]:
            raise fault("TYPE" if kind not in _KINDS else "SIZE", "I or U of 1, 2, 4, 8 bytes or F of 4, 8")
    held = [name != "_" or count != "0" for name, count in zip(names, counts, strict=True)]  # padding of no bytes
    names, sizes, types, counts = (
        [value for value, kept in zip(column, held, strict=True) if kept] for column in (names, sizes, types, counts)
    )
    if not all(1 <= (_natural(count) or 0) <= _MAX_COUNT for count in counts):
        raise fault("COUNT", f"numbers from 1 to {_MAX_COUNT}, or 0 for padding")
    if values["DATA"] not in ([encoding] for encoding in ENCODINGS):
        raise fault("DATA", " or ".join(ENCODINGS))
    return PcdHeader(
        names=tuple(names),
        dtypes=tuple(np.dtype(f"<{_KINDS[kind]}{size}") for kind, size in zip(types, sizes, strict=True)),
        counts=tuple(int(count) for count in counts),
        points=_points(values, lines, path=path),
        encoding=values["DATA"][0],
        body=body,
        line=lines["DATA"] + 1,
    )


def _fault(
    path: Path | str, lines: Mapping[str, int], values: Mapping[str, list[str]], key: str, expected: str
) -> FileFormatError:
    where, found = f"line {lines.get(key, lines['DATA'])}", " ".join(values.get(key, ["no such line"]))[:80]
    return FileFormatError(path, where=where, expected=f"{key} to be {expected}", found=found)


def _entries(data: bytes, *, path: Path | str) -> tuple[dict[str, tuple[int, list[str]]], int]:
    """Split the header into keys with their line number and values; returns also where the body begins."""
    entries: dict[str, tuple[int, list[str]]] = {}
    start, line = 0, 0
    while "DATA" not in entries:
        end, line = data.find(b"\n", start, _MAX_HEADER_BYTES), line + 1
        if end < 0:
            found = "the end of the file" if len(data) < _MAX_HEADER_BYTES else f"{_MAX_HEADER_BYTES} bytes without it"
            raise FileFormatError(path, where=f"line {line}", expected="a header that ends with DATA", found=found)
        text = data[start:end].strip()
        words = text.decode("ascii", errors="replace").split()
        start = end + 1
        if not words or words[0].startswith("#"):
            continue
        key = "FIELDS" if words[0] == "COLUMNS" else words[0]  # the older name
        if key not in KEYS or key in entries or not text.isascii():
            expected = f"one of {', '.join(key for key in KEYS if key not in entries)}"
            raise FileFormatError(path, where=f"line {line}", expected=expected, found=repr(text[:80]))
        entries[key] = (line, words[1:])
    return entries, start


def _points(values: Mapping[str, list[str]], lines: Mapping[str, int], *, path: Path | str) -> int:
    sides = {}
    for key in ("WIDTH", "HEIGHT", "POINTS"):
        value = values.get(key)
        sides[key] = _natural(value[0]) if value is not None and len(value) == 1 else None
        if value is not None and sides[key] is None:
            where, found = f"line {lines[key]}", " ".join(value)[:80]
            raise FileFormatError(path, where=where, expected=f"{key} to be one whole number", found=found)
    width, height, points = sides["WIDTH"], sides["HEIGHT"], sides["POINTS"]
    grid = None if width is None else width * (1 if height is None else height)
    total = grid if points is None else points
    if total is None or (grid is not None and grid != total):
        expected = "POINTS to be WIDTH x HEIGHT" if total is not None else "WIDTH or POINTS"
        found = f"{points} points for {width} x {height}" if total is not None else "neither"
        raise FileFormatError(path, where=f"line {lines.get('POINTS', lines['DATA'])}", expected=expected, found=found)
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
