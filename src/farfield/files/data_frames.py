"""Data frames of pandas in its own pickles, read without pandas and without running the pickle.

The layouts are those that pandas 1.0 to 1.2 (a block manager with a state) and 1.5 to 2 (one of arguments) write:
columns of one type lie together in blocks, each with the places of its rows among the columns. All others are refused.
Arrays of NumPy stand in them as ``_reconstruct`` with a state or, of protocol 5, as ``_frombuffer``.
"""

import math
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.pickles import Call, Name, walk_pickle
from farfield.vocabulary.counts import count_of

MAX_FRAME_BYTES = 64 << 20
"""Of a data frame's pickle, unpacked: 1.3 million points of six numbers."""
_GZIP = b"\x1f\x8b"
_ADVICE = (
    "If you trust the file, write it anew where pandas 2.2 is installed, which runs the pickle: "
    'python -c "import sys, pandas; [pandas.read_pickle(f).to_pickle(f) for f in sys.argv[1:]]" FILES'
)

_CORES = ("numpy.core", "numpy._core")
_DTYPE, _NDARRAY, _SLICE = Name("numpy", "dtype"), Name("numpy", "ndarray"), Name("builtins", "slice")
_RECONSTRUCT = {Name(f"{core}.multiarray", "_reconstruct") for core in _CORES}
_FROM_BUFFER = {Name(f"{core}.numeric", "_frombuffer") for core in _CORES}
_FRAME = {Name("pandas.core.frame", "DataFrame"), Name("pandas", "DataFrame")}
_MANAGER = Name("pandas.core.internals.managers", "BlockManager")
_BLOCK = Name("pandas._libs.internals", "_unpickle_block")
_NEW_INDEX = Name("pandas.core.indexes.base", "_new_Index")
_INDEX, _RANGE = Name("pandas.core.indexes.base", "Index"), Name("pandas.core.indexes.range", "RangeIndex")
_WHOLE_INDEX = Name("pandas.core.indexes.numeric", "Int64Index")
_NAMES = frozenset(
    {_DTYPE, _NDARRAY, _SLICE, _MANAGER, _BLOCK, _NEW_INDEX, _INDEX, _RANGE, _WHOLE_INDEX}
    | _RECONSTRUCT
    | _FROM_BUFFER
    | _FRAME
)
_NUMBERS = {f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)} | {"f4", "f8", "b1"}

Column = Shaped[np.ndarray, " n"] | list[Any]
"""Numbers as an array, or texts, flags, numbers and None as a list."""


class _OtherLayoutError(Exception):
    """What a part of the pickle should be, and what it is."""

    def __init__(self, part: str, expected: str, got: str) -> None:
        super().__init__(part)
        self.part, self.expected, self.got = part, expected, got


