"""Tracks edited as a whole: size, class, end, merged, split, filled."""

from functools import partial
from pathlib import Path
from typing import Any

import pytest
from edited_drives import ANN, CAR, EVE, opened, state_bytes

from farfield.annotation.edits import (
    add_box,
    boxes_of,
    combine,
    delete_box,
    fill_track,
    interpolate_track,
    merge_tracks,
    propagate_track,
    set_box,
    set_track,
    split_track,
)
from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.motion import RefitBox
from farfield.annotation.store import Author, EditResult, Store, undo
from farfield.datasets.edits import track_cell

A = "a"


def _key(row: int, drive: str = A) -> tuple[str, str]:
    return (drive, f"{row:04d}")


def _track(store: Store, id: str, base: int = 0, by: Author = ANN, track: str = "3", **value: Any) -> EditResult:
    return store.edit(by, id, "track.set", partial(set_track, drive=A, track=track, base=base, **value))


def _add(store: Store, row: int, track: str, box: Any = CAR, **more: Any) -> None:
    value = {"label": "car", "box": box, "track": track, **more}
    store.edit(
        ANN, f"add-{track}-{row}", "box.add", partial(add_box, key=_key(row), name=f"n{track}-{row}", value=value)
    )


def _sizes(store: Store, drive: str = A, track: str = "3") -> set[tuple[float, ...]]:
    return {box.label.box[3:6] for _, _, box in boxes_of(store, drive, track)}


