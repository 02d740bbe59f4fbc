"""Another data set at the same address: what waits in the browser goes to the one for which it was made, or nowhere."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
from _studio_scenes import write_folder
from _studio_screen import screen
from studio.browser.cutting import Line
from studio.browser.editing import FRAMES, choose, stored
from studio.live import studio

from farfield.datasets import open_dataset


@pytest.mark.slow
def test_edits_never_go_to_another_data_set(chromium: Any, tmp_path: Path):
    folders = [write_folder(tmp_path / name, FRAMES, 6_000) for name in ("one", "two")]
    settings = [{"mode": "annotate", "extent": "full", "edits": one / "edits", "notes": one} for one in folders]
    with (
        studio(lambda: open_dataset(folders[0]), **settings[0]) as first,
        studio(lambda: open_dataset(folders[1]), **settings[1]) as second,
    ):
        before, line = stored(second), Line(first.port)
        first.origin = f"http://127.0.0.1:{line.port}"
        with screen(chromium, first) as page:
            row = choose(page, 3)
            line.cut()
            page.until("state.connected === false")
            page.press("Shift+KeyW")
            page.until("state.pending === 1")
            page.press("Shift+KeyK")  # a bookmark
            page.press("Control+KeyS")
            name, _, value = second.cookie.partition("=")
            page.page.context.add_cookies([{"name": name, "value": value, "url": first.origin}])
            for running in (second, first):  # the page of each comes by itself
                line.cut()
                line.there = running.port
                with page.page.expect_event("load", timeout=60_000):
                    line.join()
                page.until("state.connected === true && farfieldTest.state.pending === 0", seconds=30)
                if running is second:
                    assert page.tell("state.welcome.title") == "two"
                    assert stored(second) == before
                    assert page.tell("state.bookmarks") == []
                    assert "bookmark.set" in page.page.locator("#bars").inner_text()  # it was not done, which is said
            moved = f"state.boxes.some((one) => one.track === 3 && one.box[0] !== {row['box'][0]!r})"
            page.until(f"{moved} && farfieldTest.state.pending === 0", seconds=20)
        line.close()
        first.origin = f"http://127.0.0.1:{first.port}"
        assert abs(stored(first)[0][3]["box"][0] - row["box"][0]) == pytest.approx(0.5)
