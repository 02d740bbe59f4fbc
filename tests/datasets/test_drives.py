"""Drives of every reader, of selections and of mapped data: known without building a frame."""

from pathlib import Path

import numpy as np
import pytest
from drive import frame as kradar_frame
from trees import car_label, write_delft, write_kitti, write_sequence, write_tree

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.cirrus import CirrusWriter
from farfield.datasets.kradar import KRadarWriter
from farfield.datasets.maps import Coordinates, Sweeps
from farfield.datasets.view_of_delft.reader import ViewOfDelft
from farfield.errors import DatasetError
from farfield.files.clouds import write_bin
from farfield.geometry.poses import invert, pose_from_yaw
from tests.datasets import test_cirrus
from tests.datasets.test_sweeps import Drive


def agree_with_frames(data: Dataset) -> None:
    """Keys, times and poses of the drives are those of their frames."""
    for drive in data.drives():
        frames = [data[int(index)] for index in drive.indices]
        assert drive.keys == tuple(frame.key for frame in frames)
        assert drive.name == frames[0].sequence
        if drive.times_ns is not None:
            assert drive.times_ns.tolist() == [frame.time_ns for frame in frames]
            assert (np.diff(drive.times_ns) > 0).all()
        if drive.world_T_frame is not None:
            np.testing.assert_allclose(drive.world_T_frame, np.stack([frame.world_T_frame for frame in frames]))


