"""View-of-Delft: by hand in camera coordinates, and its real frames against each other's label files."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from trees import LIDAR_T_RADAR_M, PITCH_RAD, RADAR_ROWS, write_delft, write_tree

from farfield.datasets import open_dataset, recognise
from farfield.datasets.recipes import recipe_of_experiment, replay
from farfield.datasets.view_of_delft.layout import CLIPS, clip_of
from farfield.datasets.view_of_delft.reader import ViewOfDelft, boxes_from_labels, boxes_from_objects, read_radar
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.kitti import read_calib, read_labels
from farfield.files.view_of_delft import read_camera_poses, read_objects
from farfield.geometry.boxes import count_points_in_boxes
from farfield.geometry.poses import transform_points

FRAMES = ("00549", "01047")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_delft(tmp_path)


def test_a_box_stands_upright_in_the_sensors_frame(root):
    data = open_dataset(root / "lidar")
    assert data.name == recognise(root / "lidar") == "view_of_delft"
    boxes = data[0].boxes
    np.testing.assert_allclose(boxes.centre_m, [[20, 0, 0.75]], atol=1e-9)
    np.testing.assert_allclose(boxes.size_m, [[4.2, 1.8, 1.5]])
    np.testing.assert_allclose(boxes.yaw_rad, [-np.pi / 2])
    assert boxes.label.tolist() == ["vehicle"]
    assert boxes.score is None  # the sixteenth column is no score


@pytest.mark.parametrize("reference", ["lidar", "radar"])
def test_everything_is_in_the_reference_sensors_frame(root, reference):
    frame = ViewOfDelft(root, reference=reference)[0]
    assert frame.reference == reference
    offset_m = LIDAR_T_RADAR_M * (reference == "radar")
    np.testing.assert_allclose(frame.boxes.centre_m, [[20, 0, 0.75] - offset_m], atol=1e-9)
    np.testing.assert_allclose(frame.clouds["lidar"].points_m[1], [20, 0, 0.75] - offset_m, atol=1e-5)
    expected = RADAR_ROWS[:, :3] + LIDAR_T_RADAR_M - offset_m
    np.testing.assert_allclose(frame.clouds["radar"].points_m, expected, atol=1e-5)
    np.testing.assert_allclose(frame.sensors["radar"].frame_T_sensor[:3, 3], LIDAR_T_RADAR_M - offset_m, atol=1e-9)
    pixels, _, _ = frame.cameras["camera"].project(np.array([[20.0, 0.0, 0.0] - offset_m]))
    np.testing.assert_allclose(pixels, [[500, 300 - 1000 * np.tan(PITCH_RAD)]])
    assert frame.annotation.moving.tolist() == [True]
    assert frame.annotation.details["truncation"].tolist() == [0.0]  # else KITTI's difficulties would drop what moves
    np.testing.assert_allclose(frame.metadata["radar_velocity_m_s"], [2.0, 0.5, 0.0], atol=1e-6)


def test_the_frames_may_be_seen_from_the_other_sensor(root):
    """As a detector that learnt in the radar's frame needs them."""
    data, native = ViewOfDelft(root), ViewOfDelft(root, reference="radar")
    learnt = recipe_of_experiment({"options": {"reference": "radar"}, "sweeps": 1})
    seen, opened = replay(data, learnt)[0], native[0]
    np.testing.assert_allclose(seen.boxes.centre_m, opened.boxes.centre_m, atol=1e-12)
    np.testing.assert_allclose(seen.clouds["lidar"].points_m, opened.clouds["lidar"].points_m, atol=1e-6)
    np.testing.assert_array_equal(seen.clouds["radar"].points_m, opened.clouds["radar"].points_m)
    assert replay(native, learnt) is native
    assert native.recipe["maps"] == replay(data, learnt).recipe["maps"]
    assert native.fingerprint() == replay(data, learnt).fingerprint() != data.fingerprint()
    assert replay(data, recipe_of_experiment({"options": {"reference": "os2-64"}})) is data


