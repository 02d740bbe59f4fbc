"""Exported detectors: parity with the network, the same detector to every caller, and no torch where it runs."""

import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxscript")
onnxruntime = pytest.importorskip("onnxruntime")

from exporting import NO_TORCH
from small import SMALL

import farfield as ff
from farfield.detectors.exporting import writing
from farfield.detectors.exporting.parity import PARITY, SAME_SHARE, CloudParity, same_share
from farfield.detectors.onnx.detector import OnnxDetector
from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError, FarfieldError
from farfield.frame import Frame

pytestmark = pytest.mark.slow
Trained = Callable[[str], Any]


def loaded(trained: Trained, name: str) -> Detector:
    """The small detector that knows the scene by heart."""
    return Detector(trained(name), precision="fp32", device="cpu", score_threshold=0.2, name=f"small-{name}")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Detector], writing.OnnxExport]:
    """Exports a detector, each once."""
    folder, done = tmp_path_factory.mktemp("exported"), {}

    def export(detector: Detector) -> writing.OnnxExport:
        if detector.name not in done:
            done[detector.name] = ff.export(detector, folder / f"{detector.name}.onnx", licence="CC0")
        return done[detector.name]

    return export


@pytest.mark.parametrize("name", SMALL)
def test_file_and_network_agree_on_five_clouds(
    trained: Trained, exported: Callable[[Detector], writing.OnnxExport], scene: Frame, name: str
) -> None:
    detector = loaded(trained, name)
    done = exported(detector)
    assert [row.cloud for row in done.parity] == ["empty", "one point", "usual", "full", "another range"]
    assert all(row.holds and row.largest <= PARITY for row in done.parity)
    other = ff.load_detector(done.path)
    expected, got = detector(scene.cloud()), other(scene.cloud())
    assert len(expected) >= 4
    assert same_share(expected, got) >= SAME_SHARE
    card = done.card.read_text("utf-8")
    assert all(word in card for word in ("CC0", "x forward", "another range", "What runs where", *detector.class_names))


def test_an_exported_detector_is_one_like_any_other(
    trained: Trained, exported: Callable[[Detector], writing.OnnxExport], scene: Frame
) -> None:
    detector = loaded(trained, "pointpillars")
    other = ff.load_detector(exported(detector).path, score_threshold=0.4, classes={"vehicle": "car"})
    assert isinstance(other, OnnxDetector)
    assert (other.info.reach_m, other.info.columns) == (detector.info.reach_m, detector.info.columns)
    boxes = other(scene)
    assert len(boxes)
    assert set(boxes.label) == {"car"}
    assert boxes.score is not None
    assert boxes.score.min() >= 0.4
    again = pickle.loads(pickle.dumps(other))
    assert same_share(boxes, again(scene)) == 1.0
    assert again.digest() == other.digest() != ff.load_detector(exported(detector).path).digest()
    assert other.with_cloud("lidar").cloud == "lidar"
    assert ff.evaluate(ff.load_detector(exported(detector).path), [scene], label="vehicle").to_json()
    assert [len(found) for found in ff.stream(other, [scene, scene])] == [len(boxes)] * 2
    with pytest.raises(ConfigError, match="fp32"):
        ff.load_detector(exported(detector).path, precision="bf16")


def test_a_file_that_does_not_agree_is_not_left(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "compared", lambda name, *_: CloudParity(name, 1, 0.1, 3, 0.5))
    with pytest.raises(FarfieldError, match=r"another range: 1\.0e-01, 50\.00% of 3 boxes.*Nothing was written"):
        ff.export(loaded(trained, "pointpillars"), tmp_path / "a.onnx")
    assert not list(tmp_path.iterdir())


