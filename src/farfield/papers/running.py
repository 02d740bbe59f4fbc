"""Do the jobs of a grid in bulk: train or go on, detect, score; a finished job is never done again."""

import json
import logging
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.errors import FileFormatError, plain
from farfield.experiments.plan import Plan
from farfield.files.atomic import read_bytes, write_text
from farfield.jobs import JobJournal, JobOptions, Unit, UnitResult, run
from farfield.papers.grid import Tree
from farfield.papers.jobs import TrainingJob, waves
from farfield.papers.scoring import ScoringTask
from farfield.training.report import TrainingReport

JOURNAL = ".journal.jsonl"
SCORES, WEIGHTS = "scores.json", "weights.safetensors"
_MAX_BYTES = 1 << 28
SPENT = "spent.json"
"""Of the time that a job has taken while it is not done; see :class:`CpuTime`."""
_NOTED_EVERY_S = 10.0
_STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class RunTask:
    """Does a job in its folder; the unit's parameters are the job.

    Args:
        folder: Folder of all jobs' folders.
        scoring: How it is scored.
    """

    folder: Path
    scoring: ScoringTask

    memory_bytes = 4_000_000_000
    own_process = True

    def __call__(self, unit: Unit) -> UnitResult:
        """Train unless the weights are there, score, and write the scores."""
        job: TrainingJob = unit.parameters
        home, began = self.folder / job.folder, time.monotonic()
        weights = home / WEIGHTS
        brought = weights.is_file() and not (home / SPENT).is_file()  # a process killed at scoring left what it spent
        spending = CpuTime(home / SPENT)
        quiet()
        failed = "" if weights.is_file() else _trained(job, home, spending)
        spending.note()
        trained = time.monotonic()
        clock: dict[str, Any] = {"training_s": round(trained - began, 1), "peak_memory_mb": peak_memory_mb()}
        if brought:
            clock["brought"] = True
        scores = failure(job, failed) if failed else self.scoring.of_job(job, weights)
        write_text(home / SCORES, json.dumps(scores, separators=(",", ":")) + "\n")
        (home / "checkpoint.pt").unlink(missing_ok=True)
        clock["scoring_s"] = round(time.monotonic() - trained, 1)
        clock["processor_s"] = round(spending.seconds, 1)
        _note(home / "clock.jsonl", clock)
        spending.done()
        return UnitResult(files=(home / SCORES,), clock=clock)


class CpuTime(TrainingReport):
    """The processor's time that a job takes, with what was taken by processes that were killed at it.

    Args:
        path: The file that keeps it while the job is not done.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._begun, self._noted = path, time.process_time(), time.monotonic()
        with suppress(OSError, ValueError, TypeError, KeyError, FileFormatError):
            known = json.loads(read_bytes(path, max_bytes=_MAX_BYTES))
            self._begun -= float(known["processor_s"])

    @property
    def seconds(self) -> float:
        """Of all processes so far."""
        return time.process_time() - self._begun

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Keep it now and then."""
        del step, losses
        if time.monotonic() - self._noted >= _NOTED_EVERY_S:
            self.note()

    def note(self) -> None:
        """Keep it."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_text(self._path, json.dumps({"processor_s": round(self.seconds, 1)}) + "\n")
        self._noted = time.monotonic()

    def done(self) -> None:
        """The job is done: what it took is told elsewhere."""
        self._path.unlink(missing_ok=True)


def _trained(job: TrainingJob, home: Path, report: TrainingReport) -> str:
    """Train a job; what went wrong if it diverged, which it would do again."""
    try:
        Plan(job.experiment, home).run(report)
    except RuntimeError as error:
        if "non-finite" not in str(error):
            raise
        return f"diverged: {error}"
    return ""


def failure(job: TrainingJob, why: str) -> Tree:
    """The scores of a job that has none."""
    return {"runs": list(job.runs), "seed": job.seed, "key": job.key, "clouds": {}, "failed": why}


def _note(path: Path, clock: Mapping[str, Any]) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(clock) + "\n")


def quiet() -> None:
    """Let the trainings of this process say only what is amiss."""
    logging.getLogger("lightning_fabric").setLevel(logging.WARNING)


def peak_memory_mb() -> float | None:
    """Peak memory of this process, 10^6 bytes; None where the system does not say."""
    with suppress(OSError, ValueError):
        lines = _STATUS.read_text(encoding="ascii", errors="replace").splitlines()
        found = [line.split()[1] for line in lines if line.startswith("VmHWM:")]
        return round(int(found[0]) * 1024 / 1e6, 1) if found else None
    return None


def do_all(
    jobs: Sequence[TrainingJob],
    folder: Path,
    scoring: ScoringTask,
    *,
    workers: int,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
    said: Callable[[str], object] | None = None,
) -> None:
    """Do all jobs that are not done: first those that others start from, then seed by seed.

    Args:
        jobs: The jobs.
        folder: Folder of their folders and of the journal.
        scoring: How they are scored.
        workers: Processes, one thread each.
        progress: Wraps the numbers of the jobs that are left.
        said: Called with a line before each wave.

    Raises:
        BulkError: If jobs killed their workers twice; all others are done.
    """
    journal = JobJournal(folder / JOURNAL, scoring.digest)
    for wave in waves(jobs):
        units = units_of(wave)
        left = sum(not journal.has(unit) for unit in units)
        if said is not None and left:
            said(f"{left} of {len(units)} runs are left: {_named(wave)}")
        run(RunTask(folder, scoring), units, JobOptions(workers=workers, progress=progress), journal=journal)


def _named(wave: Sequence[TrainingJob]) -> str:
    return ", ".join(dict.fromkeys(name for job in wave for name in job.runs))


def units_of(jobs: Iterable[TrainingJob]) -> list[Unit]:
    """Jobs as units of work."""
    return [Unit(job.folder, parameters=job) for job in jobs]


def done_jobs(jobs: Sequence[TrainingJob], folder: Path, scoring: ScoringTask) -> list[TrainingJob]:
    """The jobs whose scores are there."""
    journal = JobJournal(folder / JOURNAL, scoring.digest)
    return [job for job, unit in zip(jobs, units_of(jobs), strict=True) if journal.has(unit)]


def scores_of(job: TrainingJob, folder: Path) -> Tree:
    """The scores of a finished job.

    Raises:
        FileFormatError: If the file is damaged.
    """
    path = folder / job.folder / SCORES
    try:
        found = json.loads(read_bytes(path, max_bytes=_MAX_BYTES))
    except ValueError as error:
        raise FileFormatError(path, where="the file", expected="the scores of a run", found=plain(error)) from None
    return dict(found)


def clocks_of(job: TrainingJob, folder: Path) -> list[dict[str, Any]]:
    """What the clock measured of a job, a line each time that it was done or gone on with."""
    path = folder / job.folder / "clock.jsonl"
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.endswith("}")]
