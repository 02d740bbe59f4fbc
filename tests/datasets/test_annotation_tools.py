"""Data sets written for annotation tools, and scenes of SUSTechPOINTS read."""

import json
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.convert import convert
from farfield.datasets.labels.json_labels import DatumaroLabels, OpenLabels
from farfield.datasets.sustechpoints import SustechPoints
from farfield.errors import FileFormatError
from farfield.files.pcd import read_pcd
from farfield.frame import Boxes
from farfield.testing import check_dataset


def test_sustechpoints_comes_back_whole(street_root: Path, tmp_path: Path) -> None:
    source = open_dataset(street_root)
    assert convert(source, tmp_path / "scenes", to="sustechpoints").written == 3
    assert convert(source, tmp_path / "scenes", to="sustechpoints").skipped == 3
    made = open_dataset(tmp_path / "scenes")
    assert made.name == "sustechpoints"
    assert made.keys == source.keys
    for got, want in zip(made, source, strict=True):
        assert got.boxes is not None
        assert want.boxes is not None
        np.testing.assert_array_equal(got.cloud().points_m, want.cloud().points_m)
        np.testing.assert_allclose(got.boxes.centre_m, want.boxes.centre_m)
        np.testing.assert_allclose(got.boxes.size_m, want.boxes.size_m)
        np.testing.assert_allclose(got.boxes.yaw_rad, want.boxes.yaw_rad, atol=1e-12)
        assert got.boxes.label.tolist() == want.boxes.label.tolist()
        assert got.boxes.track_id is not None
        assert got.boxes.track_id.tolist() == _tracks(want.boxes)
        for name, camera in got.cameras.items():
            np.testing.assert_allclose(camera.camera_T_lidar, want.cameras[name].camera_T_lidar)
            np.testing.assert_allclose(camera.matrix, want.cameras[name].matrix)
            assert (camera.height_px, camera.width_px) == want.images[name].shape[:2]


def _tracks(boxes: Boxes) -> list[int]:
    return [-1] * len(boxes) if boxes.track_id is None else boxes.track_id.tolist()


def test_one_file_a_sequence_for_cvat_and_openlabel(street_root: Path, tmp_path: Path) -> None:
    source = open_dataset(street_root)
    for to, labels in (("cvat", DatumaroLabels(tmp_path / "cvat")), ("openlabel", OpenLabels(tmp_path / "openlabel"))):
        convert(source, tmp_path / to, to=to)
        path = labels.path(source.keys[0])
        found = labels.parse(path.read_bytes(), path, source.keys)
        for key, frame in zip(source.keys, source, strict=True):
            assert frame.boxes is not None
            rows = np.column_stack([frame.boxes.centre_m, frame.boxes.size_m, frame.boxes.yaw_rad])
            np.testing.assert_allclose([label.box for label in found[key]], rows, atol=1e-9)
            assert [label.label for label in found[key]] == frame.boxes.label.tolist()
    cloud = tmp_path / "cvat" / source.sequences[0] / "point_clouds" / f"{source.frame_ids[0]}.pcd"
    assert len(read_pcd(cloud)["x"]) == len(source[0].cloud())
    items = json.loads((cloud.parents[1] / "annotations" / "default.json").read_text())["items"]
    assert [item["id"] for item in items] == list(source.frame_ids)


def test_a_scene_fulfils_the_contract(street_root: Path, tmp_path: Path) -> None:
    convert(open_dataset(street_root), tmp_path / "scenes", to="sustechpoints")
    check_dataset(open_dataset(tmp_path / "scenes", format="sustechpoints"))


def test_the_real_sample(shared_real: Path) -> None:
    data: Dataset = open_dataset(shared_real / "sustechpoints")
    frame = data[0]
    assert frame.boxes is not None
    assert len(frame.cloud()) == 66_781
    assert sorted(frame.cameras) == ["front", "left", "right"]
    assert frame.cameras["front"].width_px == frame.images["front"].shape[1]
    assert frame.boxes.label.tolist().count("unknown") == 0
    pixels, depth, seen = frame.cameras["front"].project(frame.boxes.centre_m)
    assert seen.sum() >= 3
    assert (depth[seen] > 0).all()
    assert np.isfinite(pixels[seen]).all()


@pytest.mark.parametrize(
    "content", [[], {"extrinsic": [1, 2], "intrinsic": []}, {"extrinsic": [0] * 16, "intrinsic": [1] * 9}]
)
def test_a_calibration_that_is_none_is_refused(street_root: Path, tmp_path: Path, content: object) -> None:
    convert(open_dataset(street_root), tmp_path / "scenes", to="sustechpoints")
    data = SustechPoints(tmp_path / "scenes")
    camera = data.clouds[0].parents[1] / "calib" / "camera" / "front.json"
    camera.parent.mkdir(parents=True, exist_ok=True)
    camera.write_text(json.dumps(content))
    with pytest.raises(FileFormatError):
        data[0]
