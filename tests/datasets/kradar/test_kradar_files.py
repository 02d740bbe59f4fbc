"""K-Radar's cameras of both releases, straightened pictures, odometry, GPS, IMU, film, and axes."""

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive import frame

from farfield.datasets.kradar import KRadar, KRadarWriter
from farfield.datasets.kradar.texts import (
    IMU_COLUMNS,
    read_camera,
    read_gps,
    read_imu,
    read_local,
    read_odometry,
    read_poses,
    read_relative_odometry,
)
from farfield.datasets.kradar.undistortion import (
    straighten,
    straightened_camera,
    straightened_matrix,
    straightening_map,
)
from farfield.errors import ConfigError, FileFormatError
from farfield.files.mat import read_mat
from farfield.frame import Camera
from farfield.radar.axes import KRADAR_AXES

CAMERA = Camera(
    matrix=np.array([[567.720776, 0, 628.72078], [0, 577.213692, 369.30687], [0, 0, 1.0]]),
    distortion=np.array([-0.028873818, 0.0006023302, 0.0039573087, -0.0050471763, 0.0]),
    width_px=1280,
    height_px=720,
)


def test_the_straightened_matrix_is_the_development_kit_s() -> None:
    """Its pickled parameters hold (545.28, 570.72, 614.95, 372.48) for this camera; OpenCV 5.0 the longer figures."""
    matrix = straightened_matrix(CAMERA)
    found = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    assert np.round(found, 2).tolist() == [545.28, 570.72, 614.95, 372.48]
    np.testing.assert_allclose(found, [545.282565861, 570.715882402, 614.951749711, 372.477405798], atol=1e-3)


def test_the_kit_s_slip_is_repeated_where_it_is_asked_for() -> None:
    """Three pixels of OpenCV's map with K' as input matrix; without the slip the ray of a pixel leads to its source."""
    slip = straightening_map(CAMERA, devkit=True)
    np.testing.assert_allclose(slip[0, 0], [20.581861, 19.13118], atol=1e-3)
    np.testing.assert_allclose(slip[719, 1279], [1234.7993, 702.77606], atol=1e-3)
    np.testing.assert_allclose(slip[360, 640], [639.97504, 360.0147], atol=1e-3)
    right = straightening_map(CAMERA, devkit=False)
    pixels = np.array([[0.0, 0.0], [1279.0, 719.0], [640.0, 360.0], [100.0, 650.0]])
    rays = straightened_camera(CAMERA).rays(pixels)
    source, _, _ = CAMERA.project(50.0 * rays)
    columns, rows = pixels.astype(int).T
    np.testing.assert_allclose(right[rows, columns], source, atol=1e-3)
    assert right.min() > -0.5  # no pixel outside the raw picture is asked for
    assert (right.max(axis=(0, 1)) < [1279.5, 719.5]).all()


def test_a_straightened_picture_is_linear_between_pixels() -> None:
    ramp = np.arange(1280, dtype=np.float64)[None, :] * 0.19 * np.ones((720, 1))
    picture = np.repeat(np.rint(ramp).astype(np.uint8)[..., None], 3, axis=2)
    source = straightening_map(CAMERA, devkit=False)
    error = straighten(picture, CAMERA)[..., 0] - 0.19 * source[..., 0].astype(np.float64)
    assert np.abs(error[2:-2, 2:-2]).max() <= 1.0
    plain = replace(CAMERA, distortion=np.zeros(5))
    np.testing.assert_allclose(straightened_matrix(plain), plain.matrix, atol=1e-9)
    assert np.array_equal(straighten(picture, plain, devkit=True), picture)


def test_the_straightening_agrees_with_opencv() -> None:
    cv2 = pytest.importorskip("cv2")
    matrix, _ = cv2.getOptimalNewCameraMatrix(CAMERA.matrix, CAMERA.distortion, (1280, 720), alpha=0.0)
    np.testing.assert_allclose(straightened_matrix(CAMERA), matrix, atol=1e-3)
    maps = cv2.initUndistortRectifyMap(matrix, CAMERA.distortion, None, matrix, (1280, 720), cv2.CV_32FC1)
    np.testing.assert_allclose(straightening_map(CAMERA, devkit=True), np.stack(maps, axis=-1), atol=2e-3)


def test_cameras_without_a_picture_s_size_are_refused() -> None:
    with pytest.raises(ValueError, match="0 x 0"):
        straightened_matrix(replace(CAMERA, width_px=0, height_px=0))
    with pytest.raises(ValueError, match="folds"):
        straightened_matrix(replace(CAMERA, distortion=np.array([-3.0, 0.0, 0.0, 0.0, 0.0])))


