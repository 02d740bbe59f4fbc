"""Keys and buttons that docs/studio.md names and no other test presses: fit again, ground, ends, whose version."""

import math

import pytest

pytest.importorskip("starlette")
from _studio_scenes import GROUND_M, write_folder
from _studio_screen import Screen, screen
from studio.browser.cutting import Line
from studio.live import studio

from farfield.datasets import open_dataset

FRAMES = 3


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("work") / "drive", FRAMES, 24_000)


@pytest.fixture(scope="module")
def settings(tmp_path_factory):
    place = tmp_path_factory.mktemp("kept")
    return {"mode": "annotate", "annotator": "kim", "edits": place / "edits", "notes": place}


@pytest.fixture(scope="module")
def live(data, settings):
    with studio(lambda: open_dataset(data), **settings) as running:
        yield running


@pytest.fixture(scope="module")
def page(chromium, live):
    with screen(chromium, live) as shown:
        yield shown


def chosen(page: Screen, track: int) -> dict:
    """Look at an object from above and click it."""
    page.press("Escape", "Escape")
    page.go(0)
    row = next(row for row in page.boxes if row["track"] == track)
    page.look(*row["box"][:2], 25)
    page.click(row["box"][:3])
    page.settled()
    assert page.selected["track"] == track
    return page.selected


def pressed(page: Screen, *keys: str) -> dict:
    """Press keys; the selected box when all is saved."""
    page.press(*keys)
    page.settled()
    return page.selected


def test_what_boxes_hold_is_declared_once_by_a_button(page: Screen):
    assert page.tell("colours()") > 60
    if page.tell("state.welcome.extent") is None:
        page.page.get_by_role("button", name="whole bodies").click()
    page.until("state.welcome.extent === 'full'")
    assert "whole bodies" in page.text("#header")
    assert page.page.locator("#header button:has-text('visible parts')").count() == 0


def test_a_box_pushed_away_is_fitted_back_and_keeps_its_size_with_shift(page: Screen):
    row = chosen(page, 1)
    away = pressed(page, "Shift+KeyW")
    assert math.dist(away["box"][:2], row["box"][:2]) == pytest.approx(0.5, abs=1e-3)
    before = page.tell("fitTimes.length")
    page.press("Shift+KeyX")
    page.until(f"fitTimes.length > {before}")
    page.settled()
    back = page.selected
    assert math.dist(back["box"][:2], row["box"][:2]) < 0.3
    assert back["box"][3:5] == pytest.approx(away["box"][3:5], abs=1e-6)
    before = page.tell("fitTimes.length")
    page.press("x")
    page.until(f"fitTimes.length > {before}")
    page.settled()
    assert math.dist(page.selected["box"][:2], row["box"][:2]) < 0.3


def test_drop_to_the_ground_quarter_turn_and_duplicate(page: Screen):
    row = chosen(page, 2)
    pressed(page, "Shift+KeyR", "Shift+KeyR")
    assert page.selected["box"][2] == pytest.approx(row["box"][2] + 1.0, abs=1e-3)
    dropped = pressed(page, "b")
    assert dropped["box"][2] - dropped["box"][5] / 2 == pytest.approx(GROUND_M, abs=0.25)  # few points of it here
    turned = pressed(page, "Shift+KeyG")
    assert math.sin(turned["box"][6] - dropped["box"][6]) == pytest.approx(1, abs=1e-6)
    count = len(page.boxes)
    twin = pressed(page, "Control+d")
    assert len(page.boxes) == count + 1
    assert twin["track"] not in (None, 2)
    assert math.dist(twin["box"][:2], turned["box"][:2]) == pytest.approx(turned["box"][4] + 0.5, abs=1e-3)


def test_an_object_that_ends_says_so_and_can_go_on(page: Screen):
    chosen(page, 3)
    page.press("o")
    page.until("state.tracks.get(3).ends === 0")
    assert "ends at 1" in page.text("#inspector")
    page.press("o")
    page.until("state.tracks.get(3).ends === null")


def test_only_the_selection_is_shown_and_followed(page: Screen):
    row = chosen(page, 4)
    page.press("h")
    page.settled()
    assert page.page.locator("#objects tr.one").count() == 1
    page.press("h", "Shift+Enter")
    page.go(1)
    there = page.selected
    assert there["track"] == 4
    assert page.tell("stage.eye.target")[:2] == pytest.approx(there["box"][:2], abs=1e-6)
    assert there["box"][:2] != row["box"][:2]
    page.press("Shift+Enter")


