"""Three words for three states of the work, messages that a lost connection does not lose, numbers of new objects."""

import contextlib
import errno
import os
from functools import partial
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
from _studio_scenes import write_folder
from _studio_screen import Screen, screen
from studio.browser.cutting import Line
from studio.browser.editing import choose
from studio.live import studio
from studio.posts import write_kitti

from farfield.annotation import journal
from farfield.datasets import open_dataset
from farfield.studio.options import CalibrationSettings

pytestmark = pytest.mark.slow


def test_what_is_kept_where_is_said_and_chosen_and_survives_a_lost_connection(
    chromium: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = write_folder(tmp_path / "drive", 2, 12_000)
    place = {"edits": tmp_path / "edits", "notes": tmp_path, "out": tmp_path / "out"}
    with studio(partial(open_dataset, folder), mode="annotate", extent="full", **place) as live:
        line = Line(live.port)
        live.origin, direct = f"http://127.0.0.1:{line.port}", live.origin
        with screen(chromium, live) as page:
            assert page.text("#saved") == "nothing changed"
            choose(page, 3)
            page.press("Shift+KeyW")
            page.until("state.labels.unwritten === 1")
            assert page.text("#saved") == "in the journal: 1 edit"
            page.page.locator("#saved").click()
            page.page.locator("#work select").select_option("cvat")
            field = page.page.locator("#work input[name='labels folder']")
            for wrong in ("my labels", "Stra\u00dfe", "x" * 65):
                field.fill(wrong)
                field.press("Enter")
                page.until("state.connected && document.querySelector('#folder-note').textContent !== ''")
                assert "A folder's name has 1 to 64" in page.text("#folder-note")
                assert field.input_value() == wrong
            assert page.text("#bars") == ""
            field.fill("mine")
            field.press("Enter")
            page.page.locator("#work input[name='labels at exit']").check()
            page.until("state.labels.next_folder === 'labels-cvat' && farfieldTest.state.labels.at_exit")
            assert "1 edit on the studio's disk, in no label file yet" in page.text("#work")
            page.page.get_by_role("button", name="Write to labels-cvat").click()
            page.until("state.labels.unwritten === 0")
            assert page.text("#saved").startswith("in the labels ")
            assert "to labels-cvat as cvat" in page.text("#work")
            page.page.evaluate("farfieldTest.state.labels.left = 2")
            page.press("Escape")
            assert page.text("#saved").endswith(", 2 boxes left out")
            page.page.locator("#saved").click()
            written = next((tmp_path / "mine" / "labels-cvat").rglob("*.*"))
            before = written.read_bytes()

            line.cut()
            page.until("state.connected === false")
            page.press("Shift+KeyW")
            page.until("state.pending === 1")
            assert page.text("#saved") == "not kept: 1 edit"
            page.press("Control+s")  # all of this waits for the connection, and none of it is lost
            page.page.locator("#work input[name='labels at exit']").uncheck()
            page.press("Escape", "Shift+KeyK")
            finding = page.page.locator("#checks .finding").first
            finding.get_by_role("button", name="ignore").click()
            page.page.locator("#checks input[placeholder=reason]").fill("a crane")
            page.page.locator("#checks input[placeholder=reason]").press("Enter")
            line.join()
            page.until("state.connected && farfieldTest.state.pending === 0", seconds=20)
            page.until("state.labels.unwritten === 0 && !farfieldTest.state.labels.at_exit")
            page.until("state.bookmarks.length === 1")
            assert written.read_bytes() != before
            live.origin = direct
            with live.window() as client:
                client.open(0)
                checks = client.until("checks")["rows"]
                assert "a crane" in {row["ignored"] for row in checks}
                assert len(client.welcome["bookmarks"]) == 1

            row = page.selected
            assert row is not None
            monkeypatch.setattr(journal.os, "fsync", read_only)
            page.press("Shift+KeyW")
            page.until("state.stopped !== ''")
            assert page.text("#saved") == "not kept: 1 edit"
            assert "Read-only file system" in page.text("#bar-kept")
            assert "1 edit is kept in this browser only" in page.text("#bar-kept")
            monkeypatch.undo()
        line.close()


def read_only(_: int) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def tracks_of(page: Screen) -> set[int]:
    return {row["track"] for row in page.boxes}


def test_new_objects_never_take_the_number_of_another_one(chromium: Any, tmp_path: Path):
    for drive in ("0000", "0001"):
        for labels in write_folder(tmp_path / "two" / "training" / "velodyne" / drive, 2, 12_000).glob("*.json"):
            labels.unlink()
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with (
        studio(partial(open_dataset, tmp_path / "two"), mode="annotate", extent="full", **place) as live,
        screen(chromium, live) as page,
        live.window() as client,
    ):
        value = {"box": [20.0, -9.0, 0.0, 4.6, 1.9, 1.6, 0.0], "class_name": client.welcome["classes"][0]["name"]}
        # 77 is one object in the first drive and another in the second, which the frame at the border does not show
        for frame, track in ((0, 77), (2, 3), (3, 77), (3, 90)):
            box = {"box": f"n-{frame}-{track}", "value": value | {"track": track}}
            client.send(op="box.add", id=client.new_id(), frame=frame, **box)
            assert client.until("ack", "refused")["op"] == "ack"
        page.until("state.boxes.some((row) => row.track === 77)")
        page.page.locator("#objects tr[data-box='0:n-0-77']").click()
        page.press("Control+c")
        page.go(2)
        page.press("Control+v", "Control+d")
        page.settled()
        made = tracks_of(page) - {3}
        assert len(made) == 2
        assert not made & {77, 90}
        page.go(1)
        page.press("Control+v")  # in its own drive it is the same object
        page.settled()
        assert tracks_of(page) == {77}
        # two windows that make an object at the same moment
        page.page.evaluate("farfieldTest.hold(true)")
        rival = {"box": "rival", "value": value | {"track": 78}, "fresh": True}
        client.send(op="box.add", id=client.new_id(), frame=0, **rival)
        assert client.until("ack", "refused")["row"]["track"] == 78
        page.press("Control+d")
        page.settled()
        assert page.selected is not None
        assert page.selected["track"] == 79
        page.page.evaluate("farfieldTest.hold(false)")
        page.go(0)
        assert tracks_of(page) == {77, 78}


def test_one_question_about_an_undo_and_none_once_something_else_is_done(chromium: Any, tmp_path: Path):
    folder = write_folder(tmp_path / "drive", 2, 12_000)
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with (
        studio(partial(open_dataset, folder), mode="annotate", annotator="kim", extent="full", **place) as live,
        screen(chromium, live) as page,
        live.window(annotator="lee") as other,
    ):
        row = choose(page, 3)
        page.press("Shift+KeyW")
        page.until("state.pending === 0 && farfieldTest.state.undo")
        now = page.box(row["id"])
        value = {"box": [*now["box"][:2], now["box"][2] + 1, *now["box"][3:]], "class_name": "vehicle", "track": 3}
        other.send(op="box.set", id="o-1", frame=0, box=row["id"], base=now["version"], value=value)
        assert other.until("ack", "conflict")["op"] == "ack"
        for _ in range(3):
            page.press("Control+z")
            page.until("state.pending === 0")
            page.page.wait_for_timeout(100)
        question = page.page.get_by_role("button", name="Undo it all the same")
        assert question.count() == 1
        choose(page, 6)
        page.press("Shift+KeyW")  # now the last step is another one
        page.until("state.pending === 0")
        assert question.count() == 0
        page.press("Control+z")
        page.until("state.takenBack === 1")
        page.press("Control+z")
        page.until("state.pending === 0")
        question.click()
        page.until("state.takenBack === 2")
        assert page.box(row["id"])["box"] == pytest.approx(row["box"])


def test_what_was_set_in_a_calibration_survives_a_lost_connection_and_a_studio_that_begins_anew(
    chromium: Any, tmp_path: Path
):
    root = write_kitti(tmp_path / "set", count=1)
    calibration = CalibrationSettings(kind="lidar-camera", frames=1, folder=tmp_path / "out")
    begin = partial(studio, partial(open_dataset, root), mode="calibrate", calibration=calibration)
    moved = "farfieldTest.model.state.camera.moved[0]"
    with contextlib.ExitStack() as stack:
        with begin() as live:
            line = stack.enter_context(contextlib.closing(Line(live.port)))
            live.origin = f"http://127.0.0.1:{line.port}"
            page = stack.enter_context(screen(chromium, live))
            line.cut()
            page.until("state.connected === false")
            field = page.page.locator("input[name='moved0']")
            for value in ("0.3", "0.5"):
                field.fill(value)
                field.press("Enter")
            line.join()
            page.until(f"is(() => Math.abs({moved} - 0.5 * Math.PI / 180) < 1e-9)", seconds=20)
            page.settled()
            line.cut()
        with begin() as live:
            line.there = live.port
            name, _, cookie = live.cookie.partition("=")
            page.page.context.add_cookies([{"name": name, "value": cookie, "url": page.origin}])
            line.join()
            page.until("state.connected === true", seconds=20)
            page.until("is(({ model }) => model.state.ready && model.state.undo)", seconds=20)
            page.settled()
            assert page.page.evaluate(moved) == pytest.approx(0.5 * 3.141592653589793 / 180)
            assert "set anew" in page.text("#bars") or page.tell("model.state.unsaved")
