"""Own clouds with one table of labels, labels.csv, in their folder."""

import pickle

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.folder import write_boxes
from farfield.errors import DatasetError, FileFormatError
from farfield.frame import Boxes

HEADER = "frame,label,x,y,z,l,w,h,yaw_rad\n"
ROWS = "a,vehicle,10,1,-1,4,2,1.5,0.1\na,pedestrian,12,1,-1,0.8,0.7,1.7,0\nb,vehicle,30,1,-1,4,2,1.5,0\n"


@pytest.fixture
def own(tmp_path):
    folder = tmp_path / "own"
    folder.mkdir()
    for stem in "abc":
        np.save(folder / f"{stem}.npy", np.ones((5, 4), np.float32))
    return folder


def test_the_table_annotates_the_frames_that_it_names(own):
    assert open_dataset(own)[0].boxes is None
    before = open_dataset(own).fingerprint()
    (own / "labels.csv").write_text(HEADER + ROWS)
    data = open_dataset(own)
    assert [data.has_annotation(index) for index in range(3)] == [True, True, False]
    assert list(data[0].boxes.label) == ["vehicle", "pedestrian"]
    assert data.annotation(1).boxes.centre_m.tolist() == [[30, 1, -1]]
    assert data[2].boxes is None
    assert own / "labels.csv" in data.files(0)
    assert data.fingerprint() != before
    assert list(pickle.loads(pickle.dumps(data))[0].boxes.label) == ["vehicle", "pedestrian"]


def test_the_folder_s_own_sequence_may_be_named(own):
    lines = ["sequence," + HEADER, *[f"{'own' if row[0] == 'a' else 'other'},{row}\n" for row in ROWS.splitlines()]]
    (own / "labels.csv").write_text("".join(lines))
    data = open_dataset(own)
    assert [data.has_annotation(index) for index in range(3)] == [True, False, False]


def test_labels_of_other_frames_are_named(own):
    (own / "labels.csv").write_text(HEADER + ROWS.replace("a,", "x,").replace("b,", "y,"))
    with pytest.raises(DatasetError, match=r"labels\.csv.*'a'.*'x'"):
        open_dataset(own)


def test_two_annotations_of_a_frame_are_refused(own):
    (own / "labels.csv").write_text(HEADER + ROWS)
    write_boxes(own / "b.json", Boxes.empty())
    with pytest.raises(DatasetError, match=r"b\.json"):
        open_dataset(own)


def test_a_damaged_table_is_named(own):
    (own / "labels.csv").write_text(HEADER + "a,vehicle,ten,1,-1,4,2,1.5,0.1\n")
    with pytest.raises(FileFormatError, match=r"labels\.csv.*line 2"):
        open_dataset(own)
