import json
import os

import numpy as np
import pytest
from street import street_frame

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.cirrus import CirrusWriter
from farfield.datasets.convert import _work, convert
from farfield.datasets.folder import write_boxes
from farfield.datasets.kradar.store import JOURNAL_NAME
from farfield.datasets.tool_export import cloud_bytes
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.boxes_csv import read_boxes_csv
from farfield.files.clouds import write_bin
from farfield.frame import Boxes
from farfield.frame.cloud import CACHE_FOLDER, cache_path
from farfield.jobs import run
from farfield.metrics import box_files


def test_cirrus_to_kitti_and_back_keeps_everything_that_kitti_holds(street_root, tmp_path):
    source = open_dataset(street_root)
    outcome = convert(source, tmp_path / "kitti", to="kitti")
    assert (outcome.written, outcome.skipped) == (3, 0)
    made = open_dataset(tmp_path / "kitti")
    assert made.name == "kitti"
    for got, want in zip(made, source, strict=True):
        np.testing.assert_array_equal(got.cloud().points_m, want.cloud().points_m)
        np.testing.assert_array_equal(got.cloud().intensity, want.cloud().intensity)
        np.testing.assert_allclose(got.boxes.centre_m, want.boxes.centre_m, atol=1e-9)
        np.testing.assert_allclose(got.boxes.size_m, want.boxes.size_m)
        np.testing.assert_allclose(got.boxes.yaw_rad, want.boxes.yaw_rad, atol=1e-9)
        assert got.boxes.label.tolist() == want.boxes.label.tolist()
    lines = (tmp_path / "kitti/frames.csv").read_text().splitlines()
    assert lines[1] == f"000000,segment_00,{source.frame_ids[0]}"
    convert(made, tmp_path / "back", to="cirrus")
    for got, want in zip(open_dataset(tmp_path / "back"), source, strict=True):
        np.testing.assert_array_equal(got.cloud().points_m, want.cloud().points_m)
        np.testing.assert_allclose(got.boxes.centre_m, want.boxes.centre_m, atol=1e-6)


def test_conversion_resumes_and_mends_what_is_damaged(street_root, tmp_path):
    source = open_dataset(street_root)
    convert(source.select([0, 1]), tmp_path / "kitti", to="kitti")
    outcome = convert(source, tmp_path / "kitti", to="kitti")
    assert (outcome.written, outcome.skipped) == (1, 2)
    damaged = tmp_path / "kitti/training/velodyne/000001.bin"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:-4] + b"\0\0\0\0")
    (tmp_path / "kitti/training/label_2/000002.txt").unlink()
    outcome = convert(source, tmp_path / "kitti", to="kitti")
    assert (outcome.written, outcome.skipped) == (2, 1)
    assert damaged.read_bytes() == whole
    assert convert(source, tmp_path / "kitti", to="kitti", overwrite=True).written == 3


@pytest.mark.parametrize("first", [1, 90_000])
def test_the_room_is_judged_by_frames_that_are_spread_over_the_set(tmp_path, first):
    (tmp_path / "data").mkdir()
    for number in range(9):
        np.save(tmp_path / "data" / f"{number}.npy", np.ones((first if number in (0, 1, 8) else 1000, 3), np.float32))
    data = open_dataset(tmp_path / "data")
    assert cloud_bytes(data, None) == 12 * 1000
    assert cloud_bytes(data.select([]), None) == 0
    assert (
        _work(data, tmp_path, "kitti", "boxes", None).disk_bytes
        == _work(data.select([3]), tmp_path, "kitti", "boxes", None).disk_bytes
    )
    assert _work(data, tmp_path, "cvat", "boxes", None).disk_bytes == 9 * 12 * 1000
    (tmp_path / "data" / "4.npy").write_bytes(b"damaged")
    assert cloud_bytes(open_dataset(tmp_path / "data"), None) == 12 * (1000 + first) / 2


def test_a_changed_source_is_converted_again(street_root, tmp_path):
    convert(open_dataset(street_root), tmp_path / "out", to="boxes-csv")
    label = next(street_root.glob("dataset1_annotation/*.json"))
    label.write_text(label.read_text().replace('"large_vehicle"', '"trailer"'))
    assert convert(open_dataset(street_root), tmp_path / "out", to="boxes-csv").written == 1
    assert "trailer" in read_boxes_csv(tmp_path / "out/segment_00.csv").label


