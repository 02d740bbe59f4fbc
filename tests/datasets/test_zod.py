"""Single frames of ZOD, made by hand from the kit's description: the LiDAR's y is forward, ends of boxes in GeoJSON."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from farfield.datasets import open_dataset
from farfield.datasets.zod import Zod
from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError
from farfield.files.zod import read_trainval, time_of_name
from farfield.geometry.boxes import count_points_in_boxes

FIELDS = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("timestamp", "<i8"), ("intensity", "u1"), ("diode_index", "u1")]
KEY_S = 1644845012.25
STAMPS = [KEY_S - 0.1, KEY_S, KEY_S + 0.1]
NAMES = [f"000007_quebec_2022-02-14T13:23:32.{text}Z.npy" for text in ("150000", "250000", "350000")]
CAR = [(2.0 + 0.1 * step, 30.0, -1.0) for step in range(5)]  # x right, y forward: 30 m ahead, 2 m right
OWN = (0.5, 1.0, -0.5)


def sweep() -> np.ndarray:
    places = [*CAR, OWN, (0.0, 0.0, 0.0)]
    rows = np.zeros(len(places), dtype=FIELDS)
    for column, axis in enumerate("xyz"):
        rows[axis] = [place[column] for place in places]
    rows["timestamp"] = np.arange(len(places)) * 1000 - 3000
    rows["intensity"] = 255
    rows["diode_index"] = np.arange(len(places)) + 120
    return rows


def thing(name: str, kind: str | None, *, at=None, turn=(1.0, 0.0, 0.0, 0.0), unclear=False, **rest) -> dict:
    facts = {"class": name, "annotation_uuid": f"uuid-{name}-{kind}", "unclear": unclear, **rest}
    if kind is not None:
        facts["type"] = kind
    if at is not None:
        facts["location_3d"] = {"type": "Point", "coordinates": list(at)}
        facts |= {"size_3d_length": 4.5, "size_3d_width": 2.0, "size_3d_height": 1.6}
        facts |= dict(zip([f"orientation_3d_q{axis}" for axis in "wxyz"], turn, strict=True))
    ends = [[10, 20], [30, 15], [50, 22], [28, 40]]
    return {"geometry": {"type": "MultiPoint", "coordinates": ends}, "properties": facts}


HALF = float(np.sqrt(0.5))
OBJECTS = [
    thing("Vehicle", "Car", at=(2.2, 30.0, -1.0), turn=(HALF, 0, 0, HALF), occlusion_ratio="Light"),  # heads forward
    thing("VulnerableVehicle", "Bicycle", at=(-9.0, 30.0, -1.0), with_rider="True"),  # heads right
    thing("Pedestrian", None, unclear=True, at=(0.0, 50.0, -1.0)),
    thing("PoleObject", None, at=(0.0, 60.0, -1.0)),
    thing("Vehicle", "Van"),
    thing("Inconclusive", None),
]
EGO_T_LIDAR = [[0.0, 1, 0, 1.0], [-1, 0, 0, 0.0], [0, 0, 1, 2.0], [0, 0, 0, 1]]  # 1 m ahead of the car's origin
EGO_T_CAMERA = [[0.0, 0, 1, 1.5], [-1, 0, 0, 0.0], [0, -1, 0, 1.4], [0, 0, 0, 1]]


def write(path: Path, content) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def motion(speed_m_s: float = 20.0) -> dict:
    times = [KEY_S - 0.5 + 0.25 * step for step in range(5)]
    poses = []
    for time in times:
        pose = np.eye(4)
        pose[0, 3] = speed_m_s * (time - KEY_S)
        poses.append(pose.tolist())
    return {"poses": poses, "timestamps": times, "velocities": [], "origin_lat_lon": [57.7, 12.0]}


@pytest.fixture
def root(tmp_path):
    for number in ("000007", "000008", "000009"):
        folder = tmp_path / "single_frames" / number
        (folder / "lidar_velodyne").mkdir(parents=True)
        for name in NAMES if number == "000007" else NAMES[1:2]:
            np.save(folder / "lidar_velodyne" / name.replace("000007", number), sweep())
        lens = {"intrinsics": [[1.0] * 3] * 3, "distortion": [0.1] * 4, "field_of_view": [120, 67]}
        poses = {"lidar_extrinsics": EGO_T_LIDAR, "extrinsics": EGO_T_CAMERA}
        write(folder / "calibration.json", {"FC": {**poses, **lens}})
        write(folder / "ego_motion.json", motion())
        write(folder / "metadata.json", {"time_of_day": "day", "scraped_weather": "rain", "road_type": "city"})
        write(folder / "annotations/object_detection.json", OBJECTS)
        (folder / "camera_front_blur").mkdir()
        Image.new("RGB", (64, 48)).save(folder / f"camera_front_blur/{number}_quebec_2022-02-14T13:23:32.140954Z.jpg")
    (tmp_path / "splits").mkdir()
    (tmp_path / "splits/frames_full_train.txt").write_text("000007\n000008\n012345\n")
    (tmp_path / "splits/frames_full_val.txt").write_text("000009\n")
    return tmp_path


def labels(root: Path) -> Path:
    return root / "single_frames/000007/annotations/object_detection.json"


def test_the_key_sweep_is_the_middle_one_and_looks_along_x(root):
    data = open_dataset(root)
    assert data.name == "zod"
    assert data.sequences == ("000007",) * 3 + ("000008", "000009")
    assert [data.has_annotation(index) for index in range(5)] == [False, True, False, True, True]
    frame = data[1]
    cloud = frame.cloud("lidar")
    expected = [(y, -x, z) for x, y, z in CAR]
    np.testing.assert_allclose(cloud.points_m, expected, atol=1e-6)
    assert cloud.missing == 1
    assert cloud.extra["ring"].tolist() == [120, 121, 122, 123, 124]
    assert cloud.extra["offset_ns"].tolist() == [-3_000_000, -2_000_000, -1_000_000, 0, 1_000_000]
    assert cloud.intensity.tolist() == [1.0] * 5
    assert frame.time_ns == 1644845012_250_000_000
    assert len(Zod(root, own_car=True)[1].cloud().points_m) == 6
    assert frame.conditions == {"time": "day", "weather": "rain", "road": "city"}


def test_boxes_turn_with_the_axes_and_hold_their_points(root):
    frame = open_dataset(root)[1]
    boxes = frame.boxes
    assert boxes.label.tolist() == ["vehicle", "bicycle", "unknown", "unknown"]
    assert frame.annotation.original_label == ("Vehicle_Car", "VulnerableVehicle_Bicycle", "Pedestrian", "PoleObject")
    np.testing.assert_allclose(boxes.centre_m[0], (30.0, -2.2, -1.0))
    np.testing.assert_allclose(boxes.yaw_rad[:2], [0.0, -np.pi / 2], atol=1e-9)
    np.testing.assert_allclose(boxes.size_m[0], (4.5, 2.0, 1.6))
    assert count_points_in_boxes(frame.cloud().points_m, boxes).tolist() == [5, 0, 0, 0]
    details = frame.annotation.details
    assert details["unclear"].tolist() == [False, False, True, False]
    assert details["with_rider"].tolist() == [-1, 1, -1, -1]
    assert details["occlusion"].tolist() == ["Light", "", "", ""]
    assert Zod(root, classes="zod")[1].boxes.label.tolist()[:1] == ["Vehicle_Car"]


def test_objects_of_the_picture_alone_are_counted_and_said(root):
    frame = open_dataset(root)[1]
    assert frame.metadata["image_only"] == "2 of 6 objects have no box in 3D"
    np.testing.assert_array_equal(frame.annotation.unboxed["image_only_px"], [[10, 15, 50, 40]] * 2)
    assert frame.annotation.unboxed["image_only_label"] == ("Vehicle_Van", "Inconclusive")


def test_sweeps_round_the_key_have_poses_and_the_camera_a_place(root):
    data = open_dataset(root)
    drive = data.drives()[0]
    np.testing.assert_allclose(np.diff(drive.times_ns), 1e8)
    # The LiDAR stands 1 m ahead of the car's origin, which drives 20 m/s along x; its frame's axes are the car's.
    np.testing.assert_allclose(drive.world_T_frame[:, :3, 3], [(-1, 0, 2), (1, 0, 2), (3, 0, 2)], atol=1e-5)
    np.testing.assert_allclose(drive.world_T_frame[1][:3, :3], np.eye(3), atol=1e-9)
    assert data.before(1, 1).key == data[0].key
    assert data[0].images == {}
    frame = data[1]
    assert frame.images["front"].shape == (48, 64, 3)
    assert frame.cameras == {}
    place = frame.sensors["front"].frame_T_sensor
    np.testing.assert_allclose(place[:3, 3], (0.5, 0.0, -0.6), atol=1e-9)
    np.testing.assert_allclose(place[:3, 2], (1, 0, 0), atol=1e-9)
    assert frame.sensors["front"].time_ns == 1644845012_140_954_000
    assert frame.metadata["lens"]["distortion"] == [0.1] * 4
    assert "fisheye" in " ".join(text for _, text in data.remarks)


def test_a_single_frame_without_its_key_sweep_stops_no_other(root):
    folder = root / "single_frames/000008"
    gone = "000008_gone_2022-02-14T13:23:32.250000Z.npy"
    write(folder / "info.json", {"lidar_frames": {"velodyne": [{"filepath": gone}]}})
    data = open_dataset(root)
    assert [data.has_annotation(index) for index in range(5)] == [False, True, False, False, True]
    assert data.fingerprint()
    assert any("cannot be told of 1 single frame, such as 000008" in note for note in data.notes)
    with pytest.raises(DatasetError, match="middle sweep"):
        _ = data[3]


def test_parts_are_those_of_the_kits_records_where_there_are_no_splits_files(root):
    shutil.rmtree(root / "splits")
    record = {"timestamp": "2022-02-14", "annotations": {"lanes": [[1, 2], {"id": "x"}]}, "text": "a" * 200}
    parts = {"train": ["000009", "000007"], "val": [], "blacklisted": ["000008"]}
    parts["val"] = [f"{number:06}" for number in range(100_000, 130_000)]  # several windows
    path = root / "trainval-frames-full.json"
    write(path, {part: [{"id": name, **record} for name in names] for part, names in parts.items()})
    assert read_trainval(path) == parts
    data = open_dataset(root)
    assert set(data.split("train").sequences) == {"000007", "000009"}
    assert set(data.split("train", by="benchmark").sequences) == {"000007", "000009"}
    assert not len(data.split("val"))
    path.write_text('{"train" : [{"id": "000007"} , {"id": "8"}],\n"val": [ ]\n}\n')
    assert read_trainval(path) == {"train": ["000007", "000008"], "val": []}


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{", '{"train": [', '{"train": [{}]}', '{"train": [{"id": "../x"}]}', '{"train": [{"id": 7}]}',
        '{"train": [{"id": "7"} {"id": "8"}]}', '{"train": [,{"id": "7"}]}', '{"train": [{"id": "7"},]}',
        '{"train": [], "train": []}', '{"train": []} x', '{"train": [] "val": []}', '{"train": {"id": "7"}}',
        '{"train": [{"id": "7", "a": ' + "[" * 100_000, '{"train": [{"id": "7", "id": "8"}]}', "\xff",
    ],
)  # fmt: skip
def test_damaged_records_of_parts_are_refused(tmp_path, text):
    path = tmp_path / "trainval-frames-full.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(FileFormatError, match="lists of records"):
        read_trainval(path)


def test_names_of_disks_that_take_no_colon_are_read(root):
    folder = root / "single_frames/000007"
    listed = [f"lidar_velodyne/{path.name}" for path in sorted((folder / "lidar_velodyne").iterdir())]
    write(folder / "info.json", {"lidar_frames": {"velodyne": [{"filepath": name} for name in listed]}})
    expected = open_dataset(root)
    for path in [*folder.rglob("*.npy"), *folder.rglob("*.jpg")]:
        path.rename(path.with_name(path.name.replace(":", "_")))
    data = open_dataset(root)
    assert data.keys == expected.keys
    assert [data.has_annotation(index) for index in range(3)] == [False, True, False]
    assert data[1].sensors["front"].time_ns == expected[1].sensors["front"].time_ns


def test_parts_are_those_of_the_splits_files(root):
    data = open_dataset(root)
    for by in ("sequence", "benchmark"):
        assert {name: len(data.split(name, by=by)) for name in ("train", "val")} == {"train": 4, "val": 1}
    (root / "splits/frames_full_val.txt").write_text("000007\n")
    with pytest.raises(DatasetError, match="in both"):
        open_dataset(root).split("val")
    (root / "splits/frames_full_val.txt").write_text("../../etc\n")
    with pytest.raises(FileFormatError, match="number of a frame"):
        open_dataset(root).split("val")


def test_which_sweep_is_annotated_is_not_guessed(root):
    folder = root / "single_frames/000007"
    (folder / "lidar_velodyne" / NAMES[0]).unlink()
    with pytest.raises(DatasetError, match=r"info\.json"):
        _ = open_dataset(root)[0]
    listed = [{"filepath": f"single_frames/000007/lidar_velodyne/{name}", "time": "x"} for name in NAMES]
    write(folder / "info.json", {"id": "000007", "lidar_frames": {"velodyne": listed}})
    assert [open_dataset(root).has_annotation(index) for index in range(2)] == [True, False]
    (folder / "lidar_velodyne" / NAMES[1]).unlink()
    with pytest.raises(DatasetError, match="middle sweep"):
        _ = open_dataset(root)[0]


def spoiled(edit):
    objects = json.loads(json.dumps(OBJECTS))
    edit(objects[0]["properties"])
    return objects


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "list of features"),
        ([{}], "geometry"),
        (spoiled(lambda facts: facts.update(size_3d_length=0.0)), "positive sizes"),
        (spoiled(lambda facts: facts.update(size_3d_length="4")), "size_3d"),
        (spoiled(lambda facts: facts.pop("size_3d_width")), "size_3d"),
        (spoiled(lambda facts: facts.update(orientation_3d_qw=2.0)), "length 1"),
        (spoiled(lambda facts: facts.update(orientation_3d_qx=HALF, orientation_3d_qz=0.0)), "upright"),
        (spoiled(lambda facts: facts.update(location_3d={"coordinates": [1e9, 0, 0]})), "object 0"),
        (spoiled(lambda facts: facts.update(unclear="perhaps")), "True, False"),
        (spoiled(lambda facts: facts.update(with_rider=1)), "True, False"),
        (spoiled(lambda facts: facts.update({"class": "\n"})), "a class"),
    ],
)
def test_objects_that_cannot_be_are_refused_by_name(root, content, message):
    write(labels(root), content)
    with pytest.raises(FarfieldError, match=message):
        _ = open_dataset(root)[1].annotation


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (np.zeros((4, 6), np.float32), "fields"),
        (np.zeros(4, [field for field in FIELDS if field[0] != "timestamp"]), "fields"),
        (np.zeros(4, [(name, "<f4" if name == "intensity" else kind) for name, kind in FIELDS]), "fields"),
        (np.array([(1.0, 9.0, 0.0, 5_000_000_000, 1, 1)], FIELDS), "microseconds"),
        (np.array([(np.inf, 9.0, 0.0, 0, 1, 1)], FIELDS), "finite coordinates"),
    ],
)
def test_sweeps_of_other_columns_or_values_are_refused(root, rows, message):
    np.save(root / "single_frames/000007/lidar_velodyne" / NAMES[1], rows)
    with pytest.raises(FarfieldError, match=message):
        open_dataset(root)[1].cloud()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("calibration.json", {"FC": {"lidar_extrinsics": np.diag([1.0, 1, -1, 1]).tolist()}}, "a rotation"),
        ("calibration.json", {}, "calibration"),
        ("ego_motion.json", {**motion(), "timestamps": [KEY_S * 1e3] * 5}, "rising seconds"),
        ("ego_motion.json", {**motion(), "timestamps": [KEY_S] * 5}, "rising seconds"),
        ("ego_motion.json", {"poses": [], "timestamps": []}, "two or more"),
        ("metadata.json", [], "object"),
    ],
)
def test_damaged_calibration_and_motion_are_named(root, name, content, message):
    write(root / "single_frames/000007" / name, content)
    with pytest.raises(FileFormatError, match=message):
        _ = open_dataset(root)[1].world_T_frame


def test_times_of_names_and_options():
    assert time_of_name(Path("000000_quebec_2022-02-14T13:23:32_251875Z.npy")) == 1644845012_251_875_000
    assert time_of_name(Path("000000_quebec_2022-02-30T13:23:32_251875Z.npy")) is None
    assert time_of_name(Path("000000.npy")) is None
    with pytest.raises(ConfigError, match="classes"):
        Zod("nowhere", classes="kitti")


def test_objects_damaged_at_random_are_refused_or_read_but_nothing_else(root):
    rng, whole = np.random.default_rng(0), json.dumps(OBJECTS).encode()
    outcomes = {"read": 0, "refused": 0}
    frame = open_dataset(root)[1]
    for number in range(300):
        data = bytearray(whole)
        for place in rng.integers(len(data), size=2):
            data[place] = rng.integers(32, 127)
        labels(root).write_bytes(data if number % 10 else data[: rng.integers(len(data))])
        try:
            frame.load_annotation()
            outcomes["read"] += 1
        except FarfieldError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 10
