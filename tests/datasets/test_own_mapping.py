"""Own folders: a mapping renames their classes, and the doctor's advice can be followed there."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from street import street

from farfield.datasets import open_dataset
from farfield.datasets.folder import write_boxes
from farfield.errors import ConfigError
from farfield.frame import Boxes
from farfield.inspection.doctor import examine

HEADER = "frame,label,x,y,z,l,w,h,yaw_rad\n"
MAPPING = "classes: {Auto: vehicle, LKW: large_vehicle}\n"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    folder = tmp_path / "own"
    folder.mkdir()
    for stem in "ab":
        np.save(folder / f"{stem}.npy", np.ones((5, 4), np.float32))
    (folder / "labels.csv").write_text(HEADER + "a,Auto,10,1,-1,4,2,1.5,0\na,LKW,12,1,-1,9,2.5,3,0\n")
    car = {"centre_m": np.ones((1, 3)), "size_m": np.ones((1, 3)), "yaw_rad": np.zeros(1)}
    write_boxes(folder / "b.json", Boxes(**car, label=["Auto"]))
    return folder


@pytest.mark.parametrize("place", ["own/mapping.yaml", "elsewhere.yaml"])
def test_a_mapping_renames_classes(own: Path, place: str) -> None:
    before = open_dataset(own)
    assert before[0].boxes.label.tolist() == ["Auto", "LKW"]
    given = before.fingerprint()
    (own.parent / place).write_text(MAPPING)
    data = open_dataset(own) if place.startswith("own") else open_dataset(own, mapping=own.parent / place)
    assert data.name == "folder"
    for opened in (data, pickle.loads(pickle.dumps(data))):
        assert opened[0].boxes.label.tolist() == ["vehicle", "large_vehicle"]
        assert opened[1].boxes.label.tolist() == ["vehicle"]
        assert opened.annotation(0).original_label == ("Auto", "LKW")
    assert data.fingerprint() != given
    assert not [finding for finding in examine(data).findings if finding.topic == "class names"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("class: {Auto: vehicle}\n", "class"),
        ("classes: [Auto]\n", "classes"),
        ("classes: {Auto: ''}\n", "Auto"),
        ("labels: {yaw_scale: -1}\n", "labels"),
        ("classes: {Auto\n", "line"),
    ],
)
def test_a_wrong_mapping_is_named(own: Path, text: str, words: str) -> None:
    (own / "mapping.yaml").write_text(text)
    with pytest.raises(ConfigError, match=rf"mapping\.yaml.*{words}"):
        open_dataset(own)


def test_the_doctor_names_the_mapping_of_the_folder(own: Path) -> None:
    (finding,) = [finding for finding in examine(open_dataset(own)).findings if finding.topic == "class names"]
    advice = "{classes: {Auto: vehicle}} into mapping.yaml"
    assert advice in finding.fix
    (own / "mapping.yaml").write_text("classes: {Auto: vehicle}")
    assert "'LKW' (1)" in str(examine(open_dataset(own)))


def test_the_doctor_s_advice_fits_an_own_folder(tmp_path: Path, rng: np.random.Generator) -> None:
    """Headings cannot be mapped there: nothing is said of a mapping's ``labels``."""
    folder = tmp_path / "own"
    folder.mkdir()
    for stem in "abc":
        cloud, boxes = street(rng)
        np.save(folder / f"{stem}.npy", np.column_stack([cloud.points_m, cloud.intensity]).astype(np.float32))
        write_boxes(folder / f"{stem}.json", boxes.replace(yaw_rad=-boxes.yaw_rad))
    found = [finding for finding in examine(open_dataset(folder)).findings if finding.topic == "yaw"]
    assert [finding.severity for finding in found] == ["fail"]
    assert found[0].fix == "Change its sign."
