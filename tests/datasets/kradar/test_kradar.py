"""Whole trees of K-Radar: written, read back, in parts, by several workers."""

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive import OS2_T_OS1, boxes, frame
from scipy.spatial.transform import Rotation

from farfield.datasets import open_dataset
from farfield.datasets.kradar import KRadar, KRadarWriter
from farfield.datasets.kradar.layout import is_sequence
from farfield.datasets.kradar.texts import format_camera, read_camera, read_odometry
from farfield.datasets.kradar.writer import quarters, whole_sequences
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.frame import Annotation, Frame

FRAMES = [("1", 1, 32), ("1", 2, 32), ("1", 3, 32), ("25", 2, -1), ("25", 3, -1)]


def write(root: Path, frames: list[tuple[str, int, int]] | None = None, **options) -> KRadarWriter:
    writer = KRadarWriter(root, columns=512, **options)
    for sequence, number, lead in FRAMES if frames is None else frames:
        writer.write(frame(number, sequence=sequence, lead=lead))
    return writer


def contents(root: Path) -> dict[str, bytes]:
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kradar")
    write(folder).finish()
    return folder


def same_pose(one: np.ndarray, other: np.ndarray, atol: float = 1e-14) -> None:
    np.testing.assert_allclose(one, other, rtol=0, atol=atol)


def times(of: Frame) -> dict[str, int]:
    """Times of the sensors that have files of their own, and of the radar; right eyes share their left one's."""
    names = ("os2-64", "os1-128", "cam-front", "radar")
    known = {name: of.sensors[name].time_ns for name in names if name in of.sensors}
    return {name: time for name, time in known.items() if time is not None}


def test_a_frame_comes_back_as_it_was(root: Path) -> None:
    dataset = open_dataset(root)
    assert isinstance(dataset, KRadar)
    assert dataset.keys == (
        *(("1", f"{n + 32:05d}_{n:05d}") for n in (1, 2, 3)),
        ("25", "00001_00002"),
        ("25", "00002_00003"),
    )
    for (sequence, number, lead), back in zip(FRAMES, dataset, strict=True):
        given = frame(number, sequence=sequence, lead=lead)
        assert (back.sequence, back.time_ns, back.reference) == (sequence, given.time_ns, "os2-64")
        assert times(back) == times(given)
        assert back.conditions == given.conditions
        assert back.indices == given.indices
        assert np.array_equal(back.sensors["os1-128"].frame_T_sensor, OS2_T_OS1)
        assert back.sensors["radar"].frame_T_sensor[:3, 3].tolist() == [2.54, -0.3, -0.7]
        assert np.array_equal(back.world_T_frame, given.world_T_frame)
        for name, cloud in given.clouds.items():
            assert np.array_equal(back.clouds[name].points_m, cloud.points_m)
            assert np.array_equal(back.clouds[name].intensity, cloud.intensity)
            for column, values in cloud.extra.items():
                assert np.array_equal(back.clouds[name].extra[column], values)
        assert np.array_equal(back.radar["sparse"], given.radar["sparse"])
        for name, image in given.images.items():
            assert np.array_equal(back.images[name], image)
        assert set(back.cameras) == set(given.cameras)
        for name, camera in given.cameras.items():
            same_pose(back.cameras[name].camera_T_lidar, camera.camera_T_lidar)
            assert np.array_equal(back.cameras[name].matrix, camera.matrix)
            assert np.array_equal(back.cameras[name].distortion, camera.distortion)
        kept = given.boxes[given.boxes.label != "animal"]
        assert np.array_equal(back.boxes.centre_m, kept.centre_m)
        assert np.array_equal(back.boxes.size_m, kept.size_m)
        assert back.boxes.track_id.tolist() == kept.track_id.tolist()
        assert list(back.annotation.visibility) == ["R", "L", "L1", "R", "R"]
        assert back.annotation.extent == "full"


