"""Editing through the studio's WebSocket: a file's boxes changed, undone, seen by another window, saved."""

import csv
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio.live import studio

from farfield.errors import FarfieldError
from farfield.studio.samples import open_samples
from farfield.studio.session.frame_cache import FrameCache
from farfield.studio.showing.radar import RadarPower


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("annotated")


@pytest.fixture(scope="module")
def live(folder: Path):
    with studio(mode="annotate", annotator="kim", edits=folder / "edits", notes=folder) as running:
        yield running


def value_of(row: dict, **changed) -> dict:
    names = ("box", "class_name", "track", "state", "source", "attributes")
    return {name: row[name] for name in names} | changed


def set_box(client, frame: int, row: dict, **changed) -> dict:
    value = value_of(row, **changed)
    client.send(op="box.set", id=client.new_id(), frame=frame, box=row["id"], base=row["version"], value=value)
    return client.until("ack", "conflict", "refused")


def test_an_edit_is_acknowledged_seen_by_others_and_undone(live):
    with live.window() as mine, live.window(annotator="lee") as theirs:
        row = mine.open(0)["boxes"][0]
        theirs.open(0)
        moved = [row["box"][0] + 1.0, *row["box"][1:]]
        ack = set_box(mine, 0, row, box=moved)
        assert ack["op"] == "ack"
        assert int(ack["saved_ns"]) > 1.6e18
        assert ack["row"]["box"][0] == pytest.approx(moved[0])
        seen = theirs.until("changed")
        assert (seen["by"], seen["rows"][0]["row"]["version"]) == ("kim", ack["version"])
        late = set_box(theirs, 0, row, box=moved)
        assert late["op"] == "conflict"
        assert late["present"]["version"] == ack["version"]
        mine.send(op="undo", id=mine.new_id())
        back = mine.until("changed", wanted=lambda message: message["show"] is not None)
        assert back["show"] == 0
        assert back["rows"][0]["row"]["box"] == pytest.approx(row["box"])
        theirs.send(op="undo", id=theirs.new_id())
        assert theirs.until("refused")["code"] == "nothing"


def test_a_frame_that_becomes_unreadable_has_the_number_of_the_last_edit(live, monkeypatch):
    with live.window() as client:
        row = client.open(0)["boxes"][2]
        ack = set_box(client, 0, row, box=[row["box"][0] + 0.5, *row["box"][1:]])
        monkeypatch.setattr(FrameCache, "state", damaged)
        answer = client.open(0)
        assert "damaged" in answer["unreadable"]
        assert answer["seq"] >= ack["seq"]  # with an older one the page would ask again and again


def test_a_window_that_asks_for_no_frame_that_there_is_harms_no_check(live, capfd):
    with live.window() as client:
        client.open(0)
        assert client.open(9_999_999)["op"] == "refused"
        client.send(op="check.ignore", id=client.new_id(), check="x", reason="it is so")
        assert client.until("checks")["frame"] == 0
    assert "Traceback" not in capfd.readouterr().err


def test_an_attribute_without_a_value_is_refused_in_words(live):
    with live.window() as client:
        row = client.open(0)["boxes"][0]
        refused = set_box(client, 0, row, attributes={"colour": None})
        assert (refused["op"], refused["code"]) == ("refused", "attribute")


def damaged(*_) -> None:
    raise FarfieldError("the cloud is damaged")


def test_a_message_sent_twice_counts_once(live):
    with live.window() as client:
        row = client.open(0)["boxes"][1]
        edit = {"op": "box.set", "id": "twice", "frame": 0, "box": row["id"], "base": row["version"]}
        edit["value"] = value_of(row, box=[*row["box"][:6], 0.5])
        client.send(**edit)
        first = client.until("ack")
        client.send(**edit)
        assert client.until("ack")["seq"] == first["seq"]


def test_a_box_is_drawn_fitted_checked_and_saved(live, folder: Path):
    with live.window() as client:
        boxes = client.open(0)["boxes"]
        target = max((row for row in boxes if row["class_name"] == "vehicle"), key=lambda row: row["points"])
        client.send(op="box.delete", id=client.new_id(), frame=0, box=target["id"], base=target["version"])
        client.until("ack")
        x, y, yaw = target["box"][0], target["box"][1], target["box"][6]
        client.send(op="fit", id="f", frame=0, kind="click", at=[x, y], class_name="vehicle")
        found = client.until("fitted")
        assert found["id"] == "f"
        assert found["points"] > 5
        assert ((found["box"][0] - x) ** 2 + (found["box"][1] - y) ** 2) ** 0.5 < 1.5
        added = value_of(target, box=[*found["box"][:6], yaw], source="lidar")
        client.send(op="box.add", id=client.new_id(), frame=0, box="new-1", value=added)
        assert client.until("ack")["row"]["points"] > 0
        assert client.until("checks")["frame"] == 0
        client.send(op="save", id="s")
        saved = client.until("saved", "refused")
        assert saved["op"] == "saved"
        client.send(op="export", id="e", kind="labels", format="boxes-csv", name="mine")
        done = client.until("job", wanted=lambda job: job["state"] in ("done", "failed"))
        assert done["state"] == "done", done
        assert live.get("/" + done["url"])[2][:2] == b"PK"
    rows = list(csv.DictReader((folder / "edits" / "labels.csv").read_text().splitlines()))
    assert rows
    assert len({row["sequence"] for row in rows}) == 2


