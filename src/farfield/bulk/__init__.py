"""Work over many units: journal, resuming, progress, workers and signals, once for every command. Knows no data set."""

from farfield.bulk.engines import ENGINES, BulkError, Engine, Lost
from farfield.bulk.journal import Journal
from farfield.bulk.runs import HERE, Bulk, Outcome, Running, faults, run, values
from farfield.bulk.units import Done, Unit, Work, blocks

__all__ = [
    "ENGINES",
    "HERE",
    "Bulk",
    "BulkError",
    "Done",
    "Engine",
    "Journal",
    "Lost",
    "Outcome",
    "Running",
    "Unit",
    "Work",
    "blocks",
    "faults",
    "run",
    "values",
]
