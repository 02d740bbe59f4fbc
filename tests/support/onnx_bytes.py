"""ONNX files by hand, as protocol buffers: what no export writes, without the package onnx."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

READING: dict[str, Any] = {
    "kind": "pillars",
    "columns": ["x_m", "y_m", "z_m"],
    "grid": {"range_m": 64.0, "half_width_m": 20.0, "cell_m": 0.5},
    "multiple": 8,
    "features": "farfield",
    "positions": "absolute",
}
RECORD: dict[str, Any] = {
    "format": "farfield-onnx-1",
    "farfield": "0",
    "name": "mine",
    "detector": "pointpillars",
    "network": "PointPillars",
    "classes": ["vehicle"],
    "units": {"x_m": "metres forward"},
    "reach_m": 64.0,
    "score_threshold": 0.1,
    "nms_iou": 0.1,
    "max_boxes": 100,
    "weights_sha256": "0" * 64,
    "opset": 20,
    "reading": READING,
}
INPUTS = {"points": (1, (None, 9)), "pillar": (7, (None,)), "cell": (7, (None,))}
OUTPUTS = {"boxes": (1, (None, 7)), "scores": (1, (None,)), "labels": (7, (None,))}


def varint(number: int) -> bytes:
    """A whole number as protocol buffers write it."""
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def field(number: int, value: int | str | bytes) -> bytes:
    """One field of a message."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tensor(name: str, values: np.ndarray, *, dims: tuple[int, ...] | None = None, more: bytes = b"") -> bytes:
    """A TensorProto."""
    kind = {"f": 1, "i": 7}[values.dtype.kind]
    sides = b"".join(field(1, side) for side in (values.shape if dims is None else dims))
    return sides + field(2, kind) + field(8, name) + field(9, values.tobytes()) + more


def node(kind: str, inputs: list[str], outputs: list[str], *, domain: str = "", more: bytes = b"") -> bytes:
    """A NodeProto."""
    names = b"".join(field(1, name) for name in inputs) + b"".join(field(2, name) for name in outputs)
    return names + field(4, kind) + (field(7, domain) if domain else b"") + more


def _value(name: str, kind: int, shape: tuple[int | None, ...]) -> bytes:
    sides = b"".join(field(1, field(2, "n") if side is None else field(1, side)) for side in shape)
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, sides)))


def model(
    *,
    nodes: tuple[bytes, ...] = (),
    tensors: tuple[bytes, ...] = (),
    inputs: Mapping[str, Any] = INPUTS,
    outputs: Mapping[str, Any] = OUTPUTS,
    record: Any = RECORD,
    domains: tuple[str, ...] = ("",),
    more: bytes = b"",
    graph: bytes = b"",
) -> bytes:
    """A ModelProto; ``record`` None leaves the metadata out, ``graph`` holds more fields of the graph."""
    graph += b"".join(field(1, part) for part in nodes) + b"".join(field(5, part) for part in tensors)
    graph += b"".join(field(11, _value(name, *spec)) for name, spec in inputs.items())
    graph += b"".join(field(12, _value(name, *spec)) for name, spec in outputs.items())
    out = field(1, 10) + field(7, graph)
    out += b"".join(field(8, field(1, domain) + field(2, 20)) for domain in domains)
    if record is not None:
        text = record if isinstance(record, str) else json.dumps(record)
        out += field(14, field(1, "farfield") + field(2, text))
    return out + more