def test_no_column_of_the_radar_is_lost(root):
    cloud = read_radar(root / "radar" / "training" / "velodyne" / "00001.bin")
    names = ("rcs_dbsm", "v_r_m_s", "v_r_compensated_m_s", "scan")
    kept = np.column_stack([cloud.points_m, *(cloud.extra[name] for name in names)])
    np.testing.assert_array_equal(kept, RADAR_ROWS.astype(np.float32))
    np.testing.assert_array_equal(cloud.extra["doppler_m_s"], cloud.extra["v_r_m_s"])
    assert cloud.intensity is None
    np.testing.assert_allclose(cloud.extra["lag_s"], [0, 0, 0, 0, 2 / 13], rtol=1e-6)


def test_the_lidars_reflectance_counts_to_255(root):
    np.testing.assert_allclose(open_dataset(root)[0].clouds["lidar"].intensity, [0.2, 1.0])


def test_the_pose_is_the_reference_sensors_in_the_odometrys_frame(root):
    frame = open_dataset(root)[0]
    assert frame.world_T_frame is not None
    ahead_m = transform_points(frame.world_T_frame, np.array([[0.0, 0, 0], [10.0, 0, 0]]))
    np.testing.assert_allclose(ahead_m[0], [5, 7, 1.3], atol=1e-9)
    np.testing.assert_allclose(ahead_m[1] - ahead_m[0], [10 * np.cos(PITCH_RAD), 0, 10 * np.sin(PITCH_RAD)], atol=1e-9)
    assert set(frame.metadata["world_T_camera"]) == {"odom", "map", "utm"}


def test_the_accumulated_clouds_are_there_too(root):
    for name in ("radar_3frames", "radar_5frames"):
        write_tree(root / name / "training", RADAR_ROWS, LIDAR_T_RADAR_M, None)
    frame = open_dataset(root)[0]
    assert list(frame.clouds) == ["lidar", "radar", "radar_3frames", "radar_5frames"]
    assert list(open_dataset(root / "radar_5frames")[0].clouds) == ["radar_5frames"]


@pytest.mark.parametrize("opened", ["radar", "radar/training"])
def test_a_radars_folder_is_told_from_kitti_by_its_rows(root, opened):
    shutil.rmtree(root / "radar" / "training" / "pose")
    assert recognise(root / opened) == "view_of_delft"
    frame = open_dataset(root / opened)[0]
    assert (frame.reference, list(frame.clouds), frame.boxes) == ("radar", ["radar"], None)
    shutil.rmtree(root / "lidar" / "training" / "pose")
    assert recognise(root / "lidar") == "kitti"
    assert recognise(root) == "view_of_delft"


def test_frames_without_a_modality_lack_it(root):
    write_tree(root / "radar" / "training", RADAR_ROWS, LIDAR_T_RADAR_M, None, "00002")
    data = open_dataset(root)
    assert data.frame_ids == ("00001", "00002")
    (root / "radar" / "training" / "calib" / "00001.txt").unlink()
    with pytest.raises(DatasetError, match=r"radar/.*/calib/00001\.txt"):
        data[0]
    with pytest.raises(DatasetError, match=r"lidar/.*/calib/00002\.txt"):
        data[1]
    assert list(ViewOfDelft(root, reference="radar")[1].clouds) == ["radar"]
    assert all(path.is_file() for index in range(2) for path in data.files(index))


def test_an_unknown_option_says_what_is_known(root, without_shape_checks):
    with pytest.raises(ConfigError, match=r"reference .*'radar'.* got 'camera'"):
        open_dataset(root, reference="camera")
    with pytest.raises(DatasetError, match="velodyne"):
        ViewOfDelft(root / "lidar" / "training" / "calib")


