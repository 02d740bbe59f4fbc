"""A command's process: ended by SIGTERM and by Ctrl-C, so that nothing is left half-written and no process stays."""

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

_received: list[int] = []
_TORCH_FOLDERS = "torchinductor_*"
_IMPORTLIB = "<frozen importlib._bootstrap>"
_IMPORT_PAUSE_S = 0.05


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let Ctrl-C end what runs meanwhile, and SIGTERM with exit status 143; only the main thread can.

    What a signal raises may come out as another error: a library's code that was being run replaces it. That error is
    not told. A signal that comes while a module is imported waits until the import has ended: compiled modules abort
    the process where Python's code raises in their initialisation.

    Raises:
        KeyboardInterrupt: After Ctrl-C.
        SystemExit: After SIGTERM.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {signal.SIGTERM: signal.signal(signal.SIGTERM, _on_signal)}
    if callable(signal.getsignal(signal.SIGINT)):  # else it is ignored, as behind nohup
        before[signal.SIGINT] = signal.signal(signal.SIGINT, _on_signal)
    try:
        yield
    except Exception:
        check()
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _received.clear()


@contextmanager
def pythons_interrupt() -> Iterator[None]:
    """Let Ctrl-C raise by Python's own handler meanwhile: only where it stands does asyncio end its tasks in order."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not _on_signal:
        yield
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, _on_signal)


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _imports(frame):
        again = threading.Timer(_IMPORT_PAUSE_S, signal.raise_signal, [number])
        again.daemon = True
        again.start()
        return
    _received.append(number)
    check()


def _imports(frame: FrameType | None) -> bool:
    """Whether a frame runs within an import."""
    while frame is not None and frame.f_code.co_filename != _IMPORTLIB:
        frame = frame.f_back
    return frame is not None


def check() -> None:
    """End where a signal came: what it raised is lost if it comes while an object is being cleared away.

    Raises:
        KeyboardInterrupt: After Ctrl-C.
        SystemExit: After SIGTERM, with status 128 and the signal's number.
    """
    if _received and _received[0] == signal.SIGINT:
        raise KeyboardInterrupt
    if _received:
        raise SystemExit(128 + _received[0])


def usable_cores() -> int:
    """Cores that this process may use: fewer than the machine has under taskset or in a container's set."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# One thread a worker: as many workers as cores are at work, and sums in another order have other last digits.

VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What libraries read when they are loaded."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Let numpy, torch and numba compute on one thread meanwhile, whether they are loaded yet or not."""
    from threadpoolctl import threadpool_limits

    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
    torch, numba = sys.modules.get("torch"), sys.modules.get("numba")
    of_torch = None if torch is None else torch.get_num_threads()
    of_numba = None if numba is None else numba.get_num_threads()
    try:
        with threadpool_limits(1):
            if torch is not None:
                torch.set_num_threads(1)
            if numba is not None:
                numba.set_num_threads(1)
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if torch is not None:
            torch.set_num_threads(of_torch)
        if numba is not None:
            numba.set_num_threads(of_numba)


@contextmanager
def without_torch_folder() -> Iterator[None]:
    """Remove the folder for compiled code that torch makes among the temporary files as it is imported, if it is empty.

    One that was there before stays, as does one that something was compiled into.
    """
    try:
        temporary = Path(tempfile.gettempdir())
    except FileNotFoundError:  # no folder for temporary files can be written
        yield
        return
    before = set(temporary.glob(_TORCH_FOLDERS))
    try:
        yield
    finally:
        for folder in set(temporary.glob(_TORCH_FOLDERS)) - before if "torch" in sys.modules else ():
            with suppress(OSError):  # not empty, or somebody else's
                folder.rmdir()
