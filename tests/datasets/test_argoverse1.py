"""Argoverse 1's logs, written here as argoverse-api describes them: sweeps, labels, poses, cameras, and refusals."""

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from farfield.datasets import open_dataset, recognise
from farfield.errors import DatasetError, FarfieldError

LOG, TIME_NS = "c6911883-1843-3727-8eaa-41dc8cda8993", 315978406019574000
YAW_RAD = -0.4
CAR = {
    "center": {"x": 12.0, "y": -3.0, "z": 0.9}, "length": 4.5, "width": 1.9, "height": 1.8, "label_class": "VEHICLE",
    "rotation": {"w": math.cos(YAW_RAD / 2), "x": 0.0, "y": 0.0, "z": math.sin(YAW_RAD / 2)}, "occlusion": 1,
    "timestamp": TIME_NS, "track_label_uuid": "00000000-0000-0000-0000-000000000001", "tracked": True,
}  # fmt: skip
PERSON = CAR | {
    "center": {"x": 40.0, "y": 5.0, "z": 1.0}, "length": 0.7, "width": 0.6, "label_class": {"name": "PEDESTRIAN"},
    "track_label_uuid": "00000000-0000-0000-0000-000000000002",
}  # fmt: skip
HALF = math.sqrt(0.5)
POSE = {"rotation": [HALF, 0, 0, HALF], "translation": [2000.0, -300.0, 15.0]}
LENS = {
    "focal_length_x_px_": 100.0, "focal_length_y_px_": 110.0, "focal_center_x_px_": 32.0, "focal_center_y_px_": 24.0,
    "skew_": 0.0, "distortion_coefficients_": [-0.17, 0.1, 0.0],
    "vehicle_SE3_camera_": {"rotation": {"coefficients": [0.5, -0.5, 0.5, -0.5]}, "translation": [1.6, 0.1, 1.4]},
}  # fmt: skip
POINTS = [(12.0, -3.0, 0.9, 255, 31), (40.0, 5.0, 1.0, 51, 0), (0.0, 0.0, 0.0, 9, 1)]


def write_log(root: Path, time_ns: int = TIME_NS) -> Path:
    for folder in ("lidar", "per_sweep_annotations_amodal", "poses", "ring_front_center"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    kinds = ("float x", "float y", "float z", "uchar intensity", "ushort laser_number")
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(POINTS)}"]
    head += [f"property {kind}" for kind in kinds] + ["end_header", ""]
    body = b"".join(struct.pack("<3fBH", *point) for point in POINTS)
    (root / f"lidar/PC_{time_ns}.ply").write_bytes("\n".join(head).encode() + body)
    labels = [entry | {"timestamp": time_ns} for entry in (CAR, PERSON)]
    name = f"per_sweep_annotations_amodal/tracked_object_labels_{time_ns}.json"
    (root / name).write_text(json.dumps(labels))
    (root / f"poses/city_SE3_egovehicle_{time_ns}.json").write_text(json.dumps(POSE))
    Image.new("RGB", (64, 48)).save(root / f"ring_front_center/ring_front_center_{time_ns + 20_000_000}.jpg")
    calibration = {"camera_data_": [{"key": "image_raw_ring_front_center", "value": LENS}]}
    (root / "vehicle_calibration_info.json").write_text(json.dumps(calibration))
    (root / "city_info.json").write_text('{"city_name": "PIT"}')
    return root


@pytest.fixture
def log(tmp_path: Path) -> Path:
    root = write_log(tmp_path / "argoverse-tracking" / "train1" / LOG)
    return write_log(root, TIME_NS + 100_000_000)


def test_a_log_is_read_at_every_depth(log: Path) -> None:
    for root in (log, log.parent, log.parents[1]):
        assert recognise(root) == "argoverse1"
        assert open_dataset(root).keys == ((LOG, str(TIME_NS)), (LOG, str(TIME_NS + 100_000_000)))


def test_clouds_boxes_and_tracks_stand_as_written(log: Path) -> None:
    frame = open_dataset(log)[0]
    cloud, annotation = frame.cloud("lidar"), frame.annotation
    assert annotation is not None
    np.testing.assert_array_equal(cloud.points_m, np.float32([point[:3] for point in POINTS[:2]]))
    np.testing.assert_allclose(cloud.intensity, [1.0, 0.2])
    assert (cloud.extra["ring"].tolist(), cloud.missing) == ([31, 0], 1)
    boxes = annotation.boxes
    np.testing.assert_allclose(boxes.centre_m, [[12, -3, 0.9], [40, 5, 1]])
    np.testing.assert_allclose(boxes.size_m, [[4.5, 1.9, 1.8], [0.7, 0.6, 1.8]])
    np.testing.assert_allclose(boxes.yaw_rad, [YAW_RAD, YAW_RAD])
    assert list(boxes.label) == ["vehicle", "pedestrian"]
    assert annotation.original_label == ("VEHICLE", "PEDESTRIAN")
    assert annotation.details["occlusion"].tolist() == [1, 1]
    assert [len(rows) for rows in cloud.in_boxes(boxes)] == [1, 1]
    later = open_dataset(log)[1].boxes
    assert later is not None
    assert later.track_id is not None
    assert boxes.track_id is not None
    assert later.track_id.tolist() == boxes.track_id.tolist()
    assert len(set(boxes.track_id.tolist())) == 2


