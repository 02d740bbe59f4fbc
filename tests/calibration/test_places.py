"""Calibrations written where the readers look, and read back by the readers themselves."""

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive import frame
from street import write_street

from farfield.calibration.camera_edges import camera_difference, move_camera
from farfield.calibration.least_squares import Solution
from farfield.calibration.radar_lidar import RadarCalibration
from farfield.calibration.radar_matching import RadarPose
from farfield.calibration.saving import (
    camera_files,
    save_camera_where_read,
    save_lidars_where_read,
    save_radar_where_read,
)
from farfield.datasets import open_dataset
from farfield.datasets.calibration import write_calibration
from farfield.datasets.kitti.object import calibration_text
from farfield.datasets.kradar.radar_pose import matching_path, read_matching
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.errors import ConfigError
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose_from_yaw

CHANGE = np.array([0.01, -0.02, 0.005, 0.1, -0.05, 0.02])
POSE = RadarPose(x_m=-2.5, y_m=0.25, z_m=0.7, yaw_rad=0.02, frames=0, time_offset_s=0.0)


def radar() -> RadarCalibration:
    nothing = np.ones(0)
    solution = Solution(
        parameters=(),
        value=nothing,
        covariance=np.zeros((0, 0)),
        unobserved=(),
        before=nothing,
        after=nothing,
        converged=True,
        information=nothing,
    )
    return RadarCalibration(
        pose=POSE, solution=solution, echoes_above_m=0.0, notes=(), range_m=nothing, azimuth_rad=nothing, rivals={}
    )


@pytest.fixture
def kradar(tmp_path: Path) -> Path:
    writer = KRadarWriter(tmp_path / "set", columns=512)
    for number in (1, 2):
        writer.write(frame(number))
    writer.finish()
    return writer.root


def test_the_yaw_reaches_kradars_frames(kradar: Path) -> None:
    data = open_dataset(kradar)
    save_radar_where_read(data, 0, radar(), matching=False)
    expected = invert(pose_from_yaw(0.02, (-2.5, 0.25, 0.7)))
    for index in range(len(data)):
        found = open_dataset(kradar)[index].sensors["radar"].frame_T_sensor
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.abs(data[0].sensors["radar"].frame_T_sensor - expected).max() > 0.01  # opened before


def test_a_frames_own_matching_counts_more(kradar: Path) -> None:
    data = open_dataset(kradar)
    written = save_radar_where_read(data, 0, radar())
    own = [each for each in written if each.parent.name == "info_matching"]
    assert len(own) == len(data)
    first = kradar / matching_path("1", data.frame_ids[0])
    found = read_matching(first)
    np.testing.assert_allclose(found.base, (-2.54, 0.3, 0.0), atol=1e-9)
    np.testing.assert_allclose(found.total, (-2.5, 0.25, np.degrees(0.02)), atol=5e-4)  # three decimals
    assert found.names == ("tesseract_00033.mat", "os2-64_00001.pcd", "cam-front_00002.png")
    first.write_text(first.read_text().replace("+1.146", "+2.146"))
    poses = [open_dataset(kradar)[index].sensors["radar"].frame_T_sensor for index in (0, 1)]
    angles = [np.degrees(np.arctan2(each[0, 1], each[0, 0])) for each in poses]
    np.testing.assert_allclose(angles, [2.146, 1.146], atol=1e-3)


def test_a_text_file_changed_by_hand_counts_and_is_warned_of(kradar: Path) -> None:
    save_radar_where_read(open_dataset(kradar), 0, radar(), matching=False)
    (kradar / "1/info_calib/calib_radar_lidar.txt").write_text("frame difference,x,y\n32,-2.0,0.25\n")
    with pytest.warns(UserWarning, match="text file counts"):
        found = open_dataset(kradar)[0].sensors["radar"].frame_T_sensor
    np.testing.assert_allclose(found, pose_from_yaw(0.0, (2.0, -0.25, -0.7)), atol=1e-12)


def test_the_second_lidars_pose_is_read_back(kradar: Path) -> None:
    pose = pose_from_yaw(0.03, (0.4, 0.1, -0.2))
    save_lidars_where_read(open_dataset(kradar), 0, pose)
    np.testing.assert_allclose(open_dataset(kradar)[1].sensors["os1-128"].frame_T_sensor, pose, atol=1e-12)


