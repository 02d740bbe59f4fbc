import json

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.folder import read_boxes, write_boxes
from farfield.datasets.splits import assign_splits
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.clouds import write_bin, write_cache
from farfield.files.pcd import write_pcd
from farfield.files.xyz import write_xyz
from farfield.frame import Boxes
from farfield.vocabulary.classes import CIRRUS_CLASSES, KITTI_FROM_CIRRUS, normalised_class


@pytest.fixture
def rows(rng) -> np.ndarray:
    return np.round(rng.uniform([0, -9, -2, 0], [50, 9, 2, 1], (20, 4)), 4).astype(np.float32)


@pytest.fixture
def folder(tmp_path, rows):
    columns = dict(zip(("x", "y", "z", "intensity"), rows.T, strict=True))
    write_pcd(tmp_path / "a.pcd", columns)
    write_bin(tmp_path / "b.bin", rows)
    np.save(tmp_path / "c.npy", rows)
    write_xyz(tmp_path / "d.xyz", np.column_stack([rows, np.zeros(20)]))
    write_cache(tmp_path / "e.ffcloud", columns)
    boxes = Boxes(
        centre_m=np.array([[10.0, 0, 0]]),
        size_m=np.array([[4.0, 2, 1.5]]),
        yaw_rad=np.array([0.3]),
        label="vehicle",
        track_id=np.array([0]),
    )
    write_boxes(tmp_path / "b.json", boxes)
    return tmp_path


def test_every_cloud_format_gives_the_same_cloud(folder, rows):
    data = open_dataset(folder)
    assert data.name == "folder"
    assert data.frame_ids == ("a", "b", "c", "d", "e")
    for frame in data:
        np.testing.assert_allclose(frame.cloud().points_m, rows[:, :3], atol=1e-6)
        np.testing.assert_allclose(frame.cloud().intensity, rows[:, 3], atol=1e-6)
    assert data[0].boxes is None
    assert data[1].boxes.track_id.tolist() == [0]


def test_boxes_round_trip(tmp_path, rng):
    boxes = Boxes(
        centre_m=rng.normal(size=(5, 3)),
        size_m=rng.uniform(1, 2, (5, 3)),
        yaw_rad=rng.uniform(-3, 3, 5),
        label=list("abcde"),
        score=rng.random(5),
    )
    write_boxes(tmp_path / "x.json", boxes)
    got = read_boxes(tmp_path / "x.json")
    for name in ("centre_m", "size_m", "yaw_rad", "score"):
        np.testing.assert_array_equal(getattr(got, name), getattr(boxes, name))
    assert got.label.tolist() == boxes.label.tolist()
    write_boxes(tmp_path / "empty.json", Boxes.empty())
    assert len(read_boxes(tmp_path / "empty.json")) == 0


@pytest.mark.parametrize(
    "change",
    [
        {"size_m": [1, 0, 1]},
        {"yaw": 1},
        {"centre_m": [1, 2]},
        {"yaw_rad": "NaN"},
        {"label": 3},
        {"velocity_m_s": [1]},
        {"velocity_m_s": [1, 2, "NaN"]},
        {"velocity_m_s": [1, None]},
    ],
)
def test_wrong_boxes_are_named(tmp_path, change):
    box = {"label": "vehicle", "centre_m": [1, 2, 3], "size_m": [1, 1, 1], "yaw_rad": 0.0} | change
    (tmp_path / "x.json").write_text(json.dumps({"boxes": [box]}))
    with pytest.raises(FileFormatError, match=f"boxes.0.{next(iter(change))}"):
        read_boxes(tmp_path / "x.json")


@pytest.mark.parametrize("axes", [2, 3])
def test_velocities_round_trip_and_unknown_ones_are_left_out(tmp_path, rng, axes):
    velocity = rng.normal(0, 9, (3, axes))
    velocity[1] = np.nan
    boxes = Boxes(centre_m=np.zeros((3, 3)), size_m=np.ones((3, 3)), yaw_rad=np.zeros(3), velocity_m_s=velocity)
    write_boxes(tmp_path / "x.json", boxes)
    np.testing.assert_array_equal(read_boxes(tmp_path / "x.json").velocity_m_s, velocity)
    entries = json.loads((tmp_path / "x.json").read_text())["boxes"]
    assert ["velocity_m_s" in entry for entry in entries] == [True, False, True]
    write_boxes(tmp_path / "y.json", boxes.plain())
    assert read_boxes(tmp_path / "y.json").velocity_m_s is None
    assert "velocity" not in (tmp_path / "y.json").read_text()
    entries[0]["velocity_m_s"], entries[2]["velocity_m_s"] = [1, 2], [1, 2, 3]
    (tmp_path / "z.json").write_text(json.dumps({"boxes": entries}))
    with pytest.raises(FileFormatError, match="as many numbers in every velocity_m_s"):
        read_boxes(tmp_path / "z.json")


