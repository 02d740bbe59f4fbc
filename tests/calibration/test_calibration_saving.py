"""Calibrations written into the data sets' own files, read back by the readers, with what was there kept."""

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive import frame
from street import write_street

from farfield.calibration import Parameter, Solution
from farfield.calibration.camera_edges import camera_difference, move_camera
from farfield.calibration.radar_lidar import RadarCalibration
from farfield.calibration.radar_matching import RadarPose
from farfield.calibration.saving import (
    camera_files,
    save_camera,
    save_camera_where_read,
    save_lidars_where_read,
    save_radar,
    save_radar_where_read,
)
from farfield.datasets import open_dataset
from farfield.datasets.calibration import read_calibration, write_calibration
from farfield.datasets.kitti.object import calibration_text
from farfield.datasets.kradar.radar_pose import SIDE_FILE, InfoMatching, matching_path, read_matching, read_side_file
from farfield.datasets.kradar.texts import format_camera, read_camera, read_radar_calibration
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.errors import ConfigError, FileFormatError
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose_from_yaw

CAMERA = Camera(
    matrix=np.array([[567.7, 0, 628.7], [0, 577.2, 369.3], [0, 0, 1.0]]),
    distortion=np.array([-0.03, 0.0006, 0.004, -0.005, 0.0]),
    width_px=1280,
    height_px=720,
)
CHANGE = np.array([0.01, -0.02, 0.005, 0.1, -0.05, 0.02])


def radar() -> RadarCalibration:
    solution = Solution(
        parameters=(Parameter(name="x", unit="m", scale=0.01, prior_sigma=1.0),),
        value=np.array([-2.5]),
        covariance=np.eye(1) * 0.01,
        unobserved=(),
        before=np.ones(3),
        after=np.ones(3),
        converged=True,
        information=np.ones(1),
    )
    return RadarCalibration(
        pose=RadarPose(x_m=-2.5, y_m=0.25, z_m=0.7, yaw_rad=0.02, frames=-1, time_offset_s=0.012),
        solution=solution,
        echoes_above_m=0.0,
        notes=("z is not observed",),
        range_m=np.array([0.1, -0.2, 0.1]),
        azimuth_rad=np.zeros(3),
        rivals={},
    )


def test_the_radars_file_keeps_its_header_and_line_ends(tmp_path: Path) -> None:
    path = tmp_path / "calib_radar_lidar.txt"
    old = b"frame difference,x,y\r\n32,-2.54,0.3\r\n"
    path.write_bytes(old)
    written = save_radar(path, radar(), difference=32)
    assert path.read_bytes() == b"frame difference,x,y\r\n31,-2.5000,0.2500\r\n"
    assert read_radar_calibration(path) == (31, 2.5, -0.25)
    copies = [each for each in written if ".before-" in each.name]
    assert [each.read_bytes() for each in copies] == [old]
    side = read_side_file(tmp_path / SIDE_FILE)
    assert side["yaw_rad"] == 0.02
    assert side["time_offset_ns"] == 12_000_000
    np.testing.assert_allclose(side["radar_T_lidar"][:3, 3], [-2.5, 0.25, 0.7])


def test_a_side_file_that_disagrees_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "calib_radar_lidar.txt"
    save_radar(path, radar(), difference=0)
    path.write_text("frame difference,x,y\n0,-2.0,0.25\n")
    with pytest.raises(FileFormatError, match="text file counts"):
        read_side_file(tmp_path / SIDE_FILE)


def test_matching_info_is_read_as_it_is_written(tmp_path: Path) -> None:
    names = ("tesseract_00033.mat", "os2-64_00001.pcd", "cam-front_00002.png")
    given = InfoMatching(names=names, base=(-2.54, 0.3, 0.0), offset=(0.04, -0.05, 1.15))
    path = tmp_path / "00033_00001.txt"
    path.write_text(given.text())
    assert path.read_text().splitlines()[1] == "-2.500, +0.250, +1.150"
    assert not path.read_text().endswith("\n")
    assert read_matching(path) == given
    path.write_text(given.text().replace("-2.500", "-2.900"))
    with pytest.raises(FileFormatError, match="the sum"):
        read_matching(path)
    path.write_text("")
    with pytest.raises(FileFormatError, match="three names"):
        read_matching(path)


