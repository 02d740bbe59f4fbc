"""Astyx and TJ4DRadSet: real frames, boxes against points, small written folders, what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.api import open_dataset
from farfield.datasets import Dataset
from farfield.errors import FileFormatError
from farfield.geometry.boxes import count_points_in_boxes

COLUMNS = "X Y Z V_r Mag"


def hit(data: Dataset, cloud: str, *, grown: float = 1.0, nearer_m: float = 1e9) -> tuple[int, int]:
    """Boxes with at least one point, and boxes."""
    found = []
    for frame in data:
        assert frame.annotation is not None
        boxes = frame.annotation.boxes
        boxes = boxes[np.hypot(*boxes.centre_m[:, :2].T) < nearer_m]
        grown_boxes = replace(boxes, size_m=boxes.size_m * grown)
        found.append(count_points_in_boxes(frame.clouds[cloud].points_m, grown_boxes) > 0)
    whole = np.concatenate(found)
    return int(whole.sum()), len(whole)


def test_astyx_boxes_hold_the_points_that_were_counted_by_hand(shared_real: Path) -> None:
    """The counts of the data's README, taken by another program: 117 of 121 radar, 88 (82 of 100 near) LiDAR."""
    data = open_dataset(shared_real / "astyx")
    assert (data.name, len(data)) == ("astyx", 10)
    assert hit(data, "radar", grown=1.1) == (117, 121)
    assert hit(data, "lidar") == (88, 121)
    assert hit(data, "lidar", nearer_m=50)[1] == 100
    frame = data[0]
    assert frame.reference == "radar"
    assert {"radar", "lidar", "camera"} <= set(frame.sensors)
    pixels, _, visible = frame.cameras["camera"].project(frame.boxes.centre_m)
    assert visible.mean() > 0.8  # annotated ahead, where the camera looks; the radar sees wider
    assert pixels[visible][:, 1].min() > 200  # below the sky


def test_tj4dradset_is_a_radar_and_not_kittis_lidar(shared_real: Path) -> None:
    data = open_dataset(shared_real / "tj4dradset")
    assert (data.name, len(data)) == ("tj4dradset", 41)
    cloud = data[0].clouds["radar"]
    np.testing.assert_allclose(cloud.extra["range_m"], np.linalg.norm(cloud.points_m, axis=1), atol=1e-3)
    assert data[0].sensors["radar"].kind == "radar"
    assert hit(data, "radar", grown=1.1) == (
        115,
        152,
    )  # the README of the data, which does not say how it grew them, has 116


def folder(root: Path, **changed: object) -> Path:
    """Astyx' folders with one frame of one object."""
    entry = {
        "classname": "Towed Object",
        "center3d": [20.0, 1.0, 0.0],
        "dimension3d": [4.0, 2.0, 1.5],
        "orientation_quat": [np.cos(0.3), 0, 0, np.sin(0.3)],
        "occlusion": 1,
        "label_certainty": 2,
    } | changed
    for name in ("radar_6455", "groundtruth_obj3d"):
        (root / name).mkdir(exist_ok=True)
    (root / "radar_6455" / "000003.txt").write_text(f"\n{COLUMNS}\n20 1 0 -3.5 48\n5 0 0 0 51\n")
    (root / "groundtruth_obj3d" / "000003.json").write_text(json.dumps({"objects": [entry]}))
    return root


def test_a_written_frame_is_read_back(tmp_path: Path) -> None:
    (frame,) = open_dataset(folder(tmp_path))
    assert frame.annotation is not None
    boxes = frame.annotation.boxes
    assert (frame.frame_id, boxes.label.tolist(), frame.annotation.original_label) == (
        "000003",
        ["trailer"],
        ("Towed Object",),
    )
    assert boxes.yaw_rad[0] == pytest.approx(0.6)
    assert frame.clouds["radar"].extra["doppler_m_s"].tolist() == [-3.5, 0]
    (kept,) = open_dataset(tmp_path, classes="astyx")
    assert kept.boxes.label.tolist() == ["Towed Object"]


@pytest.mark.parametrize(
    "changed",
    [
        {"center3d": [1, 2]},
        {"center3d": [1, 2, "a"]},
        {"dimension3d": [4, 0, 1]},
        {"orientation_quat": [1, 1, 0, 0]},
        {"classname": 3},
        {"occlusion": "much"},
    ],
)
def test_wrong_objects_are_refused(tmp_path: Path, changed: dict[str, object]) -> None:
    with pytest.raises(FileFormatError, match="objects"):
        len(open_dataset(folder(tmp_path, **changed))[0].boxes)


@pytest.mark.parametrize("text", ["", "X Y Z V_r\n1 2 3 4\n", f"{COLUMNS}\n", f"{COLUMNS}\n1 2 3 nan 5\n"])
def test_wrong_points_are_refused(tmp_path: Path, text: str) -> None:
    folder(tmp_path)
    (tmp_path / "radar_6455" / "000003.txt").write_text(text)
    with pytest.raises(FileFormatError, match=r"000003\.txt"):
        open_dataset(tmp_path)[0].clouds["radar"]
