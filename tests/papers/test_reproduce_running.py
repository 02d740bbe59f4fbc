"""What a job leaves besides its scores: peak memory of the process, and words that are kept down."""

import fcntl
import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")

from tinygrid import tiny

from farfield.errors import ConfigError, FileFormatError
from farfield.jobs import Unit, folders
from farfield.papers import running
from farfield.papers.deciding import Scores
from farfield.papers.running import CpuTime, quiet
from farfield.papers.scoring import ScoringTask


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux says")
def test_peak_memory_is_what_the_process_held_at_most() -> None:
    """In a process of its own: the tests before this one have held more than it will."""
    lines = (
        "import numpy as np",
        "from farfield.papers.running import peak_memory_mb",
        "print(peak_memory_mb())",
        "large = np.ones(40_000_000)",
        "print(peak_memory_mb())",
        "del large",
        "print(peak_memory_mb())",
    )
    said = subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, capture_output=True, text=True).stdout
    before, there, after = map(float, said.split())
    assert there - before == pytest.approx(320, abs=5)
    assert after == pytest.approx(there, abs=2)  # Linux counts pages in batches


def test_trainings_are_kept_from_saying_what_is_in_order() -> None:
    quiet()
    assert logging.getLogger("lightning_fabric").getEffectiveLevel() == logging.WARNING


def test_what_killed_processes_took_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(running.time, "process_time", lambda: now[0])
    monkeypatch.setattr(running.time, "monotonic", lambda: now[0])
    path = tmp_path / "job" / "spent.json"
    first = CpuTime(path)
    for now[0] in (105.0, 115.0, 120.0):
        first.step(1, {})
    now[0] = 3.0  # it was killed: another process goes on
    second = CpuTime(path)
    now[0] = 10.0
    assert second.seconds == pytest.approx(15.0 + 7.0)  # up to ten seconds of the first are lost
    second.note()
    assert CpuTime(path).seconds == pytest.approx(22.0)
    second.remove()
    assert CpuTime(path).seconds == pytest.approx(0.0)
    path.write_text("[1", encoding="utf-8")
    assert CpuTime(path).seconds == pytest.approx(0.0)


@pytest.mark.parametrize("killed_at_scoring", [False, True])
def test_weights_that_were_brought_are_told_from_those_of_a_killed_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed_at_scoring: bool
) -> None:
    made = tiny(tmp_path)
    (job, *_) = made.jobs(made.locations)
    scoring = ScoringTask(score=made.settings.score, locations={}, fingerprints={}, needs=(), replicates=2)
    monkeypatch.setattr(ScoringTask, "of_job", lambda self, job, weights: {"clouds": {}})
    home = tmp_path / job.folder
    home.mkdir(parents=True)
    (home / running.WEIGHTS).write_bytes(b"of another machine")
    if killed_at_scoring:
        (home / running.SPENT).write_text('{"processor_s": 60.0}', encoding="utf-8")
    done = running.RunTask(tmp_path, scoring)(Unit(job.folder, parameters=job))
    assert ("brought" in done.clock) is not killed_at_scoring
    assert (done.clock["processor_s"] >= 60.0) is killed_at_scoring


def diverge(self: object, report: object = None) -> None:
    raise RuntimeError("The total norm of order 2.0 for gradients is non-finite, so it cannot be clipped.")


def run_out(self: object, report: object = None) -> None:
    raise RuntimeError("not enough memory")


def test_a_training_that_diverges_is_said_and_stops_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = tiny(tmp_path)
    (job, *_) = made.jobs(made.locations)
    scoring = ScoringTask(score=made.settings.score, locations={}, fingerprints={}, needs=(), replicates=2)
    monkeypatch.setattr(running.Plan, "run", diverge)
    (tmp_path / job.folder).mkdir(parents=True)
    done = running.RunTask(tmp_path, scoring)(Unit(job.folder, parameters=job))
    scores = json.loads(done.files[0].read_text())
    assert scores["failed"].startswith("diverged: ")
    assert Scores.of([scores]).by_run == {}
    monkeypatch.setattr(running.Plan, "run", run_out)
    with pytest.raises(RuntimeError, match="memory"):  # the next time it may suffice
        running.RunTask(tmp_path, scoring)(Unit(job.folder, parameters=job))


@pytest.mark.parametrize("torn", ['{"processor_s": ', "\0\0\0", "\0\0\n"])
def test_a_torn_last_line_of_the_clock_is_cut_before_the_next(tmp_path: Path, torn: str) -> None:
    (job, *_) = tiny(tmp_path).jobs(tiny(tmp_path).locations)
    home = tmp_path / job.folder
    home.mkdir(parents=True)
    (home / running.CLOCK).write_text('{"processor_s": 1.0}\n' + torn)
    assert running.clocks_of(job, tmp_path) == [{"processor_s": 1.0}]
    running.RunTask._finish(home, {}, CpuTime(home / "spent.json"))
    assert [clock["processor_s"] for clock in running.clocks_of(job, tmp_path)] == [1.0, 0.0]
    (home / running.CLOCK).write_text('words\n{"processor_s": 1.0}\n')
    with pytest.raises(FileFormatError, match=r"line 1: expected times as JSON.*Remove the line"):
        running.clocks_of(job, tmp_path)


def test_two_commands_do_not_work_in_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders, "_PATIENCE_S", 0.2)
    handle = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)  # as another process would
    with pytest.raises(ConfigError, match=r"no other command.*--page"):
        tiny(tmp_path).run()
    os.close(handle)


def test_a_job_that_is_only_trained_is_not_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = tiny(tmp_path)
    (job, *_) = made.jobs(made.locations)
    scoring = ScoringTask(score=made.settings.score, locations={}, fingerprints={}, needs=(), replicates=2)
    monkeypatch.setattr(running.Plan, "run", leave_weights)
    home = tmp_path / job.folder
    running.RunTask(tmp_path, scoring, train_only=True)(Unit(job.folder, parameters=job))
    assert {path.name for path in home.iterdir()} == {running.WEIGHTS, running.CLOCK}
    (clock,) = running.clocks_of(job, tmp_path)
    assert "scoring_s" not in clock
    monkeypatch.setattr(ScoringTask, "of_job", lambda self, job, weights: {"clouds": {}})
    running.RunTask(tmp_path, scoring)(Unit(job.folder, parameters=job))
    trained, scored = running.clocks_of(job, tmp_path)
    assert trained == clock
    assert scored["brought"]


def leave_weights(self: running.Plan, report: object = None) -> None:
    self.folder.mkdir(parents=True)
    (self.folder / running.WEIGHTS).write_bytes(b"weights")
    (self.folder / "checkpoint.pt").write_bytes(b"of the last step")
