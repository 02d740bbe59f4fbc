"""Waymo's v2 components, written by pyarrow from the names of their classes; places by trigonometry and scipy."""

import io
import pickle

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from farfield.datasets import open_dataset
from farfield.datasets.tracks import track_number
from farfield.datasets.waymo import Waymo
from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError
from farfield.files import parquet
from farfield.geometry.boxes import count_points_in_boxes

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

NAME = "10023947602400723454_1120_000_1140_000"
STAMPS = [1552440195362591, 1552440195462613]
INCLINATION = [-0.3, -0.1, 0.0, 0.2]  # rows from the lowest; the image begins with the highest
HEIGHT, WIDTH = 4, 8
MOUNT = {1: (1.4, 0.0, 2.1, 2.5), 2: (4.0, 0.0, 0.7, 0.0), 5: (-1.2, 0.3, 0.9, 3.1)}  # x, y, z, yaw


def placed(x, y, z, yaw=0.0, pitch=0.0, roll=0.0):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    matrix[:3, 3] = x, y, z
    return matrix


def world(frame: int):
    return placed(860.5 + 2 * frame, 15568.0, -651.0, yaw=-0.8, pitch=0.01, roll=0.02)


def car_at_pixel(frame: int, column: int):
    """Roll, pitch, yaw, x, y, z of the car while it drives 1 m along its heading in a turn of the LiDAR."""
    x, y, z = (world(frame) @ [column / WIDTH, 0, 0, 1])[:3]
    return [0.02, 0.01, -0.8 + 0.02 * column, x, y, z]


def ranges(laser: int, frame: int, number: int):
    """Two pixels that returned: (1, 3) and (2, 6); one of them alone in the second return."""
    image = np.full((HEIGHT, WIDTH, 4), -1.0, dtype=np.float32)
    image[1, 3] = (10.0 + laser + frame, 0.5, 0.1, 1.0)
    if number == 1:
        image[2, 6] = (25.0, 3.0, 0.0, -1.0)
    return image


def direction(row: int, column: int):
    """Of a pixel in the car's axes: the first column looks just right of backwards, seen from the left."""
    azimuth = ((WIDTH - column - 0.5) / WIDTH * 2 - 1) * np.pi
    up = INCLINATION[::-1][row]
    return np.array([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)])


def at_its_moment(laser: int, row: int, column: int, distance: float):
    return np.array(MOUNT[laser][:3]) + distance * direction(row, column)


def expected_point(laser, frame, row, column, distance):
    point = at_its_moment(laser, row, column, distance)
    if laser != 1:
        return point
    roll, pitch, yaw, x, y, z = car_at_pixel(frame, column)
    in_world = placed(x, y, z, yaw, pitch, roll) @ [*point, 1]
    return (np.linalg.inv(world(frame)) @ in_world)[:3]


def image_columns(name, images):
    flat = pa.array([None if image is None else image.ravel().tolist() for image in images], pa.list_(pa.float32()))
    shapes = [None if image is None else list(image.shape) for image in images]
    return {f"{name}.values": flat, f"{name}.shape": pa.array(shapes, pa.list_(pa.int32(), 3))}


def keys(pairs, name, kind=None):
    return {
        "key.segment_context_name": pa.array([NAME] * len(pairs)),
        "key.frame_timestamp_micros": pa.array([STAMPS[frame] for frame, _ in pairs], pa.int64()),
        name: pa.array([other for _, other in pairs], kind or pa.int8()),
    }


def matrices(values):
    return pa.array([matrix.ravel().tolist() for matrix in values], pa.list_(pa.float64(), 16))


