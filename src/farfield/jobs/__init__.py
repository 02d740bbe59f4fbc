"""Work over many units: journal, resuming, progress, workers and signals, once for every command. Knows no data set."""

from farfield.jobs.journal import JobJournal
from farfield.jobs.runs import HERE, JobOptions, JobRun, Outcome, faults, run, values
from farfield.jobs.units import ENGINES, BulkError, FailedTask, JobEngine, JobWork, Unit, UnitResult, blocks

__all__ = [
    "ENGINES",
    "HERE",
    "BulkError",
    "FailedTask",
    "JobEngine",
    "JobJournal",
    "JobOptions",
    "JobRun",
    "JobWork",
    "Outcome",
    "Unit",
    "UnitResult",
    "blocks",
    "faults",
    "run",
    "values",
]
