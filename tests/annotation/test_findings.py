"""Checks of the annotation as it stands, and what is noted beside boxes."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from edited_drives import ANN, CAR, EVE, opened

from farfield.annotation.edits import delete_box, set_box
from farfield.annotation.errors import RefusedError
from farfield.annotation.findings import all_findings, findings, settings_of
from farfield.annotation.notes import (
    Stopwatch,
    annotation_work,
    bookmark,
    bookmarks,
    declare_extent,
    ignore,
    ignored_findings,
    record_time,
)
from farfield.annotation.store import Store
from farfield.annotation.surroundings import Surroundings


def _key(row: int) -> tuple[str, str]:
    return ("a", f"{row:04d}")


def _names(store: Store, row: int) -> list[str]:
    return [finding.check for finding in findings(store, _key(row), settings_of(store))]


def test_a_jump_and_a_gap_are_found_after_the_edit(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        assert not list(all_findings(store, settings_of(store)))
        row = store.row(_key(8), "0")
        assert row is not None
        value = {"box": [row.label.box[0], 4.5, *row.label.box[2:]]}
        store.edit(ANN, "e1", "box.set", partial(set_box, key=_key(8), name="0", base=0, value=value))
        store.edit(ANN, "e2", "box.delete", partial(delete_box, key=_key(12), name="0", base=0))
        found = {finding.check: finding for finding in all_findings(store, settings_of(store))}
        assert {name: finding.frame for name, finding in found.items()} == {"jump": _key(8), "gap": _key(13)}
        assert found["jump"].severity == "error"
        assert found["jump"].xy_m == pytest.approx((row.label.box[0], 4.5))


def test_a_finding_is_let_stand_and_brought_back(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        store.edit(ANN, "e1", "box.delete", partial(delete_box, key=_key(12), name="0", base=0))
        (finding,) = findings(store, _key(13), settings_of(store))
        ignore(store, EVE, "i1", finding.id, " it went behind a wall ")
        assert ignored_findings(store) == {finding.id: "it went behind a wall"}
        assert findings(store, _key(13), settings_of(store))[0].ignored == "it went behind a wall"
        with pytest.raises(RefusedError, match="at most 2000"):
            ignore(store, EVE, "i2", finding.id, "x" * 2001)
    with opened(tmp_path) as store:
        assert findings(store, _key(13), settings_of(store))[0].ignored
        ignore(store, EVE, "i3", finding.id, "")
        assert findings(store, _key(13), settings_of(store))[0].ignored is None


def test_points_are_looked_at_where_they_are_given(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        around = Surroundings(np.zeros((0, 3), np.float32))
        found = findings(store, _key(3), settings_of(store), around=around)
        assert [finding.check for finding in found] == ["empty"]


def test_the_extent_is_declared_once(tmp_path: Path) -> None:
    with opened(tmp_path, extent=None) as store:
        with pytest.raises(RefusedError, match="full or visible"):
            declare_extent(store, ANN, "x0", "half")
        declare_extent(store, ANN, "x1", "visible")
        assert store.extent == "visible"
        assert declare_extent(store, EVE, "x2", "visible").record.changes == ()
        with pytest.raises(RefusedError, match="visible parts: that was declared"):
            declare_extent(store, EVE, "x3", "full")
        value = {"box": CAR}
        store.edit(ANN, "e1", "box.set", partial(set_box, key=_key(1), name="0", base=0, value=value))
        assert settings_of(store).extent == "visible"
    with opened(tmp_path, extent=None) as store:
        assert store.extent == "visible"
    with opened(tmp_path / "other") as store, pytest.raises(RefusedError, match="whole bodies"):
        declare_extent(store, ANN, "x1", "visible")


def test_bookmarks(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        bookmark(store, ANN, "b1", _key(9), "a fox")
        bookmark(store, EVE, "b2", _key(2), "")
        assert bookmarks(store) == ((_key(2), "", "eve"), (_key(9), "a fox", "ann"))
        bookmark(store, EVE, "b3", _key(9), None)
        assert [mark.key for mark in bookmarks(store)] == [_key(2)]
        with pytest.raises(RefusedError, match="no frame"):
            bookmark(store, EVE, "b4", ("z", "0"), "")
        assert store.history.counts("ann") == (0, 0)  # nothing that undo concerns


def test_time_a_box_by_annotator(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        record_time(store, ANN, "t1", _key(1), "0", 4.5, 2)
        record_time(store, ANN, "t2", _key(1), "0", 1.5, 1)
        record_time(store, ANN, "t3", _key(2), "0", 3.0, 0)
        record_time(store, EVE, "t4", _key(2), "0", 8.0, 5)
        with pytest.raises(RefusedError, match="seconds of a day"):
            record_time(store, EVE, "t5", _key(2), "0", float("nan"), 5)
    with opened(tmp_path) as store:
        found = annotation_work(store)
        assert found == {"ann": (2, 9.0, 3), "eve": (1, 8.0, 5)}
        assert found["ann"].seconds_per_box == 4.5


def test_pauses_do_not_count() -> None:
    watch = Stopwatch()
    for now_s in (100.0, 102.0, 150.0, 211.0, 213.0):
        watch.act(now_s)
    assert watch.lap(214.0) == 2.0 + 48.0 + 2.0 + 1.0
    assert watch.lap(215.0) == 1.0
