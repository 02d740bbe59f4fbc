"""What ``convert --to nuscenes`` and its dialect T4 write: read again the same, written again the same bytes."""

import json
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.convert import convert, losses, verify
from farfield.datasets.memory import InMemory
from farfield.datasets.nuscenes.writer import VERSION, SchemaExport, is_lag_of_file, written_clouds
from farfield.errors import DatasetError
from farfield.frame import Boxes, Cloud, Frame, Sensor

from .generators.nuscenes_trees import write_nuscenes

TABLES = 13


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    root = tmp_path_factory.mktemp("source") / "nuscenes"
    write_nuscenes(root)
    return root


def content(root):
    files = (path for path in sorted(root.rglob("*")) if path.is_file() and not path.name.startswith("."))
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in files}


@pytest.mark.parametrize("to", ["nuscenes", "t4"])
def test_frames_read_again_are_those_that_were_written(source, tmp_path, to):
    data = open_dataset(source)
    convert(data, tmp_path, to=to)
    again = open_dataset(tmp_path)
    assert again.name == to
    assert again.sequences == data.sequences
    for before, after in zip(data, again, strict=True):
        np.testing.assert_allclose(after.world_T_frame, before.world_T_frame, atol=1e-9)
        assert after.time_ns == before.time_ns
        order = np.argsort(before.boxes.centre_m[:, 0]), np.argsort(after.boxes.centre_m[:, 0])
        boxes, written = before.boxes[order[0]], after.boxes[order[1]]
        np.testing.assert_allclose(written.centre_m, boxes.centre_m, atol=1e-9)
        np.testing.assert_allclose(written.yaw_rad, boxes.yaw_rad, atol=1e-9)
        np.testing.assert_array_equal(written.size_m, boxes.size_m)
        np.testing.assert_array_equal(written.label, boxes.label)
        np.testing.assert_array_equal(written.point_count, boxes.point_count)
        np.testing.assert_allclose(written.velocity_m_s, boxes.velocity_m_s, atol=1e-9)
        for name in ("attribute", "visibility", "radar_points"):
            first, second = (side.annotation.details[name] for side in (before, after))
            assert first[order[0]].tolist() == second[order[1]].tolist()
        for name, cloud in before.clouds.items():
            np.testing.assert_allclose(after.clouds[name].points_m, cloud.points_m, atol=3e-5)
            assert after.sensors[name].time_ns == before.sensors[name].time_ns
            for column in {"ring", "rcs", "vx", "vy", "vx_comp", "invalid_state", "doppler_m_s"} & set(cloud.extra):
                np.testing.assert_allclose(after.clouds[name].extra[column], cloud.extra[column], atol=1e-4)


@pytest.mark.parametrize("to", ["nuscenes", "t4"])
def test_ages_of_points_that_are_not_those_of_their_file_are_said_to_be_lost(source, tmp_path, to):
    lost = {sweeps: losses(open_dataset(source, sweeps=sweeps), to) for sweeps in (1, 3)}
    columns = {
        sweeps: [name for loss in of if loss.item == "columns" for name in loss.names] for sweeps, of in lost.items()
    }
    assert "lag_s" not in columns[1]
    assert "lag_s" in columns[3]
    assert any("merged sweeps" in str(loss) for loss in lost[3])
    for sweeps in (1, 3):
        data = open_dataset(source, sweeps=sweeps).select([0])
        (frame,) = data
        convert(data, tmp_path / str(sweeps), to=to)
        again = open_dataset(tmp_path / str(sweeps))[0]
        for name, cloud in frame.clouds.items():
            same = np.allclose(cloud.extra["lag_s"], again.clouds[name].extra["lag_s"], atol=1e-5)
            assert same == is_lag_of_file(frame, name)


def test_bytes_are_the_same_again_and_after_an_interruption(source, tmp_path):
    data = open_dataset(source)
    first, second = tmp_path / "first", tmp_path / "second"
    convert(data, first, to="nuscenes")
    convert(data.select([0, 2]), second, to="nuscenes", overwrite=True)
    (second / VERSION / "sample.json").unlink()
    sorted((second / "samples" / "LIDAR_TOP").iterdir())[0].unlink()
    outcome = convert(data, second, to="nuscenes")
    assert outcome.written
    assert content(first) == content(second)
    assert convert(data, first, to="nuscenes").written == 0
    assert not verify(data, first, to="nuscenes")


