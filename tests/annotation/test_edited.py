"""A data set seen with its edits on top: the same as after saving, and any state before."""

import pickle
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edited_drives import ANN

from farfield.annotation.edits import add_box, delete_box, set_box
from farfield.annotation.notes import declare_extent
from farfield.annotation.saving import save_in_place
from farfield.annotation.schema import schema_of
from farfield.annotation.store import Store, undo
from farfield.datasets import maps
from farfield.datasets.edits import Edited, journal_folder
from farfield.datasets.kradar.label_format import KRadarLabelFormat
from farfield.datasets.kradar.reader import KRadar
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Annotation
from farfield.vocabulary.classes import SMALL_KINDS, VEHICLE_KINDS

HEADER = "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)={0}_{0}_{0}_{0}_{0}, timestamp=1643292946.{0}00000\n"
OBJECTS = (
    "*, R, 2, Bus or Truck, 43.07, -7.63, 0.6, 190.50, 4.79, 1.36, 1.70\n"
    "*, L, 3, Sedan, 20.10, 5.00, -0.1, -2.5, 2.1, 0.9, 0.8\n"
    "*, R, 4, Pedestrian, 9.00, 1.00, -0.1, 0, 0.4, 0.3, 0.9\n"
)
KEY = ("1", "00001_00001")
NEW = {"label": "Sedan", "box": [15.0, 1.0, 0.0, 4.5, 1.9, 1.6, 0.3], "track": "9"}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "data" / "KRadar_revised_visibility" / "1"
    folder.mkdir(parents=True)
    for number in range(1, 4):
        text = HEADER.format(f"{number:05d}") + ("" if number == 3 else OBJECTS)
        (folder / f"{number:05d}_{number:05d}.txt").write_text(text)
    return tmp_path / "data"


def _opened(root: Path) -> Store:
    data = KRadar(root)
    attributes: Any = {"availability": ("R", "L", "L1")}
    schema = schema_of(VEHICLE_KINDS | SMALL_KINDS, attributes)
    return Store(data, KRadarLabelFormat(data), journal_folder(root), schema)


def _edit(store: Store) -> None:
    """Move one box, remove one, add one; propose one, and one in a frame that had none."""
    declare_extent(store, ANN, "x", "full")
    row = store.row(KEY, "0")
    assert row is not None
    value = {"box": [44.0, *row.label.box[1:]], "attributes": {"availability": "L1"}}
    store.edit(ANN, "e1", "box.set", partial(set_box, key=KEY, name="0", base=0, value=value))
    store.edit(ANN, "e2", "box.delete", partial(delete_box, key=KEY, name="1", base=0))
    store.edit(ANN, "e3", "box.add", partial(add_box, key=KEY, name="n1", value=NEW))
    proposal = NEW | {"state": "proposed", "source": "detector"}
    store.edit(ANN, "e4", "box.add", partial(add_box, key=KEY, name="n2", value=proposal))
    store.edit(ANN, "e5", "box.add", partial(add_box, key=("1", "00003_00003"), name="n3", value=NEW))


def _same(first: Annotation | None, second: Annotation | None) -> None:
    assert first is not None
    assert second is not None
    for name in ("centre_m", "size_m", "yaw_rad"):
        assert np.allclose(getattr(first.boxes, name), getattr(second.boxes, name), rtol=0, atol=1e-9)
    assert first.boxes.label.tolist() == second.boxes.label.tolist()
    assert first.boxes.track_id.tolist() == second.boxes.track_id.tolist()  # type: ignore[union-attr]
    assert list(first.visibility or ()) == list(second.visibility or ())
    assert list(first.original_label or ()) == list(second.original_label or ())


def test_the_same_as_after_saving(root: Path) -> None:
    with _opened(root) as store:
        _edit(store)
    seen = KRadar(root).mapped(Edited(root))
    before = [seen.annotation(index) for index in range(3)]
    assert before[0] is not None
    assert before[0].original_label == ["Bus or Truck", "Pedestrian", "Sedan"]
    assert list(before[0].visibility or ()) == ["L1", "R", "R"]
    assert before[0].boxes.track_id.tolist() == [2, 4, 9]  # type: ignore[union-attr]
    assert before[0].version == "v2.1"
    assert seen[2].has_annotation
    with _opened(root) as store:
        save_in_place(store, ANN, "s1")
    saved, again = KRadar(root), KRadar(root).mapped(Edited(root))
    for index in range(3):
        _same(before[index], saved.annotation(index))
        _same(again.annotation(index), saved.annotation(index))
        _same(again[index].annotation, saved.annotation(index))


