"""A detector's boxes as proposals: accepted, fixed and rejected with clicks and keys; the label file that results."""

import csv
import json
from functools import partial

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("torch")  # without it no detector is on offer
from _studio_scenes import vehicles, write_folder
from _studio_screen import Screen, screen
from studio.inferring.fakes import load_scene
from studio.live import studio

from farfield.datasets import open_dataset
from farfield.studio.inferring.worker import Worker
from farfield.studio.session import detecting

AHEAD = (30, 80)  # where what is proposed is looked at, metres


@pytest.fixture(scope="module")
def settings(tmp_path_factory):
    place = tmp_path_factory.mktemp("proposals")
    return {"edits": place / "edits", "notes": place, "mode": "annotate", "extent": "full", "out": place / "saved"}


@pytest.fixture(scope="module")
def page(chromium, settings, tmp_path_factory):
    """Two frames whose boxes are gone, and a detector that finds all of them."""
    folder = write_folder(tmp_path_factory.mktemp("road") / "road", 2, 24_000)
    for path in folder.glob("*.json"):
        path.write_text(json.dumps({"boxes": []}))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(detecting, "Worker", partial(Worker, loader=load_scene))
        with (
            studio(lambda: open_dataset(folder), annotator="kim", detectors=("road",), **settings) as live,
            screen(chromium, live) as shown,
        ):
            yield shown


def proposals(page: Screen) -> list[dict]:
    """Boxes that nobody has judged yet."""
    return [row for row in page.boxes if row["state"] == "proposed"]


def ahead(page: Screen) -> list[dict]:
    """Proposals that lie in sight when one looks ahead, the nearest first."""
    page.look(sum(AHEAD) / 2, 0, 45)
    rows = [row for row in proposals(page) if AHEAD[0] < row["box"][0] < AHEAD[1]]
    return sorted(rows, key=lambda row: row["distance_m"])


JOBS = "[...farfieldTest.state.jobs.values()].map((job) => job.state)"


def detect(page: Screen) -> None:
    """Detection in this frame, as proposals, by the panel's own controls."""
    box = page.page.locator("#infer label:has-text('as proposals') input")
    if not box.is_checked():
        box.click()
    before = page.tell("state.jobs.size")
    page.page.get_by_role("button", name="This frame").click()
    ended = f"state.jobs.size > {before} && !{JOBS}.some((state) => ['queued', 'running'].includes(state))"
    page.until(ended, seconds=120)  # a process of its own starts
    assert set(page.page.evaluate(JOBS)) == {"done"}
    page.settled()