def test_the_official_lists_split_and_else_the_clips(tmp_path):
    frames = ("00000", "00600", "02600", "06000")  # clips of val, train, test, and none
    for frame in frames:
        write_tree(tmp_path / "radar" / "training", RADAR_ROWS, LIDAR_T_RADAR_M, None, frame)
    data = open_dataset(tmp_path)
    assert data.sequences == ("delft_1", "delft_2", "delft_7", "training")
    parts = {name: data.split(name).frame_ids for name in ("train", "val", "test")}
    assert parts == {"train": ("00600",), "val": ("00000",), "test": ("02600",)}
    (tmp_path / "radar" / "ImageSets").mkdir()
    (tmp_path / "radar" / "ImageSets" / "train.txt").write_text("02600\n06000\n")
    assert data.split("train").frame_ids == ("02600", "06000")


def test_clips_do_not_overlap_and_hold_the_published_number_of_frames():
    bounds = [bound for first, last, _ in CLIPS.values() for bound in (first, last)]
    assert bounds == sorted(bounds)
    counts = {part: sum(b - a + 1 for a, b, p in CLIPS.values() if p == part) for part in ("train", "val", "test")}
    assert counts == {"train": 5139, "val": 1296, "test": 2247}  # 8,682 frames; 6,435 of them have published labels
    assert [clip_of(frame) for frame in ("00543", "00544", "04048", "x1")] == ["delft_1", "delft_2", None, None]


@pytest.mark.parametrize("frame", FRAMES)
def test_real_text_and_json_labels_agree_in_the_radars_frame(shared_real, frame):
    """The JSON labels have nine degrees of freedom in the radar's frame: their heading there is the text's."""
    real = shared_real / "view_of_delft"
    calib = read_calib(real / "radar" / "training" / "calib" / f"{frame}.txt")
    camera_T_radar = np.vstack([calib["Tr_velo_to_cam"], [0, 0, 0, 1]])
    objects = read_labels(real / "lidar" / "training" / "label_2" / f"{frame}.txt")
    text = boxes_from_labels(objects, camera_T_radar, classes="kitti")
    details = read_objects(real / "radar" / "training" / "label_2" / f"{frame}.json")
    exact = boxes_from_objects(details, classes="kitti")
    np.testing.assert_allclose(text.centre_m, exact.centre_m, atol=1e-4)
    np.testing.assert_allclose(text.size_m, exact.size_m)
    np.testing.assert_allclose(np.angle(np.exp(1j * (text.yaw_rad - exact.yaw_rad))), 0, atol=1e-4)
    assert text.label.tolist() == exact.label.tolist()
    moving = [attributes["activity"] == "moving" for attributes in details.attributes]
    assert moving == (objects.truncation == 1).tolist()


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("reference", ["lidar", "radar"])
def test_real_frames_fit_together(shared_real, index, reference):
    frame = ViewOfDelft(shared_real / "view_of_delft", reference=reference)[index]
    inside = count_points_in_boxes(frame.clouds["lidar"].points_m, frame.boxes, margin_m=0.05)
    assert (inside > 0).mean() > 0.85
    assert np.median(inside) > 40
    if reference == "lidar":  # the authors: lidar to radar 2.516, 0.060 m (issue 34 of their repository)
        np.testing.assert_allclose(frame.sensors["radar"].frame_T_sensor[:2, 3], [2.516, 0.060], atol=2e-3)
    cloud = frame.clouds["radar"]
    origin_m = frame.sensors["radar"].frame_T_sensor[:3, 3]
    rays = cloud.points_m - origin_m
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    velocity = frame.sensors["radar"].frame_T_sensor[:3, :3] @ frame.metadata["radar_velocity_m_s"]
    gained = cloud.extra["v_r_compensated_m_s"] - cloud.extra["v_r_m_s"]
    np.testing.assert_allclose(rays @ velocity, gained, atol=0.05)
    assert np.median(np.abs(cloud.extra["v_r_compensated_m_s"])) < 0.01  # most of what is seen stands still


def test_the_real_radars_folder_alone_has_its_json_labels(shared_real):
    root = shared_real / "view_of_delft"
    alone, whole = open_dataset(root / "radar"), open_dataset(root, reference="radar")
    for one, other in zip(alone, whole, strict=True):
        np.testing.assert_allclose(one.boxes.centre_m, other.boxes.centre_m, atol=1e-4)
        assert one.boxes.label.tolist() == other.boxes.label.tolist()
        assert one.annotation.moving.tolist() == other.annotation.moving.tolist()
        assert len(set(one.annotation.details["object_id"])) == len(one.boxes)
        np.testing.assert_allclose(one.world_T_frame, other.world_T_frame)
        np.testing.assert_array_equal(one.clouds["radar"].points_m, other.clouds["radar"].points_m)