def test_tracks_are_those_of_their_drive(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        assert store.tracks.names(A) == ["3"]
        assert store.tracks.new(A) == "4"
        assert len(boxes_of(store, A, "3")) == 20
        _add(store, 0, "11")
        assert store.tracks.new(A) == "12"
        assert store.tracks.new("b") == "4"


def test_one_size_for_all_frames_is_one_step(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        begin = state_bytes(store)
        first = _track(store, "e1", locked=True).record.seq
        assert store.value(track_cell(A, "3"))["size"] == [4.5, 1.9, 1.6]
        row = store.row(_key(4), "0")
        assert row is not None
        box = [*row.label.box[:3], 5.0, 2.0, 1.8, 0.25]
        store.edit(ANN, "e2", "box.set", partial(set_box, key=_key(4), name="0", base=row.version, value={"box": box}))
        assert _sizes(store) == {(5.0, 2.0, 1.8)}
        assert _sizes(store, "b") == {(4.5, 1.9, 1.6)}
        bottom = {box.label.box[2] - box.label.box[5] / 2 for row, _, box in boxes_of(store, A, "3") if row != 4}
        assert bottom == {-0.8}
        with pytest.raises(ConflictError):
            _track(store, "e3", base=first, locked=False, by=EVE)
        undo(store, ANN, "u1")
        assert _sizes(store) == {(4.5, 1.9, 1.6)}
        undo(store, ANN, "u2")
        assert state_bytes(store) == begin


def test_class_and_end(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        _add(store, 19, "8", source="interpolated")
        _add(store, 2, "8")
        _track(store, "e1", track="8", label="bus", ends="0010")
        assert [(row, box.label.label) for row, _, box in boxes_of(store, A, "8")] == [(2, "bus")]
        _track(store, "e2", label="bus", size=(11.0, 2.6, 3.2), locked=True)
        assert {box.label.label for _, _, box in boxes_of(store, A, "3")} == {"bus"}
        assert _sizes(store) == {(11.0, 2.6, 3.2)}
        with pytest.raises(RefusedError, match="one of the classes"):
            _track(store, "e3", base=4, label="tank")
        with pytest.raises(RefusedError, match="no track"):
            _track(store, "e4", track="77", label="bus")
        with pytest.raises(RefusedError, match="no frame"):
            _track(store, "e5", base=4, ends="9999")


def _split(store: Store, id: str, frame: str, new_track: str, base: int) -> EditResult:
    plan = partial(split_track, drive=A, track="3", frame=frame, new_track=new_track, base=base)
    return store.edit(ANN, id, "track.split", plan)


def _merge(store: Store, id: str, track: str, bases: tuple[int, int]) -> EditResult:
    plan = partial(merge_tracks, drive=A, track=track, into="3", base=bases[0], into_base=bases[1])
    return store.edit(EVE, id, "track.merge", plan)


def test_merged_and_split(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        begin = state_bytes(store)
        _split(store, "e1", "0012", "9", 0)
        assert [len(boxes_of(store, A, track)) for track in "39"] == [12, 8]
        with pytest.raises(RefusedError, match="has a track 9"):
            _split(store, "e2", "0003", "9", 1)
        with pytest.raises(RefusedError, match="both sides"):
            _split(store, "e3", "0000", "5", 1)
        with pytest.raises(ConflictError):
            _merge(store, "e4", "9", (0, 0))
        _merge(store, "e5", "9", (0, 1))
        assert len(boxes_of(store, A, "3")) == 20
        assert state_bytes(store) == begin
        _add(store, 5, "6")
        with pytest.raises(RefusedError, match="both have a box in 1 frame"):
            _merge(store, "e6", "6", (0, 2))


def test_interpolated_between_keyframes_only(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        for row, x_m in ((2, 20.0), (6, 28.0), (12, 28.0)):
            _add(store, row, "8", [x_m, *CAR[1:]], attributes={"moving": row != 12})
        before = state_bytes(store)
        plan = partial(interpolate_track, drive=A, track="8", first=0, last=19, prefix="i1")
        done = store.edit(ANN, "i1", "track.interpolate", plan)
        assert len(done.record.changes) == 8
        boxes = boxes_of(store, A, "8")
        assert [row for row, _, _ in boxes] == [*range(2, 13)]
        assert [row for row, _, box in boxes if box.label.keyframe] == [2, 6, 12]
        assert [box.label.attributes["moving"] for _, _, box in boxes] == [True] * 10 + [False]
        again = store.edit(ANN, "i2", "track.interpolate", plan)
        assert again.record.changes == ()
        row = store.row(_key(4), "i1.4")
        assert row is not None
        moved = {"box": [99.0, *row.label.box[1:]]}
        store.edit(ANN, "e1", "box.set", partial(set_box, key=_key(4), name="i1.4", base=row.version, value=moved))
        store.edit(ANN, "i3", "track.interpolate", plan)
        assert store.row(_key(4), "i1.4").label.box[0] == 99.0  # type: ignore[union-attr]
        assert 24.0 < store.row(_key(3), "i1.3").label.box[0] < 99.0  # type: ignore[union-attr]
        for name in ("u1", "u2", "u3", "u4"):
            undo(store, ANN, name)
        assert state_bytes(store) == before
        _add(store, 0, "10")
        one = partial(interpolate_track, drive=A, track="10", first=0, last=19, prefix="i4")
        with pytest.raises(RefusedError, match="1 keyframe"):
            store.edit(ANN, "i4", "track.interpolate", one)


@pytest.mark.filterwarnings("error")
def test_two_keyframes_at_one_time_are_refused_by_their_frames(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        for row in (2, 6):
            _add(store, row, "8")
        twin = {"label": "car", "box": CAR, "track": "8"}
        store.edit(ANN, "twin", "box.add", partial(add_box, key=_key(6), name="twin", value=twin))
        plan = partial(interpolate_track, drive=A, track="8", first=0, last=19, prefix="i1")
        with pytest.raises(RefusedError, match="two keyframes at the time of frame 0006"):
            store.edit(ANN, "i1", "track.interpolate", plan)


def _still(key: Any, guess: Any, window_m: float) -> RefitBox:
    return RefitBox(guess, 2 if int(key[1]) > 8 else 30)


def test_propagated_and_one_undo(tmp_path: Path) -> None:
    with opened(tmp_path, posed=False) as store:
        for row, x_m in ((0, 20.0), (1, 21.0)):
            _add(store, row, "8", [x_m, *CAR[1:]])
        _add(store, 5, "8", [25.25, *CAR[1:]])
        before = state_bytes(store)
        found = propagate_track(store, A, "8", 1, 19, _still)
        assert [key[1] for key in found.boxes] == [f"{row:04d}" for row in (2, 3, 4, 6, 7, 8)]
        assert "lost from frame 0009" in found.message
        plan = partial(fill_track, drive=A, track="8", boxes=found.boxes, source="propagated", prefix="p1")
        store.edit(ANN, "p1", "track.propagate", plan)
        boxes = {row: box for row, _, box in boxes_of(store, A, "8")}
        assert boxes[5].label.box[0] == 25.25
        assert boxes[3].label.box[0] == pytest.approx(23.0)
        assert (boxes[3].label.source, boxes[3].label.keyframe) == ("propagated", False)
        undo(store, ANN, "u1")
        assert state_bytes(store) == before
        assert len(propagate_track(store, A, "8", 1, 0).boxes) == 0
        store.edit(ANN, "t", "track.set", partial(set_track, drive=A, track="8", base=0, ends="0003"))
        assert [key[1] for key in propagate_track(store, A, "8", 1, 19).boxes] == ["0002", "0003"]
        with pytest.raises(RefusedError, match="no box in the frame"):
            propagate_track(store, A, "8", 15, 19)


def test_several_plans_are_one_edit_or_none(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        before = state_bytes(store)
        plans = [partial(delete_box, key=_key(row), name="0", base=0) for row in range(3)]
        with pytest.raises(RefusedError, match="changed twice"):
            store.edit(ANN, "e1", "box.set", partial(combine, [*plans, plans[0]]))
        assert state_bytes(store) == before
        store.edit(ANN, "e2", "box.set", partial(combine, plans))
        assert len(boxes_of(store, A, "3")) == 17
        undo(store, ANN, "u1")
        assert state_bytes(store) == before