def written(settings) -> list[list[float]]:
    """The boxes of the first frame in the label file."""
    with (settings["out"] / "labels.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if int(row["frame"]) == 0]
    return [[float(row[name]) for name in ("x", "y", "z", "l", "w", "h", "yaw_rad")] for row in rows]


def test_boxes_are_proposed_judged_and_only_those_that_stand_are_written(page: Screen, settings):
    assert page.tell("colours()") > 60
    assert page.boxes == []
    detect(page)
    assert len(proposals(page)) == len(page.boxes) == 20
    assert page.page.locator("#objects tr.one td:has-text('?')").count() == 20
    first, second, third, fourth = ahead(page)[:4]

    page.click(first["box"][:3])
    assert page.selected["id"] == first["id"]
    page.press("y")  # accepted; the next one is selected
    page.settled()
    assert page.box(first["id"])["state"] == "accepted"
    assert page.selected["state"] == "proposed"

    page.click(second["box"][:3])
    assert page.selected["id"] == second["id"]
    page.press("Delete")  # rejected: kept out of sight, the next one is selected
    page.settled()
    assert page.box(second["id"])["state"] == "rejected"
    assert page.page.locator(f"#objects tr[data-box='{second['id']}']").count() == 0
    assert page.selected["state"] == "proposed"

    page.click(third["box"][:3])
    page.press("w", "w")  # fixed
    page.settled()
    assert page.selected["state"] == "edited"
    assert page.selected["proposal"] == pytest.approx(third["box"])

    page.click(fourth["box"][:3])
    page.page.get_by_role("button", name="Accept", exact=True).click()
    page.settled()
    assert page.box(fourth["id"])["state"] == "accepted"

    page.press("Control+s")
    page.page.locator(".bar:has-text('label file')").wait_for()
    moved = page.box(third["id"])["box"]
    assert moved[0] == pytest.approx(third["box"][0] + 0.1 * np.cos(third["box"][6]), abs=1e-6)
    assert sorted(written(settings)) == [pytest.approx(row) for row in sorted((first["box"], moved, fourth["box"]))]
    truth = np.array(vehicles(0))[:, :2]
    assert np.hypot(*(truth - np.array(first["box"][:2])).T).min() < 1e-6


def test_what_was_rejected_or_stands_is_not_proposed_again(page: Screen):
    before = {row["id"]: row["state"] for row in page.boxes}
    detect(page)
    assert {row["id"]: row["state"] for row in page.boxes} == before


def test_a_rejection_can_be_undone_and_the_box_accepted_after_all(page: Screen):
    row = ahead(page)[0]
    page.click(row["box"][:3])
    page.page.get_by_role("button", name="Reject").click()
    page.settled()
    assert page.box(row["id"])["state"] == "rejected"
    done = page.tell("state.takenBack")
    page.press("Control+z")
    page.until(f"state.takenBack > {done}")
    page.settled()
    assert page.box(row["id"])["state"] == "proposed"
    page.press("Escape")
    page.click(row["box"][:3])
    page.press("y")
    page.settled()
    assert page.box(row["id"])["state"] == "accepted"
    assert page.errors == []


def test_all_from_a_score_on_are_accepted_once_they_were_counted_and_come_back_with_one_undo(page: Screen):
    panel, bar = page.page.locator("#proposals"), page.page.locator(".bar:has-text('One undo')")
    field, left = panel.locator("input"), proposals(page)
    least = sorted(row["score"] for row in left)[len(left) // 2]
    strong = {row["id"] for row in left if row["score"] >= least}
    field.fill(f"{least - 0.001:.4f}")
    assert f"{len(strong)} of {len(left)} here" in panel.inner_text()
    panel.get_by_role("button", name="Accept all").click()
    bar.wait_for()
    assert f"{len(strong)} proposals" in bar.inner_text()
    assert len(proposals(page)) == len(left), "none is accepted before the answer"
    page.page.wait_for_timeout(4200)  # longer than a sentence stays that asks nothing
    assert bar.count() == 1
    page.press("Shift+Y")
    page.page.wait_for_timeout(500)
    assert bar.count() == 1
    bar.get_by_role("button", name="Leave them").click()
    page.press("Shift+Y")
    bar.get_by_role("button", name=f"Accept {len(strong)} of this frame").click()
    page.settled()
    assert {row["id"] for row in left} - {row["id"] for row in proposals(page)} == strong
    tracks = [row["track"] for row in page.boxes if row["id"] in strong]
    assert None not in tracks
    assert len(set(tracks)) == len(tracks)
    done = page.tell("state.takenBack")
    page.press("Control+z")
    page.until(f"state.takenBack > {done}")
    page.settled()
    assert {row["id"] for row in proposals(page)} == {row["id"] for row in left}
    assert page.errors == []


def test_a_box_that_was_rejected_or_hidden_is_not_changed_by_the_next_key(page: Screen):
    row = ahead(page)[0]
    page.press("Escape")
    page.click(row["box"][:3])
    page.until(f"state.selection === '{row['id']}'")
    hide = page.page.locator("#left label:has-text('vehicle') input[type=checkbox]").first
    hide.click()
    page.until("state.selection === null")
    hide.click()
    page.click(row["box"][:3])
    page.until(f"state.selection === '{row['id']}'")
    for other in proposals(page):  # the last one has no next to which the selection could go
        if other["id"] != row["id"]:
            page.tell(f"state.boxes.find((one) => one.id === '{other['id']}').state = 'accepted'")
    page.press("Delete")
    page.until("state.selection === null")
    page.settled()
    before = page.box(row["id"])
    assert before["state"] == "rejected"
    page.press("w")
    page.settled()
    assert page.box(row["id"]) == before
