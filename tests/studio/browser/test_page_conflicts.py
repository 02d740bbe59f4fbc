"""Edits of the page that meet another window, a refusal, a lost connection, another frame or another drive."""

import json
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
from _studio_rough_link import ROUGH_LINK
from _studio_scenes import write_folder
from _studio_screen import Screen, screen
from studio.browser.cutting import Line
from studio.browser.editing import FRAMES, choose, damage_next, slow, stored
from studio.live import Live, studio

from farfield.annotation import journal
from farfield.datasets import open_dataset
from farfield.studio.messages import requests
from farfield.studio.session.session import HANDLERS, ClientWindow, Session


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("conflicts") / "drive", FRAMES, 16_000)


@pytest.fixture
def live(data: Path, tmp_path: Path):
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with studio(lambda: open_dataset(data), mode="annotate", extent="full", **place) as running:
        yield running


@pytest.fixture
def page(chromium: Any, live: Live):
    with screen(chromium, live, script=ROUGH_LINK) as shown:
        yield shown


def test_an_edit_that_waits_never_overwrites_another_window(page: Screen, live: Live, monkeypatch: pytest.MonkeyPatch):
    row = choose(page, 3)
    theirs = [row["box"][0], row["box"][1] + 3.0, *row["box"][2:]]
    with live.window() as client:
        first = client.welcome["journal_seq"] + 1
        monkeypatch.setattr(journal.os, "fsync", slow_disk)
        page.press("Shift+KeyW", "Shift+KeyW")
        page.until("state.pending === 2")
        page.page.wait_for_timeout(200)
        value = {"box": theirs, "class_name": row["class_name"], "track": 3}
        client.send(op="box.set", id=client.new_id(), frame=0, box=row["id"], base=first, value=value)
        assert client.until("ack", "conflict")["op"] == "ack"
        page.until("state.pending === 0")
    assert stored(live)[0][3]["box"] == pytest.approx(theirs)
    assert "meanwhile" in page.text("#bars")


def slow_disk(_: int) -> None:
    time.sleep(1.0)


def test_each_conflict_is_asked_about_and_mine_is_kept_where_its_frame_is_not_loaded(page: Screen, live: Live):
    page.page.evaluate("farfieldTest.hold(true)")
    with live.window() as client:
        before = {row["id"]: row for row in client.open(0)["boxes"]}
        for row in before.values():
            value = {"box": [*row["box"][:2], row["box"][2] + 1.0, *row["box"][3:]], "class_name": row["class_name"]}
            client.send(op="box.set", id=client.new_id(), frame=0, box=row["id"], base=row["version"], value=value)
            assert client.until("ack", "conflict", "refused")["op"] == "ack"
    slow(page, 60_000)
    for _ in range(5):
        page.press("ArrowDown", "Shift+KeyW")
    page.until("state.pending === 5")
    mine = {row["id"]: row["box"] for row in page.boxes if row["box"] != before[row["id"]]["box"]}
    assert len(mine) == 5
    page.page.goto(f"{page.origin}/?test=1&frame=2")
    page.until("state.pending === 0 && document.querySelectorAll('#bars button').length >= 15", seconds=20)
    page.settled()
    assert all(f"Frame 1, box {name}:" in page.text("#bars") for name in mine)
    for _ in mine:
        page.page.get_by_role("button", name="Keep mine").first.click()
        assert page.page.evaluate("document.activeElement.textContent") != "Keep mine", "Enter answers another question"
    page.until("state.pending === 0")
    with live.window() as client:
        after = {row["id"]: row["box"] for row in client.open(0)["boxes"]}
    assert {name: after[name] for name in mine} == {name: pytest.approx(box) for name, box in mine.items()}


def draw(page: Screen) -> None:
    page.look(30, 0, 25)
    page.press("n")
    page.drag(page.pixel([28, 0, -1.5]), page.pixel([33, 0, -1.5]))


def test_a_box_drawn_just_before_a_frame_change_is_kept(page: Screen, live: Live):
    before = stored(live)
    slow(page, 150)
    draw(page)
    page.press("End")
    page.until(f"state.shown.frame.index === {FRAMES - 1}", seconds=20)
    slow(page, 0)
    page.settled()
    after = stored(live)
    assert len(set(after[0]) - set(before[0])) == 1
    assert after[1:] == before[1:]


def test_an_undo_of_an_edit_that_is_refused_takes_back_no_other(page: Screen, live: Live):
    choose(page, 3)
    page.press("Shift+KeyW")
    page.settled()
    before = stored(live)
    damage_next(page, "box.set")
    slow(page, 200)
    page.press("Shift+KeyW", "Control+z")
    page.until("state.pending === 2")
    slow(page, 0)
    page.until("state.pending === 0")
    assert stored(live) == before
    assert "nothing else was undone" in page.text("#bars")


