"""A work over many units, from the plan to the last one."""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from farfield.errors import ConfigError, MissingExtraError
from farfield.files.marks import Mark, mark_of
from farfield.files.outputs import check_room
from farfield.files.sizes import room, sized
from farfield.jobs.folders import sweep_out
from farfield.jobs.journal import JobJournal, state_of
from farfield.jobs.process import check, one_thread, usable_cores
from farfield.jobs.units import ENGINES, BulkError, FailedTask, JobEngine, JobWork, Unit, UnitResult, alone
from farfield.vocabulary.counts import count_of

Progress = Callable[[Iterable[int]], Iterable[int]]
"""Passes through the numbers that it iterates over, one as each unit is done, and may show how far they are."""

_WORTH = 4  # units that a further worker should have, for it takes seconds to start
_SHOWN = 10


@dataclass(frozen=True, kw_only=True)
class JobOptions:
    """How a work is done.

    Args:
        workers: Processes, one thread each; 1 works in this process, 0 takes as many as there are cores, work and
            memory for.
        engine: Where: a name of ``ENGINES``.
        address: Of the Ray cluster: ``auto``, ``HOST:PORT``, or nothing for one of this machine.
        progress: Wraps the numbers of the units that are left, to show progress.
    """

    workers: int = 1
    engine: str = "local"
    address: str = ""
    progress: Progress = iter

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise ConfigError(f"workers: expected 1 or more, or 0 for as many as there are cores; got {self.workers}")
        if self.address and self.engine != "ray":
            raise ConfigError(
                f"--address {self.address}: expected --engine ray, whose cluster it names; got --engine {self.engine}"
            )
        if self.engine == "ray" and find_spec("ray") is None:
            raise MissingExtraError("ray", "ray", "--engine ray")

    def new_engine(self) -> JobEngine:
        """What does the units."""
        engine: Any = ENGINES[self.engine]
        return engine(self.address) if self.address else engine()

    def num_workers(self, work: JobWork, units: int) -> int:
        """How many workers do so many units.

        Raises:
            BulkError: If the memory does not suffice.
        """
        if self.address not in ("", "local") and units:  # other machines' cores and memory
            slots = self.new_engine().slots(work)  # type: ignore[attr-defined]
            return min(self.workers or slots, slots, units)
        workers = min(self.workers, units) if self.workers else min(usable_cores(), units // _WORTH)
        return fitting(max(1, workers), getattr(work, "memory_bytes", 0), exactly=self.workers > 0)


HERE = JobOptions()
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


class JobRun:
    """A work under way over the units that the journal does not have.

    Iterating gives the number of each unit that is left: after workers did it, or, where ``here`` is true, before, and
    the caller then does it and enters the result::

        with JobRun(work, units, bulk, journal=journal) as running:
            for number in bulk.progress(running):
                if running.here:
                    running.enter(number, work(running.unit(number)))

    Args:
        work: What is done with each.
        units: The units.
        bulk: How.
        journal: As of :func:`run`.

    Raises:
        ConfigError: If the disk has no room for what the units that are left write (``disk_bytes`` of the work).
        BulkError: If the memory does not suffice; on leaving, if workers died twice over a unit.
    """

    def __init__(
        self, work: JobWork, units: Sequence[Unit], bulk: JobOptions = HERE, *, journal: JobJournal | None = None
    ) -> None:
        self.work, self.units, self.journal, self._bulk = work, units, journal, bulk
        if journal is not None and journal.files:
            sweep_out(journal.folder)
        self.left = [row for row, unit in enumerate(units) if journal is None or not journal.has(unit)]
        if journal is not None and journal.files and self.left:
            check_room(journal.folder, len(self.left) * float(getattr(work, "disk_bytes", 0)))
        self.outcome = Outcome(skipped=len(units) - len(self.left))
        self._workers = bulk.num_workers(work, len(self.left))
        self._lost, self._source = list[tuple[str, str]](), ""
        self._iterating: Generator[int, None, None] | None = None
        self.here = bulk.engine == "local" and self._workers == 1 and not alone(work)

    def __len__(self) -> int:
        return len(self.left)

    def __iter__(self) -> Iterator[int]:
        self._iterating = self._alone() if self.here else self._by_workers()
        return self._iterating

    def __enter__(self) -> "JobRun":
        return self

    def __exit__(self, kind: type[BaseException] | None, *unused: object) -> None:
        if self._iterating is not None:
            self._iterating.close()
        if self.journal is not None:
            try:
                self.journal.commit()
            finally:
                if self.journal.files and self.left:  # a worker that was killed left what it was at
                    sweep_out(self.journal.folder)
        if kind is None:
            _raise_for(self._lost, len(self.left))
            if self.journal is not None:
                self.journal.finish()

    def unit(self, number: int) -> Unit:
        """The unit of a number."""
        return self.units[self.left[number]]

    def enter(self, number: int, result: UnitResult) -> None:
        """Hand in what the unit gave that the iteration came to last."""
        value = result.value
        if self.journal is not None:
            value = _entry(self.journal.folder, self._source, result)
        self._enter(number, replace(result, value=value))

    def _enter(self, number: int, result: UnitResult) -> None:
        if self.journal is not None:
            self.journal.add(self.unit(number), *result.value)
        self.outcome.written, self.outcome.clocks[self.left[number]] = self.outcome.written + 1, result.clock

    def _alone(self) -> Generator[int, None, None]:
        with one_thread():
            for number in range(len(self.left)):
                if self.journal is None:
                    yield number
                else:
                    self._source = state_of(self.unit(number).sources, self.journal.setting)
                    yield number
                check()

    def _by_workers(self) -> Generator[int, None, None]:
        journal = self.journal
        marking = self.work if journal is None else _JournalledUnit(self.work, journal.folder, journal.setting)
        units = [self.unit(number) for number in range(len(self.left))]
        with closing(_results(self._bulk, marking, units, self._workers, ordered=False)) as results:
            for number, result in results:
                if isinstance(result, FailedTask):
                    self._lost.append((units[number].name, result.why))
                else:
                    self._enter(number, result)
                check()
                yield number


def run(work: JobWork, units: Sequence[Unit], bulk: JobOptions = HERE, *, journal: JobJournal | None = None) -> Outcome:
    """Do all units that the journal does not have, and enter them.

    Args:
        work: What is done with each.
        units: The units.
        bulk: How.
        journal: What was done before, in the folder that the files are written into, which the caller holds
            (:func:`farfield.jobs.folders.held`); without one all units are done.

    Returns:
        Counts and clocks; the values stand in the journal.

    Raises:
        BulkError: If workers died twice over a unit; all others are done, and the same call tries these again.
    """
    with JobRun(work, units, bulk, journal=journal) as running:
        for number in bulk.progress(running):
            if running.here:
                running.enter(number, work(running.unit(number)))
    return running.outcome


def faults(units: Sequence[Unit], journal: JobJournal) -> list[str]:
    """What is wrong with finished units, a line each: not written, of another source or setting, damaged or missing.

    Every byte of their files is read; nothing is written.
    """
    unit_faults = ((unit, journal.fault(unit, every_byte=True)) for unit in units)
    return [f"{unit.name}: {fault}" for unit, fault in unit_faults if fault]


def values(work: JobWork, units: Sequence[Unit], bulk: JobOptions = HERE) -> Iterator[UnitResult]:
    """Do all units and yield what they gave in their order; nothing is kept.

    Args:
        work: What is done with each.
        units: The units.
        bulk: How.

    Raises:
        BulkError: If workers died twice over a unit.
    """
    failed = list[tuple[str, str]]()
    with closing(_results(bulk, work, units, bulk.num_workers(work, len(units)), ordered=True)) as results:
        for _ in bulk.progress(range(len(units))):
            index, result = next(results)
            if isinstance(result, FailedTask):
                failed.append((units[index].name, result.why))
            else:
                yield result
            check()
    _raise_for(failed, len(units))


def _results(
    bulk: JobOptions, work: JobWork, units: Sequence[Unit], workers: int, *, ordered: bool
) -> Generator[tuple[int, UnitResult | FailedTask], None, None]:
    """What an engine gives of units, none included."""
    if units:
        yield from bulk.new_engine().run(work, units, workers=workers, ordered=ordered)


def _raise_for(failed: Sequence[tuple[str, str]], units: int) -> None:
    """Name the units that were lost, if any."""
    if not failed:
        return
    names = "; ".join(f"{name} ({why})" for name, why in failed[:_SHOWN])
    more = f" and {len(failed) - _SHOWN} more" if len(failed) > _SHOWN else ""
    raise BulkError(
        f"{len(failed)} of {count_of(units, 'unit')} could not be done, since "
        f"their workers died twice: {names}{more}. All others "
        "are done. Run the same command again to try these, with fewer --workers if memory is short."
    )


@dataclass(frozen=True)
class _JournalledUnit:
    """Does a unit, and says in what state its sources were and what stands in its files."""

    work: JobWork
    folder: Path
    setting: str

    @property
    def memory_bytes(self) -> int:
        return int(getattr(self.work, "memory_bytes", 0))

    @property
    def own_process(self) -> bool:
        return alone(self.work)

    def __call__(self, unit: Unit) -> UnitResult:
        source = state_of(unit.sources, self.setting)
        result = self.work(unit)
        return replace(result, files=(), value=_entry(self.folder, source, result))


def _entry(folder: Path, source: str, result: UnitResult) -> tuple[str, dict[str, Mark], Any]:
    """What a journal keeps of a unit besides its name."""
    return source, {path.relative_to(folder).as_posix(): mark_of(path) for path in result.files}, result.value


# How much memory is left to a work on this machine, within the limits of its container.

_CGROUP = Path("/sys/fs/cgroup")


def available_bytes(cgroup: Path = _CGROUP) -> int:
    """Memory that programs can take now without swapping: the machine's, or what a container leaves of it."""
    import psutil

    free = int(psutil.virtual_memory().available)
    try:
        limit = (cgroup / "memory.max").read_text().strip()
        used = int((cgroup / "memory.current").read_text())
        stat = dict(line.split() for line in (cgroup / "memory.stat").read_text().splitlines())
        reclaimable = int(stat.get("inactive_file", 0))
    except (OSError, ValueError):
        return free
    return free if limit == "max" else min(free, max(0, int(limit) - used + reclaimable))


def fitting(workers: int, each_bytes: int, *, exactly: bool, available: int | None = None) -> int:
    """How many workers fit into the memory.

    Args:
        workers: How many are wanted.
        each_bytes: What one takes at most; 0 where that is not known.
        exactly: Whether the user asked for so many: then all must fit.
        available: Bytes that are free (default: measured).

    Raises:
        BulkError: If not even one fits, or fewer than were asked for.
    """
    if workers <= 1 or not each_bytes:
        return workers
    free = available_bytes() if available is None else available
    fit = int(free // each_bytes)
    if fit < workers and exactly:
        raise BulkError(
            f"--workers {workers}: expected memory for {workers} of {sized(each_bytes)} each: "
            f"{room(workers * each_bytes, free)}. {f'--workers {fit} fits' if fit else 'Close other programs'}."
        )
    return max(1, min(workers, fit))
