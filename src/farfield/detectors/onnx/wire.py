"""An ONNX file checked without any library, and refused by name where it uses what no export of ours does.

ONNX is a protocol buffer (onnx.proto, field numbers below). Only what decides is read: operators, tensors, inputs,
outputs, metadata. Nothing is allocated on the word of the file, and no session is made of one that is refused.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from farfield.errors import FileFormatError

MAX_BYTES = 512 << 20
"""Of an ONNX file: weights of ours have 2 to 40 MB."""
MAX_NODES = 20_000
MAX_MADE = 1 << 29
"""Numbers of a tensor that an operator makes of a constant shape."""
LARGEST = 1e10
"""No weight is larger, as :data:`farfield.detectors.soundness.LARGEST`."""
OPERATORS = frozenset(
    [
        "Abs",
        "Add",
        "And",
        "ArgMax",
        "Atan",
        "BatchNormalization",
        "Cast",
        "CastLike",
        "Ceil",
        "Clip",
        "Concat",
        "Constant",
        "ConstantOfShape",
        "Conv",
        "Cos",
        "Div",
        "Equal",
        "Exp",
        "Expand",
        "Flatten",
        "Floor",
        "Gather",
        "GatherElements",
        "GatherND",
        "Gemm",
        "Greater",
        "GreaterOrEqual",
        "Identity",
        "IsNaN",
        "Less",
        "LessOrEqual",
        "Log",
        "MatMul",
        "Max",
        "Min",
        "Mod",
        "Mul",
        "Neg",
        "Not",
        "Or",
        "Pad",
        "Pow",
        "Range",
        "Reciprocal",
        "ReduceMax",
        "ReduceMean",
        "ReduceSum",
        "Relu",
        "Reshape",
        "Round",
        "ScatterElements",
        "ScatterND",
        "Shape",
        "Sigmoid",
        "Sign",
        "Sin",
        "Size",
        "Slice",
        "Softmax",
        "Split",
        "SplitToSequence",
        "Sqrt",
        "Squeeze",
        "Sub",
        "Sum",
        "Tan",
        "Tile",
        "TopK",
        "Transpose",
        "Unsqueeze",
        "Where",
        "Xor",
    ]
)
"""What exported networks are made of; others are refused."""
_NUMBERS = {1: "<f4", 2: "u1", 3: "i1", 4: "<u2", 5: "<i2", 6: "<i4", 7: "<i8", 9: "?", 10: "<f2", 11: "<f8", 13: "<u8"}
"""TensorProto.DataType: the types that are taken, as numpy names them."""
_MAX_DEPTH_BITS, _DOMAINS = 70, ("", "ai.onnx")


@dataclass(frozen=True)
class TensorSpec:
    """An input or output: its type as numpy names it, and its sides, None for those that vary."""

    dtype: str
    shape: tuple[int | None, ...]


@dataclass(frozen=True)
class OnnxContent:
    """What was read of a file.

    Args:
        metadata: Texts by name.
        inputs: What the network reads.
        outputs: What it gives.
        operators: Names of its operators.
        opset: Version of the standard operators.
    """

    metadata: Mapping[str, str]
    inputs: Mapping[str, TensorSpec]
    outputs: Mapping[str, TensorSpec]
    operators: frozenset[str]
    opset: int


class _DamagedError(ValueError):
    """A message that cannot be read; its words are those of the refusal."""

    def __init__(self, where: str, expected: str, got: str) -> None:
        self.where, self.expected, self.got = where, expected, got
        super().__init__(expected)


def read_content(path: Path, data: bytes) -> OnnxContent:
    """Read an ONNX file, and refuse what no export of ours holds.

    Args:
        path: Where it is from, for messages.
        data: All of it.

    Raises:
        FileFormatError: If it is none, or holds external data, an operator or domain that is not of the standard ones
            in :data:`OPERATORS`, a function, a graph in a graph, a tensor whose bytes do not suit its shape or whose
            numbers are not finite, or a shape that would take more than memory should give.
    """
    try:
        return _model(memoryview(data))
    except _DamagedError as error:
        fix = "Export the detector anew: farfield export DETECTOR OUT.onnx"
        raise FileFormatError(path, where=error.where, expected=error.expected, got=error.got, fix=fix) from error
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise FileFormatError(path, where="bytes", expected="an ONNX model", got=str(error)[:200]) from error


def _model(data: memoryview) -> OnnxContent:
    metadata: dict[str, str] = {}
    graphs: list[memoryview] = []
    opset = 0
    for number, value in _fields(data):
        if number == 7:
            graphs.append(_bytes(value))
        elif number == 8:
            entry = dict(_fields(_bytes(value)))
            domain = _text(entry.get(1, b""))
            if domain not in _DOMAINS:
                raise _DamagedError("operators", "those of ONNX alone", f"the domain {domain[:60]!r}")
            opset = max(opset, _int(entry.get(2, 0)))
        elif number == 14:
            entry = dict(_fields(_bytes(value)))
            metadata[_text(entry.get(1, b""))] = _text(entry.get(2, b""))
        elif number in (20, 25):
            raise _DamagedError("model", "a graph alone", "functions of its own" if number == 25 else "a training")
    if len(graphs) != 1:
        raise _DamagedError("model", "one graph", f"{len(graphs)}")
    return _graph(graphs[0], metadata, opset)


def _graph(data: memoryview, metadata: Mapping[str, str], opset: int) -> OnnxContent:
    inputs: dict[str, TensorSpec] = {}
    outputs: dict[str, TensorSpec] = {}
    constants: dict[str, np.ndarray] = {}
    nodes: list[memoryview] = []
    for number, value in _fields(data):
        if number == 1:
            nodes.append(_bytes(value))
        elif number == 5:
            name, array = _tensor(_bytes(value))
            constants[name] = array
        elif number in (11, 12):
            name, spec = _value(_bytes(value))
            (inputs if number == 11 else outputs)[name] = spec
        elif number == 15:
            raise _DamagedError("graph", "dense tensors", "a sparse one")
    if len(nodes) > MAX_NODES:
        raise _DamagedError("graph", f"at most {MAX_NODES:,} operators", f"{len(nodes):,}")
    operators = frozenset(_node(node, constants) for node in nodes)
    return OnnxContent(metadata, inputs, outputs, operators, opset)


def _node(data: memoryview, constants: dict[str, np.ndarray]) -> str:
    """Its operator; a Constant's value is noted among the constants."""
    names: list[str] = []
    results: list[str] = []
    kind, attributes = "", list[memoryview]()
    for number, value in _fields(data):
        if number == 1:
            names.append(_text(value))
        elif number == 2:
            results.append(_text(value))
        elif number == 4:
            kind = _text(value)
        elif number == 5:
            attributes.append(_bytes(value))
        elif number == 7 and _text(value) not in _DOMAINS:
            raise _DamagedError("operators", "those of ONNX alone", f"one of the domain {_text(value)[:60]!r}")
    if kind not in OPERATORS:
        raise _DamagedError("operators", "those that an export is made of", f"{kind[:60]!r}")
    for attribute in attributes:
        for number, value in _fields(attribute):
            if number in (6, 11):
                raise _DamagedError(f"operator {kind}", "no graph within", "one")
            if number in (22, 23):
                raise _DamagedError(f"operator {kind}", "dense tensors", "a sparse one")
            if number in (5, 10):
                _, array = _tensor(_bytes(value))
                if kind == "Constant" and results:
                    constants[results[0]] = array
    where = _SHAPED.get(kind, len(names))
    shape = constants.get(names[where]) if where < len(names) else None
    if shape is not None and shape.dtype.kind == "i" and shape.size <= 64:
        numbers = math.prod(abs(int(side)) for side in shape.reshape(-1).tolist() if side)
        if numbers > MAX_MADE:
            raise _DamagedError(f"operator {kind}", f"a tensor of at most {MAX_MADE:,} numbers", f"{numbers:,}")
    return kind


