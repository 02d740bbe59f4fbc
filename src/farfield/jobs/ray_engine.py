"""The engine of a Ray cluster: tasks with declared resources, which read and write their files themselves."""

import atexit
import os
import pickle
import secrets
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

from farfield.errors import MissingExtraError, plain
from farfield.files.locking import try_lock
from farfield.files.sizes import sized
from farfield.jobs.local import AHEAD, GROUP, PATIENCE_S, packed_work, rebuilt
from farfield.jobs.process import check, one_thread, usable_cores
from farfield.jobs.units import BulkError, FailedTask, JobWork, Unit, UnitResult, alone
from farfield.jobs.worker import answered, travelling

_GLANCE_S = 1.0  # how long a signal waits at most where Ray's own waiting does not see it
_CONNECT_S = 5.0
_STARTS = 3
_PORT = "6379"
_STORE_BYTES = 200_000_000  # of objects: the work once, and results beyond 100 kB while they pass through
_FOLDER = "farfield-ray-"
_LONGEST_FOLDER = 40  # Ray's sockets lie 60 characters deeper, and a socket's name has 107 at most
_SECRET = "RAY_AUTH_TOKEN"  # noqa: S105 - a variable's name


class RayEngine:
    """Tasks of a Ray cluster, a core each.

    Units and small results travel through the command, as with processes of this machine; frames never do: each task
    reads its sources and writes its files under the same paths. A unit whose worker or node dies is done once more.
    One command has one connection, which ends with it, as does the Ray that was started for it alone.

    Args:
        address: ``HOST:PORT`` of a cluster that this machine is a node of, ``"auto"`` for the one that runs here, or
            ``"local"`` for one of this machine alone, started now and reached by nobody else.
    """

    def __init__(self, address: str = "local") -> None:
        self.address = address or "local"

    def run(
        self, work: JobWork, units: Sequence[Unit], *, workers: int, ordered: bool
    ) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        """See :class:`~farfield.jobs.units.JobEngine`."""
        packed = packed_work(work)
        tasks = _RayTasks(_connected(self.address, workers), work, packed, units, workers)
        try:
            yield from tasks.in_order() if ordered else tasks.as_done()
        finally:
            tasks.stop()

    def slots(self, work: JobWork) -> int:
        """How many units all nodes can do at a time: a core each, and the memory that a worker needs.

        Raises:
            BulkError: If no node can do one, or none answers.
        """
        ray, needed_bytes = _connected(self.address, 1), int(getattr(work, "memory_bytes", 0))
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        slots = [_fits(node, needed_bytes) for node in nodes]
        if not sum(slots):
            most = max((int(node.get("memory", 0)) for node in nodes), default=0)
            raise BulkError(
                f"--address {self.address}: expected a node with a core and {sized(needed_bytes)} of memory "
                f"for a worker, got {len(nodes)} of at most {sized(most)}. Start nodes with more: ray start "
                "--memory BYTES."
            )
        return sum(slots)


