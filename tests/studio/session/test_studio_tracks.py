"""Tracks through the studio's WebSocket: a moving car of eight frames, of which two are labelled."""

import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio.live import Client, studio
from studio.showing.test_studio_wire import decode

from farfield import open_dataset
from farfield.annotation.edits import propagate_track
from farfield.datasets.cirrus.writer import CirrusWriter
from farfield.frame import Annotation, Boxes, Cloud, Frame, Sensor
from farfield.studio.session import annotating

FRAMES, SIZE_M = 8, (4.6, 1.95, 1.7)


def place(k: int) -> np.ndarray:
    return np.array([15.0 + 1.0 * k, 4.0, 0.85])


def car(k: int, rng: np.random.Generator) -> np.ndarray:
    """Points on the two sides of a car that the sensor sees."""
    half = np.array(SIZE_M) / 2
    along = rng.uniform(-1, 1, (300, 3)) * half
    along[:150, 0] = -half[0]
    along[150:, 1] = -half[1]
    return along + place(k)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root, rng = tmp_path_factory.mktemp("drive"), np.random.default_rng(0)
    writer = CirrusWriter(root)
    for k in range(FRAMES):
        ground = np.column_stack([rng.uniform(0, 50, (3000,)), rng.uniform(-20, 20, 3000), rng.normal(0, 0.02, 3000)])
        points = np.vstack([ground, car(k, rng)]).astype(np.float32)
        boxes = Boxes.empty()
        if k in (0, 1):
            boxes = Boxes(
                centre_m=place(k)[None],
                size_m=np.array([SIZE_M]),
                yaw_rad=np.zeros(1),
                label="vehicle",
                track_id=np.array([5]),
            )
        frame = Frame.of(Cloud(points, np.full(len(points), 0.5, np.float32)), Annotation(boxes=boxes), name="gaussian")
        time_ns = 1_600_000_000_000_000_000 + k * 100_000_000
        sensors = {"gaussian": Sensor(kind="lidar", time_ns=time_ns)}
        writer.write(replace(frame, sensors=sensors, time_ns=time_ns, reference="gaussian", world_T_frame=np.eye(4)))
    return root


@pytest.fixture(scope="module")
def live(folder: Path, tmp_path_factory: pytest.TempPathFactory):
    with studio(
        partial(open_dataset, folder),
        mode="annotate",
        annotator="kim",
        extent="full",
        notes=tmp_path_factory.mktemp("n"),
    ) as running:
        yield running


def centre_error_m(row: dict, k: int) -> float:
    return float(np.hypot(*(np.array(row["box"][:2]) - place(k)[:2])))


def test_a_track_is_propagated_by_its_motion_and_taken_back_in_one_step(live):
    with live.window() as client:
        assert client.welcome["drives"][0]["frames"] == list(range(FRAMES))
        row = client.open(1)["boxes"][0]
        client.send(
            op="track.propagate", id="p1", box=row["id"], base=row["version"], track=5, first=1, last=FRAMES - 1
        )
        changed = client.until("changed", "refused")
        assert changed["op"] == "changed", changed
        assert [each["frame"] for each in changed["rows"]] == list(range(2, FRAMES))
        for each in changed["rows"]:
            assert each["row"]["source"] == "propagated"
            assert centre_error_m(each["row"], each["frame"]) < 0.3
        assert changed["tracks"][0]["frames"] == list(range(FRAMES))
        client.send(op="undo", id="u1")
        gone = client.until("changed", wanted=lambda message: message["show"] is not None)
        assert len(gone["removed"]) == FRAMES - 2


