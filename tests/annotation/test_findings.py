"""Checks of the annotation as it stands, and what is noted beside boxes."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edited_drives import ANN, CAR, EVE, opened

from farfield.annotation.checking import LabelIssue
from farfield.annotation.edits import add_box, delete_box, set_box
from farfield.annotation.errors import RefusedError
from farfield.annotation.findings import DriveFindings, findings, settings_of
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
from farfield.errors import FarfieldError
from farfield.frame import Key


def _key(row: int) -> tuple[str, str]:
    return ("a", f"{row:04d}")


def _names(store: Store, row: int) -> list[str]:
    return [finding.check for finding in findings(store, _key(row), settings_of(store))]


def _all_findings(store: Store) -> list[LabelIssue]:
    return [finding for key in store.keys for finding in findings(store, key, settings_of(store))]


def test_a_jump_and_a_gap_are_found_after_the_edit(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        assert not _all_findings(store)
        row = store.row(_key(8), "0")
        assert row is not None
        value = {"box": [row.label.box[0], 4.5, *row.label.box[2:]]}
        store.edit(ANN, "e1", "box.set", partial(set_box, key=_key(8), name="0", base=0, value=value))
        store.edit(ANN, "e2", "box.delete", partial(delete_box, key=_key(12), name="0", base=0))
        found = {finding.check: finding for finding in _all_findings(store)}
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


def _check_frame(store: Store, points: list[str], key: Key, with_points: bool, before: Sequence[LabelIssue]) -> Any:
    """Check a frame; of which the points were looked at is noted. The frames have one point: no box holds any."""
    if with_points:
        points.append(key[1])
    around = Surroundings(np.zeros((0, 3), np.float32)) if with_points else None
    return findings(store, key, settings_of(store), around=around, before=before)


def _refreshed(drive: DriveFindings) -> dict[str, list[str]]:
    """Do all that is due; the checks that find something, by frame."""
    for due, points in ((drive.labels_due, False), (drive.points_due, True)):
        for key in list(due):
            turn = drive.begin(key, points=points)
            assert drive.end(key, turn, drive.check(key, points=points), points=points)
    return {key[1]: [issue.check for issue in issues] for key, issues in drive.issues.items()}


def test_the_findings_of_a_drive_follow_its_edits_and_read_no_cloud_twice(tmp_path: Path) -> None:
    points: list[str] = []
    with opened(tmp_path) as store:
        drive = DriveFindings(store, store.drives.keys("a"), partial(_check_frame, store, points))
        assert set(map(tuple, _refreshed(drive).values())) == {("empty",), ("empty", "empty")}
        assert len(points) == 20
        points.clear()
        row = store.row(_key(8), "0")
        assert row is not None
        moved = {"box": [row.label.box[0], 4.5, *row.label.box[2:]]}
        drive.take(
            store.edit(ANN, "e1", "box.set", partial(set_box, key=_key(8), name="0", base=0, value=moved)).record
        )
        gone = store.edit(ANN, "e2", "box.delete", partial(delete_box, key=_key(12), name="0", base=0))
        drive.take(gone.record)
        assert set(drive.labels_due) == {_key(row) for row in range(2, 19)}
        assert list(drive.points_due) == [_key(8), _key(12)]
        issues = _refreshed(drive)
        assert points == ["0008", "0012"]
        assert issues["0008"] == ["jump", "empty"]
        assert issues["0012"] == []
        assert issues["0013"] == ["gap", "empty"]
        assert issues["0011"] == ["empty"]
        drive.take(ignore(store, EVE, "i1", drive.issues[_key(13)][0].id, "behind a wall").record)
        assert list(drive.labels_due) == [_key(13)]
        _refreshed(drive)
        assert drive.issues[_key(13)][-1].ignored == "behind a wall"
        drive.take(ignore(store, EVE, "i2", drive.issues[_key(13)][-1].id, "").record)
        _refreshed(drive)
        assert all(issue.ignored is None for issue in drive.issues[_key(13)])
        assert points == ["0008", "0012"]


def test_a_check_that_an_edit_overtook_brings_nothing(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        drive = DriveFindings(store, store.drives.keys("a"), partial(_check_frame, store, []))
        _refreshed(drive)
        late = drive.begin(_key(3), points=True)
        stale = drive.check(_key(3), points=True)
        drive.begin(_key(3), points=False)
        assert not drive.end(_key(3), late, stale, points=True)
        assert list(drive.points_due) == [_key(3)]  # else nobody would look at its points again
        gone = store.edit(ANN, "e1", "box.delete", partial(delete_box, key=_key(3), name="0", base=0))
        drive.take(gone.record)
        assert _refreshed(drive)["0003"] == []
        assert not drive.end(_key(3), late, stale, points=True)
        assert drive.issues[_key(3)] == []


def test_a_short_track_is_said_in_all_its_frames_however_far_apart(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        drive = DriveFindings(store, store.drives.keys("a"), partial(_check_frame, store, []))
        _refreshed(drive)
        for number, frame in enumerate((1, 18)):
            value = {"label": "car", "box": [40.0, -8.0, *CAR[2:]], "track": "9"}
            added = partial(add_box, key=_key(frame), name=f"n{number}", value=value)
            drive.take(store.edit(ANN, f"e{number}", "box.add", added).record)
        issues = _refreshed(drive)
        assert "short" in issues["0001"]
        assert "short" in issues["0018"]
        added = partial(
            add_box, key=_key(9), name="n9", value={"label": "car", "box": [40.0, -8.0, *CAR[2:]], "track": "9"}
        )
        drive.take(store.edit(ANN, "e9", "box.add", added).record)
        assert not any("short" in checks for checks in _refreshed(drive).values())


def test_a_frame_that_cannot_be_read_is_a_finding(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        drive = DriveFindings(store, store.drives.keys("a"), _unreadable)
        assert _refreshed(drive)["0000"] == ["unreadable"]
        assert "cut off" in drive.issues[_key(0)][0].sentence


def _unreadable(*_: object) -> Any:
    raise FarfieldError("the cloud is cut off")


def test_a_cloud_that_cannot_be_read_stays_a_finding_when_labels_beside_it_are_edited(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        drive = DriveFindings(store, store.drives.keys("a"), partial(_without_clouds, FarfieldError("damaged")))
        assert _refreshed(drive)["0000"] == ["unreadable"]
        drive.mark([_key(0)])
        turn = drive.begin(_key(0), points=False)
        assert drive.end(_key(0), turn, drive.check(_key(0), points=False), points=False)
        assert [issue.check for issue in drive.issues[_key(0)]] == ["unreadable"]
        assert list(drive.points_due) == [_key(0)]  # perhaps it can be read by now


def test_an_error_of_the_checks_own_is_a_finding_of_its_frame(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with opened(tmp_path) as store:
        drive = DriveFindings(store, store.drives.keys("a"), partial(_without_clouds, KeyError("row")))
        assert _refreshed(drive)["0000"] == ["unreadable"]
        assert "error of its own (KeyError)" in drive.issues[_key(0)][0].sentence
    assert "checking frame a/0000" in caplog.text


def _without_clouds(error: Exception, key: Key, points: bool, before: Sequence[LabelIssue]) -> list[LabelIssue]:
    if points and key == _key(0):
        raise error
    return []