@pytest.mark.parametrize("to", ["kitti", "cirrus", "boxes-csv", "openlabel", "sustechpoints", "cvat"])
def test_what_was_written_can_be_verified_byte_by_byte(to, street_root, tmp_path, capsys):
    command = ["convert", str(street_root), str(tmp_path / to), "--to", to]
    assert main([*command, "--workers", "1"]) == 0
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / to).rglob("*")}
    assert main([*command, "--verify"]) == 0
    assert "is intact" in capsys.readouterr().out
    entry = json.loads((tmp_path / to / JOURNAL_NAME).read_text().splitlines()[0])
    broken = tmp_path / to / max(entry["files"])
    data = broken.read_bytes()
    broken.write_bytes(data[:-2] + bytes([data[-2] ^ 1]) + data[-1:])
    os.utime(broken, ns=(1, 1))  # as if nothing had been touched
    assert main([*command, "--verify"]) == 1
    assert f"damaged or missing: {broken.relative_to(tmp_path / to).as_posix()}" in capsys.readouterr().err
    assert before.keys() == {*(tmp_path / to).rglob("*")}


def test_a_journal_cut_off_by_a_crash_is_no_obstacle_a_damaged_one_is_named(street_root, tmp_path):
    source = open_dataset(street_root)
    convert(source, tmp_path / "kitti", to="kitti")
    journal = tmp_path / "kitti/.farfield_convert.jsonl"
    text = journal.read_text()
    journal.write_text(text[:-20])
    outcome = convert(source, tmp_path / "kitti", to="kitti")
    assert (outcome.written, outcome.skipped) == (1, 2)
    journal.write_text("nonsense\n" + text)
    with pytest.raises(FileFormatError, match="line 1"):
        convert(source, tmp_path / "kitti", to="kitti")


def test_boxes_csv_holds_every_box(street_root, tmp_path):
    source = open_dataset(street_root)
    convert(source, tmp_path / "deep/labels.csv", to="boxes-csv")
    rows = read_boxes_csv(tmp_path / "deep/labels.csv")
    want = [frame.boxes for frame in source]
    np.testing.assert_array_equal(rows.centre_m, np.concatenate([boxes.centre_m for boxes in want]))
    np.testing.assert_array_equal(rows.yaw_rad, np.concatenate([boxes.yaw_rad for boxes in want]))
    assert set(zip(rows.sequence.tolist(), rows.frame.tolist(), strict=True)) == set(source.keys)
    assert rows.score is None


def test_boxes_csv_holds_velocities_where_a_frame_knows_them(tmp_path):
    boxes = Boxes(
        centre_m=np.zeros((1, 3)),
        size_m=np.ones((1, 3)),
        yaw_rad=np.zeros(1),
        velocity_m_s=np.array([[3.0, -1.0, 0.5]]),
    )
    for stem, each in (("a", boxes.plain()), ("b", boxes), ("c", Boxes.empty())):
        (tmp_path / "own").mkdir(exist_ok=True)
        write_bin(tmp_path / "own" / f"{stem}.bin", np.zeros((4, 4), dtype=np.float32))
        write_boxes(tmp_path / "own" / f"{stem}.json", each)
    convert(open_dataset(tmp_path / "own"), tmp_path / "labels.csv", to="boxes-csv")
    got = read_boxes_csv(tmp_path / "labels.csv")
    np.testing.assert_array_equal(got.velocity_m_s, [[np.nan] * 3, [3.0, -1.0, 0.5]])
    side = box_files.read(tmp_path / "labels.csv", tmp_path / "labels.csv")
    (key,) = [key for key in side.boxes if key[1] == "b"]
    np.testing.assert_array_equal(side.boxes[key].velocity_m_s, [[3.0, -1.0, 0.5]])
    np.testing.assert_array_equal(side.annotations[key].boxes.velocity_m_s, [[3.0, -1.0, 0.5]])


def test_full_boxes_can_be_asked_for(street_root, tmp_path):
    with pytest.raises(DatasetError, match="full_boxes"):
        convert(open_dataset(street_root), tmp_path / "x.csv", to="boxes-csv", boxes="full_boxes")