_SHAPED = {"ConstantOfShape": 0, "Expand": 1, "Tile": 1, "Reshape": 1}
"""Operators that make a tensor of a shape, and which of their inputs says it."""


def _tensor(data: memoryview) -> tuple[str, np.ndarray]:
    """Name and numbers; of what is not needed for the checks, a view of the file."""
    dims: list[int] = []
    kind, name = 0, ""
    raw: memoryview | None = None
    typed: list[tuple[int, int | memoryview]] = []
    for number, value in _fields(data):
        if number == 1:
            dims += _ints(value)
        elif number == 2:
            kind = _int(value)
        elif number in (4, 5, 7, 10, 11):
            typed.append((number, value))
        elif number == 8:
            name = _text(value)
        elif number == 9:
            raw = _bytes(value)
        elif number == 13 or (number == 14 and _int(value)):
            raise _DamagedError(f"tensor {name[:80]!r}", "numbers in this file", "external data, in another file")
        elif number == 6:
            raise _DamagedError(f"tensor {name[:80]!r}", "numbers", "texts")
    where = f"tensor {name[:80]!r}"
    if kind not in _NUMBERS:
        raise _DamagedError(where, "a number type that exports use", f"type {kind}")
    if len(dims) > 16 or any(not 0 <= side < 1 << 40 for side in dims):
        raise _DamagedError(where, "up to 16 sides of possible lengths", f"{dims[:16]}")
    size, item = math.prod(dims), np.dtype(_NUMBERS[kind])
    if raw is None:
        array = _typed(typed, item, size, where)
    elif len(raw) != size * item.itemsize:
        raise _DamagedError(where, f"{size * item.itemsize:,} bytes for its shape {tuple(dims)}", f"{len(raw):,}")
    else:
        array = np.frombuffer(raw, item)
    if item.kind == "f" and array.size:
        odd = ~(np.abs(array) <= LARGEST)
        if odd.any():
            shown = f"{float(array[odd][0]):g} in {int(odd.sum())} of {array.size}"
            raise _DamagedError(where, "numbers as a training leaves them", shown)
    return name, array


