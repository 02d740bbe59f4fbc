"""What a person sees and does without changing a label."""

import json
import math

import pytest

pytest.importorskip("starlette")
from _studio_screen import Screen, screen
from studio.live import studio

VISIBLE = (
    "[...farfieldTest.stage.clouds.values()].filter(({layer}) => farfieldTest.stage.inPane(layer.name, layer, 0))"
    ".map(({object}) => object.set.count)"
)


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    with studio(notes=tmp_path_factory.mktemp("notes")) as running:
        yield running


@pytest.fixture(scope="module")
def page(chromium, live):
    with screen(chromium, live) as shown:
        yield shown


@pytest.fixture(autouse=True)
def _same_start(page: Screen):
    page.press("Escape", "Escape")
    page.go(0)


def test_canvas_is_not_blank(page: Screen):
    assert page.tell("colours()") > 60  # distinct colours; a blank canvas has 1 or 2
    drawn = page.tell("drawn()")
    assert drawn["frame"] == 0
    assert drawn["points"] > 10_000
    assert drawn["whole"]


def test_nothing_comes_from_elsewhere_and_nothing_fails(page: Screen):
    assert page.foreign == []
    assert page.errors == []


def test_edits_that_the_browser_keeps_are_not_taken_up_where_boxes_are_viewed_only(page: Screen):
    edit = {"op": "box.set", "id": "old-1", "frame": 0, "box": "0:1", "base": 0, "value": {}}
    names = [f"farfield-edits {page.tell('state.welcome.' + part)} old" for part in ("data", "store")]
    for name in names:
        page.page.evaluate("([name, text]) => localStorage.setItem(name, text)", [name, json.dumps([edit])])
    page.page.reload()
    page.page.wait_for_function("window.farfieldTest !== undefined")
    page.settled()
    assert [page.page.evaluate("(name) => localStorage.getItem(name)", name) for name in names] == [
        json.dumps([edit])
    ] * 2
    page.page.evaluate("localStorage.clear()")
    assert page.text("#bars") == ""


def test_arrow_keys_change_the_frame_and_the_place_is_shown(page: Screen):
    page.press("ArrowRight")
    page.settled()
    assert page.tell("drawn()")["frame"] == 1
    assert "kradar" in page.text("#header")
    assert page.text("#conditions").strip()
    page.press("Home")
    page.settled()
    assert page.tell("drawn()")["frame"] == 0


def test_a_drag_on_the_timeline_scrubs(page: Screen):
    strip = page.page.locator("#timeline canvas").bounding_box()
    y = strip["y"] + strip["height"] / 2
    page.drag((strip["x"] + 8, y), (strip["x"] + strip["width"] - 8, y))
    page.settled()
    assert page.tell("drawn()")["frame"] == 1


def test_play_ends_at_the_last_frame(page: Screen):
    page.press("Space")
    page.until("state.playing === false && farfieldTest.state.frame === 1")
    page.settled()
    assert page.tell("drawn()")["frame"] == 1


def test_a_click_selects_the_box_under_it_and_the_close_ups_show_its_points(page: Screen):
    row = max(page.boxes, key=lambda box: box["points"] or 0)
    page.look(*row["box"][:2], 30)
    page.click(row["box"][:3])
    assert page.selected["id"] == row["id"]
    page.settled()
    assert page.tell("closePoints()") >= row["points"]
    assert float(page.page.locator("#inspector input[name=l]").input_value()) == pytest.approx(row["box"][3], abs=6e-3)
    page.press("Escape")
    assert page.selected is None


def test_the_arrows_walk_through_the_objects_by_distance(page: Screen):
    page.press("ArrowDown", "ArrowDown")
    rows = sorted(page.boxes, key=lambda box: box["distance_m"])
    assert page.selected["id"] == rows[1]["id"]
    page.press("ArrowUp")
    assert page.selected["id"] == rows[0]["id"]