def test_a_track_is_interpolated_between_keyframes(live):
    with live.window() as client:
        row = client.open(1)["boxes"][0]
        value = {name: row[name] for name in ("box", "class_name", "track", "state", "source", "attributes")}
        value |= {"box": [*place(7), *SIZE_M, 0.0], "state": "edited"}
        client.send(op="box.add", id="a1", frame=7, box="k-7", value=value)
        client.until("ack")
        shown = {"frame": 1, "box": row["id"], "base": row["version"]}
        client.send(op="track.interpolate", id="i1", **shown, track=5, first=1, last=7)
        changed = client.until("changed", wanted=lambda message: message["id"] == "i1")
        assert [each["frame"] for each in changed["rows"]] == [2, 3, 4, 5, 6]
        for each in changed["rows"]:
            assert each["row"]["source"] == "interpolated"
            assert not each["row"]["keyframe"]
            assert centre_error_m(each["row"], each["frame"]) < 1e-6
        track = changed["tracks"][0]
        assert (track["frames"], track["keyframes"]) == (list(range(FRAMES)), [0, 1, 7])
        box = next(each["row"] for each in changed["rows"] if each["frame"] == 4)
        shown = {"frame": 4, "box": box["id"], "box_base": box["version"]}
        client.send(op="track.split", id="s1", track=5, **shown, new_track=9, base=track["version"])
        split = client.until("changed", "refused", "conflict", wanted=lambda message: message["id"] == "s1")
        assert split["op"] == "changed", split
        assert {each["track"]: each["frames"] for each in split["tracks"]} == {5: [0, 1, 2, 3], 9: [4, 5, 6, 7]}
        versions = {each["track"]: each["version"] for each in split["tracks"]}
        merge = {"op": "track.merge", "track": 9, "into": 5, "base": versions[9], "into_base": versions[5]}
        client.send(id="m0", **merge, **shown)  # as the box was before the split
        late = client.until("changed", "refused", "conflict", wanted=lambda message: message["id"] == "m0")
        assert late["op"] == "conflict", late
        client.send(id="m1", **merge, **shown | {"box_base": late["present"]["version"]})
        merged = client.until("changed", "refused", "conflict", wanted=lambda message: message["id"] == "m1")
        assert merged["op"] == "changed", merged
        assert next(each["frames"] for each in merged["tracks"] if each["track"] == 5) == list(range(FRAMES))


@pytest.mark.parametrize(("kind", "limit_m"), [("click", 0.5), ("drag", 0.4), ("rectangle", 0.4), ("refit", 0.4)])
def test_gestures_find_the_car(live, kind, limit_m):
    x, y = place(3)[:2]
    corners = [x - 2.4, y - 1.1, x + 2.4, y - 1.1, x + 2.4, y + 1.1, x - 2.4, y + 1.1]
    at = {"click": [x - 2.2, y], "drag": [x - 2.2, y, x + 2, y], "rectangle": corners, "refit": []}[kind]
    with live.window() as client:
        around = [x + 0.3, y + 0.2, 0.85, *SIZE_M, 0.05] if kind == "refit" else None
        client.send(op="fit", id=kind, frame=3, kind=kind, at=at, class_name="vehicle", around=around)
        found = client.until("fitted", "refused")
        assert found["op"] == "fitted", found
        assert float(np.hypot(found["box"][0] - x, found["box"][1] - y)) < limit_m
        assert found["points"] > 100
        turn = abs(np.arctan2(np.sin(2 * found["box"][6]), np.cos(2 * found["box"][6]))) / 2
        assert turn < np.radians(6)


def test_a_gesture_without_its_numbers_is_refused(live):
    with live.window() as client:
        client.send(op="fit", id="f", frame=0, kind="drag", at=[1, 2], class_name="vehicle")
        assert "needs 4 numbers" in client.until("refused")["sentence"]


def test_checks_of_all_frames_and_one_let_stand(live):
    with live.window() as client:
        client.open(0)
        row = client.open(0)["boxes"][0]
        value = {name: row[name] for name in ("box", "class_name", "track", "state", "source", "attributes")}
        value |= {"box": [30.0, -10.0, 1.1, *SIZE_M, 0.0], "track": None}
        client.send(op="box.add", id="e1", frame=0, box="empty-1", value=value)
        client.until("ack")
        found = client.until(
            "checks", wanted=lambda message: any(each["box"] == "0:empty-1" for each in message["rows"])
        )
        finding = next(each for each in found["rows"] if each["box"] == "0:empty-1")
        assert finding["check"] == "empty"
        client.send(op="check.ignore", id="c1", check=finding["id"], reason="hidden by a wall")
        later = client.until(
            "checks", wanted=lambda message: any(each["ignored"] == "hidden by a wall" for each in message["rows"])
        )
        assert later["frame"] == 0
        client.send(op="box.add", id="e2", frame=0, box="empty-2", value=value)
        client.until("ack")
        client.send(op="timing", frame=0, box="0:empty-1", seconds=12.5, edits=2)


