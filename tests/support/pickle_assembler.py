"""Pickles put together op-code by op-code, after the standard library's ``pickletools``; nothing is pickled."""

import gzip
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


class Raw(NamedTuple):
    """Op-codes that leave one value on the stack."""

    code: bytes


def value(item: Any) -> bytes:
    """Op-codes of a value."""
    if isinstance(item, Raw):
        return item.code
    if item is None or isinstance(item, bool):
        return {None: b"N", True: b"\x88", False: b"\x89"}[item]
    if isinstance(item, int):
        return b"J" + struct.pack("<i", item) if abs(item) < 1 << 31 else b"\x8a\x08" + struct.pack("<q", item)
    if isinstance(item, float):
        return b"G" + struct.pack(">d", item)
    if isinstance(item, str):
        return b"X" + struct.pack("<I", len(item.encode())) + item.encode()
    if isinstance(item, bytes):
        return b"B" + struct.pack("<I", len(item)) + item
    if isinstance(item, Mapping):
        return b"}(" + b"".join(value(key) + value(entry) for key, entry in item.items()) + b"u"
    entries = b"(" + b"".join(value(entry) for entry in item)
    return entries + b"t" if isinstance(item, tuple) else b"]" + entries + b"e"


def name(module: str, attribute: str) -> Raw:
    """A name of a function or class."""
    return Raw(value(module) + value(attribute) + b"\x93")


def call(called: Raw, *arguments: Any, state: Any = None) -> Raw:
    """A call, and what is set on the result."""
    built = b"" if state is None else value(state) + b"b"
    return Raw(called.code + value(tuple(arguments)) + b"R" + built)


def stream(item: Any, protocol: int = 4) -> bytes:
    """A whole pickle of a value."""
    return b"\x80" + bytes([protocol]) + value(item) + b"."


def array(values: np.ndarray | Sequence[Any]) -> Raw:
    """An array of NumPy as its ``__reduce__`` describes it; a list of objects becomes one row."""
    if isinstance(values, np.ndarray):
        shape, kind, data = values.shape, values.dtype.str[1:], np.ascontiguousarray(values).tobytes()
        order = values.dtype.str[0]
    else:
        shape, kind, data, order = (len(values),), "O8", list(values), "|"
    dtype = call(name("numpy", "dtype"), kind, False, True, state=(3, order, None, None, None, -1, -1, 0))
    made = call(name("numpy.core.multiarray", "_reconstruct"), name("numpy", "ndarray"), (0,), b"b")
    return Raw(made.code + value((1, tuple(shape), dtype, False, data)) + b"b")


def _cells(column: Sequence[Any] | np.ndarray) -> Raw:
    """One column as a block's values: one line of them."""
    if isinstance(column, np.ndarray):
        return array(column[None])
    flat = array(column).code
    return Raw(flat.replace(value((len(column),)), value((1, len(column))), 1))


def data_frame(columns: Mapping[str, Sequence[Any] | np.ndarray], *, rows: int | None = None) -> bytes:
    """A pickle of a data frame in the layout of pandas 1.0, a block a column."""
    count = len(next(iter(columns.values()))) if rows is None else rows
    new_index = name("pandas.core.indexes.base", "_new_Index")
    names = call(new_index, name("pandas.core.indexes.base", "Index"), {"data": array(list(columns)), "name": None})
    bounds = {"name": "index", "start": 0, "stop": count, "step": 1}
    lines = call(new_index, name("pandas.core.indexes.range", "RangeIndex"), bounds)
    blocks = [
        {"values": _cells(column), "mgr_locs": call(name("builtins", "slice"), place, place + 1, 1)}
        for place, column in enumerate(columns.values())
    ]
    state = ([names, lines], [], [], {"0.14.1": {"axes": [names, lines], "blocks": blocks}})
    manager = call(name("pandas.core.internals.managers", "BlockManager"), state=state)
    return stream(call(name("pandas.core.frame", "DataFrame"), state={"_data": manager, "_typ": "dataframe"}))


def packed(columns: Mapping[str, Sequence[Any] | np.ndarray]) -> bytes:
    """The same in a gzip file."""
    return gzip.compress(data_frame(columns), mtime=0)
