"""ROS' camera_info, OpenCV's FileStorage and Kalibr's camchain beside clouds: read, and never in the way."""

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
