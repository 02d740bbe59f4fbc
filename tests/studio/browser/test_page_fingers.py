"""One gesture, one finger; and under the help, or behind an undo on its way, nothing is changed that is not shown."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
from _studio_rough_link import ROUGH_LINK
from _studio_scenes import write_folder
from _studio_screen import Screen, screen
from studio.browser.editing import FRAMES, choose, slow, stored
from studio.live import Live, studio

from farfield.datasets import open_dataset

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory):
    place = tmp_path_factory.mktemp("fingers")
    data = write_folder(place / "drive", FRAMES, 8_000)
    settings = {"mode": "annotate", "extent": "full", "edits": place / "edits", "notes": place}
    with studio(lambda: open_dataset(data), **settings) as running:
        yield running


@pytest.fixture(scope="module")
def page(chromium: Any, live: Live):
    with screen(chromium, live, script=ROUGH_LINK) as shown:
        yield shown


def test_a_second_finger_neither_moves_nor_ends_what_the_first_one_does(page: Screen, live: Live, tmp_path: Path):
    row = choose(page, 3)
    session = page.page.context.new_cdp_session(page.page)
    for name in ("close-top", "close-side", "main"):
        page.press("Escape")
        page.click(row["box"][:3])
        page.settled()
        if name == "main":
            page.press("n")
        area = page.page.locator(f"#{name}").bounding_box()
        x, y = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
        one, moved = {"x": x, "y": y, "id": 1}, {"x": x + 12, "y": y + 4, "id": 1}
        other, gone = {"x": x + 70, "y": y + 40, "id": 2}, {"x": x - 60, "y": y + 60, "id": 2}
        touch(session, "touchStart", one)
        touch(session, "touchMove", moved)
        shown = page.tell("sketch.points") if name == "main" else page.box(row["id"])["box"]
        touch(session, "touchStart", moved, other)
        touch(session, "touchMove", moved, gone)
        now = page.tell("sketch.points") if name == "main" else page.box(row["id"])["box"]
        assert now == shown, name
        touch(session, "touchMove", moved)  # the second one goes up
        assert page.page.evaluate("roughLink.sent.filter((m) => m.op === 'fit').length") == 0
        touch(session, "touchEnd")
        page.settled()
        if name != "main":
            assert stored(live)[0][3]["box"] == pytest.approx(shown), name
    page.press("Escape", "Escape")


def touch(session: Any, kind: str, *points: dict[str, float]) -> None:
    session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": list(points)})


@pytest.mark.parametrize("key", ["Delete", "KeyW", "p", "Control+v"])
def test_keys_under_the_help_change_nothing(page: Screen, live: Live, key: str):
    choose(page, 5)
    page.press("Control+c")
    before = stored(live)
    page.press("Shift+Slash")
    page.press(key)
    page.press("Escape")
    page.settled()
    assert stored(live) == before


def test_a_box_of_the_wall_is_no_conflict_with_an_undo_of_ones_own(page: Screen, live: Live):
    choose(page, 3)
    page.press("Shift+KeyW")
    page.settled()
    page.press("v")
    tile = page.page.locator("#over.wall canvas").first
    tile.wait_for()
    page.page.wait_for_timeout(300)
    slow(page, 200)
    page.press("Control+z")
    area = tile.bounding_box()
    x, y = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
    page.drag((x, y), (x + 30, y), steps=3)
    slow(page, 0)
    page.settled()
    page.until("state.pending === 0")
    assert page.page.evaluate("roughLink.conflicts") == 0
    page.press("Escape")
