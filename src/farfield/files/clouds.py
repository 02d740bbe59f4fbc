"""Binary clouds: KITTI's velodyne ``.bin`` and Farfield's own cache ``.ffcloud``.

A cache file is: the magic ``FFCLOUD1``; the header's length (uint32, little-endian); the header, JSON; then the columns
one after another, little-endian, C order, without gaps. The header names each column with its dtype and shape and gives
the CRC-32 of all columns' bytes, and under ``source`` size and CRC-32 of the file that they were read from, if any.
"""

import json
import math
import sys
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float32, Shaped

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.json_text import plain_json
from farfield.files.limits import MAX_BYTES, is_addressable, open_file

CACHE_SUFFIX = ".ffcloud"
_MAGIC = b"FFCLOUD1"
_HEADER_BYTES = 1 << 20
_DTYPES = frozenset(["|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8"])


def read_bin(
    path: Path | str,
    *,
    columns: int = 4,
    on_nan: Literal["error", "drop", "keep"] = "error",
    max_bytes: int = MAX_BYTES,
) -> Float32[np.ndarray, "n columns"]:
    """Read a KITTI velodyne file: rows of little-endian float32, no header (KITTI object devkit readme).

    Args:
        path: The file.
        columns: Columns: 4 for KITTI (x, y, z in metres, reflectance 0..1), 7 for View-of-Delft radar.
        on_nan: What to do with points that hold NaN or infinity: ``"error"``, ``"drop"`` or ``"keep"``.
        max_bytes: Largest file that is accepted.

    Returns:
        One row a point, at least one, shape (n, columns), float32.

    Raises:
        FileFormatError: If the file is empty, too large, no whole number of points, or not finite.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    _refuse_other_cloud(path, data)
    points, rest = divmod(len(data), 4 * columns)
    if points == 0 or rest:
        raise FileFormatError(
            path,
            where=f"byte {points * 4 * columns}",
            expected=f"at least one point and {4 * columns} bytes ({columns} float32) for each",
            got=f"{len(data)} bytes: {points} points and {rest} bytes more",
            fix="The file is truncated, or has another number of columns (columns=).",
        )
    rows = np.frombuffer(data, dtype="<f4").reshape(points, columns).astype(np.float32)
    if on_nan == "keep":
        return rows
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all() and (on_nan == "error" or not finite.any()):
        bad = int(np.argmin(finite))
        raise FileFormatError(
            path,
            where=f"byte {bad * 4 * columns} (point {bad})",
            expected="finite numbers",
            got=str(rows[bad].tolist()),
            fix="Remove them from the file; in Python on_nan='drop' leaves them out." if on_nan == "error" else "",
        )
    return rows if finite.all() else rows[finite]


def _refuse_other_cloud(path: Path | str, data: bytes) -> None:
    """Refuse a cloud of another format under the name of a ``.bin``: its bytes would be read as float32."""
    marks = {
        b"\x93NUMPY": ".npy",
        b"# .PCD": ".pcd",
        b"VERSION": ".pcd",
        _MAGIC: ".ffcloud",
        b"ply": ".ply",
        b"LASF": ".las",
    }
    suffix = next((suffix for mark, suffix in marks.items() if data.startswith(mark)), "")
    if suffix:
        name = {".pcd": "a PCD", ".ply": "a PLY", ".las": "a LAS"}.get(suffix, f"a file of the kind {suffix}")
        fix = f"Give it its own suffix, {suffix}."
        raise FileFormatError(path, where="byte 0", expected="float32 without a header", got=name, fix=fix)


def write_bin(path: Path | str, rows: Float32[np.ndarray, "n c"]) -> None:
    """Write rows of float32 as a KITTI velodyne file, all or nothing.

    Raises:
        ValueError: If the rows are not a finite table with at least one row.
    """
    rows = np.asarray(rows, dtype="<f4")
    if rows.ndim != 2 or rows.size == 0 or not np.isfinite(rows).all():
        raise ValueError(f"write_bin: expected a table of finite numbers with at least one row, got {rows.shape}")
    with open_atomic(path) as handle:
        handle.write(rows.tobytes())


def write_cache(path: Path | str, columns: Mapping[str, np.ndarray], *, source: tuple[int, int] | None = None) -> None:
    """Write named arrays of any numeric or boolean dtype and any shape as a cache file, all or nothing.

    Args:
        path: The file to write, by custom ``*.ffcloud``.
        columns: Arrays by name.
        source: Size and CRC-32 of the file that they were read from.

    Raises:
        ValueError: If an array is neither numeric nor boolean.
        FileFormatError: If they are more than :func:`read_cache` takes.
    """
    arrays = {name: np.asarray(array) for name, array in columns.items()}
    arrays = {name: array.astype(array.dtype.newbyteorder("<"), order="C") for name, array in arrays.items()}
    checksum = 0
    for name, array in arrays.items():
        if array.dtype.str not in _DTYPES:
            raise ValueError(f"write_cache: expected numbers in column {name!r}, got dtype {array.dtype}")
        checksum = zlib.crc32(array.tobytes(), checksum)
    if (total := sum(array.nbytes for array in arrays.values()) + _HEADER_BYTES) > MAX_BYTES:
        raise FileFormatError(
            path,
            where="the columns",
            expected=f"at most {MAX_BYTES} bytes",
            got=f"{total} bytes",
            fix="Nothing could read it again; it was not written. Read the cloud without a cache.",
        )
    table = [{"name": name, "dtype": array.dtype.str, "shape": array.shape} for name, array in arrays.items()]
    head = {"columns": table, "crc32": checksum, **({} if source is None else {"source": source})}
    header = json.dumps(head).encode("utf-8")
    with open_atomic(path) as handle:
        handle.write(_MAGIC + len(header).to_bytes(4, "little") + header)
        for array in arrays.values():
            handle.write(array.tobytes())


def read_cache(path: Path | str, *, max_bytes: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """Read a cache file.

    Args:
        path: The file.
        max_bytes: Largest file that is accepted.

    Returns:
        The arrays by name, as they were given to :func:`write_cache`.

    Raises:
        FileFormatError: If the file is no cache file, is truncated or over-long, or its checksum disagrees.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    start = len(_MAGIC) + 4
    if data[: len(_MAGIC)] != _MAGIC or len(data) < start:
        raise FileFormatError(path, where="byte 0", expected=f"the magic {_MAGIC!r}", got=repr(data[:12]))
    length = int.from_bytes(data[len(_MAGIC) : start], "little")
    if length > min(_HEADER_BYTES, len(data) - start):
        actual = f"{length}, in a file of {len(data)} bytes"
        raise FileFormatError(path, where="byte 8", expected="the length of a header in the file", got=actual)
    table, checksum = _parse_header(data[start : start + length], path=path)
    payload = memoryview(data)[start + length :]
    expected_bytes = sum(_bytes_of(column) for column in table)
    if len(payload) != expected_bytes:
        where, actual = f"byte {start + length}", f"{len(payload)} bytes"
        raise FileFormatError(path, where=where, expected=f"{expected_bytes} bytes of columns", got=actual)
    if zlib.crc32(payload) != checksum:
        where, actual = f"byte {start + length}", f"{zlib.crc32(payload)}"
        fix = "The file is damaged; write it again."
        raise FileFormatError(path, where=where, expected=f"CRC-32 {checksum}", got=actual, fix=fix)
    arrays, offset = {}, 0
    for column in table:
        part = np.frombuffer(payload, dtype=np.uint8, count=_bytes_of(column), offset=offset)
        if column["dtype"] == "|b1" and (part > 1).any():
            where, expected = f"byte {start + length + offset}", f"booleans in {column['name']!r}"
            raise FileFormatError(path, where=where, expected=expected, got="bytes above 1")
        arrays[column["name"]] = part.view(column["dtype"]).reshape(column["shape"]).copy()
        offset += part.size
    return arrays


