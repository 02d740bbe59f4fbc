"""kill -9 of a process that edits: what was acknowledged is there, and nothing that was never sent."""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from edited_drives import ANN, default_rows, opened, state_bytes

from farfield.annotation.store import undo
from farfield.datasets.edits import Record

SERVER = Path(__file__).with_name("edit_server.py")
FRAMES = 20


def place_m(number: int) -> float:
    """Where an edit puts its box."""
    return 100.0 + number / 4


def _killed(root: Path, edits: int, after: int) -> set[str]:
    """Send edits to a process and kill it after so many acknowledgements; which were acknowledged."""
    command = [sys.executable, str(SERVER), str(root)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        assert server.stdout.readline() == b"ready\n"
        acknowledged: set[str] = set()
        sent = 0
        while len(acknowledged) < after:
            more = range(sent, min(sent + 25, edits))  # a window sends on while it waits
            lines = (json.dumps({"id": f"e{n}", "row": n % FRAMES, "x": place_m(n)}) + "\n" for n in more)
            os.write(server.stdin.fileno(), "".join(lines).encode())
            sent += len(more)
            acknowledged.add(server.stdout.readline().split()[0].decode())
        server.kill()
        acknowledged |= {line.split()[0].decode() for line in server.stdout if line.endswith(b"\n")}
    return acknowledged


def _check(root: Path, edits: int, acknowledged: set[str]) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torn.*")
        store = opened(root)
    with store:
        records: list[Record] = [store.journal.read(seq) for seq in range(1, len(store.journal) + 1)]
        kept = [record.id for record in records]
        assert acknowledged <= set(kept)
        assert kept == [f"e{number}" for number in range(len(kept))]  # in order, without gaps, nothing made up
        assert len(kept) <= edits
        for row in range(FRAMES):
            last = max((number for number in range(len(kept)) if number % FRAMES == row), default=None)
            there = store.row(("a", f"{row:04d}"), "0")
            assert there is not None
            assert there.label.box[0] == (default_rows()[row][3] if last is None else place_m(last))


def test_killed_once(tmp_path: Path) -> None:
    acknowledged = _killed(tmp_path, 300, 137)
    assert len(acknowledged) >= 137
    _check(tmp_path, 300, acknowledged)


@pytest.mark.slow
def test_killed_twenty_times_during_a_thousand_edits(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for repeat in range(20):
        root = tmp_path / f"run{repeat}"
        acknowledged = _killed(root, 1000, int(rng.integers(1, 990)))
        _check(root, 1000, acknowledged)


def test_taken_back_to_the_first_edit_after_a_kill(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        begin = state_bytes(store)
    acknowledged = _killed(tmp_path, 200, 60)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torn.*")
        store = opened(tmp_path)
    with store:
        steps = store.history.counts("ann")[0]
        assert steps >= len(acknowledged)
        for number in range(steps):
            undo(store, ANN, f"u{number}")
        assert state_bytes(store) == begin
