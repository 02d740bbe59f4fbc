"""Bags that rosbags wrote, read back: every layout of points, images, transforms; damaged ones are refused."""

import io
import json
import pickle
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("rosbags")
import bag_messages as rosbag

from farfield import cli
from farfield.datasets import open_dataset
from farfield.datasets.bags.reader import cloud_of
from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError, MissingExtraError
from farfield.files.bags import Bag
from farfield.files.sensor_messages import read_points
from farfield.frame import merge_clouds
from farfield.frame.cloud import CloudSettings

START, MS = rosbag.START, 1_000_000
OUSTER = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t", "ring"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 16, 20, 26],
        "itemsize": 48,
    }
)
RADAR = np.dtype([("doppler", "<f4"), ("z", "<f8"), ("y", "<f8"), ("x", "<f8")])


def points(dtype: np.dtype, count: int, rng: np.random.Generator) -> np.ndarray:
    table = np.zeros(count, dtype)
    for name in dtype.names:
        kind = dtype.fields[name][0]
        table[name] = rng.integers(0, 100, count) if kind.kind in "iu" else rng.normal(0, 50, count)
    if "intensity" in dtype.names:
        table["intensity"] = rng.uniform(0, 200, count)
    return table


@pytest.fixture(params=["db3", "mcap"])
def bag(request: pytest.FixtureRequest, tmp_path: Path, rng: np.random.Generator) -> Path:
    """Five sweeps at 10 Hz, a radar 30 ms later, cameras, an IMU; recorded 20 ms after they were taken."""
    static = rosbag.transforms(START, ("base", "lidar", (1, 0, 2), 0.0), ("base", "radar", (3, 0, 1), np.pi / 2))
    rows: list = [("/tf_static", START, static)]
    for k in range(5):
        at = START + k * 100 * MS
        rows.append(
            ("/os/points", at + 20 * MS, rosbag.cloud(points(OUSTER, 60, rng), at, "lidar", height=4, padding=8))
        )
        radar = rosbag.cloud(points(RADAR, 9, rng), at + 30 * MS, "radar", big=True)
        rows.append(("/radar", at + 50 * MS, radar))
        pixels = np.full((3, 4, 3), 10 * k, np.uint8)
        rows.append(("/left", at + 25 * MS, rosbag.image(pixels, at + 5 * MS, padding=4)))
        held = io.BytesIO()
        Image.fromarray(pixels).save(held, "png")
        rows.append(("/right", at + 26 * MS, rosbag.compressed(held.getvalue(), at + 90 * MS)))
        rows.append(("/tf", at + 21 * MS, rosbag.transforms(at, ("map", "base", (2.0 * k, 0, 0), 0.1 * k))))
        rows += [("/imu", at + j * 10 * MS, rosbag.imu(at + j * 10 * MS, 0.5)) for j in range(3)]
    return rosbag.write_bag(tmp_path / "drive", rows, mcap=request.param == "mcap")


def test_frames_hold_clouds_images_and_poses(bag: Path) -> None:
    data = open_dataset(bag)
    assert (data.name, len(data), set(data.sequences)) == ("bags", 5, {"drive"})
    frame = data[2]
    assert frame.reference == "os_points"
    assert frame.time_ns == START + 200 * MS
    assert {name: (s.kind, s.in_frame) for name, s in frame.sensors.items()} == {
        "os_points": ("lidar", True),
        "radar": ("radar", True),
        "left": ("camera", False),
        "right": ("camera", False),
    }
    assert frame.sensors["right"].time_ns == START + 190 * MS  # that of the frame before is nearer
    assert next(iter(frame.clouds)) == "os_points"
    cloud = frame.cloud()
    assert cloud.intensity is not None
    assert set(cloud.extra) == {"offset_ns", "ring"}
    assert cloud.extra["offset_ns"].dtype == np.int64
    np.testing.assert_array_equal(frame.images["left"], np.full((3, 4, 3), 20))
    np.testing.assert_array_equal(frame.images["right"], np.full((3, 4, 3), 10))
    lidar_T_radar = frame.sensors["radar"].frame_T_sensor
    assert lidar_T_radar is not None
    np.testing.assert_allclose(lidar_T_radar[:3, 3], [2, 0, -1])
    np.testing.assert_allclose(lidar_T_radar[:3, 0], [0, 1, 0], atol=1e-9)  # turned by a quarter to the left
    assert merge_clouds(frame, ["radar"]).columns == ("x_m", "y_m", "z_m", "doppler")
    assert frame.world_T_frame is not None
    expected = [4 + np.cos(0.2), np.sin(0.2), 2]  # the base's place and the lidar's in it
    np.testing.assert_allclose(frame.world_T_frame[:3, 3], expected)


