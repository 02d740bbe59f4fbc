"""KITTI's columns with a unit calibration: labels in the LiDAR's axes are recognised, refused, and read by a flag."""

from pathlib import Path

import numpy as np
import pytest
from trees import write_kitti, write_kitti_tracking

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.labels import label_format
from farfield.errors import ConfigError, DatasetError
from farfield.inspection.doctor import examine

P2 = "700 0 600 0 0 700 180 0 0 0 1 0"
UNIT = f"P2: {P2}\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 1 0 0 0 0 1 0 0 0 0 1 0\n"
CAR = "Car 0 0 0 10 10 50 50 1.5 1.8 4.4 20 2 -0.95 0.3\n"


@pytest.fixture(params=["kitti", "kitti_tracking"])
def own(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    training = tmp_path / "training"
    if request.param == "kitti":
        write_kitti(tmp_path)
        (training / "calib" / "000007.txt").write_text(UNIT)
        (training / "label_2" / "000007.txt").write_text(CAR)
    else:
        write_kitti_tracking(tmp_path)
        (training / "calib" / "0003.txt").write_text(UNIT)
        (training / "label_02" / "0003.txt").write_text(f"0 0 {CAR}")
    return tmp_path


@pytest.mark.parametrize(("axes", "z"), [("lidar", -0.95), ("lidar-bottom", -0.2)])
def test_labels_in_lidar_axes_are_read_as_the_flag_says(own: Path, axes: str, z: float) -> None:
    data = open_dataset(own, label_axes=axes)
    boxes = data[0].boxes
    np.testing.assert_allclose(boxes.centre_m, [[20, 2, z]])
    np.testing.assert_allclose(boxes.size_m, [[4.4, 1.8, 1.5]])
    np.testing.assert_allclose(boxes.yaw_rad, [0.3])
    assert not data[0].cameras
    assert label_format(data) is None


def test_without_the_flag_they_are_refused_with_it(own: Path) -> None:
    data = open_dataset(own)
    with pytest.raises(DatasetError, match=r"unit matrices.*--label-axes lidar .*lidar-bottom"):
        data[0].boxes  # noqa: B018
    findings = [finding.what for finding in examine(data).findings if finding.topic == "damaged"]
    assert any("--label-axes" in what for what in findings)
    with pytest.raises(ConfigError, match="camera, lidar, lidar-bottom"):
        open_dataset(own, label_axes="other")


def test_the_flag_works_in_a_verb(own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path.with_name(f"{tmp_path.name}-boxes.csv")
    words = ["convert", str(own), str(table), "--to", "boxes-csv"]
    assert main(words) == 1
    assert "--label-axes" in capsys.readouterr().err
    assert main([*words, "--label-axes", "lidar"]) == 0
    assert "20.0,2.0,-0.95,4.4,1.8,1.5,0.3" in table.read_text()


def test_labels_in_lidar_axes_need_no_calibration(tmp_path: Path) -> None:
    write_kitti(tmp_path)
    (tmp_path / "training" / "calib" / "000007.txt").unlink()
    (tmp_path / "training" / "label_2" / "000007.txt").write_text(CAR)
    assert open_dataset(tmp_path, label_axes="lidar")[0].boxes.centre_m.tolist() == [[20, 2, -0.95]]
    with pytest.raises(DatasetError, match="--label-axes lidar"):
        open_dataset(tmp_path)[0]


def test_kitti_s_own_calibrations_are_none_of_these(shared_real: Path) -> None:
    assert [len(frame.boxes) for frame in open_dataset(shared_real / "kitti")] == [1, 3, 15]
