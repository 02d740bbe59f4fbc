"""Predicted boxes beside the truth: what was missed, what has no truth, filters, two sets, detection from the page."""

import csv

import pytest

pytest.importorskip("starlette")
from _studio_screen import Screen, screen
from studio.live import studio

from farfield.studio.samples import open_samples

COLUMNS = ("sequence", "frame", "label", "x", "y", "z", "l", "w", "h", "yaw_rad", "score")


def write(path, *, drop: int, false: bool):
    """The truth of both frames as predictions: without its ``drop``-th box, with one box where nothing is."""
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        for frame in open_samples():
            boxes = frame.boxes
            assert boxes is not None
            for place in range(len(boxes)):
                if place != drop:
                    numbers = (*boxes.centre_m[place], *boxes.size_m[place], boxes.yaw_rad[place])
                    rows.writerow([*frame.key, boxes.label[place], *numbers, 0.5 + place / 100])
            if false:
                rows.writerow([*frame.key, "vehicle", 30.0, 30.0, -1.0, 4.5, 1.9, 1.6, 0.0, 0.9])
    return path


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory):
    folder = tmp_path_factory.mktemp("predicted")
    first, second = folder / "first.csv", folder / "second.csv"
    sets = (write(first, drop=2, false=True), write(second, drop=-1, false=False))
    with studio(notes=folder, predictions=sets) as live, screen(chromium, live) as shown:
        yield shown


def test_missed_and_false_boxes_are_told_by_the_protocol(page: Screen):
    assert page.tell("colours()") > 60
    first, second = page.tell("state.shown.predicted")
    assert first["missed"] == [page.boxes[2]["id"]] or page.boxes[2]["id"] in first["ignored"]
    assert [row["box"][:2] for row in first["rows"] if row["match"] == "false"] == [[30, 30]]
    assert not [row for row in second["rows"] if row["match"] == "false"]
    assert len(second["rows"]) == len(page.boxes)


def test_j_jumps_to_what_needs_a_look(page: Screen):
    page.tell("look([0, 0, 0], 40, true)")
    page.settled()
    seen = []
    for _ in range(3):
        page.press("j")
        page.settled()
        seen.append((page.tell("state.selection"), page.tell("stage.eye.target")[:2]))
    assert [30, 30] in [place for _, place in seen]
    page.press("Escape")


def test_the_score_filter_hides_what_is_below_it(page: Screen):
    slider = page.page.locator("#left input[name=score]")
    slider.fill("0.6")
    assert page.tell("state.filters.score") == pytest.approx(0.6)
    rows = page.tell("state.shown.predicted")[0]["rows"]
    assert 0 < sum(row["score"] >= 0.6 for row in rows) < len(rows)
    slider = page.page.locator("#left input[name=score]")
    slider.fill("0")


def test_two_sets_stand_in_two_panes(page: Screen):
    page.press("Backslash")
    page.settled()
    names = [found["set"] for found in page.tell("state.shown.predicted")]
    page.page.locator(f"#left .layer:has(input[name='set {names[0]}']) button").click()
    page.page.locator(f"#left .layer:has(input[name='set {names[1]}']) button").click()
    page.page.locator(f"#left .layer:has(input[name='set {names[1]}']) button").click()
    assert page.page.evaluate("[...farfieldTest.state.setSides.values()].sort()") == [1, 2]
    page.press("Backslash")


def test_a_set_can_be_hidden(page: Screen):
    names = [found["set"] for found in page.tell("state.shown.predicted")]
    page.page.locator(f"#left input[name='set {names[0]}']").click()
    assert page.page.evaluate("[...farfieldTest.state.hiddenSets]") == [names[0]]
    page.page.locator(f"#left input[name='set {names[0]}']").click()
