import sys

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.argoverse2 import Argoverse2, read_columns
from farfield.errors import DatasetError, FileFormatError, MissingExtraError
from farfield.geometry.boxes import count_points_in_boxes

pytest.importorskip("pyarrow")

LOG = "7fab2350-7eaf-3b7e-a39d-6937a4c1bede"


@pytest.fixture(params=["", "val", f"val/{LOG}"])
def root(request, shared_real):
    return shared_real / "argoverse2" / request.param


def test_points_in_boxes_equal_the_official_counts(shared_real):
    checked = 0
    for frame in open_dataset(shared_real / "argoverse2"):
        counts = count_points_in_boxes(frame.cloud().points_m, frame.boxes)
        np.testing.assert_array_equal(counts, frame.boxes.point_count)
        checked += len(counts)
    assert checked == 162


def test_every_root_opens_the_same_frames(root):
    data = open_dataset(root)
    assert data.name == "argoverse2"
    assert data.keys == ((LOG, "315966265259836000"), (LOG, "315966265360032000"))


def test_frames_carry_classes_poses_tracks_and_cameras(shared_real):
    data = Argoverse2(shared_real / "argoverse2", classes="argoverse2")
    frame = data[0]
    assert "REGULAR_VEHICLE" in set(frame.boxes.label.tolist())
    assert set(open_dataset(data.root)[0].boxes.label.tolist()) >= {"vehicle", "pedestrian", "bicycle", "unknown"}
    assert frame.annotation.original_label == tuple(frame.boxes.label.tolist())
    shared = set(frame.boxes.track_id.tolist()) & set(data[1].boxes.track_id.tolist())
    assert len(shared) > 0.8 * len(frame.boxes)
    # Standing objects keep their place in the city when the ego vehicle moves: poses and boxes agree.
    places = [f.boxes.transform(f.world_T_frame) for f in data]
    by_id = [dict(zip(p.track_id.tolist(), p.centre_m, strict=True)) for p in places]
    moved = [np.linalg.norm(by_id[0][track] - by_id[1][track]) for track in shared]
    assert np.median(moved) < 0.1
    camera = frame.cameras["ring_front_center"]
    assert (camera.width_px, camera.height_px) == (1550, 2048)
    pixels, depth, visible = camera.project(np.array([[30.0, 0.0, 1.0]]))
    assert visible[0]
    assert depth[0] == pytest.approx(30.0 - 1.635, abs=0.1)
    assert abs(pixels[0, 0] - 1550 / 2) < 50


def test_a_damaged_file_and_a_missing_column_are_named(tmp_path, shared_real):
    path = tmp_path / "damaged.feather"
    whole = (shared_real / "argoverse2/val" / LOG / "city_SE3_egovehicle.feather").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileFormatError, match=r"damaged\.feather"):
        read_columns(path, ["qw"])
    path.write_bytes(whole)
    with pytest.raises(FileFormatError, match="each of speed once"):
        read_columns(path, ["speed"])


def test_the_missing_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"\[argoverse2\]"):
        read_columns(tmp_path / "any.feather", [])


def test_a_log_of_annotations_alone_opens_without_the_measuring_car(shared_real):
    root = shared_real / "argoverse2_tracks"
    data = open_dataset(root)
    assert data.name == "argoverse2"
    assert len(data) == 157
    (drive,) = data.drives()
    assert np.diff(drive.times_ns).min() > 9e7
    assert drive.world_T_frame.shape == (157, 4, 4)
    frame = data[0]
    assert not frame.clouds
    assert frame.time_ns == drive.times_ns[0] == int(frame.frame_id)
    annotations = [data.annotation(index) for index in range(157)]
    names = {name for annotation in annotations for name in annotation.original_label}
    assert "EGO_VEHICLE" not in names
    ranges = np.concatenate([annotation.boxes.range_m for annotation in annotations])
    assert ((ranges > 150).sum(), round(ranges.max())) == (1012, 203)
    assert data.files(0) == [next(root.glob("*/annotations_with_ego.feather"))]


def test_a_folder_without_sweeps_and_annotations_is_refused(tmp_path):
    with pytest.raises(DatasetError, match="annotations"):
        Argoverse2(tmp_path)
