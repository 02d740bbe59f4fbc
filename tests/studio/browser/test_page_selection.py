"""What stays selected from frame to frame, where a box of the same identity is another object; its next box drawn."""

import json
import math

import numpy as np
import pytest

pytest.importorskip("starlette")
from _studio_scenes import vehicles, write_folder
from _studio_screen import Screen, screen
from scipy.spatial import cKDTree
from studio.live import studio

from farfield.datasets import open_dataset

GONE = 2  # the object that the second frame has no box of, by its place


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Three frames: labels of the second stand in the reverse order and lack one object; the third has none."""
    folder = write_folder(tmp_path_factory.mktemp("order") / "drive", 3, 48_000)
    for frame in (1, 2):
        path = folder / f"{frame:06d}.json"
        entries = json.loads(path.read_text())["boxes"]
        kept = [entry for entry in reversed(entries) if entry["track_id"] != GONE + 1] if frame == 1 else []
        path.write_text(json.dumps({"boxes": kept}))
    return folder


@pytest.fixture
def page(chromium, data, tmp_path):
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with (
        studio(lambda: open_dataset(data), mode="annotate", extent="full", **place) as live,
        screen(chromium, live) as shown,
    ):
        yield shown


def click_track(page: Screen, track: int) -> dict:
    """Look at an object from above and click it."""
    row = next(row for row in page.boxes if row["track"] == track)
    page.look(*row["box"][:2], 25)
    page.click(row["box"][:3])
    page.settled()
    assert page.selected["track"] == track
    return row


def test_the_same_object_stays_selected_not_the_box_of_the_same_identity(page: Screen):
    assert page.tell("colours()") > 60
    row = click_track(page, 5)
    page.go(1)
    assert page.selected["track"] == 5
    assert page.selected["id"] != row["id"]
    assert all(other["id"] != row["id"] for other in page.boxes)
    page.go(0)
    assert page.selected["id"] == row["id"]


def test_what_was_deselected_stays_so_in_the_next_frame(page: Screen):
    click_track(page, 5)
    page.press("Escape")
    assert page.selected is None
    page.go(1)
    assert page.selected is None


def test_an_object_without_a_box_here_is_selected_again_where_it_has_one(page: Screen):
    click_track(page, GONE + 1)
    page.go(1)
    assert page.selected is None
    assert f"Object {GONE + 1} has no box in this frame" in page.text("#inspector")
    page.go(0)
    assert page.selected["track"] == GONE + 1


def test_a_drag_draws_the_next_box_of_the_object_with_its_locked_size(page: Screen):
    row = click_track(page, GONE + 1)
    field = page.page.locator("#inspector input[name=l]")
    field.fill("4.70")
    field.press("Enter")
    page.press("Escape")
    click_track(page, GONE + 1)
    page.press("Control+l")
    page.until(f"state.tracks.get({GONE + 1}).size_locked === true && farfieldTest.state.pending === 0")
    page.go(1)
    truth = vehicles(1)[GONE]
    page.look(*truth[:2], 20)
    page.press("n")
    assert f"object {GONE + 1}" in page.text("#hint")
    rear, front = ([truth[0] + way * 2 * math.cos(truth[6]), truth[1], truth[2]] for way in (-1, 1))
    page.drag(page.pixel(rear), page.pixel(front))
    page.until("state.selection !== null")
    page.settled()
    made = page.selected
    assert made["track"] == GONE + 1
    assert made["class_name"] == row["class_name"]
    assert made["box"][3] == pytest.approx(4.7)
    assert math.dist(made["box"][:2], truth[:2]) < 0.4
    page.until(f"state.tracks.get({GONE + 1}).frames.join() === '0,1'")


def test_after_escape_a_drag_draws_another_object(page: Screen):
    click_track(page, 1)
    page.go(2)
    page.press("Escape")
    truth = vehicles(2)[0]
    page.look(*truth[:2], 20)
    page.press("n")
    rear, front = ([truth[0] + way * 2 * math.cos(truth[6]), truth[1], truth[2]] for way in (-1, 1))
    page.drag(page.pixel(rear), page.pixel(front))
    page.until("state.selection !== null")
    page.settled()
    assert page.selected["track"] > 20


def alone(data) -> list[float]:
    """A point of the third frame that has no other within 1.2 m, seen from above."""
    places = np.fromfile(data / "000002.bin", "<f4").reshape(-1, 4)[:, :3].astype(float)
    apart = cKDTree(places[:, :2]).query(places[:, :2], k=2)[0][:, 1]
    apart[(np.abs(places[:, 0]) > 90) | (np.abs(places[:, 1]) > 90)] = 0
    assert apart.max() > 1.2
    return places[int(np.argmax(apart))].tolist()


def test_a_point_beside_the_pointer_does_not_turn_the_drag(page: Screen, data):
    """The press snaps to a point up to 7 pixels away; the heading is the pointer's own way."""
    page.go(2)
    point, wanted = alone(data), math.radians(3)
    page.look(*point[:2], 45)  # 7 pixels are half a metre: such a drag would be turned by 7 degrees
    page.press("n")
    start = [point[0] + 0.4 * math.sin(wanted), point[1] - 0.4 * math.cos(wanted), point[2]]
    end = [start[0] + 3 * math.cos(wanted), start[1] + 3 * math.sin(wanted), point[2]]
    page.page.mouse.move(*page.pixel(start))
    page.page.mouse.down()
    page.page.mouse.move(*page.pixel(end), steps=4)
    drawn, line = page.tell("sketch.box"), page.tell("sketch.points")
    page.page.mouse.up()
    assert math.dist(line[0][:2], point[:2]) < 0.01  # it did snap
    assert drawn[6] == pytest.approx(wanted, abs=math.radians(1))