def dying(work, units, bulk):
    done = run(work, units, bulk)
    (units[0].parameters[0] / CACHE_FOLDER / ".a.xyz.ffcloud.0123456789ab.part").write_bytes(b"half")
    return done


def test_what_a_killed_worker_left_of_a_cache_is_swept_out(street_root, monkeypatch):
    monkeypatch.setattr("farfield.datasets.convert.run", dying)
    assert convert(open_dataset(street_root), to="cache").written == 3
    assert not list(street_root.rglob("*.part"))


def test_cache_is_written_once_and_read(street_root):
    source = open_dataset(street_root)
    before = source[0].cloud()
    assert convert(source, to="cache").written == 3
    assert convert(source, to="cache").skipped == 3
    sweep = source.entries[0].gaussian
    assert cache_path(sweep, street_root).is_file()
    after = open_dataset(street_root)[0].cloud()
    np.testing.assert_array_equal(before.points_m, after.points_m)
    np.testing.assert_array_equal(before.intensity, after.intensity)
    assert len(open_dataset(street_root.parent)) == 3  # the cache folder is no data set of its own


def test_split_is_carried_over_as_image_sets(tmp_path, rng):
    writer = CirrusWriter(tmp_path / "source")
    for number in range(4):
        writer.write(street_frame(rng, 100 * number))
    source = open_dataset(tmp_path / "source")
    assert len(set(source.sequences)) == 4
    convert(source, tmp_path / "kitti", to="kitti")
    made = open_dataset(tmp_path / "kitti")
    assert made.split("val").frame_ids == tuple(f"{source.keys.index(key):06d}" for key in source.split("val").keys)


def test_a_split_that_cannot_be_carried_over_is_said_before_anything_is_written(street_root, tmp_path):
    source = open_dataset(street_root)
    file = source.root / source.split_file
    file.parent.mkdir(exist_ok=True)
    file.write_text('{"train": ["segment_00"], "val": ["lacks"]}')
    with pytest.raises(DatasetError, match="names sequences that the data set lacks: lacks"):
        convert(open_dataset(street_root), tmp_path / "kitti", to="kitti")
    assert not (tmp_path / "kitti").exists()


def test_lists_of_train_and_val_alone_are_carried_over(street_root, tmp_path):
    convert(open_dataset(street_root), tmp_path / "one", to="kitti")
    lists = tmp_path / "one" / "ImageSets"
    lists.mkdir(exist_ok=True)
    (lists / "test.txt").unlink(missing_ok=True)
    (lists / "train.txt").write_text("000001\n")
    (lists / "val.txt").write_text("000000\n000002\n")
    convert(open_dataset(tmp_path / "one"), tmp_path / "two", to="kitti")
    assert sorted(path.name for path in (tmp_path / "two" / "ImageSets").iterdir()) == ["train.txt", "val.txt"]
    assert (tmp_path / "two" / "ImageSets" / "val.txt").read_text() == "000000\n000002\n"
    (lists / "val.txt").write_bytes(b"\xff000000\n")
    with pytest.raises(FileFormatError, match=r"val.txt, the list: expected numbers of frames, one a line"):
        convert(open_dataset(tmp_path / "one"), tmp_path / "three", to="kitti")
    assert not (tmp_path / "three").exists()


def test_wrong_targets_are_errors(street_root, tmp_path):
    source = open_dataset(street_root)
    with pytest.raises(ConfigError, match="expected a target folder"):
        convert(source, to="kitti")
    with pytest.raises(ConfigError, match="leave the target out"):
        convert(source, tmp_path / "elsewhere", to="cache")


def test_real_kitti_becomes_cirrus(shared_real, tmp_path):
    source = open_dataset(shared_real / "kitti")
    convert(source.select([1]), tmp_path, to="cirrus")
    got, want = open_dataset(tmp_path)[0], source[1]
    np.testing.assert_allclose(got.cloud().points_m, want.cloud().points_m, atol=6e-5)
    np.testing.assert_allclose(got.boxes.centre_m, want.boxes.centre_m, atol=1e-6)
    assert got.boxes.label.tolist() == want.boxes.label.tolist()
    np.testing.assert_allclose(got.cameras["camera"].camera_T_lidar, want.cameras["camera"].camera_T_lidar)
