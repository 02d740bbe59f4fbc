"""A work over many units, from the plan to the last one."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from farfield.bulk.engines import ENGINES, BulkError, Lost
from farfield.bulk.folders import locked, sweep_out
from farfield.bulk.journal import Journal, Mark, mark_of, state_of
from farfield.bulk.memory import fitting
from farfield.bulk.signals import check
from farfield.bulk.units import Done, Unit, Work
from farfield.errors import ConfigError

Progress = Callable[[Iterable[int]], Iterable[int]]
"""Passes through the numbers that it iterates over, one as each unit is done, and may show how far they are."""

_WORTH = 4  # units that a further worker should have, for it takes seconds to start
_SHOWN = 10


@dataclass(frozen=True, kw_only=True)
class Bulk:
    """How a work is done.

    Args:
        workers: Processes, one thread each; 1 works in this process, 0 takes as many as there are cores, work and
            memory for.
        engine: Where: a name of ``ENGINES``.
        progress: Wraps the numbers of the units that are left, to show progress.
    """

    workers: int = 1
    engine: str = "local"
    progress: Progress = iter

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise ConfigError(f"workers: expected 1 or more, or 0 for as many as there are cores; got {self.workers}")

    def hands(self, work: Work, units: int) -> int:
        """How many workers do so many units.

        Raises:
            BulkError: If the memory does not suffice.
        """
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        wanted = min(self.workers, units) if self.workers else min(cores, units // _WORTH)
        return fitting(max(1, wanted), getattr(work, "memory_bytes", 0), asked=self.workers > 0)


HERE = Bulk()
"""In this process, without a word."""


@dataclass
class Outcome:
    """What became of the units.

    Args:
        written: How many were done now.
        skipped: How many stood there intact.
        clocks: What the clock measured of those that were done now, by their place among the units.
    """

    written: int = 0
    skipped: int = 0
    clocks: dict[int, Any] = field(default_factory=dict)


def run(work: Work, units: Sequence[Unit], bulk: Bulk = HERE, *, journal: Journal | None = None) -> Outcome:
    """Do all units that the journal does not have, and enter them.

    Args:
        work: What is done with each.
        units: The units.
        bulk: How.
        journal: What was done before, in the folder that the files are written into; without one all units are done.

    Returns:
        Counts and clocks; the values stand in the journal.

    Raises:
        BulkError: If workers died twice over a unit; all others are done, and the same call tries these again.
    """
    if journal is None:
        outcome = Outcome()
        for index, done in _work(work, units, bulk, ordered=False):
            outcome.written, outcome.clocks[index] = outcome.written + 1, done.clock
        return outcome
    if journal.files:
        sweep_out(journal.folder)
    places = [place for place, unit in enumerate(units) if not journal.has(unit)]
    outcome = Outcome(skipped=len(units) - len(places))
    marking = _Marking(work, journal.folder, journal.setting)
    try:
        for index, done in _work(marking, [units[place] for place in places], bulk, ordered=False):
            source, files, value = done.value
            journal.add(units[places[index]], source, files, value)
            outcome.written, outcome.clocks[places[index]] = outcome.written + 1, done.clock
    finally:
        journal.commit()
        if journal.files and places:  # a worker that was killed left what it was at
            sweep_out(journal.folder)
    journal.finish()
    return outcome


def faults(units: Sequence[Unit], journal: Journal) -> list[str]:
    """What is wrong with finished units, a line each: not written, of another source or setting, damaged or missing.

    Every byte of their files is read; nothing is written.
    """
    found = ((unit, journal.fault(unit, every_byte=True)) for unit in units)
    return [f"{unit.name}: {fault}" for unit, fault in found if fault]


def values(work: Work, units: Sequence[Unit], bulk: Bulk = HERE) -> Iterator[Done]:
    """Do all units and yield what they gave in their order; nothing is kept.

    Args:
        work: What is done with each.
        units: The units.
        bulk: How.

    Raises:
        BulkError: If workers died twice over a unit.
    """
    for _, done in _work(work, units, bulk, ordered=True):
        yield done


def _work(work: Work, units: Sequence[Unit], bulk: Bulk, *, ordered: bool) -> Iterator[tuple[int, Done]]:
    """What each unit gave; those that were lost are named at the end."""
    if not units:
        return
    engine, lost = ENGINES[bulk.engine](), list[tuple[str, str]]()
    results = engine.run(work, units, workers=bulk.hands(work, len(units)), ordered=ordered)
    numbers = iter(bulk.progress(range(len(units))))
    try:
        next(numbers, None)
        for index, done in results:
            if isinstance(done, Lost):
                lost.append((units[index].name, done.why))
            else:
                yield index, done
            check()
            next(numbers, None)
    finally:
        results.close()  # type: ignore[attr-defined]
        close = getattr(numbers, "close", None)
        if close is not None:
            close()
    if lost:
        named = "; ".join(f"{name} ({why})" for name, why in lost[:_SHOWN])
        more = f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
        raise BulkError(
            f"{len(lost)} of {len(units)} units could not be done, since their workers died twice: {named}{more}. All "
            "others are done. Run the same command again to try these, with fewer --workers if memory is short."
        )


@dataclass(frozen=True)
class _Marking:
    """Does a unit, and says in what state its sources were and what stands in its files."""

    work: Work
    folder: Path
    setting: str

    @property
    def memory_bytes(self) -> int:
        return int(getattr(self.work, "memory_bytes", 0))

    def __call__(self, unit: Unit) -> Done:
        with locked(self.folder, shared=True):
            source = state_of(unit.sources, self.setting)
            done = self.work(unit)
            files: dict[str, Mark] = {path.relative_to(self.folder).as_posix(): mark_of(path) for path in done.files}
        return Done(value=(source, files, done.value), clock=done.clock)
