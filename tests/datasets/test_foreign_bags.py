"""Bags of ROS 1, of other encodings and of drivers' own types say what they are; an FMCW LiDAR is no radar."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")
import bag_messages as rosbag

from farfield import cli
from farfield.datasets import open_dataset
from farfield.errors import ConfigError, DatasetError, FileFormatError

MAGIC = b"\x89MCAP0\r\n"


def text(words: str) -> bytes:
    return len(words).to_bytes(4, "little") + words.encode()


def record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + len(content).to_bytes(8, "little") + content


def mcap(profile: str, encoding: str) -> bytes:
    """A file of one channel without messages."""
    header = record(1, text(profile) + text("a library"))
    channel = record(4, bytes([1, 0, 1, 0]) + text("/points") + text(encoding) + bytes(4))
    return MAGIC + header + channel + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


@pytest.mark.parametrize("data", [mcap("ros1", "ros1"), mcap("", "ros1"), b"#ROSBAG V2.0\n" + bytes(50)])
def test_ros_1_names_the_converter(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").write_bytes(data)
    with pytest.raises(FileFormatError, match="bag of ROS 1") as refused:
        open_dataset(tmp_path)
    assert "rosbags-convert" in refused.value.fix


@pytest.mark.parametrize("encoding", ["protobuf", "json", "flatbuffer"])
def test_other_encodings_are_named(encoding: str, tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").write_bytes(mcap("", encoding))
    with pytest.raises(FileFormatError, match=f"messages in {encoding}"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("data", [b"", b"not a bag at all", MAGIC[:4]])
def test_what_is_no_mcap_is_called_so(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").write_bytes(data)
    with pytest.raises(FileFormatError, match="MCAP's mark") as refused:
        open_dataset(tmp_path)
    assert "reindex" not in str(refused.value)


@pytest.mark.parametrize("as_mcap", [True, False])
def test_a_bag_without_clouds_names_the_kinds_that_it_holds(as_mcap: bool, tmp_path: Path) -> None:
    rows = [("/imu", rosbag.START + k, rosbag.imu(rosbag.START + k, 0.5)) for k in range(3)]
    rosbag.write_bag(tmp_path / "drive", rows, mcap=as_mcap)
    with pytest.raises(DatasetError, match=r"found /imu \(sensor_msgs/msg/Imu, 3 messages\)"):
        open_dataset(tmp_path / "drive")


def sweep(names: str, count: int) -> np.ndarray:
    table = np.zeros(count, np.dtype([(name, "<f4") for name in names.split()]))
    rng = np.random.default_rng(0)
    for name in table.dtype.names or ():
        table[name] = rng.uniform(0, 1, count) if name in ("intensity", "reflectivity") else rng.normal(0, 20, count)
    return table


def kind_of(tmp_path: Path, topic: str, names: str, count: int, **options: object) -> str:
    folder = tmp_path / "drive"
    if not folder.exists():
        message = rosbag.cloud(sweep(names, count), rosbag.START, "frame")
        rosbag.write_bag(folder, [(topic, rosbag.START, message)], mcap=True)
    sensors = open_dataset(folder, **options)[0].sensors
    return next(iter(sensors.values())).kind


@pytest.mark.parametrize(
    ("topic", "names", "count", "kind"),
    [
        ("/aeva/points", "x y z velocity intensity", 20_000, "lidar"),
        ("/aurora", "x y z doppler reflectivity line_index", 20_000, "lidar"),
        ("/front_lidar/points", "x y z velocity", 300, "lidar"),
        ("/ti_mmwave", "x y z intensity velocity", 60, "radar"),
        ("/ars548", "x y z range_rate rcs", 400, "radar"),
        ("/points", "x y z intensity", 20_000, "lidar"),
        ("/front_radar/points", "x y z intensity", 400, "radar"),
    ],
)
def test_what_took_a_cloud_is_decided_by_names_columns_and_number(
    topic: str, names: str, count: int, kind: str, tmp_path: Path
) -> None:
    assert kind_of(tmp_path, topic, names, count) == kind


def test_a_radars_intensity_is_a_column_in_its_own_unit(tmp_path: Path) -> None:
    """Decibels are negative too, and no flag brings them to [0, 1]: a radar's cloud has no intensity."""
    table = sweep("x y z velocity intensity", 60)
    table["intensity"] = np.linspace(-30, 12, 60)
    message = rosbag.cloud(table, rosbag.START, "frame")
    rosbag.write_bag(tmp_path / "drive", [("/ti_mmwave", rosbag.START, message)], mcap=True)
    cloud = open_dataset(tmp_path / "drive")[0].cloud()
    assert cloud.intensity is None
    np.testing.assert_array_equal(cloud.column("intensity"), table["intensity"])
    np.testing.assert_array_equal(cloud.column("velocity"), table["velocity"])
    with pytest.raises(FileFormatError, match="Write 0 where the strength is not known"):
        open_dataset(tmp_path / "drive", radars=("none",))[0].cloud()


def test_the_flag_overrules(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("/scan", "x y z velocity intensity", 60)
    assert kind_of(tmp_path, *words) == "radar"
    assert kind_of(tmp_path, *words, radars=("none",)) == "lidar"
    assert kind_of(tmp_path, *words, radars=("/scan",)) == "radar"
    with pytest.raises(ConfigError, match="expected topics of clouds"):
        kind_of(tmp_path, *words, radars=("/other",))
    cli.main(["doctor", str(tmp_path / "drive"), "--radars", "none"])
    assert "does not know" not in capsys.readouterr().err


def test_other_readers_refuse_the_flag(tmp_path: Path) -> None:
    (tmp_path / "0.xyz").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(ConfigError, match="does not know the option 'radars'"):
        open_dataset(tmp_path, radars=("none",))