def test_drives_have_times_and_poses_and_frames_pickle(bag: Path) -> None:
    data = pickle.loads(pickle.dumps(open_dataset(bag)))
    (drive,) = data.drives()
    assert drive.times_ns is not None
    np.testing.assert_array_equal(drive.times_ns, START + np.arange(5) * 100 * MS)
    assert drive.world_T_frame is not None
    again = pickle.loads(pickle.dumps(data[1]))
    np.testing.assert_array_equal(again.cloud().points_m, data[1].cloud().points_m)


def test_what_was_written_is_read_bit_for_bit(bag: Path) -> None:
    """Every message's bytes, and the points of the clouds."""
    opened = Bag(bag)
    read = list(opened.messages())
    assert len(read) == sum(topic.size for topic in opened.topics) == 41
    for topic, _, raw in read:
        message = opened.decode(topic, raw)
        again = rosbag.STORE.deserialize_cdr(raw, topic.kind)
        assert bytes(rosbag.STORE.serialize_cdr(again, topic.kind)) == raw
        if topic.name == "/os/points":
            columns = read_points(message, bag)
            assert [column.dtype.str for column in columns.values()] == ["<f4", "<f4", "<f4", "<f4", "<u4", "<u2"]


LAYOUTS = [(1, 0, False), (4, 0, False), (4, 5, False), (1, 0, True), (4, 7, True)]


@pytest.mark.parametrize(("height", "padding", "big"), LAYOUTS)
@pytest.mark.parametrize("dtype", [OUSTER, RADAR, np.dtype([("x", "i1"), ("y", "<i2"), ("z", "<i4"), ("i", "u1")])])
def test_every_layout_of_points(
    height: int, padding: int, big: bool, dtype: np.dtype, rng: np.random.Generator
) -> None:
    table = points(dtype, 12, rng)
    columns = read_points(rosbag.cloud(table, START, "lidar", height=height, padding=padding, big=big), "memory")
    assert list(columns) == list(dtype.names)
    for name in dtype.names:
        np.testing.assert_array_equal(columns[name], table[name])


def test_clouds_that_contradict_themselves_are_refused(rng: np.random.Generator) -> None:
    good = rosbag.cloud(points(OUSTER, 12, rng), START, "lidar")
    for name, value in (("width", 13), ("point_step", 20), ("height", 3), ("row_step", 1), ("point_step", 0)):
        message = rosbag.cloud(points(OUSTER, 12, rng), START, "lidar", height=2)
        setattr(message, name, value)
        with pytest.raises(FileFormatError, match="point cloud"):
            read_points(message, "memory")
    for height in (1, 2):
        message = rosbag.cloud(points(OUSTER, 12, rng), START, "lidar", height=height)
        message.data = np.concatenate([message.data, message.data])  # twice as many points as the header says
        with pytest.raises(FileFormatError, match="the sizes"):
            read_points(message, "memory")
    message = rosbag.cloud(points(OUSTER, 12, rng), START, "lidar")
    message.width = 10  # two points more stand in the row
    with pytest.raises(FileFormatError, match="the sizes"):
        read_points(message, "memory")
    good.fields[0].datatype = 9
    with pytest.raises(FileFormatError, match="7 f4"):
        read_points(good, "memory")
    good.fields[0].datatype, good.fields[1].name = 7, "x"
    with pytest.raises(FileFormatError, match="one of each"):
        read_points(good, "memory")


