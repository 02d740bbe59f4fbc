"""Undo and redo through the page, in another frame, by a server that was started anew."""

import math

import pytest

pytest.importorskip("starlette")
from _studio_screen import screen
from studio.live import studio


def test_an_edit_is_undone_and_done_again_after_a_restart(chromium, tmp_path):
    given = {"mode": "annotate", "annotator": "kim", "edits": tmp_path / "edits", "notes": tmp_path, "extent": "full"}
    with studio(**given) as live, screen(chromium, live) as page:
        row = min(page.boxes, key=lambda each: each["distance_m"])
        page.look(*row["box"][:2], 25)
        page.click(row["box"][:3])
        page.until("state.selection !== null")
        name, before = page.selected["id"], page.selected["box"]
        page.press("Shift+KeyW")
        page.settled()
        page.until("state.pending === 0")
        after = page.selected["box"]
        assert math.dist(before[:2], after[:2]) == pytest.approx(0.5, abs=1e-3)
    with studio(**given) as live, screen(chromium, live) as page:
        page.go(0)
        assert page.box(name)["box"] == pytest.approx(after)
        page.go(1)  # the edit to take back is one of another frame
        page.press("Control+z")
        page.until("state.takenBack > 0")
        page.settled()
        page.go(0)
        assert page.box(name)["box"] == pytest.approx(before)
        taken = page.tell("state.takenBack")
        page.press("Control+Shift+z")
        page.until(f"state.takenBack > {taken}")
        page.settled()
        assert page.box(name)["box"] == pytest.approx(after)