def read_data_frame(path: Path | str, *, max_bytes: int = MAX_FRAME_BYTES) -> Mapping[str, Column]:
    """The columns of a data frame in ``.pkl`` or ``.pkl.gz``, without its index.

    Args:
        path: The file.
        max_bytes: Largest pickle that is accepted, packed and unpacked.

    Returns:
        Columns by name, all of one length, views of the file's bytes where they are numbers.

    Raises:
        FileFormatError: If it is no pickle of a data frame in a layout that is known, or larger.
        OSError: If it cannot be opened.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    if data.startswith(_GZIP):
        data = _unpacked(data, path, max_bytes)
    content = walk_pickle(data, path, _NAMES, fix=_ADVICE)
    try:
        return _columns(content)
    except _OtherLayoutError as error:
        raise FileFormatError(path, where=error.part, expected=error.expected, got=error.got, fix=_ADVICE) from error


def _unpacked(data: bytes, path: Path | str, max_bytes: int) -> bytes:
    """The one member of a gzip file, with its check sum checked."""
    stream = zlib.decompressobj(wbits=31)
    try:
        unpacked = stream.decompress(data, max_bytes + 1)
    except zlib.error as error:
        raise FileFormatError(path, where="the file", expected="a whole gzip file", got=str(error)[:100]) from error
    if len(unpacked) > max_bytes:
        expected = f"at most {max_bytes} bytes when unpacked"
        raise FileFormatError(path, where="the file", expected=expected, got="more")
    if not stream.eof or stream.unused_data:
        got = "bytes behind it" if stream.eof else "a part of one"
        raise FileFormatError(path, where="the end", expected="the end of one gzip file", got=got)
    return unpacked


def _columns(content: Any) -> dict[str, Column]:
    frame = _call(content, _FRAME, "the pickle", "a data frame of pandas")
    state = frame.state if isinstance(frame.state, dict) else {}
    manager = _call(state.get("_mgr", state.get("_data")), {_MANAGER}, "the data frame", "a block manager")
    axes, blocks = _manager_parts(manager)
    if len(axes) != 2:
        raise _OtherLayoutError("the axes", "columns and rows", f"{len(axes)}")
    names, rows = _texts_of(axes[0]), _length_of(axes[1])
    columns: dict[str, Column] = {}
    for number, (values, places) in enumerate(blocks):
        part = f"block {number}"
        where = _places(places, len(names), part)
        lines = _lines(values, (len(where), rows), part)
        for column, line in zip(where, lines, strict=True):
            if names[column] in columns:
                raise _OtherLayoutError(part, f"the column {names[column]!r:.80} once", "twice")
            columns[names[column]] = line
    missing = [name for name in names if name not in columns]
    if missing:
        raise _OtherLayoutError("the blocks", f"values of the column {missing[0]!r:.80}", "none")
    return columns


def _call(value: Any, names: Any, part: str, expected: str) -> Call:
    if not isinstance(value, Call) or value.called not in names:
        got = str(value.called) if isinstance(value, Call) else type(value).__name__
        raise _OtherLayoutError(part, expected, got)
    return value


def _manager_parts(manager: Call) -> tuple[list[Any], list[tuple[Any, Any]]]:
    """The axes, and the values and places of each block."""
    if manager.arguments:  # pandas 1.5 and later
        if len(manager.arguments) != 2 or manager.state is not None:
            raise _OtherLayoutError("the block manager", "blocks and axes", f"{len(manager.arguments)} arguments")
        listed, axes = manager.arguments
        calls = [_call(block, {_BLOCK}, "a block", "values and places") for block in _list(listed, "the blocks")]
        if any(len(block.arguments) != 3 for block in calls):
            raise _OtherLayoutError("a block", "values, places and 2", "another number of arguments")
        return _list(axes, "the axes"), [(block.arguments[0], block.arguments[1]) for block in calls]
    state = manager.state
    extra = state[3] if isinstance(state, tuple) and len(state) == 4 else None
    whole = extra.get("0.14.1") if isinstance(extra, dict) else None
    if not isinstance(whole, dict) or not {"axes", "blocks"} <= set(whole):
        raise _OtherLayoutError("the block manager", "a state of four parts, the last '0.14.1'", type(state).__name__)
    blocks = _list(whole["blocks"], "the blocks")
    if not all(isinstance(block, dict) and {"values", "mgr_locs"} <= set(block) for block in blocks):
        raise _OtherLayoutError("a block", "values and mgr_locs", "something else")
    return _list(whole["axes"], "the axes"), [(block["values"], block["mgr_locs"]) for block in blocks]


def _list(value: Any, part: str) -> list[Any]:
    if not isinstance(value, list | tuple):
        raise _OtherLayoutError(part, "a list", type(value).__name__)
    return list(value)


def _index_parts(value: Any) -> tuple[Name, Mapping[str, Any]]:
    index = _call(value, {_NEW_INDEX}, "an axis", "an index")
    arguments = index.arguments
    if len(arguments) != 2 or not isinstance(arguments[0], Name) or not isinstance(arguments[1], dict):
        raise _OtherLayoutError("an axis", "an index's class and what it is made of", "something else")
    return arguments[0], arguments[1]


def _texts_of(axis: Any) -> list[str]:
    """The names of the columns."""
    kind, made_of = _index_parts(axis)
    values = _array(made_of.get("data"), "the columns' names") if kind == _INDEX else None
    if not isinstance(values, tuple) or not all(isinstance(name, str) for name in values[1]):
        raise _OtherLayoutError("the columns' names", "texts", "something else")
    if len(set(values[1])) < len(values[1]):
        raise _OtherLayoutError("the columns' names", "different ones", "one of them twice")
    return list(values[1])


def _length_of(axis: Any) -> int:
    """How many rows there are."""
    kind, made_of = _index_parts(axis)
    if kind == _RANGE:
        bounds: list[Any] = [made_of.get(name) for name in ("start", "stop", "step")]
        if not all(type(bound) is int for bound in bounds) or bounds[2] == 0:
            raise _OtherLayoutError("the rows", "whole start, stop and step", "something else")
        return len(range(*bounds)) if abs(bounds[0] - bounds[1]) < 1 << 40 else 1 << 40
    if kind not in (_INDEX, _WHOLE_INDEX):
        raise _OtherLayoutError("the rows", "a plain index", str(kind)[:80])
    values = _array(made_of.get("data"), "the rows")
    shape = values[0] if isinstance(values, tuple) else values.shape
    return math.prod(shape)


def _places(value: Any, count: int, part: str) -> list[int]:
    """Which columns the lines of a block are."""
    if isinstance(value, Call) and value.called == _SLICE:
        bounds = value.arguments
        whole = len(bounds) == 3 and all(type(bound) is int and 0 <= bound < 1 << 31 for bound in bounds)
        span = range(*bounds) if whole and bounds[2] else range(count, count + 1)
        if span and span[-1] >= count:
            raise _OtherLayoutError(part, f"places among {count} columns", "other bounds")
        return list(span)
    places = _array(value, part)
    if isinstance(places, tuple) or places.dtype.kind not in "iu" or places.ndim != 1:
        raise _OtherLayoutError(part, "whole numbers as places", "something else")
    if len(places) > count or ((places < 0) | (places >= count)).any():
        raise _OtherLayoutError(part, f"places among {count} columns", "others")
    return [int(column) for column in places]


def _lines(value: Any, sides: tuple[int, int], part: str) -> list[Column]:
    """The columns of a block of so many columns and rows."""
    values = _array(value, part)
    shape = values[0] if isinstance(values, tuple) else values.shape
    rows = sides[1]
    if shape != sides:
        raise _OtherLayoutError(
            part, f"{count_of(sides[0], 'line')} of {count_of(rows, 'value')}", f"values of shape {shape}"[:80]
        )
    if not isinstance(values, tuple):
        return list(values)
    _, cells, by_column = values
    if by_column:
        return [cells[line :: shape[0]] for line in range(shape[0])]
    return [cells[line * rows : (line + 1) * rows] for line in range(shape[0])]


_Cells = tuple[tuple[int, ...], list[Any], bool]


def _array(value: Any, part: str) -> Shaped[np.ndarray, "..."] | _Cells:
    """An array of NumPy; of objects its shape, its values and whether they stand in Fortran's order."""
    call = _call(value, _RECONSTRUCT | _FROM_BUFFER, part, "an array of NumPy")
    if call.called in _RECONSTRUCT:
        state = call.state if isinstance(call.state, tuple) else ()
        if len(state) != 5 or call.arguments[:1] != (_NDARRAY,):
            raise _OtherLayoutError(part, "an array's shape, type and values", "something else")
        _, shape, kind, by_column, data = state
    else:
        if len(call.arguments) != 4 or call.arguments[3] not in ("C", "F") or call.state is not None:
            raise _OtherLayoutError(part, "an array's values, type, shape and order", "something else")
        data, kind, shape, by_column = *call.arguments[:3], call.arguments[3] == "F"
    sound = isinstance(shape, tuple) and len(shape) <= 2 and type(by_column) is bool
    if not sound or not all(type(side) is int and 0 <= side < 1 << 40 for side in shape):
        raise _OtherLayoutError(part, "a shape of one or two sides", "another")
    return _values(data, _dtype(kind, part), shape, by_column, part)


