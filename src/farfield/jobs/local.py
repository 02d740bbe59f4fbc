"""The engine of this machine: its own processes, one thread each, which end with the command whatever ends it."""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from queue import SimpleQueue
from threading import Event, Lock, Semaphore, Thread
from typing import IO, Any

from farfield.jobs.folders import handles
from farfield.jobs.process import VARIABLES, one_thread
from farfield.jobs.units import BulkError, FailedTask, JobWork, Unit, UnitResult, alone
from farfield.jobs.worker import receive, send

GROUP = 10  # units of one group that a worker takes at a time
AHEAD = 16  # units under way, for each worker: a slow one holds back those behind it no longer
PATIENCE_S = 10.0  # for a worker to end by itself

Place = tuple[int, Unit]


class LocalEngine:
    """Processes of this machine, or this very process where one is enough.

    A worker is a new Python process: what it does must stand in a module, not in the script or notebook that asks.
    """

    def run(
        self, work: JobWork, units: Sequence[Unit], *, workers: int, ordered: bool
    ) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        """See :class:`~farfield.jobs.units.JobEngine`."""
        if workers <= 1 and not alone(work):
            with one_thread():
                for index, unit in enumerate(units):
                    yield index, work(unit)
            return
        pool = _WorkerPool(packed_work(work), units, workers, alone=alone(work))
        completed = False
        try:
            pool.start()
            yield from pool.in_order() if ordered else pool.as_done()
            completed = True
        finally:
            pool.stop(completed=completed)


def packed_work(work: JobWork) -> bytes:
    """A work as it is sent to other processes.

    Raises:
        BulkError: If it cannot be sent, or stands in the script that asks.
    """
    try:
        pickled = pickle.dumps(work)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise BulkError(
            f"several workers: expected work that can be sent to another process, got {type(work).__name__} ({error}). "
            "Put its functions and classes into a module, or take one worker."
        ) from error
    if b"__main__" in pickled and "__main__" in _words(pickled):
        raise BulkError(
            "several workers: expected work whose functions and classes stand in a module, got some of the script or "
            "notebook itself, which other processes do not see. Move them into a module, or take one worker."
        )
    return pickled


def _words(packed: bytes) -> set[str]:
    """All words of a pickle, the names of its modules among them."""
    from pickletools import genops

    return {str(argument).split(" ")[0] for _, argument, _ in genops(packed) if isinstance(argument, str)}


class _WorkerPool:
    """Workers, the units that they have yet to take, and what they gave."""

    def __init__(self, work: bytes, units: Sequence[Unit], workers: int, *, alone: bool = False) -> None:
        self.work, self.units, self.alone = work, units, alone
        self.next, self.lock, self.stopping = 0, Lock(), Event()
        self.room = Semaphore(AHEAD * workers)
        self.results: SimpleQueue[tuple[int, Any]] = SimpleQueue()
        self.workers = [_WorkerThread(self) for _ in range(min(workers, len(units)))]

    def start(self) -> None:
        for worker in self.workers:
            worker.start()

    def take(self) -> list[Place]:
        """The next units for one worker: one, or a few of one group; none when there are no more."""
        units: list[Place] = []
        while len(units) < GROUP:
            if not self.room.acquire(blocking=not units):  # who has a unit in hand waits for nobody
                break
            with self.lock:
                unit = self.units[self.next] if self.next < len(self.units) and not self.stopping.is_set() else None
                if unit is None or (units and (not unit.group or unit.group != units[0][1].group)):
                    self.room.release()
                    break
                units.append((self.next, unit))
                self.next += 1
            if not unit.group:
                break
        return units

    def as_done(self) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        for _ in range(len(self.units)):
            index, result = self._get()
            self.room.release()
            yield index, result

    def in_order(self) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        early: dict[int, Any] = {}
        for index in range(len(self.units)):
            while index not in early:
                done_index, result = self._get()
                early[done_index] = result
            self.room.release()
            yield index, early.pop(index)

    def _get(self) -> tuple[int, Any]:
        index, result = self.results.get()
        if isinstance(result, BaseException):
            raise result
        return index, result

    def stop(self, *, completed: bool) -> None:
        """End all workers and wait for them; unless the work is whole, they leave what they are at."""
        self.stopping.set()
        for worker in self.workers:
            self.room.release()
            if not completed:
                worker.end()
        for worker in self.workers:
            worker.join(PATIENCE_S)
            worker.kill()
            worker.join()