def _fits(node: dict[str, float], needed_bytes: int) -> int:
    cores = int(node.get("CPU", 0))
    return min(cores, int(node.get("memory", 0) // needed_bytes)) if needed_bytes else cores


@dataclass(frozen=True)
class _Batch:
    """Units that one task does, by their places, and how many of their workers died."""

    indices: tuple[int, ...]
    deaths: int = 0


class _RayTasks:
    """Tasks under way, the units that no task has yet, and what was lost."""

    def __init__(self, ray: Any, work: JobWork, packed: bytes, units: Sequence[Unit], workers: int) -> None:
        self.ray, self.units, self.workers, self.alone = ray, units, workers, alone(work)
        resources: dict[str, Any] = {"num_cpus": 1, "max_retries": 0}  # lost units are tried again below, one by one
        if memory := int(getattr(work, "memory_bytes", 0)):
            resources["memory"] = memory
        if self.alone:
            resources["max_calls"] = 1
        self.task = ray.remote(**resources)(do_units)
        self.home = (os.fspath(Path.cwd()), _version(), secrets.token_hex(8))
        paths = [str(Path(entry).absolute()) for entry in sys.path if entry]
        self.box = [ray.put((paths, packed))]  # in a list, so that Ray does not unpack it for each task
        self.next, self.ahead = 0, 0
        self.again: deque[_Batch] = deque()
        self.under_way: dict[Any, _Batch] = {}

    def as_done(self) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        for index, result in self._results():
            self.ahead -= 1
            yield index, result

    def in_order(self) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        early: dict[int, UnitResult | FailedTask] = {}
        following = 0
        for index, result in self._results():
            early[index] = result
            while following in early:
                self.ahead -= 1
                yield following, early.pop(following)
                following += 1

    def _results(self) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        while True:
            self._submit()
            if not self.under_way:
                return
            done, _ = self.ray.wait(list(self.under_way), num_returns=1, timeout=_GLANCE_S)
            check()
            for task in done:
                yield from self._of_task(task, self.under_way.pop(task))

    def _submit(self) -> None:
        """Keep as many tasks under way as there are workers."""
        while len(self.under_way) < self.workers:
            batch = self.again.popleft() if self.again else self._take()
            if not batch.indices:
                return
            units = [pickle.dumps(self.units[index], pickle.HIGHEST_PROTOCOL) for index in batch.indices]
            self.under_way[self.task.remote(self.box, self.home, units)] = batch

    def _take(self) -> _Batch:
        """The next units for one task: one, or a few of one group; none where there are no more, or too many wait."""
        first, group = self.next, ""
        while self.next < len(self.units) and self.ahead < AHEAD * self.workers and self.next - first < GROUP:
            unit = self.units[self.next]
            if self.next > first and (self.alone or not unit.group or unit.group != group):
                break
            group = unit.group
            self.next, self.ahead = self.next + 1, self.ahead + 1
        return _Batch(tuple(range(first, self.next)))

    def _of_task(self, task: Any, batch: _Batch) -> Iterator[tuple[int, UnitResult | FailedTask]]:
        """What a task gave; its units are put back where its worker died."""
        errors = self.ray.exceptions
        lost = (errors.WorkerCrashedError, errors.OutOfMemoryError, errors.NodeDiedError, errors.ObjectLostError)
        try:
            answers = pickle.loads(self.ray.get(task))
        except lost as error:
            if len(batch.indices) > 1:  # whose fault it was is seen when each is done alone
                self.again.extend(_Batch((index,)) for index in batch.indices)
            elif batch.deaths:
                yield batch.indices[0], FailedTask(_why(error))
            else:
                self.again.append(_Batch(batch.indices, 1))
            return
        except errors.RayError as error:
            words = str(error).strip().splitlines()
            raise BulkError(f"--engine ray: a task failed: {(words or [type(error).__name__])[-1][:300]}") from error
        for index, (kind, result) in zip(batch.indices, answers, strict=False):  # those behind a failure have none
            if kind == "failed":
                raise rebuilt(result)
            yield index, result

    def stop(self) -> None:
        """Leave what is under way, so that its own clean-up runs; end what would not leave."""
        tasks = list(self.under_way)
        self.under_way.clear()
        for force in (False, True):
            for task in tasks:
                with suppress(self.ray.exceptions.RayError, ValueError):
                    self.ray.cancel(task, force=force)
            if tasks:
                _, tasks = self.ray.wait(tasks, num_returns=len(tasks), timeout=PATIENCE_S)


def _why(error: Exception) -> str:
    """How a worker ended, in words."""
    kinds = {"OutOfMemoryError": "was ended by Ray for want of memory", "NodeDiedError": "was lost with its node"}
    return kinds.get(type(error).__name__, "was ended by a signal (perhaps for want of memory)")


# What a task does, in a worker of Ray.

_works: dict[str, JobWork] = {}
"""The work that a worker did last, by its key."""
_threads: list[Any] = []


def do_units(box: Sequence[Any], home: tuple[str, str, str], units: Sequence[bytes]) -> bytes:
    """Do some units of a work; a failure ends them.

    Args:
        box: Refers to the work, packed.
        home: Folder that relative paths begin at, version of Farfield, and key of the work.
        units: The units, each packed.

    Returns:
        What each gave, packed.
    """
    answers: list[tuple[str, Any]] = []
    try:
        work = _work_of(box, *home)
    except Exception as error:  # noqa: BLE001 - the command raises it
        return pickle.dumps([("failed", travelling(error))])
    for unit in units:
        answers.append(answered(work, unit))
        if answers[-1][0] == "failed":
            break
    return pickle.dumps(answers, pickle.HIGHEST_PROTOCOL)


def _work_of(box: Sequence[Any], folder: str, command_version: str, key: str) -> JobWork:
    """The work, unpacked once a worker; a new worker computes on one thread, in the command's folder."""
    if key not in _works:
        import ray

        host = socket.gethostname()
        if _version() != command_version:
            raise BulkError(
                f"node {host} of the Ray cluster: expected Farfield {command_version}, got {_version()}. "
                "Install one version on all nodes."
            )
        try:
            os.chdir(folder)
        except OSError as error:
            raise BulkError(
                f"node {host} of the Ray cluster: expected the folder {folder}, got: {plain(error)}. Nodes share "
                "their files: start the command in a folder that all have under one path."
            ) from error
        if not _threads:
            os.environ["NUMBA_NUM_THREADS"] = "1"
            _threads.append(one_thread())
            _threads[0].__enter__()
        paths, packed = ray.get(box[0])
        sys.path += [entry for entry in paths if entry not in sys.path]
        _works.clear()
        _works[key] = pickle.loads(packed)
    return _works[key]


def _version() -> str:
    try:
        return version("farfield")
    except PackageNotFoundError:  # a checkout on PYTHONPATH
        from farfield import __version__

        return __version__


# The connection of a command, and the Ray of this machine that is started for one.

_own: list[tuple[Path, int]] = []
"""Folder and lock of the Ray that this process started."""


def _connected(address: str, workers: int) -> Any:
    """Ray, connected; it stays so until the command ends, or to what the program had connected it itself."""
    local = address == "local"
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    if local:
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # Ray's own name for: only on 127.0.0.1
        os.environ.setdefault("RAY_DASHBOARD_STARTUP_TIMEOUT_S", "0")  # nobody waits for what is switched off
        os.environ.setdefault("RAY_AUTH_MODE", "token")  # read while Ray is imported
        os.environ.setdefault(_SECRET, secrets.token_hex(32))
    with _own_signals():
        try:
            import ray
        except ImportError as error:
            raise MissingExtraError("ray", "ray", "--engine ray") from error
        _messages_to_stderr(ray._private.worker)
        if not ray.is_initialized():
            if local:
                _start(ray, max(workers, usable_cores()))
            else:
                _join(ray, address)
    return ray


def _messages_to_stderr(worker: Any) -> None:
    """Let Ray say to standard error what it knows of lost workers: a verb's results may go to standard output."""
    written = getattr(worker, "print_to_stdstream", None)
    if written is not None and not isinstance(written, partial):
        worker.print_to_stdstream = partial(_to_stderr, written)


def _to_stderr(written: Callable[..., None], data: dict[str, Any], **settings: Any) -> None:
    written({**data, "is_err": True}, **settings)


def _join(ray: Any, address: str) -> None:
    advice = "Start one with 'ray start --head' here, or with 'ray start --address HOST:PORT' join this machine to it."
    host, _, port = address.rpartition(":") if ":" in address else (address, "", _PORT)
    if address != "auto" and (not host or "/" in host or not port.isdecimal() or int(port) > 0xFFFF):
        raise BulkError(f"--address {address}: expected auto, HOST or HOST:PORT, such as 10.0.0.1:6379")
    try:
        if address != "auto":
            socket.create_connection((host, int(port)), timeout=_CONNECT_S).close()
            address = f"{host}:{port}"
        ray.init(address=address, log_to_driver=False, logging_level="CRITICAL")
    except Exception as error:
        raise BulkError(f"--address {address}: expected a Ray cluster, got: {plain(error)}. {advice}") from error
    atexit.register(ray.shutdown)


def _start(ray: Any, cores: int) -> None:
    """Start Ray on this machine: on 127.0.0.1 alone, with a password, without dashboard and statistics."""
    if sys.platform == "win32":
        raise BulkError("--engine ray: expected --address of a cluster, since Ray starts no own one on Windows here")
    temporary = Path(tempfile.gettempdir())
    if len(os.fspath(temporary)) > _LONGEST_FOLDER:
        temporary = Path("/tmp")  # noqa: S108 - a new folder in it, of this user alone
    _sweep(temporary)
    folder = Path(tempfile.mkdtemp(prefix=_FOLDER, dir=temporary))
    handle = os.open(folder, os.O_RDONLY)
    try_lock(handle)
    _own.append((folder, handle))
    atexit.register(close)
    failure: Exception | None = None
    for _ in range(_STARTS):  # Ray gives its own processes 15 to 30 s, which a busy machine may not have
        try:
            ray.init(
                address="local",
                num_cpus=cores,
                include_dashboard=False,
                object_store_memory=_STORE_BYTES,
                log_to_driver=False,
                logging_level="CRITICAL",
                _temp_dir=os.fspath(folder),
            )
        except Exception as error:  # noqa: BLE001 - raised below
            failure = error
            _end(ray, folder)
        else:
            return
    close()
    raise BulkError(f"--engine ray: Ray could not start on this machine: {plain(failure or OSError())}") from failure


def _sweep(temporary: Path) -> None:
    """Remove folders of Ray that killed commands left; who is at work locks its own before it fills it."""
    for folder in temporary.glob(f"{_FOLDER}*"):
        with suppress(OSError):
            if folder.is_symlink() or not any(folder.iterdir()):
                continue
            handle = os.open(folder, os.O_RDONLY)
            try:
                if try_lock(handle):
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(handle)


def close() -> None:
    """End the Ray that this process started, with all its processes and its folder; nothing if there is none."""
    if not _own:
        return
    import ray

    folder, handle = _own.pop()
    _end(ray, folder)
    until = time.monotonic() + PATIENCE_S
    while folder.exists() and time.monotonic() < until:
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.01)
    os.close(handle)
    os.environ.pop(_SECRET, None)


def _end(ray: Any, folder: Path) -> None:
    """End all processes of the Ray that has a folder."""
    processes = []
    for process in psutil.Process().children(recursive=True):
        line = " ".join(_words(process))
        if os.fspath(folder) in line or line.startswith("ray::"):
            processes.append(process)
    with _own_signals():
        ray.shutdown()
    _, left = psutil.wait_procs(processes, timeout=PATIENCE_S)
    for process in left:
        with suppress(psutil.Error):
            process.kill()
    psutil.wait_procs(left, timeout=PATIENCE_S)


def _words(process: Any) -> list[str]:
    """The command line of a process; nothing if it has ended."""
    try:
        return list(process.cmdline())
    except psutil.Error:
        return []


@contextmanager
def _own_signals() -> Iterator[None]:
    """Keep this process's handlers: Ray sets others, which end it without its clean-up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    ended = False
    try:
        yield
    except SystemExit as leaving:  # Ray's handler
        ended = leaving.code == signal.SIGTERM
        raise
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)
        if ended:
            signal.raise_signal(signal.SIGTERM)
