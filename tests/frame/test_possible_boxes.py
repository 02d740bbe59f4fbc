"""Centres of 1e9 m, empty labels and tracks of 10^30 are refused by readers, and never written by convert."""

import json
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.errors import FarfieldError, FileFormatError
from farfield.files.boxes_csv import read_boxes_csv
from farfield.files.clouds import write_bin
from farfield.files.kitti import read_tracking
from farfield.frame import Annotation, Boxes
from farfield.metrics.box_files import read_predictions

GOOD = {"label": "vehicle", "centre_m": [10.0, 0.0, 0.0], "size_m": [4.0, 2.0, 1.5], "yaw_rad": 0.1, "track_id": 3}
WRONG = [
    {"centre_m": [1e9, 0.0, 0.0]},
    {"centre_m": [0.0, 0.0, -1e9]},
    {"size_m": [1e9, 2.0, 1.5]},
    {"label": ""},
    {"label": "  "},
    {"track_id": 10**30},
    {"track_id": -7},
    {"yaw_rad": 1e300},
]
CALIB = "P2: 700 0 600 0 0 700 180 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"


def own_folder(root: Path, **changes: object) -> Path:
    root.mkdir(parents=True)
    write_bin(root / "0.bin", np.random.default_rng(0).uniform(0, 1, (300, 4)).astype(np.float32))
    (root / "0.json").write_text(json.dumps({"boxes": [GOOD | changes]}))
    return root


@pytest.mark.parametrize("changes", WRONG)
def test_own_json(changes: dict[str, object], tmp_path: Path) -> None:
    assert len(open_dataset(own_folder(tmp_path / "good"))[0].boxes) == 1
    root = own_folder(tmp_path / "own", **changes)
    with pytest.raises(FileFormatError, match=r"0\.json"):
        _ = open_dataset(root)[0].annotation
    for target in ("kitti", "boxes-csv"):
        assert main(["convert", str(root), str(tmp_path / target), "--to", target]) != 0
        written = [path for path in (tmp_path / target).rglob("*") if path.suffix in (".txt", ".json", ".csv")]
        assert not [path for path in written if "1e+09" in path.read_text() or "1000000000" in path.read_text()]


ROWS = ["1e9,0,0,4,2,1,0,3", "1,0,0,1e9,2,1,0,3", f"1,0,0,4,2,1,0,{10**30}", "1,0,0,4,2,1,1e300,3"]


@pytest.mark.parametrize("row", ROWS)
def test_own_table(row: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"frame,label,x,y,z,l,w,h,yaw_rad,track_id\n0,vehicle,{row}\n")
    with pytest.raises(FileFormatError, match="line 2"):
        read_boxes_csv(tmp_path / "a.csv")


def test_kitti(tmp_path: Path) -> None:
    for folder in ("velodyne", "label_2", "calib"):
        (tmp_path / "training" / folder).mkdir(parents=True)
    write_bin(tmp_path / "training" / "velodyne" / "000000.bin", np.full((300, 4), 0.5, np.float32))
    (tmp_path / "training" / "calib" / "000000.txt").write_text(CALIB)
    label = tmp_path / "training" / "label_2" / "000000.txt"
    for numbers in ("1.5 2 4 1e9 1 10 0", "1.5 2 1e8 1 1 10 0", "1.5 2 4 1 1 10 1e300"):
        label.write_text(f"Car 0 0 0 1 1 2 2 {numbers}\n")
        with pytest.raises(FarfieldError, match=r"000000.*line 1.*metres"):
            _ = open_dataset(tmp_path)[0].annotation
        with pytest.raises(FarfieldError, match=r"000000.*line 1.*metres"):
            read_predictions(label.parent, format="kitti")
        (tmp_path / "0000.txt").write_text(f"0 1 Car 0 0 0 1 1 2 2 {numbers}\n")
        with pytest.raises(FarfieldError, match=r"0000.*line 1.*metres"):
            read_tracking(tmp_path / "0000.txt")


def test_any_reader_that_makes_an_annotation() -> None:
    boxes = Boxes(centre_m=np.array([[1e9, 0, 0]]), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1), label=["Car"])
    with pytest.raises(FarfieldError, match="metres"):
        Annotation(boxes=boxes)
    fine = Boxes(centre_m=np.zeros((1, 3)), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1), label=["Car"])
    with pytest.raises(FarfieldError, match="class"):
        Annotation(boxes=fine.replace(label=[" "]))
    with pytest.raises(FarfieldError, match="class"):
        Annotation(boxes=fine, original_label=[""])
    assert len(Annotation(boxes=Boxes.empty())) == 0
