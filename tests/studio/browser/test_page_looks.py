"""How the pages look at four sizes, and that everything on them is reached and worked by the keyboard."""

from collections.abc import Sequence

import pytest

pytest.importorskip("starlette")
from _studio_scenes import write_folder
from _studio_screen import Screen, screen
from studio.browser.layout import SIZES, axe_faults, layout_faults
from studio.live import studio

from farfield.datasets import open_dataset

pytestmark = pytest.mark.slow

REACHED = """() => {
  const all = [...document.querySelectorAll("button, select, input, [tabindex='0']")];
  const open = (one) => !one.disabled && !one.closest("[inert]") && one.checkVisibility({ visibilityProperty: true });
  return all.filter(open).length;
}"""
FOCUS = """() => {
  const one = document.activeElement, style = getComputedStyle(one), after = getComputedStyle(one, "::after");
  window.reached ??= new Set();
  window.reached.add(one);
  const outlined = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0;
  const seen = outlined || parseFloat(after.borderTopWidth) > 0;
  return [one === document.body ? "" : one.outerHTML.slice(0, 90), seen];
}"""


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory):
    """Both frames that ship, annotated, with a detector on offer."""
    folder = tmp_path_factory.mktemp("looks")
    settings = {"mode": "annotate", "annotator": "kim", "edits": folder / "edits", "notes": folder, "extent": "full"}
    with studio(detectors=("pointpillars-cirrus-sim",), **settings) as live, screen(chromium, live) as shown:
        yield shown


def chosen(page: Screen, frame: int) -> None:
    """Select the box with the most points of a frame."""
    page.press("Escape", "Escape")
    page.go(frame)
    page.until("state.boxes.every((row) => row.points !== null || row.radar_points !== null)")
    row = max(page.boxes, key=lambda one: one["points"] or 0)
    page.look(*row["box"][:2], 30)
    page.click(row["box"][:3])
    page.until("state.selection !== null")
    page.settled()


def faults(page: Screen, sizes: Sequence[tuple[int, int]] = SIZES[::3]) -> list[str]:
    """What is wrong at some sizes, and by axe-core at the last."""
    found = []
    for width, height in sizes:
        page.page.set_viewport_size({"width": width, "height": height})
        page.page.wait_for_timeout(150)
        page.settled()
        found += [f"{width} x {height}: {fault}" for fault in layout_faults(page.page)]
    return found + axe_faults(page.page)


def test_nothing_is_cut_covered_or_off_the_screen_and_axe_refuses_nothing(page: Screen):
    assert faults(page) == []
    chosen(page, 0)
    assert faults(page, SIZES) == []
    page.press("n")
    assert layout_faults(page.page) == []
    page.press("Escape")
    page.press("?")
    assert faults(page) == []
    page.press("Escape")
    chosen(page, 1)  # a radar's map and slice, a camera without a calibration
    page.page.locator(".bar.info").first.wait_for(state="detached")
    assert layout_faults(page.page) == []
    page.page.get_by_role("button", name="View", exact=True).click()
    page.settled()
    assert layout_faults(page.page) == []
    page.page.get_by_role("button", name="Annotate", exact=True).click()


def test_tab_reaches_every_control_and_shows_where_it_is(page: Screen):
    page.page.set_viewport_size({"width": 1440, "height": 900})
    chosen(page, 0)
    page.page.evaluate("window.reached = undefined")
    page.page.evaluate("document.activeElement.blur()")
    count = page.page.evaluate(REACHED)
    unseen = []
    for _ in range(count + 2):  # one goes round through the browser
        page.press("Tab")
        name, seen = page.page.evaluate(FOCUS)
        unseen += [] if seen or not name else [name]
    assert unseen == []
    assert page.page.evaluate("[...reached].filter((one) => one !== document.body).length") == count
    assert page.tell("state.frame") == 0


def test_a_control_that_tab_went_to_keeps_its_keys_and_the_focus(page: Screen):
    chosen(page, 0)
    page.page.locator("#left select[name=colour]").focus()
    page.press("Tab", "Tab")  # past the window of the colour
    page.press("ArrowRight", "ArrowRight")
    assert page.tell("state.frame") == 0, "an arrow on a slider changed the frame"
    assert page.tell("state.pointSize") == pytest.approx(1.7)
    page.press("Tab", "Space")
    assert page.tell("state.grow") is False
    page.page.wait_for_timeout(100)
    page.press("Space")  # the column was built anew
    assert page.tell("state.grow") is True
    assert not page.tell("state.playing")
    page.look(40, 20, 30)
    page.click([40, 20, 0])
    page.press("ArrowRight")
    page.until("state.frame === 1")


