"""Boxes drawn, moved, sized and saved with a person's clicks, drags and keys."""

import json
import math

import numpy as np
import pytest

pytest.importorskip("starlette")
from _studio_screen import Screen, screen
from studio.live import studio


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("hand")


@pytest.fixture(scope="module")
def live(folder):
    with studio(mode="annotate", annotator="kim", edits=folder / "edits", notes=folder, extent="full") as running:
        yield running


@pytest.fixture(scope="module")
def page(chromium, live):
    with screen(chromium, live) as shown:
        yield shown


@pytest.fixture(autouse=True)
def _same_start(page: Screen):
    page.press("Escape", "Escape")
    page.go(0)


def dense(page: Screen, place: int = 0) -> dict:
    """A box with many points that is not beside the sensor."""
    rows = [row for row in page.boxes if row["distance_m"] < 60 and row["class_name"] == "vehicle"]
    return sorted(rows, key=lambda row: -(row["points"] or 0))[place]


def near(page: Screen) -> dict:
    """The vehicle at 16 m of the second frame, seen with 160 points: what gestures are tried on."""
    page.go(1)
    return dense(page)


def chosen(page: Screen, row: dict) -> dict:
    """Look at a box from above and click it."""
    page.look(*row["box"][:2], 25)
    page.click(row["box"][:3])
    page.settled()
    assert page.selected["id"] == row["id"]
    return page.selected


def along(box: list[float], forward: float, left: float = 0.0, up: float = 0.0) -> list[float]:
    """A place in the box's axes."""
    c, s = math.cos(box[6]), math.sin(box[6])
    return [box[0] + c * forward - s * left, box[1] + s * forward + c * left, box[2] + up]


def undone(page: Screen, times: int = 1) -> None:
    """Undo, and wait for it."""
    for _ in range(times):
        before = page.tell("state.takenBack")
        page.press("Control+z")
        page.until(f"state.takenBack > {before}")
    page.settled()


def test_canvas_is_not_blank(page: Screen):
    assert page.tell("colours()") > 60
    assert page.tell("state.mode") == "annotate"


@pytest.mark.parametrize(
    ("key", "forward", "left", "up", "turn"),
    [
        ("w", 0.05, 0, 0, 0),
        ("Shift+KeyW", 0.5, 0, 0, 0),
        ("Alt+KeyW", 0.01, 0, 0, 0),
        ("s", -0.05, 0, 0, 0),
        ("a", 0, 0.05, 0, 0),
        ("d", 0, -0.05, 0, 0),
        ("r", 0, 0, 0.05, 0),
        ("f", 0, 0, -0.05, 0),
        ("q", 0, 0, 0, 1),
        ("Shift+KeyE", 0, 0, 0, -10),
        ("g", 0, 0, 0, 180),
    ],
)
def test_keys_move_and_turn_in_the_box_axes(page: Screen, key, forward, left, up, turn):
    row = chosen(page, dense(page))
    page.press(key)
    page.settled()
    box = page.selected["box"]
    assert box[:3] == pytest.approx(along(row["box"], forward, left, up), abs=1e-4)
    assert math.cos(box[6] - row["box"][6] - math.radians(turn)) == pytest.approx(1, abs=1e-9)
    assert page.selected["version"] > row["version"]
    assert page.text("#saved").startswith("in the journal: ")
    undone(page)
    assert page.box(row["id"])["box"] == pytest.approx(row["box"], abs=1e-9)


@pytest.mark.parametrize(("key", "axis", "change"), [("]", 3, 0.05), ("[", 3, -0.05), ("'", 4, 0.05), (",", 5, -0.05)])
def test_keys_size_the_far_face_and_the_near_one_stays(page: Screen, key, axis, change):
    row = chosen(page, dense(page))
    page.press(key)
    page.settled()
    box = page.selected["box"]
    assert box[axis] == pytest.approx(row["box"][axis] + change, abs=1e-4)
    if axis < 5:
        angle = row["box"][6] + (axis == 4) * math.pi / 2
        normal = np.array([math.cos(angle), math.sin(angle)])
        near = -np.sign(normal @ row["box"][:2])
        faces = [normal @ each[:2] + near * each[axis] / 2 for each in (row["box"], box)]
        assert faces[0] == pytest.approx(faces[1], abs=1e-4)
    undone(page)


