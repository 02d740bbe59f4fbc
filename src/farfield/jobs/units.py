"""A unit of work, and what became of it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from farfield.errors import FarfieldError
from farfield.registry import Registry


@dataclass(frozen=True)
class Unit:
    """A part of a large work that is done whole or not at all, such as a frame to write.

    Args:
        name: Tells it from the others of the same work.
        sources: Files that it is made from; when one of them changes, it is made anew.
        parameters: What else the work needs to know; it travels to other processes.
        group: Units that stand beside each other with the same group go to one worker, a few at a time, so that what
            they share is made once.
    """

    name: str
    sources: tuple[Path, ...] = ()
    parameters: Any = None
    group: str = ""


@dataclass(frozen=True)
class UnitResult:
    """What a unit gave.

    Args:
        files: Files that were written, whole.
        value: What was computed; where a journal keeps it, what JSON takes.
        clock: What the clock measured; it is kept apart from the value, so that equal work gives equal files.
    """

    files: tuple[Path, ...] = ()
    value: Any = None
    clock: Any = None


@runtime_checkable
class JobWork(Protocol):
    """What is done with each unit: a function or object that pickles, of a module that can be imported.

    The same unit gives the same files and the same value, whoever does it and whatever was done before. An attribute
    ``memory_bytes`` says what a worker needs at most; ``own_process`` set to true gives each unit a new process,
    which costs seconds, so that its memory is measured and freed whatever the libraries below keep.
    """

    def __call__(self, unit: Unit) -> UnitResult:
        """Do one unit."""


def alone(work: JobWork) -> bool:
    """Whether each unit wants a process of its own."""
    return bool(getattr(work, "own_process", False))


def blocks(count: int, size: int, *, what: str = "") -> list[Unit]:
    """Units of so many places each, whose parameters are the range of their places.

    >>> " ".join(unit.name for unit in blocks(5, 2))
    '0-2 2-4 4-5'
    """
    ranges = [range(first, min(first + size, count)) for first in range(0, count, size)]
    return [Unit(f"{what}{rows.start}-{rows.stop}", parameters=rows) for rows in ranges]


# Where bulk work is done: the contract of an engine, and the registry of engines.


class BulkError(FarfieldError):
    """A work over many units cannot begin, or some units could not be done."""


@dataclass(frozen=True)
class FailedTask:
    """A unit whose worker died, twice.

    Args:
        why: How the worker ended, in words.
    """

    why: str


@runtime_checkable
class JobEngine(Protocol):
    """Does units somewhere: in processes of this machine, or on a cluster."""

    def run(
        self, work: JobWork, units: Sequence[Unit], *, workers: int, ordered: bool
    ) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        """Do all units, a bounded number of them under way at a time.

        Args:
            work: What is done; it is sent to each worker once.
            units: The units.
            workers: How many work at a time.
            ordered: Yield in the order of the units instead of as they are done.

        Yields:
            The place of a unit, and what it gave, or that it was lost after a second try. An exception of the work is
            raised here and ends the rest. When the iteration ends, for whatever reason, no worker is left.
        """


ENGINES: Registry[type[JobEngine]] = Registry(
    "farfield.engines",
    "bulk engine",
    {"local": "farfield.jobs.local:LocalEngine", "ray": "farfield.jobs.ray_engine:RayEngine"},
)
"""Engines by name."""
