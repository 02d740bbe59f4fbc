"""Tasks of CVAT read: Datumaro, KITTI raw with tracklets, Supervisely."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.convert import convert
from farfield.datasets.cvat import Cvat
from farfield.datasets.labels import label_format
from farfield.datasets.labels.tracklet_labels import TrackletLabels
from farfield.errors import DatasetError
from farfield.files.pcd import write_pcd
from farfield.geometry.boxes import count_points_in_boxes
from farfield.testing import check_dataset

POSE = "<item><tx>{x}</tx><ty>2</ty><tz>-1.75</tz><rx>0</rx><ry>0</ry><rz>0.5235987755982988</rz></item>"
OBJECT = "<objectType>Car</objectType><h>1.5</h><w>1.9</w><l>4.6</l><first_frame>1</first_frame>"
TRACKLETS = f"<b><tracklets><item>{OBJECT}<poses>{POSE.format(x=10)}{POSE.format(x=11)}</poses></item></tracklets></b>"
PLACE = {"x": 10.0, "y": 2.0, "z": -1.0}
GEOMETRY = {
    "position": PLACE,
    "rotation": {"x": 0, "y": 0, "z": 0.5235987755982988},
    "dimensions": {"x": 4.6, "y": 1.9, "z": 1.5},
}
SUPERVISELY = {
    "objects": [{"key": "k", "classTitle": "Car"}],
    "figures": [{"objectKey": "k", "geometryType": "cuboid_3d", "geometry": GEOMETRY}],
}


def clouds(folder: Path, names: tuple[str, ...]) -> None:
    folder.mkdir(parents=True)
    for name in names:
        write_pcd(folder / f"{name}.pcd", {axis: np.float32([1, 2]) for axis in "xyz"})


def test_datumaro_comes_back_from_a_conversion(street_root: Path, tmp_path: Path) -> None:
    source = open_dataset(street_root)
    convert(source, tmp_path / "tasks", to="cvat")
    made = open_dataset(tmp_path / "tasks")
    assert made.name == "cvat"
    assert made.keys == source.keys
    for got, want in zip(made, source, strict=True):
        assert got.boxes is not None
        assert want.boxes is not None
        np.testing.assert_array_equal(got.cloud().points_m, want.cloud().points_m)
        np.testing.assert_allclose(got.boxes.size_m, want.boxes.size_m)
        np.testing.assert_allclose(got.boxes.yaw_rad, want.boxes.yaw_rad, atol=1e-12)
        assert got.boxes.label.tolist() == want.boxes.label.tolist()
    check_dataset(made)


def test_datumaro_is_edited_where_it_stands(street_root: Path, tmp_path: Path) -> None:
    convert(open_dataset(street_root), tmp_path / "tasks", to="cvat")
    made = open_dataset(tmp_path / "tasks")
    labels = label_format(made)
    assert labels is not None
    key = made.keys[0]
    path = labels.path(key)
    found = labels.parse(path.read_bytes(), path, [key])[key]
    moved = [replace(found[0], box=(1.25, *found[0].box[1:])), *found[1:]]
    path.write_bytes(labels.render(path.read_bytes(), path, {key: moved}))
    boxes = open_dataset(tmp_path / "tasks")[0].boxes
    assert boxes is not None
    assert boxes.centre_m[0, 0] == 1.25


@pytest.mark.parametrize("names", [("0000000000", "0000000001", "0000000002"), ("a", "b", "c")])
def test_tracklets_by_the_number_of_the_frame(tmp_path: Path, names: tuple[str, ...]) -> None:
    clouds(tmp_path / "drive" / "velodyne_points" / "data", names)
    (tmp_path / "drive" / "tracklet_labels.xml").write_text(TRACKLETS)
    data = open_dataset(tmp_path)
    assert data.sequences == ("drive",) * 3
    boxes = [frame.boxes for frame in data]
    assert [0 if each is None else len(each) for each in boxes] == [0, 1, 1]
    assert boxes[2] is not None
    assert boxes[2].centre_m[0].tolist() == [11.0, 2.0, -1.0]
    assert boxes[2].size_m[0].tolist() == [4.6, 1.9, 1.5]
    assert np.rad2deg(boxes[2].yaw_rad[0]) == pytest.approx(30)
    assert boxes[2].label.tolist() == ["vehicle"]
    labels, key = label_format(data), data.keys[2]
    assert isinstance(labels, TrackletLabels)
    path = labels.path(key)
    (found,) = labels.parse(path.read_bytes(), path, [key])[key]
    moved = replace(found, box=(12.5, *found.box[1:]))
    path.write_bytes(labels.render(path.read_bytes(), path, {key: [moved]}))
    again = open_dataset(tmp_path)
    assert again[2].boxes.centre_m[0].tolist() == [12.5, 2.0, -1.0]
    assert again[1].boxes.centre_m[0].tolist() == boxes[1].centre_m[0].tolist()


def test_supervisely_by_the_clouds_name(tmp_path: Path) -> None:
    clouds(tmp_path / "ds0" / "pointcloud", ("a", "b"))
    (tmp_path / "ds0" / "ann").mkdir()
    (tmp_path / "ds0" / "ann" / "b.pcd.json").write_text(json.dumps(SUPERVISELY))
    data = open_dataset(tmp_path)
    assert [data.has_annotation(index) for index in (0, 1)] == [False, True]
    annotation = data.annotation(1)
    assert annotation is not None
    assert annotation.boxes.size_m[0].tolist() == [4.6, 1.9, 1.5]
    assert annotation.original_label == ("Car",)


def test_a_real_drive(shared_real: Path) -> None:
    data = open_dataset(shared_real / "kitti_raw", format="cvat")  # tracklets alone, as CVAT exports them
    assert isinstance(data, Cvat)
    assert len(data) == 4
    for frame in data:
        assert frame.boxes is not None
        assert len(frame.boxes) == 5
        assert (count_points_in_boxes(frame.cloud().points_m, frame.boxes) > 0).all()


def test_nothing_is_no_task(tmp_path: Path) -> None:
    (tmp_path / "annotations").mkdir()
    (tmp_path / "annotations" / "a.json").write_text("{}")
    with pytest.raises(DatasetError, match="task of CVAT"):
        Cvat(tmp_path)


def test_supervisely_is_edited_where_it_stands(tmp_path: Path) -> None:
    """One number moved: one line changed; tags, pitch, figures of other kinds and spelling stay as they are."""
    clouds(tmp_path / "ds0" / "pointcloud", ("a", "b"))
    file = tmp_path / "ds0" / "ann" / "b.pcd.json"
    file.parent.mkdir()
    other = {"objectKey": "k", "geometryType": "point_3d", "geometry": {"x": 1}}
    tilted = GEOMETRY | {"rotation": {"x": 0.1, "y": 0, "z": 0.5}}
    figures = [other, *SUPERVISELY["figures"], {"objectKey": "m", "geometryType": "cuboid_3d", "geometry": tilted}]
    seen = [{"name": "seen", "value": "half"}]
    objects = [{"key": "k", "classTitle": "Car", "tags": seen}, {"key": "m", "classTitle": "Van"}]
    file.write_text(json.dumps({"figures": figures, "objects": objects}, indent=3).replace("10.0", "1.00e1"))
    data = open_dataset(tmp_path)
    labels = label_format(data)
    assert labels is not None
    key, before = data.keys[1], file.read_bytes()
    car, van = labels.parse(before, file, [key])[key]
    assert labels.render(before, file, {key: [car, van]}) == before
    x, y, z, *rest = van.box
    after = labels.render(before, file, {key: [car, replace(van, box=(x, y + 1.5, z, *rest))]})
    old, new = before.splitlines(), after.splitlines()
    assert [line for line, was in zip(new, old, strict=True) if line != was] == [b'               "y": 3.5,']
    bus = replace(car, id="new", label="Bus", track="7", box=(30.0, *car.box[1:6], 0.25))
    made = labels.render(before, file, {key: [replace(car, label="Truck"), bus]})
    again = labels.parse(made, file, [key])[key]
    assert [(each.label, each.track, each.box) for each in again] == [("Truck", "k", car.box), ("Bus", "7", bus.box)]
    assert again[0].attributes == {"seen": "half"}
    assert json.loads(made)["figures"][0] == other
    first = labels.path(data.keys[0])
    assert first == file.with_name("a.pcd.json")
    fresh = labels.render(None, first, {data.keys[0]: [bus]})
    assert labels.parse(fresh, first, [data.keys[0]])[data.keys[0]][0].box == bus.box


def datumaro(root: Path, stems: tuple[str, ...], items: list[dict[str, object]]) -> Path:
    """A task in Datumaro's form; item number n has a car n m ahead."""
    clouds(root / "task" / "point_clouds", stems)
    for number, item in enumerate(items):
        box = {"position": [number, 0, 0], "rotation": [0, 0, 0], "scale": [4.4, 1.8, 1.5]}
        item["annotations"] = [{"id": 0, "type": "cuboid_3d", "label_id": 0, "attributes": {}, **box}]
    path = root / "task" / "annotations" / "default.json"
    path.parent.mkdir()
    path.write_text(json.dumps({"categories": {"label": {"labels": [{"name": "Car"}]}}, "items": items}))
    return root


