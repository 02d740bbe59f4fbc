"""Tables of numbers in ASCII: parsed fast, and slowly a second time only to name the line of a fault."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.decimals import parse_decimals

_CHUNK_BYTES = 1 << 17  # text parsed at a time: its list of lines then stays in the processor's caches


def parse_table(
    data: bytes,
    *,
    dtypes: Sequence[np.dtype],
    separator: str | None,
    path: Path | str,
    line: int = 1,
) -> list[Shaped[np.ndarray, " n"]]:
    r"""Parse lines of numbers.

    Args:
        data: The text, at least one line, lines ended by ``\n``, the last one's end left out.
        dtypes: Dtype of each column.
        separator: What stands between two numbers; None for any white space.
        path: The file, for messages.
        line: Line of the file at which the text begins.

    Returns:
        One array a column, each of shape (n,).

    Raises:
        FileFormatError: If a line is blank, too long, or has other columns, or if something is no such number.
    """
    parts, start = [], 0
    while start < len(data):
        end = _chunk_end(data, start, path=path, line=line)
        parts.append(_parse_chunk(data[start:end], dtypes, separator, path=path, line=line))
        start, line = end + 1, line + data.count(b"\n", start, end) + 1
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def _chunk_end(data: bytes, start: int, *, path: Path | str, line: int) -> int:
    """Index of the last line end of the next chunk, or of the end of the data."""
    stop = start + _CHUNK_BYTES
    if stop >= len(data):
        return len(data)
    end = data.rfind(b"\n", start, stop)
    if end < 0:
        found = f"more than {_CHUNK_BYTES} bytes in one line"
        raise FileFormatError(path, where=f"line {line}", expected="a line of numbers", found=found)
    return end


def _parse_chunk(
    data: bytes, dtypes: Sequence[np.dtype], separator: str | None, *, path: Path | str, line: int
) -> list[Shaped[np.ndarray, " n"]]:
    """Plain decimals the fast way, anything else by numpy."""
    if all(dtype.kind == "f" for dtype in dtypes):
        rows = parse_decimals(data, columns=len(dtypes), separator=(separator or " ").encode())
        if rows is not None:
            return [column.astype(dtype) for column, dtype in zip(rows.T, dtypes, strict=True)]
    return _parse_lines(data.decode("latin-1").split("\n"), dtypes, separator, path=path, line=line)


def _parse_lines(
    lines: list[str], dtypes: Sequence[np.dtype], separator: str | None, *, path: Path | str, line: int
) -> list[Shaped[np.ndarray, " n"]]:
    alike = len(set(dtypes)) == 1
    dtype = dtypes[0] if alike else np.dtype([(f"c{index}", kind) for index, kind in enumerate(dtypes)])
    try:
        rows = np.loadtxt(lines, dtype=dtype, delimiter=separator, comments=None, ndmin=2 if alike else 1)
    except ValueError as error:
        raise _fault(lines, dtypes, separator, path=path, line=line, reason=str(error)) from error
    if len(rows) != len(lines) or (alike and rows.shape[1] != len(dtypes)):  # numpy skips blank lines
        raise _fault(lines, dtypes, separator, path=path, line=line, reason="a blank line")
    return list(rows.T) if alike else [rows[f"c{index}"] for index in range(len(dtypes))]


def _fault(
    lines: list[str], dtypes: Sequence[np.dtype], separator: str | None, *, path: Path | str, line: int, reason: str
) -> FileFormatError:
    for number, text in enumerate(lines, start=line):
        cells, where = text.split(separator), f"line {number}"
        if len(cells) != len(dtypes):
            found, mend = f"{len(cells)} in {text[:80]!r}", "The file may be truncated or spliced."
            return FileFormatError(path, where=where, expected=f"{len(dtypes)} columns", found=found, mend=mend)
        for cell, dtype in zip(cells, dtypes, strict=True):
            if not _fits(cell, dtype):
                return FileFormatError(path, where=where, expected=f"a number ({dtype})", found=repr(cell[:80]))
    where = f"lines {line} to {line + len(lines) - 1}"
    return FileFormatError(path, where=where, expected="numbers that fit their columns", found=reason)


def _fits(text: str, dtype: np.dtype) -> bool:
    if not text.isascii() or "_" in text:  # Python takes 1_000 for a number
        return False
    try:
        number = float(text) if dtype.kind == "f" else int(text)
    except ValueError:
        return False
    return dtype.kind == "f" or np.iinfo(dtype).min <= number <= np.iinfo(dtype).max
