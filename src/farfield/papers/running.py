"""Do the jobs of a grid in bulk: train or go on, detect, score; a finished job is never done again.

A folder of runs holds the journal and a folder a job, whose scores, weights and clock stand there. What differs between
grids (frames to train on, what is scored of a job) is a :class:`GridScoring`.
"""

import json
import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.datasets import Dataset
from farfield.errors import FileFormatError, plain
from farfield.experiments.plan import Plan
from farfield.files.atomic import read_bytes, write_text
from farfield.files.json_text import plain_json
from farfield.jobs import JobJournal, JobOptions, Unit, UnitResult, run
from farfield.jobs.runs import Progress
from farfield.papers.grid import Tree
from farfield.papers.jobs import TrainingJob, waves
from farfield.training.checkpoints import CHECKPOINT_NAME, begin_log
from farfield.training.report import TrainingReport
from farfield.vocabulary.counts import count_of

JOURNAL = ".journal.jsonl"
SCORES, WEIGHTS, CLOCK = "scores.json", "weights.safetensors", "clock.jsonl"
SPENT = "spent.json"
"""The processor's time of a job that is not done; see :class:`CpuTime`."""
_NOTED_EVERY_S = 10.0
_STATUS = Path("/proc/self/status")
Report = Callable[[str], object]
"""Is called with lines for the user."""


def silent(line: str) -> None:
    """Print nothing."""
    del line


def no_progress(activity: str) -> Progress:
    """Show no progress."""
    del activity
    return iter


class GridScoring(ABC):
    """What a grid adds to the engine: how its jobs are scored, and frames that their experiments do not open."""

    memory_bytes = 4_000_000_000
    """Memory that a job takes at most."""

    @property
    @abstractmethod
    def digest(self) -> str:
        """Hash of all that decides the scores besides the weights: the setting of the journal."""

    @abstractmethod
    def of_job(self, job: TrainingJob, weights: Path) -> Tree:
        """The scores of a job's weights as JSON values."""

    def frames(self, job: TrainingJob) -> Mapping[str, Dataset]:
        """Frames to train on, by stream; those that are left out stand where the experiment says."""
        del job
        return {}


@dataclass(frozen=True)
class RunTask:
    """Does a job in its folder; the unit's parameters are the job.

    Args:
        folder: Folder of all jobs' folders.
        scoring: How it is scored.
        train_only: Leave the scoring to a later command, here or where the folder is taken to.
    """

    folder: Path
    scoring: GridScoring
    train_only: bool = False

    own_process = True

    @property
    def memory_bytes(self) -> int:
        """Memory that a job takes at most."""
        return self.scoring.memory_bytes

    def __call__(self, unit: Unit) -> UnitResult:
        """Train unless the weights are there, score, and write the scores; a training that diverged has none.

        The checkpoint is removed once it is of no use. The clock gets a line, one more where only to train was asked.
        """
        job: TrainingJob = unit.parameters
        home, began = self.folder / job.folder, time.monotonic()
        weights = home / WEIGHTS
        brought = weights.is_file() and not (home / SPENT).is_file()  # a process killed at scoring left what it spent
        cpu_time = CpuTime(home / SPENT)
        quiet()
        # train, or go on with what a killed process left
        failure = ""
        if not weights.is_file():
            try:
                Plan(job.experiment, home, data=self.scoring.frames(job), fingerprints=job.fingerprints).run(cpu_time)
            except RuntimeError as error:
                if "non-finite" not in str(error):
                    raise
                failure = f"diverged: {error}"  # which it would do again
        cpu_time.note()
        trained = time.monotonic()
        clock: dict[str, Any] = {"training_s": round(trained - began, 1), "peak_memory_mb": peak_memory_mb()}
        if brought:
            clock["brought"] = True
        if self.train_only:
            if weights.is_file() and not brought:
                self._finish(home, clock, cpu_time)
            return UnitResult(clock=clock)
        # score, and note the time
        scores = (
            {"runs": list(job.runs), "seed": job.seed, "key": job.key, "clouds": {}, "failed": failure}
            if failure
            else self.scoring.of_job(job, weights)
        )
        write_text(home / SCORES, json.dumps(scores, separators=(",", ":")) + "\n")
        clock["scoring_s"] = round(time.monotonic() - trained, 1)
        self._finish(home, clock, cpu_time)
        return UnitResult(files=(home / SCORES,), clock=clock)

    @staticmethod
    def _finish(home: Path, clock: dict[str, Any], cpu_time: "CpuTime") -> None:
        (home / CHECKPOINT_NAME).unlink(missing_ok=True)
        clock["processor_s"] = round(cpu_time.seconds, 1)
        begin_log(home / CLOCK, anew=False)
        with (home / CLOCK).open("a", encoding="utf-8") as file:
            file.write(json.dumps(clock) + "\n")
        cpu_time.remove()