def boxes():
    """A box about the first pixel of LiDAR 2 in frame 1, one without points, and a sign of frame 0."""
    centre = expected_point(2, 1, 1, 3, 13.0)
    rows = [
        (1, "car", centre, 1, 2, 1),
        (1, "walker", centre + np.array([0, 30, 0]), 2, 0, 0),
        (0, "sign", centre, 3, 7, 2),
    ]
    table = keys([(frame, name) for frame, name, *_ in rows], "key.laser_object_id", pa.string())
    prefix = "[LiDARBoxComponent]."
    for axis, letter in enumerate("xyz"):
        table[f"{prefix}box.center.{letter}"] = pa.array([float(row[2][axis]) for row in rows])
        table[f"{prefix}box.size.{letter}"] = pa.array([(4.5, 2.0, 1.6)[axis]] * 3)
        table[f"{prefix}speed.{letter}"] = pa.array([(3.0, 4.0, 0.0)[axis], None, 0.0], pa.float64())
    table[f"{prefix}box.heading"] = pa.array([0.3, -3.1, 0.0])
    table[f"{prefix}type"] = pa.array([row[3] for row in rows], pa.int8())
    table[f"{prefix}num_lidar_points_in_box"] = pa.array([row[4] for row in rows], pa.int64())
    table[f"{prefix}num_top_lidar_points_in_box"] = pa.array([0, 0, 0], pa.int64())
    table[f"{prefix}difficulty_level.detection"] = pa.array([row[5] for row in rows], pa.int8())
    return table


def components():
    sweeps = [(1, 2), (0, 1), (1, 1), (0, 5), (0, 2), (1, 5)]  # in no order
    prefix = "[LiDARComponent].range_image_return"
    first = [ranges(laser, frame, 1) for frame, laser in sweeps]
    second = [ranges(laser, frame, 2) if laser == 2 else None for frame, laser in sweeps]
    tops = [(1, 1), (0, 1)]
    poses = [
        np.array([[car_at_pixel(frame, column) for column in range(WIDTH)]] * HEIGHT, np.float32) for frame, _ in tops
    ]
    picture = io.BytesIO()
    Image.new("RGB", (64, 48), (10, 200, 30)).save(picture, "JPEG")
    calibration = "[LiDARCalibrationComponent]."
    camera = "[CameraCalibrationComponent]."
    lens = {"f_u": 40.0, "f_v": 40.0, "c_u": 32.0, "c_v": 24.0, **dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0)}
    return {
        "vehicle_pose": {
            "key.segment_context_name": pa.array([NAME] * 2),
            "key.frame_timestamp_micros": pa.array(STAMPS, pa.int64()),
            "[VehiclePoseComponent].world_from_vehicle.transform": matrices([world(0), world(1)]),
        },
        "lidar": {
            **keys(sweeps, "key.laser_name"),
            **image_columns(f"{prefix}1", first),
            **image_columns(f"{prefix}2", second),
        },
        "lidar_pose": {
            **keys(tops, "key.laser_name"),
            **image_columns("[LiDARPoseComponent].range_image_return1", poses),
        },
        "lidar_calibration": {
            "key.segment_context_name": pa.array([NAME] * 3),
            "key.laser_name": pa.array(list(MOUNT), pa.int8()),
            f"{calibration}extrinsic.transform": matrices([placed(*mount) for mount in MOUNT.values()]),
            f"{calibration}beam_inclination.min": pa.array([-0.3, -0.4, -0.4]),
            f"{calibration}beam_inclination.max": pa.array([0.2, 0.4, 0.4]),
            f"{calibration}beam_inclination.values": pa.array([INCLINATION] * 3, pa.list_(pa.float64())),
        },
        "lidar_box": boxes(),
        "camera_calibration": {
            "key.segment_context_name": pa.array([NAME]),
            "key.camera_name": pa.array([1], pa.int8()),
            **{f"{camera}intrinsic.{name}": pa.array([value]) for name, value in lens.items()},
            f"{camera}extrinsic.transform": matrices([placed(1.5, 0.0, 2.0)]),
            f"{camera}width": pa.array([64], pa.int32()),
            f"{camera}height": pa.array([48], pa.int32()),
        },
        "camera_image": {
            **keys([(0, 1), (1, 1)], "key.camera_name"),
            "[CameraImageComponent].image": pa.array([picture.getvalue()] * 2, pa.binary()),
            "[CameraImageComponent].pose.transform": matrices([world(0), world(1) @ placed(1.0, 0, 0)]),
            "[CameraImageComponent].pose_timestamp": pa.array([stamp * 1e-6 + 0.03 for stamp in STAMPS]),
        },
        "stats": {
            "key.segment_context_name": pa.array([NAME] * 2),
            "key.frame_timestamp_micros": pa.array(STAMPS, pa.int64()),
            "[StatsComponent].time_of_day": pa.array(["Day", "Night"]),
            "[StatsComponent].location": pa.array(["location_sf"] * 2),
            "[StatsComponent].weather": pa.array(["sunny", "rain"]),
        },
    }


