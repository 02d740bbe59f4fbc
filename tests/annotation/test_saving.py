"""Label files written from the annotation: bytes kept, originals kept, other programs noticed."""

import errno
import os
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from edited_drives import ANN, CAR, Drives, opened, schema, state_bytes

from farfield.annotation import saving
from farfield.annotation.edits import add_box, delete_box, set_box
from farfield.annotation.saving import export_labels, save, save_copy, save_in_place, save_place
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


@pytest.mark.parametrize("fault", [errno.EROFS, errno.ENOSPC, errno.EACCES])
def test_where_nothing_can_be_written_beside_saves_go_beside_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: int
) -> None:
    """As root, and on a full disk, os.access says that everything can be."""
    (tmp_path / "data").mkdir()
    with opened(tmp_path / "data") as store:
        assert save_place(store) == tmp_path / "data-edited"
        with monkeypatch.context() as patch:
            patch.setattr("tempfile.TemporaryFile", partial(_refuse_in, tmp_path, fault, tempfile.TemporaryFile))
            target = save_place(store)
            assert target == store.folder / "saved"
            _moved(store, "e1")
            assert len(save_copy(store, ANN, "s1", target).files) == 1
    assert not (tmp_path / "data-edited").exists()


def test_a_journal_that_cannot_be_written_beside_leaves_nothing_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    (tmp_path / "data").mkdir()
    patched = partial(_refuse_in, tmp_path / "data", errno.ENOSPC, tempfile.TemporaryFile)
    monkeypatch.setattr("tempfile.TemporaryFile", patched)
    assert journal_folder(tmp_path / "data").is_relative_to(tmp_path / "home")
    assert not any((tmp_path / "data").iterdir())


def _refuse_in(folder: Path, fault: int, own: Any, *, dir: Path) -> Any:
    if dir.resolve() == folder:
        raise OSError(fault, os.strerror(fault))
    return own(dir=dir)


def test_what_label_files_hold_is_known_over_restarts(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        assert (store.unwritten, store.written) == (0, None)
        _moved(store, "e1")
        _moved(store, "e2", A1)
        assert store.unwritten == 2
    with opened(tmp_path) as store:
        assert (store.unwritten, store.written) == (2, None)
        save_in_place(store, ANN, "s1")
        assert store.written is not None
        assert store.unwritten == 0
        assert (store.written.folder, store.written.format) == ("the data set's label files", "boxes-csv")
        _moved(store, "e3", x_m=11.0)
    with opened(tmp_path) as store:
        assert store.unwritten == 1
        save(store, ANN, "s2", target=None, format="cvat")
        assert store.unwritten == 0
        assert (store.written.folder, store.written.format) == ("labels-cvat", "cvat")  # type: ignore[union-attr]
    with opened(tmp_path) as store:
        assert store.unwritten == 0
        undo(store, ANN, "u1")
        assert store.unwritten == 1


def test_a_save_that_was_interrupted_leaves_its_edits_unwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with opened(tmp_path) as store:
        _moved(store, "e1")
        with monkeypatch.context() as patch:
            patch.setattr(saving, "_write_or_remove", _fails)
            with pytest.raises(OSError, match="no more"):
                save_in_place(store, ANN, "s1")
        assert store.unwritten == 1
    with opened(tmp_path) as store:
        assert store.unwritten == 1


def test_an_edit_during_a_save_is_not_counted_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(tmp_path) as store:
        _moved(store, "e1")
        monkeypatch.setattr(saving, "sync", partial(_moved, store, "e2", A1))
        save_copy(store, ANN, "s1", tmp_path.with_name("copy"))
        assert store.unwritten == 1


def test_a_save_that_comes_again_writes_what_is_there_now_and_the_labels_stay_ours(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        _moved(store, "e1")
        save_in_place(store, ANN, "s1")
        _moved(store, "e2", x_m=12.5)
        save_in_place(store, ANN, "s1")
        assert store.unwritten == 0
    with opened(tmp_path) as store:
        assert store.rows(A0)[0].label.box[0] == 12.5
    assert b"a,0000,car,12.5," in (tmp_path / "boxes.csv").read_bytes()
