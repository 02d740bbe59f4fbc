"""PandaSet's scenes, made by hand from the devkit's description: world coordinates, y forward, two LiDARs."""

import json

import numpy as np
import pytest
from pickle_assembler import packed
from PIL import Image

from farfield.datasets import open_dataset
from farfield.datasets.pandaset import PandaSet
from farfield.datasets.tracks import track_number
from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError
from farfield.geometry.boxes import count_points_in_boxes

STAMPS = [1557539956.5, 1557539956.6, 1557539956.7]
YAW = 0.7  # of the car in the world, beyond the files' y axis
UUIDS = [f"{letter * 8}-0000-4000-8000-000000000000" for letter in "abcde"]


def position(number: int) -> np.ndarray:
    return np.array([4000.0 + number, -3000.0, 20.0])


def world_from_car(forward: float, left: float, up: float, number: int = 0) -> np.ndarray:
    """A place ahead of the car in the world, written without the reader's matrices: y of the files is forward."""
    ahead = np.array([-np.sin(YAW), np.cos(YAW), 0.0])
    to_left = np.array([-np.cos(YAW), -np.sin(YAW), 0.0])
    return position(number) + forward * ahead + left * to_left + [0.0, 0.0, up]


def pose(number: int, turn=None) -> dict:
    x, y, z = position(number)
    w, qz = np.cos(YAW / 2), np.sin(YAW / 2)
    heading = dict(zip("wxyz", turn or (w, 0.0, 0.0, qz), strict=True))
    return {"position": {"x": x, "y": y, "z": z}, "heading": heading}


CAR = [(20.0 + 0.1 * step, 3.0, 0.5) for step in range(8)]


def points(number: int) -> dict:
    places = [*CAR, (60.0, -5.0, 0.5), (61.0, -5.0, 0.5)]
    world = np.array([world_from_car(*place, number=number) for place in places])
    count = len(world)
    return {
        **{axis: world[:, column] for column, axis in enumerate("xyz")},
        "i": np.linspace(0.0, 255.0, count),
        "t": STAMPS[number] - np.linspace(0.1, 0.0, count),
        "d": np.array([0] * 8 + [1] * 2),
    }


def cuboids(number: int) -> dict:
    places = [(20.35, 3.0, 0.5), (60.5, -5.0, 0.5), (62.0, -5.0, 0.5), (30.0, 0.0, 1.0), (90.0, 9.0, 1.0)]
    world = np.array([world_from_car(*place, number=number) for place in places])
    return {
        "uuid": UUIDS,
        "label": ["Car", "Bus", "Bus", "Pedestrian with Object", "Cones"],
        "yaw": np.full(5, YAW),  # along the car's own heading: 0 is the world's y
        "stationary": np.array([True, False, False, False, True]),
        "camera_used": np.array([-1, 0, 0, 3, -1]),
        **{f"position.{axis}": world[:, column] for column, axis in enumerate("xyz")},
        "dimensions.x": np.array([2.0, 2.5, 2.5, 0.6, 0.4]),
        "dimensions.y": np.array([4.5, 12.0, 12.0, 0.7, 0.4]),
        "dimensions.z": np.array([1.6, 3.0, 3.0, 1.8, 1.0]),
        "attributes.object_motion": ["Parked", "Moving", "Moving", float("nan"), None],
        "cuboids.sensor_id": np.array([-1, 0, 1, 1, -1]),
        "cuboids.sibling_id": ["-", UUIDS[2], UUIDS[1], "f" * 36, "-"],
    }


