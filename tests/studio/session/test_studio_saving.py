"""What is kept where: in the journal, in label files of a chosen place and format, at the end, on a read-only disk."""

import errno
import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio.live import Client, studio

from farfield import open_dataset
from farfield.annotation import journal, saving

VALUE = {"class_name": "vehicle", "box": [12.0, 3.0, 0.8, 4.6, 1.9, 1.6, 0.0], "track": 1}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two clouds with a box each, in files of their own."""
    root = tmp_path / "clouds"
    root.mkdir()
    for frame in range(2):
        points = np.random.default_rng(frame).uniform((-20, -20, -2, 0), (20, 20, 2, 1), (500, 4)).astype("<f4")
        (root / f"{frame:06d}.bin").write_bytes(points.tobytes())
        (root / f"{frame:06d}.json").write_text(
            '{"boxes": [{"label": "vehicle", "centre_m": [8.0, 2.0, 0.0], "size_m": [4.6, 1.9, 1.6], "yaw_rad": 0.0}]}'
        )
    return root


def running(folder: Path, **settings: Any):
    place = {"edits": folder.parent / "edits", "notes": folder.parent, "out": folder.parent / "out"}
    return studio(partial(open_dataset, folder), mode="annotate", annotator="kim", extent="full", **place | settings)


def added(client: Client, name: str) -> dict[str, Any]:
    client.send(op="box.add", id=client.new_id(), frame=0, box=name, value=VALUE | {"box": [*VALUE["box"][:6], 0.1]})
    return client.until("ack", "refused")


def test_edits_are_counted_until_labels_have_them_where_and_as_it_was_chosen(folder: Path):
    with running(folder) as live, live.window() as client, live.window() as other:
        state = client.welcome["written"]
        assert (state["unwritten"], state["written_ns"], state["at_exit"]) == (0, None, False)
        assert (state["next_folder"], state["next_format"]) == ("out", client.welcome["formats"][0])
        assert [added(client, f"a-{number}")["unwritten"] for number in range(2)] == [1, 2]
        assert other.until("changed", wanted=lambda message: message["unwritten"] == 2)
        client.send(op="save.choose", id="c-1", format="cvat", folder="mine", at_exit=True)
        for window in (client, other):
            state = window.until("labels")
            assert (state["answers"], state["next_folder"], state["next_format"]) == ("c-1", "labels-cvat", "cvat")
        client.send(op="save.choose", id="c-2", format="pascal")
        assert "pascal" in client.until("refused")["sentence"]
        client.send(op="save.choose", id="c-3", folder="..")
        assert client.until("refused")["id"] == "c-3"
        client.send(op="save", id="s-1")
        assert client.until("saved", "refused")["folder"] == "labels-cvat"
        for window in (client, other):
            state = window.until("labels")
            assert (state["unwritten"], state["folder"], state["format"]) == (0, "labels-cvat", "cvat")
        assert list((folder.parent / "mine" / "labels-cvat").rglob("*"))
        assert added(client, "a-3")["unwritten"] == 1
        client.send(op="save.choose", id="c-4")
        client.until("labels")
    assert "1 edit kept in the journal" in live.lines[-1]
    with running(folder) as live, live.window() as client:  # over a restart
        state = client.welcome["written"]
        assert (state["unwritten"], state["folder"], state["format"]) == (1, "labels-cvat", "cvat")


def test_labels_are_written_at_the_end_if_that_is_asked_for(folder: Path):
    with running(folder, save_at_exit=True) as live:
        with live.window() as client:
            assert client.welcome["written"]["at_exit"] is True
            added(client, "a-1")
        assert not (folder.parent / "out").exists()
    assert "labels written to out" in live.lines[-1]
    assert len((folder.parent / "out" / "labels.csv").read_text().splitlines()) == 4  # a head, two boxes, and one more


def test_labels_in_place_are_written_at_the_end_though_others_were_before(tmp_path: Path):
    """A folder of sweeps without labels: those of the annotators' own making are written in their places."""
    root = tmp_path / "clouds"
    root.mkdir()
    np.save(root / "0000.npy", np.ones((50, 4), np.float32))
    settings = {"edits": tmp_path / "edits", "notes": tmp_path}
    running_here = studio(partial(open_dataset, root), mode="annotate", annotator="kim", extent="full", **settings)
    with running_here as live, live.window() as client:
        assert client.welcome["written"]["itself"] is True
        added(client, "a-1")
        client.send(op="save", id="s-1", folder="mine", format="cvat")
        assert client.until("saved", "refused")["folder"] == "labels-cvat"
        client.send(op="save.choose", id="c-1", folder="other", format="openlabel", at_exit=True)
        client.until("labels", wanted=lambda message: message["answers"] == "c-1")
    assert "a-1" in (tmp_path / "edits" / "edits.jsonl").read_text()
    assert (tmp_path / "edits" / "labels.csv").is_file()
    assert list((tmp_path / "edits" / "other" / "labels-openlabel").rglob("*.json"))


def read_only(*_: Any, **__: Any) -> Any:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS), "labels")


def test_labels_on_a_read_only_disk_leave_the_edits_in_the_journal(folder: Path, monkeypatch: pytest.MonkeyPatch):
    with running(folder, save_at_exit=True) as live:
        with live.window() as client:
            added(client, "a-1")
            with monkeypatch.context() as patch:
                patch.setattr(saving, "_updated", read_only)
                client.send(op="save", id="s-1")
                refused = client.until("saved", "refused")
                assert (refused["op"], refused["id"]) == ("refused", "s-1")
                assert "Read-only file system" in refused["sentence"]
                assert "the journal has all edits" in refused["sentence"]
            with live.window() as again:
                assert again.welcome["written"]["unwritten"] == 1
                assert len(again.open(0)["boxes"]) == 2
        monkeypatch.setattr(saving, "_updated", read_only)
    assert "1 edit kept in the journal" in live.lines[-1]
    assert "Read-only file system" in live.lines[-1]


def test_why_labels_in_their_places_could_not_be_written_at_the_end_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    root = tmp_path / "clouds"
    root.mkdir()
    np.save(root / "0000.npy", np.ones((50, 4), np.float32))
    settings = {"edits": tmp_path / "edits", "notes": tmp_path}
    with studio(partial(open_dataset, root), mode="annotate", annotator="kim", extent="full", **settings) as live:
        with live.window() as client:
            added(client, "a-1")
        monkeypatch.setattr(saving, "_write_or_remove", read_only)
    assert "1 edit kept in the journal" in live.lines[-1]
    assert "Read-only file system" in live.lines[-1]


def test_a_journal_on_a_read_only_disk_takes_no_edit_and_says_so(folder: Path, monkeypatch: pytest.MonkeyPatch):
    with running(folder) as live, live.window() as client:
        added(client, "a-1")
        with monkeypatch.context() as patch:
            patch.setattr(journal.os, "write", partial(_read_only_write, os.write))
            refused = added(client, "a-2")
        assert (refused["op"], refused["code"]) == ("refused", "journal")
        assert "Read-only file system" in refused["sentence"]
        state = client.open(0)
        assert [row["id"] for row in state["boxes"] if "a-" in row["id"]] == ["0:a-1"]


def _read_only_write(write: Any, handle: int, data: Any) -> int:
    if bytes(data).rstrip().endswith(b"}"):  # a line of the journal, not the socket's
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))
    return int(write(handle, data))
