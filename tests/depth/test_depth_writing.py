"""Depth maps of data sets: clouds and cameras by name, scales, names of files, interrupted runs."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fans import camera, directions, onto_plane

from farfield.datasets import open_dataset
from farfield.datasets.kitti.object import KittiWriter
from farfield.depth import frame_depth
from farfield.depth.writing import DepthSettings, write_depth_maps
from farfield.errors import ConfigError, DatasetError
from farfield.files.depth_png import read_depth
from farfield.frame import Cloud, Frame, Sensor
from farfield.geometry.boxes import Boxes


def frame(far_m: float = 40.0, number: int = 0) -> Frame:
    """Ground and a wall before a camera."""
    rays, ring = directions(24, columns=900)
    ground = onto_plane(rays, np.array([0, 0, -1.0]), 1.7)
    ranges = np.minimum(ground, onto_plane(rays, np.array([1.0, 0, 0]), far_m))
    hit = np.isfinite(ranges)
    points = (rays[hit] * ranges[hit, None]).astype(np.float32)
    cloud = Cloud(points, np.full(len(points), 0.5, np.float32), {"ring": ring[hit].astype(np.uint8)})
    lens = camera()
    image = np.full((lens.height_px, lens.width_px, 3), 90, np.uint8)
    return Frame.of(cloud, Boxes.empty(), frame_id=f"{number:06d}", images={"camera": image}, cameras={"camera": lens})


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    for number in range(3):
        KittiWriter(tmp_path / "kitti").write(number, frame(30.0 + number, number))
    return tmp_path / "kitti"


def test_a_data_set_becomes_a_folder_of_maps(kitti: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    written = write_depth_maps(open_dataset(kitti), out, DepthSettings(uncertainty=True))
    assert (written.outcome.written, written.outcome.skipped) == (3, 0)
    summary = json.loads((out / "depth.json").read_text())
    assert summary == written.summary
    assert summary["depth_scale"] == 256
    assert summary["methods"] == {"rings": 3}  # told from the order of the rows: KITTI's files have no ring
    depth = sorted((out / "depth").rglob("*.png"))
    assert [path.name for path in depth] == ["000000.png", "000001.png", "000002.png"]
    for path in depth:
        found, doubt = read_depth(path), read_depth(out / "uncertainty" / path.relative_to(out / "depth"))
        assert found.notes["method"] == "rings"
        assert found.depth_m.shape == doubt.depth_m.shape == (160, 300)
        assert np.array_equal(np.isnan(found.depth_m), np.isnan(doubt.depth_m))
    again = write_depth_maps(open_dataset(kitti), out, DepthSettings(uncertainty=True))
    assert (again.outcome.written, again.outcome.skipped) == (0, 3)


def test_one_far_point_gives_all_files_the_second_scale(kitti: Path, tmp_path: Path) -> None:
    KittiWriter(kitti).write(3, frame(300.0, 3))
    data = open_dataset(kitti)
    auto = write_depth_maps(data, tmp_path / "auto")
    assert auto.summary["depth_scale"] == 128
    assert auto.summary["beyond_end"] == 0
    maps = [read_depth(path) for path in sorted((tmp_path / "auto" / "depth").rglob("*.png"))]
    assert [each.scale for each in maps] == [128] * 4
    assert np.nanmax(maps[3].depth_m) == pytest.approx(299.7, abs=0.2)
    near = write_depth_maps(data, tmp_path / "near", DepthSettings(scale="256"))
    assert near.summary["beyond_end"] > 100
    assert np.nanmax(read_depth(sorted((tmp_path / "near").rglob("*.png"))[3]).depth_m) < 256


def test_less_sure_pixels_are_left_out(kitti: Path, tmp_path: Path) -> None:
    data = open_dataset(kitti)
    every = write_depth_maps(data, tmp_path / "a").summary["filled"]
    sure = write_depth_maps(data, tmp_path / "b", DepthSettings(max_uncertainty_m=0.3)).summary["filled"]
    assert 0.1 < sure < every


def test_the_data_set_s_own_folder_is_refused(kitti: Path) -> None:
    with pytest.raises(ConfigError, match="apart"):
        write_depth_maps(open_dataset(kitti), kitti)


def test_what_a_frame_does_not_have_is_named() -> None:
    whole = frame()
    for wanted, match in (({"cloud": "radar"}, "'radar'.*lidar"), ({"camera": "rear"}, "'rear'.*camera")):
        with pytest.raises(DatasetError, match=match):
            frame_depth(whole, **wanted)
    with pytest.raises(DatasetError, match="calibrated camera"):
        frame_depth(replace(whole, cameras={}))
    with pytest.raises(DatasetError, match="LiDAR"):
        frame_depth(replace(whole, clouds={}))


def test_a_cloud_in_its_own_axes_gives_the_same_map() -> None:
    """A sensor that stands elsewhere, its points moved into the frame or left in their own axes."""
    whole = frame()
    straight = frame_depth(whole)
    pose = np.eye(4)
    pose[:3, 3] = [1.0, 2.0, 0.5]
    moved = replace(
        whole,
        sensors={"lidar": Sensor(kind="lidar", frame_T_sensor=pose, in_frame=False)},
        cameras={
            "camera": replace(
                whole.cameras["camera"], camera_T_lidar=whole.cameras["camera"].camera_T_lidar @ np.linalg.inv(pose)
            )
        },
    )
    own = frame_depth(moved)
    np.testing.assert_allclose(own.depth_m, straight.depth_m, atol=1e-3)
    inside = replace(
        moved,
        clouds={"lidar": whole.cloud().transform(pose)},
        sensors={"lidar": Sensor(kind="lidar", frame_T_sensor=pose)},
    )
    assert np.nanmean(np.abs(frame_depth(inside).depth_m - straight.depth_m)) < 1e-3
    lost = replace(moved, sensors={"lidar": Sensor(kind="lidar", in_frame=False)})
    with pytest.raises(DatasetError, match="where that stands"):
        frame_depth(lost)


def test_the_page_s_example_runs(kitti: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "depth.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    (tmp_path / "data").mkdir()
    kitti.rename(tmp_path / "data" / "kitti")
    monkeypatch.chdir(tmp_path)
    write_depth_maps(open_dataset("data/kitti"), "depth")
    names: dict[str, object] = {}
    exec(compile(block, "depth.md", "exec"), names)
    made, again = names["made"], names["again"]
    assert np.nanmax(np.abs(made.depth_m - again)) <= 0.5 / 256 * 1.01
    assert names["sure"].depth_m.shape == again.shape
