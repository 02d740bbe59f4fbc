"""Trees of the nuScenes schema as people have them: partly unpacked, links into a cache, other lenses."""

import json
import shutil

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.errors import DatasetError, FileFormatError

from .generators.nuscenes_trees import write_nuscenes


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    root = tmp_path_factory.mktemp("disk")
    write_nuscenes(root)
    return root


@pytest.fixture
def tree(written, tmp_path):
    return shutil.copytree(written, tmp_path / "tree")


def renamed(root, name):
    """Change the first file that the tables name."""
    path = root / "v1.0-mini" / "sample_data.json"
    rows = json.loads(path.read_text())
    rows[0]["filename"] = name
    path.write_text(json.dumps(rows))


def first_cloud(data, index=0):
    return next(iter(data[index].clouds.values()))


def test_files_that_are_links_into_a_cache_are_read(tree, tmp_path):
    expected = first_cloud(open_dataset(tree)).points_m
    (tmp_path / "blobs").mkdir()
    for number, path in enumerate(sorted((tree / "samples").rglob("*.*"))):
        path.rename(tmp_path / "blobs" / str(number))
        path.symlink_to(tmp_path / "blobs" / str(number))
    frame = open_dataset(tree)[0]
    np.testing.assert_array_equal(next(iter(frame.clouds.values())).points_m, expected)
    assert all(picture.ndim == 3 for picture in frame.images.values())


@pytest.mark.parametrize(
    "name", ["../blobs/0.bin", "/etc/passwd", "samples/../../0.bin", "C:\\0.bin", "samples\\0.bin"]
)
def test_names_that_leave_the_folder_are_refused(tree, name):
    renamed(tree, name)
    with pytest.raises(FileFormatError, match="within the data set"):
        _ = [frame.key for frame in open_dataset(tree)]


@pytest.mark.parametrize("target", ["nowhere.bin", "itself"])
def test_a_link_that_leads_nowhere_or_to_itself_is_named(tree, target):
    path = sorted((tree / "samples" / "LIDAR_TOP").iterdir())[0]
    path.unlink()
    path.symlink_to(path.name if target == "itself" else target)
    data = open_dataset(tree)
    index = next(number for number in range(len(data)) if path in data.files(number))
    with pytest.raises(DatasetError, match=f"{path.name}: expected a file, got a link that leads nowhere"):
        data[index].cloud("LIDAR_TOP")
    picture = next(file for file in data.files(1 - index) if "CAM" in file.name and file.is_file())
    shutil.rmtree(picture.parent)
    picture.parent.symlink_to(tree / "gone")
    with pytest.raises(DatasetError, match="a link that leads nowhere") as refusal:
        _ = [frame.images[name] for frame in data for name in frame.images]
    assert str(picture.parent) in str(refusal.value)


def test_a_folder_of_sweeps_that_was_not_unpacked_is_named_with_the_way_out(tree):
    shutil.rmtree(tree / "sweeps")
    data = open_dataset(tree, sweeps=5)
    with pytest.raises(DatasetError, match=r"Unpack the archive .*sweeps/LIDAR_TOP stands in .*sweeps=1"):
        data[1].cloud("LIDAR_TOP")
    assert any("files are missing" in note and "sweeps=1" in note for note in data.notes)
    whole = open_dataset(tree)
    assert len(whole[1].cloud("LIDAR_TOP").points_m)
    assert not whole.notes


