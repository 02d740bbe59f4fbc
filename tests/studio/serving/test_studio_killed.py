"""kill -9 in the midst of edits: nothing that was acknowledged is lost, and the next studio goes on from there."""

import contextlib
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio.live import Client, Live
from websockets.exceptions import ConnectionClosed

from farfield.datasets.edits import JOURNAL, Record, read_journal

EDITS = 1000


@contextlib.contextmanager
def process(edits: Path) -> Iterator[tuple[subprocess.Popen, Live]]:
    """A studio in a process of its own."""
    command = [sys.executable, "-m", "farfield.cli", "annotate", "--no-browser", "--port", "0", "--edits", str(edits)]
    environment = os.environ | {"XDG_DATA_HOME": str(edits), "SSH_CONNECTION": ""}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as running:
        try:
            line = running.stdout.readline()
            live = Live(int(re.search(r"127\.0\.0\.1:(\d+)/", line)[1]), [line])
            until = time.monotonic() + 60
            while not json.loads(live.get("/health")[2])["ready"] and time.monotonic() < until:
                time.sleep(0.05)
            live.enter()
            yield running, live
        finally:
            running.kill()


def edit_until_killed(edits: Path, after: int, turn: int) -> tuple[set[str], set[str]]:
    """Send edits as fast as they go, kill the studio after so many replies; ids sent and ids acknowledged."""
    sent, acknowledged = set(), set()
    with process(edits) as (running, live), contextlib.suppress(ConnectionClosed, OSError), live.window() as client:
        row = client.open(0)["boxes"][0]
        sender = threading.Thread(target=send_all, args=(client, row, sent, turn), daemon=True)
        sender.start()
        while len(acknowledged) < after:
            message = client.until("ack", "conflict", "refused")
            assert message["op"] == "ack", message
            acknowledged.add(message["id"])
        running.kill()
        while True:  # what was on its way
            message = client.until("ack")
            acknowledged.add(message["id"])
    return sent, acknowledged


def send_all(client: Client, row: dict, sent: set[str], turn: int) -> None:
    """Each edit starts from the one before it, whose number is its version, as nobody else edits."""
    value = {name: row[name] for name in ("box", "class_name", "track", "state", "source", "attributes")}
    with contextlib.suppress(ConnectionClosed, OSError):
        for number in range(EDITS):
            name, version = f"kill-{turn}-{number}", row["version"] + number
            value["box"] = [*row["box"][:6], (number % 600) / 100 - 3]
            sent.add(name)
            client.send(op="box.set", id=name, frame=0, box=row["id"], base=version, value=value)


def kept(edits: Path) -> list[str]:
    records: list[Record] = []
    read_journal(edits / JOURNAL, records.append)
    return [record.id for record in records]


def lost(tmp_path: Path, kills: int, rng: np.random.Generator) -> int:
    missing = 0
    for turn in range(kills):
        sent, acknowledged = edit_until_killed(tmp_path, int(rng.integers(1, EDITS // 2)), turn)
        mine = {name for name in kept(tmp_path) if name.startswith(f"kill-{turn}-")}
        missing += len(acknowledged - mine)
        assert mine <= sent
        assert acknowledged
    return missing


def test_no_acknowledged_edit_is_lost_by_a_kill(tmp_path: Path):
    assert lost(tmp_path, 1, np.random.default_rng(1)) == 0
    with process(tmp_path) as (_, live), live.window() as client:
        version = client.open(0)["boxes"][0]["version"]
        assert version == len(kept(tmp_path))
        client.send(op="undo", id="back")
        assert client.until("changed", wanted=lambda message: message["show"] is not None)["rows"]


@pytest.mark.slow
def test_no_acknowledged_edit_is_lost_by_eight_kills(tmp_path: Path):
    assert lost(tmp_path, 8, np.random.default_rng(2)) == 0