def cache_source(path: Path | str) -> tuple[int, int] | None:
    """Size and CRC-32 of the file that a cache file was made of; None where it does not say it, or is no cache file.

    Args:
        path: The file, of which the header alone is read.
    """
    try:
        with open_file(path, max_bytes=sys.maxsize) as handle:
            magic, length = handle.read(len(_MAGIC)), int.from_bytes(handle.read(4), "little")
            head = plain_json(handle.read(min(length, _HEADER_BYTES))) if magic == _MAGIC else {}
        size, checksum = (int(number) for number in head["source"])
    except (OSError, FileFormatError, ValueError, RecursionError, KeyError, TypeError):
        return None
    return size, checksum


def _bytes_of(column: Mapping[str, Any]) -> int:
    return math.prod(column["shape"]) * np.dtype(column["dtype"]).itemsize


def _parse_header(text: bytes, *, path: Path | str) -> tuple[list[dict[str, Any]], int]:
    try:
        header = plain_json(text)
        table, checksum = header["columns"], header["crc32"]
        names = [column["name"] for column in table]
        good = isinstance(checksum, int) and len(set(names)) == len(names)
        good = good and all(_is_column(column) for column in table)
    except (ValueError, KeyError, TypeError) as error:
        raise FileFormatError(path, where="byte 12", expected="a JSON header", got=plain(error)) from error
    if not good:
        expected = "columns with unique names, known dtypes and shapes"
        raise FileFormatError(path, where="byte 12", expected=expected, got=repr(text[:120]))
    return table, checksum


