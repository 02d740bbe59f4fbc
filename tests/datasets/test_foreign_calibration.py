"""ROS' camera_info, OpenCV's FileStorage and Kalibr's camchain beside clouds: read, and never in the way."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from farfield import cli
from farfield.calibration.initial_guess import InitialGuess
from farfield.datasets import open_dataset
from farfield.datasets.calibration import read_calibration, read_calibration_file
from farfield.errors import FileFormatError

ROS = """image_width: 64
image_height: 48
camera_name: front
camera_matrix: {rows: 3, cols: 3, data: [500.0, 0, 32, 0, 510.0, 24, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.01, 0.001, 0.002, 0.0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}
"""
OPENCV = """%YAML:1.0
---
image_width: 64
image_height: 48
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 32., 0., 510., 24., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.1, 0.01, 0.001, 0.002, 0. ]
"""
KALIBR = """cam0:
  camera_model: pinhole
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0.001, 0.002]
  intrinsics: [500.0, 510.0, 32.0, 24.0]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
"""
OWN = """matrix: [[500, 0, 32], [0, 510, 24], [0, 0, 1]]
camera_T_lidar: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
FORMS = {"ROS": ROS, "OpenCV": OPENCV, "Kalibr": KALIBR}
UNUSABLE = {
    "fisheye": ROS.replace("plumb_bob", "equidistant"),
    "omni": KALIBR.replace("pinhole", "omni"),
    "short": OPENCV.replace("510., ", ""),
    "another": "lidar: {x: 1}\n",
    "no YAML": "a: [1, 2\n",
    "text": KALIBR.replace("500.0", "wide"),
}


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "0.xyz").write_text("1 2 3\n4 5 6\n")
    Image.new("RGB", (64, 48)).save(tmp_path / "own" / "0.png")
    return tmp_path / "own"


@pytest.mark.parametrize("form", FORMS)
def test_intrinsics_are_read(form: str, own: Path) -> None:
    path = own / "calibration.yaml"
    path.write_text(FORMS[form])
    content = read_calibration_file(path)
    assert form in content.form
    (camera,) = content.intrinsics.values()
    np.testing.assert_allclose(camera.matrix, [[500, 0, 32], [0, 510, 24], [0, 0, 1]])
    np.testing.assert_allclose(camera.distortion, [-0.1, 0.01, 0.001, 0.002, 0])
    assert (camera.width_px, camera.height_px) == (64, 48)
    guess = InitialGuess(intrinsics=path, position_m=(0.0, 0.0, 0.0)).camera("camera", (48, 64, 3), None)
    assert guess.matrix[0, 0] == 500
    with pytest.raises(FileFormatError, match="intrinsics alone"):
        read_calibration(path)


@pytest.mark.parametrize("text", [*FORMS.values(), *UNUSABLE.values()], ids=[*FORMS, *UNUSABLE])
def test_clouds_and_pictures_go_on(text: str, own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (own / "calibration.yaml").write_text(text)
    frame = open_dataset(own)[0]
    assert len(frame.cloud()) == 2
    assert frame.images["camera"].shape == (48, 64, 3)
    assert not frame.cameras  # of a place that nobody knows nothing is drawn
    cli.main(["doctor", str(own)])
    captured = capsys.readouterr()
    assert "calibration" in captured.err
    assert "calibration.yaml" in captured.out.replace("\n", "") or "calibration" in captured.out


@pytest.mark.parametrize("form", FORMS)
def test_a_place_that_was_added_is_used(form: str, own: Path) -> None:
    pose = "camera_T_lidar: [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]\n"
    (own / "calibration.yaml").write_text(FORMS[form] + ("  " if form == "Kalibr" else "") + pose)
    assert len(open_dataset(own)[0].cameras) == 1


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"matrix": [[-500, 0, 32], [0, 500, 24], [0, 0, 1]]}, "fx"),
        ({"matrix": [[500, 0, 32], [0, 0, 24], [0, 0, 1]]}, "fx"),
        ({"matrix": [[500, 0, 0], [0, 500, 0], [32, 24, 1]]}, "fx"),  # transposed
        (
            {"camera_T_lidar": [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0.1, -0.2, 0.3, 1]]},
            "0 0 0 1",
        ),  # transposed
        ({"camera_T_lidar": [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 2]]}, "0 0 0 1"),
    ],
)
def test_our_own_form_is_checked_as_the_foreign_ones(changes: dict, expected: str, tmp_path: Path) -> None:
    """A negative focal length mirrors the picture; a transposed pose loses where the camera stands."""
    pose = [[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]]
    content = {"matrix": [[500, 0, 32], [0, 500, 24], [0, 0, 1]], "camera_T_lidar": pose}
    (tmp_path / "a.json").write_text(json.dumps(content))
    assert read_calibration(tmp_path / "a.json")["camera"].camera_T_lidar[0, 3] == 0.1
    (tmp_path / "a.json").write_text(json.dumps(content | changes))
    with pytest.raises(FileFormatError, match=expected):
        read_calibration(tmp_path / "a.json")


@pytest.mark.parametrize("form", FORMS)
def test_a_transposed_pose_of_a_foreign_file_is_refused(form: str, tmp_path: Path) -> None:
    row = "{}camera_T_lidar: [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0.1, -0.2, 0.3, 1]]\n"
    (tmp_path / "a.yaml").write_text(FORMS[form] + row.format("  " if form == "Kalibr" else ""))
    with pytest.raises(FileFormatError, match="0 0 0 1"):
        read_calibration(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (OPENCV + "avg_reprojection_error: .nan\n", ""),
        (KALIBR + "  timeshift_cam_imu: .inf\n", ""),
        (OPENCV.replace("510.,", ".nan,"), "finite numbers"),
        (KALIBR.replace("510.0", ".inf"), "finite numbers"),
        (ROS.replace("-0.1, 0.01", "-0.1, -.inf"), "finite numbers"),
        (ROS + "camera_T_lidar: [.nan, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n", "finite numbers"),
        (OWN + "width: .inf\n", "finite"),
        (OWN.replace("1, 0, 0, 0]", "1, 0, 0, .nan]"), "finite"),
    ],
)
def test_a_number_that_is_not_finite_refuses_where_it_is_read(tmp_path: Path, text: str, fault: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    if not fault:
        assert len(read_calibration_file(tmp_path / "a.yaml").intrinsics) == 1
        return
    with pytest.raises(FileFormatError, match=fault):
        read_calibration_file(tmp_path / "a.yaml")