def test_verbs_run_it_without_torch(
    trained: Trained, exported: Callable[[Detector], writing.OnnxExport], scene: Frame, tmp_path: Path
) -> None:
    path = exported(loaded(trained, "pointpillars")).path
    cloud = scene.cloud()
    np.save(tmp_path / "scan.npy", np.column_stack([cloud.points_m, cloud.column("intensity")]))
    words = ["predict", str(path), str(tmp_path / "scan.npy"), "--out", str(tmp_path / "boxes.csv")]
    done = subprocess.run([sys.executable, "-c", NO_TORCH, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = (tmp_path / "boxes.csv").read_text("utf-8").splitlines()
    assert len(rows) == 1 + len(ff.load_detector(path)(cloud))


def test_the_example_gives_the_boxes_of_the_library(
    trained: Trained, exported: Callable[[Detector], writing.OnnxExport], scene: Frame, tmp_path: Path
) -> None:
    example = Path(__file__).resolve().parents[2] / "examples" / "deploy" / "detect.py"
    path, cloud = exported(loaded(trained, "pointpillars")).path, scene.cloud()
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    header += f"WIDTH {len(cloud)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(cloud)}\nDATA binary\n"
    scan = tmp_path / "scan.pcd"
    scan.write_bytes(header.encode() + np.ascontiguousarray(cloud.points_m, dtype="<f4").tobytes())
    block = "import runpy, sys\nfor name in ('torch', 'farfield', 'scipy'):\n    sys.modules[name] = None\n"
    code = f"{block}sys.argv = sys.argv[1:]\nrunpy.run_path(sys.argv[0], run_name='__main__')"
    words = [sys.executable, "-c", code, str(example), str(path), str(scan)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line.split(",") for line in done.stdout.splitlines()[1:]]
    expected = ff.load_detector(path)(cloud)
    assert [row[0] for row in rows] == list(expected.label)
    numbers = np.array([list(map(float, row[1:])) for row in rows])
    stated = np.column_stack([expected.score, expected.centre_m, expected.size_m, expected.yaw_rad])
    assert np.allclose(numbers, stated, atol=2e-4)


def test_metadata_hold_what_a_deployer_needs(
    trained: Trained, exported: Callable[[Detector], writing.OnnxExport]
) -> None:
    session = onnxruntime.InferenceSession(str(exported(loaded(trained, "pointpillars")).path))
    record = json.loads(session.get_modelmeta().custom_metadata_map["farfield"])
    needed = {"classes", "axes", "boxes", "units", "score_threshold", "nms_iou", "reach_m", "licence", "weights_sha256"}
    assert needed <= record.keys()
    assert record["units"]["x_m"] == "metres forward"


def damaged(data: bytes) -> dict[str, tuple[bytes, str]]:
    """Ten damages of an exported file, and what names each."""
    import onnx
    from onnx import helper, numpy_helper

    def changed(change: Callable[[Any], object]) -> bytes:
        model = onnx.load_model_from_string(data)
        change(model)
        return bytes(model.SerializeToString())

    def weight(model: Any) -> Any:
        return max(model.graph.initializer, key=lambda tensor: len(tensor.raw_data))

    def elsewhere(model: Any) -> None:
        tensor = weight(model)
        onnx.external_data_helper.set_external_data(tensor, "../../etc/passwd")
        tensor.ClearField("raw_data")

    def filled(model: Any, value: float) -> None:
        tensor = weight(model)
        values = numpy_helper.to_array(tensor).copy()
        values.flat[0] = value
        tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))

    def narrower(model: Any) -> None:
        tensor = weight(model)
        tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor)[:-1].copy(), tensor.name))

    def recorded(model: Any, **changes: Any) -> None:
        (entry,) = [entry for entry in model.metadata_props if entry.key == "farfield"]
        entry.value = json.dumps(json.loads(entry.value) | changes)

    def first_side(model: Any) -> Any:
        return model.graph.input[0].type.tensor_type.shape.dim[0]

    foreign = helper.make_node("Read", [], ["b"], domain="com.example")
    return {
        "external data": (changed(elsewhere), "external data"),
        "an operator of a domain": (changed(lambda model: model.graph.node.append(foreign)), "com.example"),
        "a custom operator": (
            changed(lambda model: model.graph.node.append(helper.make_node("Read", [], ["b"]))),
            "Read",
        ),
        "no metadata": (changed(lambda model: model.ClearField("metadata_props")), "metadata"),
        "metadata of another format": (changed(lambda model: recorded(model, format="other-9")), "metadata.*other-9"),
        "metadata of another detector": (changed(lambda model: recorded(model, reading={"kind": "what"})), "metadata"),
        "not a number": (changed(lambda model: filled(model, np.nan)), "nan in 1 of"),
        "beyond all weights": (changed(lambda model: filled(model, 1e30)), "1e\\+30 in 1 of"),
        "a weight of another shape": (changed(narrower), "a network that runs|does not run"),
        "an input of a fixed size": (changed(lambda model: setattr(first_side(model), "dim_value", 7)), "input"),
        "half a file": (data[: len(data) // 2], "bytes|model"),
    }


def test_damaged_exports_are_refused_by_name(
    trained: Trained, exported: Callable[[Detector], writing.OnnxExport], scene: Frame, tmp_path: Path
) -> None:
    whole = exported(loaded(trained, "pointpillars")).path.read_bytes()
    for name, (data, words) in damaged(whole).items():
        path = tmp_path / f"{name}.onnx"
        path.write_bytes(data)
        with pytest.raises(FarfieldError, match=f"(?s){name}.onnx.*({words})"):
            ff.load_detector(path)(scene.cloud())
