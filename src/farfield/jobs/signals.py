"""SIGTERM unwinds the work as Ctrl-C does, so that nothing is left half-written and no process stays."""

import signal
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
    before = signal.signal(signal.SIGTERM, _end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
        _received.clear()


def _end(number: int, frame: FrameType | None) -> None:
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