def test_both_releases_of_the_calibrations(shared_real: Path, tmp_path: Path) -> None:
    """Measured on the published files: 21 sequences differ, 11 in every camera, the others in the front one."""
    for name in ("calib_seq", "calib_seq_v2"):
        with zipfile.ZipFile(shared_real / "kradar" / f"{name}.zip") as archive:
            archive.extractall(tmp_path / "resources" / "cam_calib")
    changed = []
    for number in range(1, 59):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / f"{number:05d}_00001.txt").write_text("")
    sets = {name: KRadar(tmp_path, calibration=name) for name in ("v1", "v2", None)}
    for number in range(1, 59):
        first, second, newest = (sets[name].of_sequence(str(number)) for name in ("v1", "v2", None))
        assert len(first.cameras) == len(second.cameras) == 8
        assert newest.camera_files == second.camera_files
        poses = [{name: camera.camera_T_lidar for name, camera in facts.cameras.items()} for facts in (first, second)]
        differ = {name for name, pose in poses[0].items() if not np.array_equal(pose, poses[1][name])}
        assert number == 11 or differ <= {"cam-front", "cam-front-right"}
        changed += [number] * bool(differ)
    assert changed == [11, 15, 16, 17, 19, 20, 21, 22, 26, 27, 28, 29, 32, 33, 41, 44, 45, 50, 54, 55, 56]
    with pytest.raises(ConfigError, match="one of v2, v1"):
        KRadar(tmp_path, calibration="v3")


def test_the_common_calibration_stands_in(tmp_path: Path) -> None:
    KRadarWriter(tmp_path, columns=512).write(frame(1))
    KRadarWriter(tmp_path).finish()
    own = KRadar(tmp_path).of_sequence("1")
    common = tmp_path / "resources" / "cam_calib" / "common"
    common.mkdir()
    own.camera_files["cam-front-right"].rename(common / "cam_front1.yml")
    again = KRadar(tmp_path).of_sequence("1")
    assert again.camera_files["cam-front-right"] == common / "cam_front1.yml"
    assert np.array_equal(again.cameras["cam-front-right"].matrix, own.cameras["cam-front-right"].matrix)


def test_relative_odometry_goes_on_from_line_to_line(shared_real: Path, tmp_path: Path) -> None:
    """The first three published lines of gt_rel/01.txt lead to the published poses of gt_01.txt."""
    folder = tmp_path / "resources" / "odometry" / "gt_rel"
    folder.mkdir(parents=True)
    (folder / "01.txt").write_text(
        "1.0 0.0 0.0 0.0 0.0 0.0 0.0\n"
        "9.999978e-01 1.243496e-03 -1.696353e-03 3.130206e-05 1.472801e+00 -6.487845e-03 3.946946e-03\n"
        "9.999972e-01 -6.540993e-04 2.022862e-03 -1.039322e-03 1.423695e+00 -2.353417e-02 -4.460656e-02\n"
    )
    absolute = read_odometry(shared_real / "kradar" / "odometry" / "gt_01.txt")
    np.testing.assert_allclose(read_poses([tmp_path], "1"), absolute[:3], atol=2e-6)
    assert read_poses([tmp_path], "2") is None
    (folder / "01.txt").write_text("1 0 0 0 0 0 0\n1 1 0 0 0 0 0")
    with pytest.raises(FileFormatError, match="unit quaternion"):
        read_relative_odometry(folder / "01.txt")


def test_gps_and_imu_are_tables_over_time(tmp_path: Path) -> None:
    local, gps, imu = tmp_path / "l.csv", tmp_path / "gps.txt", tmp_path / "imu.txt"
    local.write_text(
        "timestamp,local_x,local_y,local_z\n1643292946686577,0.000,0.000,0.000\n1643292946788769,0.384,1.339,-0.119\n"
    )
    table = read_local(local)
    assert table.time_ns.tolist() == [1_643_292_946_686_577_000, 1_643_292_946_788_769_000]
    assert table.nearest(1_643_292_946_780_000_000) == {"x_m": 0.384, "y_m": 1.339, "z_m": -0.119}
    assert table.nearest(1_643_292_950_000_000_000) is None
    gps.write_text("1643292946.25, 36.37, 127.36, 80.5, " + ", ".join(["0.01"] * 9))
    assert read_gps(gps).time_ns.tolist() == [1_643_292_946_250_000_000]
    assert read_gps(gps).nearest(1_643_292_946_000_000_000)["altitude_m"] == 80.5
    imu.write_text("1643292946250000001 " + " ".join(str(value) for value in range(24)))
    row = read_imu(imu)
    assert (row.time_ns.tolist(), row.columns) == ([1_643_292_946_250_000_001], IMU_COLUMNS)
    assert row.nearest(1_643_292_946_250_000_001)["acceleration_x_m_s2"] == 12.0
    for text in ("1643292946.25, 1, 2", "12, 1, 2, 3\n12, 1, 2, 3", "1643292946,1,2,nan\n", "1643292946,1,2,3\n,,,"):
        local.write_text(text)
        with pytest.raises(FileFormatError, match="a time and 3 finite numbers"):
            read_local(local)