def test_p_behind_a_box_that_is_refused_leaves_p_as_it_was(page: Screen):
    damage_next(page, "box.add")
    slow(page, 300)
    draw(page)
    page.until("state.pending === 1 && farfieldTest.state.selection !== null")
    page.press("p")
    page.until("state.pending === 2")
    slow(page, 0)
    page.until("state.pending === 0")
    choose(page, 3)
    page.press("p")
    page.until("state.frame === 1")
    assert page.tell("state.pending") == 0


def test_the_edits_that_an_earlier_version_kept_are_sent(page: Screen, live: Live):
    row = next(row for row in page.boxes if row["track"] == 3)
    moved = [row["box"][0], row["box"][1] + 2.0, *row["box"][2:]]
    value = {"box": moved, "class_name": row["class_name"], "track": 3, "attributes": {}}
    edit = {"op": "box.set", "id": "old-1", "frame": 0, "box": row["id"].split(":")[1], "base": 0, "value": value}
    name = f"farfield-edits {page.tell('state.welcome.data')} old"
    page.page.evaluate("([name, text]) => localStorage.setItem(name, text)", [name, json.dumps([edit])])
    page.page.goto(f"{page.origin}/?test=1")
    page.settled()
    assert stored(live)[0][3]["box"] == pytest.approx(moved)


@pytest.fixture
def line(live: Live):
    """A line to the studio; the windows that open take it."""
    line = Line(live.port)
    live.origin = f"http://127.0.0.1:{line.port}"
    yield line
    line.close()


def test_a_goodbye_is_not_the_last_word(chromium: Any, live: Live, line: Line, monkeypatch: pytest.MonkeyPatch):
    handler, sent_away = HANDLERS[requests.Save], list[str]()
    monkeypatch.setitem(HANDLERS, requests.Save, partial(send_away, handler, sent_away))
    with screen(chromium, live) as page:
        page.press("Control+s")
        page.until("state.connected === false")
        page.until("state.connected === true")
        for _ in range(2):
            line.cut()
            page.until("state.connected === false")
            page.page.wait_for_timeout(1000)  # an attempt that fails
            line.join()
            page.until("state.connected === true")
        assert page.tell("state.connected") is True


async def send_away(
    handler: Any, sent_away: list[str], session: Session, window: ClientWindow, request: requests.Save
) -> None:
    """Send the windows away at the first save: it comes again."""
    if sent_away:
        return await handler(session, window, request)
    sent_away.append(request.id)
    session.goodbye("the studio was ended in its terminal")
    return None


def test_the_wall_is_there_again_with_the_connection(chromium: Any, live: Live, line: Line):
    with screen(chromium, live, script=ROUGH_LINK) as page:
        choose(page, 3)
        line.cut()
        page.until("state.connected === false")
        page.press("v")
        line.join()
        page.page.wait_for_function(POINTS_OF_THE_LAST_TILE, timeout=10_000)
        assert page.page.evaluate(POINTS_OF_THE_LAST_TILE)


POINTS_OF_THE_LAST_TILE = f"""() => {{
  const tile = document.querySelector(".wall canvas[data-frame='{FRAMES - 1}']");
  const pixels = tile.getContext("2d").getImageData(0, 0, tile.width, tile.height).data;
  return pixels.some((value, i) => i % 4 === 0 && value === 0x7f && pixels[i + 1] === 0xc6 && pixels[i + 2] === 0xb0);
}}"""


def test_a_conflict_of_a_track_leaves_the_edits_of_its_box(page: Screen, live: Live):
    row = choose(page, 3)
    page.page.evaluate("farfieldTest.hold(true)")
    with live.window() as client:
        value = {"box": [*row["box"][:2], row["box"][2] + 1.0, *row["box"][3:]], "class_name": row["class_name"]}
        client.send(op="box.set", id="c-1", frame=0, box=row["id"], base=row["version"], value=value | {"track": 3})
        assert client.until("ack", "conflict", "refused")["op"] == "ack"
    slow(page, 300)
    page.press("p", "Shift+KeyW")
    page.until("state.pending === 2")
    page.until("state.pending === 0")
    assert page.page.get_by_role("button", name="Keep mine").count() == 2


def test_a_selection_ends_with_its_drive(chromium: Any, tmp_path: Path):
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with studio(mode="annotate", extent="full", **place) as live, screen(chromium, live) as page:
        assert [drive["frames"] for drive in page.tell("state.welcome.drives")] == [[0], [1]]
        row = next(row for row in page.boxes if row["track"] is not None)
        page.page.locator(f"#objects tr[data-box='{row['id']}']").click()
        page.until("state.carried !== null")
        page.go(1)
        assert (page.tell("state.carried"), page.tell("state.selection")) == (None, None)
