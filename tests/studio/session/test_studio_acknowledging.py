"""What an acknowledgement waits for: the disk, and never the clouds of a whole drive."""

import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio.live import Client, Live, studio
from studio.session.test_studio_classes import TANK, sweeps

from farfield import open_dataset
from farfield.annotation.surroundings import SortedPoints
from farfield.errors import FarfieldError
from farfield.studio.showing.annotations import AnnotationService

FRAMES = 3


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    root = sweeps(tmp_path / "a", FRAMES)
    place = {"edits": tmp_path / "edits", "notes": tmp_path, "out": tmp_path / "out"}
    with studio(partial(open_dataset, root), mode="annotate", annotator="kim", extent="full", **place) as running:
        yield running


def proposed(client: Client) -> int:
    """A proposal in every frame; the number of the last edit."""
    value = {"class_name": "tank", "box": [30.0, 2.0, 0.0, *TANK, 0.0], "track": None, "source": "detector"}
    for frame in range(FRAMES):
        edit = {"frame": frame, "box": f"p-{frame}", "value": value | {"state": "proposed", "attributes": {}}}
        client.send(op="box.add", id=client.new_id(), **edit)
        ack = client.until("ack", "refused")
        assert ack["op"] == "ack", ack
    return ack["seq"]


def accept_all(client: Client, base: int) -> None:
    client.send(op="box.accept", id="all", frame=0, first=0, last=FRAMES - 1, score=0.0, count=FRAMES, base=base)


def test_points_are_counted_where_a_window_shows_them(live: Live, monkeypatch: pytest.MonkeyPatch):
    counted: list[int] = []
    with live.window() as client:
        client.open(0)
        base = proposed(client)
        monkeypatch.setattr(SortedPoints, "count", lambda points, index, kind, box: counted.append(index) or 7)
        accept_all(client, base)
        rows = client.until("changed", wanted=lambda one: one["id"] == "all")["rows"]
        assert set(counted) == {0}
        assert [row["row"]["points"] for row in rows] == [7, None, None]


def test_a_message_that_comes_again_waits_for_the_acknowledgement_under_way(
    live: Live, monkeypatch: pytest.MonkeyPatch
):
    gate, passes, changed = threading.Event(), list[int](), AnnotationService.changed
    with live.window() as client:
        client.open(0)
        base = proposed(client)
        monkeypatch.setattr(
            AnnotationService,
            "changed",
            lambda *args: (passes.append(1), gate.wait(10), changed(*args))[-1],
        )
        for _ in range(3):
            accept_all(client, base)
        client.send(op="proposals.count", id="count", frame=0, score=0.0)
        client.until("proposals")
        gate.set()
        assert client.until("ack")["id"] == "all"
        assert len(passes) == 1
        accept_all(client, base)
        assert client.until("ack")["id"] == "all"  # it came once more, after the answer


def unreadable(error: Exception, *_: Any) -> int:
    raise error


@pytest.mark.parametrize("error", [FarfieldError("the cloud is damaged"), PermissionError(13, "Permission denied")])
def test_an_edit_that_is_stored_is_acknowledged_though_its_cloud_cannot_be_read(
    live: Live, monkeypatch: pytest.MonkeyPatch, error: Exception
):
    with live.window() as client:
        row = client.open(0)["boxes"][0]
        monkeypatch.setattr(SortedPoints, "around", partial(unreadable, error))
        value = {name: row[name] for name in ("class_name", "track", "state", "source", "attributes")}
        value["box"] = [row["box"][0] + 1.0, *row["box"][1:]]
        client.send(op="box.set", id="e", frame=0, box=row["id"], base=row["version"], value=value)
        ack = client.until("ack", "refused")
        assert ack["op"] == "ack", ack
        assert ack["row"]["points"] is None


def test_a_frame_whose_cloud_cannot_be_read_is_a_finding_of_the_drive_once_it_is_shown(
    live: Live, monkeypatch: pytest.MonkeyPatch
):
    with live.window() as client:
        client.open(0)
        client.send(op="check.list", frame=0)
        client.until("drive.checks", wanted=lambda one: one["done"] == one["total"])
        monkeypatch.setattr(SortedPoints, "around", partial(unreadable, PermissionError(13, "Permission denied")))
        client.open(1)
        rows = client.until("drive.checks", wanted=lambda one: 1 in one["frames"])["rows"]
        assert [row["check"] for row in rows] == ["unreadable"]