class CpuTime(TrainingReport):
    """The processor's time that a job takes, with that of processes that were killed at it.

    Args:
        path: The file that holds it while the job is not done.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._begun, self._noted = path, time.process_time(), time.monotonic()
        with suppress(OSError, ValueError, TypeError, KeyError, FileFormatError):
            self._begun -= float(plain_json(read_bytes(path))["processor_s"])

    @property
    def seconds(self) -> float:
        """Of all processes so far."""
        return time.process_time() - self._begun

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Write it now and then."""
        del step, losses
        if time.monotonic() - self._noted >= _NOTED_EVERY_S:
            self.note()

    def note(self) -> None:
        """Write it."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_text(self._path, json.dumps({"processor_s": round(self.seconds, 1)}) + "\n")
        self._noted = time.monotonic()

    def remove(self) -> None:
        """Remove the file: the job's clock holds the time from now on."""
        self._path.unlink(missing_ok=True)


def quiet() -> None:
    """Let the trainings of this process log warnings only."""
    logging.getLogger("lightning_fabric").setLevel(logging.WARNING)


def peak_memory_mb() -> float | None:
    """Peak memory of this process, 10^6 bytes; None where the system has no such gauge."""
    with suppress(OSError, ValueError):
        lines = _STATUS.read_text(encoding="ascii", errors="replace").splitlines()
        peaks_kib = [int(line.split()[1]) for line in lines if line.startswith("VmHWM:")]
        return round(peaks_kib[0] * 1024 / 1e6, 1) if peaks_kib else None
    return None


def do_all(
    jobs: Sequence[TrainingJob],
    folder: Path,
    scoring: GridScoring,
    *,
    options: JobOptions,
    report: Report = silent,
) -> None:
    """Do all jobs that are not done: first those that others start from, then seed by seed.

    Args:
        jobs: The jobs.
        folder: Folder of their folders and of the journal.
        scoring: How they are scored.
        options: Who does them.
        report: Called with a line before each wave.

    Raises:
        BulkError: If jobs killed their workers twice; all others are done.
    """
    journal = JobJournal(folder / JOURNAL, scoring.digest)
    for wave in waves(jobs):
        units = units_of(wave)
        left = sum(not journal.has(unit) for unit in units)
        if left:
            names = ", ".join(dict.fromkeys(name for job in wave for name in job.runs))
            report(f"{left} of {count_of(len(units), 'run')} are left: {names}")
        run(RunTask(folder, scoring), units, options, journal=journal)


def train_all(
    jobs: Sequence[TrainingJob],
    folder: Path,
    scoring: GridScoring,
    *,
    options: JobOptions,
    report: Report = silent,
) -> None:
    """Train all jobs whose weights are not there, in the order of :func:`do_all`, and score none.

    Args:
        jobs: The jobs.
        folder: Folder of their folders.
        scoring: Gives the frames that their experiments do not open.
        options: Who does them.
        report: Called with a line before each wave.

    Raises:
        BulkError: If jobs killed their workers twice; all others are done.
    """
    for wave in waves(jobs):
        left = [job for job in wave if not (folder / job.folder / WEIGHTS).is_file()]
        if left:
            report(f"{len(left)} of {len(wave)} trainings are left: {', '.join(job.experiment.name for job in left)}")
            task = RunTask(folder, scoring, train_only=True)
            run(task, units_of(left), options)


def units_of(jobs: Iterable[TrainingJob]) -> list[Unit]:
    """Jobs as units of work."""
    return [Unit(job.folder, parameters=job) for job in jobs]


def done_jobs(jobs: Sequence[TrainingJob], folder: Path, scoring: GridScoring) -> list[TrainingJob]:
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
        return dict(plain_json(read_bytes(path)))
    except ValueError as error:
        raise FileFormatError(path, where="the file", expected="the scores of a run", got=plain(error)) from None


def clocks_of(job: TrainingJob, folder: Path) -> list[dict[str, Any]]:
    """What the clock measured of a job, a line each time that it was done or gone on with.

    A last line that is torn is passed over.

    Raises:
        FileFormatError: If another line is damaged.
    """
    path = folder / job.folder / CLOCK
    lines = path.read_bytes().splitlines() if path.is_file() else []
    clocks = []
    for number, line in enumerate(lines, 1):
        try:
            clocks.append(dict(plain_json(line)))
        except (ValueError, TypeError) as error:
            if number == len(lines):
                break
            where, fix = f"line {number}", "Remove the line: what that run took is then not known."
            raise FileFormatError(
                path, where=where, expected="times as JSON", got=plain(error)[:200], fix=fix
            ) from None
    return clocks