def write(root, component, columns, **options):
    (root / component).mkdir(parents=True, exist_ok=True)
    options = {"row_group_size": 2, **options}
    pq.write_table(pa.table(columns), root / component / f"{NAME}.parquet", **options)


@pytest.fixture
def root(tmp_path):
    for component, columns in components().items():
        write(tmp_path / "training", component, columns)
    return tmp_path


def test_points_stand_where_their_pixels_look_and_the_top_ones_are_moved_to_the_frames_moment(root):
    data = open_dataset(root)
    assert data.name == "waymo"
    assert data.keys == ((NAME, str(STAMPS[0])), (NAME, str(STAMPS[1])))
    for number in (1, 0):
        frame = data[number]
        assert list(frame.clouds) == ["lidar", "top", "front", "rear"]
        for name, laser in (("top", 1), ("front", 2), ("rear", 5)):
            cloud = frame.cloud(name)
            near, far = (1, 3, 10.0 + laser + number), (2, 6, 25.0)
            expected = [near, far, near] if laser == 2 else [near, far]
            places = [expected_point(laser, number, *pixel) for pixel in expected]
            np.testing.assert_allclose(cloud.points_m, places, atol=2e-3 if laser == 1 else 1e-4)
            np.testing.assert_allclose(cloud.extra["range_m"], [pixel[2] for pixel in expected])
            assert cloud.extra["return_number"].tolist() == ([1, 1, 2] if laser == 2 else [1, 1])
            assert cloud.extra["no_label_zone"].tolist()[:2] == [True, False]
            np.testing.assert_allclose(cloud.extra["elongation"][:2], [0.1, 0.0])
            np.testing.assert_allclose(cloud.extra["raw_intensity"][:2], [0.5, 3.0])
            np.testing.assert_allclose(cloud.intensity[:2], np.tanh([0.5, 3.0]), atol=1e-6)
        whole = frame.cloud("lidar")
        assert sorted(whole.extra["laser"].tolist()) == [1, 1, 2, 2, 2, 5, 5]
        assert frame.sensors["lidar"].holds == ("top", "front", "rear")
        np.testing.assert_allclose(frame.sensors["top"].frame_T_sensor, placed(*MOUNT[1]), atol=1e-9)


def test_what_the_rolling_shutter_is_worth_is_seen_without_it(root):
    corrected = open_dataset(root)[0].cloud("top").points_m
    raw = Waymo(root, pixel_poses=False)[0].cloud("top").points_m
    np.testing.assert_allclose(raw[0], at_its_moment(1, 1, 3, 11.0), atol=1e-4)
    assert np.linalg.norm(corrected - raw, axis=1).max() > 0.3
    assert any("1 m off" in text for _, text in Waymo(root, pixel_poses=False).remarks)


def test_boxes_hold_their_official_counts_and_their_speed_stands_in_the_cars_axes(root):
    frame = open_dataset(root)[1]
    assert frame.boxes.label.tolist() == ["vehicle", "pedestrian"]
    counts = count_points_in_boxes(frame.cloud().points_m, frame.boxes)
    np.testing.assert_array_equal(counts, frame.boxes.point_count)
    np.testing.assert_allclose(frame.boxes.yaw_rad, [0.3, -3.1])
    np.testing.assert_allclose(frame.boxes.velocity_m_s[0], world(1)[:3, :3].T @ [3, 4, 0])
    assert np.isnan(frame.boxes.velocity_m_s[1]).all()
    assert frame.annotation.details["detection_level"].tolist() == [1, 0]
    assert frame.annotation.details["tracking_level"].tolist() == [0, 0]
    assert frame.boxes.track_id.tolist() == [track_number("car"), track_number("walker")]
    assert Waymo(root, classes="waymo")[0].boxes.label.tolist() == ["Sign"]


@pytest.mark.parametrize("folder", ["", "training"])
def test_a_part_that_lies_there_alone_is_that_part(root, folder):
    data = open_dataset(root / folder)
    assert data.split_parts() == {"train": [NAME]}
    assert len(data.split("train")) == len(data.split("train", by="benchmark")) == 2
    with pytest.raises(ConfigError, match="one of train; got 'val'"):
        data.split("val")
    with pytest.raises(ConfigError, match="unpack validation/"):
        data.split("val", by="benchmark")
    (root / folder / "splits").mkdir()
    (root / folder / "splits/cirrus_v1.json").write_text(f'{{"val": ["{NAME}"]}}')
    assert len(open_dataset(root / folder).split("val")) == 2


