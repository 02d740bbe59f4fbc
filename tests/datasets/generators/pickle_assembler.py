"""Pickles of pandas' frames put together opcode by opcode: pandas is needed neither to write nor to read them.

Layouts as pandas 1.0, 1.5 and 2.2 write them (read by pandas 2.2.3 itself when this was written).
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Global:
    """Something that a pickle names."""

    module: str
    name: str


@dataclass(frozen=True)
class Call:
    """A call of a global, and what the result is then built with."""

    function: Global
    arguments: tuple[Any, ...]
    state: Any = None
    new: bool = False


def assemble(value: Any, protocol: int = 4) -> bytes:
    """A whole pickle, framed, with names and texts that are remembered, as Python's own pickler makes it."""
    body = _Parts({}).part(value) + b"."
    return b"\x80" + bytes([protocol]) + b"\x95" + struct.pack("<Q", len(body)) + body


@dataclass
class _Parts:
    """What was put onto the stack before, by its number."""

    numbers: dict[Any, int]

    def part(self, value: Any) -> bytes:
        """The opcodes that put one value onto the stack."""
        if isinstance(value, str | Global):
            return self.named(value)
        if isinstance(value, tuple):
            return b"(" + b"".join([self.part(entry) for entry in value]) + b"t"
        if isinstance(value, list):
            return b"](" + b"".join([self.part(entry) for entry in value]) + b"e"
        if isinstance(value, Mapping):
            return b"}(" + b"".join([self.part(key) + self.part(entry) for key, entry in value.items()]) + b"u"
        if isinstance(value, Call):
            made = self.part(value.function) + self.part(value.arguments) + (b"\x81" if value.new else b"R")
            return made if value.state is None else made + self.part(value.state) + b"b"
        return plain(value)

    def named(self, value: str | Global) -> bytes:
        """A text or a name, by its number where it stood there before."""
        if value in self.numbers:
            number = self.numbers[value]
            return b"h" + bytes([number]) if number < 256 else b"j" + struct.pack("<I", number)
        if isinstance(value, Global):
            made = self.part(value.module) + self.part(value.name) + b"\x93"
        else:
            text = value.encode()
            made = b"\x8c" + bytes([len(text)]) if len(text) < 256 else b"X" + struct.pack("<I", len(text))
            made += text
        self.numbers[value] = len(self.numbers)
        return made + b"\x94"


def plain(value: Any) -> bytes:
    """Numbers and bytes."""
    if value is None or isinstance(value, bool):
        return {None: b"N", True: b"\x88", False: b"\x89"}[value]
    if isinstance(value, int | np.integer):
        return b"J" + struct.pack("<i", value) if -(2**31) <= value < 2**31 else b"\x8a\x08" + struct.pack("<q", value)
    if isinstance(value, float | np.floating):
        return b"G" + struct.pack(">d", value)
    if isinstance(value, bytearray):
        return b"\x96" + struct.pack("<Q", len(value)) + value
    assert isinstance(value, bytes)
    return b"B" + struct.pack("<I", len(value)) + value


def array(values: np.ndarray, core: str, *, buffers: bool) -> Call:
    """An array: by ``_reconstruct`` and a state, or where buffers are used (protocol 5) by ``_frombuffer``."""
    dtype = values.dtype
    numpy_dtype = Call(
        Global("numpy", "dtype"),
        ("O8" if dtype.kind == "O" else dtype.str[1:], False, True),
        (3, "|" if dtype.kind in "Ob" else "<", None, None, None, -1, -1, 63 if dtype.kind == "O" else 0),
    )
    if buffers and dtype.kind != "O":
        arguments = (bytearray(values.tobytes()), numpy_dtype, values.shape, "C")
        return Call(Global(f"{core}.numeric", "_frombuffer"), arguments)
    content: Any = values.ravel().tolist() if dtype.kind == "O" else values.tobytes()
    return Call(
        Global(f"{core}.multiarray", "_reconstruct"),
        (Global("numpy", "ndarray"), (0,), b"b"),
        (1, values.shape, numpy_dtype, False, content),
    )


def frame_pickle(columns: Mapping[str, np.ndarray], version: str) -> bytes:
    """A data frame as a version of pandas writes it: ``1.0``, ``1.5`` or ``2.2``.

    Args:
        columns: By name; texts as object arrays.
        version: Of pandas.
    """
    buffers = version != "1.0"
    core = "numpy._core" if version == "2.2" else "numpy.core"
    names = list(columns)
    blocks = []
    for kind in ("f", "i", "b", "O"):
        rows = [row for row, name in enumerate(names) if columns[name].dtype.kind == kind]
        if rows:
            stacked = np.stack([columns[names[row]] for row in rows])
            blocks.append((array(stacked, core, buffers=buffers), placement(rows, core, buffers=buffers)))
    count = len(next(iter(columns.values())))
    new_index = Global("pandas.core.indexes.base", "_new_Index")
    texts = np.empty(len(names), object)
    texts[:] = names
    items = Call(
        new_index,
        (
            Global("pandas.core.indexes.base", "Index"),
            {"data": array(texts, core, buffers=buffers), "name": None},
        ),
    )
    span = {"name": None, "start": 0, "stop": count, "step": 1}
    rows_index = Call(new_index, (Global("pandas.core.indexes.range", "RangeIndex"), span))
    axes = [items, rows_index]
    manager_class = Global("pandas.core.internals.managers", "BlockManager")
    if version == "1.0":
        listed = [{"values": values, "mgr_locs": where} for values, where in blocks]
        state = (
            axes,
            [values for values, _ in blocks],
            [items] * len(blocks),
            {"0.14.1": {"axes": axes, "blocks": listed}},
        )
        manager = Call(manager_class, (), state, new=True)
        attributes: dict[str, Any] = {"_data": manager, "_typ": "dataframe", "_metadata": [], "attrs": {}}
    else:
        unpickle = Global("pandas._libs.internals", "_unpickle_block")
        made = tuple(Call(unpickle, (values, where, 2)) for values, where in blocks)
        manager = Call(manager_class, (made, axes))
        attributes = {"_mgr": manager, "_typ": "dataframe", "_metadata": [], "attrs": {}}
        attributes["_flags"] = {"allows_duplicate_labels": True}
    frame = Call(Global("pandas.core.frame", "DataFrame"), (), attributes, new=True)
    return assemble(frame, 5 if buffers else 4)


def placement(rows: Sequence[int], core: str, *, buffers: bool) -> Any:
    """Where a block's rows stand: a slice where they lie in a row, else an array."""
    steps = set(np.diff(rows).tolist()) or {1}
    if len(steps) == 1:
        step = steps.pop()
        return Call(Global("builtins", "slice"), (rows[0], rows[-1] + step, step))
    return array(np.array(rows, dtype=np.int64), core, buffers=buffers)


HOSTILE = assemble(Call(Global("os", "system"), ("touch farfield-was-here",)))
"""A pickle that would run a command."""
