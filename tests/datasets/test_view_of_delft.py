from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset, recognise
from farfield.datasets.view_of_delft import boxes_from_labels
from farfield.files.kitti import read_calib, read_labels
from farfield.geometry.points import count_points_in_boxes

PITCH_RAD = np.radians(7.0)


def write_frame(root: Path, label: str) -> Path:
    """A frame whose camera looks down by seven degrees from the lidar's own place."""
    folder = root / "training"
    for name in ("velodyne", "label_2", "calib", "pose"):
        (folder / name).mkdir(parents=True)
    np.zeros((3, 4), np.float32).tofile(folder / "velodyne" / "00001.bin")
    (folder / "label_2" / "00001.txt").write_text(label)
    (folder / "pose" / "00001.json").write_text("{}")
    sin, cos = np.sin(PITCH_RAD), np.cos(PITCH_RAD)
    motion = f"0 -1 0 0 {-sin} 0 {-cos} 0 {cos} 0 {-sin} 0"
    camera = "\n".join(f"P{i}: 1000 0 500 0 0 1000 300 0 0 0 1 0" for i in range(4))
    text = f"{camera}\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {motion}\nTr_imu_to_velo:"
    (folder / "calib" / "00001.txt").write_text(text)
    return root


def test_a_box_stands_upright_in_the_lidars_frame(tmp_path):
    """A car 20 m ahead on the level of the lidar, its length across the road: by hand in camera coordinates."""
    sin, cos = np.sin(PITCH_RAD), np.cos(PITCH_RAD)
    label = f"Car 0 0 0 0 0 1 1 1.5 1.8 4.2 0 {-20 * sin} {20 * cos} 0 1\n"
    data = open_dataset(write_frame(tmp_path, label))
    assert data.name == recognise(tmp_path) == "view_of_delft"
    boxes = data[0].boxes
    np.testing.assert_allclose(boxes.centre_m, [[20, 0, 0.75]], atol=1e-9)
    np.testing.assert_allclose(boxes.size_m, [[4.2, 1.8, 1.5]])
    np.testing.assert_allclose(boxes.yaw_rad, [-np.pi / 2])
    assert boxes.label.tolist() == ["vehicle"]
    assert boxes.score is None  # the sixteenth column is no score


def test_real_frames_have_their_points_in_their_boxes(shared_real):
    root = shared_real / "view_of_delft" / "lidar"
    data = open_dataset(root)
    assert (data.name, len(data)) == ("view_of_delft", 2)
    for frame in data:
        inside = count_points_in_boxes(frame.cloud().points_m, frame.boxes, margin_m=0.05)
        assert (inside > 0).mean() > 0.85
        assert np.median(inside) > 40
        assert "camera" in frame.images


@pytest.mark.parametrize("name", ["Car", "Cyclist", "rider"])
def test_class_names_are_translated_or_kept(shared_real, name):
    folder = shared_real / "view_of_delft" / "lidar" / "training"
    objects = read_labels(folder / "label_2" / "01047.txt")
    calib = read_calib(folder / "calib" / "01047.txt")
    assert "Tr_imu_to_velo" not in calib
    camera_T_lidar = np.eye(4)
    camera_T_lidar[:3] = calib["Tr_velo_to_cam"]
    kept = boxes_from_labels(objects, camera_T_lidar, classes="kitti")
    ours = boxes_from_labels(objects, camera_T_lidar)
    expected = {"Car": "vehicle", "Cyclist": "bicycle", "rider": "unknown"}[name]
    assert set(ours.label[kept.label == name]) == {expected}