def test_a_part_that_is_a_link_is_called_by_its_own_name(root, tmp_path):
    (root / "training").rename(tmp_path / "elsewhere")
    (root / "validation").symlink_to(tmp_path / "elsewhere")
    assert open_dataset(root).split_parts() == open_dataset(root / "validation").split_parts() == {"val": [NAME]}


def test_cameras_stand_where_the_car_was_when_the_picture_was_taken(root):
    data = open_dataset(root)
    for number, ahead_m in ((0, 0.0), (1, 1.0)):
        frame = data[number]
        camera = frame.cameras["camera_front"]
        pixels, depth, _ = camera.project(np.array([[21.5 + ahead_m, 2.0, 1.0]]))
        np.testing.assert_allclose(depth, 20, atol=1e-6)
        np.testing.assert_allclose(pixels[0], (32 - 40 * 2 / 20, 24 + 40 / 20), atol=1e-6)
        assert frame.images["camera_front"].shape == (48, 64, 3)
        assert frame.sensors["camera_front"].time_ns == pytest.approx(STAMPS[number] * 1000 + 30_000_000, abs=1000)
    assert data[1].conditions == {"time": "Night", "location": "location_sf", "weather": "rain"}


def test_drives_have_times_and_poses_frames_travel_and_folders_are_parts(root):
    (drive,) = open_dataset(root / "training").drives()
    assert drive.times_ns.tolist() == [stamp * 1000 for stamp in STAMPS]
    np.testing.assert_allclose(drive.world_T_frame, [world(0), world(1)])
    frame = pickle.loads(pickle.dumps(open_dataset(root)[0]))
    assert len(frame.cloud().points_m) == 7
    for component, columns in components().items():
        (root / "validation").mkdir(exist_ok=True)
        write(root / "validation", component, columns)
        path = root / "validation" / component / f"{NAME}.parquet"
        path.rename(path.with_name("other.parquet"))
    data = open_dataset(root)
    for by in ("sequence", "benchmark"):
        assert {name: len(data.split(name, by=by)) for name in ("train", "val")} == {"train": 2, "val": 2}
    (root / "splits").mkdir()
    (root / "splits/cirrus_v1.json").write_text('{"train": ["other"]}')
    assert data.split("train").sequences == ("other", "other")


def test_a_segment_in_two_parts_is_refused(root):
    for component, columns in components().items():
        (root / "validation").mkdir(exist_ok=True)
        write(root / "validation", component, columns)
    with pytest.raises(DatasetError, match="in two"):
        Waymo(root)


def edited(component, column, values):
    table = components()[component]
    return {**table, next(name for name in table if name.endswith(column)): values}


FLOATS = pa.list_(pa.float32())