def _typed(parts: list[tuple[int, int | memoryview]], item: np.dtype, size: int, where: str) -> np.ndarray:
    """Numbers of the fields float_data, int32_data, int64_data, double_data and uint64_data."""
    values: list[float] = []
    for number, value in parts:
        if number in (4, 10) and isinstance(value, memoryview):
            values += np.frombuffer(value, "<f4" if number == 4 else "<f8").tolist()
        elif number in (4, 10):
            raise _DamagedError(where, "packed numbers", "single ones")
        else:
            values += _ints(value)
        if len(values) > size:
            break
    if len(values) != size:
        raise _DamagedError(where, f"{size:,} numbers for its shape", f"{len(values):,}")
    return np.array(values).astype(item)


def _value(data: memoryview) -> tuple[str, TensorSpec]:
    """Name, type and sides of an input or output."""
    entry = dict(_fields(data))
    name = _text(entry.get(1, b""))
    tensor = dict(_fields(_bytes(entry.get(2, b"")))).get(1)
    if tensor is None:
        raise _DamagedError(f"input or output {name[:80]!r}", "a tensor", "something else")
    parts = dict(_fields(_bytes(tensor)))
    shape: list[int | None] = []
    for number, value in _fields(_bytes(parts.get(2, b""))):
        if number == 1:
            side = dict(_fields(_bytes(value))).get(1)
            shape.append(None if side is None else _int(side))
    return name, TensorSpec(_NUMBERS.get(_int(parts.get(1, 0)), "unknown"), tuple(shape))


# Protocol buffers: a message is a row of fields, each a number, a wire type and a value.


def _fields(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    position, end = 0, len(data)
    while position < end:
        tag, position = _varint(data, position)
        wire = tag & 7
        if wire == 0:
            value, position = _varint(data, position)
            yield tag >> 3, value
            continue
        if wire == 2:
            length, position = _varint(data, position)
        elif wire in (1, 5):
            length = 8 if wire == 1 else 4
        else:
            raise ValueError(f"a field of wire type {wire}")
        if length > end - position:
            raise ValueError(f"a field of {length:,} bytes where {end - position:,} are left")
        yield tag >> 3, data[position : position + length]
        position += length


def _varint(data: memoryview, position: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, _MAX_DEPTH_BITS, 7):
        if position >= len(data):
            raise ValueError("an end within a number")
        byte = data[position]
        position += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, position
    raise ValueError("a number without an end")


def _ints(value: int | memoryview) -> list[int]:
    """Whole numbers, packed or single, with their sign."""
    if isinstance(value, int):
        return [_signed(value)]
    numbers, position = [], 0
    while position < len(value):
        number, position = _varint(value, position)
        numbers.append(_signed(number))
    return numbers


def _signed(value: int) -> int:
    return value - (1 << 64) if value >= 1 << 63 else value


def _int(value: int | memoryview) -> int:
    if not isinstance(value, int):
        raise ValueError("bytes where a number should stand")
    return _signed(value)


def _bytes(value: int | memoryview | bytes) -> memoryview:
    if isinstance(value, int):
        raise ValueError("a number where bytes should stand")
    return memoryview(value)


def _text(value: int | memoryview | bytes) -> str:
    return bytes(_bytes(value)).decode("utf-8")
