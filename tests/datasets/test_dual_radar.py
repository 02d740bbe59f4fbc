"""Dual-Radar's frames, written as the authors' code describes them: turned axes, labels' axes decided, refusals."""

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from farfield.datasets import open_dataset, recognise
from farfield.errors import DatasetError, FarfieldError

# In the LiDAR's own axes (x right, y forward, z up): two cars, turned by 0.3 and -0.2 about z
CENTRES, YAWS = np.array([[2.0, 20.0, -1.0], [-6.0, 45.0, -0.8]]), (0.3, -0.2)
LENGTH, WIDTH, HEIGHT = 4.4, 1.8, 1.6
CAMERA_T_LIDAR = np.array([[1.0, 0, 0, 0.1], [0, 0, -1, -0.3], [0, 1, 0, -0.2], [0, 0, 0, 1]])
ARBE_T_M, ARS_T_M = (0.0780045, 2.2140800, -1.6030740), (0.0715209, 1.9685450, -1.1990910)


def label(centre: np.ndarray, yaw: float, track: int, axes: str = "camera") -> str:
    bottom = centre - [0, 0, HEIGHT / 2]
    place = {"camera": CAMERA_T_LIDAR[:3, :3] @ bottom + CAMERA_T_LIDAR[:3, 3], "lidar": centre}[axes]
    turn = -yaw if axes == "camera" else yaw
    numbers = [0.1, 1, 0, 10, 20, 30, 40, HEIGHT, WIDTH, LENGTH, *place, turn, -1, track]
    return " ".join(["Car", *map(str, numbers)])


def write_frames(root: Path, frames: int = 3, axes: str = "camera", lidar: str = "robosense") -> Path:
    base = root / "training"
    for folder in (lidar, "arbe", "ars548", "calib", "image", "label"):
        (base / folder).mkdir(parents=True)
    rows = [[*centre, 51, ring, 7.5] for ring, centre in enumerate(CENTRES)] + [
        [0, 0, 0, 0, 3, 7.5],
        [1, 9, -2, 255, 4, 8],
    ]
    calib = {
        "P2": [100, 0, 32, 0, 0, 110, 24, 0, 0, 0, 1, 0],
        "R0_rect": np.eye(3).ravel(),
        "Tr_velo_to_cam": CAMERA_T_LIDAR[:3].ravel(),
    }
    for number in range(frames):
        np.array(rows, "<f4").tofile(base / f"{lidar}/{number:06d}.bin")
        np.array([[0, 10, 0, 5, -3]], "<f4").tofile(base / f"arbe/{number:06d}.bin")
        np.array([[10, 0, 0, 5, 2], [20, 1, 0, 6, 1]], "<f4").tofile(base / f"ars548/{number:06d}.bin")
        text = "\n".join(f"{name}: {' '.join(map(str, values))}" for name, values in calib.items())
        (base / f"calib/{number:06d}.txt").write_text(text + "\n")
        Image.new("RGB", (64, 48)).save(base / f"image/{number:06d}.png")
        lines = [label(centre, yaw, 7 + row, axes) for row, (centre, yaw) in enumerate(zip(CENTRES, YAWS, strict=True))]
        lines.append("DontCare -1 -1 -10 1 2 3 4 -1 -1 -1 -1000 -1000 -1000 -10 -1 -1")
        (base / f"label/{number:06d}.txt").write_text("\n".join(lines) + "\n")
    return root


@pytest.mark.parametrize("lidar", ["robosense", "velodyne"])
def test_all_is_turned_so_that_x_is_forward(tmp_path: Path, lidar: str) -> None:
    write_frames(tmp_path, lidar=lidar)
    assert recognise(tmp_path) == recognise(tmp_path / "training") == "dual_radar"
    data = open_dataset(tmp_path)
    frame = data[1]
    cloud, boxes = frame.cloud("lidar"), frame.boxes
    assert boxes is not None
    np.testing.assert_allclose(cloud.points_m[:2], CENTRES[:, [1, 0, 2]] * [1, -1, 1], atol=1e-5)
    np.testing.assert_allclose(cloud.intensity, [0.2, 0.2, 1])
    assert (cloud.extra["ring"].tolist(), cloud.missing) == ([0, 1, 4], 1)
    np.testing.assert_allclose(boxes.centre_m, CENTRES[:, [1, 0, 2]] * [1, -1, 1], atol=1e-9)
    np.testing.assert_allclose(boxes.size_m, [[LENGTH, WIDTH, HEIGHT]] * 2)
    np.testing.assert_allclose(boxes.yaw_rad, np.array(YAWS) - np.pi / 2)
    assert boxes.track_id is not None
    assert boxes.track_id.tolist() == [7, 8]
    assert [len(rows) for rows in cloud.in_boxes(boxes)] == [1, 1]
    assert list(boxes.label) == ["vehicle", "vehicle"]
    assert frame.annotation is not None
    assert frame.annotation.unboxed["dontcare_px"].tolist() == [[1, 2, 3, 4]]
    assert "camera 100%" in data.unwrapped.assumptions[0]
    assert data.drives() == ()


