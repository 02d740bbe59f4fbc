"""What stands in the place of a file is named by every reader, with the command that fetches the file itself."""

import gzip
import math
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.calibration import read_calibration
from farfield.datasets.cirrus.layout import read_mapping
from farfield.datasets.folder import read_boxes, read_class_mapping
from farfield.datasets.splits import read_parts
from farfield.errors import DatasetError, FarfieldError, FileFormatError
from farfield.evaluation.record import Evaluation
from farfield.files.atomic import read_bytes
from farfield.files.bags import Bag
from farfield.files.boxes_csv import read_boxes_csv
from farfield.files.images import image_size, read_image
from farfield.files.kitti import read_labels
from farfield.files.mat import open_mat, read_mat
from farfield.files.stamps import recognise_stamps
from farfield.files.videos import read_film
from farfield.frame.cloud import columns_shown, read_cloud
from farfield.metrics.box_files import read_predictions
from farfield.metrics.comparing import read_results

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"ab" * 32 + b"\nsize 1234567\n"
STAND_INS = {
    "git lfs pull": POINTER,
    "git annex get": b"/annex/objects/SHA256E-s123--abc.pcd\n",
    "a page in HTML": b"\n<!DOCTYPE html>\n<html><body>Please log in</body></html>",
    "gunzip": gzip.compress(b"x" * 5000),
    "unzip": b"PK\x03\x04" + bytes(40),
}


def opened_mat(path: Path) -> None:
    with open_mat(path, "x"):
        pass


def kitti_predictions(path: Path) -> None:
    read_predictions(path, format="kitti-tracking")


READERS: dict[str, Callable[[Path], Any]] = {
    **{f"a{suffix}": read_cloud for suffix in (".pcd", ".bin", ".npy", ".xyz", ".ffcloud")},
    "a.png": read_image,
    "b.jpg": image_size,
    "a.json": read_boxes,
    "scores.json": Evaluation.load,
    "b.json": lambda path: read_results([path]),
    "labels.csv": read_boxes_csv,
    "000000.txt": read_labels,
    "0001.txt": kitti_predictions,
    "calibration.yaml": read_calibration,
    "mapping.yaml": read_class_mapping,
    "cirrus.yaml": read_mapping,
    "split.json": lambda path: read_parts(path, ("a",)),
    "cube.mat": lambda path: read_mat(path, "x"),
    "stream.mat": opened_mat,
    "timestamps.txt": recognise_stamps,
    **({"a.mcap": Bag, "a.db3": Bag} if find_spec("rosbags") else {}),
    **({"a.mp4": read_film} if find_spec("av") else {}),
}


@pytest.mark.parametrize("advice", STAND_INS)
@pytest.mark.parametrize("name", READERS)
def test_every_reader_names_what_stands_there(name: str, advice: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(STAND_INS[advice])
    with pytest.raises(FarfieldError) as refused:
        READERS[name](path)
    assert advice in str(refused.value)
    assert "reindex" not in str(refused.value)


@pytest.mark.parametrize("suffix", [".pcd", ".bin", ".npy", ".npz", ".ply", ".xyz", ".las", ".LAZ", ".ffcloud"])
def test_own_folders_of_pointers_say_git_lfs_pull(suffix: str, tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"{number}{suffix}").write_bytes(POINTER)
    assert columns_shown(sorted(tmp_path.iterdir())) is None
    with pytest.raises(FileFormatError, match="git lfs pull"):
        open_dataset(tmp_path)[0].cloud()


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("a.E57", "pdal translate"),
        ("data.zip", "unpack it"),
        ("data.tar.gz", "unpack it"),
        ("000.pcd.crdownload", "has not ended"),
        ("000.bin.part", "has not ended"),
        ("a.pcap", "sensor's own tool"),
    ],
)
def test_files_that_no_reader_takes_are_named(name: str, advice: str, tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    path = tmp_path / "set" / name
    path.write_bytes(b"ply\n")
    with pytest.raises(DatasetError, match=advice):
        open_dataset(tmp_path / "set")
    with pytest.raises(DatasetError, match=advice):
        open_dataset(path)


def test_links_that_lead_nowhere_are_refused(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(DatasetError, match="leads in a circle"):
        open_dataset(tmp_path / "loop")
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "0.xyz").write_text("1 2 3\n4 5 6\n")
    (folder / "1.xyz").symlink_to(folder / ".git" / "annex" / "objects" / "1.xyz")
    with pytest.raises(DatasetError, match="git annex get"):
        open_dataset(folder)


def test_hidden_files_of_macos_are_no_clouds(tmp_path: Path) -> None:
    (tmp_path / "0.xyz").write_text("1 2 3\n4 5 6\n")
    (tmp_path / "._0.xyz").write_bytes(b"\0\5\x16\7Mac OS X")
    (tmp_path / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0")
    assert open_dataset(tmp_path).frame_ids == ("0",)


def test_one_cloud_or_bag_in_place_of_a_folder_names_the_folder(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    path.write_bytes(b"x")
    with pytest.raises(DatasetError, match="Name the folder that holds it"):
        open_dataset(path)


def test_labels_of_labelcloud_are_named(tmp_path: Path) -> None:
    (tmp_path / "0.xyz").write_text("1 2 3\n4 5 6\n")
    (tmp_path / "0.json").write_text(
        '{"folder": "a", "filename": "0.ply", "path": "0.ply", "objects": [{"name": "car", "centroid": {"x": 1, "y": 2,'
        ' "z": 3}, "dimensions": {"length": 4, "width": 2, "height": 1}, "rotations": {"x": 0, "y": 0, "z": 90}}]}'
    )
    with pytest.raises(FileFormatError, match="labels of labelCloud") as refused:
        open_dataset(tmp_path, format="folder").annotation(0)
    assert "--format labelcloud" in refused.value.fix
    boxes = open_dataset(tmp_path)[0].boxes
    assert boxes is not None
    assert boxes.yaw_rad.tolist() == [math.pi / 2]


@pytest.mark.parametrize("suffix", [".npz", ".pt", ".zip"])
def test_archives_by_nature_are_themselves(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"state{suffix}"
    with path.open("wb") as file:
        np.savez(file, a=np.zeros(3))
    assert read_bytes(path).startswith(b"PK")
