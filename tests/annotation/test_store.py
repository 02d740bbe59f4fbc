"""Boxes edited, versions, conflicts, undo and redo over restarts."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from edited_drives import ANN, CAR, EVE, opened, state_bytes

from farfield.annotation.edits import add_box, delete_box, set_box
from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.store import Author, EditResult, Store, keep, redo, undo
from farfield.datasets.edits import box_cell
from farfield.errors import DatasetError

A0, A1, B0 = ("a", "0000"), ("a", "0001"), ("b", "0000")


def _set(
    store: Store, id: str, key: Any, name: str, base: int, value: Any, by: Author = ANN, **more: Any
) -> EditResult:
    return store.edit(by, id, "box.set", partial(set_box, key=key, name=name, base=base, value=value), **more)


def _add(store: Store, id: str, key: Any, name: str, value: Any, by: Author = ANN, **more: Any) -> EditResult:
    return store.edit(by, id, "box.add", partial(add_box, key=key, name=name, value=value), **more)


def _delete(store: Store, id: str, key: Any, name: str, base: int, by: Author = ANN) -> EditResult:
    return store.edit(by, id, "box.delete", partial(delete_box, key=key, name=name, base=base))


def _box(store: Store, key: Any = A0, name: str = "0") -> Any:
    row = store.row(key, name)
    return None if row is None else row.label.box


def test_rows_are_the_files_with_the_edits_on_top(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        assert [(row.label.id, row.version) for row in store.rows(A0)] == [("0", 0), ("1", 0)]
        _delete(store, "e1", A0, "0", 0)
        _add(store, "e2", A0, "n1", {"label": "car", "box": CAR, "track": "8"})
        done = _set(store, "e3", A0, "1", 0, {"label": "bus"})
        assert done.saved.result(10).seq == 3
        rows = store.rows(A0)
        assert [(row.label.id, row.version, row.by) for row in rows] == [("1", 3, "ann"), ("n1", 2, "ann")]
        assert rows[0].label.label == "bus"
        assert rows[1].label == replace(rows[1].label, track="8", state="edited")
        assert store.rows(B0)[0].label.id == "0"
        before = state_bytes(store)
    with opened(tmp_path) as store:
        assert state_bytes(store) == before
        assert store.rows(A0)[0].version == 3


def test_an_edit_from_an_old_version_is_a_conflict(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        first = _set(store, "e1", A0, "0", 0, {"box": CAR}, by=EVE).record.seq
        with pytest.raises(ConflictError, match="changed by eve") as caught:
            _set(store, "e2", A0, "0", 0, {"label": "bus"})
        assert (caught.value.version, caught.value.present["box"]) == (first, CAR)
        assert store.row(A0, "0").label.label == "car"  # type: ignore[union-attr]
        _delete(store, "e3", A0, "0", first, by=EVE)
        with pytest.raises(ConflictError, match="removed by eve"):
            _set(store, "e4", A0, "0", first, {"label": "bus"})
        assert len(store.journal) == 2


def test_a_message_sent_again_is_recognised_also_after_a_restart(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        first = _set(store, "e1", A0, "0", 0, {"label": "bus"})
        again = _set(store, "e1", A0, "0", 0, {"label": "bus"})
        assert (again.record, again.repeated) == (first.record, True)
    with opened(tmp_path) as store:
        again = _set(store, "e1", A0, "0", 0, {"label": "bus"})
        assert (again.record, again.repeated, again.saved.result(0)) == (first.record, True, first.record)
        assert len(store.journal) == 1
        with pytest.raises(RefusedError, match="used before"):
            _delete(store, "e1", A0, "0", 1)
        assert undo(store, ANN, "u1").record.seq == 2
        assert undo(store, ANN, "u1").repeated


@pytest.mark.parametrize(
    ("value", "code"),
    [
        ({"box": [0, 0, 0, 4, 2, 0, 0]}, "size"),
        ({"box": [0, 0, 0, 61, 2, 1, 0]}, "size"),
        ({"box": [0, 1000.5, 0, 4, 2, 1, 0]}, "place"),
        ({"box": [0, 0, float("nan"), 4, 2, 1, 0]}, "box"),
        ({"box": [0, 0, 0]}, "box"),
        ({"box": ["0"] * 7}, "box"),
        ({"label": "tank"}, "class"),
        ({"state": "good"}, "state"),
        ({"source": "guess"}, "source"),
        ({"track": 7}, "track"),
        ({"attributes": {"colour": "red"}}, "attribute"),
        ({"attributes": {"moving": "perhaps"}}, "attribute"),
        ({"attributes": {"note": 3.0}}, "attribute"),
        ({"speed": 3}, "value"),
        ({"score": float("nan")}, "score"),
        ({"score": "high"}, "score"),
        ({"attributes": ["moving"]}, "attribute"),
        ({"proposal": [1.0, 2.0]}, "box"),
        ({"attributes": {"colour": None}}, "attribute"),
        ({"attributes": {"note": None}}, "attribute"),
        ({"attributes": {"count": 10**20}}, "attribute"),
        ({"attributes": {"count": -(10**400)}}, "attribute"),
        ({"attributes": {"moving": 1}}, "attribute"),
        ({"score": 10**400}, "score"),
        ({"box": [10**400, 0, 0, 4, 2, 1, 0]}, "box"),
    ],
)
def test_what_is_not_possible_is_refused(tmp_path: Path, value: Any, code: str) -> None:
    with opened(tmp_path) as store:
        before = state_bytes(store)
        for edit in (partial(_set, base=0), _add):
            name = "0" if edit is not _add else "n1"
            with pytest.raises(RefusedError) as caught:
                edit(store, f"e-{name}", A0, name, value={"label": "car", "box": CAR} | value)
            assert caught.value.code == code
        assert state_bytes(store) == before
        assert len(store.journal) == 0


def test_names_and_frames_that_there_are_not(tmp_path: Path) -> None:
    value = {"label": "car", "box": CAR}
    with opened(tmp_path) as store:
        for name in ("7", "", "n" * 65):
            with pytest.raises(RefusedError, match="name of a new box"):
                _add(store, "e", A0, name, value)
        _add(store, "e", A0, "n1", value)
        with pytest.raises(RefusedError, match="already"):
            _add(store, "f", A0, "n1", value)
        with pytest.raises(RefusedError, match="no box"):
            _set(store, "g", A0, "99", 0, value)
        for edit in (partial(_set, base=0), _add):
            with pytest.raises(RefusedError, match="no frame"):
                edit(store, "h", ("c", "0000"), "n2", value=value)


def test_nothing_is_annotated_before_the_extent_is_declared(tmp_path: Path) -> None:
    with opened(tmp_path, extent=None) as store, pytest.raises(RefusedError, match="nobody has said"):
        _set(store, "e1", A0, "0", 0, {"label": "bus"})


def test_undo_and_redo_over_frames_and_a_restart(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        begin = state_bytes(store)
        _set(store, "e1", A0, "0", 0, {"box": CAR})
        _delete(store, "e2", B0, "0", 0)
        _add(store, "e3", A1, "n1", {"label": "car", "box": CAR})
        end = state_bytes(store)
    with opened(tmp_path) as store:
        assert undo(store, ANN, "u1").record.changes[0].cell == box_cell(A1, "n1")
        undo(store, ANN, "u2")
    with opened(tmp_path) as store:
        undo(store, ANN, "u3")
        assert state_bytes(store) == begin
        assert store.history.counts("ann") == (0, 3)
        with pytest.raises(RefusedError, match="nothing to be taken back"):
            undo(store, ANN, "u4")
        for number in range(3):
            redo(store, ANN, f"r{number}")
        assert state_bytes(store) == end
        with pytest.raises(RefusedError, match="nothing to be done again"):
            redo(store, ANN, "r4")
        undo(store, ANN, "u5")
        _set(store, "e4", A1, "0", 0, {"box": CAR})
        with pytest.raises(RefusedError, match="nothing to be done again"):
            redo(store, ANN, "r5")


def test_a_group_is_taken_back_at_once(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        begin = state_bytes(store)
        _set(store, "e1", A0, "1", 0, {"box": CAR})
        middle = state_bytes(store)
        for number in range(5):
            _set(store, f"g{number}", ("a", f"{number:04d}"), "0", 0, {"box": CAR}, group="g")
        undo(store, ANN, "u1")
        assert state_bytes(store) == middle
        undo(store, ANN, "u2")
        assert state_bytes(store) == begin
        redo(store, ANN, "r1")
        redo(store, ANN, "r2")
        assert [_box(store, ("a", f"{number:04d}")) for number in range(5)] == [tuple(CAR)] * 5


def test_undo_is_the_annotators_own(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        _set(store, "e1", A0, "0", 0, {"box": CAR})
        mine = state_bytes(store)
        _set(store, "e2", A1, "0", 0, {"box": CAR}, by=EVE)
        undo(store, EVE, "u1")
        assert state_bytes(store) == mine
        redo(store, EVE, "r1")
        undo(store, ANN, "u2", everybody=True)
        assert state_bytes(store) == mine
        undo(store, ANN, "u3")
        assert store.history.counts("ann") == (0, 1)


def test_undo_of_what_somebody_else_went_on_from(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        _set(store, "e0", A1, "0", 0, {"box": CAR})
        version = _set(store, "e1", A0, "0", 0, {"box": CAR}).record.seq
        _set(store, "e2", A0, "0", version, {"label": "bus"}, by=EVE)
        with pytest.raises(ConflictError, match="changed by eve"):
            undo(store, ANN, "u1")
        keep(store, ANN, "k1")
        assert undo(store, ANN, "u2").record.changes[0].cell == box_cell(A1, "0")
        assert store.row(A0, "0").label.label == "bus"  # type: ignore[union-attr]
    with opened(tmp_path) as store:
        assert store.history.counts("ann") == (0, 1)
        with pytest.raises(RefusedError, match="nothing"):
            undo(store, ANN, "u3")


def test_undo_by_force(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        begin = state_bytes(store)
        version = _set(store, "e1", A0, "0", 0, {"box": CAR}).record.seq
        _set(store, "e2", A0, "0", version, {"label": "bus"}, by=EVE)
        undo(store, ANN, "u1", force=True)
        assert state_bytes(store) == begin
        with pytest.raises(ConflictError, match="changed by ann"):
            undo(store, EVE, "u2")


def test_a_proposal_is_rejected_and_kept(tmp_path: Path) -> None:
    value = {"label": "car", "box": CAR, "state": "proposed", "source": "detector", "score": 0.5, "proposal": CAR}
    with opened(tmp_path) as store:
        first = _add(store, "e1", A0, "n1", value).record.seq
        row = store.row(A0, "n1")
        assert row is not None
        assert (row.label.keyframe, row.label.score, row.proposal) == (False, 0.5, tuple(CAR))
        moved = _set(store, "e2", A0, "n1", first, {"box": [11.0, *CAR[1:]]}).record.seq
        row = store.row(A0, "n1")
        assert row is not None
        assert (row.label.state, row.proposal) == ("edited", tuple(CAR))
        undo(store, ANN, "u1")
        _delete(store, "e3", A0, "n1", moved + 1)
        row = store.row(A0, "n1")
        assert row is not None
        assert row.label.state == "rejected"


def test_a_made_box_that_is_moved_is_a_keyframe(tmp_path: Path) -> None:
    value = {"label": "car", "box": CAR, "source": "interpolated"}
    with opened(tmp_path) as store:
        version = _add(store, "e1", A0, "n1", value).record.seq
        assert not store.row(A0, "n1").label.keyframe  # type: ignore[union-attr]
        _set(store, "e2", A0, "n1", version, {"box": [11.0, *CAR[1:]], "source": "interpolated"})
        assert store.row(A0, "n1").label.keyframe  # type: ignore[union-attr]


def test_a_file_changed_by_another_program_is_noticed(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        _set(store, "e1", A0, "0", 0, {"box": CAR})
    file = tmp_path / "boxes.csv"
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:1] + lines[2:]))
    with opened(tmp_path) as store, pytest.raises(DatasetError, match="changed by another program"):
        store.rows(A0)
