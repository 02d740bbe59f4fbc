"""aiMotive's sessions, written here byte for byte: clouds, boxes, radars, cameras, times, splits, and refusals."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from las_files import las_bytes, point_1
from PIL import Image

from farfield.datasets import open_dataset, recognise
from farfield.errors import DatasetError, FarfieldError, FileFormatError

from .generators.aimotive import write_aimotive
from .generators.truth import check_dataset, open_recognised

SESSION = "20210901-194123-00.37.12-00.37.27@Yoda"
NUMBER, TIME_NS = 33643, 4833189570000
YAW_RAD = 0.3
CAR = {
    "ActorName": "CAR 04", "ObjectId": 4, "ObjectType": "CAR", "Occluded": 1, "Truncated": 0,
    "BoundingBox3D Extent X": 4.7, "BoundingBox3D Extent Y": 2.0, "BoundingBox3D Extent Z": 1.9,
    "BoundingBox3D Orientation Quat W": math.cos(YAW_RAD / 2), "BoundingBox3D Orientation Quat X": 0,
    "BoundingBox3D Orientation Quat Y": 0, "BoundingBox3D Orientation Quat Z": math.sin(YAW_RAD / 2),
    "BoundingBox3D Origin X": 30.0, "BoundingBox3D Origin Y": -5.0, "BoundingBox3D Origin Z": 0.5,
    "Relative Velocity X": -1.5, "Relative Velocity Y": 0.25, "Relative Velocity Z": 0,
}  # fmt: skip
TARGET = {"azimuth": 0.1, "elevation": -0.02, "range": 40.0, "speed": -29.5, "rcs": 2.5, "power": 139.0, "noise": 103.0}
BODY_T_FRONT = [[1, 0, 0, 3.8], [0, 1, 0, 0], [0, 0, 1, 0.4], [0, 0, 0, 1]]
BODY_T_BACK = [[-1, 0, 0, -1.1], [0, -1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]
BODY_T_CAMERA = [[0, 0, 1, 1.9], [-1, 0, 0, 0.1], [0, -1, 0, 1.2], [0, 0, 0, 1]]
LENS = {
    "sensor_type": "camera", "focal_length_px": [100, 110], "principal_point_px": [32, 24],
    "distortion_coeffs": [-0.3, 0.1, 0.001, 0.002, 0], "image_resolution_px": [64, 48],
}  # fmt: skip


def write_session(root: Path, frames: int = 2) -> Path:
    calibration = {
        "F_LRR_C": {"sensor_type": "radar", "RT_body_from_sensor": BODY_T_FRONT},
        "B_LRR_C": {
            "sensor_type": "radar", "RT_body_from_sensor": BODY_T_BACK,
            "RT_sensor_from_body": np.linalg.inv(BODY_T_BACK).tolist(),
            "custom_vars": {"rotate_objects_by_180_degree": True},
        },
        "F_MIDLONGRANGECAM_CL": LENS | {"model": "opencv_pinhole", "RT_body_from_sensor": BODY_T_CAMERA},
        "M_FISHEYE_L": LENS | {"model": "mei", "xi": 1.02, "RT_body_from_sensor": BODY_T_CAMERA},
        "M_LIDAR_M": {"sensor_type": "lidar", "RT_body_from_sensor": BODY_T_FRONT, "rpm": math.nan},
        "Imu0": {"sensor_type": "imu_ins"},
    }  # fmt: skip
    for folder in ("dynamic/box/3d_body", "dynamic/raw-revolutions", "sensor/calibration", "sensor/gnssins"):
        (root / folder).mkdir(parents=True)
    (root / "sensor/calibration/calibration.json").write_text(json.dumps(calibration))
    for number in range(NUMBER, NUMBER + frames):
        time_ns = TIME_NS + 66_700_000 * (number - NUMBER)
        boxes = {"CapturedObjects": [CAR], "Timestamp": str(time_ns)}
        (root / f"dynamic/box/3d_body/frame_{number:07d}.json").write_text(json.dumps(boxes))
        points = [point_1(30_000, -5000, 500, 254, time=time_ns - 68e6), point_1(-20_000, 1, 0, 0, time=time_ns + 32e6)]
        cloud = las_bytes(points, encoding=1, records=[("is_body", 12345, b"true\0\0\0\0")])
        (root / f"dynamic/raw-revolutions/frame_{number:07d}.laz").write_bytes(cloud)
        for name in ("F_LRR_C", "B_LRR_C"):
            (root / f"sensor/radar/{name}").mkdir(parents=True, exist_ok=True)
            targets = json.dumps({"id": "?", "targets": [TARGET]})
            (root / f"sensor/radar/{name}/{name}_{number:07d}.json").write_text(targets)
        for name in ("F_MIDLONGRANGECAM_CL", "M_FISHEYE_L"):
            (root / f"sensor/camera/{name}").mkdir(parents=True, exist_ok=True)
            Image.new("RGB", (64, 48)).save(root / f"sensor/camera/{name}/{name}_{number:07d}.jpg")
    return root


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return write_session(tmp_path / "data" / "train" / "nighttime" / SESSION)


def test_a_session_is_read_at_every_depth(session: Path) -> None:
    for root in (session, *list(session.parents)[:4]):
        assert recognise(root) == "aimotive"
        data = open_dataset(root)
        assert data.keys == ((SESSION, "0033643"), (SESSION, "0033644"))


def test_boxes_stand_as_they_are_written(session: Path) -> None:
    annotation = open_dataset(session)[0].annotation
    assert annotation is not None
    boxes = annotation.boxes
    np.testing.assert_allclose(boxes.centre_m, [[30, -5, 0.5]])
    np.testing.assert_allclose(boxes.size_m, [[4.7, 2.0, 1.9]])
    np.testing.assert_allclose(boxes.yaw_rad, [YAW_RAD])
    assert (list(boxes.label), annotation.original_label) == (["vehicle"], ("CAR",))
    assert boxes.track_id is not None
    assert boxes.track_id.tolist() == [4]
    assert boxes.velocity_m_s is None  # what is relative to the car is no velocity over ground
    np.testing.assert_allclose(annotation.details["relative_velocity_m_s"], [[-1.5, 0.25, 0]])
    assert annotation.details["occluded"].tolist() == [1]
    assert list(open_dataset(session, classes="aimotive")[0].boxes.label) == ["CAR"]  # type: ignore[union-attr]


def test_clouds_have_their_times_and_full_scale(session: Path) -> None:
    frame = open_dataset(session)[1]
    cloud = frame.cloud("lidar")
    assert frame.time_ns == TIME_NS + 66_700_000
    np.testing.assert_allclose(cloud.points_m, [[30, -5, 0.5], [-20, 0.001, 0]], atol=1e-6)
    np.testing.assert_allclose(cloud.intensity, [254 / 255, 0])
    assert cloud.extra["offset_ns"].tolist() == [-68_000_000, 32_000_000]
    assert [len(rows) for rows in cloud.in_boxes(frame.boxes)] == [1]  # type: ignore[arg-type]


def test_radars_stand_in_the_bodys_coordinates(session: Path) -> None:
    frame = open_dataset(session)[0]
    flat, up = 40 * math.cos(0.02), -40 * math.sin(0.02)
    ahead = [flat * math.cos(0.1), flat * math.sin(0.1), up]
    np.testing.assert_allclose(frame.cloud("F_LRR_C").points_m, [np.add(ahead, [3.8, 0, 0.4])], rtol=1e-6)
    back = [-ahead[0] - 1.1, -ahead[1], up + 0.5]
    np.testing.assert_allclose(frame.cloud("B_LRR_C").points_m, [back], rtol=1e-6)
    assert frame.cloud("F_LRR_C").kind == "radar"
    np.testing.assert_allclose(frame.cloud("F_LRR_C").column("doppler_m_s"), [-29.5])
    np.testing.assert_allclose(frame.cloud("F_LRR_C").column("rcs"), [2.5])


def test_cameras_project_and_fisheyes_are_said(session: Path) -> None:
    (session / "sensor/gnssins/egomotion2.json").write_text("{}")
    data = open_dataset(session)
    frame = data[0]
    assert sorted(frame.images) == ["F_MIDLONGRANGECAM_CL", "M_FISHEYE_L"]
    assert list(frame.cameras) == ["F_MIDLONGRANGECAM_CL"]
    pixels, depth, _ = frame.cameras["F_MIDLONGRANGECAM_CL"].project(np.array([[11.9, 0.1, 1.2]]))
    np.testing.assert_allclose(pixels, [[32, 24]], atol=1e-9)
    assert depth.tolist() == [10.0]
    assert ["egomotion" in note or "mei" in note for note in data.notes] == [True, True]
    assert frame.world_T_frame is None


def test_drives_are_sessions_and_parts_their_folders(session: Path, tmp_path: Path) -> None:
    write_session(tmp_path / "data" / "val" / "rain" / "other@Car", frames=3)
    data = open_dataset(tmp_path / "data")
    drives = {drive.name: drive for drive in data.drives()}
    assert drives[SESSION].times_ns is not None
    assert drives[SESSION].times_ns.tolist() == [TIME_NS, TIME_NS + 66_700_000]
    assert (len(data.split("train")), len(data.split("val"))) == (2, 3)
    assert {frame.conditions["condition"] for frame in data} == {"nighttime", "rain"}
    write_session(tmp_path / "data" / "val" / "rain" / SESSION)
    with pytest.raises(DatasetError, match="twice"):
        open_dataset(tmp_path / "data")


def change(content: Any, key: str, value: Any) -> None:
    *steps, last = key.split("/")
    for step in steps:
        content = content[int(step) if step.isdigit() else step]
    content[last] = value


def read_all(session: Path) -> None:
    frame = open_dataset(session)[0]
    _ = frame.annotation, [frame.cloud(name) for name in frame.clouds], frame.cameras


BOXES, RADAR, CALIBRATION = (
    "dynamic/box/3d_body/frame_0033643.json", "sensor/radar/F_LRR_C/F_LRR_C_0033643.json",
    "sensor/calibration/calibration.json",
)  # fmt: skip


@pytest.mark.parametrize(
    ("file", "key", "value"),
    [
        *((BOXES, "Timestamp", value) for value in (4833, "-1", "4.8e12", "9" * 30, None)),
        (BOXES, "CapturedObjects", {}),
        (BOXES, "CapturedObjects", [CAR, CAR]),
        (BOXES, "CapturedObjects", [1]),
        *((BOXES, f"CapturedObjects/0/{name}", None) for name in CAR if name != "ActorName"),
        (BOXES, "CapturedObjects/0/BoundingBox3D Extent Z", 0.0),
        (BOXES, "CapturedObjects/0/BoundingBox3D Origin X", 1e9),
        (BOXES, "CapturedObjects/0/BoundingBox3D Orientation Quat W", 2.0),
        (BOXES, "CapturedObjects/0/BoundingBox3D Orientation Quat X", 0.9),
        (BOXES, "CapturedObjects/0/ObjectId", 4.5),
        (BOXES, "CapturedObjects/0/ObjectType", ""),
        (BOXES, "CapturedObjects/0/Relative Velocity X", 1e6),
        *((RADAR, f"targets/0/{name}", None) for name in TARGET),
        *((RADAR, f"targets/0/{name}", -5.0) for name in ("range", "rcs", "azimuth")),
        (RADAR, "targets/0/elevation", 5.0),
        (RADAR, "targets/0/speed", 1e5),
        (RADAR, "targets", 3),
        (CALIBRATION, "F_LRR_C/RT_body_from_sensor", np.eye(3).tolist()),
        (CALIBRATION, "F_LRR_C/RT_body_from_sensor", np.diag([1, 1, -1, 1]).tolist()),
        (CALIBRATION, "F_LRR_C/RT_body_from_sensor", np.diag([2, 2, 2, 1]).tolist()),
        (CALIBRATION, "B_LRR_C/RT_sensor_from_body", BODY_T_BACK),
        (CALIBRATION, "F_LRR_C/sensor_type", 3),
        (CALIBRATION, "F_LRR_C", {}),
        *((CALIBRATION, f"F_MIDLONGRANGECAM_CL/{name}", None) for name in (*LENS, "model")),
    ],
)
def test_what_cannot_be_is_refused_by_name(session: Path, file: str, key: str, value: Any) -> None:
    content = json.loads((session / file).read_text())
    change(content, key, value)
    (session / file).write_text(json.dumps(content))
    with pytest.raises(FarfieldError, match=Path(file).name.replace(".", r"\.")):
        read_all(session)


def test_times_that_go_back_and_two_files_of_a_number_are_refused(session: Path) -> None:
    boxes = session / "dynamic/box/3d_body"
    text = (boxes / "frame_0033644.json").read_text()
    (boxes / "frame_0033644.json").write_text(text.replace(str(TIME_NS + 66_700_000), str(TIME_NS)))
    with pytest.raises(FileFormatError, match="a time after frame 33643"):
        open_dataset(session).drives()
    (boxes / "frame_33643.json").write_text(text)
    with pytest.raises(DatasetError, match="same number"):
        open_dataset(session)


@pytest.mark.parametrize(
    "cloud",
    [
        las_bytes([point_1(1, 1, 1, 256, time=TIME_NS)], encoding=1),
        las_bytes([point_1(1, 1, 1, time=TIME_NS + 2e9)], encoding=1),
        las_bytes([point_1(1, 1, 1, time=TIME_NS)], encoding=1, records=[("is_body", 12345, b"false\0")]),
    ],
)
def test_clouds_of_other_scales_times_and_coordinates_are_refused(session: Path, cloud: bytes) -> None:
    (session / "dynamic/raw-revolutions/frame_0033643.laz").write_bytes(cloud)
    with pytest.raises(FileFormatError):
        open_dataset(session)[0].cloud("lidar")


def test_the_published_session(shared_real: Path) -> None:
    """Points in boxes as counted when the format was first read: 17 at 116 m, 17,508 at 4 m, 89 at 92 m behind."""
    pytest.importorskip("lazrs")
    if not (shared_real / "aimotive").is_dir():
        pytest.skip("no session of aiMotive there")
    frame = open_dataset(shared_real / "aimotive")[0]
    assert frame.boxes is not None
    counts = [len(rows) for rows in frame.cloud("lidar").in_boxes(frame.boxes)]
    assert {17, 17_508, 89} <= set(counts)
    assert len(frame.cloud("F_LRR_C")) == 39


def test_clouds_as_las_are_read_too(tmp_path):
    truth = write_aimotive(tmp_path, packed=False)
    check_dataset(open_recognised(tmp_path), truth)
