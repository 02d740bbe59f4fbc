"""Binary clouds: KITTI's velodyne ``.bin`` and Farfield's own cache ``.ffcloud``.

A cache file is: the magic ``FFCLOUD1``; the header's length (uint32, little-endian); the header, JSON; then the columns
one after another, little-endian, C order, without gaps. The header names each column with its dtype and shape and gives
the CRC-32 of all columns' bytes.
"""

import json
import math
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import MAX_BYTES, open_atomic, read_bytes

CACHE_SUFFIX = ".ffcloud"
_MAGIC = b"FFCLOUD1"
_HEADER_BYTES = 1 << 20
_MAX_SIDE = 1 << 40
_DTYPES = frozenset(["|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8"])


def read_bin(
    path: Path | str, *, columns: int = 4, on_nan: Literal["error", "drop"] = "error", max_bytes: int = MAX_BYTES
) -> Float32[np.ndarray, "n columns"]:
    """Read a KITTI velodyne file: rows of little-endian float32, no header (KITTI object devkit readme).

    Args:
        path: The file.
        columns: Numbers a point: 4 for KITTI (x, y, z in metres, reflectance 0..1), 7 for View-of-Delft radar.
        on_nan: What to do with points that hold NaN or infinity: ``"error"`` or ``"drop"``.
        max_bytes: Largest file that is accepted.

    Returns:
        One row a point, at least one, shape (n, columns), float32.

    Raises:
        FileFormatError: If the file is empty, too large, no whole number of points, or not finite.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    points, rest = divmod(len(data), 4 * columns)
    if points == 0 or rest:
        raise FileFormatError(
            path,
            where=f"byte {points * 4 * columns}",
            expected=f"at least one point and {4 * columns} bytes ({columns} float32) for each",
            found=f"{len(data)} bytes: {points} points and {rest} bytes more",
            mend="The file is truncated, or has another number of columns (columns=).",
        )
    rows = np.frombuffer(data, dtype="<f4").reshape(points, columns).astype(np.float32)
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all() and (on_nan == "error" or not finite.any()):
        bad = int(np.argmin(finite))
        raise FileFormatError(
            path,
            where=f"byte {bad * 4 * columns} (point {bad})",
            expected="finite numbers",
            found=str(rows[bad].tolist()),
            mend="Pass on_nan='drop' to leave such points out." if on_nan == "error" else "",
        )
    return rows if finite.all() else rows[finite]


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


def write_cache(path: Path | str, columns: Mapping[str, np.ndarray]) -> None:
    """Write named arrays of any numeric or boolean dtype and any shape as a cache file, all or nothing.

    Args:
        path: The file to write, by custom ``*.ffcloud``.
        columns: Arrays by name.

    Raises:
        ValueError: If an array is neither numeric nor boolean.
    """
    arrays = {name: np.asarray(array) for name, array in columns.items()}
    arrays = {name: array.astype(array.dtype.newbyteorder("<"), order="C") for name, array in arrays.items()}
    checksum = 0
    for name, array in arrays.items():
        if array.dtype.str not in _DTYPES:
            raise ValueError(f"write_cache: expected numbers in column {name!r}, got dtype {array.dtype}")
        checksum = zlib.crc32(array.tobytes(), checksum)
    table = [{"name": name, "dtype": array.dtype.str, "shape": array.shape} for name, array in arrays.items()]
    header = json.dumps({"columns": table, "crc32": checksum}).encode("utf-8")
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
        raise FileFormatError(path, where="byte 0", expected=f"the magic {_MAGIC!r}", found=repr(data[:12]))
    length = int.from_bytes(data[len(_MAGIC) : start], "little")
    if length > min(_HEADER_BYTES, len(data) - start):
        found = f"{length}, in a file of {len(data)} bytes"
        raise FileFormatError(path, where="byte 8", expected="the length of a header in the file", found=found)
    table, checksum = _parse_header(data[start : start + length], path=path)
    payload = memoryview(data)[start + length :]
    wanted = sum(_bytes_of(column) for column in table)
    if len(payload) != wanted:
        where, found = f"byte {start + length}", f"{len(payload)} bytes"
        raise FileFormatError(path, where=where, expected=f"{wanted} bytes of columns", found=found)
    if zlib.crc32(payload) != checksum:
        where, found = f"byte {start + length}", f"{zlib.crc32(payload)}"
        mend = "The file is damaged; write it again."
        raise FileFormatError(path, where=where, expected=f"CRC-32 {checksum}", found=found, mend=mend)
    arrays, offset = {}, 0
    for column in table:
        part = np.frombuffer(payload, dtype=np.uint8, count=_bytes_of(column), offset=offset)
        if column["dtype"] == "|b1" and (part > 1).any():
            where, expected = f"byte {start + length + offset}", f"booleans in {column['name']!r}"
            raise FileFormatError(path, where=where, expected=expected, found="bytes above 1")
        arrays[column["name"]] = part.view(column["dtype"]).reshape(column["shape"]).copy()
        offset += part.size
    return arrays


def _bytes_of(column: Mapping[str, Any]) -> int:
    return math.prod(column["shape"]) * np.dtype(column["dtype"]).itemsize


def _parse_header(text: bytes, *, path: Path | str) -> tuple[list[dict[str, Any]], int]:
    try:
        header = json.loads(text.decode("utf-8"))
        table, checksum = header["columns"], header["crc32"]
        names = [column["name"] for column in table]
        good = isinstance(checksum, int) and len(set(names)) == len(names)
        good = good and all(_is_column(column) for column in table)
    except (ValueError, RecursionError, KeyError, TypeError) as error:
        raise FileFormatError(path, where="byte 12", expected="a JSON header", found=plain(error)) from error
    if not good:
        expected = "columns with unique names, known dtypes and shapes"
        raise FileFormatError(path, where="byte 12", expected=expected, found=repr(text[:120]))
    return table, checksum


def _is_column(column: Mapping[str, Any]) -> bool:
    shape = column["shape"]
    return (
        isinstance(column["name"], str)
        and column["dtype"] in _DTYPES
        and isinstance(shape, list)
        and len(shape) <= 8
        and all(type(side) is int and 0 <= side <= _MAX_SIDE for side in shape)
    )