def test_a_finding_is_let_stand_with_a_reason(page: Screen):
    row = chosen(page, 5)
    field = page.page.locator("#inspector input[name=h]")
    field.fill("9")
    field.press("Enter")
    page.until(f"state.checks.some((found) => found.box === '{row['id']}' && found.frame === 0)")
    mine = f"[...farfieldTest.state.checks].filter((found) => found.box === '{row['id']}' && found.ignored === null)"
    before = page.page.evaluate(f"{mine}.length")
    finding = page.page.locator("#checks .finding").first
    finding.get_by_role("button", name="ignore").click()
    page.page.locator("#checks input[placeholder=reason]").fill("a crane")
    page.page.locator("#checks input[placeholder=reason]").press("Enter")
    page.until("state.checks.some((found) => found.ignored === 'a crane')")
    assert page.page.evaluate(f"{mine}.length") <= before
    done = page.tell("state.takenBack")
    page.press("Control+z")
    page.until(f"state.takenBack > {done}")
    page.settled()


def test_their_version_of_a_box_is_kept_where_a_person_says_so(chromium, live, page: Screen):
    row = chosen(page, 6)
    with screen(chromium, live) as other:
        page.until("state.windows === 2")
        other.look(*row["box"][:2], 25)
        other.click(row["box"][:3])
        other.page.evaluate("farfieldTest.hold(true)")
        first = pressed(page, "w")
        other.press("a")
        other.page.evaluate("farfieldTest.hold(false)")
        other.page.get_by_role("button", name="Keep theirs").click()
        other.settled()
        assert other.box(row["id"])["box"] == pytest.approx(first["box"])
    page.settled()
    assert page.box(row["id"])["box"] == pytest.approx(first["box"])


def wait_until_unlocked(page, origin):
    """Wait until the browser has noticed that the window is closed: until then its edits are its own."""
    page.goto(f"{origin}/nothing")  # of the same origin, and holds no lock itself
    for _ in range(200):
        if page.evaluate("navigator.locks.query().then((found) => found.held.length)") == 0:
            return
        page.wait_for_timeout(50)
    raise AssertionError("the closed window still holds its lock")


@pytest.fixture
def parted(chromium, live):
    """A line to the studio that can be cut, and pages of one browser that come to it by that line."""
    line, origin = Line(live.port), live.origin
    live.origin = f"http://127.0.0.1:{line.port}"
    name, _, value = live.cookie.partition("=")
    context = chromium.new_context(viewport={"width": 1280, "height": 800})
    try:
        context.add_cookies([{"name": name, "value": value, "url": live.origin}])
        yield line, *(Screen(context.new_page(), live.origin) for _ in range(2))
    finally:
        live.origin = origin
        context.close()
        line.close()


def opened(window, origin):
    """Open the studio in a window."""
    window.page.goto(f"{origin}/?test=1&frame=0")
    window.settled()


def assert_sent(window, row, wanted):
    """Wait until a window has sent the edit of another one, and look at the box."""
    window.until(f"state.boxes.find((one) => one.id === '{row['id']}').version > {row['version']}")
    window.until("state.connected && farfieldTest.state.pending === 0")
    assert wanted != row["box"]
    assert window.box(row["id"])["box"] == pytest.approx(wanted)


def test_edits_of_a_window_that_was_closed_unsent_are_sent_by_a_new_one(live, parted):
    line, first, second = parted
    opened(first, live.origin)
    row = chosen(first, 7)
    line.cut()
    first.until("state.connected === false")
    first.press("w")
    first.until("state.pending === 1")
    wanted = first.selected["box"]
    first.page.close()
    line.join()
    wait_until_unlocked(second.page, live.origin)
    opened(second, live.origin)
    assert_sent(second, row, wanted)


def test_edits_of_a_window_that_is_closed_later_are_sent_by_one_that_waits(live, parted):
    line, first, second = parted
    opened(first, live.origin)
    row = chosen(first, 8)
    first.page.evaluate("() => { window.WebSocket = class { send() {} close() {} } }")  # it alone stays cut off
    line.cut()
    first.until("state.connected === false")
    first.press("w")
    first.until("state.pending === 1")
    wanted = first.selected["box"]
    line.join()
    opened(second, live.origin)
    assert second.box(row["id"])["box"] == pytest.approx(row["box"])
    assert first.page.evaluate("farfieldTest.state.pending") == 1
    first.page.close()
    assert_sent(second, row, wanted)