def test_detections_are_kept_apart_until_they_are_accepted(live):
    with live.window() as client:
        row = client.open(0)["boxes"][0]
        value = value_of(row, state="proposed", source="detector", box=[row["box"][0] + 30, *row["box"][1:]])
        client.send(op="box.add", id=client.new_id(), frame=0, box="p-1", value=value)
        made = client.until("ack")["row"]
        assert (made["state"], made["source"]) == ("proposed", "detector")
        assert set_box(client, 0, made, state="accepted")["row"]["state"] == "accepted"


def test_what_was_counted_is_accepted_and_nothing_else(live):
    with live.window() as client, live.window() as other:
        row = client.open(0)["boxes"][0]
        for number in range(3):
            box = [row["box"][0] + 60 + 8 * number, *row["box"][1:]]
            value = value_of(row, state="proposed", source="detector", box=box) | {"track": None}
            client.send(op="box.add", id=client.new_id(), frame=0, box=f"q-{number}", value=value)
            made = client.until("ack")["row"]
        client.send(op="proposals.count", id="count", frame=0, score=0.5)
        counted = client.until("proposals")
        assert (counted["here"], counted["count"], counted["frames"]) == (3, 3, 1)
        set_box(other, 0, made, box=[row["box"][0] + 90, *row["box"][1:]], state="proposed")
        accept = {"op": "box.accept", "frame": 0, "first": 0, "last": 0, "score": 0.5, "count": 3}
        client.send(**accept, id="late", base=counted["seq"])
        assert client.until("conflict", "refused", wanted=lambda one: one["id"] == "late")["op"] == "conflict"
        client.send(op="proposals.count", id="again", frame=0, score=0.5)
        seq = client.until("proposals")["seq"]
        client.send(**accept | {"count": 4}, id="more", base=seq)
        assert client.until("refused")["code"] == "proposals"
        client.send(**accept, id="all", base=seq)
        taken = client.until("changed", "refused", wanted=lambda one: one["id"] == "all")
        assert [one["row"]["state"] for one in taken["rows"]] == ["accepted"] * 3
        assert len({one["row"]["track"] for one in taken["rows"]} - {None}) == 3
        client.send(op="undo", id="back")
        back = client.until("changed", wanted=lambda one: one["id"] == "back")
        assert [one["row"]["state"] for one in back["rows"]] == ["proposed"] * 3


def test_tracks_of_the_page_are_numbers(live):
    with live.window() as client:
        assert client.welcome["tracks"]
        assert all(isinstance(track["track"], int) for track in client.welcome["tracks"])
        row = next(row for row in client.open(0)["boxes"] if row["track"] is not None)
        track = next(one for one in client.welcome["tracks"] if one["track"] == row["track"])
        edit = {"op": "track.set", "id": client.new_id(), "frame": 0, "track": row["track"], "base": track["version"]}
        edit |= {"box": row["id"], "box_base": row["version"]}
        client.send(**edit, size_locked=True)
        answer = client.until("changed", "refused")
        assert answer["op"] == "changed", answer
        assert answer["tracks"][0]["size_locked"] is True


def test_extent_is_declared_once(live):
    with live.window() as client:
        assert client.welcome["extent"] in ("full", "visible")
        other = "full" if client.welcome["extent"] == "visible" else "visible"
        client.send(op="policy.set", id=client.new_id(), extent=other)
        assert client.until("refused")["code"] == "extent"


@pytest.mark.parametrize("name", ["..", ".", "..."])
def test_a_save_stays_beside_the_journal(live, name):
    with live.window() as client:
        client.send(op="save", id="s", folder=name)
        assert "folder" in client.until("refused")["sentence"]


def test_an_object_that_only_the_radar_sees_stands_behind_its_peak(live):
    radar = open_samples()[1]
    power = RadarPower.read(radar.radar)
    pose = radar.sensors["cells"].frame_T_sensor
    peak = power.peak_near((40.0, 0.0), reach_m=15.0)
    here = pose @ np.array([*peak, 0.0, 1.0])
    with live.window() as client:
        client.open(1)
        at = [float(here[0]) + 0.4, float(here[1]) - 0.4]  # a hand's noise, within a metre and a half
        client.send(op="fit", id="r", frame=1, kind="peak", at=at, class_name="vehicle")
        found = client.until("fitted")
    assert found["source"] == "radar"
    x, y, _, length, width, _, yaw = found["box"]
    back = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) @ (here[:2] - [x, y])
    assert np.abs(np.abs(back) / [length / 2, width / 2]).max() == pytest.approx(1.0, abs=0.01)  # on a face
    assert np.hypot(*here[:2]) < np.hypot(x, y)  # the near one