@pytest.mark.parametrize("name", ["intensity", "x", "normal"])
def test_a_field_of_several_numbers_is_split_or_refused_as_in_files(name: str, rng: np.random.Generator) -> None:
    """An intensity of two numbers a point was no intensity, without a word."""
    message = rosbag.cloud(
        points(np.dtype([(axis, "<f4") for axis in "xyz"] + [(name * 2, "<f8")]), 12, rng), START, "l"
    )
    message.fields[-1] = rosbag.make("sensor_msgs/msg/PointField", name=name, offset=12, datatype=7, count=2)
    message.fields = [field for field in message.fields[:3] if field.name != name] + message.fields[3:]
    if name == "normal":
        assert {*cloud_of(read_points(message, "memory"), "memory", CloudSettings()).extra} == {"normal_0", "normal_1"}
        return
    with pytest.raises(FileFormatError, match="COUNT 1"):
        cloud_of(read_points(message, "memory"), "memory", CloudSettings())


def test_columns_become_ours() -> None:
    columns = {name: np.array([1.0, np.nan, 3.0], np.float32) for name in "xyz"}
    columns["intensity"] = np.array([0, 5, 255], np.float32)
    cloud = cloud_of(columns, "memory", CloudSettings(intensity_scale=255.0))
    assert cloud.intensity is not None
    assert cloud.intensity.tolist() == [0, 1]
    with pytest.raises(FileFormatError, match="--intensity-scale 255"):
        cloud_of(columns, "memory", CloudSettings(intensity_scale=1.0))
    with pytest.raises(FileFormatError, match="x, y, z"):
        cloud_of({"x": columns["x"]}, "memory", CloudSettings())


def test_point_times_of_every_unit(tmp_path: Path) -> None:
    """Two sweeps whose points' times are milliseconds in float32, once beside a no-return that has none."""
    dtype = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f4")])
    table = np.zeros(50, dtype)
    table["x"], table["time"] = 5, np.linspace(0, 100, 50)
    table["x"][0], table["time"][0] = np.nan, -1e9
    rows = [("/points", START + k * 100 * MS, rosbag.cloud(table, START + k * 100 * MS, "lidar")) for k in range(3)]
    path = rosbag.write_bag(tmp_path / "drive", rows, mcap=True)
    offsets = open_dataset(path)[1].cloud().extra["offset_ns"]
    np.testing.assert_allclose(offsets, table["time"][1:] * MS, atol=10)
    kept = open_dataset(path, point_times="none")[1].cloud()
    assert list(kept.extra) == ["time"]


def test_an_intensity_that_grows_is_read_on_one_scale(tmp_path: Path) -> None:
    dtype = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("Reflectivity", "<f4")])
    rows = []
    for k, largest in enumerate((0.9, 100.0, 200.0)):
        table = np.zeros(50, dtype)
        table["x"], table["Reflectivity"] = 5, np.linspace(0, largest, 50)
        rows.append(("/points", START + k * 100 * MS, rosbag.cloud(table, START + k * 100 * MS, "lidar")))
    path = rosbag.write_bag(tmp_path / "drive", rows, mcap=True)
    largest = [frame.cloud().column("intensity").max() for frame in open_dataset(path)]
    np.testing.assert_allclose(largest, np.array([0.9, 100, 200]) / 255, rtol=1e-5)
    with pytest.raises(FileFormatError, match="--intensity-scale 200"):
        open_dataset(path, intensity_scale=100)[2].cloud()


def test_images_of_other_encodings(rng: np.random.Generator) -> None:
    from farfield.files.sensor_messages import read_ros_compressed, read_ros_image

    pixels = rng.integers(0, 255, (5, 4, 3)).astype(np.uint8)
    np.testing.assert_array_equal(read_ros_image(rosbag.image(pixels[:, :, ::-1], 0, encoding="bgr8"), "m"), pixels)
    grey = rosbag.image(pixels[:, :, :1], 0, encoding="mono8", padding=2)
    np.testing.assert_array_equal(read_ros_image(grey, "m")[:, :, 2], pixels[:, :, 0])
    with pytest.raises(FileFormatError, match="bayer"):
        read_ros_image(rosbag.image(pixels, 0, encoding="bayer_rggb8"), "m")
    short = rosbag.image(pixels, 0)
    short.height = 6
    with pytest.raises(FileFormatError, match="all there"):
        read_ros_image(short, "m")
    with pytest.raises(FileFormatError, match="depth"):
        read_ros_compressed(rosbag.compressed(b"", 0, kind="16UC1; compressedDepth png"), "m")
    with pytest.raises(FileFormatError, match="whole JPEG"):
        read_ros_compressed(rosbag.compressed(b"\x89PNG", 0), "m")


