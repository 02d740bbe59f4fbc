"""Work over many units: journal, resuming, progress, workers and signals, once for every command. Knows no data set."""

from farfield.bulk.engines import ENGINES, BulkError, FailedTask, JobEngine
from farfield.bulk.journal import JobJournal
from farfield.bulk.runs import HERE, JobOptions, JobRun, Outcome, faults, run, values
from farfield.bulk.units import JobWork, Unit, UnitResult, blocks

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