def _is_column(column: Mapping[str, Any]) -> bool:
    shape = column["shape"]
    return (
        isinstance(column["name"], str)
        and column["dtype"] in _DTYPES
        and isinstance(shape, list)
        and len(shape) <= 8
        and all(type(side) is int for side in shape)
        and is_addressable(shape, np.dtype(column["dtype"]).itemsize)
    )


# How many columns the points have in a ``.bin`` file, which says nothing of it: decided from the numbers themselves.
#
# Read with the right number, each column holds one kind of quantity; read with another, every column is a mixture of
# several. So the mutual information between a value and the column that it falls into is largest at the right number,
# in whatever order the points stand, and at its multiples: of those the smallest is taken whose repeated columns are
# alike.

POSSIBLE = (3, 4, 5, 6, 7, 8, 9, 10)
"""Numbers of columns that can be told apart."""

_BLOCK = 2520  # a multiple of all that are possible
_MOST_BLOCKS = 32
_LEAST_VALUES = 600
_BINS = 48
_FARTHEST_M = 1e4
_ALIKE = 0.1  # mean Kolmogorov distance of columns that hold the same quantity
_CLEAR = 0.05  # nats: what the best has to have, and to be ahead of one that is no divisor of it
MOST_RINGS = 512
"""Of a column of whole numbers that is taken for rings, as no sensor has more today."""
_FEW = 0.01  # share of negative numbers in a damaged column of intensities
_LEAST_BRIGHT = 129  # the brightest value of a colour, more than the most rings of a usual LiDAR


@dataclass(frozen=True)
class BinColumns:
    """What the columns of a ``.bin`` file are.

    Args:
        count: Number of columns.
        names: A name a column: x, y, z, intensity, then what is recognised (``ring``, ``range_m``), else ``extra0``...
        likely: Whether the numbers themselves say so; else it is the format's usual count.
    """

    count: int
    names: tuple[str, ...]
    likely: bool

    def __str__(self) -> str:
        why = "by the numbers themselves" if self.likely else "too few numbers to tell: KITTI's layout is taken"
        return f"{self.count} columns a point ({', '.join(self.names)}), {why}"