def test_the_tree_is_the_real_one(root: Path) -> None:
    names = set(contents(root))
    assert {
        name for name in names if name.endswith(("_00001.pcd", "00033_00001.txt", "00033.npy", "00033_00001.json"))
    } == {
        "1/frame_record/00033_00001.json",
        "1/info_label/00033_00001.txt",
        "1/os1-128/os1-128_00001.pcd",
        "1/os2-64/os2-64_00001.pcd",
        "kradar_revised_label_v2_1/KRadar_revised_visibility/1/00033_00001.txt",
        "rtnh_wider_10p_1/1/sprdr_00033.npy",
    }
    assert "1/cam-front/cam-front_00002.png" in names
    text = {name: (root / name).read_text() for name in names if name.endswith((".txt", ".yml"))}
    assert text["1/description.txt"] == "countryside,day,lightsnow\n"
    assert text["1/info_calib/calib_radar_lidar.txt"] == "frame difference,x,y\n32,-2.54,0.3\n"
    assert text["1/time_info/os2-64.txt"].splitlines()[0] == "os2-64_00001.pcd, 1643292946.810046076"
    assert text["1/time_info/cam-front.txt"].splitlines()[2] == "cam-front_00008.png, 1643292947.010046071"
    assert text["resources/split/train.txt"] == "1,00034_00002.txt"
    poses = text["resources/odometry/gt/gt_01.txt"].splitlines()
    assert poses[0] == " ".join(f"{value:.6e}" for value in np.eye(4)[:3].ravel())
    assert len(poses) == 3
    assert text["resources/cam_calib/calib_seq_v2/seq_01/cam_1.yml"].splitlines()[:2] == ["cam_number: 1", "fx: 567.72"]


def test_bytes_do_not_depend_on_who_wrote_what_when(root: Path, tmp_path: Path) -> None:
    """Two workers in another order, one frame twice, and a finish in the middle."""
    write(tmp_path, FRAMES[3:])
    KRadarWriter(tmp_path).finish()
    write(tmp_path, [FRAMES[2], FRAMES[0]])
    write(tmp_path, [FRAMES[1], FRAMES[0]]).finish()
    assert contents(tmp_path) == contents(root)


def test_paths_load_nothing_and_the_record_goes_last(root: Path) -> None:
    def fail(*_: object) -> None:
        raise AssertionError

    given = replace(frame(1), load_annotation=fail)
    paths = KRadarWriter(root).paths(given)
    assert all(path.is_file() for path in paths.values())
    assert list(paths)[-3:] == ["label_v1.0", "label_v2.1", "record"]
    assert "label_v1.0" not in KRadarWriter(root, labels=("v2.1",)).paths(given)
    assert not [key for key in KRadarWriter(root).paths(replace(given, load_annotation=None)) if "label" in key]


def test_cameras_are_those_of_the_first_frame_that_has_them(root: Path, tmp_path: Path) -> None:
    """A drive with pictures in some of its frames only."""
    writer = KRadarWriter(tmp_path, columns=512)
    writer.write(replace(frame(1), images={}, cameras={}))
    writer.write(frame(2))
    writer.finish()
    back, whole = (KRadar(folder)[1].cameras for folder in (tmp_path, root))
    assert list(back) == list(whole)
    assert np.array_equal(back["cam-front"].camera_T_lidar, whole["cam-front"].camera_T_lidar)