def drive_findings(client: Client, rows: dict[int, list], *, done: int) -> dict[int, list]:
    """Take in the findings of the drive until so many frames are checked with their points."""
    while True:
        reply = client.until("drive.checks")
        for frame in reply["frames"]:
            rows[frame] = [row for row in reply["rows"] if row["frame"] == frame]
        if reply["done"] == done and len(rows) == reply["total"]:
            return rows


def test_findings_of_the_whole_drive_come_by_themselves_and_follow_edits(live):
    with live.window() as client, live.window() as other:
        client.open(0)
        client.send(op="check.list", frame=0)
        rows = drive_findings(client, {}, done=FRAMES)
        assert set(rows) == set(range(FRAMES))
        last = FRAMES - 1
        before = [row["check"] for row in rows[last]]
        value = {"class_name": "vehicle", "box": [30.0, -20.0, 3.1, *SIZE_M, 0.0], "track": None}
        other.send(op="box.add", id="far-1", frame=last, box="far-1", value=value)
        other.until("ack")
        rows = drive_findings(client, rows, done=FRAMES)
        mine = [row for row in rows[last] if row["box"] == f"{last}:far-1"]
        assert "empty" in {row["check"] for row in mine}  # against the points of a frame that nobody shows
        assert mine[0]["at"] == [30.0, -20.0]
        other.send(op="undo", id="far-2")
        rows = drive_findings(client, rows, done=FRAMES)
        assert [row["check"] for row in rows[last]] == before


def test_two_windows_that_make_an_object_at_once_give_it_two_numbers(live):
    value = {"class_name": "vehicle", "box": [20.0, -15.0, 0.9, *SIZE_M, 0.0], "track": 40}
    with live.window() as one, live.window() as two:
        for window, number in ((one, 40), (two, 41)):
            window.send(op="box.add", id=window.new_id(), frame=2, box=window.new_id(), value=value, fresh=True)
            assert window.until("ack", "refused")["row"]["track"] == number
        two.send(op="box.add", id=two.new_id(), frame=3, box=two.new_id(), value=value)  # the same object, later
        assert two.until("ack", "refused")["row"]["track"] == 40


def test_several_sweeps_are_one_cloud_with_its_ages(live):
    with live.window() as client:
        alone = client.open(1)["layers"][0]
        several = client.open(1, sweeps=2)["layers"][0]
        unlabelled = client.open(3, sweeps=2)
    assert (several["sweeps"], several["url"]) == (2, alone["url"] + "?sweeps=2")
    (one, _), (two, arrays) = (decode(live.get("/" + layer["url"])[2]) for layer in (alone, several))
    assert two["count"] == 2 * one["count"]
    field = next(each for each in two["fields"] if each["name"] == "lag_s")
    assert (round(field["low"], 3), round(field["high"], 3)) == (0.0, 0.1)
    assert len(np.unique(arrays["lag_s"])) == 2
    assert unlabelled["layers"][0]["sweeps"] == 2  # its pose stands with its conditions, not with its labels


class SlowPropagation:
    """Propagates once it may, and counts how often it was called."""

    def __init__(self) -> None:
        self.calls, self.may = 0, threading.Event()

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        self.calls += 1
        assert self.may.wait(20)
        return propagate_track(*arguments, **options)


def test_a_long_edit_that_comes_again_while_it_goes_on_is_made_once(live, monkeypatch):
    slow = SlowPropagation()
    monkeypatch.setattr(annotating, "propagate_track", slow)
    with live.window() as client:
        row = client.open(1)["boxes"][0]
        edit = {"op": "track.propagate", "id": "again", "box": row["id"], "base": row["version"], "track": 5}
        for _ in range(2):
            client.send(**edit, first=1, last=2)
        client.open(3)  # both have come
        slow.may.set()
        first = client.until("ack")
        client.send(**edit, first=1, last=2)
        assert client.until("ack")["seq"] == first["seq"]
        assert slow.calls == 1
        client.send(op="undo", id=client.new_id())
        client.until("ack")
