"""Tables of numbers in ASCII: parsed fast, and slowly a second time only to name the line of a fault."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, Integer, Shaped, UInt8

from farfield.errors import FileFormatError

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
        actual = f"more than {_CHUNK_BYTES} bytes in one line"
        raise FileFormatError(path, where=f"line {line}", expected="a line of numbers", got=actual)
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
            actual, fix = f"{len(cells)} in {text[:80]!r}", "The file may be truncated or spliced."
            return FileFormatError(path, where=where, expected=f"{len(dtypes)} columns", got=actual, fix=fix)
        for cell, dtype in zip(cells, dtypes, strict=True):
            if not _fits(cell, dtype):
                return FileFormatError(path, where=where, expected=f"a number ({dtype})", got=repr(cell[:80]))
    where = f"lines {line} to {line + len(lines) - 1}"
    return FileFormatError(path, where=where, expected="numbers that fit their columns", got=reason)


def whole_numbers(
    values: Float[np.ndarray, " n"], *, largest: int, path: Path | str, where: str
) -> Int[np.ndarray, " n"]:
    """A column of a table as whole numbers: rings, identities, counters.

    Raises:
        FileFormatError: If one is not finite, has a fraction, is negative or beyond the largest: no cast says so.
    """
    with np.errstate(invalid="ignore"):
        wrong = ~((values >= 0) & (values <= largest) & (values % 1 == 0))
    if wrong.any():
        expected, row = f"whole numbers from 0 to {largest}", int(np.argmax(wrong))
        raise FileFormatError(path, where=f"{where} of point {row}", expected=expected, got=f"{values[row]:g}")
    return values.astype(np.int64)


def _fits(text: str, dtype: np.dtype) -> bool:
    if not text.isascii() or "_" in text:  # Python takes 1_000 for a number
        return False
    try:
        number = float(text) if dtype.kind == "f" else int(text)
    except ValueError:
        return False
    return dtype.kind == "f" or np.iinfo(dtype).min <= number <= np.iinfo(dtype).max


# Plain decimal numbers in ASCII, many at a time: the digits are added up column by column of the text.
#
# Three times as fast as numpy's own reader of text, and equal to it to the last bit: a number of at most 15 digits is
# an integer divided by a power of ten, both of them exact in double precision, and one division rounds once (Clinger
# 1990).

_LONGEST = 17  # a sign, 15 digits, a point
_MOST_DIGITS = 15
_TENS = 10.0 ** np.arange(_LONGEST + 1)
_MINUS, _POINT, _ZERO, _NEWLINE = b"-.0\n"


def parse_decimals(data: bytes, *, columns: int, separator: bytes) -> Float[np.ndarray, "n columns"] | None:
    r"""Parse lines of plain decimals such as ``-12.25``.

    Args:
        data: The text, at least one line, lines ended by ``\n``, the last one's end left out.
        columns: Numbers a line, at least one.
        separator: The one byte between two numbers of a line.

    Returns:
        One row a line, shape (n, columns); None where anything else stands in the text: an exponent, a plus sign, more
        than 15 digits, a blank, another number of columns.
    """
    text = np.frombuffer(data, dtype=np.uint8)
    line_ends = text == _NEWLINE
    breaks = np.flatnonzero(line_ends | (text == separator[0]))
    ends = np.append(breaks, len(text))
    if len(ends) % columns:
        return None
    # Every line ends after as many numbers, and none before.
    ending = line_ends[breaks]
    if not ending[columns - 1 :: columns].all() or ending.sum() != len(ending[columns - 1 :: columns]):
        return None
    starts = np.concatenate([[0], breaks + 1])
    values = _values(text, starts, ends - starts)
    return None if values is None else values.reshape(-1, columns)


def _values(
    text: UInt8[np.ndarray, " bytes"], starts: Int[np.ndarray, " n"], lengths: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"] | None:
    """The number that begins at each start and is that long; None where one of them is no plain decimal."""
    longest = int(lengths.max())
    if longest > _LONGEST or lengths.min() < 1:
        return None
    padded = np.append(text, np.zeros(longest, dtype=np.uint8))
    negative = padded[starts] == _MINUS
    mantissa = np.zeros(len(starts), dtype=np.int64)
    digits, decimals = (np.zeros(len(starts), dtype=np.int8) for _ in range(2))
    past_point = np.zeros(len(starts), dtype=bool)
    for position in range(longest):
        letter = padded[starts + position]
        within = lengths > position
        digit = letter - np.uint8(_ZERO)  # wraps round: what is no digit becomes 10 or more
        counts = (digit < 10) & within
        point = (letter == _POINT) & within
        if (point & past_point).any() or (within & ~counts & ~point & ~(negative if position == 0 else False)).any():
            return None
        mantissa = np.where(counts, mantissa * 10 + digit, mantissa)
        digits += counts
        decimals += counts & past_point
        past_point |= point
    if digits.min() < 1 or digits.max() > _MOST_DIGITS:
        return None
    values = mantissa / _TENS[decimals]
    return np.where(negative, -values, values)


# Tables of numbers written as ASCII text, a column at a time with array operations.
#
# A column becomes a matrix of ASCII codes, one row a number, in which the code 0 stands for no character. Four digits
# are looked up at once. :func:`join` sets columns side by side and drops the zeros.

EXACT = float(1 << 53)  # integers below are exact in float64
ROWS_AT_ONCE = 1 << 14  # such a part of a table stays in the processor's caches
_BLOCK = 10_000  # four digits
_PADDED, _LEADING, _WHOLE, _TRAILING = (number * _BLOCK for number in range(4))
_DECIMALS = 12  # a float32 of 1e-4 or more has nine significant digits within twelve decimals
_DECADES = 10.0 ** np.arange(-4, 10)
_STEPS = 10.0 ** np.arange(_DECIMALS + 1)
_SCALES = (10 ** np.arange(_DECIMALS + 1)).astype(np.int64)

Text = UInt8[np.ndarray, "_ _"]


@cache
def _digits() -> np.ndarray:
    """Four ASCII codes for 0 to 9999, in four kinds, shape (40000,), uint32.

    The kinds: zeros kept; leading zeros left out; leading zeros left out except the last; trailing zeros left out.
    """
    digits = (np.arange(_BLOCK)[:, None] // [1000, 100, 10, 1] % 10).astype(np.uint8)
    filled = digits > 0
    shown = np.logical_or.accumulate(filled, axis=1)
    at_least_one = shown | [False, False, False, True]
    until_last = np.logical_or.accumulate(filled[:, ::-1], axis=1)[:, ::-1]
    kinds = [np.ones_like(shown), shown, at_least_one, until_last]
    codes = np.concatenate([np.where(kind, digits + ord("0"), 0).astype(np.uint8) for kind in kinds])
    return np.ascontiguousarray(codes).view(np.uint32)[:, 0]


def _codes(index: Shaped[np.ndarray, " n"]) -> Text:
    return _digits()[index].view(np.uint8).reshape(-1, 4)


def _whole(values: Integer[np.ndarray, " n"]) -> list[Text]:
    """Digits of numbers that are not negative, leading zeros left out."""
    rest: np.ndarray = values.astype(np.uint32 if int(values.max(initial=0)) < 1 << 32 else np.uint64)
    four = np.array(_BLOCK, dtype=rest.dtype)  # keeps the dtype, and with it the speed
    blocks: list[Text] = []
    while True:
        higher = rest // four
        block = (rest - higher * four).astype(np.intp)
        blocks.insert(0, _codes(block + np.where(higher == 0, _LEADING if blocks else _WHOLE, _PADDED)))
        if not higher.any():
            return blocks
        rest = higher


def _decimals(values: Integer[np.ndarray, " n"], places: int) -> list[Text]:
    """Digits after the point, ``places`` of them, zeros kept."""
    blocks: list[Text] = []
    rest = values
    for first in range(places, 0, -4):
        higher = rest // _BLOCK
        blocks.insert(0, _codes(rest - higher * _BLOCK)[:, max(4 - first, 0) :])
        rest = higher
    return blocks


def _sign(negative: Shaped[np.ndarray, " n"]) -> Text:
    return np.where(negative, ord("-"), 0).astype(np.uint8)[:, None]


def fixed_point(values: Float[np.ndarray, " n"], places: int) -> Text:
    """Write numbers with a fixed number of digits after the point.

    Args:
        values: Finite numbers, shape (n,), float64; times ``10**places`` they must stay below 2**53.
        places: Digits after the point, 0 to 15. A value half-way between two neighbours may go to either.
    """
    scaled = np.rint(values * 10.0**places).astype(np.int64)
    rest = np.abs(scaled)
    integer_part = rest // 10**places
    point = [np.full((len(values), 1), ord("."), dtype=np.uint8)] if places else []
    return np.concatenate(
        [_sign(scaled < 0), *_whole(integer_part), *point, *_decimals(rest - integer_part * 10**places, places)], axis=1
    )


def integers(values: Integer[np.ndarray, " n"]) -> Text:
    """Write whole numbers of any integer dtype."""
    if values.dtype == np.int64 and (values == np.iinfo(np.int64).min).any():  # has no positive counterpart
        return _one_by_one(values, "%d")
    rest = values if values.dtype.kind == "u" else np.abs(values.astype(np.int64))
    return np.concatenate([_sign(values < 0), *_whole(rest)], axis=1)


def floats(values: Float[np.ndarray, " n"]) -> Text:
    """Write numbers with as many digits as it takes to read the same number back.

    float32 gets up to nine significant digits without trailing zeros; not-a-number is ``nan``.
    """
    if values.dtype != np.float32:
        return _one_by_one(values, "%.17g")
    with np.errstate(invalid="ignore"):  # a signalling not-a-number
        size = np.abs(values.astype(np.float64))
    usual = (size == 0) | ((size >= _DECADES[0]) & (size < _DECADES[-1]))
    size[~usual] = 0.0
    places = _DECIMALS + 1 - np.maximum(np.searchsorted(_DECADES, size, side="right"), 1)
    places = np.minimum(places, _DECIMALS)
    integer_part = size.astype(np.int64)
    decimals = np.rint((size - integer_part) * _STEPS[places]).astype(np.int64) * _SCALES[_DECIMALS - places]
    carried = decimals >= _SCALES[_DECIMALS]
    integer_part, decimals = integer_part + carried, np.where(carried, 0, decimals)
    point = np.where(decimals > 0, ord("."), 0).astype(np.uint8)[:, None]
    text = np.concatenate([_sign(np.signbit(values)), *_whole(integer_part), point, *_stripped(decimals)], axis=1)
    if not usual.all():
        text = _patched(text, np.flatnonzero(~usual), _one_by_one(values[~usual], "%.9g"))
    return text


def _stripped(decimals: Integer[np.ndarray, " n"]) -> list[Text]:
    """Twelve digits after the point, trailing zeros left out."""
    blocks: list[Text] = []
    rest, nothing_after = decimals, np.ones(len(decimals), dtype=np.bool_)
    for _ in range(_DECIMALS // 4):
        higher = rest // _BLOCK
        block = rest - higher * _BLOCK
        blocks.insert(0, _codes(block + np.where(nothing_after, _TRAILING, _PADDED)))
        nothing_after &= block == 0
        rest = higher
    return blocks


def _one_by_one(values: Shaped[np.ndarray, " n"], form: str) -> Text:
    lines = np.array([(form % value).encode("ascii") for value in values.tolist()] or [b"0"], dtype=np.bytes_)
    return lines.view(np.uint8).reshape(len(lines), -1)[: len(values)]


def _patched(text: Text, rows: Integer[np.ndarray, " k"], patch: Text) -> Text:
    width = max(text.shape[1], patch.shape[1])
    wider = np.zeros((len(text), width), dtype=np.uint8)
    wider[:, : text.shape[1]] = text
    wider[rows] = 0
    wider[rows, : patch.shape[1]] = patch
    return wider


def join(columns: Sequence[Text], separator: str) -> bytes:
    """Set columns of text side by side, a separator between two and a line end after the last."""
    between = np.full((len(columns[0]), 1), ord(separator), dtype=np.uint8)
    end = np.full_like(between, ord("\n"))
    parts = [part for column in columns for part in (column, between)]
    return np.concatenate([*parts[:-1], end], axis=1).tobytes().translate(None, b"\0")