def test_only_a_sample_is_drawn_while_the_view_moves_and_all_of_it_after(page: Screen):
    page.go(1)
    points = page.page.locator("#left input[name='layer radar']").first
    points.click()
    page.settled()
    whole = page.tell("drawn()")["points"]
    assert whole > 25_000
    seen = page.page.evaluate_handle(
        """({points: new Promise((done) => {
            const look = () => {
                const { whole, points } = farfieldTest.drawn();
                if (whole) setTimeout(look, 1); else done(points);
            };
            look();
        })})"""
    )
    page.page.mouse.move(600, 300)
    page.page.mouse.down()
    page.page.mouse.move(640, 310, steps=3)
    assert page.page.evaluate("(held) => held.points", seen) == pytest.approx(20_000, abs=5)
    page.page.mouse.up()
    page.settled()
    assert page.tell("drawn()")["points"] == whole
    page.page.locator("#left input[name='layer radar']").first.click()


def test_a_drag_turns_the_view_and_the_wheel_comes_nearer(page: Screen):
    page.look(20, 0, 40, top=False)
    before = page.tell("stage.eye.azimuth"), page.tell("stage.eye.distance")
    page.drag((600, 300), (680, 320))
    page.page.mouse.wheel(0, -200)
    page.settled()
    assert page.tell("stage.eye.azimuth") != before[0]
    assert page.tell("stage.eye.distance") < before[1]


def test_every_colour_is_drawn(page: Screen):
    names = page.page.locator("#left select[name=colour] option").evaluate_all("rows => rows.map((row) => row.value)")
    assert {"height", "range", "pattern", "intensity"} <= set(names)
    seen = {}
    for _ in names:
        page.press("l")
        page.settled()
        seen[page.tell("state.colour")] = page.tell("colours()")
    assert set(seen) == set(names)
    values = page.page.evaluate(
        """() => { const most = {};
        for (const {object} of farfieldTest.stage.clouds.values()) for (const [name, column] of object.set.values)
            most[name] = Math.max(most[name] ?? 0, new Set(column.rows).size);
        return most; }"""
    )
    for name, count in seen.items():  # a field of a few values has as many colours, and the background one
        assert count > (1 if name == "pattern" else min(values.get(name, 11), 10)), (name, values)


def test_two_panes_stand_side_by_side(page: Screen):
    page.press("Backslash")
    page.settled()
    assert page.tell("stage.panes().length") == 2
    assert page.tell("drawn()")["points"] == 2 * sum(page.page.evaluate(VISIBLE))
    page.press("Backslash")
    page.settled()
    assert page.tell("stage.panes().length") == 1


def test_the_tape_measures_between_two_clicks(page: Screen):
    page.look(20, 0, 40)
    page.press("m")
    page.click((15, 3, -1.5))
    page.click((25, -4, -1.5))
    first, second = page.tell("state.tape")
    assert math.dist(first[:2], second[:2]) == pytest.approx(math.hypot(10, 7), abs=0.5)
    page.press("Escape")


def test_filters_hide_classes_and_ranges(page: Screen):
    count = page.page.locator("#objects tr.one").count
    page.settled()
    rows = page.boxes
    assert count() == len(rows)
    name = rows[0]["class_name"]
    box = page.page.locator(f"#left input[name='class {name}']")
    box.click()
    page.settled()
    assert count() == sum(row["class_name"] != name for row in rows)
    page.page.locator(f"#left input[name='class {name}']").click()
    far = page.page.locator("#left input[name=to]")
    far.fill("30")
    page.settled()
    assert count() == sum(row["distance_m"] <= 30 for row in rows)
    page.page.locator("#left input[name=to]").fill("400")
    page.settled()
    assert count() == len(rows)


def test_the_radar_map_is_drawn_and_its_view_from_the_front_follows_the_selection(page: Screen):
    page.go(1)
    assert page.page.evaluate("farfieldTest.stage.maps.size") == 1
    before = page.tell("colours()")
    page.page.locator("#left input[name='layer radar']").last.click()
    page.settled()
    assert page.tell("colours()") != before
    page.page.locator("#left input[name='layer radar']").last.click()
    page.press("Escape")
    page.page.wait_for_selector("#slice")
    assert "radar from the front" in page.text("#slices")
    page.press("ArrowDown")
    page.until("closeRadar() !== null")
    assert page.page.locator("#slice").count() == 0
    assert " to " in page.text("#close-radar")


def test_cameras_show_points_and_boxes(page: Screen):
    page.go(1)
    page.page.wait_for_selector("[data-camera='cam-front'] canvas")
    shown = page.page.evaluate(
        """() => { const c = document.querySelector("[data-camera='cam-front'] canvas");
        const d = new Uint32Array(c.getContext("2d").getImageData(0, 0, c.width, c.height).data.buffer);
        return new Set(d).size; }"""
    )
    assert shown > 500