def without_frames(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make building a frame an error."""

    def refuse(self: Dataset, index: int) -> None:
        raise AssertionError(f"built frame {index}")

    monkeypatch.setattr(type(data.unwrapped), "frame", refuse)


def test_kradars_drives_have_times_and_poses(tmp_path, monkeypatch):
    writer = KRadarWriter(tmp_path)
    for sequence in ("2", "11"):
        for number in (1, 2, 3):
            pose = pose_from_yaw(0.1 * number, (3.0 * number, 0.0, 0.0))
            writer.write(kradar_frame(number, sequence=sequence, world_T_frame=pose))
    writer.finish()
    data = open_dataset(tmp_path)
    agree_with_frames(data)
    agree_with_frames(data.mapped(Coordinates("radar")))
    without_frames(data, monkeypatch)
    drives = open_dataset(tmp_path).drives()
    assert [(drive.name, len(drive.keys)) for drive in drives] == [("2", 3), ("11", 3)]
    assert all(drive.times_ns is not None and drive.world_T_frame is not None for drive in drives)
    assert all(drive.world_T_frame is None for drive in open_dataset(tmp_path, reference="radar").drives())


def test_cirrus_drives_are_its_segments(tmp_path, rng, monkeypatch):
    writer = CirrusWriter(tmp_path)
    for number, (name, gap_ns) in enumerate([("highway", 0), ("highway", 0), ("city", 20_000_000_000)]):
        writer.write(test_cirrus.make_frame(rng, number, sequence=name, gap_ns=gap_ns))
    data = open_dataset(tmp_path)
    agree_with_frames(data)
    without_frames(data, monkeypatch)
    assert [drive.indices.tolist() for drive in data.drives()] == [[0, 1], [2]]
    assert all(drive.times_ns is not None for drive in data.drives())


def test_kittis_shuffled_frames_are_no_drive(tmp_path):
    data = open_dataset(write_kitti(tmp_path))
    assert data.drives() == ()
    assert set(data.sequences) == {"training"}
    assert data.split_units() == data.frame_ids
    assert data.before(0, 1) is None
    with pytest.raises(DatasetError, match="shuffled"):
        data.split("train", by="time")
    assert data.select([0]).drives() == ()


def test_kittis_tracks_are_drives(tmp_path):
    (tmp_path / "label_02").mkdir()
    line = "{frame} 3 Car 0 0 -1 0 0 50 50 1.5 1.8 4.2 1 1.6 20 0\n"
    for name in ("0000", "0007"):
        text = "".join(line.format(frame=number) for number in (0, 2))
        (tmp_path / "label_02" / f"{name}.txt").write_text(text)
    data = open_dataset(tmp_path)
    agree_with_frames(data)
    assert [(drive.name, len(drive.keys)) for drive in data.drives()] == [("0000", 3), ("0007", 3)]
    assert data.drives()[0].times_ns is None


def test_a_folder_is_one_drive_by_file_name(tmp_path):
    for stem in ("1558131117608556768", "1558131117708556768"):
        write_bin(tmp_path / f"{stem}.bin", np.zeros((1, 4), np.float32))
    data = open_dataset(tmp_path)
    agree_with_frames(data)
    assert np.diff(data.drives()[0].times_ns).tolist() == [100_000_000]
    write_bin(tmp_path / "last.bin", np.zeros((1, 4), np.float32))
    (drive,) = open_dataset(tmp_path).drives()
    assert drive.times_ns is None
    assert drive.indices.tolist() == [0, 1, 2]


def test_radiates_times_come_from_its_list(tmp_path, monkeypatch):
    data = open_dataset(write_sequence(tmp_path / "fog_6_0"))
    agree_with_frames(data)
    without_frames(data, monkeypatch)
    assert np.diff(data.drives()[0].times_ns).tolist() == [250_000_000]


def test_argoverses_logs_have_times_and_poses(shared_real):
    pytest.importorskip("pyarrow")
    data = open_dataset(shared_real / "argoverse2")
    agree_with_frames(data)
    assert all(drive.times_ns is not None and drive.world_T_frame is not None for drive in data.drives())


def test_delfts_clips_have_nominal_times_where_asked(tmp_path):
    root = write_delft(tmp_path)
    tree = root / "lidar" / "training"
    for frame in ("00002", "00004"):
        cloud = np.array([[10.0, 1.0, 0.5, 51.0]])
        write_tree(tree, cloud, np.zeros(3), car_label(), frame)
    data = ViewOfDelft(root / "lidar")
    (drive,) = data.drives()
    assert (drive.name, drive.times_ns) == ("delft_1", None)
    with pytest.raises(DatasetError, match="no time"):
        data.mapped(Sweeps(2))[1]
    timed = open_dataset(root / "lidar", nominal_times=True)
    agree_with_frames(timed)
    np.testing.assert_allclose(np.diff(timed.drives()[0].times_ns) / 1e9, [1 / 13, 2 / 13], atol=1e-9)
    lag_s = timed.mapped(Sweeps(2))[2].cloud("lidar").extra["lag_s"]
    np.testing.assert_allclose(lag_s, [0.0, 2 / 13], rtol=1e-6)


def test_a_selection_has_its_part_of_each_drive_in_the_order_of_time():
    data = Drive().select([6, 3, 1, 3])
    assert [(drive.name, drive.indices.tolist()) for drive in data.drives()] == [("a", [2, 1, 3]), ("b", [0])]
    assert data.drives()[0].keys == (("a", "1"), ("a", "3"), ("a", "3"))
    assert {name: indices.tolist() for name, indices in data.drive_indices().items()} == {"a": [2, 1, 3], "b": [0]}
    assert data.select([1]).drives()[0].indices.tolist() == [0]
    agree_with_frames(data)


class Posed(Drive):
    """Drives that know their poses and times."""

    def _times_of(self, indices: np.ndarray) -> np.ndarray:
        return indices * 100_000_000

    def _poses_of(self, indices: np.ndarray) -> np.ndarray:
        return np.stack([self.pose(int(index)) for index in indices])


def test_maps_say_what_becomes_of_poses():
    agree_with_frames(Posed())
    moved = Posed().moved(pose_from_yaw(0.3, (1.0, 2.0, 3.0)))
    agree_with_frames(moved)
    np.testing.assert_allclose(
        moved.drives()[0].world_T_frame[1], Posed().pose(1) @ invert(pose_from_yaw(0.3, (1.0, 2.0, 3.0)))
    )
    agree_with_frames(moved.select([5, 2]).mapped(Sweeps(2)))
    assert moved.mapped(Sweeps(2)).select([3]).drives()[0].world_T_frame.shape == (1, 4, 4)


def test_annotations_come_without_frames_where_they_can(tmp_path, monkeypatch):
    write_bin(tmp_path / "a.bin", np.zeros((1, 4), np.float32))
    write_bin(tmp_path / "b.bin", np.zeros((1, 4), np.float32))
    (tmp_path / "a.json").write_text('{"boxes": []}')
    data = open_dataset(tmp_path)
    without_frames(data, monkeypatch)
    seen = data.select([1, 0]).mapped(Sweeps(3))
    assert [seen.has_annotation(index) for index in (0, 1)] == [False, True]
    assert seen.annotation(0) is None
    assert len(seen.annotation(1)) == 0


def test_annotations_of_moved_frames_are_moved():
    data = Drive().turned(180)
    np.testing.assert_array_equal(data.annotation(2).boxes.centre_m, data[2].boxes.centre_m)
    assert Path(data.files(2)[0]).name == "2.xyz"