def test_there_are_thirteen_tables_and_a_map_for_each_log(source, tmp_path):
    convert(open_dataset(source), tmp_path, to="nuscenes")
    tables = {path.stem: json.loads(path.read_text()) for path in (tmp_path / VERSION).glob("*.json")}
    assert len(tables) == TABLES + 1  # and the splits
    (row,) = tables["map"]
    assert set(row["log_tokens"]) == {log["token"] for log in tables["log"]}
    assert (tmp_path / row["filename"]).is_file()


def test_a_radar_file_has_a_byte_more_and_an_empty_one_a_point_of_nan(source, tmp_path):
    frame = open_dataset(source)[0]
    names = list(frame.clouds)
    radar = next(name for name in names if name.startswith("RADAR"))
    clouds = {name: cloud if name != radar else cloud[:0] for name, cloud in frame.clouds.items()}
    pose = np.eye(4)
    made = Frame(
        sequence="a",
        frame_id="0",
        time_ns=1_600_000_000_000_000_000,
        clouds=clouds,
        sensors=frame.sensors,
        load_annotation=frame.load_annotation,
        world_T_frame=pose,
    )
    convert(InMemory([made]), tmp_path, to="nuscenes")
    for path in (tmp_path / "samples").rglob("*.pcd"):
        body = path.read_bytes().split(b"DATA binary\n", 1)[1]
        assert len(body) % 43 == 1
    assert len(open_dataset(tmp_path)[0].clouds[radar]) == 0


def one(track_id, label, time_ns):
    boxes = Boxes(
        centre_m=np.array([[9.0, 1, 0]] * len(label)),
        size_m=np.ones((len(label), 3)),
        yaw_rad=np.zeros(len(label)),
        label=label,
        track_id=np.array(track_id),
    )
    cloud = Cloud(np.ones((3, 3), np.float32), np.zeros(3))
    return Frame.of(cloud, boxes, sequence="a", frame_id=str(time_ns), time_ns=time_ns, world_T_frame=np.eye(4))


@pytest.mark.parametrize(
    ("frames", "match"),
    [
        ([one([1, 1], ["vehicle", "vehicle"], 10**18)], "track once in a frame"),
        ([one([1], ["vehicle"], 10**18), one([1], ["pedestrian"], 2 * 10**18)], "of one class"),
        ([one([1], ["vehicle"], 10**18), one([1], ["vehicle"], 10**18 + 10)], "times that rise"),
    ],
)
def test_what_the_schema_cannot_hold_is_refused(tmp_path, frames, match):
    with pytest.raises(DatasetError, match=match):
        convert(InMemory(frames, in_order=True), tmp_path, to="nuscenes")


def test_the_command_writes_the_dialect_and_refuses_it_elsewhere(source, tmp_path, capsys):
    assert main(["convert", str(source), str(tmp_path / "t4"), "--to", "nuscenes", "--dialect", "t4"]) == 0
    assert "tokens are made anew" in capsys.readouterr().out
    assert open_dataset(tmp_path / "t4").name == "t4"
    assert main(["convert", str(source), str(tmp_path / "k"), "--to", "kitti", "--dialect", "t4"]) != 0


def test_a_merged_cloud_is_left_to_its_parts_and_the_top_lidar_is_the_top():
    cloud = Cloud(np.zeros((1, 3), np.float32), np.zeros(1, np.float32))
    frame = Frame(
        sequence="s",
        frame_id="0",
        clouds={"lidar": cloud, "front": cloud, "top": cloud},
        sensors={"lidar": Sensor(kind="lidar", holds=("front", "top"))},
    )
    assert written_clouds(frame) == ("front", "top")
    export = SchemaExport(dataset=InMemory([frame]), target=Path("out"), boxes="boxes", to="nuscenes")
    assert export.channels(frame) == {"top": "LIDAR_TOP", "front": "LIDAR_FRONT"}
