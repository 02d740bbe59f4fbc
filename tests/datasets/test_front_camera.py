"""Which of several cameras layouts of one camera hold: the one that looks ahead."""

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.convert import convert
from farfield.files.coordinates import read_coordinates
from farfield.frame import Camera, Frame
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES
from farfield.geometry.poses import pose

from .generators.nuscenes_trees import write_nuscenes


def looking(yaw_deg: float) -> Camera:
    """A camera turned to the left."""
    turn = np.deg2rad(-yaw_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    matrix = np.array([[60.0 + yaw_deg, 0, 60], [0, 60.0 + yaw_deg, 40], [0, 0, 1]])
    return Camera(matrix=matrix, camera_T_lidar=CAMERA_T_LIDAR_AXES @ pose(rotation, np.zeros(3)))


def frame_of(yaws_deg: dict[str, float], pictures: tuple[str, ...] = ()) -> Frame:
    """A frame with cameras and the pictures of some."""
    image = np.zeros((80, 120, 3), dtype=np.uint8)
    cameras = {name: looking(yaw) for name, yaw in yaws_deg.items()}
    return Frame(sequence="a", frame_id="0", cameras=cameras, images=dict.fromkeys(pictures, image))


@pytest.mark.parametrize(
    ("yaws_deg", "pictures", "name"),
    [
        ({"back": 180, "front": 0, "front_left": 55}, (), "front"),
        ({"left_colour": 1, "right_colour": 0, "left": 90}, (), "left_colour"),
        ({"back": 180, "front": 0, "front_left": 55}, ("back", "front_left"), "front_left"),
        ({"back": 180, "left": 90}, (), "back"),
        ({}, (), None),
    ],
)
def test_the_camera_ahead_is_taken(yaws_deg, pictures, name):
    assert frame_of(yaws_deg, pictures).front_camera == name


def test_kitti_and_cirrus_get_nuscenes_front_camera(tmp_path):
    """Channels come in the order of their names, of which CAM_BACK is the first."""
    write_nuscenes(tmp_path / "source", samples=1)
    source = open_dataset(tmp_path / "source")
    channel = source[0].front_camera
    assert channel == "CAM_FRONT"
    assert next(iter(source[0].cameras)) != channel
    convert(source, tmp_path / "kitti", to="kitti")
    made = open_dataset(tmp_path / "kitti")
    for got, expected in zip(made, source, strict=True):
        np.testing.assert_allclose(got.cameras["camera"].camera_T_lidar, expected.cameras[channel].camera_T_lidar)
        np.testing.assert_array_equal(got.cameras["camera"].matrix, expected.cameras[channel].matrix)
        assert got.images["camera"].shape == expected.images[channel].shape
    words = read_coordinates(tmp_path / "kitti/training/label_2")
    assert channel in words
    convert(source, tmp_path / "cirrus", to="cirrus")
    made = open_dataset(tmp_path / "cirrus")
    np.testing.assert_allclose(
        made[0].cameras["camera"].camera_T_lidar, source[0].cameras[channel].camera_T_lidar, atol=1e-6
    )
