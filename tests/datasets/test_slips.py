"""Slips of a person with own data: each is named, where it is noticed first."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from farfield.api import open_dataset
from farfield.datasets.folder import write_boxes
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.boxes_csv import parse_boxes_csv
from farfield.frame import Boxes
from farfield.inspection.doctor import DoctorReport, examine

CAR = Boxes(
    centre_m=np.array([[9.0, 2.0, -1.0]]), size_m=np.array([[4.2, 1.9, 1.6]]), yaw_rad=np.zeros(1), label=["vehicle"]
)


def own(folder: Path, change: Callable[[np.ndarray], np.ndarray] = np.asarray) -> Path:
    folder.mkdir(parents=True)
    random = np.random.default_rng(0)
    ground = np.column_stack(
        [random.uniform(-50, 50, 4000), random.uniform(-50, 50, 4000), random.normal(-1.7, 0.03, 4000)]
    )
    walls = np.column_stack([random.uniform(-50, 50, 900), np.full(900, 20.0), random.uniform(-1.7, 3, 900)])
    rows = np.column_stack([np.concatenate([ground, walls]), random.uniform(0, 1, 4900)])
    for number in range(2):
        np.save(folder / f"{number:03d}.npy", change(rows))
    return folder


def topics(report: DoctorReport, severity: str) -> str:
    return " ".join(f"{one.topic}: {one.what}" for one in report.findings if one.severity == severity)


def test_a_spreadsheets_separators_are_named() -> None:
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        with pytest.raises(FileFormatError, match=word):
            parse_boxes_csv(
                separator.join(("frame", "label", "x", "y", "z", "l", "w", "h", "yaw_rad")).encode(), "a.csv"
            )


def test_a_pointer_of_git_lfs_is_named(tmp_path: Path) -> None:
    path = tmp_path / "000000.bin"
    path.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{'a' * 64}\nsize 1900000\n")
    with pytest.raises(FileFormatError, match="Git LFS"):
        open_dataset(tmp_path)[0].cloud()


def test_annotations_of_no_cloud_are_counted(tmp_path: Path) -> None:
    folder = own(tmp_path / "own")
    (folder / "labels").mkdir()
    write_boxes(folder / "labels" / "000.json", CAR)
    write_boxes(folder / "labels" / "img_001.json", CAR)
    said = topics(examine(open_dataset(folder)), "warn")
    assert "1 annotation belongs to no cloud" in said


def test_two_annotations_of_a_frame_are_refused(tmp_path: Path) -> None:
    folder = own(tmp_path / "own")
    for place in ("boxes", "labels"):
        (folder / place).mkdir()
        write_boxes(folder / place / "001.json", CAR)
    with pytest.raises(DatasetError, match="one annotation a frame"):
        open_dataset(folder)


def test_a_table_of_another_sequence_is_refused(tmp_path: Path) -> None:
    folder = own(tmp_path / "own")
    text = "sequence,frame,label,x,y,z,l,w,h,yaw_rad\ndrive_7,000,vehicle,9,2,-1,4,2,1.6,0\n"
    (folder / "labels.csv").write_text(text)
    with pytest.raises(DatasetError, match="drive_7"):
        open_dataset(folder)
    (folder / "labels.csv").write_text(text.replace("drive_7", "own"))
    assert open_dataset(folder).has_annotation(0)


def test_coordinates_of_a_map_are_refused(tmp_path: Path) -> None:
    folder = own(tmp_path / "own", lambda rows: rows + np.array([691_000, 5_335_000, 520, 0]))
    with pytest.raises(DatasetError, match="coordinates of a map"):
        open_dataset(folder)[0].cloud()


def test_a_cloud_upside_down_is_noticed(tmp_path: Path) -> None:
    good = examine(open_dataset(own(tmp_path / "good")))
    assert "z seems to point down" not in str(good)
    turned = examine(open_dataset(own(tmp_path / "turned", lambda rows: rows * [1, -1, -1, 1])))
    assert "z seems to point down" in topics(turned, "fail")


def test_a_folder_too_high_names_the_one_below(tmp_path: Path) -> None:
    own(tmp_path / "all" / "drive1")
    with pytest.raises(DatasetError, match=r"drive1 \(folder\): open that"):
        open_dataset(tmp_path / "all")


def test_radians_for_degrees_are_refused(tmp_path: Path) -> None:
    folder = own(tmp_path / "own")
    for turn in (np.pi, -1.5708):
        with pytest.raises(ConfigError, match="degrees"):
            open_dataset(folder, rotate_deg=turn)
    assert len(open_dataset(folder, rotate_deg=3.0)) == 2


@pytest.mark.parametrize("inverted", [False, True])
def test_a_camera_of_the_inverse_pose_is_noticed(tmp_path: Path, *, inverted: bool) -> None:
    from PIL import Image

    folder = own(tmp_path / "own")
    Image.new("RGB", (64, 48), (90, 90, 90)).save(folder / "000.png")
    pose = np.array([[0, -1, 0, 0], [0, 0, -1, 1.2], [1, 0, 0, -0.3], [0, 0, 0, 1.0]])
    rows = (np.linalg.inv(pose) if inverted else pose).tolist()
    matrix = "[[50, 0, 32], [0, 50, 24], [0, 0, 1]]"
    text = f"matrix: {matrix}\ncamera_T_lidar: {rows}\nwidth: 64\nheight: 48\n"
    (folder / "calibration.yaml").write_text(text)
    assert ("it is upright if camera_T_lidar is inverted" in str(examine(open_dataset(folder)))) == inverted


def test_real_cameras_and_clouds_stand_upright(shared_real: Path) -> None:
    for name in ("kitti", "view_of_delft", "cirrus_layout", "argoverse2", "astyx"):
        said = str(examine(open_dataset(shared_real / name), max_clouds=2))
        assert "lies on its side" not in said, name
        assert "z seems to point down" not in said, name
