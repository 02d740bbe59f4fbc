"""Label files written from the annotation: bytes kept, originals kept, other programs noticed."""

from functools import partial
from pathlib import Path
from typing import Any

import pytest
from edited_drives import ANN, CAR, Drives, opened, schema, state_bytes

from farfield.annotation import saving
from farfield.annotation.edits import add_box, delete_box, set_box
from farfield.annotation.saving import export_labels, save_copy, save_in_place, save_place
from farfield.annotation.store import Store, undo
from farfield.datasets.edits import journal_folder
from farfield.datasets.labels import CsvLabels
from farfield.errors import ConfigError, DatasetError

A0, A1 = ("a", "0000"), ("a", "0001")


def _moved(store: Store, id: str, key: Any = A0, x_m: float = 10.5) -> None:
    row = store.row(key, "0")
    assert row is not None
    value = {"box": [x_m, *row.label.box[1:]]}
    store.edit(ANN, id, "box.set", partial(set_box, key=key, name="0", base=row.version, value=value))


def test_one_box_moved_changes_one_line(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        before = (tmp_path / "boxes.csv").read_bytes()
        _moved(store, "e1")
        saved = save_in_place(store, ANN, "s1")
        assert saved.files == (tmp_path / "boxes.csv",)
        assert saved.edit.saved.result(0).op == "save"
        after = (tmp_path / "boxes.csv").read_bytes()
        lines = list(zip(before.splitlines(), after.splitlines(), strict=True))
        assert [new for old, new in lines if old != new] == [b"a,0000,car,10.5,2,0,4.5,1.9,1.6,0.25,,3"]
        assert (journal_folder(tmp_path) / "original" / "boxes.csv").read_bytes() == before
        assert save_in_place(store, ANN, "s2").files == ()


def test_taken_back_and_saved_the_file_is_as_it_was(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        before = (tmp_path / "boxes.csv").read_bytes()
        _moved(store, "e1")
        store.edit(ANN, "e2", "box.delete", partial(delete_box, key=A0, name="1", base=0))
        value = {"label": "bus", "box": CAR}
        store.edit(ANN, "e3", "box.add", partial(add_box, key=A0, name="n1", value=value))
        save_in_place(store, ANN, "s1")
        edited = state_bytes(store)
    with opened(tmp_path) as store:
        assert state_bytes(store) == edited
        for number in range(3):
            undo(store, ANN, f"u{number}")
        save_in_place(store, ANN, "s2")
    assert (tmp_path / "boxes.csv").read_bytes() == before
    with opened(tmp_path) as store:
        assert save_in_place(store, ANN, "s3").files == ()


def test_a_save_that_was_interrupted_is_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(tmp_path) as store:
        _moved(store, "e1")
        state = state_bytes(store)
        with monkeypatch.context() as patch:
            patch.setattr(saving, "_write_or_remove", _fails)
            with pytest.raises(OSError, match="no more"):
                save_in_place(store, ANN, "s1")
    with opened(tmp_path) as store:
        assert state_bytes(store) == state
        assert len(save_in_place(store, ANN, "s2").files) == 1
    with opened(tmp_path) as store:
        assert state_bytes(store) == state


def _fails(path: Path, data: bytes) -> None:
    raise OSError("no more")


def test_another_program_is_noticed_after_a_save(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        _moved(store, "e1")
        save_in_place(store, ANN, "s1")
    file = tmp_path / "boxes.csv"
    saved = file.read_bytes()
    file.write_bytes(saved.replace(b"a,0001,car,11", b"a,0001,car,12"))
    with opened(tmp_path) as store, pytest.raises(DatasetError, match="another program"):
        store.rows(A0)
    file.write_bytes(saved)
    (journal_folder(tmp_path) / "original" / "boxes.csv").write_bytes(b"other")
    with opened(tmp_path) as store, pytest.raises(DatasetError, match="before the first edit"):
        store.rows(A0)


def test_a_copy_leaves_the_labels_alone(tmp_path: Path) -> None:
    root, target = tmp_path / "data", tmp_path / "mine"
    with opened(root) as store:
        before = (root / "boxes.csv").read_bytes()
        assert save_place(store) == tmp_path / "data-edited"
        _moved(store, "e1")
        assert save_copy(store, ANN, "s1", target).files == (target / "boxes.csv",)
        first = (target / "boxes.csv").read_bytes()
        assert first.count(b"10.5,") == 1
        assert (root / "boxes.csv").read_bytes() == before
        assert save_copy(store, ANN, "s2", target).files == ()
        _moved(store, "e2", A1, 3.25)
        assert len(save_copy(store, ANN, "s3", target).files) == 1
        with pytest.raises(ConfigError, match="holds something else"):
            save_copy(store, ANN, "s4", root)
        assert (root / "boxes.csv").read_bytes() == before


def test_new_labels_are_written_in_their_place(tmp_path: Path) -> None:
    files = CsvLabels(tmp_path / "boxes.csv")
    data = Drives(tmp_path)
    with Store(data, files, journal_folder(tmp_path), schema()) as store:
        assert save_place(store) is None
        value = {"label": "car", "box": CAR, "track": "4"}
        store.edit(ANN, "e1", "box.add", partial(add_box, key=A1, name="n1", value=value))
        proposal = {"label": "car", "box": CAR, "state": "proposed"}
        store.edit(ANN, "e2", "box.add", partial(add_box, key=A1, name="n2", value=proposal))
        save_in_place(store, ANN, "s1")
        (label,) = files.parse(files.file.read_bytes(), files.file, [A1])[A1]
        assert (label.box, label.track) == (tuple(CAR), "4")
        assert save_place(store) is None
    with Store(data, files, journal_folder(tmp_path), schema()) as store:
        assert [row.label.id for row in store.rows(A1)] == ["n1", "n2"]
        undo(store, ANN, "u1")
        undo(store, ANN, "u2")
        save_in_place(store, ANN, "s2")
        assert not files.file.exists()


def test_export_in_another_format(tmp_path: Path) -> None:
    with opened(tmp_path / "data") as store:
        _moved(store, "e1")
        (file,) = export_labels(store, CsvLabels(tmp_path / "out" / "all.csv"), store.keys)
        lines = file.read_text().splitlines()
        assert len(lines) == 42
        assert lines[1] == "a,0000,car,10.5,2.0,0.0,4.5,1.9,1.6,0.25,,3"
