"""Slips in the label files of published layouts: each is refused, as it would change a number in silence."""

import json
from pathlib import Path
from typing import Any

import pytest

from farfield.datasets.cirrus.labels import annotation_from_labels, parse_labels
from farfield.datasets.cirrus.layout import Labels
from farfield.datasets.cirrus.reader import Cirrus
from farfield.datasets.kradar.labels import parse_labels as parse_kradar
from farfield.datasets.view_of_delft.reader import ViewOfDelft
from farfield.errors import DatasetError, FarfieldError, FileFormatError
from farfield.files.astyx import read_objects as read_astyx
from farfield.files.boreas import read_boreas_objects
from farfield.files.kitti import read_labels as read_kitti
from farfield.files.nuscenes import read_results
from farfield.files.radiate import read_times, read_tracks
from farfield.files.view_of_delft import read_camera_poses
from farfield.files.view_of_delft import read_objects as read_delft

NAN, FAR = float("nan"), 2e7
TURNED, ON_ITS_SIDE = [0.0, 0.0, 3.0, 4.0], [0.6, 0.0, 0.0, 0.8]  # x, y, z, w


def written(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


# View-of-Delft's JSON.


def delft(**changes: Any) -> dict[str, Any]:
    geometry = {
        "center": {"x": 10.0, "y": -2.0, "z": 0.5},
        "size": {"length": 4.0, "width": 1.8, "height": 1.5},
        "quaternion": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
    }
    geometry |= {name: changes.pop(name) for name in list(changes) if name in geometry}
    entry = {"className": "bicycle", "objectId": "a", "geometry": geometry, "attributes": {"has_rider": True}}
    return entry | changes


@pytest.mark.parametrize(
    "changes",
    [
        {"center": {"x": True, "y": -2.0, "z": 0.5}},
        {"center": {"x": FAR, "y": -2.0, "z": 0.5}},
        {"quaternion": dict(zip("xyzw", ON_ITS_SIDE, strict=True))},
        {"quaternion": {"x": 0.0, "y": 0.0, "z": 0.3, "w": 0.5}},
        {"className": " "},
        {"className": "c\0ar"},
        {"attributes": {"has_rider": "False"}},
        {"attributes": {"activity": 3}},
    ],
)
def test_view_of_delft(tmp_path: Path, changes: dict[str, Any]) -> None:
    read_delft(written(tmp_path / "good.json", [delft()]))
    with pytest.raises(FileFormatError, match="object 1"):
        read_delft(written(tmp_path / "wrong.json", [delft(objectId="b"), delft(**changes)]))


def test_view_of_delft_says_each_thing_once(tmp_path: Path) -> None:
    text = json.dumps([delft()]).replace('"z": 0.5', '"z": 0.5, "z": 9.5')
    with pytest.raises(FileFormatError, match="twice"):
        read_delft(written(tmp_path / "keys.json", text))
    eye = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    moved = [1, 0, 0, 9, *eye[4:]]
    lines = "\n".join(json.dumps({"odomToCamera": matrix}) for matrix in (eye, moved))
    with pytest.raises(FileFormatError, match="odomToCamera"):
        read_camera_poses(written(tmp_path / "poses.json", lines))


# RADIATE.


def radiate(**changes: Any) -> dict[str, Any]:
    box = {"position": [500.0, 400.0, 12.5, 24.0], "rotation": 12.0}
    return {"id": 1, "class_name": "car", "bboxes": [[], box, box]} | changes


@pytest.mark.parametrize(
    "changes",
    [
        {"bboxes": [[], None, []]},
        {"bboxes": [[], {}, []]},
        {"bboxes": [[], 0, []]},
        {"bboxes": [[]]},
        {"bboxes": [[], {"position": [True, 400.0, 12.5, 24.0], "rotation": 12.0}, []]},
        {"bboxes": [[], {"position": [500.0, 400.0, 12.5, 24.0], "rotation": 1e4}, []]},
        {"bboxes": [[], {"position": [50000.0, 400.0, 12.5, 24.0], "rotation": 12.0}, []]},
        {"class_name": ""},
        {"class_name": "c\0ar"},
    ],
)
def test_radiate(tmp_path: Path, changes: dict[str, Any]) -> None:
    assert len(read_tracks(written(tmp_path / "good.json", [radiate(), radiate(id=2)]))) == 4
    with pytest.raises(FileFormatError, match="object 1"):
        read_tracks(written(tmp_path / "wrong.json", [radiate(), radiate(id=2) | changes]))


def test_radiate_says_each_thing_once(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"object 1.*once"):
        read_tracks(written(tmp_path / "tracks.json", [radiate(), radiate()]))
    text = json.dumps([radiate()]).replace('"id": 1', '"id": 1, "id": 2')
    with pytest.raises(FileFormatError, match="twice"):
        read_tracks(written(tmp_path / "keys.json", text))
    line = "Frame: 000001 Time: 1574859771.744660272\n"
    with pytest.raises(FileFormatError, match="line 2"):
        read_times(written(tmp_path / "times.txt", line + line.replace("771", "772")))


# Cirrus.


def cirrus(**changes: Any) -> dict[str, Any]:
    entry = {"label_class": "vehicle", "position": [20.0, 3.0, -1.0], "size": [4.5, 1.9, 1.6]}
    return entry | {"quaternion": [0.0, 0.0, 0.6, 0.8], "track_id": 7, "point_count_gaussian": 30} | changes


def read_cirrus(content: Any, name: str = "a.json") -> Any:
    data = content if isinstance(content, bytes) else json.dumps(content).encode()
    return annotation_from_labels(parse_labels(data, Path(name), Labels()), Labels())


@pytest.mark.parametrize(
    "changes",
    [
        {"track_id": 7.5},
        {"track_id": True},
        {"track_id": -5},
        {"track_id": [7]},
        {"track_id": ""},
        {"point_count_gaussian": "30"},
        {"point_count_gaussian": -3},
        {"point_count_gaussian": True},
        {"point_count_uniform": 2.5},
        {"position": [FAR, 3.0, -1.0]},
        {"quaternion": TURNED},
        {"label_class": " "},
        {"label_class": "vehi\ncle"},
    ],
)
def test_cirrus(changes: dict[str, Any]) -> None:
    read_cirrus({"labels": [cirrus(), cirrus(track_id="3f2b")]})
    with pytest.raises(FileFormatError, match="label 1"):
        read_cirrus({"labels": [cirrus(track_id=1), cirrus(**changes)]})


def test_cirrus_says_each_thing_once() -> None:
    text = json.dumps({"labels": [cirrus()]})
    for old, new in (('"track_id": 7', '"track_id": 7, "track_id": 8'), ('{"labels"', '{"labels": [], "labels"')):
        with pytest.raises(FileFormatError, match="twice"):
            read_cirrus(text.replace(old, new).encode())


@pytest.mark.parametrize("angle", ["90", "1_0", "\u0663"])
def test_cirrus_text(angle: str) -> None:
    row = "vehicle 0 0 0 0 0 9 9 1.6 4.5 1.9 -3 1 20"
    assert len(read_cirrus(f"{row} 0.5\n".encode(), "a.txt").boxes) == 1
    with pytest.raises(FileFormatError, match="line 2"):
        read_cirrus(f"{row} 0.5\n{row} {angle}\n".encode(), "a.txt")


def test_poses_of_cirrus_are_rigid(tmp_path: Path) -> None:
    sweep = tmp_path / "Cirrus_dataset1" / "dataset1_gaussian" / "1556919593820375200.xyz"
    sweep.parent.mkdir(parents=True)
    sweep.write_text("1.0 2.0 3.0 0.5 0\n" * 3)
    labels = sweep.parents[1] / "dataset1_annotation" / f"{sweep.stem}.json"
    labels.parent.mkdir()
    pose = [[1, 0, 0, 5], [0, -1, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
    written(labels, {"labels": [cirrus()], "world_T_lidar": pose})
    with pytest.raises(FileFormatError, match=r"world_T_lidar"):
        Cirrus(tmp_path)[0]


# nuScenes' results.


def nuscenes(**changes: Any) -> dict[str, Any]:
    box = {"translation": [20.0, 3.0, 1.0], "size": [1.9, 4.5, 1.6], "rotation": [0.8, 0.0, 0.0, 0.6]}
    names = {"detection_name": "car", "detection_score": 0.9, "attribute_name": ""}
    return {"sample_token": "b"} | box | {"velocity": [1.0, 2.0]} | names | changes


@pytest.mark.parametrize(
    "changes",
    [
        {"sample_token": "a"},
        {"translation": [FAR, 3.0, 1.0]},
        {"rotation": [0.6, 0.8, 0.0, 0.0]},
        {"rotation": [1.5708, 0.0, 0.0, 0.0]},
        {"velocity": [1.0, 2.0, 3.0, 4.0]},
        {"velocity": [1.0]},
        {"velocity": [NAN, 2.0]},
        {"detection_name": " "},
        {"detection_name": "c\0ar"},
    ],
)
def test_nuscenes(tmp_path: Path, changes: dict[str, Any]) -> None:
    good = {"results": {"a": [], "b": [nuscenes(), nuscenes(velocity=[NAN, NAN])]}}
    assert len(read_results(written(tmp_path / "good.json", good))["b"].label) == 2
    wrong = {"results": {"a": [], "b": [nuscenes(), nuscenes(**changes)]}}
    with pytest.raises(FileFormatError, match="sample b"):
        read_results(written(tmp_path / "wrong.json", wrong))


def test_nuscenes_says_each_sample_once(tmp_path: Path) -> None:
    text = json.dumps({"results": {"a": [], "b": [nuscenes()]}}).replace('"a"', '"b"')
    with pytest.raises(FileFormatError, match="twice"):
        read_results(written(tmp_path / "samples.json", text))
    names = {"tracking_name": "car", "tracking_score": 0.9, "tracking_id": "1"}
    track = {key: value for key, value in nuscenes(sample_token="a").items() if "detection" not in key} | names
    with pytest.raises(FileFormatError, match="not both"):
        read_results(written(tmp_path / "kinds.json", {"results": {"a": [track], "b": [nuscenes()]}}))
    with pytest.raises(FileFormatError, match="reference"):
        read_results(written(tmp_path / "meta.json", {"meta": {"reference": 5}, "results": {}}))


# K-Radar.

HEADER = (
    "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)=00033_00001_00002_00001_00004, timestamp=1643292946.710046076"
)


@pytest.mark.parametrize(
    "line",
    [
        "*, R, 1, S\u00e9dan, 20, 3, -1, 30, 2, 1, 0.8".encode("latin-1"),
        b"*, R, 1, Se\0dan, 20, 3, -1, 30, 2, 1, 0.8",
        b"*, R, 1, Sedan, 2e7, 3, -1, 30, 2, 1, 0.8",
        b"*, R, 1, Sedan, 20, 3, -1, 30000, 2, 1, 0.8",
        b"*, R, 5, 5, Sedan, 20, 3, -1, 30, 2, 1, 0.8",
        b"*, 1, Sedan, 20, 3, -1, 30, 2, 1, 0.8",
    ],
)
def test_kradar(line: bytes) -> None:
    good = f"{HEADER}\n*, R, 0, Sedan, 20, 3, -1, 30, 2, 1, 0.8\n".encode()
    assert parse_kradar(good, "a.txt").boxes.track_id is not None
    with pytest.raises(FileFormatError):
        parse_kradar(good + line + b"\n", "a.txt")


# Astyx, Boreas, KITTI.


def astyx(**changes: Any) -> dict[str, Any]:
    entry = {"classname": "Car", "center3d": [18.0, 3.0, 0.0], "dimension3d": [4.9, 1.9, 1.8]}
    return entry | {"orientation_quat": [0.8, 0.0, 0.0, 0.6], "occlusion": 0, "label_certainty": 0} | changes


@pytest.mark.parametrize(
    "changes",
    [
        {"center3d": [FAR, 3.0, 0.0]},
        {"orientation_quat": [0.0, 0.0, 0.6, 0.8]},
        {"occlusion": True},
        {"classname": ""},
        {"classname": "c\0ar"},
    ],
)
def test_astyx(tmp_path: Path, changes: dict[str, Any]) -> None:
    read_astyx(written(tmp_path / "good.json", {"objects": [astyx()]}))
    with pytest.raises(FileFormatError, match=r"objects.1"):
        read_astyx(written(tmp_path / "wrong.json", {"objects": [astyx(), astyx(**changes)]}))


@pytest.mark.parametrize(
    "line",
    [
        "b C\0ar 4.5 2.0 1.6 10 -2 -0.5 1.5 28",
        "b Car 4.5 2.0 1_6 10 -2 -0.5 1.5 28",
        "b Car 4.5 2.0 1.6 10 -2 -0.5 1.5 28.5",
        "b Car 4.5 2.0 1.6 10 -2 -0.5 90 28",
        "b Car 4.5 2.0 1.6 2e7 -2 -0.5 1.5 28",
        "\ufeffb Car 4.5 2.0 1.6 10 -2 -0.5 1.5 28",
        "a Car 4.5 2.0 1.6 10 -2 -0.5 1.5 28",
    ],
)
def test_boreas(tmp_path: Path, line: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(f"a Car 4.5 2.0 1.6 10 -2 -0.5 1.5 28\n{line}\n", encoding="utf-8")
    with pytest.raises(FileFormatError):
        read_boreas_objects(path)


KITTI = "Car 0.00 0 -1.57 599.41 156.40 629.75 189.25 2.85 2.63 12.34 0.47 1.49 69.44 -1.56"


@pytest.mark.parametrize(
    "line",
    [
        KITTI.replace("Car", "0.5"),
        KITTI.replace("Car", "C\0ar"),
        KITTI.replace("Car 0.00 0", "Car 69.44 0"),
        KITTI.replace("Car 0.00 0", "Car 0.00 17"),
        KITTI.replace("599.41 156.40 629.75", "629.75 156.40 599.41"),
    ],
)
def test_kitti(tmp_path: Path, line: str) -> None:
    assert len(read_kitti(written(tmp_path / "good.txt", KITTI + "\n"))) == 1
    with pytest.raises(FileFormatError, match="byte 84" if "\0" in line else "line 2"):
        read_kitti(written(tmp_path / "wrong.txt", f"{KITTI}\n{line}\n"))


@pytest.mark.parametrize("line", [KITTI.replace("69.44 -1.56", "69.44 90"), KITTI.replace("2.85", "0")])
def test_view_of_delft_text(tmp_path: Path, line: str) -> None:
    root = tmp_path / "radar" / "training"
    for folder, suffix, text in (("velodyne", "bin", ""), ("label_2", "txt", f"{KITTI} 1\n{line} 1\n")):
        (root / folder).mkdir(parents=True)
        written(root / folder / f"00001.{suffix}", text)
    (root / "calib").mkdir()
    written(
        root / "calib" / "00001.txt",
        "P2: 700 0 600 0 0 700 180 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n",
    )
    with pytest.raises(FileFormatError, match="line 2"):
        ViewOfDelft(tmp_path).annotation(0)


# Argoverse 2.

STAMP = 315966265259836000


def argoverse(root: Path, sweep: bool = False, renamed: tuple[str, str] = ("", ""), **changes: Any) -> Any:
    pyarrow = pytest.importorskip("pyarrow")
    feather = pytest.importorskip("pyarrow.feather")
    from farfield.datasets.argoverse2 import Argoverse2

    columns: dict[str, Any] = {
        "timestamp_ns": [STAMP, STAMP],
        "track_uuid": ["a", "b"],
        "category": ["REGULAR_VEHICLE"] * 2,
        "num_interior_pts": [30, 3],
    }
    numbers = {"length_m": 4.5, "width_m": 1.9, "height_m": 1.6, "qw": 0.8, "qx": 0.0, "qy": 0.0, "qz": 0.6}
    numbers |= {"tx_m": 20.0, "ty_m": 3.0, "tz_m": 1.0}
    columns |= {name: [value, value] for name, value in numbers.items()}
    columns |= changes
    names = [renamed[1] if name == renamed[0] else name for name in columns]
    root.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pyarrow.table(list(columns.values()), names=names), root / "annotations.feather")
    if sweep:
        (root / "sensors" / "lidar").mkdir(parents=True)
        (root / "sensors" / "lidar" / f"{STAMP}.feather").write_bytes(b"")
    data = Argoverse2(root)
    return [data.annotation(index) for index in range(len(data))]


@pytest.mark.parametrize(
    "changes",
    [
        {"length_m": ["4.5", "4.5"]},
        {"length_m": [True, True]},
        {"tx_m": [[20.0], [20.0]]},
        {"tx_m": [20.0, FAR]},
        {"timestamp_ns": [float(STAMP)] * 2},
        {"timestamp_ns": [str(STAMP)] * 2},
        {"num_interior_pts": [30.0, float("nan")]},
        {"num_interior_pts": [30, -3]},
        {"category": [1, 2]},
        {"category": ["REGULAR_VEHICLE", ""]},
        {"category": ["REGULAR_VEHICLE", "BU\0S"]},
        {"track_uuid": ["a", ""]},
        {"track_uuid": ["a", "a"]},
        {"qw": [5.0, 0.8]},
        {"qx": [0.6, 0.6], "qz": [0.0, 0.0]},
        {"qw": [0.0, 0.0], "qy": [0.6, 0.6], "qz": [0.8, 0.8]},
        {"renamed": ("category", "length_m")},
        {"renamed": ("num_interior_pts", "qw")},
    ],
)
def test_argoverse2(tmp_path: Path, changes: dict[str, Any]) -> None:
    assert len(argoverse(tmp_path / "good")[0].boxes) == 2
    with pytest.raises(FarfieldError, match=r"annotations\.feather"):
        argoverse(tmp_path / "wrong", **changes)


def test_annotations_of_argoverse2_belong_to_its_sweeps(tmp_path: Path) -> None:
    assert len(argoverse(tmp_path / "good", sweep=True)[0].boxes) == 2
    with pytest.raises(DatasetError, match="timestamp_ns"):
        argoverse(tmp_path / "wrong", sweep=True, timestamp_ns=[STAMP // 1000] * 2)
