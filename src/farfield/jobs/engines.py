"""Where bulk work is done: the contract of an engine, and the registry of engines."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from farfield.errors import FarfieldError
from farfield.jobs.units import JobWork, Unit, UnitResult
from farfield.registry import Registry


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
    "farfield.engines", "bulk engine", {"local": "farfield.jobs.local:LocalEngine"}
)
"""Engines by name."""
