"""OpenPCDet's and mmdetection3d's custom sets: columns, what z is, lists, labels that do not parse, writing them."""

import random
from pathlib import Path

import numpy as np
import pytest
from openpcdet_tree import CAR, NAMES, TRUCK, rows, write_openpcdet

from farfield.datasets import open_dataset
from farfield.datasets.convert import convert, verify
from farfield.datasets.openpcdet import OpenPcdet, height_votes
from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError
from farfield.files.openpcdet import format_labels, read_frame_list, read_label_rows
from farfield.geometry.boxes import count_points_in_boxes


@pytest.mark.parametrize("bottom", [False, True])
@pytest.mark.parametrize("suffix", [".npy", ".bin"])
def test_frames_are_as_they_were_written(suffix: str, bottom: bool, tmp_path: Path) -> None:
    data = open_dataset(write_openpcdet(tmp_path / "custom", suffix=suffix, bottom=bottom))
    assert (type(data), data.name, len(data), set(data.sequences)) == (OpenPcdet, "openpcdet", 3, {"custom"})
    assert data.drives() == ()
    for number, frame in enumerate(data):
        np.testing.assert_array_equal(frame.cloud().points_m, rows(number)[:, :3])
        np.testing.assert_allclose(frame.cloud().intensity, rows(number)[:, 3])
        np.testing.assert_allclose(frame.boxes.centre_m, [CAR[:3], TRUCK[:3]], atol=1e-12)
        np.testing.assert_array_equal(frame.boxes.size_m, [CAR[3:6], TRUCK[3:6]])
        np.testing.assert_array_equal(frame.boxes.yaw_rad, [CAR[6], TRUCK[6]])
        assert list(frame.boxes.label) == ["vehicle", "large_vehicle"]
        assert list(frame.annotation.original_label) == list(NAMES)
        assert count_points_in_boxes(frame.cloud().points_m, frame.boxes).tolist() == [80, 60]
    sentences = " ".join(text for _, text in data.remarks)
    assert ("taken for its bottom" in sentences) == bottom


def test_the_flag_says_what_z_is(tmp_path: Path) -> None:
    root = write_openpcdet(tmp_path, suffix=".bin", bottom=True)
    assert open_dataset(root, label_axes="lidar")[0].boxes.centre_m[0, 2] == CAR[2] - CAR[5] / 2
    assert open_dataset(root, label_axes="lidar-bottom").remarks == ()
    with pytest.raises(ConfigError, match="label_axes: expected one of lidar, lidar-bottom"):
        open_dataset(root, label_axes="camera")


def test_boxes_that_show_both_are_refused(tmp_path: Path) -> None:
    root = write_openpcdet(tmp_path, suffix=".bin")
    label = root / "labels/000001.txt"
    lines = label.read_text().splitlines()
    x, y, z, *rest = lines[1].split()
    for number in range(3):
        moved = " ".join([x, y, str(float(z) - TRUCK[5] / 2), *rest])
        (root / f"labels/{number:06d}.txt").write_text(f"{lines[0]}\n{moved}\n")
    data = open_dataset(root)
    with pytest.raises(DatasetError, match=r"3 that show the centre and 3 the bottom.*--label-axes"):
        data[0].boxes  # noqa: B018 - reads
    assert len(open_dataset(root, label_axes="lidar")[0].boxes) == 2


def test_without_points_the_centre_is_taken_and_said(tmp_path: Path) -> None:
    root = write_openpcdet(tmp_path, suffix=".bin")
    for number in range(3):
        (root / f"labels/{number:06d}.txt").write_text("900 2 -1 4 2 1.5 0 Car\n")
    data = open_dataset(root)
    assert data[0].boxes.centre_m[0, 2] == -1
    assert any("no box has points that show it" in text for _, text in data.remarks)


def test_height_votes_by_hand() -> None:
    box = np.array([[0.0, 0.0, 1.0, 4.0, 2.0, 2.0, 0.0]])
    heights = np.linspace(0.05, 1.95, 40)
    points = np.column_stack([np.zeros((40, 2)), heights]).astype(np.float32)
    assert height_votes(points, box) == (0, 1)
    assert height_votes(points + np.float32([0, 0, 1]), box) == (1, 0)
    assert height_votes(points[:4], box) == (0, 0)


def test_columns_are_shown_by_the_numbers_or_told(tmp_path: Path) -> None:
    data = open_dataset(write_openpcdet(tmp_path / "five", suffix=".bin", columns=5))
    assert set(data[0].cloud().extra) == {"ring"}
    few = write_openpcdet(tmp_path / "few", suffix=".bin")
    for path in (few / "points").iterdir():
        path.write_bytes(path.read_bytes()[: 16 * 20])
    with pytest.raises(FileFormatError, match=r"how many a point has.*--columns"):
        open_dataset(few)
    assert len(open_dataset(few, bin_columns=4)[0].cloud()) == 20
    assert len(open_dataset(few, bin_columns=5)[0].cloud()) == 16


def test_lists_are_the_split(tmp_path: Path) -> None:
    root = write_openpcdet(tmp_path)
    data = open_dataset(root)
    assert data.split("train").frame_ids == ("000000", "000002")
    assert data.split("val", by="benchmark").frame_ids == ("000001",)
    with pytest.raises(ConfigError):
        data.split("test")
    (root / "ImageSets/val.txt").write_text("000000\n000009\n")
    (root / "labels/000007.txt").write_text("")
    (root / "labels/000002.txt").unlink()
    notes = " ".join(open_dataset(root).notes)
    assert "val.txt names 1 frame ('000009')" in notes
    assert "labels/ has 1 frame ('000007')" in notes
    assert "1 frame ('000002') without a file in labels/" in notes
    with pytest.raises(DatasetError, match=r"'000000' of train\.txt in no other list"):
        open_dataset(root).split("train")