def test_a_larger_camera_shows_every_pixel_of_its_file(page: Screen):
    asked: list[str] = []
    page.page.on("request", lambda request: asked.append(request.url) if "/image/" in request.url else None)
    page.page.wait_for_selector(".camera canvas")
    with page.page.expect_response(lambda answer: "exact=1" in answer.url) as waiting:
        page.page.locator(".camera canvas").first.click()
    assert waiting.value.status == 200
    page.page.locator(".camera.big canvas").wait_for()
    assert sum("exact=1" in url for url in asked) == 1
    page.page.locator(".camera canvas").first.click()
    page.page.locator(".camera:not(.big) canvas").first.wait_for()


def test_a_larger_camera_does_not_hide_the_points(page: Screen):
    from io import BytesIO

    from PIL import Image

    page.page.wait_for_selector(".camera canvas")
    page.page.locator(".camera canvas").first.click()
    page.settled()
    page.page.wait_for_timeout(800)
    page.page.evaluate("document.getElementById('lines').style.visibility = 'hidden'")
    box = page.page.locator("#main").bounding_box()
    picture = Image.open(BytesIO(page.page.screenshot(clip={**box, "y": box["y"] + 30, "height": box["height"] - 40})))
    page.page.evaluate("document.getElementById('lines').style.visibility = ''")
    page.page.locator(".camera canvas").first.click()
    page.settled()
    assert len(picture.convert("RGB").getcolors(1 << 20) or ()) > 60


def test_a_bookmark_is_kept(chromium, live, page: Screen):
    page.press("k")
    page.until("state.bookmarks.length === 1")
    with screen(chromium, live) as other:
        assert [mark["frame"] for mark in other.tell("state.bookmarks")] == [0]
        assert other.tell("state.windows") == 2
    page.press("k")
    page.until("state.bookmarks.length === 0")


def test_help_shows_every_key_of_the_mode(page: Screen):
    page.press("Shift+Slash")
    text = page.text("#help")
    assert "measuring tape" in text
    assert "carry the object on" not in text  # a key of annotating
    page.press("Escape")
    assert not page.page.locator("#help").is_visible()


def test_a_lost_context_comes_back(page: Screen):
    before = page.tell("colours()")
    page.page.evaluate(
        """async () => { const lose = farfieldTest.stage.renderer.getContext().getExtension("WEBGL_lose_context");
        lose.loseContext(); await new Promise((done) => setTimeout(done, 300)); lose.restoreContext();
        await new Promise((done) => setTimeout(done, 500)); }"""
    )
    page.settled()
    assert page.tell("colours()") == pytest.approx(before, rel=0.2)


def test_a_picture_is_saved(chromium, live, tmp_path):
    with screen(chromium, live, downloads=tmp_path) as shown:
        with shown.page.expect_download() as waiting:
            shown.page.get_by_role("button", name="Picture").click()
        waiting.value.save_as(tmp_path / "picture.png")
    from PIL import Image

    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.width > 700
        assert len(picture.convert("RGB").getcolors(1 << 20) or ()) > 60


def test_one_file_of_html_opens_from_disk_without_a_network(chromium, live, tmp_path):
    with screen(chromium, live, frame=1, downloads=tmp_path) as shown:
        with shown.page.expect_download() as waiting:
            shown.page.get_by_role("button", name="HTML").click()
        waiting.value.save_as(tmp_path / "frame.html")
    context = chromium.new_context(offline=True, viewport={"width": 1280, "height": 800})
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"file://{tmp_path}/frame.html?test=1")
    page.evaluate("farfieldTest.waitIdle()")
    assert page.evaluate("farfieldTest.colours()") > 60
    assert page.evaluate("farfieldTest.state.boxes.length") > 3
    assert errors == []
    context.close()
    assert (tmp_path / "frame.html").stat().st_size < 2_000_000


def test_conditions_are_said(page: Screen):
    page.go(1)
    told = json.loads(page.page.evaluate("JSON.stringify(farfieldTest.state.shown.frame.conditions)"))
    assert all(value.replace("_", " ") in page.text("#conditions") for value in told.values())