@pytest.mark.parametrize("release", ["v1", "v2"])
def test_real_cameras_of_both_releases(kradar: Path, shared_real: Path, release: str) -> None:
    shutil.rmtree(kradar / "resources" / "cam_calib")
    for name in ("calib_seq", "calib_seq_v2"):
        with zipfile.ZipFile(shared_real / "kradar" / f"{name}.zip") as archive:
            archive.extractall(kradar / "resources" / "cam_calib")
    data = open_dataset(kradar, calibration=release)
    before = data[0].cameras["cam-front"]
    after = move_camera(before, CHANGE)
    written, copy = save_camera_where_read(data, 0, "cam-front", before, after)
    assert written.parent.parent.name == {"v1": "calib_seq", "v2": "calib_seq_v2"}[release]
    found = open_dataset(kradar, calibration=release)[0].cameras["cam-front"]
    np.testing.assert_allclose(camera_difference(found, after), 0, atol=1e-9)
    np.testing.assert_array_equal(found.matrix, before.matrix)
    np.testing.assert_array_equal(found.distortion, before.distortion)
    new, old = (path.read_text().splitlines() for path in (written, copy))
    assert [line.split(":")[0] for line in new] == [line.split(":")[0] for line in old]
    assert sum(a != b for a, b in zip(new, old, strict=True)) == 6  # the pose alone


def write_kitti(root: Path, cameras: list[Camera]) -> Path:
    for kind in ("velodyne", "calib", "image_2"):
        (root / "training" / kind).mkdir(parents=True)
    for number, camera in enumerate(cameras):
        np.ones((5, 4), np.float32).tofile(root / f"training/velodyne/{number:06d}.bin")
        (root / f"training/calib/{number:06d}.txt").write_text(calibration_text(camera))
    return root


def test_kittis_files_of_the_same_car_are_changed_alone(tmp_path: Path) -> None:
    matrix = np.array([[707.0493, 0, 604.0814], [0, 707.0493, 180.5066], [0, 0, 1]])
    one = Camera(matrix=matrix, width_px=1224, height_px=370)
    data = open_dataset(write_kitti(tmp_path, [one, one, move_camera(one, CHANGE)]), format="kitti")
    before = data[0].cameras["camera"]
    after = move_camera(before, 2 * CHANGE)
    written = save_camera_where_read(data, 0, "camera", before, after)
    assert len([each for each in written if each.suffix == ".txt"]) == 2
    again = open_dataset(tmp_path, format="kitti")
    np.testing.assert_allclose(camera_difference(again[1].cameras["camera"], before), 2 * CHANGE, atol=1e-6)
    np.testing.assert_allclose(camera_difference(again[2].cameras["camera"], one), CHANGE, atol=1e-6)


@pytest.mark.parametrize("named", [None, "car/front.yaml"])
def test_cirrus_reads_what_was_written(tmp_path: Path, rng: np.random.Generator, named: str | None) -> None:
    root = write_street(tmp_path, rng)
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text("{}" if named is None else f"calib: {{file: {named}}}\n")
    data = open_dataset(root, mapping=mapping)
    if named is not None:
        (root / "car").mkdir()
        write_calibration(root / named, {"other": Camera(matrix=np.eye(3))})
    camera = Camera(
        matrix=np.diag([900.0, 900, 1]), camera_T_lidar=move_camera(Camera(matrix=np.eye(3)), CHANGE).camera_T_lidar
    )
    save_camera_where_read(data, 0, "camera", None, camera)
    found = open_dataset(root, mapping=mapping)[0].cameras
    np.testing.assert_allclose(found["camera"].camera_T_lidar, camera.camera_T_lidar)
    assert ("other" in found) == (named is not None)


def test_a_set_without_a_place_is_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    data = open_dataset(write_street(tmp_path / "a", rng))
    with pytest.raises(ConfigError, match="only K-Radar"):
        save_radar_where_read(data, 0, radar())
    with pytest.raises(ConfigError, match="only K-Radar"):
        save_lidars_where_read(data, 0, np.eye(4))
    one = Camera(matrix=np.diag([700.0, 700, 1]), width_px=10, height_px=10)
    kitti = open_dataset(write_kitti(tmp_path / "b", [one]), format="kitti")
    other = replace(one, camera_T_lidar=move_camera(one, CHANGE).camera_T_lidar)
    with pytest.raises(ConfigError, match="--save"):
        camera_files(kitti, 0, "camera", other)