def _values(
    data: Any, dtype: np.dtype | None, shape: tuple[int, ...], by_column: bool, part: str
) -> Shaped[np.ndarray, "..."] | _Cells:
    count = math.prod(shape)
    if dtype is None:
        if not isinstance(data, list) or len(data) != count:
            raise _OtherLayoutError(part, f"{count} values", "another number or something else")
        if not all(cell is None or isinstance(cell, str | bool | int | float) for cell in data):
            raise _OtherLayoutError(part, "texts, flags, numbers and None", "something else")
        return shape, data, by_column
    if not isinstance(data, memoryview) or len(data) != count * dtype.itemsize:
        raise _OtherLayoutError(part, f"{count * dtype.itemsize} bytes", "another number or something else")
    array = np.frombuffer(data, dtype=dtype) if count else np.zeros(0, dtype)
    if not count and max(shape, default=0) > MAX_FRAME_BYTES:  # a side that no value needs
        raise _OtherLayoutError(part, f"sides up to {MAX_FRAME_BYTES}", f"a shape of {shape}"[:80])
    if dtype.kind == "b" and (array.view(np.uint8) > 1).any():
        raise _OtherLayoutError(part, "flags", "bytes above 1")
    return array.reshape(shape, order="F" if by_column else "C")


def _dtype(value: Any, part: str) -> np.dtype | None:
    """A type of numbers; None for objects."""
    call = _call(value, {_DTYPE}, part, "a type of NumPy")
    name, state = call.arguments[0] if call.arguments else None, call.state
    if name == "O8":
        return None
    order = state[1] if isinstance(state, tuple) and len(state) >= 2 else None
    if not isinstance(name, str) or name not in _NUMBERS or order not in ("<", ">", "|"):
        raise _OtherLayoutError(part, "integers, floats, flags or objects", f"the type {str(name)[:40]!r}")
    return np.dtype(name).newbyteorder(order)
