"""Networks that run and give other shapes than their record says: refused by name, not read as boxes."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnxruntime")

from onnx_bytes import RECORD, field, model, node, tensor

from farfield.detectors.onnx.detector import OnnxDetector
from farfield.errors import FarfieldError, FileFormatError
from farfield.frame import Cloud

_BOX = np.array([[10.0, 0.0, -1.0, 4.0, 2.0, 1.5, 0.3]], dtype=np.float32)
SOUND: Mapping[str, np.ndarray] = {
    "boxes": _BOX,
    "scores": np.array([0.9], dtype=np.float32),
    "labels": np.array([0], dtype=np.int64),
}
CLOUD = Cloud(np.array([[10.0, 0.0, -1.0]], dtype=np.float32))


def constant(path: Path, outputs: Mapping[str, np.ndarray], record: object = RECORD) -> OnnxDetector:
    """A network that always gives the same."""
    kinds = {"f": 1, "i": 7}
    data = model(
        nodes=tuple(node("Identity", [f"own_{name}"], [name]) for name in outputs),
        tensors=tuple(tensor(f"own_{name}", values) for name, values in outputs.items()),
        outputs={name: (kinds[values.dtype.kind], values.shape) for name, values in outputs.items()},
        record=record,
        graph=field(2, "constant"),
    )
    path.write_bytes(data)
    return OnnxDetector(path)


def test_a_network_that_gives_what_it_says_runs(tmp_path: Path) -> None:
    boxes = constant(tmp_path / "net.onnx", SOUND)(CLOUD)
    assert np.allclose(np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]), _BOX)
    assert list(boxes.label) == ["vehicle"]


ODD: dict[str, tuple[dict[str, np.ndarray], str]] = {
    "boxes without a heading": ({"boxes": _BOX[:, :6]}, r"output boxes.*\(n, 7\).*float32 of \(1, 6\)"),
    "one box without its row": ({"boxes": _BOX[0]}, r"output boxes.*\(7,\)"),
    "fewer scores than boxes": ({"boxes": np.repeat(_BOX, 2, axis=0)}, r"output scores.*\(2\).*\(1,\)"),
    "a score of every class": ({"scores": np.ones((1, 3), np.float32)}, r"output scores.*\(1, 3\)"),
    "a single score": ({"scores": np.float32(0.9).reshape(())}, r"output scores.*\(\)"),
    "labels as numbers": ({"labels": np.zeros(1, np.float32)}, r"output labels.*integers.*float32"),
    "no labels of boxes": ({"labels": np.zeros(0, np.int64)}, r"output labels.*\(0,\)"),
}


@pytest.mark.parametrize("name", ODD)
def test_other_shapes_are_refused_by_name(tmp_path: Path, name: str) -> None:
    outputs, words = ODD[name]
    detector = constant(tmp_path / "net.onnx", {**SOUND, **outputs})
    with pytest.raises(FileFormatError, match=rf"(?s)net\.onnx.*{words}"):
        detector(CLOUD)


def test_a_class_too_few_in_the_record_is_no_other_class(tmp_path: Path) -> None:
    detector = constant(tmp_path / "net.onnx", {**SOUND, "labels": np.array([1], dtype=np.int64)})
    with pytest.raises(FarfieldError, match=r"net\.onnx.*of its classes"):
        detector(CLOUD)
