"""Label files of Cirrus and KITTI, edited where they stand."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.cirrus import CirrusWriter
from farfield.datasets.cirrus.label_format import CirrusLabelFormat
from farfield.datasets.cirrus.reader import Cirrus
from farfield.datasets.kitti.label_format import KittiLabelFormat
from farfield.datasets.kitti.object import Kitti, KittiWriter
from farfield.datasets.labels import BoxLabel
from farfield.datasets.labels.formats import LabelFormat, label_files_in, label_format
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame, Key

NEW = BoxLabel(id="new", label="vehicle", box=(15.0, 1.0, -0.2, 5.0, 2.0, 2.2, math.radians(30)))


def frame_of(yaw_deg: float = 30.0) -> Frame:
    boxes = Boxes(
        centre_m=np.array([[20.0, 3.0, -0.9], [35.0, -6.0, -0.8]]),
        size_m=np.array([[4.6, 1.9, 1.5], [0.8, 0.6, 1.8]]),
        yaw_rad=np.deg2rad([yaw_deg, -100.0]),
        label=["vehicle", "pedestrian"],
        track_id=np.array([4, 5]),
        point_count=np.array([30, 6]),
    )
    points = Cloud(points_m=np.float32([[20.0, 3.0, -1.0]]), intensity=np.float32([0.5]))
    return Frame(
        sequence="a",
        frame_id="1600000000000000000",
        time_ns=1_600_000_000_000_000_000,
        clouds={"gaussian": points},
        load_annotation=Constant(Annotation(boxes=boxes)),
    )


def opened(labels: LabelFormat, data: Dataset) -> tuple[Key, Path, bytes, list[BoxLabel]]:
    (key,) = data.keys
    path = labels.path(key)
    content = path.read_bytes()
    return key, path, content, list(labels.parse(content, path, [key])[key])


@pytest.fixture
def cirrus(tmp_path: Path) -> Cirrus:
    CirrusWriter(tmp_path).write(frame_of())
    return Cirrus(tmp_path / "Cirrus_dataset1")


@pytest.fixture
def kitti(tmp_path: Path) -> Kitti:
    KittiWriter(tmp_path).write(1, frame_of())
    return Kitti(tmp_path)


def test_cirrus_saved_as_it_was_and_one_number_changed(cirrus: Cirrus) -> None:
    labels = CirrusLabelFormat(cirrus)
    key, path, content, found = opened(labels, cirrus)
    boxes = cirrus[0].boxes
    assert boxes is not None
    assert [label.label for label in found] == ["vehicle", "pedestrian"]
    assert [label.track for label in found] == ["4", "5"]
    assert np.allclose([label.box[6] for label in found], boxes.yaw_rad)
    assert labels.render(content, path, {key: found}) == content
    moved = [replace(found[0], box=(20.5, *found[0].box[1:])), found[1]]
    changed = labels.render(content, path, {key: moved})
    old, new = json.loads(content), json.loads(changed)
    assert new["labels"][1] == old["labels"][1]
    assert new["labels"][0]["position"] == [20.5, 3.0, -0.9]
    assert new["labels"][0]["quaternion"] == old["labels"][0]["quaternion"]
    assert "point_count_gaussian" not in new["labels"][0]
    assert {name: value for name, value in new.items() if name != "labels"} == {
        name: value for name, value in old.items() if name != "labels"
    }


def test_cirrus_objects_come_and_go(cirrus: Cirrus) -> None:
    labels = CirrusLabelFormat(cirrus)
    key, path, content, found = opened(labels, cirrus)
    turned = replace(found[1], box=(*found[1].box[:6], 0.75), label="bicycle", track="8")
    changed = labels.render(content, path, {key: [turned, replace(NEW, track="9")]})
    path.write_bytes(changed)
    boxes = Cirrus(cirrus.root)[0].boxes
    assert boxes is not None
    assert boxes.label.tolist() == ["bicycle", "vehicle"]
    assert boxes.yaw_rad.tolist() == pytest.approx([0.75, math.radians(30)])
    assert boxes.size_m[1].tolist() == pytest.approx([5.0, 2.0, 2.2])
    assert boxes.track_id is not None
    assert boxes.track_id.tolist() == [8, 9]
    made = labels.render(None, path, {key: [NEW]})
    assert labels.parse(made, path, [key])[key][0].box == pytest.approx(NEW.box)


def test_cirrus_of_another_mapping(tmp_path: Path) -> None:
    CirrusWriter(tmp_path).write(frame_of())
    path = next(tmp_path.rglob("*.json"))
    content = json.loads(path.read_text())
    for label in content["labels"]:
        label["dims"] = label.pop("size")[::-1]
        label["position"][2] -= label["dims"][0] / 2
        label["quaternion"] = [label["quaternion"][3], *label["quaternion"][:3]]
    path.write_text(json.dumps(content))
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(
        "labels: {size: dims, size_order: hwl, quat_order: wxyz, position_is: bottom, yaw_offset_deg: 10}\n"
    )
    data = Cirrus(tmp_path / "Cirrus_dataset1", mapping=mapping)
    labels = CirrusLabelFormat(data)
    key, path, raw, found = opened(labels, data)
    assert found[0].box[:6] == pytest.approx((20.0, 3.0, -0.9, 4.6, 1.9, 1.5))
    assert labels.render(raw, path, {key: found}) == raw
    changed = labels.render(raw, path, {key: [*found, NEW]})
    assert labels.parse(changed, path, [key])[key][2].box == pytest.approx(NEW.box)


def test_real_luminar_labels(shared_real: Path) -> None:
    data = open_dataset(shared_real / "cirrus_layout" / "Cirrus_dataset1")
    labels = label_format(data)
    assert isinstance(labels, CirrusLabelFormat)
    for key in data.keys:
        content = labels.path(key).read_bytes()
        found = labels.parse(content, labels.path(key), [key])[key]
        assert len(found) > 90
        assert labels.render(content, labels.path(key), {key: found}) == content


def test_kitti_saved_as_it_was(kitti: Kitti) -> None:
    labels = KittiLabelFormat(kitti)
    key, path, content, found = opened(labels, kitti)
    boxes = kitti[0].boxes
    assert boxes is not None
    assert [label.label for label in found] == ["Car", "Pedestrian"]
    assert np.allclose([label.box for label in found], np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]))
    extra = b"DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10\n\n"
    for raw in (content, content[:-1], content + extra, extra + content, content.replace(b"\n", b"\r\n")):
        again = list(labels.parse(raw, path, [key])[key])
        assert labels.render(raw, path, {key: again}) == raw
        moved = [replace(again[0], box=(21.0, *again[0].box[1:])), again[1]]
        changed = labels.render(raw, path, {key: moved})
        assert sum(a != b for a, b in zip(raw.split(b"\n"), changed.split(b"\n"), strict=True)) == 1
        assert labels.parse(changed, path, [key])[key][0].box == pytest.approx(moved[0].box, abs=1e-6)


def test_kitti_class_and_occlusion_are_edited_alone(kitti: Kitti) -> None:
    labels = KittiLabelFormat(kitti)
    key, path, content, found = opened(labels, kitti)
    edited = [replace(found[0], label="Van", attributes={"occlusion": 1.0}), found[1]]
    changed = labels.render(content, path, {key: edited})
    first, second = content.split()[:3], changed.split()[:3]
    assert first == [b"Car", second[1], b"3"]
    assert second == [b"Van", first[1], b"1"]
    assert changed.split()[3:] == content.split()[3:]


def test_kitti_objects_come_and_go(kitti: Kitti) -> None:
    labels = KittiLabelFormat(kitti)
    key, path, content, found = opened(labels, kitti)
    changed = labels.render(content, path, {key: [found[1], NEW]})
    again = labels.parse(changed, path, [key])[key]
    assert [label.label for label in again] == ["Pedestrian", "Car"]
    assert again[1].box == pytest.approx(NEW.box, abs=1e-6)
    assert labels.parse(labels.render(None, path, {key: [NEW]}), path, [key])[key][0].label == "Car"
    scored = content.replace(b"\n", b" 0.5\n")
    with_score = labels.render(scored, path, {key: [*labels.parse(scored, path, [key])[key], NEW]})
    assert len(labels.parse(with_score, path, [key])[key]) == 3
    with pytest.raises(ConfigError, match="class of KITTI"):
        labels.render(content, path, {key: [replace(NEW, label="tank")]})
    with pytest.raises(DatasetError, match="expected a frame"):
        labels.path(("a", "none"))


@pytest.mark.parametrize("folder", ["kitti", "kitti_more"])
def test_real_kitti_labels(shared_real: Path, folder: str) -> None:
    data = open_dataset(shared_real / folder)
    labels = label_format(data)
    assert isinstance(labels, KittiLabelFormat)
    for key in data.keys:
        path = labels.path(key)
        if not path.is_file():
            continue
        content = path.read_bytes()
        found: Sequence[BoxLabel] = labels.parse(content, path, [key])[key]
        assert labels.render(content, path, {key: found}) == content
        if found:
            moved = [replace(found[0], box=(found[0].box[0] + 0.5, *found[0].box[1:])), *found[1:]]
            changed = labels.render(content, path, {key: moved})
            lines = zip(content.split(b"\n"), changed.split(b"\n"), strict=True)
            assert sum(a != b for a, b in lines) == 1
            assert labels.parse(changed, path, [key])[key][0].box == pytest.approx(moved[0].box, abs=1e-3)


def test_formats_by_data_set_and_by_name(cirrus: Cirrus, tmp_path: Path) -> None:
    assert isinstance(label_format(cirrus.select([0])), CirrusLabelFormat)
    assert label_files_in(tmp_path, "openlabel").name == "openlabel"
    assert label_files_in(tmp_path / "a.csv", "boxes-csv").path(("a", "b")) == tmp_path / "a.csv"
    with pytest.raises(DatasetError, match="expected one of"):
        label_files_in(tmp_path, "none")


AUTHORS = (
    b"vehicle 0 0 0 0 0 0 0 1.50 4.6 1.9 -3.0 1.65 20.0 0.1\r\n"
    b"\r\n"
    b"pedestrian\t0 1 -1.2 10 20 30 40 1.7  0.7 0.7 4 1.70 12.0 -1.5"
)


@pytest.mark.parametrize("naming", ["authors", "kitti"])
def test_the_authors_text_of_cirrus_is_edited_in_its_place(cirrus: Cirrus, naming: str) -> None:
    labels = CirrusLabelFormat(cirrus)
    labels.settings = labels.settings.model_copy(update={"text_naming": naming})
    key, path = cirrus.keys[0], Path("1600000000.txt")
    found = labels.parse(AUTHORS, path, [key])[key]
    assert len(found) == 2
    assert labels.render(AUTHORS, path, {key: found}) == AUTHORS
    assert labels.render(AUTHORS, path, {}) == AUTHORS
    first = replace(found[0], label="large_vehicle", box=(found[0].box[0] + 0.5, *found[0].box[1:]), track="7")
    changed = labels.render(AUTHORS, path, {key: [first, found[1]]})
    assert changed == AUTHORS.replace(b"vehicle", b"large_vehicle").replace(b"20.0 0.1", b"20.5 0.1")
    second = replace(found[1], box=(*found[1].box[:6], found[1].box[6] + 0.25))
    turned = labels.render(AUTHORS, path, {key: [found[0], second]})
    assert turned.startswith(
        AUTHORS.partition(b"pedestrian")[0] + b"pedestrian\t0 1 0 0 0 0 0 1.7  0.7 0.7 4 1.70 12.0 "
    )
    assert not turned.endswith(b"\n")  # as it was
    assert labels.parse(turned, path, [key])[key][1].box == pytest.approx(second.box, abs=1e-9)


def test_boxes_come_and_go_in_the_authors_text(cirrus: Cirrus) -> None:
    labels = CirrusLabelFormat(cirrus)
    key, path = cirrus.keys[0], Path("1600000000.txt")
    found = labels.parse(AUTHORS, path, [key])[key]
    added = replace(found[0], id="n1", box=(31.0, 2.0, 0.5, 4.2, 1.8, 1.6, -2.0))
    changed = labels.render(AUTHORS, path, {key: [found[1], added]})
    again = labels.parse(changed, path, [key])[key]
    assert [label.label for label in again] == ["pedestrian", "vehicle"]
    assert again[1].box == pytest.approx(added.box, abs=1e-9)
    assert changed.count(b"\r\n") == 3  # a blank line, the pedestrian's that something follows now, and the new one's
    new = labels.render(None, path, {key: [added]})
    assert labels.parse(new, path, [key])[key][0].box == pytest.approx(added.box, abs=1e-9)
    with pytest.raises(ConfigError, match="without blanks"):
        labels.render(AUTHORS, path, {key: [replace(found[0], label="a car")]})
    with pytest.raises(FileFormatError, match="line ends"):
        labels.render(AUTHORS.replace(b"\r\n", b"\r"), path, {key: found})
