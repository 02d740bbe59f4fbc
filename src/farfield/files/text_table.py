"""Tables of numbers written as ASCII text, a column at a time with array operations.

A column becomes a matrix of ASCII codes, one row a number, in which the code 0 stands for no character. Four digits are
looked up at once. :func:`join` sets columns side by side and drops the zeros.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Float, Integer, Shaped, UInt8

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
    whole = rest // 10**places
    point = [np.full((len(values), 1), ord("."), dtype=np.uint8)] if places else []
    return np.concatenate(
        [_sign(scaled < 0), *_whole(whole), *point, *_decimals(rest - whole * 10**places, places)], axis=1
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
    whole = size.astype(np.int64)
    decimals = np.rint((size - whole) * _STEPS[places]).astype(np.int64) * _SCALES[_DECIMALS - places]
    carried = decimals >= _SCALES[_DECIMALS]
    whole, decimals = whole + carried, np.where(carried, 0, decimals)
    point = np.where(decimals > 0, ord("."), 0).astype(np.uint8)[:, None]
    text = np.concatenate([_sign(np.signbit(values)), *_whole(whole), point, *_stripped(decimals)], axis=1)
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
