"""Two windows that edit at once: no update is lost, every conflict is shown; any history can be taken back."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edited_drives import ANN, CAR, EVE, opened, state_bytes

from farfield.annotation.edits import add_box, delete_box, set_box, set_track
from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.store import Author, Store, redo, undo
from farfield.datasets.edits import EditState, Record, read_journal

A = ("a", "0000")


class Window:
    """A window that counts up an attribute by reading, adding one, writing; it asks again after a conflict.

    Args:
        store: The annotation.
        author: Who sits there.
        steps: How often it counts.
    """

    def __init__(self, store: Store, author: Author, steps: int, name: str) -> None:
        self.store, self.author, self.left, self.name = store, author, steps, name
        self.seen: tuple[int, int] | None = None  # version and count
        self.acknowledged = self.conflicts = self.sent = 0
        self.shown: list[ConflictError] = []

    def step(self, box: str) -> bool:
        """Read, or write what was read; whether it wrote."""
        if self.seen is None:
            row = self.store.row(A, box)
            assert row is not None
            self.seen = row.version, int(row.label.attributes.get("note", "0"))
            return False
        version, count = self.seen
        self.seen, self.sent = None, self.sent + 1
        plan = partial(set_box, key=A, name=box, base=version, value={"attributes": {"note": str(count + 1)}})
        try:
            self.store.edit(self.author, f"{self.name}-{self.sent}", "box.set", plan)
        except ConflictError as error:
            self.conflicts += 1
            self.shown.append(error)
            return False
        self.acknowledged += 1
        self.left -= 1
        return True


def _interleaved(store: Store, number: int, rng: np.random.Generator) -> tuple[int, int]:
    """One random interleaving on a box of its own; counts and conflicts."""
    box = f"n{number}"
    store.edit(ANN, f"add{number}", "box.add", partial(add_box, key=A, name=box, value={"label": "car", "box": CAR}))
    windows = [Window(store, author, int(rng.integers(1, 4)), f"{author.by}{number}") for author in (ANN, EVE)]
    stale = [False, False]
    due = 0
    while any(window.left for window in windows):
        turn = int(rng.choice([place for place, window in enumerate(windows) if window.left]))
        window = windows[turn]
        writes = window.seen is not None
        if not writes:
            stale[turn] = False
        before = window.conflicts
        if window.step(box):
            stale[1 - turn] = windows[1 - turn].seen is not None
        if writes:  # a conflict, if and only if the other one wrote since the reading
            assert (window.conflicts > before) == stale[turn]
            due += stale[turn]
    row = store.row(A, box)
    assert row is not None
    assert int(row.label.attributes["note"]) == sum(window.acknowledged for window in windows)
    shown = [error for window in windows for error in window.shown]
    assert len(shown) == due
    for window, other in zip(windows, (EVE, ANN), strict=True):
        assert all(error.by == other.by and error.present["box"] == CAR for error in window.shown)
    return int(row.label.attributes["note"]), due


@pytest.mark.parametrize("times", [200, pytest.param(1000, marks=pytest.mark.slow)])
def test_interleavings_of_two_windows(tmp_path: Path, times: int) -> None:
    rng = np.random.default_rng(7)
    with opened(tmp_path) as store:
        found = [_interleaved(store, number, rng) for number in range(times)]
        counts, conflicts = (sum(each) for each in zip(*found, strict=True))
        assert conflicts > times / 2
        assert len(store.journal) == times + counts
        path, state = store.journal.path, EditState()
        rows = store.rows(A)
    read_journal(path, state.apply)  # every line starts from the value before it: that is checked here
    assert {row.label.id: row.version for row in rows if row.version} == {
        name: standing.version for name, standing in state.touched(A).items()
    }


def _random_edit(store: Store, number: int, rng: np.random.Generator) -> None:
    key = ("ab"[int(rng.integers(2))], f"{rng.integers(20):04d}")
    rows = store.rows(key)
    group = f"g{number // 4}" if rng.random() < 0.3 else None
    kind = rng.choice(["set", "add", "delete", "track"], p=[0.6, 0.2, 0.12, 0.08])
    value: dict[str, Any] = {"box": [float(rng.normal()), *CAR[1:]], "label": str(rng.choice(["car", "bus"]))}
    if kind == "track":
        plan: Any = partial(set_track, drive=key[0], track="3", base=store.version(("track", key[0], "3")), label="bus")
    elif kind == "add" or not rows:
        plan = partial(add_box, key=key, name=f"n{number}", value=value)
    else:
        row = rows[int(rng.integers(len(rows)))]
        change = partial(set_box, value=value) if kind == "set" else delete_box
        plan = partial(change, key=key, name=row.label.id, base=row.version)
    op = "track.set" if kind == "track" else f"box.{kind}"
    try:
        store.edit(ANN, f"e{number}", op, plan, group=group)
    except RefusedError:
        assert kind == "track"  # all boxes of the track were deleted


@pytest.mark.parametrize("edits", [120, pytest.param(1000, marks=pytest.mark.slow)])
def test_any_history_is_taken_back_after_a_restart(tmp_path: Path, edits: int) -> None:
    rng = np.random.default_rng(3)
    with opened(tmp_path) as store:
        begin, states = state_bytes(store), []
        for number in range(edits):
            _random_edit(store, number, rng)
            if rng.random() < 0.1 and store.history.counts("ann")[0]:
                undo(store, ANN, f"early{number}")
            if number % 40 == 0:
                states.append((store.history.counts("ann")[0], state_bytes(store)))
        end = state_bytes(store)
    with opened(tmp_path) as store:
        assert state_bytes(store) == end
        steps = store.history.counts("ann")[0]
        for number in range(steps):
            undo(store, ANN, f"u{number}")
        assert state_bytes(store) == begin
        assert store.history.counts("ann")[0] == 0
    with opened(tmp_path) as store:
        for number in range(steps):
            redo(store, ANN, f"r{number}")
        assert state_bytes(store) == end
    records: list[Record] = []
    read_journal(store.journal.path, records.append)
    assert [record.seq for record in records] == list(range(1, len(records) + 1))
