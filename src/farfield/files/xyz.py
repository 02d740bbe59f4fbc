"""Headerless ASCII clouds, one point a line: the ``.xyz`` files of Cirrus.

The Gaussian pattern has 5 columns (x, y, z, intensity, one unknown), the uniform pattern 8.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError
from farfield.files import ascii_table
from farfield.files.ascii_table import parse_table
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.limits import MAX_BYTES, open_file
from farfield.files.stand_ins import check_itself

KNOWN_COLUMNS = (5, 8)
_MOST_COLUMNS = 16
_LINE_BYTES = 4096  # longer than any line of numbers


def read_xyz(
    path: Path | str,
    *,
    columns: int | None = None,
    delimiter: str = "auto",
    on_nan: Literal["error", "drop", "keep"] = "error",
    max_bytes: int = MAX_BYTES,
) -> Float[np.ndarray, "n c"]:
    """Read a headerless ASCII cloud.

    Args:
        path: The file.
        columns: Number of columns; None accepts 5 or 8, as the first line has it.
        delimiter: ``"auto"`` (from the first line: semicolon, comma, else white space), ``","``, ``";"``, or
            ``" "`` for any white space.
        on_nan: What to do with points that hold NaN or infinity: ``"error"``, ``"drop"`` or ``"keep"``.
        max_bytes: Largest file that is accepted.

    Returns:
        One row a point, at least one, shape (n, columns), float64, in the file's own units.

    Raises:
        FileFormatError: If the file is empty, truncated, too large, or holds anything but such rows of numbers.
        ValueError: If an argument is not one of those possible.
    """
    if delimiter not in ("auto", ",", ";", " ", "\t"):
        raise ValueError(f"read_xyz: expected delimiter 'auto', ',', ';', ' ' or '\\t', got {delimiter!r}")
    data = read_bytes(path, max_bytes=max_bytes)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    data = data.rstrip()
    if not data:
        raise FileFormatError(path, where="line 1", expected="at least one point", got="an empty file")
    first = data[: _LINE_BYTES + 1].partition(b"\n")[0].decode("ascii", errors="replace")
    separator = delimiter.strip() or None
    if delimiter == "auto":
        separator = next((mark for mark in ";," if mark in first), None)
    count = len(first.split(separator))
    if count != columns if columns is not None else count not in KNOWN_COLUMNS:
        raise FileFormatError(
            path,
            where="line 1",
            expected=f"{columns} columns" if columns is not None else "5 columns (Gaussian) or 8 (uniform)",
            got=f"{count} in {first[:80]!r}",
            fix="Pass columns= if the file is meant to have so many.",
        )
    table = parse_table(data, dtypes=[np.dtype(np.float64)] * count, separator=separator, path=path)
    rows = np.stack(table, axis=1)
    return _finite(rows, on_nan=on_nan, path=path)


def xyz_columns(path: Path) -> int | None:
    """Columns of an ASCII cloud, three or more; None leaves it to the reader, which names what is wrong."""
    check_itself(path)
    with open_file(path, max_bytes=None) as handle:
        first = handle.read(_LINE_BYTES).partition(b"\n")[0].decode("ascii", errors="replace")
    count = len(first.replace(";", " ").replace(",", " ").split())
    return count if 3 <= count <= _MOST_COLUMNS else None


def _finite(
    rows: Float[np.ndarray, "n c"], *, on_nan: Literal["error", "drop", "keep"], path: Path | str
) -> Float[np.ndarray, "kept c"]:
    finite = np.isfinite(rows).all(axis=1)
    if finite.all() or on_nan == "keep":
        return rows
    if on_nan == "drop" and finite.any():
        return rows[finite]
    bad = int(np.argmin(finite))
    raise FileFormatError(
        path,
        where=f"line {bad + 1}",
        expected="finite numbers" if on_nan == "error" else "at least one point with finite numbers",
        got=str(rows[bad].tolist()),
        fix="Remove them from the file; in Python on_nan='drop' leaves them out." if on_nan == "error" else "",
    )


def write_xyz(path: Path | str, rows: Float[np.ndarray, "n c"], *, decimals: int | Sequence[int] = 4) -> None:
    """Write a headerless, comma-separated ASCII cloud, all or nothing.

    Args:
        path: The file to write.
        rows: One row a point, at least one, finite, shape (n, c).
        decimals: Digits after the point, one number for all columns or one a column. A value half-way between two
            neighbours may go to either.

    Raises:
        ValueError: If the rows are not a finite table with at least one row, or ``decimals`` does not fit it.
    """
    rows = np.asarray(rows, dtype=np.float64)
    if rows.ndim != 2 or rows.size == 0 or not np.isfinite(rows).all():
        raise ValueError(f"write_xyz: expected a table of finite numbers with at least one row, got {rows.shape}")
    places = [decimals] * rows.shape[1] if isinstance(decimals, int) else list(decimals)
    if len(places) != rows.shape[1] or not all(0 <= digits <= 15 for digits in places):
        raise ValueError(f"write_xyz: expected 0..15 decimals for {rows.shape[1]} columns, got {decimals!r}")
    with open_atomic(path) as handle:
        for start in range(0, len(rows), ascii_table.ROWS_AT_ONCE):
            handle.write(_format(rows[start : start + (ascii_table.ROWS_AT_ONCE)], places))


def _format(rows: Float[np.ndarray, "n c"], places: list[int]) -> bytes:
    if any(np.abs(rows[:, j]).max() * 10.0**digits >= ascii_table.EXACT for j, digits in enumerate(places)):
        line = ",".join(f"%.{digits}f" for digits in places) + "\n"  # huge values: slow and exact
        return ((line * len(rows)) % tuple(rows.ravel().tolist())).encode("ascii")
    return ascii_table.join([ascii_table.fixed_point(rows[:, j], digits) for j, digits in enumerate(places)], ",")
