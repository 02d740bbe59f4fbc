"""Proposals of a drive accepted as one edit: one track an object, also where a box of it stands already."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from edited_drives import ANN, CAR, opened, state_bytes

from farfield.annotation.edits import add_box, boxes_of
from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.proposals import ProposalRange, accept_proposals, proposals_of
from farfield.annotation.store import Store, undo

A = "a"
WHOLE = ProposalRange(drive=A, first=0, last=19, score=0.5)


def _key(row: int) -> tuple[str, str]:
    return (A, f"{row:04d}")


def _propose(store: Store, row: int, name: str, x: float, y: float, score: float) -> None:
    value = {"label": "car", "box": [x, y, *CAR[2:]], "state": "proposed", "source": "detector", "score": score}
    store.edit(ANN, f"{name}-{row}", "box.add", partial(add_box, key=_key(row), name=name, value=value))


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Ten frames of two cars beside track 3 of the files, a weak proposal, and one that goes on with track 3."""
    with opened(tmp_path, frames=20, posed=False) as store:
        for row in range(4, 14):
            _propose(store, row, "left", 30.0 + row, 9.0, 0.9)
            _propose(store, row, "right", 40.0 - row, -6.0, 0.7)
        _propose(store, 6, "weak", 60.0, 0.0, 0.2)
        yield store


def test_all_of_a_drive_are_one_edit_with_a_track_an_object(store: Store) -> None:
    begin = state_bytes(store)
    assert len(proposals_of(store, WHOLE)) == 20
    store.edit(ANN, "all", "box.accept", partial(accept_proposals, meant=WHOLE, count=20, base=store.state.seq))
    assert [len(boxes_of(store, A, name)) for name in store.tracks.names(A)] == [20, 10, 10]
    assert [row.box.label.score for row in proposals_of(store, replace(WHOLE, score=0.0))] == [0.2]
    undo(store, ANN, "u1")
    assert state_bytes(store) == begin


def test_later_frames_go_on_with_the_tracks_that_stand(store: Store) -> None:
    for number, rows in enumerate(((4, 8), (9, 13))):
        meant = ProposalRange(drive=A, first=rows[0], last=rows[1], score=0.5)
        plan = partial(accept_proposals, meant=meant, count=10, base=store.state.seq)
        store.edit(ANN, f"part-{number}", "box.accept", plan)
    assert [len(boxes_of(store, A, name)) for name in store.tracks.names(A)] == [20, 10, 10]


def test_others_than_those_counted_are_left(store: Store) -> None:
    base = store.state.seq
    with pytest.raises(RefusedError, match="19 proposals were counted, 20 are there"):
        store.edit(ANN, "few", "box.accept", partial(accept_proposals, meant=WHOLE, count=19, base=base))
    _propose(store, 15, "late", 50.0, 5.0, 0.9)
    with pytest.raises(ConflictError):
        store.edit(ANN, "all", "box.accept", partial(accept_proposals, meant=WHOLE, count=20, base=base))