@pytest.mark.parametrize(
    ("component", "column", "values", "message"),
    [
        ("vehicle_pose", "timestamp_micros", pa.array([stamp * 1000 for stamp in STAMPS]), "microseconds"),
        ("vehicle_pose", "timestamp_micros", pa.array([STAMPS[0]] * 2), "once"),
        ("vehicle_pose", "transform", matrices([world(0) * 2, world(1)]), "rigid"),
        ("vehicle_pose", "transform", matrices([world(0) * np.nan, world(1)]), "finite"),
        ("vehicle_pose", "transform", pa.array([[1.0] * 12] * 2), "16"),
        ("lidar", "laser_name", pa.array([1, 2, 3, 4, 5, 6], pa.int8()), "1 to 5"),
        ("lidar", "laser_name", pa.array([2, 1, 2, 1, 1, 1], pa.int8()), "once"),
        ("lidar", "return1.values", pa.array([[1.0] * 127] * 6, FLOATS), "shape"),
        ("lidar", "return1.values", pa.array([[np.nan] * 128] * 6, FLOATS), "finite ranges"),
        ("lidar", "return1.values", pa.array([[1.0, -2.0, 0.0, 0.0] * 32] * 6, FLOATS), "from 0 on"),
        ("lidar", "return1.shape", pa.array([[4, 8, 3]] * 6, pa.list_(pa.int32(), 3)), "shape"),
        ("lidar", "return1.shape", pa.array([[1 << 30, 8, 4]] * 6, pa.list_(pa.int32(), 3)), "shape"),
        ("lidar_pose", "return1.values", pa.array([[0.0] * 192] * 2, FLOATS), "within 50 m"),
        ("lidar_calibration", "inclination.values", pa.array([INCLINATION[::-1]] * 3), "rising"),
        ("lidar_calibration", "inclination.values", pa.array([[-30.0, -10.0, 0.0, 20.0]] * 3), "radians"),
        ("lidar_box", "heading", pa.array([90.0, 0.0, 0.0]), "radians"),
        ("lidar_box", "size.x", pa.array([0.0, 1.0, 1.0]), "possible box"),
        ("lidar_box", ".type", pa.array([9, 1, 1], pa.int8()), "possible box"),
        ("lidar_box", "num_lidar_points_in_box", pa.array([-5, 0, 0], pa.int64()), "possible box"),
        ("lidar_box", "speed.x", pa.array([1e6, 0.0, 0.0]), "possible box"),
        ("lidar_box", "object_id", pa.array(["a", "a", "a"]), "once"),
        ("lidar_box", "center.x", pa.array(["1", "2", "3"]), "numbers"),
        ("camera_image", "pose_timestamp", pa.array([1e3, 1e3]), "within a second"),
    ],
)
def test_values_beyond_their_range_are_refused_by_name(root, component, column, values, message):
    write(root / "training", component, edited(component, column, values))
    with pytest.raises(FarfieldError, match=message):
        _ = [(frame.cloud("lidar"), frame.annotation) for frame in open_dataset(root)]


def test_the_top_lidar_without_its_pixels_poses_is_refused_with_the_way_out(root):
    (root / f"training/lidar_pose/{NAME}.parquet").unlink()
    with pytest.raises(DatasetError, match="pixel_poses=False"):
        open_dataset(root)[0].cloud("top")
    assert len(Waymo(root, pixel_poses=False)[0].cloud("top").points_m) == 2


def test_a_component_that_is_not_there_is_named(root):
    (root / f"training/lidar_calibration/{NAME}.parquet").unlink()
    with pytest.raises(DatasetError, match="lidar_calibration"):
        _ = open_dataset(root)[0]


def test_repeated_values_that_unpack_to_much_are_refused_before_they_do(root, monkeypatch):
    """Pages of zeros that pack to a thousandth; the same file passes where more is allowed."""
    path = root / f"training/lidar/{NAME}.parquet"
    lists = pa.ListArray.from_arrays(
        pa.array(range(0, 700_000, 100_000), pa.int32()), pa.array(np.zeros(600_000, np.float32))
    )
    name = "[LiDARComponent].range_image_return1.values"
    pq.write_table(pa.table({**components()["lidar"], name: lists}), path, compression="zstd")
    assert path.stat().st_size < 20_000
    with pytest.raises(FileFormatError, match="shape"):
        open_dataset(root)[0].cloud("front")
    monkeypatch.setattr(parquet, "MAX_BYTES", 1 << 20)
    parquet._size_of.cache_clear()
    with pytest.raises(FileFormatError, match=r"unpacked|pages of"):
        open_dataset(root)[0].cloud("front")


def test_damaged_files_are_refused_or_read_but_nothing_else(root):
    rng = np.random.default_rng(0)
    outcomes = {"read": 0, "refused": 0}
    for number in range(60):
        component = ("lidar", "lidar_box", "vehicle_pose", "lidar_calibration")[number % 4]
        path = root / f"training/{component}/{NAME}.parquet"
        whole = path.read_bytes()
        data = bytearray(whole)
        for place in rng.integers(len(data), size=3):
            data[place] = rng.integers(256)
        path.write_bytes(data if number % 5 else data[: rng.integers(len(data))])
        try:
            frame = open_dataset(root, format="waymo")[0]
            _ = frame.cloud("front"), frame.annotation
            outcomes["read"] += 1
        except FarfieldError:
            outcomes["refused"] += 1
        path.write_bytes(whole)
    assert outcomes["refused"] > 10
