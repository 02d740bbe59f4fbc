"""Which classes are offered, what is said of others, and which sizes count as usual."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from farfield.annotation.annotator import LabelSize, offered_classes
from farfield.annotation.edits import add_box
from farfield.annotation.errors import RefusedError
from farfield.annotation.store import Author
from farfield.datasets import open_dataset
from farfield.errors import ConfigError
from farfield.studio.options import StudioSettings
from farfield.studio.showing.annotations import AnnotationService
from farfield.studio.showing.opened import OpenedDataset

TANK = (7.0, 3.0, 2.5)


def sweeps(folder: Path, frames: int, tanks: int = 1) -> Path:
    folder.mkdir()
    rng = np.random.default_rng(0)
    for number in range(frames):
        np.save(folder / f"{number:04d}.npy", rng.uniform(-9, 9, (50, 4)).astype(np.float32).clip(0, 1))
        boxes = [
            {"label": "tank", "centre_m": [10 + 9 * row, 2, 0], "size_m": list(TANK), "yaw_rad": 0.0}
            for row in range(tanks)
        ]
        (folder / f"{number:04d}.json").write_text(json.dumps({"boxes": boxes}))
    return folder


def annotated(folder: Path, **settings) -> AnnotationService:
    return AnnotationService(
        OpenedDataset(open_dataset(folder)), StudioSettings(mode="annotate", extent="full", **settings)
    )


def test_classes_that_boxes_bear_are_offered_with_their_size(tmp_path: Path):
    known = annotated(sweeps(tmp_path / "a", 2))
    try:
        spec = next(spec for spec in known.classes if spec.name == "tank")
        assert spec.size == TANK
        assert {"vehicle", "pedestrian"} < {spec.name for spec in known.classes}
        key = known.store.keys[0]
        value = {"label": "tank", "box": [20.0, 0, 0, *TANK, 0], "state": "edited"}
        known.store.edit(
            Author("kim"), "e1", "box.add", partial(add_box, key=key, name="n", value=value)
        ).saved.result()
        assert [row.class_name for row in known.rows(0)] == ["tank", "tank"]
    finally:
        known.close()


def test_a_class_that_nobody_offers_is_refused_with_what_to_do(tmp_path: Path):
    known = annotated(sweeps(tmp_path / "a", 1), classes=("car:4.5,1.9,1.7",))
    try:
        value = {"label": "ship", "box": [20.0, 0, 0, *TANK, 0], "state": "edited"}
        plan = partial(add_box, key=known.store.keys[0], name="n", value=value)
        with pytest.raises(RefusedError, match=r"car, tank.*ship.*classes\.yaml.*--classes"):
            known.store.edit(Author("kim"), "e1", "box.add", plan)
    finally:
        known.close()


def test_kradar_speaks_its_own_words_unless_its_boxes_speak_cirrus():
    assert "Sedan" in offered_classes("kradar", (), {"Sedan": LabelSize((4.6, 2.2, 1.9), 3)})
    assert "Sedan" in offered_classes("kradar", (), {})
    cirrus = offered_classes("kradar", (), {"vehicle": LabelSize((4.6, 2.2, 1.9), 3)})
    assert "Sedan" not in cirrus
    assert "vehicle" in cirrus
    both = offered_classes("kradar", (), {"Sedan": LabelSize((4.6, 2.2, 1.9), 3), "tank": LabelSize(TANK, 1)})
    assert both["tank"].size_m == TANK
    assert set(offered_classes("kradar", ("car:4,2,1",), {"Sedan": LabelSize((4.6, 2.2, 1.9), 3)})) == {"car", "Sedan"}


def test_the_usual_size_is_the_data_sets_own_else_published_else_ours():
    many = offered_classes("kitti", (), {"Car": LabelSize((4.1, 1.7, 1.6), 57)})["Car"]
    assert many.size_m == (4.1, 1.7, 1.6)
    assert many.source == "median of 57 boxes of the data set"
    few = offered_classes("kitti", (), {"Car": LabelSize((4.1, 1.7, 1.6), 4)})["Car"]
    assert few.size_m == pytest.approx((3.88, 1.63, 1.53))
    assert "KITTI's training labels" in few.source
    assert offered_classes("kitti", (), {})["Tram"].size_m[0] > 15
    assert offered_classes("kitti_raw", (), {})["vehicle"].size_m == few.size_m
    assert "K-Radar" in offered_classes("kradar", (), {})["Sedan"].source
    assert "Farfield" in offered_classes("cirrus", (), {})["vehicle"].source
    ours = offered_classes("kitti", ("Car:5,2,1",), {"Car": LabelSize((4.1, 1.7, 1.6), 57)})["Car"]
    assert ours.size_m == (5, 2, 1)  # what a person says stands
    assert "--classes" in ours.source


def test_sizes_that_count_as_usual_are_those_of_the_data_set(tmp_path: Path):
    """Among 200 boxes of one size, one a quarter longer is found; among fewer, up to twice the preset is let stand."""
    folder = sweeps(tmp_path / "a", 11, tanks=20)
    longer = [TANK[0] * 1.25, *TANK[1:]]
    for frames, expected in ((11, True), (9, False)):
        for path in sorted(folder.glob("*.json"))[frames:]:
            path.unlink()
        known = annotated(folder, edits=tmp_path / f"edits{frames}")
        try:
            key = known.store.keys[0]
            value = {"label": "tank", "box": [20.0, -20, 0, *longer, 0], "state": "edited"}
            plan = partial(add_box, key=key, name="n", value=value)
            known.store.edit(Author("kim"), "e1", "box.add", plan).saved.result()
            assert any(row.check == "size" and row.box == "n" for row in known.annotator.check(0)) is expected
        finally:
            known.close()


def test_label_files_that_are_not_edited_are_not_promised_to_be_written(tmp_path: Path):
    """A folder of one's own: its boxes are begun with, and saved in another format."""
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "0000.bin").write_bytes(np.ones((9, 4), "<f4").tobytes())
    row = {"label": "vehicle", "centre_m": [10.0, 2.0, -1.0], "size_m": [4.6, 1.9, 1.5], "yaw_rad": 0.5}
    text = json.dumps({"boxes": [row]})
    (folder / "0000.json").write_text(text)
    with pytest.raises(ConfigError, match=r"--write.*Leave it out.*--to"):
        annotated(folder, write=True)
    known = annotated(folder)
    try:
        assert [row.box[:2] for row in known.rows(0)] == [(10.0, 2.0)]
    finally:
        known.close()
    assert (folder / "0000.json").read_text() == text
