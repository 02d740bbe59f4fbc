"""Names with blanks, commas and newlines: quoted where they stand in a table, never merged, never one file for two."""

import csv
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets.convert import convert
from farfield.datasets.memory import in_memory
from farfield.errors import DatasetError, FileFormatError
from farfield.files.boxes_csv import read_boxes_csv
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame

HEADER = "frame,label,x,y,z,l,w,h,yaw_rad\n"


def frames(*keys: tuple[str, str]) -> list[Frame]:
    cloud = Cloud(np.float32([[20, 2, -1]]), np.float32([0.5]))
    size = np.array([[4.4, 1.8, 1.5]])
    boxes = Boxes(centre_m=np.array([[20.0, 2, -1]]), size_m=size, yaw_rad=np.zeros(1), label=["vehicle"])
    load = Constant(Annotation(boxes=boxes))
    return [Frame(sequence=key[0], frame_id=key[1], clouds={"lidar": cloud}, load_annotation=load) for key in keys]


@pytest.mark.parametrize("to", ["boxes-csv", "openlabel", "sustechpoints", "cvat"])
@pytest.mark.parametrize("names", [("a b", "a_b"), ("a,b", "a b"), ("a\nb", "a_b"), ("A", "a")])
def test_sequences_that_would_share_a_file_are_refused(tmp_path: Path, to: str, names: tuple[str, str]) -> None:
    with pytest.raises(DatasetError, match="differ as names of files"):
        convert(in_memory(frames((names[0], "1"), (names[1], "2"))), tmp_path / "out", to=to)


@pytest.mark.parametrize("to", ["sustechpoints", "cvat"])
def test_frames_that_would_share_a_file_are_refused(tmp_path: Path, to: str) -> None:
    with pytest.raises(DatasetError, match="differ as names of files"):
        convert(in_memory(frames(("s", "1 2"), ("s", "1_2"))), tmp_path / "out", to=to)


def test_kitti_s_list_of_frames_quotes_its_names(tmp_path: Path) -> None:
    keys = (("a,b", "1"), ("a\nb", "2"), (" a", "3"))
    convert(in_memory(frames(*keys)), tmp_path / "out", to="kitti")
    with (tmp_path / "out" / "frames.csv").open(newline="") as handle:
        rows = list(csv.reader(handle))
    assert rows[1:] == [[f"{number:06d}", *key] for number, key in enumerate(keys)]


@pytest.mark.parametrize("name", ["frame", "sequence"])
def test_names_that_differ_by_blanks_are_not_merged(tmp_path: Path, name: str) -> None:
    rows = "".join(f"{frame},Car,1,2,3,4,2,1.5,0\n" for frame in ("a", " a"))
    header = HEADER if name == "frame" else "sequence,frame,label,x,y,z,l,w,h,yaw_rad\n"
    rows = rows if name == "frame" else rows.replace("a,Car", "a,1,Car")
    (tmp_path / "p.csv").write_text(header + rows)
    with pytest.raises(FileFormatError, match=r"line 3: expected each .* spelt in one way"):
        read_boxes_csv(tmp_path / "p.csv")