def test_a_set_of_which_one_archive_was_unpacked_says_so_and_its_whole_scenes_are_used(tree):
    (tree / "v1.0-mini").rename(tree / "v1.0-trainval")
    data = open_dataset(tree)
    first, second = dict.fromkeys(data.sequences)
    for index in range(len(data)):
        if data.sequences[index] == second:
            for path in data.files(index)[:-1]:
                path.unlink(missing_ok=True)
    data = open_dataset(tree)
    (note,) = [note for note in data.notes if "missing" in note]
    assert f"files are missing of {len(data) // 2} of the {len(data)} frames that were looked at" in note
    assert "v1.0-trainval01_blobs" in note
    assert ("warning", note) in data.remarks
    frame = data[data.sequences.index(second)]
    assert frame.boxes is not None
    with pytest.raises(DatasetError, match="trainval01_blobs"):
        frame.cloud("LIDAR_TOP")
    with pytest.raises(DatasetError, match="expected a file of frame"):
        data.fingerprint()
    whole = open_dataset(tree, whole_scenes=True)
    assert set(whole.sequences) == {first}
    assert whole.fingerprint()
    assert all(len(frame.cloud("LIDAR_TOP").points_m) for frame in whole)
    assert whole.notes == ("1 of 2 scenes lack files and are left out (whole_scenes)",)


def test_a_sensor_that_was_never_unpacked_tears_no_scene(tree):
    shutil.rmtree(next((tree / "samples").glob("CAM_*")))
    count = len(open_dataset(tree))
    assert len(open_dataset(tree, whole_scenes=True)) == count
    shutil.rmtree(tree / "sweeps")
    assert len(open_dataset(tree, whole_scenes=True)) == count
    with pytest.raises(DatasetError, match=r"expected a scene that lacks no file, found none: .*sweeps=1"):
        open_dataset(tree, whole_scenes=True, sweeps=2)


@pytest.mark.parametrize("dialect", ["truckscenes", "t4"])
def test_numbers_are_taken_from_files_that_are_there(dialect, tmp_path):
    write_nuscenes(tmp_path, dialect=dialect)
    data = open_dataset(tmp_path)
    expected, scale = data.assumptions, data.intensity_scale
    channel = data.files(0)[0].parent
    paths = [data.files(index)[0] for index in range(len(data))]
    assert all(path.parent == channel for path in paths)
    for path in paths[:-1]:
        path.unlink()
    data = open_dataset(tmp_path)
    assert data.intensity_scale == scale
    assert data.assumptions == expected


@pytest.mark.parametrize(
    "coefficient", [float("nan"), float("inf"), "1", True, 10**400], ids=["nan", "inf", "text", "flag", "huge"]
)
def test_a_lens_whose_coefficients_are_no_numbers_is_refused(tmp_path, coefficient):
    write_nuscenes(tmp_path, dialect="t4", samples=1)
    path = next(tmp_path.rglob("calibrated_sensor.json"))
    rows = json.loads(path.read_text())
    for row in rows:
        row["camera_distortion"] = [coefficient] * 5 if row["camera_intrinsic"] else []
    path.write_text(json.dumps(rows))
    with pytest.raises(FileFormatError):
        _ = open_dataset(tmp_path)[0]


@pytest.mark.parametrize("count", [8, 12, 14])
def test_a_camera_with_a_lens_of_more_coefficients_is_shown_without_calibration(tmp_path, count):
    write_nuscenes(tmp_path, dialect="t4", samples=1)
    plain = open_dataset(tmp_path)[0]
    path = next(tmp_path.rglob("calibrated_sensor.json"))
    rows = json.loads(path.read_text())
    cameras = [row for row in rows if row["camera_intrinsic"]]
    cameras[0]["camera_distortion"] = [0.1, 0.01, 0, 0, 0, 0.2, *[0.01] * (count - 6)]
    for row in cameras[1:]:
        row["camera_distortion"] = [0.1, 0.01, 0, 0, 0, *[0] * (count - 5)]
    path.write_text(json.dumps(rows))
    data = open_dataset(tmp_path)
    frame = data[0]
    (name,) = set(plain.cameras) - set(frame.cameras)
    assert frame.images[name].shape == plain.images[name].shape
    assert not frame.sensors[name].in_frame
    np.testing.assert_allclose(frame.sensors[name].frame_T_sensor, plain.sensors[name].frame_T_sensor, atol=1e-9)
    assert len(frame.cloud().points_m)
    assert frame.boxes is not None
    assert any(name in note and "without calibration" in note for note in data.notes)