def test_a_broken_off_frame_has_no_record(tmp_path: Path) -> None:
    writer = KRadarWriter(tmp_path, columns=512)
    with pytest.raises(DatasetError, match=r"expected visibility R, L or L1 of each box, got X"):
        writer.write(frame(1).annotated(replace(frame(1).annotation, visibility=["X"] * 6)))
    assert not list(tmp_path.rglob("*.json"))
    assert writer.finish() == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sequence": "segment_01"}, "expected a sequence such as '1'"),
        ({"indices": {}}, "and indices with"),
        ({"time_ns": None, "sensors": {}}, "expected time_ns"),
        ({"indices": {"radar": 1, "os2-64": 1}}, r"\['os1-128'\], which numbers its os1-128 file"),
    ],
)
def test_what_names_the_files_is_asked_for(tmp_path: Path, change: dict, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        KRadarWriter(tmp_path, columns=512).write(replace(frame(1), **change))


def test_options_are_checked(root: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"labels from v1.0, v2.1"):
        KRadarWriter(tmp_path, labels=("v3",))
    with pytest.raises(ConfigError, match=r"one of v2.1, v2.0, v1.1, v1.0"):
        KRadar(root, labels="v9")
    with pytest.raises(DatasetError, match=r"annotations v2.0"):
        KRadar(root, labels="v2.0")
    with pytest.raises(DatasetError, match="files of K-Radar, found none"):
        KRadar(tmp_path)


def test_both_versions_of_the_annotations(root: Path) -> None:
    new, old = KRadar(root, labels="v2.1")[0], KRadar(root, labels="v1.0")[0]
    assert new.annotation.visibility is not None
    assert old.annotation.visibility is None
    assert new.boxes.track_id is not None
    assert old.boxes.track_id is None  # v1 numbers the objects of a frame: no identity
    assert np.array_equal(new.boxes.centre_m, old.boxes.centre_m)


@pytest.mark.parametrize(
    ("kept", "clouds", "radar", "annotated"),
    [
        ("1/os2-64", {"os2-64"}, set(), False),
        ("rtnh_wider_10p_1/1", {"radar"}, {"sparse"}, False),
        ("1/info_label", set(), set(), True),
        ("kradar_revised_label_v2_1/KRadar_revised_visibility/1", set(), set(), True),
    ],
)
def test_any_part_of_a_download_is_a_data_set(
    root: Path, tmp_path: Path, kept: str, clouds: set[str], radar: set[str], annotated: bool
) -> None:
    """Without the calibration the published frame difference, 32 for sequence 1, ties radar to LiDAR."""
    shutil.copytree(root / kept, tmp_path / kept)
    dataset = open_dataset(tmp_path)
    assert dataset.name == "kradar"
    assert dataset.keys == KRadar(root).keys[:3]
    assert set(dataset[0].clouds) == clouds
    assert set(dataset[0].radar) == radar
    assert (dataset[0].boxes is not None) == annotated
    assert dataset[0].conditions == {"road": "urban", "time": "night", "weather": "normal"}
    assert dataset[0].metadata["conditions_from"] == "published table"
    assert all(dataset.files(index) for index in range(3))


def test_several_roots_make_one_set(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root / "1" / "os2-64", tmp_path / "a" / "1" / "os2-64")
    shutil.copytree(root / "rtnh_wider_10p_1", tmp_path / "b" / "rtnh_wider_10p_1")
    back = KRadar(tmp_path / "a", roots=[tmp_path / "b"])[0]
    assert set(back.clouds) == {"os2-64", "radar"}
    assert set(back.radar) == {"sparse"}


def test_poses_come_from_odometry_where_there_are_no_records(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root, tmp_path / "x")
    for path in (tmp_path / "x").rglob("*.json"):
        path.unlink()
    back, given = KRadar(tmp_path / "x")[1], [frame(number).world_T_frame for number in (1, 2)]
    same_pose(back.world_T_frame, np.linalg.inv(given[0]) @ given[1], atol=2e-6)
    assert back.time_ns == frame(2).time_ns
    assert set(times(back)) == {"os2-64", "os1-128", "cam-front"}
    assert back.sensors["os1-128"].frame_T_sensor is None
    assert (back.clouds["os1-128"].extra["time_ns"].min(), frame(2).clouds["os1-128"].extra["time_ns"].min() < 0) == (
        0,
        True,
    )


def test_damaged_side_files_are_named(root: Path, tmp_path: Path) -> None:
    files = {
        "1/description.txt": "road only",
        "1/info_calib/calib_radar_lidar.txt": "frame difference,x,y\n1.5,2,3",
        "1/time_info/os2-64.txt": "os2-64_00001.pcd 164",
        "resources/odometry/gt/gt_01.txt": "1 2 3",
        "resources/cam_calib/calib_seq_v2/seq_01/cam_1.yml": "fx: nan",
        "1/frame_record/00033_00001.json": '{"sequence": "1", "indices": {}, "time_ns": 1}',
        "1/info_label/00033_00001.txt": "nothing",
    }
    for number, (name, text) in enumerate(files.items()):
        copy = tmp_path / str(number)
        shutil.copytree(root, copy)
        shutil.rmtree(copy / "kradar_revised_label_v2_1")
        (copy / name).write_text(text)
        with pytest.raises(FileFormatError, match=Path(name).name):
            KRadar(copy)[0]


def test_real_calibrations(shared_real: Path, tmp_path: Path) -> None:
    """Forward is the front camera's optical axis; what is written again reads the same."""
    count = 0
    with zipfile.ZipFile(shared_real / "kradar" / "calib_seq_v2.zip") as archive:
        for name in archive.namelist():
            if not name.endswith(".yml"):
                continue
            (tmp_path / "cam.yml").write_bytes(archive.read(name))
            camera, number = read_camera(tmp_path / "cam.yml"), int(name[-5])
            forward = [0, -np.pi / 2, np.pi, np.pi / 2][(number - 1) // 2]
            axis = camera.camera_T_lidar[2, :3]
            assert axis @ [np.cos(forward), np.sin(forward), 0] > 0.95
            text = format_camera(camera, number)
            assert [line.split(":")[0] for line in text.splitlines()] == sorted(
                line.split(":")[0] for line in archive.read(name).decode().splitlines() if line
            )
            (tmp_path / "again.yml").write_text(text)
            again = read_camera(tmp_path / "again.yml")
            same_pose(again.camera_T_lidar, camera.camera_T_lidar)
            assert np.array_equal(again.matrix, camera.matrix)
            count += 1
    assert count > 400


def test_the_camera_s_rotation_is_the_development_kit_s(tmp_path: Path) -> None:
    (tmp_path / "cam.yml").write_text(format_camera(frame(1).cameras["cam-front"], 1))
    values = dict(line.split(": ") for line in (tmp_path / "cam.yml").read_text().splitlines())
    angles = [float(values[f"{name}_ldr2cam"]) for name in ("yaw", "pitch", "roll")]
    point = np.array([30.0, -4.0, 1.0])
    moved = Rotation.from_euler("zyx", angles, degrees=True).apply(point) + [
        float(values[f"{axis}_ldr2cam"]) for axis in "xyz"
    ]
    expected = frame(1).cameras["cam-front"].camera_T_lidar @ [*point, 1]
    np.testing.assert_allclose(moved, expected[:3], atol=1e-12)


def test_real_odometry(shared_real: Path) -> None:
    poses = read_odometry(shared_real / "kradar" / "odometry" / "gt_01.txt")
    assert len(poses) == 597
    assert np.array_equal(poses[0], np.eye(4))
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1, atol=1e-5)
    assert np.linalg.norm(poses[1, :3, 3]) < 3


def test_the_real_lists_are_quarters_of_the_real_frames(shared_real: Path) -> None:
    lists = {}
    for part in ("train", "test"):
        lines = (shared_real / "kradar" / "split" / f"{part}.txt").read_text().splitlines()
        lists[part] = [tuple(line.removesuffix(".txt").split(",")) for line in lines]
    stems: dict[str, list[str]] = {}
    for sequence, stem in sorted(lists["train"] + lists["test"], key=lambda key: (int(key[0]), key[1])):
        stems.setdefault(sequence, []).append(stem)
    assert len(stems) == 58
    assert quarters(stems) == lists


def test_parts(root: Path) -> None:
    dataset = KRadar(root)
    parts = [dataset.benchmark_split(name) for name in ("train", "test")]
    assert {key for part in parts for key in part.keys} == set(dataset.keys)
    assert sum(map(len, parts)) == len(dataset)
    with pytest.raises(ConfigError, match="train or test"):
        dataset.benchmark_split("val")
    assert not (root / "splits").exists()  # two sequences cannot be dealt out


def test_whole_sequences_of_every_weather_are_dealt_out(tmp_path: Path) -> None:
    weather = {str(n): ("fog", "rain", "snow")[n % 3] for n in range(1, 31)} | {"31": "overcast", "32": "overcast"}
    parts = whole_sequences(dict.fromkeys(weather, 600), weather)
    assert sorted((name for part in parts.values() for name in part), key=int) == sorted(weather, key=int)
    assert {weather[name] for name in parts["val"]} == {"fog", "rain", "snow"}
    assert (
        {weather[name] for name in parts["train"]} == {weather[name] for name in parts["test"]} == set(weather.values())
    )
    assert 0.6 < len(parts["train"]) / len(weather) < 0.8
    few = whole_sequences({"1": 5, "2": 5, "3": 5}, {"1": "fog", "2": "rain", "3": "normal"})
    assert [len(few[part]) for part in ("train", "val", "test")] == [1, 1, 1]
    assert whole_sequences({"1": 5, "2": 5}, {}) == {}
    frames = [(str(sequence), number, 0) for sequence in (1, 2, 3) for number in (1, 2)]
    write(tmp_path, frames).finish()
    dealt = json.loads((tmp_path / "splits" / "kradar_v1.json").read_text())
    for name, sequences in dealt.items():
        assert set(KRadar(tmp_path).split(name).sequences) == set(sequences)


def test_names_of_sequences() -> None:
    assert [name for name in ("1", "58", "0", "01", "a", "1000", "resources") if is_sequence(name)] == ["1", "58"]


def test_other_trees_are_not_taken_for_k_radar(tmp_path: Path) -> None:
    (tmp_path / "1" / "velodyne").mkdir(parents=True)
    with pytest.raises(DatasetError, match=r"recognised no data set.*kradar"):
        open_dataset(tmp_path)


def test_boxes_without_tracks_or_availability(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    plain = replace(boxes(rng), track_id=None)
    given = frame(1)
    KRadarWriter(tmp_path, columns=512).write(given.annotated(Annotation(boxes=plain)))
    back = KRadar(tmp_path)[0]
    assert back.boxes.track_id.tolist() == [0, 1, 2, 3, 4]
    assert list(back.annotation.visibility) == ["R"] * 5
