"""Damaged ONNX files: each is refused by name, before a session is made of it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx_bytes import INPUTS, OUTPUTS, READING, RECORD, field, model, node, tensor

from farfield.detectors.onnx import detector as onnx_detector
from farfield.detectors.onnx.detector import OnnxDetector
from farfield.errors import FarfieldError, FileFormatError

_WEIGHT = np.ones((2, 3), dtype=np.float32)
_EXTERNAL = field(13, field(1, "location") + field(2, "../../etc/passwd")) + field(14, 1)
_LOOP = field(5, field(1, "body") + field(6, field(1, node("Relu", ["a"], ["b"]))))
_SHAPE = tensor("shape", np.array([1 << 20, 1 << 20], dtype=np.int64))

DAMAGED: dict[str, tuple[bytes, str]] = {
    "external data": (model(tensors=(tensor("w", _WEIGHT, more=_EXTERNAL),)), "tensor 'w'.*external data"),
    "a custom domain": (model(domains=("", "com.example")), "domain 'com.example'"),
    "an operator of a domain": (model(nodes=(node("Relu", [], ["b"], domain="x"),)), "domain 'x'"),
    "a custom operator": (model(nodes=(node("ReadFile", [], ["b"]),)), "'ReadFile'"),
    "a graph in a graph": (model(nodes=(node("Identity", ["a"], ["b"], more=_LOOP),)), "graph within"),
    "functions": (model(more=field(25, b"")), "functions"),
    "NaN": (model(tensors=(tensor("w", np.full((2, 3), np.nan, np.float32)),)), "tensor 'w'.*nan in 6 of 6"),
    "a flipped exponent": (model(tensors=(tensor("w", _WEIGHT * np.float32(1e36)),)), "tensor 'w'.*as a training"),
    "a shape without its numbers": (model(tensors=(tensor("w", _WEIGHT, dims=(200, 300)),)), "240,000 bytes"),
    "an endless shape": (model(tensors=(tensor("w", _WEIGHT, dims=(1 << 50,)),)), "sides of possible lengths"),
    "huge memory": (
        model(nodes=(node("ConstantOfShape", ["shape"], ["b"]),), tensors=(_SHAPE,)),
        "ConstantOfShape.*at most 536,870,912",
    ),
    "no metadata": (model(record=None), "metadata: expected those that farfield export writes"),
    "other metadata": (model(record={**RECORD, "format": "other-1"}), "metadata.*farfield-onnx-1"),
    "torn metadata": (model(record=json.dumps(RECORD)[:-40]), "metadata"),
    "a record of another kind": (model(record={**RECORD, "reading": {**READING, "kind": "what"}}), "metadata"),
    "an endless grid": (
        model(record={**RECORD, "reading": {**READING, "grid": {**READING["grid"], "cell_m": 1e-6}}}),
        "metadata.*cell_m",
    ),
    "another input": (model(inputs={**INPUTS, "points": (1, (None, 5))}), "input points.*9"),
    "an input of a fixed size": (model(inputs={**INPUTS, "cell": (7, (12,))}), "input cell"),
    "an input of another type": (model(inputs={**INPUTS, "pillar": (1, (None,))}), "input pillar"),
    "an output that is missing": (model(outputs={"boxes": OUTPUTS["boxes"]}), "outputs.*no scores"),
    "half a file": (model()[: len(model()) // 2], "bytes"),
    "text": (b"this is no model at all", "bytes|model"),
    "nothing": (b"", "one graph"),
}


@pytest.fixture(autouse=True)
def no_session(monkeypatch: pytest.MonkeyPatch) -> None:
    """Making a session fails the test."""

    def refuse(*_: Any) -> None:
        raise AssertionError("a session was made")

    monkeypatch.setattr(onnx_detector, "_session", refuse)


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, damage: str) -> None:
    data, words = DAMAGED[damage]
    path = tmp_path / "net.onnx"
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=rf"(?s)net\.onnx.*({words})"):
        OnnxDetector(path)


def test_what_is_not_damaged_comes_to_its_session(tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    path.write_bytes(model(nodes=(node("Relu", ["points"], ["boxes"]),), tensors=(tensor("w", _WEIGHT),)))
    with pytest.raises(AssertionError, match="a session was made"):
        OnnxDetector(path)


def test_a_file_beyond_the_limit_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "net.onnx"
    path.write_bytes(model())
    monkeypatch.setattr(onnx_detector, "MAX_BYTES", 100)
    with pytest.raises(FarfieldError, match=r"net\.onnx"):
        OnnxDetector(path)


def test_each_cut_of_a_file_is_refused_or_read(tmp_path: Path) -> None:
    whole, path = model(tensors=(tensor("w", _WEIGHT),)), tmp_path / "net.onnx"
    for end in range(0, len(whole), 7):
        path.write_bytes(whole[:end])
        with pytest.raises((FileFormatError, AssertionError)):
            OnnxDetector(path)