def test_a_typed_number_is_one_edit(page: Screen):
    row = chosen(page, dense(page))
    field = page.page.locator("#inspector input[name=l]")
    field.fill("4.44")
    field.press("Enter")
    page.settled()
    assert page.selected["box"][3] == pytest.approx(4.44)
    page.page.locator("#inspector input[name=yaw]").fill("370")
    page.page.locator("#inspector input[name=yaw]").press("Enter")
    page.settled()
    assert page.selected["box"][6] == pytest.approx(math.radians(10), abs=1e-6)
    page.page.locator("#inspector input[name=w]").fill("-2")
    page.page.locator("#inspector input[name=w]").press("Enter")
    assert page.selected["box"][4] == pytest.approx(row["box"][4])
    undone(page, 2)
    assert page.box(row["id"])["box"] == pytest.approx(row["box"], abs=1e-9)


def test_letters_typed_into_a_field_move_nothing(page: Screen):
    row = chosen(page, dense(page))
    page.page.locator("#inspector input[name=track]").focus()
    page.press("w", "n", "q")
    assert page.selected["box"] == row["box"]
    assert page.tell("state.tool") == "none"
    page.press("Escape")


def test_press_and_drag_along_the_heading_draws_a_box(page: Screen):
    truth = near(page)
    chosen(page, truth)
    page.press("Delete", "Escape")  # or the box that is gone stays the selection until the new one is fitted
    page.settled()
    assert truth["id"] not in [row["id"] for row in page.boxes]
    page.press("n")
    bottom = -truth["box"][5] / 2
    rear, front = (along(truth["box"], side * truth["box"][3] / 2, up=bottom) for side in (-1, 1))
    page.drag(page.pixel(rear), page.pixel(front))
    page.until("state.selection !== null")
    page.settled()
    drawn = page.selected
    assert math.dist(drawn["box"][:2], truth["box"][:2]) < 0.35
    assert abs(math.sin(drawn["box"][6] - truth["box"][6])) < math.radians(4)
    assert math.cos(drawn["box"][6] - truth["box"][6]) > 0  # along the drag
    assert drawn["source"] == "lidar"
    assert page.tell("fitTimes.length") >= 1
    undone(page, 2)
    assert truth["id"] in [row["id"] for row in page.boxes]
    assert drawn["id"] not in [row["id"] for row in page.boxes]


def test_one_click_fits_what_is_under_the_pointer(page: Screen):
    truth = near(page)
    chosen(page, truth)
    page.press("Delete", "Escape")
    page.settled()
    away = np.array(truth["box"][:2]) / truth["distance_m"]
    place = [*(np.array(truth["box"][:2]) - away * truth["box"][3] * 0.45), truth["box"][2]]
    page.page.mouse.move(*page.pixel(place))
    page.press("c")
    page.until("state.selection !== null")
    page.settled()
    assert math.dist(page.selected["box"][:2], truth["box"][:2]) < 1.0
    undone(page, 2)


def test_a_rectangle_with_ctrl(page: Screen):
    truth = near(page)
    chosen(page, truth)
    page.press("Delete", "Escape", "n")
    page.settled()
    box = truth["box"]
    corners = (along(box, -box[3] / 2, box[4] / 2, -box[5] / 2), along(box, box[3] / 2, -box[4] / 2, -box[5] / 2))
    page.page.keyboard.down("Control")
    page.drag(*(page.pixel(corner) for corner in corners))
    page.page.keyboard.up("Control")
    page.until("state.selection !== null")
    page.settled()
    assert math.dist(page.selected["box"][:2], box[:2]) < 0.6
    undone(page, 2)


def test_an_edge_dragged_in_a_close_up_moves_that_face_only(page: Screen):
    row = chosen(page, dense(page))
    box = row["box"]
    front, middle = along(box, box[3] / 2), along(box, 0)
    start = page.tell(f"closeUp('top', {front})")
    further = page.tell(f"closeUp('top', {along(box, box[3] / 2 + 0.4)})")
    page.drag(tuple(start), tuple(further))
    page.settled()
    after = page.selected["box"]
    assert after[3] == pytest.approx(box[3] + 0.4, abs=0.05)
    assert along(after, -after[3] / 2)[:2] == pytest.approx(along(box, -box[3] / 2)[:2], abs=1e-3)
    undone(page)
    chosen(page, page.box(row["id"]))
    start = page.tell(f"closeUp('side', {middle})")
    higher = page.tell(f"closeUp('side', {along(box, 0.2, up=0.3)})")
    page.drag(tuple(start), tuple(higher))
    page.settled()
    assert page.selected["box"][:3] == pytest.approx(along(box, 0.2, up=0.3), abs=0.06)
    undone(page)


