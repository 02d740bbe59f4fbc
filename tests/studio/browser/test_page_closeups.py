"""Close-ups as rooms to work in: sized, large, moved and zoomed; the radar's power, echoes and heights in them."""

import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
from _studio_rough_link import ROUGH_LINK
from _studio_screen import Screen, screen
from studio.live import studio

from farfield.geometry.poses import transform_points
from farfield.studio.samples import open_samples

REACH_M = 10.0


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory):
    folder = tmp_path_factory.mktemp("close")
    place = {"edits": folder / "edits", "notes": folder}
    with (
        studio(mode="annotate", annotator="kim", extent="full", **place) as live,
        screen(chromium, live, frame=1, script=ROUGH_LINK) as shown,
    ):
        yield shown


def chosen(page: Screen) -> dict[str, Any]:
    """The vehicle with the most points between 8 and 60 m, looked at and clicked."""
    rows = [row for row in page.boxes if 8 < row["distance_m"] < 60]
    row = max(rows, key=lambda one: one["points"] or 0)
    if page.tell("state.selection") != row["id"]:
        page.look(*row["box"][:2], 25)
        page.click(row["box"][:3])
        page.settled()
    assert page.selected["id"] == row["id"]
    return page.selected


def area(page: Screen, selector: str) -> dict[str, float]:
    return page.page.locator(selector).bounding_box()


def close(page: Screen, name: str, place: list[float]) -> tuple[float, float]:
    x, y = page.tell(f"closeUp('{name}', {list(map(float, place))})")
    return x, y


def undone(page: Screen) -> None:
    before = page.tell("state.takenBack")
    page.press("Control+z")
    page.until(f"state.takenBack > {before}")
    page.settled()


STALE = """() => ["gl", "lines"].map((id) => document.getElementById(id)).map((canvas) => {
  const before = canvas.toDataURL();
  farfieldTest.stage.whole();
  return canvas.toDataURL() !== before;
})"""
BEYOND = """() => {
  const lines = document.getElementById("lines");
  const room = document.getElementById("closeups").getBoundingClientRect();
  const ratio = lines.width / innerWidth;
  return [[0, room.top], [room.bottom, innerHeight]].some(([top, bottom]) => {
    const part = [room.x, top, room.width, bottom - top].map((value) => value * ratio);
    return lines.getContext("2d").getImageData(...part).data.some((value) => value);
  });
}"""


def test_they_are_sized_and_laid_over_the_main_view_and_that_is_remembered(page: Screen):
    row = chosen(page)
    before = area(page, "#close-side")
    grip = area(page, "#close-side .grip")
    page.drag((grip["x"] + 100, grip["y"] + 3), (grip["x"] + 100, grip["y"] + 43))
    page.drag((area(page, "#grip-width")["x"] + 3, 500), (area(page, "#grip-width")["x"] - 57, 500))
    now = area(page, "#close-side")
    assert now["height"] == pytest.approx(before["height"] + 40, abs=1)
    assert now["width"] == pytest.approx(before["width"] + 60, abs=2)
    page.page.locator("#close-side .grip").focus()
    page.press("ArrowUp")
    assert area(page, "#close-side")["height"] == pytest.approx(before["height"] + 24, abs=1)
    main = area(page, "#main")
    page.page.mouse.move(main["x"] + 5, main["y"] + 5)
    page.press("Shift+T")
    assert area(page, "#close-top")["width"] == pytest.approx(main["width"] / 2, abs=2)
    assert area(page, "#close-radar")["y"] > area(page, "#close-side")["y"]
    page.settled()
    page.page.locator("button[name='large side']").click()
    page.settled()
    assert page.page.evaluate(STALE) == [False, False], "the picture of all four"
    page.page.locator("button[name='large side']").click()
    page.page.mouse.move(main["x"] + 5, main["y"] + 5)
    page.press("Shift+T")
    page.page.mouse.move(area(page, "#close-side")["x"] + 50, area(page, "#close-side")["y"] + 50)
    page.press("Shift+T")
    large = area(page, "#close-side")
    assert large["width"] == pytest.approx(main["width"], abs=2)
    assert large["height"] == pytest.approx(main["height"], abs=2)
    assert not page.page.locator("#close-top").is_visible()
    assert page.tell("colours()") > 10  # the picture is the close-up's, not an empty one
    box = row["box"]
    top, higher = (close(page, "side", [*box[:2], box[2] + box[5] / 2 + up]) for up in (0.0, 0.4))
    page.drag(top, higher)
    page.settled()
    after = page.selected["box"]
    assert after[5] == pytest.approx(box[5] + 0.4, abs=0.02)
    assert after[2] - after[5] / 2 == pytest.approx(box[2] - box[5] / 2, abs=1e-3)
    edit = page.page.evaluate("roughLink.sent.filter((m) => m.op === 'box.set').at(-1)")
    assert (edit["frame"], edit["box"], edit["base"]) == (1, row["id"], row["version"])
    undone(page)
    page.page.reload()
    page.page.wait_for_function("window.farfieldTest !== undefined")
    page.settled()
    assert page.page.evaluate("document.body.dataset.close") == ""  # nothing is selected yet
    page.page.locator(f"#objects tr[data-box='{row['id']}']").click()
    page.settled()
    assert area(page, "#close-side")["width"] == pytest.approx(large["width"], abs=2)
    page.press("Shift+T")
    assert area(page, "#close-side")["height"] == pytest.approx(before["height"] + 24, abs=1)
    high = page.page.evaluate("document.getElementById('close-top').style.getPropertyValue('--high')")
    page.page.evaluate("document.getElementById('close-top').style.setProperty('--high', '500px')")
    page.page.evaluate("new Promise(requestAnimationFrame)")
    page.page.evaluate("document.getElementById('closeups').scrollTop = 150")
    page.page.evaluate("new Promise(requestAnimationFrame)")
    page.settled()
    assert page.page.evaluate(STALE) == [False, False], "the picture stands where it was before it was scrolled"
    assert page.page.evaluate(BEYOND) is False, "lines over the header or the inspector"
    page.page.evaluate("(high) => document.getElementById('close-top').style.setProperty('--high', high)", high)
    page.settled()
    assert page.errors == []


