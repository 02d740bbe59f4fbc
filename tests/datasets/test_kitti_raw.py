"""KITTI raw: the real drive's stamps, boxes and calibration; a written drive; what is refused."""

from pathlib import Path

import numpy as np
import pytest

from farfield.api import open_dataset
from farfield.errors import DatasetError, FileFormatError
from farfield.files.kitti import read_raw_calib, read_record
from farfield.geometry.boxes import count_points_in_boxes

DRIVE = "2011_09_26/2011_09_26_drive_0009_sync"
RECORD = [49.0, 8.4, 116.0, 0.0, 0.0, np.pi / 2, *[0.0] * 24]
TRACKLET = """<boost_serialization><tracklets><count>1</count><item><objectType>Car</objectType>
<h>1.5</h><w>1.6</w><l>4</l><first_frame>1</first_frame><poses><count>1</count>
<item><tx>20</tx><ty>1</ty><tz>-1.7</tz><rx>0</rx><ry>0</ry><rz>0.5</rz></item></poses></item></tracklets>
</boost_serialization>"""


def drive(root: Path, *, step_deg: float = 1e-5, rotation: str = "1 0 0 0 1 0 0 0 1") -> Path:
    """A drive of two frames that goes north by ``step_deg`` a frame."""
    folder = root / DRIVE
    for name in ("velodyne_points/data", "oxts/data"):
        (folder / name).mkdir(parents=True)
    for number in range(2):
        rows = np.random.default_rng(number).uniform(-20, 20, (30, 4)).astype(np.float32)
        rows[:, 3] = 0.5
        rows.tofile(folder / "velodyne_points" / "data" / f"{number:010d}.bin")
        record = [RECORD[0] + number * step_deg, *RECORD[1:]]
        (folder / "oxts" / "data" / f"{number:010d}.txt").write_text(" ".join(map(str, record)))
    for name, shift in (("timestamps", 50), ("timestamps_start", 0), ("timestamps_end", 100)):
        lines = [f"2011-09-26 13:02:25.{100 * number + shift:03d}000000" for number in range(2)]
        (folder / "velodyne_points" / f"{name}.txt").write_text("\n".join(lines) + "\n")
    (folder / "tracklet_labels.xml").write_text(TRACKLET)
    (folder.parent / "calib_imu_to_velo.txt").write_text(f"calib_time: now\nR: {rotation}\nT: 0 0 0\n")
    return root


def test_the_real_drive_has_its_boxes_stamps_and_cameras(shared_real: Path) -> None:
    data = open_dataset(shared_real / "kitti_raw")
    assert (data.name, len(data)) == ("kitti_raw", 4)
    points = [count_points_in_boxes(frame.clouds["lidar"].points_m, frame.boxes) for frame in data]
    assert len(np.concatenate(points)) == 20  # all hold points, the tram at 87 m 14 to 23: counted by another program
    assert min(np.concatenate(points)) > 0
    tram = [int(count[frame.boxes.label == "large_vehicle"][0]) for count, frame in zip(points, data, strict=True)]
    assert (min(tram), max(tram)) == (14, 23)
    frame = data[0]
    start, end = frame.metadata["turn_ns"]
    assert frame.time_ns is not None
    assert (frame.time_ns - start) / 1e6 == pytest.approx(51.6, abs=0.1)
    assert (end - start) / 1e6 == pytest.approx(103.15, abs=0.1)
    assert frame.sensors["image_02"].time_ns == frame.time_ns + 10_462_359
    assert len(data.drives()) == 1


def test_its_camera_is_that_of_the_object_benchmark(shared_real: Path) -> None:
    """Frame 002364 of the object benchmark is this drive's second."""
    camera = open_dataset(shared_real / "kitti_raw")[1].cameras["image_02"]
    same = next(frame for frame in open_dataset(shared_real / "kitti_more") if frame.frame_id == "002364")
    np.testing.assert_allclose(camera.matrix, same.cameras["camera"].matrix, atol=1e-9)
    np.testing.assert_allclose(camera.camera_T_lidar, same.cameras["camera"].camera_T_lidar, atol=1e-6)


def test_the_gps_tells_the_way(tmp_path: Path) -> None:
    """1e-5 degrees of latitude are 1.11 m; yaw pi / 2 looks north, so that this is straight ahead."""
    first, second = open_dataset(drive(tmp_path))
    assert first.world_T_frame is not None
    assert second.world_T_frame is not None
    moved = np.linalg.inv(first.world_T_frame) @ second.world_T_frame
    np.testing.assert_allclose(moved[:3, 3], [np.radians(1e-5) * 6_378_137.0, 0, 0], atol=1e-6)


def test_objects_stand_in_their_frames(tmp_path: Path) -> None:
    first, second = open_dataset(drive(tmp_path))
    assert (len(first.boxes), len(second.boxes)) == (0, 1)
    np.testing.assert_allclose(second.boxes.centre_m[0], [20, 1, -0.95])
    assert second.boxes.yaw_rad[0] == 0.5


@pytest.mark.parametrize(
    ("text", "message"),
    [("R 1 2 3\n", "line 1"), ("R: 1 a\n", "line 1"), ("R: 1\nR: 2\n", "line 2"), ("", "no such")],
)
def test_a_damaged_calibration_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "calib_velo_to_cam.txt"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_raw_calib(path)


def test_a_record_of_another_length_and_a_motion_that_is_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "0.txt"
    path.write_text("49 8 116")
    with pytest.raises(FileFormatError, match="30 numbers"):
        read_record(path)
    with pytest.raises(FileFormatError, match="a rotation"):
        open_dataset(drive(tmp_path / "turned", rotation="0 0 0 0 0 0 0 0 0"))[0]


def test_a_folder_without_drives_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="timestamps"):
        open_dataset(tmp_path, format="kitti_raw")