def test_radars_stand_where_the_authors_code_has_them(tmp_path: Path) -> None:
    frame = open_dataset(write_frames(tmp_path))[0]
    arbe, ars = frame.cloud("arbe"), frame.cloud("ars548")
    right, ahead, up = ARBE_T_M  # its y looks along the LiDAR's but for some degrees
    np.testing.assert_allclose(arbe.points_m, [[ahead + 9.980, -right - 0.5916, up + 0.2212]], atol=1e-3)
    right, ahead, up = ARS_T_M  # its x looks along the LiDAR's y
    np.testing.assert_allclose(ars.points_m[:1], [[ahead + 9.9558, -right - 0.8066, up + 0.4820]], atol=1e-3)
    assert (arbe.kind, ars.kind) == ("radar", "radar")
    assert arbe.column("doppler_m_s").tolist() == [-3]
    assert ars.column("strength").tolist() == [5, 6]


def test_the_camera_projects(tmp_path: Path) -> None:
    frame = open_dataset(write_frames(tmp_path))[0]
    pixels, depth, _ = frame.cameras["camera"].project(np.array([[10.2, 0.1, -0.3]]))  # 0.1 m left of the LiDAR
    np.testing.assert_allclose(pixels, [[32, 24]], atol=1e-9)
    np.testing.assert_allclose(depth, [10])


def test_axes_that_cannot_be_told_are_refused_and_can_be_said(tmp_path: Path) -> None:
    write_frames(tmp_path, axes="lidar")
    with pytest.raises(DatasetError, match=r"camera 0%, lidar 100%.*--label-axes"):
        _ = open_dataset(tmp_path)[0]
    boxes = open_dataset(tmp_path, label_axes="lidar")[0].boxes
    assert boxes is not None
    np.testing.assert_allclose(boxes.centre_m, CENTRES[:, [1, 0, 2]] * [1, -1, 1], atol=1e-9)
    np.testing.assert_allclose(boxes.yaw_rad, np.array(YAWS) - np.pi / 2)


def test_without_a_lidar_the_axes_have_to_be_said(tmp_path: Path) -> None:
    write_frames(tmp_path)
    for path in (tmp_path / "training" / "robosense").iterdir():
        path.unlink()
    with pytest.raises(DatasetError, match=r"clouds of the LiDAR \(robosense\).*--label-axes"):
        _ = open_dataset(tmp_path)[0]
    assert len(open_dataset(tmp_path, label_axes="camera")[0].boxes) == 2  # type: ignore[arg-type]


def test_one_radar_tells_the_set_from_kittis(tmp_path: Path) -> None:
    """Read as KITTI's, all would be turned by 90 degrees."""
    write_frames(tmp_path, lidar="velodyne")
    for path in (tmp_path / "training" / "ars548").iterdir():
        path.unlink()
    (tmp_path / "training" / "ars548").rmdir()
    assert recognise(tmp_path) == "dual_radar"


def test_parts_are_those_of_the_lists(tmp_path: Path) -> None:
    write_frames(tmp_path)
    (tmp_path / "ImageSets").mkdir()
    (tmp_path / "ImageSets" / "train.txt").write_text("000000\n000002\n")
    assert open_dataset(tmp_path).split("train").frame_ids == ("000000", "000002")


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("label", " 7\n", "\n"),
        ("label", " 7\n", " 7 8\n"),
        ("label", " 7\n", " 7.5\n"),
        ("label", "Car 0.1", "Car nan"),
        ("label", f" {LENGTH} ", " -4.4 "),
        ("calib", "Tr_velo_to_cam", "Tr_other"),
        ("calib", "1.0 0.0 0.0 0.1", "2.0 0.0 0.0 0.1"),
    ],
)
def test_damaged_texts_are_refused(tmp_path: Path, file: str, old: str, new: str) -> None:
    write_frames(tmp_path, frames=1)
    path = tmp_path / "training" / file / "000000.txt"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FarfieldError, match="000000"):
        read_all(tmp_path)


@pytest.mark.parametrize(
    ("kind", "row"),
    [
        ("robosense", [1, 2, 3, math.nan, 0, 0]), ("robosense", [1, 2, 3, -1, 0, 0]),
        ("robosense", [1, 2, 3, 1, 0.5, 0]),
        ("robosense", [1, 2, 3, 1, 2000, 0]), ("arbe", [1, 2, 3, math.inf, 0]), ("ars548", [1, 2, 3, 0, math.nan]),
        ("arbe", [1, 2, 3, 4]),
    ],
)  # fmt: skip
def test_damaged_clouds_are_refused(tmp_path: Path, kind: str, row: list[float]) -> None:
    write_frames(tmp_path, frames=1)
    np.array([row], "<f4").tofile(tmp_path / f"training/{kind}/000000.bin")
    with pytest.raises(FarfieldError, match="000000"):
        read_all(tmp_path)


def read_all(root: Path) -> None:
    frame = open_dataset(root, label_axes="camera")[0]
    _ = frame.annotation, frame.cameras, [frame.cloud(name) for name in frame.clouds]


def test_unknown_options_are_refused(tmp_path: Path) -> None:
    write_frames(tmp_path, frames=1)
    for options in ({"label_axes": "body"}, {"classes": "mine"}, {"intensity_scale": -1}):
        with pytest.raises(FarfieldError):
            open_dataset(tmp_path, **options)