class _WorkerThread(Thread):
    """A thread that feeds one worker process, and starts another when it dies."""

    def __init__(self, pool: _WorkerPool) -> None:
        super().__init__(daemon=True, name="farfield-bulk")
        self.pool = pool
        self.process: subprocess.Popen[bytes] | None = None

    def run(self) -> None:
        """Take units until there are no more."""
        try:
            while units := self.pool.take():
                for index, unit in units:
                    if self.pool.stopping.is_set():
                        return
                    self.pool.results.put((index, self._do(unit)))
        except BaseException as error:  # noqa: BLE001 - raised where the results are read
            self.pool.results.put((-1, error))
        finally:
            if self.process is not None:
                self._ended()

    def _do(self, unit: Unit) -> Any:
        reason = ""
        for _ in range(2):
            process = self.process or self._begin()
            try:
                send(process.stdin, unit)
                kind, result = receive(process.stdout)
            except (EOFError, OSError):
                reason = self._ended()
                if self.pool.stopping.is_set():
                    return FailedTask(reason)
                continue
            if self.pool.alone:
                self._ended()
            return result if kind == "done" else rebuilt(result)
        return FailedTask(reason)

    def _begin(self) -> "subprocess.Popen[bytes]":
        """Start a worker and give it the work; one that dies on the way is started once more."""
        reason = ""
        for _ in range(2):
            with self.pool.lock:
                if self.pool.stopping.is_set():
                    raise OSError("the work is over")
                self.process = process = _start()
            try:
                send(process.stdin, self.pool.work, packed=True)
                kind, result = receive(process.stdout)
            except (EOFError, OSError):
                reason = self._ended()
                continue
            if kind != "ready":
                raise rebuilt(result)
            return process
        raise BulkError(f"a worker process could not start: it {reason}")

    def _ended(self) -> str:
        """Wait until the worker, who has nothing left to read, has ended; how, in words."""
        process = self.process
        if process is None:
            return "was ended"
        _close(process.stdin)
        status = process.wait()
        _close(process.stdout)
        self.process = None
        if status >= 0:
            return f"ended with status {status}"
        killed = " (perhaps for want of memory)" if -status == getattr(signal, "SIGKILL", 9) else ""
        return f"was ended by {signal.Signals(-status).name}{killed}"

    def end(self) -> None:
        """Ask the worker to leave what it is at."""
        process = self.process
        if process is not None:
            with suppress(OSError):
                process.terminate()

    def kill(self) -> None:
        """End a worker that would not leave."""
        process = self.process
        if process is not None:
            with suppress(OSError):
                process.kill()


def _start() -> "subprocess.Popen[bytes]":
    """A worker in a session of its own: a Ctrl-C of the terminal is the command's to deal with."""
    path = os.pathsep.join(entry for entry in sys.path if entry)
    environment = os.environ | dict.fromkeys((*VARIABLES, "NUMBA_NUM_THREADS"), "1") | {"PYTHONPATH": path}
    return subprocess.Popen(
        [sys.executable, "-m", "farfield.jobs.worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
        start_new_session=True,
        pass_fds=() if sys.platform == "win32" else handles(),
    )


def _close(pipe: IO[bytes] | None) -> None:
    if pipe is not None:
        with suppress(OSError):
            pipe.close()


def rebuilt(error: tuple[bytes, str]) -> BaseException:
    """The exception of a worker, or its words where it does not travel."""
    packed, text = error
    with suppress(Exception):
        exception = pickle.loads(packed)
        if isinstance(exception, BaseException):
            return exception
    return BulkError(f"a worker failed: {text}")
