"""A tiny grid from end to end: killed at any time and gone on with, it gives the very same figures and decisions."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from tinygrid import RUNS, tiny
from whole import whole_or

from farfield.errors import ConfigError
from farfield.papers.running import JOURNAL

SUPPORT = Path(__file__).resolve().parents[1] / "support"
PATIENCE_S = 240.0
JOBS = 2 * len(RUNS)


def started(out: Path, workers: int) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(SUPPORT), *filter(None, sys.path)])}
    command = [sys.executable, str(SUPPORT / "tinygrid.py"), str(out), str(workers)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)


def finished(out: Path) -> int:
    journal = out / "runs" / JOURNAL
    return len(journal.read_bytes().splitlines()) if journal.is_file() else 0


def killed_after(out: Path, runs: int) -> None:
    """Start the command and kill it when so many runs are finished, or before any while the first is trained."""
    command = started(out, workers=2)
    began = time.monotonic()
    try:
        while finished(out) < runs or not any(out.glob("runs/*/log.jsonl")):
            assert command.poll() is None, "it ended before it could be killed"
            assert time.monotonic() - began < PATIENCE_S
            time.sleep(0.005)
    finally:
        command.send_signal(signal.SIGKILL)
        command.wait()


def summary(out: Path) -> dict[str, Any]:
    return dict(json.loads((out / "reproduction.json").read_text()))


def checked_plan(out: Path) -> None:
    """What a plan says and measures, before anything is run; one that does not fit is refused at once."""
    reproduction = tiny(out)
    for name in reproduction.settings.sets:  # of a command that was killed while it measured
        (out / ".measure" / "data" / name).mkdir(parents=True)
    outline = reproduction.outline()
    measured = json.loads((out / "measured.json").read_text())
    assert measured["simulating_s"].keys() == reproduction.settings.sets.keys()
    assert min(measured["simulating_s"].values()) > 0
    assert (outline.jobs, outline.rows, outline.seeds) == (JOBS, len(RUNS), 2)
    assert reproduction.outline() == outline  # measured once
    assert not (out / "data").exists()  # a plan simulates no data but those it measures on
    hasty = replace(reproduction, minutes=0.001)
    began = time.process_time()
    with pytest.raises(ConfigError, match="fewest steps"):
        hasty.outline()
    assert time.process_time() - began < 1  # nothing is measured again


@pytest.mark.first
@pytest.mark.slow
def test_killed_twice_it_gives_the_same_and_redoes_nothing(tmp_path: Path) -> None:
    whole, torn = tmp_path / "whole", tmp_path / "torn"
    checked_plan(whole)
    page = tiny(whole).run()
    assert page.is_file()
    expected = summary(whole)
    assert expected["runs"] == {"planned": JOBS, "done": JOBS}
    verdicts = {claim["id"]: claim["verdict"] for claim in expected["claims"]}
    assert verdicts["C4"] == "not run"
    assert verdicts["C0"] != "not run"

    for runs in whole_or((0, 3), (3,)):
        killed_after(torn, runs)
    before = {path: path.stat().st_mtime_ns for path in torn.glob("runs/*/weights.safetensors")}
    assert 3 <= len(before) < JOBS
    assert started(torn, workers=2).wait(PATIENCE_S) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before  # no finished training was done again
    assert summary(torn) == expected
    assert (torn / "reproduction.json").read_bytes() == (whole / "reproduction.json").read_bytes()
    assert not [*torn.rglob("checkpoint.pt"), *torn.rglob(".measure")]

    scores = next(torn.glob("runs/s0-uniform-*/scores.json"))
    scores.write_text("{}")
    tiny(torn).run()  # what was damaged is scored again, not trained
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert summary(torn) == expected

    (torn / ".measure" / "data").mkdir(parents=True)  # of a command for other workers, killed while it measured
    tiny(torn).run()
    assert not (torn / ".measure").exists()

    lost = next(whole.glob("runs/s1-uniform-*/scores.json"))
    lost.unlink()
    tiny(whole).run(page_only=True)  # the page of what is there
    assert summary(whole)["runs"] == {"planned": JOBS, "done": JOBS - 1}
    assert not lost.exists()
