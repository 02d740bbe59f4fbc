"""Ctrl-C and SIGTERM between two steps, so that a run keeps what it has done."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import torch

from farfield.training.distributed import average_values

Handler = Callable[[int, FrameType | None], Any] | int | None


class StopSignal:
    """Whether a signal asked to stop. A second one ends at once, as it would have without."""

    def __init__(self) -> None:
        self.number = 0
        self.before: dict[int, Handler] = {}

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Receive a signal."""
        before = self.before[number]
        if self.number and callable(before):
            before(number, frame)
        self.number = number

    def asked(self, device: torch.device) -> bool:
        """Whether any process was asked to stop: all of them hear of it after the same step."""
        return average_values({"asked": float(self.number > 0)}, device)["asked"] > 0

    def follow(self) -> None:
        """End as the signal would have ended it.

        Raises:
            KeyboardInterrupt: After Ctrl-C, or where another process was asked to stop.
            SystemExit: After SIGTERM, where the command line ends by it.
        """
        before = self.before.get(self.number)
        if self.number != signal.SIGINT and callable(before):
            before(self.number, None)
        raise KeyboardInterrupt


@contextmanager
def stopping() -> Iterator[StopSignal]:
    """Let Ctrl-C and SIGTERM wait for the end of a step; outside the main thread they stay as they are."""
    stop = StopSignal()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    for number in (signal.SIGINT, signal.SIGTERM):
        if callable(signal.getsignal(number)):  # one that ends the process by itself is left alone
            stop.before[number] = signal.signal(number, stop)
    try:
        yield stop
    finally:
        for received, before in stop.before.items():
            signal.signal(received, before)