@pytest.mark.parametrize("frame", FRAMES)
def test_real_poses_hold_the_camera_level_and_map_it_out(shared_real, frame):
    poses = read_camera_poses(shared_real / "view_of_delft" / "lidar" / "training" / "pose" / f"{frame}.json")
    for matrix in poses.values():
        down, ahead = matrix[:3, 1], matrix[:3, 2]
        assert down[2] < -0.99
        assert np.arcsin(ahead[2]) == pytest.approx(np.radians(6.86), abs=1e-3)
        assert matrix[2, 3] == pytest.approx(1.2994)
    assert 5.7e6 < poses["utm"][1, 3] < 5.8e6  # Delft's northing


@pytest.mark.parametrize("name", ["Car", "Cyclist", "rider"])
def test_class_names_are_translated_or_kept(shared_real, name):
    folder = shared_real / "view_of_delft" / "lidar" / "training"
    objects = read_labels(folder / "label_2" / "01047.txt")
    calib = read_calib(folder / "calib" / "01047.txt")
    assert "Tr_imu_to_velo" not in calib
    camera_T_lidar = np.vstack([calib["Tr_velo_to_cam"], [0, 0, 0, 1]])
    kept = boxes_from_labels(objects, camera_T_lidar, classes="kitti")
    ours = boxes_from_labels(objects, camera_T_lidar)
    expected = {"Car": "vehicle", "Cyclist": "bicycle", "rider": "unknown"}[name]
    assert set(ours.label[kept.label == name]) == {expected}


IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("[1]", "odomToCamera"),
        ('{"odomToCamera": [1, 2]}', "16 numbers"),
        (json.dumps({"odomToCamera": [2 * value for value in IDENTITY]}), "rotation"),
        (json.dumps({"odomToCamera": ["x", *IDENTITY[1:]]}), "16 numbers"),
        ('{"odomToCamera": [NaN' + ", 0" * 15 + "]}", "NaN"),
        (json.dumps({"wheelToCamera": IDENTITY}), "wheelToCamera"),
        ('{"a":' * 10_000, "JSON"),
        ("{}" * 40_000, "at most"),
        ("\udcff", "UTF-8"),
    ],
)
def test_a_damaged_pose_file_is_named(tmp_path, text, words):
    path = tmp_path / "00001.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(FileFormatError, match=words):
        read_camera_poses(path)


GEOMETRY = {
    "center": {"x": 1, "y": 2, "z": 3},
    "size": {"length": 4, "width": 2, "height": 1.5},
    "quaternion": {"x": 0, "y": 0, "z": 0, "w": 1},
}


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({}, "list"),
        ([7], "className"),
        ([{"className": "car"}], "geometry"),
        ([{"className": 3, "geometry": GEOMETRY}], "texts"),
        ([{"className": "car", "geometry": {**GEOMETRY, "size": {"length": 0, "width": 1, "height": 1}}}], "positive"),
        ([{"className": "car", "geometry": {**GEOMETRY, "quaternion": dict.fromkeys("xyzw", 0)}}], "quaternion"),
        ([{"className": "car", "geometry": {**GEOMETRY, "center": dict.fromkeys("xyz", 1e300)}}], "1e9"),
    ],
)
def test_a_damaged_json_label_file_is_named(tmp_path, entries, words):
    path = tmp_path / "00001.json"
    path.write_text(json.dumps(entries))
    with pytest.raises(FileFormatError, match=words):
        read_objects(path)


def test_json_labels_without_objects_are_no_error(tmp_path):
    path = tmp_path / "00001.json"
    path.write_text("[]")
    assert len(read_objects(path)) == 0
    assert len(boxes_from_objects(read_objects(path))) == 0