def test_a_test_list_that_repeats_val_is_no_part(tmp_path: Path) -> None:
    root = write_openpcdet(tmp_path)
    (root / "ImageSets/test.txt").write_bytes((root / "ImageSets/val.txt").read_bytes())
    data = open_dataset(root)
    assert data.split("val").frame_ids == ("000001",)
    assert data.split("test", by="benchmark").frame_ids == ("000001",)
    with pytest.raises(ConfigError):
        data.split("test")
    assert any("test.txt repeats 1 frame of val.txt" in note for note in data.notes)


def test_a_long_list_of_one_name_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "train.txt"
    path.write_text("".join(f"{number:06d}\n" for number in range(200_000)) + "199999\n")  # hours, square in its length
    with pytest.raises(FileFormatError, match="'199999' twice"):
        read_frame_list(path)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 2 3 4 2 1.5 0.1", "7 words"),
        ("1 2 3 4 2 1.5 0.1 Big Car", "9 words"),
        ("1,2,3,4,2,1.5,0.1,Car", "1 words"),
        ("1, 2, 3, 4, 2, 1.5, 0.1, Car", "a number as x"),
        ("Car 0 0 0 1 2 3 4 1 1 1 1 1 1 0", "15 words"),
        ("1 2 3 4 2 nan 0.1 Car", "a number as dz"),
        ("1 2 3 4 2 1e999 0.1 Car", "a number as dz"),
        ("1 2 3 4 -2 1.5 0.1 Car", "positive sizes"),
        ("1 2 3 4 2 1.5 90 Car", "a yaw in radians"),
        ("1_0 2 3 4 2 1.5 0.1 Car", "a number as x"),
        ("1 2 3 4 2 1.5 0.1 7", "not a number"),
        ("1 2 3e7 4 2 1.5 0.1 Car", "a place within"),
    ],
)
def test_a_row_that_does_not_parse_is_refused_by_name(line: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "000003.txt"
    path.write_text(f"# x y z dx dy dz yaw name\n\n1 2 3 4 2 1.5 0.1 Car\n{line}\n")
    with pytest.raises(FileFormatError, match=f"000003.txt, line 4.*{words}"):
        read_label_rows(path)


def test_an_empty_file_is_no_box_and_numbers_keep_their_digits(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("")
    assert len(read_label_rows(path).names) == 0
    numbers = np.random.default_rng(0).uniform(0.1, 3, (5, 7))
    path.write_text(format_labels(numbers, ["Car"] * 5))
    np.testing.assert_array_equal(read_label_rows(path).numbers, numbers)
    for name in ("Big Car", "", "12", "a\tb"):
        with pytest.raises(ValueError, match="a class without blanks"):
            format_labels(numbers[:1], [name])


def test_converting_writes_what_is_read_again(tmp_path: Path) -> None:
    data = open_dataset(write_openpcdet(tmp_path / "custom", suffix=".bin", bottom=True))
    assert convert(data, tmp_path / "out", to="openpcdet").written == 3
    again = open_dataset(tmp_path / "out")
    for before, after in zip(data, again, strict=True):
        np.testing.assert_array_equal(before.cloud().points_m, after.cloud().points_m)
        np.testing.assert_array_equal(before.cloud().intensity, after.cloud().intensity)
        np.testing.assert_array_equal(before.boxes.centre_m, after.boxes.centre_m)
        assert list(before.boxes.label) == list(after.boxes.label)
    assert again.split("val").frame_ids == data.split("val").frame_ids
    assert np.load(tmp_path / "out/points/000000.npy").dtype == np.float32
    assert convert(data, tmp_path / "out", to="openpcdet").skipped == 3
    assert verify(data, tmp_path / "out", to="openpcdet") == []


def test_links_and_doubles_are_refused(tmp_path: Path) -> None:
    root = write_openpcdet(tmp_path)
    (root / "points/000000.bin").write_bytes(bytes(16))
    with pytest.raises(DatasetError, match="several of '000000'"):
        open_dataset(root)


def test_damaged_files_are_refused_and_nothing_else(tmp_path: Path) -> None:
    root = write_openpcdet(tmp_path)
    label, cloud, names = root / "labels/000000.txt", root / "points/000000.npy", root / "ImageSets/train.txt"
    whole = {path: path.read_bytes() for path in (label, cloud, names)}
    draw = random.Random(3)
    errors: list[tuple[str, str]] = []
    for _ in range(80):
        path = draw.choice([label, label, cloud, names])
        data = bytearray(whole[path])
        where = draw.randrange(min(len(data), 160))
        new = bytes(draw.randrange(256) for _ in range(draw.randrange(3)))
        path.write_bytes(bytes(data[:where]) + new + bytes(data[where + draw.randrange(9) :]))
        try:
            opened = open_dataset(root)
            opened[0].boxes  # noqa: B018 - reads
            opened[0].cloud()
            opened.split("train")
        except FarfieldError as error:
            errors.append((path.name, str(error)))
        path.write_bytes(whole[path])
    assert len(errors) > 40
    assert [pair for pair in errors if pair[0] not in pair[1] and "ImageSets" not in pair[1]] == []
