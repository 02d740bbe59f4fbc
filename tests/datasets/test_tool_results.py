"""Results in the forms of other tools: losses said first, frames refused by name, and read back as they were."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import InMemory
from farfield.datasets.result_files import ResultWriter, file_name, result_format
from farfield.errors import ConfigError
from farfield.evaluation import read_detections
from farfield.frame import Annotation, Boxes, Camera, Cloud, Constant, Frame, Sensor
from farfield.metrics.box_files import read_predictions

CLASSES = ("vehicle", "large_vehicle", "pedestrian", "animal")


def boxes_of(rng: np.random.Generator, count: int = 6) -> Boxes:
    return Boxes(
        centre_m=rng.uniform([10, -8, -1], [60, 8, 1], (count, 3)),
        size_m=rng.uniform([3, 1.5, 1.2], [5, 2, 2], (count, 3)),
        yaw_rad=rng.uniform(-0.4, 0.4, count),
        label=rng.choice(["vehicle", "large_vehicle", "pedestrian"], count),
        score=rng.uniform(0.1, 1, count),
    )


def scene(
    *, sequence: str = "5", names: tuple[str, ...] = ("00033_00001", "00034_00002"), **changes: object
) -> InMemory:
    """Two annotated frames with conditions."""
    frames = []
    for number, name in enumerate(names):
        truth = boxes_of(np.random.default_rng(number)).replace(score=None)
        whole: dict[str, object] = {
            "sequence": sequence,
            "frame_id": name,
            "reference": "radar",
            "sensors": {"lidar": Sensor(kind="lidar")},
            "clouds": {"lidar": Cloud(np.zeros((1, 3), np.float32))},
            "load_annotation": Constant(Annotation(boxes=truth)),
            "conditions": {"time": "day", "road": "suburban", "weather": "heavy_snow"},
        }
        frames.append(Frame(**(whole | changes)))  # type: ignore[arg-type]
    return InMemory(frames)


def detections_of(data: InMemory) -> list[tuple[tuple[str, str], Boxes]]:
    return [(key, boxes_of(np.random.default_rng(10 + row))) for row, key in enumerate(data.keys)]


def equal(boxes: Boxes, expected: Boxes, atol: float = 1e-12) -> None:
    np.testing.assert_allclose(boxes.centre_m, expected.centre_m, atol=atol)
    np.testing.assert_allclose(boxes.size_m, expected.size_m, atol=atol)
    np.testing.assert_allclose(np.exp(1j * boxes.yaw_rad), np.exp(1j * expected.yaw_rad), atol=atol)
    np.testing.assert_array_equal(boxes.score, expected.score)


def test_the_kit_s_folder_stands_by_condition_and_reads_back(tmp_path: Path) -> None:
    data = scene()
    boxes = detections_of(data)
    writer = ResultWriter("kradar", data, data.keys, "radar", CLASSES, True)
    assert any("animal" in loss for loss in writer.losses())
    assert any("numbered anew" in loss for loss in writer.losses())
    writer.write(tmp_path / "0.0", boxes)
    assert sorted(path.name for path in (tmp_path / "0.0").iterdir()) == ["all", "countryside", "day", "heavysnow"]
    line = (tmp_path / "0.0/all/preds/000000.txt").read_text().split("\n")[0].split(" ")
    assert line[1:8] == ["-1", "-1", "0", "50", "50", "150", "150"]
    assert (tmp_path / "0.0/all/desc/000000.txt").read_text().split() == ["day", "countryside", "heavysnow"]
    assert (tmp_path / "0.0/all/val.txt").read_text() == "000000\n000001\n"
    own = read_detections(tmp_path / "0.0", tmp_path / "0.0", format="kradar", axes="exchanged")
    equal(own.boxes["", "000001"], boxes[1][1])
    equal(own.annotated["", "000001"].replace(score=boxes[1][1].score), data[1].boxes.replace(score=boxes[1][1].score))
    assert own.reference == "radar"
    beside = read_detections(tmp_path / "0.0/heavysnow", data, format="kradar", axes="exchanged")
    assert list(beside.boxes) == list(data.keys)  # by FRAMES
    (tmp_path / "0.0/all/preds/FRAMES").unlink()
    with pytest.raises(ConfigError, match="numbers its frames anew"):
        read_detections(tmp_path / "0.0", data, format="kradar", axes="exchanged")


def test_frames_without_annotated_boxes_are_not_in_the_kit(tmp_path: Path) -> None:
    data = scene()
    frames = [data[0], replace(data[1], load_annotation=Constant(Annotation(boxes=Boxes.empty())))]
    data = InMemory(frames)
    writer = ResultWriter("kradar", data, data.keys, "radar", CLASSES, True)
    writer.write(tmp_path / "a", detections_of(data))
    assert any("1 frame without an annotated box" in note for note in writer.notes)
    assert [path.name for path in sorted((tmp_path / "a/all/preds").glob("*.txt"))] == ["000000.txt"]
    bare = scene(load_annotation=None)
    writer = ResultWriter("kradar", bare, bare.keys, "radar", CLASSES, True)
    assert any("gts and val.txt are not written" in loss for loss in writer.losses())
    writer.write(tmp_path / "b", detections_of(bare))
    assert not (tmp_path / "b/all/gts").exists()


def test_hostile_conditions_and_names_stay_in_the_folder(tmp_path: Path) -> None:
    data = scene(conditions={"time": "../../x", "road": "urban", "weather": "fog"})
    ResultWriter("kradar", data, data.keys, "radar", CLASSES, True).write(tmp_path / "out" / "a", detections_of(data))
    assert sorted(path.name for path in (tmp_path / "out/a").iterdir()) == ["all", "fog", "urban"]
    data = scene(names=("../../y", "b c"))
    ResultWriter("mmdetection3d", data, data.keys, "lidar", CLASSES).write(tmp_path / "out" / "m", detections_of(data))
    assert sorted(path.name for path in (tmp_path / "out/m").iterdir()) == ["_.._y.json", "b c.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]
    assert file_name("plain name-1") == "plain name-1"


def test_mmdetection3d_s_json_reads_back_beside_the_data(tmp_path: Path) -> None:
    data = scene()
    boxes = detections_of(data)
    speed = np.arange(12.0).reshape(6, 2)
    boxes[0] = (boxes[0][0], boxes[0][1].replace(velocity_m_s=speed))
    writer = ResultWriter("mmdetection3d", data, data.keys, "lidar", CLASSES, True)
    writer.write(tmp_path / "m", boxes)
    detections = read_detections(tmp_path / "m", data, format="mmdetection3d")
    for key, part in boxes:
        equal(detections.boxes[key], part)
        assert detections.boxes[key].label.tolist() == part.label.tolist()
    np.testing.assert_array_equal(detections.boxes[data.keys[0]].velocity_m_s, speed)
    with pytest.raises(ConfigError, match="expected classes"):
        ResultWriter("mmdetection3d", data, data.keys, "lidar", ("vehicle",)).write(tmp_path / "n", boxes)


def test_openpcdet_s_texts_need_a_camera_and_read_back(tmp_path: Path) -> None:
    data = scene()
    with pytest.raises(ConfigError, match="calibrated camera"):
        ResultWriter("openpcdet", data, data.keys, strict=True).check()
    camera = Camera(matrix=np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]]), width_px=1200, height_px=370)
    data = scene(cameras={"image_2": camera})
    boxes = detections_of(data)
    ResultWriter("openpcdet", data, data.keys, "lidar", CLASSES, True).write(tmp_path / "p", boxes)
    row = (tmp_path / "p/00033_00001.txt").read_text().split("\n")[0].split(" ")
    assert (row[1], row[2], len(row)) == ("-1", "-1", 16)
    read_back = read_predictions(tmp_path / "p", format="openpcdet").boxes["", "00033_00001"]
    np.testing.assert_array_equal(read_back.score, boxes[0][1].score)
    joined = read_detections(tmp_path / "p", data, format="openpcdet")
    assert sum(map(len, joined.boxes.values())) == 12


@pytest.mark.parametrize(
    ("format", "names", "changes", "expected"),
    [
        ("nuscenes", ("a", "b"), {}, "tokens"),
        ("argoverse2", ("a", "b"), {"reference": "ego"}, "a stamp"),
        ("argoverse2", ("1550083467346370",), {"reference": "ego"}, "nanoseconds"),
        ("argoverse2", ("315966253660357000",), {"reference": "radar"}, "vehicle"),
        ("waymo", ("315966253660357000",), {"reference": "vehicle"}, "microseconds"),
        ("waymo", ("1550083467346370",), {"reference": "vehicle", "sequence": ""}, "context"),
    ],
)
def test_frames_that_the_form_cannot_name_are_refused(
    format: str, names: tuple[str, ...], changes: dict[str, object], expected: str
) -> None:
    data = scene(names=names, **changes)
    with pytest.raises(ConfigError, match=expected):
        ResultWriter(format, data, data.keys, strict=True).check()


@pytest.mark.parametrize(("format", "lost"), [("waymo", "single precision"), ("argoverse2", "velocities")])
def test_losses_are_named(format: str, lost: str) -> None:
    data = scene(names=("315966253660357000",), reference="ego")
    assert any(lost in loss for loss in ResultWriter(format, data, data.keys, classes=CLASSES).losses())


def test_folders_are_folders(tmp_path: Path) -> None:
    for format in ("kradar", "openpcdet", "mmdetection3d"):
        assert result_format(tmp_path / "a", format) == format
        with pytest.raises(ConfigError, match="a folder"):
            result_format(tmp_path / "a.json", format)
