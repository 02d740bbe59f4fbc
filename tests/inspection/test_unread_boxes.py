"""Boxes in files of one's own: those that are not read are named, with where they go; no track is no track."""

from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.errors import DatasetError
from farfield.inspection.doctor import examine
from farfield.inspection.statistics.census import take_census

ROW = "0000,vehicle,10,0,-1,4.5,1.9,1.6,0.1"
HEADER = "frame,label,x,y,z,l,w,h,yaw_rad"


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    for number in range(3):
        points = rng.uniform((-40, -40, -2, 0), (40, 40, 2, 1), (2000, 4)).astype(np.float32)
        np.save(tmp_path / f"{number:04d}.npy", points)
    return tmp_path


def labels_advice(folder: Path) -> str:
    return next(one.fix for one in examine(open_dataset(folder)).findings if one.topic == "labels")


def test_a_table_of_another_name_is_named_with_where_boxes_go(folder: Path) -> None:
    assert "not read" not in labels_advice(folder)
    (folder / "boxes.csv").write_text(f"{HEADER}\n{ROW}\n")
    assert "boxes.csv is not read: boxes go into labels.csv" in labels_advice(folder)
    (folder / "annotations.json").write_text("{}")
    assert "annotations.json and 1 more file are not read" in labels_advice(folder)


def test_frames_named_with_their_suffix_are_told_to_leave_it_out(folder: Path) -> None:
    (folder / "labels.csv").write_text(f"{HEADER}\n{ROW.replace('0000', '0000.npy')}\n")
    with pytest.raises(DatasetError, match=r"such as '0000\.npy'\. Leave out the files' suffix\."):
        open_dataset(folder)
    (folder / "labels.csv").write_text(f"{HEADER}\n{ROW.replace('0000', 'first')}\n")
    with pytest.raises(DatasetError, match="without suffix"):
        open_dataset(folder)


def test_boxes_without_tracks_are_no_tracks() -> None:
    data = open_dataset("open-sweeps")
    assert take_census(data.select([0, 1])).tracks() == {}