STEMS = ("000005", "000006", "000007")


@pytest.mark.parametrize(
    "items",
    [
        [{"id": stem, "attr": {"frame": row}} for row, stem in enumerate(STEMS)],
        [{"id": str(row), "point_cloud": {"path": f"clouds/{stem}.PCD"}} for row, stem in enumerate(STEMS)],
        [{"id": str(int(stem))} for stem in STEMS],
    ],
)
def test_items_stand_on_the_cloud_that_they_name(tmp_path: Path, items: list[dict[str, object]]) -> None:
    data = open_dataset(datumaro(tmp_path, STEMS, items))
    assert [frame.boxes.centre_m[:, 0].tolist() for frame in data] == [[0.0], [1.0], [2.0]]


@pytest.mark.parametrize("names", [("0", "1", "2"), ("000005", "000006", "000008"), ("5", "000005", "7")])
@pytest.mark.parametrize("stems", [STEMS, ("a", "b", "c")])
def test_items_of_no_cloud_are_refused(tmp_path: Path, names: tuple[str, ...], stems: tuple[str, ...]) -> None:
    data = open_dataset(datumaro(tmp_path, stems, [{"id": name} for name in names]))
    with pytest.raises(DatasetError, match=r"default\.json: expected boxes of the clouds"):
        data[0].boxes  # noqa: B018


def test_supervisely_labels_of_no_cloud_are_refused(tmp_path: Path) -> None:
    clouds(tmp_path / "ds0" / "pointcloud", ("a", "b"))
    (tmp_path / "ds0" / "ann").mkdir()
    (tmp_path / "ds0" / "ann" / "b.json").write_text(json.dumps(SUPERVISELY))
    with pytest.raises(DatasetError, match=r"such as a\.pcd\.json, found b\.json"):
        open_dataset(tmp_path)


def test_two_clouds_of_one_name_are_refused(tmp_path: Path) -> None:
    root = datumaro(tmp_path, STEMS, [{"id": "000005"}])
    clouds(root / "task" / "point_clouds" / "more", ("000005",))
    with pytest.raises(DatasetError, match="clouds of different names"):
        open_dataset(root)