def test_a_kradar_camera_keeps_its_comments(tmp_path: Path) -> None:
    path = tmp_path / "cam_1.yml"
    path.write_text("# by hand\n" + format_camera(CAMERA, 1))
    after = move_camera(CAMERA, CHANGE)
    written = save_camera(path, "cam-front", CAMERA, after)
    assert path.read_text().startswith("# by hand\n")
    assert len(path.read_text().splitlines()) == 17
    assert len(written) == 2
    np.testing.assert_allclose(read_camera(path).camera_T_lidar, after.camera_T_lidar, atol=1e-9)


def test_kittis_change_goes_into_one_matrix(tmp_path: Path) -> None:
    path = tmp_path / "000001.txt"
    rows = {"P2": "700 0 600 45 0 700 180 0.2 0 0 1 0.003", "R0_rect": "1 0 0 0 1 0 0 0 1"}
    rows |= {"Tr_velo_to_cam": "0 -1 0 0.01 0 0 -1 -0.07 1 0 0 -0.27", "Tr_imu_to_velo": "1 0 0 0 0 1 0 0 0 0 1 0"}
    old = "".join(f"{key}: {value}\n" for key, value in rows.items())
    path.write_text(old)
    row = np.array(rows["Tr_velo_to_cam"].split(), dtype=float).reshape(3, 4)
    before = replace(CAMERA, camera_T_lidar=np.vstack([row, [0, 0, 0, 1]]))
    _, copy = save_camera(path, "image_2", before, move_camera(before, CHANGE))
    assert copy.read_text() == old
    lines = path.read_text().splitlines()
    assert [line for line in lines if not line.startswith("Tr_velo")] == [
        line for line in old.splitlines() if not line.startswith("Tr_velo")
    ]
    values = np.array(lines[2].split()[1:], dtype=float).reshape(3, 4)
    found = replace(CAMERA, camera_T_lidar=np.vstack([values, [0, 0, 0, 1]]))
    np.testing.assert_allclose(camera_difference(found, before), CHANGE, atol=1e-9)


def test_our_own_file_keeps_other_cameras(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    save_camera(path, "left", CAMERA, CAMERA)
    save_camera(path, "right", CAMERA, move_camera(CAMERA, CHANGE))
    assert set(read_calibration(path)) == {"left", "right"}
    assert len(list(tmp_path.glob("*.before-*"))) == 1
    assert json.loads(path.read_text())["cameras"]["left"]["width"] == 1280


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"\.txt, \.yml or \.json"):
        save_camera(tmp_path / "a.xml", "left", CAMERA, CAMERA)


# Written where the readers look, and read back by the readers themselves

POSE = RadarPose(x_m=-2.5, y_m=0.25, z_m=0.7, yaw_rad=0.02, frames=0, time_offset_s=0.0)


def bare_radar() -> RadarCalibration:
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
    save_radar_where_read(data, 0, bare_radar(), matching=False)
    expected = invert(pose_from_yaw(0.02, (-2.5, 0.25, 0.7)))
    for index in range(len(data)):
        found = open_dataset(kradar)[index].sensors["radar"].frame_T_sensor
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.abs(data[0].sensors["radar"].frame_T_sensor - expected).max() > 0.01  # opened before


def test_a_frames_own_matching_counts_more(kradar: Path) -> None:
    data = open_dataset(kradar)
    written = save_radar_where_read(data, 0, bare_radar())
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
    save_radar_where_read(open_dataset(kradar), 0, bare_radar(), matching=False)
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
        save_radar_where_read(data, 0, bare_radar())
    with pytest.raises(ConfigError, match="only K-Radar"):
        save_lidars_where_read(data, 0, np.eye(4))
    one = Camera(matrix=np.diag([700.0, 700, 1]), width_px=10, height_px=10)
    kitti = open_dataset(write_kitti(tmp_path / "b", [one]), format="kitti")
    other = replace(one, camera_T_lidar=move_camera(one, CHANGE).camera_T_lidar)
    with pytest.raises(ConfigError, match="--save"):
        camera_files(kitti, 0, "camera", other)