@pytest.fixture
def root(tmp_path):
    scene = tmp_path / "set" / "042"
    for folder in ("lidar", "annotations/cuboids", "annotations/semseg", "camera/front_camera", "meta"):
        (scene / folder).mkdir(parents=True)
    for number in range(3):
        (scene / f"lidar/{number:02d}.pkl.gz").write_bytes(packed(points(number)))
        (scene / f"annotations/cuboids/{number:02d}.pkl.gz").write_bytes(packed(cuboids(number)))
        (scene / f"annotations/semseg/{number:02d}.pkl.gz").write_bytes(
            packed({"class": np.array([13] * 8 + [23] * 2)})
        )
        Image.new("RGB", (64, 48)).save(scene / f"camera/front_camera/{number:02d}.jpg")
    # The camera looks ahead from 1.5 m above the car: its z is the car's forward, its x right, its y down.
    ahead, right, down = world_from_car(1, 0, 0), world_from_car(0, -1, 0), world_from_car(0, 0, -1)
    rotation = np.column_stack([axis - position(0) for axis in (right, down, ahead)])
    w = np.sqrt(1 + np.trace(rotation)) / 2
    x, y, z = (rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1])
    turn = (w, x / (4 * w), y / (4 * w), z / (4 * w))
    poses = [pose(number, turn) for number in range(3)]
    for entry in poses:
        entry["position"]["z"] += 1.5
    write(scene / "camera/front_camera/poses.json", poses)
    write(scene / "camera/front_camera/timestamps.json", [stamp - 0.05 for stamp in STAMPS])
    write(scene / "camera/front_camera/intrinsics.json", {"fx": 40.0, "fy": 40.0, "cx": 32.0, "cy": 24.0})
    write(scene / "lidar/poses.json", [pose(number) for number in range(3)])
    write(scene / "lidar/timestamps.json", STAMPS)
    gps = {"lat": 37.7, "long": -122.4, "height": 3.0, "xvel": 0.1, "yvel": 0.2}
    write(scene / "meta/gps.json", [gps] * 3)
    return tmp_path / "set"


def write(path, content) -> None:
    path.write_text(json.dumps(content))


def test_both_lidars_stand_in_the_cars_coordinates_with_their_times_and_classes(root):
    data = open_dataset(root)
    assert data.name == "pandaset"
    assert data.keys == (("042", "00"), ("042", "01"), ("042", "02"))
    for number, frame in reversed(list(enumerate(data))):  # the last first: no offset is taken from what opens first
        near, far = frame.cloud("pandar64"), frame.cloud("pandargt")
        np.testing.assert_allclose(near.points_m, CAR, atol=1e-5)
        np.testing.assert_allclose(far.points_m, [(60, -5, 0.5), (61, -5, 0.5)], atol=1e-5)
        np.testing.assert_allclose(near.intensity[[0, 7]], [0.0, 7 / 9], atol=1e-6)
        np.testing.assert_allclose(near.extra["offset_ns"][0], -100_000_000, atol=1000)
        assert far.extra["offset_ns"][-1] == pytest.approx(0, abs=1000)
        assert set(near.extra["semseg"].tolist()) == {13}
        assert set(far.extra["semseg"].tolist()) == {23}
        assert frame.time_ns == pytest.approx(STAMPS[number] * 1e9, abs=1000)
        assert frame.reference == "ego"
        assert frame.metadata["gps"]["lat"] == 37.7


def test_boxes_head_as_the_car_and_hold_their_points(root):
    frame = open_dataset(root)[1]
    boxes = frame.boxes
    np.testing.assert_allclose(boxes.yaw_rad, 0, atol=1e-9)
    np.testing.assert_allclose(boxes.centre_m[0], (20.35, 3.0, 0.5), atol=1e-6)
    np.testing.assert_allclose(boxes.size_m[0], (4.5, 2.0, 1.6))
    assert count_points_in_boxes(frame.cloud("pandar64").points_m, boxes)[0] == 8
    assert boxes.label.tolist() == ["vehicle", "large_vehicle", "pedestrian", "unknown"]
    assert frame.annotation.original_label == ("Car", "Bus", "Pedestrian with Object", "Cones")
    assert frame.annotation.moving.tolist() == [False, True, True, False]
    assert boxes.track_id.tolist() == [track_number(uuid) for uuid in (UUIDS[0], UUIDS[1], UUIDS[3], UUIDS[4])]
    assert frame.annotation.details["object_motion"].tolist() == ["Parked", "Moving", "", ""]
    assert frame.annotation.details["sensor_id"].tolist() == [-1, 0, 1, -1]


