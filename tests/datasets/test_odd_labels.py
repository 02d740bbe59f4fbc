"""Odd labels in every layout that reads them: refused with a cure, or named by the doctor; never read as they are."""

import json
import unicodedata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trees import write_kitti

from farfield.datasets import open_dataset
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.openlabel import parse_openlabel
from farfield.files.pcd import write_pcd
from farfield.files.tracklets import parse_frame_list
from farfield.inspection.doctor import examine

BOX = "10,2,-1,4.4,1.8,1.5"
HEAD = "frame,label,x,y,z,l,w,h,yaw_rad"


def own(root: Path, rows: str, head: str = HEAD) -> Path:
    root.mkdir(exist_ok=True)
    for stem in ("a", "b"):
        np.save(root / f"{stem}.npy", np.ones((5, 4), np.float32))
    (root / "labels.csv").write_text(f"{head}\n{rows}")
    return root


def cloud(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_pcd(path, {axis: np.float32([1, 2]) for axis in "xyz"})


def json_box(root: Path, turn: tuple[float, float, float]) -> Path:
    own(root, f"a,Car,{BOX},0\n")
    (root / "labels.csv").unlink()
    box = {"label": "Car", "centre_m": [10, 2, -1], "size_m": [4, 2, 1.5], "yaw_rad": turn[2]}
    (root / "a.json").write_text(json.dumps({"boxes": [box]}))
    return root


def sustechpoints(root: Path, turn: tuple[float, float, float]) -> Path:
    cloud(root / "lidar" / "a.pcd")
    (root / "label").mkdir()
    place = {"position": {"x": 10, "y": 2, "z": 0}, "scale": {"x": 4, "y": 2, "z": 1.5}}
    place["rotation"] = dict(zip("xyz", turn, strict=True))
    (root / "label" / "a.json").write_text(json.dumps([{"obj_id": "1", "obj_type": "Car", "psr": place}]))
    return root


def datumaro(root: Path, turn: tuple[float, float, float], names: tuple[str, ...] = ("a",), file: str = "x") -> Path:
    for stem in ("a", "b"):
        cloud(root / "point_clouds" / f"{stem}.pcd")
    box: dict[str, Any] = {"position": [10, 2, 0], "rotation": list(turn), "scale": [4.4, 1.8, 1.5]}
    entry = {"id": 0, "type": "cuboid_3d", "label_id": 0, "attributes": {}, **box}
    items = [{"id": name, "annotations": [entry]} for name in names]
    (root / "annotations").mkdir(exist_ok=True)
    content = {"categories": {"label": {"labels": [{"name": "Car"}]}}, "items": items}
    (root / "annotations" / f"{file}.json").write_text(json.dumps(content))
    return root


def supervisely(root: Path, turn: tuple[float, float, float]) -> Path:
    cloud(root / "pointcloud" / "a.pcd")
    (root / "ann").mkdir()
    place = {"position": {"x": 10, "y": 2, "z": 0}, "dimensions": {"x": 4, "y": 2, "z": 1.5}}
    geometry = place | {"rotation": dict(zip("xyz", turn, strict=True))}
    figure = {"key": "f", "objectKey": "k", "geometryType": "cuboid_3d", "geometry": geometry}
    content = {"objects": [{"key": "k", "classTitle": "Car", "tags": []}], "figures": [figure]}
    (root / "ann" / "a.pcd.json").write_text(json.dumps(content))
    return root


def tracklets(root: Path, turn: tuple[float, float, float], names: tuple[str, ...] = ("a", "b")) -> Path:
    folder = root / "drive"
    for stem in ("a", "b"):
        cloud(folder / "velodyne_points" / "data" / f"{stem}.pcd")
    angles = "".join(f"<r{axis}>{value}</r{axis}>" for axis, value in zip("xyz", turn, strict=True))
    pose = f"<item><tx>10</tx><ty>2</ty><tz>0</tz>{angles}</item>"
    head = "<objectType>Car</objectType><h>4.4</h><w>1.8</w><l>1.5</l><first_frame>0</first_frame>"
    (folder / "tracklet_labels.xml").write_text(
        f"<b><tracklets><item>{head}<poses>{pose * 2}</poses></item></tracklets></b>"
    )
    (folder / "frame_list.txt").write_text("".join(f"{number} {name}\n" for number, name in enumerate(names)))
    return root


def kitti(root: Path, turn: tuple[float, float, float] = (0, 0, 0), row: str = "10 10 50 50 1.5 1.8 4.0") -> Path:
    write_kitti(root)
    (root / "training" / "label_2" / "000007.txt").write_text(f"Car 0 0 0 {row} 2 1.7 20 {turn[2]}\n")
    return root


def csv(root: Path, turn: tuple[float, float, float]) -> Path:
    return own(root, f"a,Car,{BOX},{turn[2]}\n")


YAWS = (csv, json_box, sustechpoints, datumaro, supervisely, tracklets, kitti)


def read(root: Path) -> None:
    data = open_dataset(root)
    for index in range(len(data)):
        data.annotation(index)


@pytest.mark.parametrize("layout", YAWS)
def test_degrees_for_radians_are_refused(tmp_path: Path, layout: Any) -> None:
    read(layout(tmp_path / "near", (0, 0, 6.9)))  # a little more than a turn is an angle that was counted on
    with pytest.raises(FileFormatError, match=r"radians.*90.*[Dd]egrees"):
        read(layout(tmp_path / "far", (0, 0, 90)))


@pytest.mark.parametrize("turn", [(3.1, 0, 0), (0, 1.57, 0)])
@pytest.mark.parametrize("layout", [sustechpoints, datumaro, supervisely, tracklets])
def test_boxes_that_do_not_stand_upright_are_refused(tmp_path: Path, layout: Any, turn: Any) -> None:
    read(layout(tmp_path / "near", (0.07, -0.05, 0.4)))
    with pytest.raises(FileFormatError, match="upright"):
        read(layout(tmp_path / "far", turn))


def test_openlabel_s_boxes_stand_upright() -> None:
    cuboid = {"name": "a", "val": [10, 2, 0, 0.7071, 0, 0, 0.7071, 4, 2, 1.5]}
    frames = {"0": {"objects": {"1": {"object_data": {"cuboid": [cuboid]}}}}}
    content = {"openlabel": {"objects": {"1": {"name": "a", "type": "Car"}}, "frames": frames}}
    with pytest.raises(FileFormatError, match="upright"):
        parse_openlabel(json.dumps(content).encode(), "a.json")


def test_an_item_twice_is_refused_and_every_file_is_read(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="'a' twice"):
        read(datumaro(tmp_path / "one", (0, 0, 0), ("x/a", "y/a")))
    root = datumaro(tmp_path / "two", (0, 0, 0), ("a",), "train")
    data = open_dataset(datumaro(root, (0, 0, 0), ("b",), "val"))
    assert [len(data.annotation(index)) for index in range(2)] == [1, 1]
    assert len([path for path in data.files(0) if path.suffix == ".json"]) == 2
    with pytest.raises(DatasetError, match=r"val\.json.*'a'"):
        read(datumaro(root, (0, 0, 0), ("a",), "val"))


def test_a_list_of_sweeps_in_any_spelling_but_each_once(tmp_path: Path) -> None:
    assert parse_frame_list(b"\xef\xbb\xbf0\ta\r\n1\tb b\r\n", "l") == {0: "a", 1: "b b"}
    with pytest.raises(DatasetError, match="each sweep once"):
        read(tracklets(tmp_path / "twice", (0, 0, 0), ("x/a", "y/a")))


@pytest.mark.parametrize("sizes", ["0 1.8 4.0", "-1 1.8 4.0"])
def test_kitti_s_sizes_are_all_there_or_none(tmp_path: Path, sizes: str) -> None:
    read(kitti(tmp_path / "none", row="10 10 50 50 -1 -1 -1"))
    with pytest.raises(FileFormatError, match="sizes"):
        read(kitti(tmp_path / "some", row=f"10 10 50 50 {sizes}"))


@pytest.mark.parametrize("turns", ["0 -1 0 0 1 0 0 0 0 0 1 0", "0 0 1 0 -1 0 0 0 0 -1 0 0"])
def test_a_calibration_of_no_upright_camera_is_refused(tmp_path: Path, turns: str) -> None:
    root = kitti(tmp_path / "k")
    path = root / "training" / "calib" / "000007.txt"
    matrix = "P2: 700 0 600 0 0 700 180 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n"
    path.write_text(f"{matrix}Tr_velo_to_cam: {turns}\n")
    with pytest.raises(DatasetError, match="--label-axes lidar"):
        read(root)


@pytest.mark.parametrize("cell", ['"Car\nfast"', '"Car\tfast"'])
def test_names_stand_on_one_line(tmp_path: Path, cell: str) -> None:
    with pytest.raises(FileFormatError, match="one line"):
        read(own(tmp_path / "own", f"a,{cell},{BOX},0\n"))


def test_digits_are_plain(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="1_0"):
        read(own(tmp_path / "own", f"a,Car,1{BOX.replace('10', '_0', 1)},0\n"))
    with pytest.raises(FileFormatError, match="1_0"):
        read(kitti(tmp_path / "k", row="1_0 10 50 50 1.5 1.8 4.0"))


def test_one_name_in_two_forms_of_unicode_is_one_class(tmp_path: Path) -> None:
    forms = [unicodedata.normalize(form, "Gefährt") for form in ("NFC", "NFD")]
    root = own(tmp_path / "own", "".join(f"{frame},{name},{BOX},0\n" for frame, name in zip("ab", forms, strict=True)))
    data = open_dataset(root)
    assert {str(data.annotation(index).boxes.label[0]) for index in range(2)} == {forms[0]}
    (root / "mapping.yaml").write_text(f"classes: {{{forms[1]}: trailer}}\n", encoding="utf-8")
    data = open_dataset(root)
    assert {str(data.annotation(index).boxes.label[0]) for index in range(2)} == {"trailer"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("classes:\n  Car: animal\n  Car: vehicle\n", "'Car' twice"),
        ('classes: {Car: "a\\nb"}\n', "one line"),
    ],
)
def test_a_mapping_says_one_thing(tmp_path: Path, text: str, message: str) -> None:
    root = own(tmp_path / "own", f"a,Car,{BOX},0\n")
    (root / "mapping.yaml").write_text(text)
    with pytest.raises(ConfigError, match=message):
        open_dataset(root)


@pytest.mark.parametrize("name", ["0", "No"])
def test_numbers_and_no_are_names_of_classes(tmp_path: Path, name: str) -> None:
    root = own(tmp_path / "own", f"a,{name},{BOX},0\n")
    (root / "mapping.yaml").write_text(f"classes: {{{name}: trailer}}\n")
    assert open_dataset(root).annotation(0).boxes.label.tolist() == ["trailer"]


def test_the_doctor_names_sizes_out_of_order_and_tracks_twice_in_a_frame(tmp_path: Path) -> None:
    rows = "".join(f"{frame},Car,{10 + 9 * n},2,-1,1.5,1.8,4.4,0,7\n" for frame in "ab" for n in range(3))
    findings = examine(open_dataset(own(tmp_path / "own", rows, f"{HEAD},track_id"))).findings
    (sizes,) = [finding for finding in findings if finding.topic == "order of sizes"]
    assert "6 of 6" in sizes.what
    (tracks,) = [finding for finding in findings if finding.topic == "tracks"]
    assert "2 of 2 frames" in tracks.what