def test_film_gps_and_other_folder_names_belong_to_a_frame(tmp_path: Path) -> None:
    KRadarWriter(tmp_path, columns=512).write(frame(1))
    KRadarWriter(tmp_path).finish()
    (tmp_path / "1" / "cam-front").rename(tmp_path / "1" / "cam_front")
    (tmp_path / "1" / "cam-dash").mkdir()
    (tmp_path / "1" / "cam-dash" / "1.mp4").write_bytes(b"no film")
    (tmp_path / "1" / "gps.txt").write_text("1643292946.9, 36.37, 127.36, 80.5, " + ", ".join(["0"] * 9))
    back = KRadar(tmp_path)[0]
    assert np.array_equal(back.images["cam-front"], frame(1).images["cam-front"])
    assert Path(back.metadata["video"]) == tmp_path / "1" / "cam-dash" / "1.mp4"
    assert back.metadata["gps"]["latitude_deg"] == 36.37
    assert "imu" not in back.metadata


def test_the_dashboard_cameras_frame_is_that_of_the_frames_time(tmp_path: Path) -> None:
    """A film whose grey rises by ten a frame of a tenth of a second, which begins with the sequence's first file."""
    av = pytest.importorskip("av")
    for number in range(3):
        KRadarWriter(tmp_path, columns=512).write(frame(number))
    KRadarWriter(tmp_path).finish()
    (tmp_path / "1" / "cam-dash").mkdir()
    with av.open(str(tmp_path / "1" / "cam-dash" / "1.mp4"), "w") as film:
        stream = film.add_stream("libx264", rate=10, options={"crf": "4"})
        stream.width = stream.height = 32
        for number in range(40):
            grey = np.full((32, 32, 3), 10 + 5 * number, dtype=np.uint8)
            film.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        film.mux(stream.encode())
    back = KRadar(tmp_path)
    first_ns = min(back.of_sequence("1").times_ns.values())
    for index in range(3):
        shown = back[index].images["cam-dash"]
        place = min(39, round((back[index].time_ns - first_ns) / 1e8))
        assert abs(float(shown.mean()) - (10 + 5 * place)) < 2.5
    assert next(iter(back[0].images)) != "cam-dash"


def test_the_real_axes_are_those_of_the_radar_room(shared_real: Path) -> None:
    """``info_arr.mat`` counts both angles as the tensor stores them: to the right and downwards."""
    info, doppler = (shared_real / "kradar" / name for name in ("info_arr.mat", "arr_doppler.mat"))
    np.testing.assert_allclose(read_mat(info, "arrRange").ravel(), KRADAR_AXES.range_m, atol=1e-9)
    assert np.array_equal(read_mat(info, "arrAzimuth").ravel(), KRADAR_AXES.azimuth_deg)
    assert np.array_equal(read_mat(info, "arrElevation").ravel(), KRADAR_AXES.elevation_deg)
    np.testing.assert_allclose(read_mat(doppler, "arr_doppler").ravel(), KRADAR_AXES.doppler_m_s, atol=1e-9)


def test_a_camera_file_in_any_order_of_keys(tmp_path: Path) -> None:
    keys = {"cam_number": 1, "fx": 567.7, "fy": 577.2, "px": 628.7, "py": 369.3, "yaw_ldr2cam": 0.5}
    rest = ("k1", "k2", "k3", "k4", "k5", "pitch_ldr2cam", "roll_ldr2cam", "x_ldr2cam", "y_ldr2cam", "z_ldr2cam")
    lines = [f"{key}: {value}" for key, value in (keys | dict.fromkeys(rest, 0.0)).items()]
    (tmp_path / "a.yml").write_text("\n".join(lines))
    (tmp_path / "b.yml").write_text("\n".join(reversed(lines)))
    cameras = [read_camera(tmp_path / name) for name in ("a.yml", "b.yml")]
    assert np.array_equal(cameras[0].camera_T_lidar, cameras[1].camera_T_lidar)