def test_of_an_object_with_two_boxes_that_of_one_lidar_is_read(root):
    """Only where both stand in the frame: the pedestrian's sibling does not."""
    taken = {name: PandaSet(root, boxes_of=name, classes="pandaset")[0].boxes for name in ("pandar64", "pandargt")}
    assert {name: len(boxes) for name, boxes in taken.items()} == {"pandar64": 4, "pandargt": 4}
    assert taken["pandar64"].centre_m[1][0] == pytest.approx(60.5)
    assert taken["pandargt"].centre_m[1][0] == pytest.approx(62.0)
    assert taken["pandargt"].label[1] == "Bus"
    with pytest.raises(ConfigError, match="boxes_of"):
        PandaSet(root, boxes_of="both")


def test_siblings_that_name_themselves_or_others_leave_one_box_an_object(root):
    table = cuboids(0)
    table["cuboids.sibling_id"] = [UUIDS[0], UUIDS[2], "-", UUIDS[1], "-"]
    (root / "042/annotations/cuboids/00.pkl.gz").write_bytes(packed(table))
    boxes = open_dataset(root)[0].boxes
    assert boxes.track_id.tolist() == [track_number(uuid) for uuid in (UUIDS[0], UUIDS[1], UUIDS[4])]


def test_the_camera_sees_the_car_where_it_stands(root):
    frame = open_dataset(root)[2]
    camera = frame.cameras["front_camera"]
    pixels, depth, visible = camera.project(np.array([[20.0, 0.0, 1.5], [20.0, 4.0, 0.5]]))
    np.testing.assert_allclose(pixels, [(32, 24), (32 - 40 * 4 / 20, 24 + 40 / 20)], atol=1e-4)
    np.testing.assert_allclose(depth, 20, atol=1e-6)
    assert visible.all()
    assert frame.images["front_camera"].shape == (48, 64, 3)
    assert frame.sensors["front_camera"].time_ns == pytest.approx((STAMPS[2] - 0.05) * 1e9, abs=1000)


def test_drives_have_times_and_poses(root):
    (drive,) = open_dataset(root / "042").drives()
    np.testing.assert_allclose(np.diff(drive.times_ns), 1e8, atol=1000)
    np.testing.assert_allclose(drive.world_T_frame[1][:3, 3], position(1))
    ahead = drive.world_T_frame[0] @ [1.0, 0, 0, 1]
    np.testing.assert_allclose(ahead[:3], world_from_car(1, 0, 0), atol=1e-9)


def change(column, values):
    return lambda table: {**table, column: values}