def test_any_state_before_has_a_number(root: Path) -> None:
    with _opened(root) as store:
        _edit(store)
        undo(store, ANN, "u1")
        save_in_place(store, ANN, "s1")
        undo(store, ANN, "u2")
        undo(store, ANN, "u3")
    journal = journal_folder(root)
    counts = []
    for upto in range(12):
        found = KRadar(root).mapped(Edited(journal, upto)).annotation(0)
        assert found is not None
        counts.append(len(found))
    assert counts == [3, 3, 3, 2, 3, 3, 3, 3, 3, 3, 3, 2]
    assert Edited(journal).upto == 11
    with pytest.raises(ConfigError, match="12 edits or more, got 11"):
        Edited(journal, 12)


def test_made_again_from_its_settings_and_pickled(root: Path) -> None:
    with _opened(root) as store:
        _edit(store)
    seen = KRadar(root).mapped(Edited(root))
    assert seen.recipe["maps"] == [{"name": "edited", "settings": {"edits": str(root), "upto": 6}}]
    (described,) = seen.recipe["maps"]
    again = maps.make(described["name"], described["settings"])
    assert again == Edited(root, 6)
    assert isinstance(again, maps.FrameMap)
    copy = pickle.loads(pickle.dumps(seen))
    _same(copy.annotation(0), seen.annotation(0))
    assert again.fits(KRadar(root))  # type: ignore[attr-defined]
    assert not again.fits(KRadar(root).turned(180))  # type: ignore[attr-defined]
    before = seen.fingerprint()
    with _opened(root) as store:
        undo(store, ANN, "u1")
    assert seen.fingerprint() == before
    assert KRadar(root).mapped(Edited(root)).fingerprint() != before
    assert KRadar(root).mapped(Edited(root, 6)).fingerprint() == before


def test_a_file_that_was_not_the_one_edited(root: Path) -> None:
    with _opened(root) as store:
        _edit(store)
    file = root / "KRadar_revised_visibility" / "1" / "00001_00001.txt"
    file.write_text(file.read_text().replace("43.07", "43.17"))
    seen = KRadar(root).mapped(Edited(root))
    with pytest.raises(DatasetError, match=r"a box that was edited \(at 43.07, -7.63, 0.60\)"):
        seen.annotation(0)
    assert len(seen.annotation(1) or ()) == 3


def test_frames_moved_before_are_refused(root: Path) -> None:
    with _opened(root) as store:
        _edit(store)
    with pytest.raises(DatasetError, match="before those that move frames"):
        KRadar(root).turned(180).mapped(Edited(root)).annotation(0)
    turned = KRadar(root).mapped(Edited(root)).turned(180).annotation(0)
    assert turned is not None
    assert turned.boxes.centre_m[2, 0] == pytest.approx(-15.0)


def test_a_twin_does_not_take_its_models_place(root: Path) -> None:
    with _opened(root) as store:
        declare_extent(store, ANN, "x", "full")
        row = store.row(KEY, "1")
        assert row is not None
        value = {"label": "Sedan", "box": list(row.label.box), "track": "7"}
        plan = partial(add_box, key=KEY, name="n1", value=value)
        store.edit(ANN, "e1", "box.add", plan).saved.result()
        found = KRadar(root).mapped(Edited(root)).annotation(0)
        assert found is not None
        assert found.boxes.track_id.tolist() == [2, 3, 4, 7]  # type: ignore[union-attr]
        save_in_place(store, ANN, "s1")
        found = KRadar(root).mapped(Edited(root)).annotation(0)
        assert found is not None
        assert sorted(found.boxes.track_id.tolist()) == [2, 3, 4, 7]  # type: ignore[union-attr]


def test_no_journal(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="farfield annotate"):
        Edited(tmp_path)