def test_two_clouds_of_one_stem_are_refused(folder, rows):
    write_bin(folder / "a.bin", rows)
    with pytest.raises(DatasetError, match="stem 'a'"):
        open_dataset(folder)


def test_pickles_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{"x": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match="fields of numbers, found numbers of dtype object"):
        open_dataset(tmp_path)[0].cloud()


def test_nothing_recognised_lists_what_was_looked_for(tmp_path):
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(DatasetError) as caught:
        open_dataset(tmp_path)
    for words in ("notes.txt", "cirrus", "kitti", "argoverse2", "folder", "farfield formats NAME"):
        assert words in str(caught.value)
    with pytest.raises(DatasetError, match="found nothing"):
        open_dataset(tmp_path / "absent")
    with pytest.raises(ConfigError, match="data set format, one of cirrus"):
        open_dataset(tmp_path, format="no-such-set")


def test_unknown_options_are_errors(folder):
    with pytest.raises(ConfigError, match="bin_colums"):
        open_dataset(folder, bin_colums=5)


def test_turned_frames_see_the_same_from_behind(folder):
    data = open_dataset(folder, rotate_deg=180)
    plain = open_dataset(folder)
    np.testing.assert_allclose(data[1].cloud().points_m[:, :2], -plain[1].cloud().points_m[:, :2], atol=1e-5)
    np.testing.assert_allclose(data[1].boxes.centre_m, plain[1].boxes.centre_m * [-1, -1, 1], atol=1e-9)
    assert data[1].boxes.yaw_rad[0] == pytest.approx(0.3 - np.pi)
    assert data[0].boxes is None
    assert data.fingerprint() != plain.fingerprint()
    quarter = open_dataset(folder).turned(90.0)[1]
    np.testing.assert_allclose(quarter.boxes.centre_m[0], [0, 10, 0], atol=1e-9)


def test_selection_indexing_and_fingerprint(folder):
    data = open_dataset(folder)
    part = data.select([3, -1])
    assert part.frame_ids == ("d", "e")
    assert part[-1].frame_id == "e"
    assert [frame.frame_id for frame in part.select([1])] == ["e"]
    with pytest.raises(IndexError):
        data[5]
    with pytest.raises(IndexError):
        data.select([5])
    before = data.fingerprint()
    assert before == open_dataset(folder).fingerprint()
    assert part.fingerprint() != before
    (folder / "e.json").write_text('{"boxes": []}')
    assert open_dataset(folder).fingerprint() != before


def test_split_of_one_sequence_asks_for_a_decision(folder):
    data: Dataset = open_dataset(folder)
    with pytest.raises(DatasetError, match="by='time'"):
        data.split("train")
    parts = [data.split(name, by="time").frame_ids for name in ("train", "val", "test")]
    assert tuple(name for part in parts for name in part) == data.frame_ids


def test_sequences_are_dealt_out_whole_and_near_the_shares(tmp_path):
    units = [f"segment_{i:02d}" for i in range(40) for _ in range(10)]
    parts = assign_splits(units, root=tmp_path)
    assert sorted([name for part in parts.values() for name in part]) == sorted(set(units))
    assert [len(parts[name]) for name in ("train", "val", "test")] == [28, 6, 6]
    assert all(len(part) == 1 for part in assign_splits(["a", "b", "c"], root=tmp_path).values())


def test_class_names_come_into_the_vocabulary():
    assert normalised_class("Wheeled Pedestrian", {}) == "wheeled_pedestrian"
    assert normalised_class("LARGE-VEHICLE", {}) == "large_vehicle"
    assert normalised_class("pkw", {"pkw": "vehicle"}) == "vehicle"
    assert normalised_class("Submarine", {}) == "Submarine"
    assert set(KITTI_FROM_CIRRUS) == set(CIRRUS_CLASSES)