def test_imu_and_choices(bag: Path) -> None:
    data = open_dataset(bag, cloud="/radar", stamp="log")
    assert data[0].reference == "radar"
    assert data[0].time_ns == START + 50 * MS
    found = data.unwrapped.imu("drive")  # type: ignore[attr-defined]
    assert found["angular_rad_s"].shape == (15, 3)
    assert found["time_ns"][1] == START + 10 * MS
    with pytest.raises(ConfigError, match="/nothing"):
        open_dataset(bag, cloud="/nothing")


def test_a_bag_is_a_sound_data_set(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from farfield.testing import check_dataset

    check_dataset(open_dataset(bag))
    assert cli.main(["doctor", str(bag)]) in (0, 1)
    assert "bags" in capsys.readouterr().out


def test_a_missing_extra_is_named(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(MissingExtraError, match=r"\[bags\]"):
        open_dataset(bag)


def test_sync_reads_bags(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["sync", str(bag), "--to", "/os/points", "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"/left: 5 matched, [\d.]+ ms (later|earlier) than /os/points, worst 5\.000 ms", shown)
    assert re.search(r"/radar: 5 matched, [\d.]+ ms (later|earlier) than /os/points, worst 30\.000 ms", shown)


def test_times_of_recording_show_the_computers_clock(tmp_path: Path, rng: np.random.Generator) -> None:
    """A computer that runs 50 ppm fast and gets messages 3 ms late or later."""
    at = START + np.arange(600) * 100 * MS
    log = at + 3 * MS + ((at - START) * 50e-6).astype(np.int64) + (rng.exponential(2, 600) * MS).astype(np.int64)
    rows = [("/imu", int(late), rosbag.imu(int(taken), 0.0)) for taken, late in zip(at, log, strict=True)]
    rows += [("/other", int(taken) + 1, rosbag.imu(int(taken) + 5 * MS, 0.0)) for taken in at]
    path = rosbag.write_bag(tmp_path / "drive", rows, mcap=True)
    for stamp in ("header", "log"):
        arguments = ["sync", str(path), "--to", "/imu", "--stamp", stamp, "--out", str(tmp_path / stamp)]
        assert cli.main(arguments) == 0
    (found,) = json.loads((tmp_path / "header" / "sync.json").read_text())["recordings"]
    clock = found["arrivals"]["/imu"]
    assert clock["method"] == "hull"
    assert clock["drift_ppm"] == pytest.approx(50, abs=1)
    assert clock["offset_ns"] / MS == pytest.approx(3 + 50e-6 * 30_000, abs=0.1)
    assert found["pairs"]["/other"]["residual"]["mean_ms"] == pytest.approx(5)
    page = (tmp_path / "header" / "sync.html").read_text()
    assert "clock against it, ppm" in page
    assert f"{clock['drift_ppm']:+.3f} ±" in page
    (found,) = json.loads((tmp_path / "log" / "sync.json").read_text())["recordings"]
    assert found["arrivals"] == {}
    assert found["pairs"]["/other"]["residual"]["mean_ms"] < -3


def test_a_bag_that_is_cut_is_an_error(bag: Path, tmp_path: Path) -> None:
    """A lone file and the folder, cut at many places."""
    (file,) = [path for path in bag.iterdir() if path.suffix != ".yaml"]
    content = file.read_bytes()
    for part in (*range(0, len(content), max(len(content) // 40, 1)), len(content) - 1):
        for folder in (bag, tmp_path / "lone"):
            folder.mkdir(exist_ok=True)
            (folder / file.name).write_bytes(content[:part])
            with pytest.raises(FarfieldError):
                list(Bag(folder if folder == bag else folder / file.name).messages())
    file.unlink()
    with pytest.raises((FileFormatError, DatasetError)):
        open_dataset(bag)


def test_fewer_messages_than_said_are_an_error(bag: Path) -> None:
    metadata = bag / "metadata.yaml"
    text = metadata.read_text()
    assert "message_count: 15" in text
    metadata.write_text(text.replace("message_count: 15", "message_count: 16").replace("count: 41", "count: 42"))
    with pytest.raises(FileFormatError, match=r"topic /imu: expected 16 messages, found 15"):
        list(Bag(bag).messages())


def test_mutated_bags_give_messages_or_clear_errors(bag: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    (file,) = [path for path in bag.iterdir() if path.suffix != ".yaml"]
    content = file.read_bytes()
    outcomes = {"whole": 0, "refused": 0}
    target = tmp_path / f"mutated{file.suffix}"
    for _ in range(60):
        changed = bytearray(content)
        for place in rng.integers(0, min(len(changed), 20_000), int(rng.integers(1, 5))):
            changed[int(place)] = int(rng.integers(256))
        target.write_bytes(bytes(changed))
        try:
            opened = Bag(target)
            for topic, _, raw in opened.messages():
                opened.decode(topic, raw)
            outcomes["whole"] += 1
        except FarfieldError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 0


def test_several_bags_are_sequences(bag: Path) -> None:
    shutil.copytree(bag, bag.parent / "second")
    data = open_dataset(bag.parent)
    assert sorted(set(data.sequences)) == ["drive", "second"]
    assert len(data) == 10


def test_real_bags_of_ros2(shared_real: Path) -> None:
    folder = shared_real / "time" / "rosbag2_tests"
    counts = {
        path.name: sum(1 for _ in Bag(path).messages())
        for path in sorted(folder.iterdir())
        if path.suffix != ".yaml" and path.suffix != ".md"
    }
    assert sorted(counts.values()) == [13, 75, 150]


@pytest.mark.parametrize("mcap", [False, True])
def test_kitti_and_radiate_as_bags(shared_real: Path, tmp_path: Path, mcap: bool) -> None:
    """Real sweeps and real stamps, written as a bag and read back bit for bit."""
    from farfield.files.clouds import read_bin
    from farfield.files.radiate import read_times
    from farfield.files.stamps import read_stamps, recognise_stamps

    drive = shared_real / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0001_sync" / "velodyne_points"
    known = recognise_stamps(drive / "timestamps_start.txt")
    assert known is not None
    (starts,) = read_stamps(known)
    sweeps = [read_bin(path) for path in sorted((drive / "data").glob("*.bin"))[:3]]
    dtype = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
    rows = [
        ("/velodyne", int(at) + 10**8, rosbag.cloud(sweep.view(dtype)[:, 0], int(at), "velodyne"))
        for at, sweep in zip(starts, sweeps, strict=False)
    ]
    lists = shared_real / "time" / "radiate_tiny_foggy"
    for name in ("Navtech_Polar", "velo_lidar", "GPS_IMU_Twist"):
        stamps = read_times(lists / f"{name}.txt").values()
        rows += [(f"/{name}", at + place, rosbag.imu(at, 0.0)) for place, at in enumerate(stamps)]
    opened = Bag(rosbag.write_bag(tmp_path / "real", rows, mcap=mcap))
    sent: dict[str, list[bytes]] = {}
    for topic, _, message in sorted(rows, key=lambda row: row[1]):
        sent.setdefault(topic, []).append(bytes(rosbag.STORE.serialize_cdr(message, message.__msgtype__)))
    read: dict[str, list[bytes]] = {}
    for topic, _, raw in opened.messages():
        read.setdefault(topic.name, []).append(raw)
    assert read == sent
    for name in ("Navtech_Polar", "velo_lidar", "GPS_IMU_Twist"):
        header_ns = opened.stamps([f"/{name}"])[f"/{name}"].header_ns
        assert header_ns is not None
        assert sorted(header_ns.tolist()) == sorted(read_times(lists / f"{name}.txt").values())
    data = open_dataset(tmp_path / "real")
    for index, sweep in enumerate(sweeps):
        np.testing.assert_array_equal(data[index].cloud().points_m, sweep[:, :3])
        np.testing.assert_array_equal(data[index].cloud().intensity, sweep[:, 3])