def bin_columns(path: Path | str, *, max_bytes: int = MAX_BYTES) -> BinColumns:
    """Decide how many float32 a point has.

    Args:
        path: The file: rows of little-endian float32 without a header.
        max_bytes: Largest file that is accepted.

    Raises:
        FileFormatError: If no number of columns fits, or several fit alike.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    _refuse_other_cloud(path, data)
    values = np.frombuffer(data[: len(data) // 4 * 4], dtype="<f4")
    fitting = [count for count in POSSIBLE if len(data) % (4 * count) == 0 and len(data)]
    if not fitting:
        raise FileFormatError(
            path,
            where="the file's size",
            expected=f"a whole number of points of {POSSIBLE[0]} to {POSSIBLE[-1]} float32",
            got=f"{len(data)} bytes",
            fix="The file is truncated, or no table of float32.",
        )
    if len(values) < _LEAST_VALUES:
        return _usual(path, fitting, values)
    evidence = {count: _told(values, count) for count in fitting}
    best = max(evidence, key=lambda count: evidence[count])
    chosen = min(count for count in fitting if best % count == 0 and _repeats(values, count, best) < _ALIKE)
    rivals = [count for count in fitting if count % chosen and evidence[count] > evidence[chosen] - _CLEAR]
    if evidence[chosen] < _CLEAR or rivals:
        raise _doubt(path, [chosen, *rivals])
    rows = values.reshape(-1, chosen)
    if not _places(rows):
        raise _doubt(path, fitting)
    return BinColumns(chosen, names_of(rows), likely=True)


def _usual(path: Path | str, fitting: list[int], values: Float32[np.ndarray, " n"]) -> BinColumns:
    """Few numbers tell nothing: KITTI's four, where they fit and are places and a strength."""
    if 4 in fitting:
        rows = values.reshape(-1, 4)
        if _places(rows) and (rows[:, 3] >= 0).all():
            return BinColumns(4, names_of(rows), likely=False)
    raise _doubt(path, fitting)


def _doubt(path: Path | str, counts: list[int]) -> FileFormatError:
    return FileFormatError(
        path,
        where="the columns",
        expected="numbers that tell how many columns there are",
        got=f"a file that may have {' or '.join(str(count) for count in sorted(counts))} columns",
        fix="Say how many with --columns, in Python bin_columns=; or the file is truncated, or holds another type than "
        "float32, such as float64.",
    )