@pytest.mark.parametrize("name", ["top", "side", "front", "radar"])
def test_each_is_zoomed_at_the_pointer_and_moved(page: Screen, name: str):
    box = chosen(page)["box"]
    rect = area(page, f"#close-{name}")
    aside = (rect["x"] + rect["width"] - 30, rect["y"] + rect["height"] - 22)  # beside the box
    start = close(page, name, box[:3])
    page.page.mouse.move(*aside)
    page.page.mouse.wheel(0, 240)
    page.settled()
    smaller = close(page, name, box[:3])
    factor = math.exp(240 * 0.0015)
    for i in (0, 1):
        assert smaller[i] - aside[i] == pytest.approx((start[i] - aside[i]) / factor, abs=0.6)
    page.drag(aside, (aside[0] - 40, aside[1] - 10))
    page.settled()
    moved = close(page, name, box[:3])
    assert moved == pytest.approx((smaller[0] - 40, smaller[1] - 10), abs=0.6)
    page.page.mouse.move(*aside)
    page.page.mouse.down()
    page.page.mouse.move(aside[0] - 30, aside[1], steps=3)
    page.press("Escape")
    page.page.mouse.up()
    page.settled()
    assert page.selected is not None
    assert close(page, name, box[:3]) == pytest.approx(moved, abs=0.01)
    assert page.selected["box"] == box
    page.page.locator(f"#close-{name} .tools button").first.click()
    page.settled()
    assert close(page, name, box[:3]) == pytest.approx(
        (rect["x"] + rect["width"] / 2, rect["y"] + rect["height"] / 2), abs=1
    )


def test_the_radar_is_drawn_in_them_and_its_view_sets_height_and_z(page: Screen):
    row = chosen(page)
    box = row["box"]
    page.until("closeRadar() !== null")
    frame = open_samples()[1]
    radar = np.concatenate(
        [
            transform_points(pose, frame.cloud(name).points_m)
            if (pose := frame.sensors[name].frame_T_sensor) is not None and not frame.sensors[name].in_frame
            else frame.cloud(name).points_m
            for name in frame.clouds
            if frame.sensors[name].kind == "radar"
        ]
    )
    near = (np.abs(radar[:, :2] - box[:2]).max(axis=1) < REACH_M).sum()
    lidar = frame.cloud().points_m
    both = near + (np.abs(lidar[:, :2] - box[:2]).max(axis=1) < REACH_M).sum()
    assert near > 0
    assert page.tell("closePoints()") == pytest.approx(both, abs=max(5, 0.1 * both))
    assert page.page.locator("#slice").count() == 0  # the map over all ranges gives way to the close-up
    assert "RADAR" in page.text("#close-radar")
    assert -3 < page.tell("closeRadar().ground") < 0
    page.page.locator("#close-radar input[name=gate]").fill("4")
    page.press("Enter")
    page.settled()
    assert page.page.evaluate("localStorage.getItem('farfield-settings radar gate')") == "4"
    with_map = page.tell("colours()")
    for part, by, expected in (
        (-box[5] / 2, -0.3, [*box[:2], box[2] - 0.15, *box[3:5], box[5] + 0.3, box[6]]),
        (box[5] / 2, 0.3, [*box[:2], box[2] + 0.15, *box[3:5], box[5] + 0.3, box[6]]),
        (0.0, 0.3, [*box[:2], box[2] + 0.3, *box[3:]]),
    ):
        page.drag(close(page, "radar", [*box[:2], box[2] + part]), close(page, "radar", [*box[:2], box[2] + part + by]))
        page.settled()
        assert page.selected["box"] == pytest.approx(expected, abs=0.04)
        assert page.selected["box"][:2] == box[:2]
        undone(page)
    x, y = close(page, "radar", [*box[:2], box[2] + box[5] / 2])
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x, y - 15, steps=3)
    page.press("Escape")
    page.page.mouse.move(x, y - 30, steps=2)
    page.page.mouse.up()
    page.settled()
    assert page.selected["box"] == box
    page.page.locator("#left input[name='layer radar']").last.click()
    page.settled()
    assert page.tell("closeRadar()") is None
    assert page.tell("colours()") != with_map
    page.page.locator("#left input[name='layer radar']").last.click()
    assert page.errors == []