def test_the_arrows_go_through_the_objects_and_enter_on_a_row_selects_it(page: Screen):
    page.press("Escape", "Escape")
    page.go(0)
    rows = sorted(page.boxes, key=lambda one: one["distance_m"])
    page.press("ArrowDown", "ArrowDown")
    page.until(f"state.selection === '{rows[1]['id']}'")
    assert page.selected["id"] == rows[1]["id"]
    page.press("ArrowUp")
    page.until(f"state.selection === '{rows[0]['id']}'")
    assert page.selected["id"] == rows[0]["id"]
    page.press("Escape")
    page.page.locator("#timeline button").first.focus()
    page.press("Shift+Tab")
    while page.page.evaluate("document.activeElement.tagName") != "TR":
        page.press("Shift+Tab")
    page.press("Enter")
    page.until("state.selection !== null")
    assert page.selected["id"] == rows[0]["id"]


@pytest.mark.parametrize("code", ["Slash", "Minus", "KeyM"])  # of English, German and French keyboards
def test_a_question_mark_opens_the_keys_on_any_keyboard(page: Screen, code: str):
    chosen(page, 0)
    key = f"new KeyboardEvent('keydown', {{key: '?', code: '{code}', shiftKey: true, bubbles: true, cancelable: true}})"
    page.page.evaluate(f"document.body.dispatchEvent({key})")
    assert "Keys while annotating" in page.text("#help")
    page.press("ArrowRight", "Delete")  # what lies behind waits
    assert page.tell("state.frame") == 0
    assert page.selected is not None
    page.press("Escape")
    assert not page.page.locator("#help").is_visible()
    assert page.selected is not None, "Escape closed the keys and deselected"


def test_ctrl_and_a_letter_is_that_letter_on_any_keyboard(page: Screen):
    chosen(page, 0)
    before = page.selected
    page.press("w")
    page.settled()
    assert page.selected["version"] > before["version"]
    taken = page.tell("state.takenBack")
    key = "new KeyboardEvent('keydown', {key: 'z', code: 'KeyY', ctrlKey: true, bubbles: true, cancelable: true})"
    page.page.evaluate(f"document.body.dispatchEvent({key})")  # of a German keyboard
    page.until(f"state.takenBack > {taken}")
    page.settled()
    assert page.selected["box"] == before["box"]


def test_the_wall_hides_what_it_covers(chromium, tmp_path):
    data = write_folder(tmp_path / "drive", 6, 6_000)
    settings = {"mode": "annotate", "annotator": "kim", "edits": tmp_path / "edits", "notes": tmp_path}
    with (
        studio(lambda: open_dataset(data), extent="full", **settings) as live,
        screen(chromium, live) as page,
    ):
        row = min((one for one in page.boxes if one["box"][0] > 8), key=lambda one: one["distance_m"])
        page.look(*row["box"][:2], 30)
        page.click(row["box"][:3])
        page.settled()
        page.press("v")
        page.page.wait_for_selector("#over.wall canvas")
        page.settled()
        page.page.wait_for_timeout(1500)  # the tiles' frames arrive
        shown = page.page.locator("#over").screenshot()
        for part in ("lines", "gl", "corner"):
            page.page.evaluate(f"document.getElementById('{part}').style.visibility = 'hidden'")
        assert page.page.locator("#over").screenshot() == shown, "lines of the views show through the wall"
        for part in ("lines", "gl", "corner"):
            page.page.evaluate(f"document.getElementById('{part}').style.visibility = ''")
        assert faults(page) == []
        ratios = page.page.evaluate(
            "[...document.querySelectorAll('#over canvas')].map(({width, height}) => width / height)"
        )
        assert ratios == pytest.approx([1.5] * len(ratios), rel=0.03)
        before = [row["state"] for row in page.boxes]
        page.page.get_by_role("button", name="View", exact=True).click()
        page.press("Enter")
        page.settled()
        assert [row["state"] for row in page.boxes] == before
        assert not page.page.locator("#over.wall").is_visible(), "boxes are accepted while they are viewed only"
        page.page.get_by_role("button", name="Annotate", exact=True).click()
        page.press("v")
        page.page.wait_for_selector("#over.wall canvas")
        page.press("?", "Escape")
        assert page.page.locator("#over.wall").is_visible(), "the keys took the wall's place"
        page.press("Tab")
        while page.page.evaluate("document.activeElement.dataset.frame") != "3":
            page.press("Tab")
        page.press("Enter")
        page.until("state.frame === 3")
        assert not page.page.locator("#over.wall").is_visible()
        assert page.page.evaluate("[...document.querySelectorAll('[inert]')].length") == 0
