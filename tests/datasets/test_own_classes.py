"""One's own classes in any layout: kept as they are, mapped by one file for every format, named by the doctor."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from trees import write_kitti, write_kitti_tracking

from farfield.cli import main
from farfield.datasets import Dataset, open_dataset
from farfield.datasets.convert import convert
from farfield.errors import ConfigError, DatasetError
from farfield.evaluation import read_detections
from farfield.files.pcd import write_pcd
from farfield.inspection.doctor import examine

CAR = "1.5 1.8 4.0 2 1.7 20 -1.57"


def kitti(root: Path) -> Path:
    write_kitti(root)
    label = root / "training" / "label_2" / "000007.txt"
    label.write_text("".join(f"{name} 0 0 0 10 10 50 50 {CAR}\n" for name in ("Cone", "Lorry", "Car")))
    return root


def kitti_tracking(root: Path) -> Path:
    write_kitti_tracking(root)
    label = root / "training" / "label_02" / "0003.txt"
    label.write_text("".join(f"0 {n} {name} 0 0 0 10 10 50 50 {CAR}\n" for n, name in enumerate(NAMES)))
    return root


NAMES = ("Cone", "Lorry", "Car")


def clouds(folder: Path) -> Path:
    folder.mkdir(parents=True)
    write_pcd(folder / "a.pcd", {axis: np.float32([1, 2]) for axis in "xyz"})
    return folder


def cvat(root: Path) -> Path:
    clouds(root / "task" / "point_clouds")
    box = {"position": [10, 0, 0], "rotation": [0, 0, 0], "scale": [4.4, 1.8, 1.5]}
    entries = [{"id": n, "type": "cuboid_3d", "label_id": n, "attributes": {}, **box} for n in range(3)]
    labels = [{"name": name} for name in NAMES]
    path = root / "task" / "annotations" / "default.json"
    path.parent.mkdir()
    content = {"categories": {"label": {"labels": labels}}, "items": [{"id": "a", "annotations": entries}]}
    path.write_text(json.dumps(content))
    return root


def sustechpoints(root: Path) -> Path:
    clouds(root / "lidar")
    place = {"position": {"x": 10, "y": 0, "z": 0}, "scale": {"x": 4, "y": 2, "z": 1.5}}
    place["rotation"] = dict.fromkeys("xyz", 0)
    (root / "label").mkdir()
    rows = [{"obj_id": str(n), "obj_type": name, "psr": place} for n, name in enumerate(NAMES)]
    (root / "label" / "a.json").write_text(json.dumps(rows))
    return root


def folder(root: Path) -> Path:
    np.save(root / "a.npy", np.ones((5, 4), np.float32))
    rows = "".join(f"a,{name},10,{n},-1,4,2,1.5,0\n" for n, name in enumerate(NAMES))
    (root / "labels.csv").write_text("frame,label,x,y,z,l,w,h,yaw_rad\n" + rows)
    return root


LAYOUTS = {
    "kitti": kitti,
    "kitti_tracking": kitti_tracking,
    "cvat": cvat,
    "sustechpoints": sustechpoints,
    "folder": folder,
}


@pytest.fixture(params=LAYOUTS)
def own(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    return LAYOUTS[request.param](tmp_path / "data")


def labels_of(data: Dataset) -> list[str]:
    frame = data[0]
    assert data.annotation(0).boxes.label.tolist() == frame.boxes.label.tolist()
    return frame.boxes.label.tolist()


def test_own_names_stay_and_usual_ones_are_mapped(own: Path) -> None:
    data = open_dataset(own)
    assert labels_of(data) == ["Cone", "large_vehicle", "vehicle"]
    (finding,) = [finding for finding in examine(data).findings if finding.topic == "class names"]
    assert "'Cone' (1)" in finding.what
    assert "mapping.yaml" in finding.fix


@pytest.mark.parametrize("place", ["data/mapping.yaml", "elsewhere.yaml"])
def test_a_mapping_works_for_every_reader(own: Path, place: str) -> None:
    name = open_dataset(own).name
    before = open_dataset(own).fingerprint()
    (own.parent / place).write_text("classes: {Cone: animal, Car: Taxi}\n")
    data = open_dataset(own, **({} if place.startswith("data") else {"mapping": own.parent / place}))
    assert data.name == name
    for opened in (data, pickle.loads(pickle.dumps(data))):
        assert labels_of(opened) == ["animal", "large_vehicle", "Taxi"]
        assert opened.annotation(0).original_label == NAMES
        assert opened.has_annotation(0)
    assert data.fingerprint() != before


def test_a_mapping_that_is_none_is_named(own: Path) -> None:
    path = own.parent / "wrong.yaml"
    path.write_text("classes: {Cone: [1]}\n")
    with pytest.raises(ConfigError, match=r"wrong\.yaml.*Cone"):
        open_dataset(own, mapping=path)


@pytest.mark.parametrize("to", ["boxes-csv", "kitti", "cirrus", "openlabel", "sustechpoints", "cvat"])
def test_convert_keeps_own_names(own: Path, tmp_path: Path, to: str) -> None:
    if (to == "kitti" or to == "cirrus" or to == "sustechpoints" or to == "cvat") and "tracking" in open_dataset(
        own
    ).name:
        pytest.skip("needs intensities of every frame")
    convert(open_dataset(own), tmp_path / "out", to=to)
    files = [path for path in (tmp_path / "out").rglob("*") if path.suffix in (".csv", ".txt", ".json")]
    assert any("Cone" in path.read_text() for path in files)
    if to in ("kitti", "cirrus", "sustechpoints", "cvat"):
        assert labels_of(open_dataset(tmp_path / "out")) == ["Cone", "large_vehicle", "vehicle"]


def test_kitti_s_text_keeps_names_apart(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    root = folder(tmp_path / "own")
    table = root / "labels.csv"
    table.write_text(table.read_text().replace("Cone", "traffic cone"))
    convert(open_dataset(root), tmp_path / "out", to="kitti")
    assert labels_of(open_dataset(tmp_path / "out"))[0] == "traffic_cone"
    table.write_text(table.read_text().replace("Lorry", "traffic_cone"))
    with pytest.raises(DatasetError, match=r"'traffic_cone'.*'traffic cone' is called so too"):
        convert(open_dataset(root), tmp_path / "again", to="kitti")


def test_predictions_are_called_as_the_data_s_classes(tmp_path: Path) -> None:
    root = folder(tmp_path)
    (root / "mapping.yaml").write_text("classes: {Cone: animal}\n")
    rows = "".join(f"a,{name},10,{n},-1,4,2,1.5,0,0.9\n" for n, name in enumerate((*NAMES, "Tree")))
    predictions = tmp_path / "predictions" / "p.csv"
    predictions.parent.mkdir()
    predictions.write_text("frame,label,x,y,z,l,w,h,yaw_rad,score\n" + rows)
    detections = read_detections(predictions, root)
    (boxes,) = detections.boxes.values()
    assert boxes.label.tolist() == ["animal", "large_vehicle", "vehicle", "Tree"]
    assert any("Cone is animal" in note for note in detections.notes)


def test_a_mapping_of_a_class_to_itself_keeps_a_usual_name(tmp_path: Path) -> None:
    root = folder(tmp_path)
    (root / "mapping.yaml").write_text("classes: {Car: Car}\n")
    assert labels_of(open_dataset(root)) == ["Cone", "large_vehicle", "Car"]


def test_the_flag_works_in_the_verbs(own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "classes.yaml"
    path.write_text("classes: {Cone: animal}\n")
    assert main(["convert", str(own), str(tmp_path / "o.csv"), "--to", "boxes-csv", "--mapping", str(path)]) == 0
    assert ",animal," in (tmp_path / "o.csv").read_text()
    capsys.readouterr()