def test_the_handle_turns_the_box(page: Screen):
    row = chosen(page, dense(page))
    box = row["box"]
    handle = page.tell(f"closeUp('top', {along(box, box[3] / 2 + 0.8)})")
    target = page.tell(f"closeUp('top', {along(box, box[3] / 2, 0.5)})")
    page.drag(tuple(handle), tuple(target))
    page.settled()
    wanted = math.atan2(0.5, box[3] / 2)
    assert math.remainder(page.selected["box"][6] - box[6], math.tau) == pytest.approx(wanted, abs=0.03)
    undone(page)


def test_class_copy_paste_and_redo(page: Screen):
    row = chosen(page, dense(page))
    other = page.tell("state.welcome.classes")[2]
    page.press(other["key"])
    page.settled()
    assert page.selected["class_name"] == other["name"]
    page.press("Control+c", "Control+v")
    page.settled()
    copy = page.selected
    assert copy["id"] != row["id"]
    assert copy["track"] != row["track"]
    assert copy["box"] == row["box"]
    undone(page, 2)
    assert page.box(row["id"])["class_name"] == row["class_name"]
    page.press("Control+Shift+Z")
    page.until(f"state.boxes.find((row) => row.id === '{row['id']}').class_name === '{other['name']}'")
    undone(page)


def test_checks_find_a_box_that_is_too_large(page: Screen):
    row = chosen(page, dense(page))
    field = page.page.locator("#inspector input[name=h]")
    field.fill("9")
    field.press("Enter")
    page.settled()
    page.until(f"state.checks.some((found) => found.box === '{row['id']}')")
    assert page.page.locator("#checks .finding").count() >= 1
    undone(page)


def test_a_box_for_a_peak_of_the_radar(page: Screen):
    page.go(1)
    rows = [row for row in page.boxes if 15 < row["distance_m"] < 60 and (row["radar_points"] or 0) > 20]
    truth = max(rows, key=lambda row: row["radar_points"])
    page.look(*truth["box"][:2], 25)
    chosen(page, truth)
    page.press("Delete", "Escape")
    page.settled()
    away = np.array(truth["box"][:2]) / truth["distance_m"]
    face = np.array(truth["box"][:2]) - away * truth["box"][3] / 2
    page.page.mouse.dblclick(*page.pixel([*face, 0.0]))
    page.until("state.selection !== null")
    page.settled()
    made = page.selected
    assert made["source"] == "radar"
    assert math.dist(made["box"][:2], truth["box"][:2]) < 3.0
    undone(page, 2)


def test_two_windows_conflict_and_each_choice_is_kept(chromium, live, page: Screen):
    row = chosen(page, dense(page))
    with screen(chromium, live) as other:
        page.until("state.windows === 2")
        assert "2 windows" in page.text("#header")
        other.look(*row["box"][:2], 25)
        other.click(row["box"][:3])
        other.until(f"state.selection === '{row['id']}'")
        # both change the version that both saw: the second comes late
        other.page.evaluate("farfieldTest.hold(true)")
        page.press("w")
        page.settled()
        other.press("a")
        other.page.evaluate("farfieldTest.hold(false)")
        other.page.wait_for_selector(".bar.warning")
        assert other.box(row["id"])["box"] == pytest.approx(along(row["box"], 0.05) + row["box"][3:], abs=1e-4)
        other.page.get_by_role("button", name="Keep mine").click()
        other.settled()
        mine = other.box(row["id"])["box"]
        there = f"(one.box[1] - ({mine[1]})) ** 2 < 1e-12"
        page.until(f"state.boxes.some((one) => one.id === '{row['id']}' && {there})")
        assert page.box(row["id"])["box"] == pytest.approx(mine)
        assert page.box(row["id"])["box"][:3] == pytest.approx(along(row["box"], 0, 0.05), abs=1e-4)


def test_save_writes_the_labels(page: Screen, folder):
    row = chosen(page, dense(page))
    page.press("w")
    page.settled()
    moved = page.selected["box"]
    page.press("Control+s")
    page.page.wait_for_selector(".bar.info")
    files = [path for path in folder.rglob("*") if path.is_file() and path.stat().st_size]
    numbers = {f"{moved[0]:.3f}", repr(moved[0]), f"{moved[0]:.6f}"}
    found = [path for path in files if path.suffix in (".json", ".csv", ".txt")]
    assert any(any(number in path.read_text() for number in numbers) for path in found), [str(p) for p in files]
    undone(page)
    assert json.dumps(page.box(row["id"])["box"])
