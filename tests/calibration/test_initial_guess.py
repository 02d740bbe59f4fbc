"""A Cirrus folder without calibration: twelve pairs, and the reader's own boxes on its picture; clicked points."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from street import START_NS, street_frame

from farfield import cli
from farfield.calibration.initial_guess import camera_at, camera_from_clicked, read_clicked
from farfield.datasets import open_dataset
from farfield.datasets.cirrus import CirrusWriter
from farfield.errors import FileFormatError
from farfield.figures.camera import boxes_picture
from farfield.files.images import read_image
from farfield.frame import camera_sensor
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, transform_points

TRUTH = Camera(
    matrix=np.array([[1040.0, 0, 955], [0, 1040, 330], [0, 0, 1]]),
    camera_T_lidar=camera_at(np.array([-0.4, 0.1, -0.3]), yaw_rad=0.02, pitch_rad=0.03),
    width_px=1920,
    height_px=650,
)


@pytest.fixture
def root(tmp_path: Path, rng: np.random.Generator) -> Path:
    """One frame with a picture and no calibration."""
    writer = CirrusWriter(tmp_path)
    frame = street_frame(rng)
    picture = np.full((650, 1920, 3), 90, np.uint8)
    sensors = dict(frame.sensors) | {"camera": camera_sensor(None, START_NS)}
    writer.write(replace(frame, images={"camera": picture}, sensors=sensors))
    return tmp_path / "Cirrus_dataset1"


def pick(root: Path, path: Path, count: int, rng: np.random.Generator) -> Path:
    """Box corners picked by hand: the truth's pixels with 2 px of noise."""
    corners = open_dataset(root)[0].boxes.corners_m().reshape(-1, 3)
    corners = corners[TRUTH.project(corners)[2] & (np.hypot(*corners.T[:2]) < 70)]
    chosen = corners[rng.permutation(len(corners))[:count]]
    pixels = TRUTH.project(chosen)[0] + rng.normal(0, 2, (count, 2))
    rows = [",".join(f"{value:.3f}" for value in row) for row in np.column_stack([chosen, pixels])]
    path.write_text("\n".join(["x_m,y_m,z_m,u_px,v_px", *rows]))
    return path


def test_twelve_pairs_put_cirrus_boxes_on_its_picture(
    root: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cv2")
    assert open_dataset(root)[0].cameras == {}
    picks = pick(root, tmp_path / "picks.csv", 12, rng)
    words = ["lidar-camera", str(root), "--guess-focal", "900", "--pairs", str(picks), "--out", str(tmp_path / "out")]
    assert cli.main(["calibrate", *words, "--save", str(root)]) == 0
    assert "calibration.json" in capsys.readouterr().out
    frame = open_dataset(root)[0]  # the same reader, nothing told
    found = frame.cameras["camera"]
    assert abs(found.matrix[0, 0] / 1040 - 1) < 0.05
    centres = frame.boxes.centre_m
    there, _, seen = TRUTH.project(centres)
    away = np.linalg.norm(found.project(centres[seen])[0] - there[seen], axis=1)
    assert seen.sum() > 5
    assert np.median(away) < 5
    assert frame.sensors["camera"].frame_T_sensor is not None
    drawn = boxes_picture(frame.images["camera"], found, frame.boxes)
    assert (drawn != frame.images["camera"]).any(axis=2).sum() > 1000
    assert read_image(tmp_path / "out" / "boxes.png").shape == (650, 1920, 3)
    result = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert len(result["residual_px"]) == 12
    assert np.median(result["residual_px"]) < 5


def test_what_is_lacking_is_said(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["calibrate", "lidar-camera", str(root), "--out", str(tmp_path / "out")]
    assert cli.main(words) == 1
    assert "no camera at all" in capsys.readouterr().err
    assert cli.main([*words, "--guess-focal", "900"]) == 1
    assert "give --pairs" in capsys.readouterr().err
    assert cli.main([*words, "--position", "0", "0", "0"]) == 1
    assert "has no calibration" in capsys.readouterr().err
    picks = pick(root, tmp_path / "picks.csv", 6, np.random.default_rng(0))
    assert cli.main([*words, "--guess-focal", "900", "--pairs", str(picks)]) == 1
    assert "expected 12 points" in capsys.readouterr().err


CLICKED = """name,x,y,z
lidar,0,170,20
front,0,60,230
rear,0,60,-200
left,90,60,0
right,-90,60,0
Cam-Front,-10,160,45
cam-front ahead,-10,150,145
cam-left,40,165,10
cam-left ahead,140,165,10
"""


def test_clicked_points_tell_where_cameras_stand(tmp_path: Path) -> None:
    path = tmp_path / "car.csv"
    path.write_text(CLICKED)  # a scan in centimetres: y up, z ahead, x left
    points = read_clicked(path, unit_m=0.01)
    np.testing.assert_allclose(points["cam-front"], [0.25, -0.1, -0.1], atol=1e-12)
    front, left = (camera_from_clicked(points, name) for name in ("Cam-Front", "cam-left"))
    assert front is not None
    assert left is not None
    np.testing.assert_allclose(invert(front)[:3, 3], [0.25, -0.1, -0.1], atol=1e-12)
    ahead = transform_points(front, np.array([[0.25 + 1, -0.1, -0.1 - 0.1]]))[0]
    np.testing.assert_allclose(ahead / np.linalg.norm(ahead), [0, 0, 1], atol=1e-12)
    beside = transform_points(left, points["cam-left"][None] + [0, 1, 0])[0]
    np.testing.assert_allclose(beside, [0, 0, 1], atol=1e-12)
    assert camera_from_clicked(points, "cam-rear") is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("name,x,y,z", "a,b", "line 1"),
        ("left,90,60,0\n", "", "no left"),
        ("left,90,60,0", "left,0,60,200", "across"),
        ("rear,0,60,-200", "rear,0,here,-200", "row 4"),
        ("rear,0,60,-200", "front,0,60,-200", "a new name"),
    ],
)
def test_other_lists_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "car.csv"
    path.write_text(CLICKED.replace(old, new))
    with pytest.raises(FileFormatError, match=message):
        read_clicked(path)
