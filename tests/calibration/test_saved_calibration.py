"""Calibrations written into the data sets' own files, read back by the readers, with what was there kept."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.calibration import Parameter, Solution
from farfield.calibration.camera_edges import camera_difference, move_camera
from farfield.calibration.radar_lidar import RadarCalibration
from farfield.calibration.radar_matching import RadarPose
from farfield.calibration.saving import save_camera, save_radar
from farfield.datasets.calibration import read_calibration
from farfield.datasets.kradar.radar_pose import SIDE_FILE, InfoMatching, read_matching, read_side_file
from farfield.datasets.kradar.texts import format_camera, read_camera, read_radar_calibration
from farfield.errors import FileFormatError
from farfield.geometry.cameras import Camera

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