@np.errstate(invalid="ignore")  # numbers of another kind
def _told(values: Float32[np.ndarray, " n"], count: int) -> float:
    """Mutual information of value and column in nats, less what chance alone gives."""
    used = _spread(values[: len(values) // count * count]).astype(np.float64)
    edges = np.unique(np.quantile(used[np.isfinite(used)], np.linspace(0, 1, _BINS + 1)[1:-1]))
    bins = np.searchsorted(edges, used, side="right")
    bins[~np.isfinite(used)] = len(edges) + 1
    cells = np.tile(np.arange(count), len(used) // count) + count * bins
    joint = np.bincount(cells, minlength=count * (len(edges) + 2)).reshape(-1, count) / len(used)
    independent = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0)
    filled = joint > 0
    chance = (np.count_nonzero(joint.sum(axis=1)) - 1) * (count - 1) / (2 * len(used))
    return float((joint[filled] * np.log(joint[filled] / independent[filled])).sum()) - chance


@np.errstate(invalid="ignore")
def _repeats(values: Float32[np.ndarray, " n"], count: int, multiple: int) -> float:
    """How far the columns that a number of columns puts together differ: mean Kolmogorov distance, 0 to 1."""
    if count == multiple:
        return 0.0
    used = _spread(values[: len(values) // multiple * multiple]).reshape(-1, multiple // count, count)
    used = np.sort(np.where(np.isfinite(used), used, 0.0), axis=0)
    apart = [
        float(np.abs(_share(used[:, later, column], used[:, 0, column]) - _share(*[used[:, 0, column]] * 2)).max())
        for later in range(1, multiple // count)
        for column in range(count)
    ]
    return float(np.mean(apart))


def _share(ordered: Float32[np.ndarray, " n"], limits: Float32[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Share of ordered values up to each limit."""
    return np.searchsorted(ordered, limits, side="right") / len(ordered)


def _spread(values: Float32[np.ndarray, " n"]) -> Float32[np.ndarray, " m"]:
    """Blocks of whole points from the whole file, at most some 80,000 numbers."""
    blocks = len(values) // _BLOCK
    if blocks <= _MOST_BLOCKS:
        return values
    chosen = np.linspace(0, blocks - 1, _MOST_BLOCKS).astype(np.int64)
    return values[: blocks * _BLOCK].reshape(blocks, _BLOCK)[chosen].reshape(-1)


def _places(rows: Float32[np.ndarray, "n c"]) -> bool:
    """Whether the first three columns can be places in metres: nearly all finite, and none beyond 10 km."""
    with np.errstate(invalid="ignore", over="ignore"):
        finite = np.isfinite(rows[:, :3]).all(axis=1)
        near = np.abs(rows[finite, :3]).max(initial=0.0) < _FARTHEST_M
    return bool(finite.any() and near)


@np.errstate(invalid="ignore", over="ignore")  # damaged numbers
def names_of(rows: Shaped[np.ndarray, "n c"]) -> tuple[str, ...]:
    """Names by what the columns hold, the first three being x, y and z.

    Of six, three colours of 0 to 255 are ``r``, ``g``, ``b`` and unit vectors ``nx``, ``ny``, ``nz``; neither is an
    intensity. Else the fourth is ``intensity`` unless more than one in a hundred is negative (``signal``); one that is
    equal to sqrt(x^2 + y^2 + z^2) is ``range_m``, and small whole numbers are a ``ring``; others are ``extra0``,
    ``extra1``... from the fifth on.
    """
    if rows.shape[1] == 6 and (named := _colours_or_normals(rows[:, 3:])):
        return ("x", "y", "z", *named)
    is_signal = np.count_nonzero(rows[:, 3:4] < 0) > _FEW * len(rows)
    names = ["x", "y", "z", "signal" if is_signal else "intensity"][: rows.shape[1]]
    if rows.shape[1] == len(names):
        return tuple(names)
    ranges = np.linalg.norm(rows[:, :3].astype(np.float64), axis=1)
    for number in range(4, rows.shape[1]):
        column = rows[:, number].astype(np.float64)
        finite = np.isfinite(column) & np.isfinite(ranges)
        is_near = "range_m" not in names and finite.any() and np.median(np.abs(column - ranges)[finite]) < 1e-2
        if is_near and ranges[finite].max() > 1:
            names.append("range_m")
        elif "ring" not in names and _is_ring(column):
            names.append("ring")
        else:
            names.append(f"extra{number - 4}")
    return tuple(names)


def _colours_or_normals(three: Shaped[np.ndarray, "n 3"]) -> tuple[str, ...]:
    """Names of three columns that are colours or unit vectors; none where they are neither."""
    values = three.astype(np.float64)
    if not len(values) or not np.isfinite(values).all():
        return ()
    if (np.abs(np.linalg.norm(values, axis=1) - 1) < 0.01).mean() > 0.99:
        return ("nx", "ny", "nz")
    is_byte = bool((values == np.rint(values)).all() and values.min() >= 0 and values.max() <= 255)
    return ("r", "g", "b") if is_byte and values.max(axis=0).min() >= _LEAST_BRIGHT else ()


def _is_ring(column: Float[np.ndarray, " n"]) -> bool:
    is_integer = np.isfinite(column).all() and bool((column == np.rint(column)).all())
    return bool(
        len(column)
        and is_integer
        and column.min() >= 0
        and 2 < len(np.unique(column)) <= MOST_RINGS
        and column.max() < MOST_RINGS
    )
