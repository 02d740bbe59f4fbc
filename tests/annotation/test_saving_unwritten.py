"""K-Radar gives each object a track: what is accepted gets one, and a box that cannot be written holds up no other."""

import errno
import os
import shutil
from functools import partial
from pathlib import Path

import pytest
from edited_drives import ANN, opened
from studio.posts import write_kradar

from farfield.annotation.annotator import Annotator
from farfield.annotation.edits import add_box, set_box
from farfield.annotation.errors import JournalError
from farfield.annotation.saving import UnwrittenError, save, unwritten_in
from farfield.annotation.store import Store
from farfield.datasets import open_dataset
from farfield.datasets.edits import CellEdit, box_cell
from farfield.errors import ConfigError
from farfield.studio import samples

BOX = [20.0, 3.0, -0.4, 4.6, 2.1, 1.9, 0.1]


@pytest.fixture
def kradar(tmp_path: Path):
    root = tmp_path / "kradar"
    shutil.copytree(Path(samples.__file__).with_name("kradar"), root)
    with Annotator(open_dataset(root), extent="full", write=True) as annotator:
        yield annotator


def label_file(annotator: Annotator) -> Path:
    return next(iter(annotator.store.files.keys_of))


def test_a_proposal_that_is_accepted_gets_the_next_track_and_is_written(kradar: Annotator) -> None:
    store, key = kradar.store, kradar.store.keys[0]
    tracks = {row.label.track for row in store.rows(key)}
    value = {"label": "Sedan", "box": BOX, "state": "proposed", "source": "detector"}
    store.edit(ANN, "p1", "box.add", partial(add_box, key=key, name="p", value=value))
    row = store.row(key, "p")
    assert row is not None
    assert row.label.track == ""  # nobody stands for it yet
    store.edit(ANN, "a1", "box.set", partial(set_box, key=key, name="p", base=row.version, value={"state": "accepted"}))
    accepted = store.row(key, "p")
    assert accepted is not None
    assert accepted.label.track.isdigit()
    assert accepted.label.track not in tracks
    before = label_file(kradar).read_bytes()
    assert kradar.save(ANN, "s1").files == 1
    assert label_file(kradar).read_bytes().count(b"*") == before.count(b"*") + 1


def test_a_box_that_cannot_be_written_is_named_and_holds_up_no_other_file(kradar: Annotator, tmp_path: Path) -> None:
    store, key = kradar.store, kradar.store.keys[0]
    before = label_file(kradar).read_bytes()
    # as journals before tracks were given have it
    old = {"label": "Sedan", "box": BOX, "state": "edited"}
    store.edit(ANN, "e1", "box.add", lambda _: [CellEdit(box_cell(key, "old"), 0, None, old)])
    with pytest.raises(
        UnwrittenError, match=f"frame {'/'.join(key)}, box old: .*whole number as track of a Sedan"
    ) as raised:
        kradar.save(ANN, "s1")
    assert raised.value.summary.unwritten[0][:2] == (key, "old")
    assert label_file(kradar).read_bytes() == before
    standing = store.row(key, "old")
    assert standing is not None
    store.edit(ANN, "e2", "box.set", partial(set_box, key=key, name="old", base=standing.version, value={"box": BOX}))
    assert kradar.save(ANN, "s2").files == 1  # any change gives it a track


def test_frames_beside_the_one_that_cannot_be_written_are_written(tmp_path: Path) -> None:
    root = write_kradar(tmp_path / "kradar", count=2)
    with Annotator(open_dataset(root), extent="full", out=tmp_path / "saved") as annotator:
        store, (first, second) = annotator.store, annotator.store.keys
        bad = {"label": "Sedan", "box": BOX, "track": "none", "state": "edited"}
        store.edit(ANN, "e1", "box.add", lambda _: [CellEdit(box_cell(first, "bad"), 0, None, bad)])
        value = {"label": "Sedan", "box": BOX}
        store.edit(ANN, "e2", "box.add", partial(add_box, key=second, name="good", value=value))
        with pytest.raises(UnwrittenError, match="box bad"):
            annotator.save(ANN, "s1")
        path = tmp_path / "saved" / store.files.relative(store.files.path_of[second])
        assert b"Sedan" in path.read_bytes()


def test_a_save_onto_a_full_disk_is_said_in_words(kradar: Annotator, monkeypatch: pytest.MonkeyPatch) -> None:
    store, key = kradar.store, kradar.store.keys[0]
    value = {"label": "Sedan", "box": BOX}
    store.edit(ANN, "e1", "box.add", partial(add_box, key=key, name="n", value=value))

    from farfield.annotation import saving

    monkeypatch.setattr(saving, "write_bytes", full)
    with pytest.raises(Exception, match=r"No space left on device.*the journal has all edits"):
        kradar.save(ANN, "s1")


def full(path: Path, data: bytes) -> None:
    del path, data
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def moved(store: Store, metres: float) -> list[CellEdit]:
    key = store.keys[0]
    row = store.rows(key)[0]
    box = [row.label.box[0] + metres, *row.label.box[1:]]
    return list(set_box(store, key, row.label.id, row.version, {"box": box}))


def test_after_a_failed_write_the_annotation_is_what_is_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with opened(tmp_path) as store:
        store.edit(ANN, "e1", "box.set", partial(moved, metres=1.0)).saved.result()
        stored = store.rows(store.keys[0])
        monkeypatch.setattr(os, "write", lambda *_: full(Path(), b""))
        lost = store.edit(ANN, "e2", "box.set", partial(moved, metres=5.0))
        with pytest.raises(JournalError):
            lost.saved.result(10)
        monkeypatch.undo()
        assert store.rows(store.keys[0]) == stored
        with pytest.raises(JournalError):
            store.edit(ANN, "e3", "box.set", partial(moved, metres=7.0))
        assert store.state.seq == 1
    with opened(tmp_path) as again:
        assert again.rows(again.keys[0]) == stored
        again.edit(ANN, "e2", "box.set", partial(moved, metres=5.0)).saved.result()  # sent again, it is taken


def test_labels_written_elsewhere_leave_those_in_place_lacking(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        store.edit(ANN, "e1", "box.set", partial(moved, metres=1.0)).saved.result()
        save(store, ANN, "s1", target=None, format="cvat")
        assert store.unwritten == 0
        assert unwritten_in(store, target=None, format="cvat") == 0
        assert unwritten_in(store, target=None) == 1
        assert unwritten_in(store, target=None, folder="mine") == 1
        save(store, ANN, "s2", target=None)
        assert unwritten_in(store, target=None) == 0
    with opened(tmp_path) as again:
        assert unwritten_in(again, target=None) == 0
        assert unwritten_in(again, target=None, folder="mine") == 1


@pytest.mark.parametrize("name", ["original", "Original", "original/mine", "lock", "classes.yaml", "edits.jsonl"])
def test_a_folder_that_the_annotation_itself_needs_gets_no_labels(tmp_path: Path, name: str) -> None:
    with opened(tmp_path) as store:
        store.edit(ANN, "e1", "box.set", partial(moved, metres=1.0)).saved.result()
        with pytest.raises(ConfigError, match=f"{name}.*Choose another"):
            save(store, ANN, "s1", target=None, folder=name)
        assert not (store.folder / "original").exists()
        assert save(store, ANN, "s2", target=None, folder="mine").files == 1
