"""Work over many units: journal, resuming, progress, workers and signals, once for every command. Knows no data set."""

from typing import TYPE_CHECKING

from farfield.jobs.journal import JobJournal
from farfield.jobs.runs import HERE, JobOptions, JobRun, Outcome, faults, run, values
from farfield.jobs.units import ENGINES, BulkError, FailedTask, JobEngine, JobWork, Unit, UnitResult, blocks
from farfield.registry import old_names

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

if not TYPE_CHECKING:
    __getattr__ = old_names(
        __name__,
        Bulk="JobOptions",
        Done="UnitResult",
        Engine="JobEngine",
        Journal="JobJournal",
        Lost="FailedTask",
        Running="JobRun",
        Work="JobWork",
    )