def test_poses_and_cameras_are_those_of_the_devkit(log: Path) -> None:
    data = open_dataset(log)
    frame = data[0]
    assert frame.world_T_frame is not None
    np.testing.assert_allclose(frame.world_T_frame @ [1, 0, 0, 1], [2000, -299, 15, 1], atol=1e-9)
    (drive,) = data.drives()
    assert drive.times_ns is not None
    assert drive.world_T_frame is not None
    assert np.diff(drive.times_ns).tolist() == [100_000_000]
    pixels, depth, _ = frame.cameras["ring_front_center"].project(np.array([[11.6, 0.1, 1.4], [11.6, -0.9, 0.4]]))
    np.testing.assert_allclose(pixels, [[32, 24], [42, 35]], atol=1e-9)  # to the right, and down: not distorted
    np.testing.assert_allclose(depth, [10, 10])
    assert frame.sensors["ring_front_center"].time_ns == TIME_NS + 20_000_000


def test_parts_are_the_folders_and_names_stand_once(log: Path) -> None:
    root = log.parents[1]
    write_log(root / "val" / "other")
    write_log(root / "train2" / "third")
    data = open_dataset(root)
    assert sorted(set(data.split("train").sequences)) == sorted([LOG, "third"])
    assert set(data.split("val").sequences) == {"other"}
    write_log(root / "val" / LOG)
    with pytest.raises(DatasetError, match="twice"):
        open_dataset(root)


def test_a_sweep_without_labels_is_not_annotated(log: Path) -> None:
    next((log / "per_sweep_annotations_amodal").iterdir()).unlink()
    assert sorted(frame.has_annotation for frame in open_dataset(log)) == [False, True]


LABELS, CAMERA = f"per_sweep_annotations_amodal/tracked_object_labels_{TIME_NS}.json", "vehicle_calibration_info.json"


def without(name: str) -> dict[str, Any]:
    return {key: value for key, value in CAR.items() if key != name}


@pytest.mark.parametrize(
    ("file", "content"),
    [
        (LABELS, {}),
        (LABELS, [1]),
        (LABELS, [CAR, CAR]),
        *((LABELS, [without(name)]) for name in CAR if name not in ("occlusion", "tracked")),
        (LABELS, [CAR | {"timestamp": TIME_NS + 1}]),
        (LABELS, [CAR | {"height": 0}]),
        (LABELS, [CAR | {"length": "4.5"}]),
        (LABELS, [CAR | {"length": 1e9}]),
        (LABELS, [CAR | {"center": {"x": 1e300, "y": 0, "z": 0}}]),
        (LABELS, [CAR | {"rotation": {"w": 0, "x": 1, "y": 0, "z": 0}}]),
        (LABELS, [CAR | {"rotation": {"w": 2, "x": 0, "y": 0, "z": 0}}]),
        (LABELS, [CAR | {"occlusion": 0.5}]),
        (LABELS, [CAR | {"label_class": {"class": "VEHICLE"}}]),
        (f"poses/city_SE3_egovehicle_{TIME_NS}.json", POSE | {"rotation": [1, 1, 0, 0]}),
        (f"poses/city_SE3_egovehicle_{TIME_NS}.json", POSE | {"translation": [1, 2]}),
        (f"poses/city_SE3_egovehicle_{TIME_NS}.json", [1]),
        (CAMERA, {"camera_data_": {}}),
        (CAMERA, {"camera_data_": [{"key": "image_raw_ring_front_center", "value": LENS | {"skew_": 0.1}}]}),
        (CAMERA, {"camera_data_": [{"key": "image_raw_ring_front_center", "value": LENS | {"focal_length_x_px_": 0}}]}),
        (CAMERA, {"camera_data_": [{"key": "image_raw_ring_front_center", "value": LENS}] * 2}),
        (CAMERA, {"camera_data_": [{"key": 3, "value": LENS}]}),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_name(log: Path, file: str, content: Any) -> None:
    (log / file).write_text(json.dumps(content))
    with pytest.raises(FarfieldError, match=Path(file).name.replace(".", r"\.")):
        read_all(log)


@pytest.mark.parametrize(
    ("old", "new"), [(b"uchar intensity", b"short intensity"), (b"laser_number", b"ring_of_laser")]
)
def test_sweeps_of_other_columns_are_refused(log: Path, old: bytes, new: bytes) -> None:
    path = log / f"lidar/PC_{TIME_NS}.ply"
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(FarfieldError, match="PC_"):
        read_all(log)


def read_all(log: Path) -> None:
    frame = open_dataset(log)[0]
    _ = frame.annotation, frame.cloud("lidar"), frame.cameras, frame.world_T_frame
