"""SIGTERM unwinds the work as Ctrl-C does, so that nothing is left half-written and no process stays."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_received: list[int] = []


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end what runs meanwhile with exit status 143; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _on_sigterm)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
        _received.clear()


def _on_sigterm(number: int, frame: FrameType | None) -> None:
    del frame
    _received.append(number)
    check()


def check() -> None:
    """End where a signal came: what it raised is lost if it comes while an object is being cleared away.

    Raises:
        SystemExit: With status 128 and the signal's number.
    """
    if _received:
        raise SystemExit(128 + _received[0])


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