@pytest.mark.parametrize(
    ("kind", "edit", "message"),
    [
        ("lidar", change("d", np.full(10, 2)), "column d"),
        ("lidar", change("i", np.full(10, 256.0)), "column i"),
        ("lidar", change("i", np.full(10, -1.0)), "column i"),
        ("lidar", change("t", np.full(10, STAMPS[0] * 1e3)), "column t"),
        ("lidar", change("t", np.full(10, np.nan)), "column t"),
        ("lidar", change("x", np.full(10, np.inf)), "finite coordinates"),
        ("lidar", change("x", np.full(10, 5e6)), "metres from the sensor"),
        ("lidar", change("y", ["1"] * 10), "column y"),
        ("annotations/semseg", lambda table: {"class": np.full(9, 1)}, "one a point"),
        ("annotations/semseg", lambda table: {"class": np.full(10, 0.5)}, "column class"),
        ("annotations/cuboids", change("yaw", np.full(5, 90.0)), "radians"),
        ("annotations/cuboids", change("yaw", np.full(5, np.nan)), "radians"),
        ("annotations/cuboids", change("dimensions.x", np.zeros(5)), "positive sizes"),
        ("annotations/cuboids", change("dimensions.x", np.full(5, 4500.0)), "positive sizes"),
        ("annotations/cuboids", change("position.x", np.full(5, 1e9)), "a place"),
        ("annotations/cuboids", change("uuid", [UUIDS[0]] * 5), "one twice"),
        ("annotations/cuboids", change("label", ["Car", None, "", "Bus", "Bus"]), "column label"),
        ("annotations/cuboids", change("stationary", np.full(5, 2)), "column stationary"),
        ("annotations/cuboids", change("cuboids.sensor_id", np.full(5, 3)), "sensor_id"),
        ("annotations/cuboids", lambda table: {"uuid": table["uuid"]}, "column yaw"),
    ],
)
def test_values_beyond_their_range_are_refused_by_name(root, kind, edit, message):
    made = {"lidar": points(0), "annotations/cuboids": cuboids(0), "annotations/semseg": {}}[kind]
    (root / "042" / kind / "00.pkl.gz").write_bytes(packed(edit(made)))
    frame = open_dataset(root)[0]
    with pytest.raises(FarfieldError, match=message):
        _ = frame.cloud("pandar64") if kind != "annotations/cuboids" else frame.annotation


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("timestamps.json", [stamp * 1e3 for stamp in STAMPS], "seconds"),
        ("timestamps.json", STAMPS[::-1], "later time"),
        ("timestamps.json", STAMPS[:2], "one for each"),
        ("timestamps.json", {"0": 1}, "seconds"),
        ("poses.json", [pose(0)], "one for each|frame 1"),
        ("poses.json", [{}, {}, {}], "position"),
        ("poses.json", [pose(0, (0.0, 0.0, 0.0, 0.0))] * 3, "length 1"),
    ],
)
def test_damaged_poses_and_times_are_named(root, name, content, message):
    write(root / "042/lidar" / name, content)
    with pytest.raises(FileFormatError, match=message):
        _ = open_dataset(root)[2]


@pytest.mark.parametrize("name", ["lidar/timestamps.json", "camera/front_camera/poses.json"])
def test_poses_and_times_that_are_not_there_are_named(root, name):
    (root / "042" / name).unlink()
    with pytest.raises(DatasetError, match=name.rpartition("/")[2].partition(".")[0]):
        _ = open_dataset(root)[0]


def test_a_frame_without_boxes_is_not_annotated_and_other_folders_are_not_pandaset(root, tmp_path):
    (root / "042/annotations/cuboids/01.pkl.gz").unlink()
    data = open_dataset(root)
    assert [data.has_annotation(index) for index in range(3)] == [True, False, True]
    assert data[1].annotation is None
    assert "boxes_of" in " ".join(sentence for _, sentence in data.remarks)
    with pytest.raises(DatasetError, match=r"poses\.json"):
        PandaSet(tmp_path / "set" / "042" / "camera")


def test_the_boxes_of_a_real_scene_hold_points_of_the_lidar_that_they_were_drawn_for(shared_real):
    """Scene 002 of the devkit's repository at 9102b4d (test/data), where it lies at hand."""
    root = shared_real / "pandaset_002"
    if not root.is_dir():
        pytest.skip("no real scene at hand")
    frame = open_dataset(root)[0]
    assert {name: len(frame.cloud(name).points_m) for name in frame.clouds} == {"pandar64": 106_169, "pandargt": 60_599}
    near = np.linalg.norm(frame.boxes.centre_m[:, :2], axis=1) < 70
    counts = count_points_in_boxes(frame.cloud("pandar64").points_m, frame.boxes)
    assert (counts[near] >= 5).mean() > 0.85
    assert len(frame.boxes) == 92
