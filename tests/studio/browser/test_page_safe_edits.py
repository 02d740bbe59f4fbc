"""Edits that a person may trust: nothing lands in another frame, nothing blocks, no number is none, P goes on."""

import contextlib
import errno
import json
import math
import os
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
from _studio_rough_link import ROUGH_LINK
from _studio_scenes import write_folder
from _studio_screen import Screen, screen
from studio.browser.cutting import Line
from studio.browser.editing import FRAMES, choose, damage_next, slow, stored
from studio.live import Live, studio
from studio.posts import write_kradar

from farfield.annotation import journal
from farfield.datasets import open_dataset

DAMAGED = 4


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames, the boxes of every second one in the reverse order; the cloud of one of them is damaged."""
    folder = write_folder(tmp_path_factory.mktemp("safe") / "drive", FRAMES, 16_000)
    for frame in range(1, FRAMES, 2):
        path = folder / f"{frame:06d}.json"
        path.write_text(json.dumps({"boxes": json.loads(path.read_text())["boxes"][::-1]}))
    (folder / f"{DAMAGED:06d}.bin").write_bytes(b"damaged")
    return folder


@pytest.fixture
def live(data: Path, tmp_path: Path):
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with studio(lambda: open_dataset(data), mode="annotate", extent="full", **place) as running:
        yield running


@pytest.fixture
def page(chromium: Any, live: Live):
    with screen(chromium, live, script=ROUGH_LINK) as shown:
        yield shown


@pytest.mark.parametrize("keys", [("Shift+KeyW",), ("2",), ("Delete",), ("Shift+KeyD", "g")])
def test_an_edit_during_a_frame_change_never_lands_in_another_frame(page: Screen, live: Live, keys: tuple[str, ...]):
    choose(page, 3)
    before = stored(live)
    slow(page, 100)
    page.press("End")
    page.page.wait_for_timeout(60)
    page.press(*keys)
    slow(page, 0)
    page.settled()
    page.until("state.pending === 0")
    assert stored(live) == before
    assert "not shown yet" in page.text("#bars")


def test_the_boxes_of_a_drive_have_names_of_their_own(live: Live):
    with live.window() as client:
        frames = [client.open(frame)["boxes"] for frame in (0, 1, 2)]
        names = [row["id"] for boxes in frames for row in boxes]
        assert len(set(names)) == len(names)
        again = [row["id"] for row in client.open(1)["boxes"]]
        assert again == [row["id"] for row in frames[1]]
        row, value = frames[0][0], {"box": frames[0][0]["box"], "class_name": "vehicle"}
        for frame, name in ((1, row["id"]), (0, "0")):
            client.send(op="box.set", id=client.new_id(), frame=frame, box=name, base=0, value=value)
            assert client.until("ack", "refused", "conflict")["op"] == "refused"


def test_a_frame_that_cannot_be_read_leaves_no_old_picture(page: Screen, live: Live):
    choose(page, 3)
    before = stored(live)
    page.press(*["ArrowRight"] * DAMAGED)
    page.until(f"state.frame === {DAMAGED}")
    page.until(f"state.shown.frame.index === {DAMAGED}")
    page.settled()
    assert page.boxes == []
    assert page.selected is None
    assert page.tell("drawn().points") == 0
    assert "cannot be read" in page.text("#main") + page.text("#bars")
    page.press("Shift+KeyW", "Delete", "n")
    page.page.wait_for_timeout(300)
    assert stored(live) == before
    page.press("ArrowRight")
    page.settled()
    assert len(page.boxes) == 20
    assert page.selected is not None
    assert page.selected["track"] == 3


def test_what_is_refused_is_said_at_its_field_and_what_follows_is_kept(page: Screen, live: Live):
    choose(page, 3)
    for name, text in (("l", "600"), ("x", "5000"), ("yaw", "1e9"), ("h", "-1")):
        field = page.page.locator(f"#inspector input[name={name}]")
        shown = field.input_value()
        field.fill(text)
        field.press("Enter")
        assert page.page.locator(".field-note").inner_text() != ""
        assert page.page.evaluate("roughLink.sent.filter((m) => m.op === 'box.set').length") == 0
        field.fill(shown)
        field.press("Enter")
    field = page.page.locator("#inspector input[name=l]")
    field.fill("4.9")
    field.press("Enter")
    page.settled()
    assert stored(live)[0][3]["box"][3] == pytest.approx(4.9)


def test_a_message_that_the_server_cannot_read_blocks_none_after_it(chromium: Any, page: Screen, live: Live):
    row = choose(page, 3)
    damage_next(page, "box.set")
    page.press("Shift+KeyW")
    page.until("state.pending === 0")
    assert page.box(row["id"])["box"] == pytest.approx(row["box"])  # the page shows what is stored
    for track in (5, 6, 7):
        choose(page, track)
        page.press("Shift+KeyW")
    page.settled()
    page.until("state.pending === 0")
    now = stored(live)[0]
    assert [now[track]["version"] > 0 for track in (3, 5, 6, 7)] == [False, True, True, True]


@pytest.mark.parametrize("bad", ["NaN", "Infinity", "null", "1e999"])
def test_numbers_that_are_none_are_refused_by_their_message(live: Live, bad: str):
    with live.window() as client:
        row = client.open(0)["boxes"][0]
        box = ", ".join([bad, *map(str, row["box"][1:])])
        client.socket.send(
            f'{{"op": "box.set", "id": "n-1", "frame": 0, "box": "{row["id"]}", "base": 0, '
            f'"value": {{"class_name": "vehicle", "box": [{box}]}}}}'
        )
        answer = client.until("ack", "refused")
        assert (answer["op"], answer["id"]) == ("refused", "n-1")
        assert "value.box" in answer["sentence"]


def middle(page: Screen, name: str) -> tuple[float, float]:
    area = page.page.locator(f"#close-{name}").bounding_box()
    return area["x"] + area["width"] / 2, area["y"] + area["height"] / 2


@pytest.mark.parametrize("view", ["top", "side", "front"])
@pytest.mark.parametrize("interruption", ["Escape", "ArrowRight", "ArrowDown", "Delete"])
def test_a_gesture_that_is_interrupted_changes_nothing(page: Screen, live: Live, view: str, interruption: str):
    row = choose(page, 3)
    before = stored(live)
    x, y = middle(page, view)
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + 6, y + 6, steps=2)
    page.press(interruption)
    page.page.mouse.move(x + 40, y + 20, steps=4)
    page.page.mouse.up()
    page.settled()
    page.until("state.pending === 0")
    after = stored(live)
    if interruption == "Delete":
        del before[0][3]
    assert after == before
    sent = page.page.evaluate("JSON.stringify(roughLink.sent)")
    assert "null" not in "".join(
        json.dumps(m.get("value")) for m in json.loads(sent) if m["op"] == "preview"
    )  # NaN is null in JSON
    page.go(0)
    if interruption != "Delete":
        assert page.box(row["id"])["box"] == pytest.approx(row["box"])


def test_a_drawing_gesture_that_is_interrupted_draws_nothing(page: Screen, live: Live):
    before = stored(live)
    page.look(30, 0, 25)
    page.press("n")
    a, b = page.pixel([28, 0, -1.5]), page.pixel([33, 0, -1.5])
    page.page.mouse.move(*a)
    page.page.mouse.down()
    page.page.mouse.move(*b, steps=3)
    page.press("Escape")
    page.page.mouse.move(b[0] + 5, b[1], steps=2)
    page.page.mouse.up()
    page.page.wait_for_timeout(500)
    page.settled()
    assert not page.page.evaluate("roughLink.sent.some((m) => m.op === 'fit')")
    assert stored(live) == before


@pytest.mark.parametrize("latency_ms", [0, 120])
def test_p_carries_on_as_often_as_it_is_pressed(chromium: Any, tmp_path: Path, latency_ms: float):
    folder = write_folder(tmp_path / "drive", FRAMES, 16_000)
    for frame in range(1, FRAMES):
        (folder / f"{frame:06d}.json").write_text(json.dumps({"boxes": []}))
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with (
        studio(lambda: open_dataset(folder), mode="annotate", extent="full", **place) as live,
        screen(chromium, live, script=ROUGH_LINK) as page,
    ):
        choose(page, 3)
        slow(page, latency_ms)
        page.press("p", "p", "p")
        page.until("state.frame === 3 && farfieldTest.state.selection !== null", seconds=20)
        slow(page, 0)
        page.settled()
        assert page.selected is not None
        assert page.selected["track"] == 3
        frames = [boxes.get(3) for boxes in stored(live)]
        assert [row is not None for row in frames] == [True, True, True, True, False, False]


def test_p_gives_a_box_where_points_do_not_decide(chromium: Any, tmp_path: Path):
    """A car that leaves a standing start by 2 m a frame, and one without a point."""
    folder = write_folder(tmp_path / "drive", 4, 16_000)
    for frame in range(4):
        boxes = [
            {
                "label": "vehicle",
                "centre_m": [20.0, 40.0, -0.9],
                "size_m": [4.6, 1.9, 1.6],
                "yaw_rad": 0.0,
                "track_id": 1,
            }
        ]
        boxes = boxes if frame == 0 else []
        (folder / f"{frame:06d}.json").write_text(json.dumps({"boxes": boxes}))
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with (
        studio(lambda: open_dataset(folder), mode="annotate", extent="full", **place) as live,
        screen(chromium, live) as page,
    ):
        choose(page, 1)
        page.press("p", "p", "p")
        page.until("state.frame === 3 && farfieldTest.state.selection !== null", seconds=20)
        page.settled()
        assert page.selected is not None
        assert (page.selected["track"], page.selected["source"]) == (1, "predicted")
        assert "predicted" in page.text("#facts")
        assert math.dist(page.selected["box"][:2], (20.0, 40.0)) < 0.5


def test_a_track_edit_of_one_box_is_shown_and_the_next_edit_is_taken(chromium: Any, tmp_path: Path):
    folder = write_folder(tmp_path / "drive", 3, 16_000)
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    entries = json.loads((folder / "000001.json").read_text())["boxes"]
    with (
        studio(lambda: open_dataset(folder), mode="annotate", extent="full", **place) as live,
        screen(chromium, live) as page,
    ):
        assert len(entries) == 20
        choose(page, 3)
        page.go(1)
        with live.window() as client:  # a box that the tool made: P makes it anew
            row = next(row for row in client.open(1)["boxes"] if row["track"] == 3)
            value = {"box": row["box"], "class_name": row["class_name"], "track": 3, "source": "propagated"}
            edit = {"op": "box.set", "id": "c-1", "frame": 1, "box": row["id"], "base": row["version"]}
            client.send(**edit, value=value)
            made = client.until("ack")["row"]
        page.until(f"state.boxes.find((row) => row.track === 3).version === {made['version']}")
        page.go(0)
        page.press("p")
        page.until("state.frame === 1 && farfieldTest.state.selection !== null")
        page.settled()
        shown = page.selected
        assert shown is not None
        assert shown["version"] > made["version"]
        page.press("Shift+KeyW")
        page.settled()
        page.until("state.pending === 0")
        assert "meanwhile" not in page.text("#bars")
        now = stored_frame(live, 1)
        assert now[3]["box"][0] == pytest.approx(shown["box"][0] + 0.5 * math.cos(shown["box"][6]))


def stored_frame(live: Live, frame: int) -> dict[int, dict[str, Any]]:
    with live.window() as client:
        return {row["track"]: row for row in client.open(frame)["boxes"]}


def test_an_accepted_proposal_is_saved_and_a_box_that_cannot_be_is_shown(chromium: Any, tmp_path: Path):
    root = write_kradar(tmp_path / "kradar", count=3)
    place = {"edits": tmp_path / "edits", "notes": tmp_path, "out": tmp_path / "saved"}
    value = {"box": [20.0, 3.0, -0.4, 4.6, 2.1, 1.9, 0.1], "class_name": "Sedan", "source": "detector"}
    with (
        studio(lambda: open_dataset(root), mode="annotate", extent="full", **place) as live,
        screen(chromium, live) as page,
    ):
        with live.window() as client:
            for frame, more in ((0, {"state": "proposed"}), (2, {"state": "edited", "track": 1_234_567_890})):
                client.send(op="box.add", id=client.new_id(), frame=frame, box=f"p-{frame}", value=value | more)
                assert client.until("ack", "refused")["op"] == "ack"
        page.until("state.boxes.some((row) => row.state === 'proposed')")
        page.page.locator("#objects tr[data-box='0:p-0']").click()
        page.press("y")
        page.settled()
        assert page.box("0:p-0")["track"] is not None
        page.press("Control+s")
        page.until("state.jump === null && document.querySelector('#bars .error') !== null")
        said = page.text("#bars")
        assert "Frame 3, box 2:p-2 was not written" in said
        assert "2 other" in said
        assert sorted(path.name for path in (tmp_path / "saved").rglob("*.txt")) != []
        page.page.get_by_role("button", name="Go there").click()
        page.until("state.selection === '2:p-2'")
        assert page.tell("state.frame") == 2


def test_a_server_that_is_gone_and_a_full_disk_are_said_and_the_edits_kept(
    chromium: Any, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    place = {"edits": tmp_path / "edits", "notes": tmp_path}
    with contextlib.ExitStack() as stack:
        live = stack.enter_context(studio(lambda: open_dataset(data), mode="annotate", extent="full", **place))
        line = Line(live.port)
        stack.callback(line.close)
        live.origin = f"http://127.0.0.1:{line.port}"
        page = stack.enter_context(screen(chromium, live))
        row = choose(page, 3)
        line.cut()
        page.until("state.connected === false")
        assert "does not answer" in page.text("#bar-kept")
        page.press("Shift+KeyW")
        page.until("state.pending === 1")
        assert "1 edit is kept in this browser only" in page.text("#bar-kept")
        line.join()
        page.until("state.connected === true && farfieldTest.state.pending === 0", seconds=20)
        assert page.page.locator("#bar-kept").count() == 0
        stored_box = page.box(row["id"])["box"]
        monkeypatch.setattr(journal.os, "fsync", full)
        page.press("Shift+KeyW")
        page.until("state.stopped !== ''")
        assert "cannot write any more edits" in page.text("#bar-kept")
        assert "No space left" in page.text("#bar-kept")
        assert "1 edit is kept in this browser only" in page.text("#bar-kept")
        monkeypatch.undo()
        wanted = page.box(row["id"])["box"]
        assert wanted != pytest.approx(stored_box)
        assert page.page.evaluate("Object.values(localStorage).join().includes('box.set')")


def full(_: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
