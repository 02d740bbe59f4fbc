"""The process that detects: it gets a detector's name and a frame's number, and gives boxes or what went wrong."""

import multiprocessing
import os
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from farfield.datasets.base import Dataset
from farfield.errors import FarfieldError
from farfield.frame import Boxes, Frame

Load = Callable[[str], Callable[[Frame], Boxes]]


def load(name: str) -> Any:
    """A detector by its name."""
    from farfield.api import load_detector

    return load_detector(name)


def work(connection: Connection, data: Dataset, loader: Load) -> None:
    """Answer until the other end closes.

    Args:
        connection: Gives ``(name, index)``, takes ``("boxes", Boxes)`` or ``("failed", sentence)``.
        data: The data set; boxes are given in its coordinates.
        loader: Gives a detector by its name.
    """
    from farfield.detection import search

    loaded: dict[str, Any] = {}
    while True:
        try:
            name, index = connection.recv()
        except (EOFError, OSError, KeyboardInterrupt):
            return
        try:
            if name not in loaded:
                loaded[name] = loader(name)
            found = next(iter(search(loaded[name], data.select([index]), in_own=True).found({})))
            answer: tuple[str, Any] = ("boxes", Boxes.empty(scored=True) if found is None else found.boxes)
        except FarfieldError as error:
            answer = ("failed", str(error))
        except KeyboardInterrupt:
            return
        except Exception as error:  # noqa: BLE001
            answer = ("failed", f"{type(error).__name__}: {str(error)[:300]}")
        try:
            connection.send(answer)
        except OSError:
            return


class Worker:
    """The process, from the server's side; started at the first question, and anew after it died.

    Args:
        data: The data set.
        loader: Gives a detector by its name; runs in the process.
    """

    def __init__(self, data: Dataset, loader: Load = load) -> None:
        self.data, self.loader = data, loader
        self._process: Any = None
        self._connection: Connection | None = None

    def ask(self, name: str, index: int) -> Boxes:
        """Detect in one frame; waits.

        Raises:
            FarfieldError: With what went wrong.
        """
        connection = self._started()
        try:
            connection.send((name, index))
            kind, value = connection.recv()
        except (EOFError, OSError):
            code = self._ended()
            raise FarfieldError(
                f"the process that detects ended (status {code}), perhaps for want of memory; ask again to start anew"
            ) from None
        if kind == "failed":
            raise FarfieldError(value)
        return value

    def _started(self) -> Connection:
        if self._connection is None or not self._process.is_alive():
            self.stop()
            context = multiprocessing.get_context("spawn")
            here, there = context.Pipe()
            self._process = context.Process(target=work, args=(there, self.data, self.loader), daemon=True)
            self._process.start()
            there.close()
            self._connection = here
        return self._connection

    def _ended(self) -> int | None:
        process, code = self._process, None
        if process is not None:
            process.join(5)
            code = process.exitcode
        self.stop()
        return code

    def stop(self) -> None:
        """End the process."""
        connection, self._connection = self._connection, None
        process, self._process = self._process, None  # two threads may come here: who asks, and who ends the studio
        if connection is not None:
            connection.close()
        if process is not None:
            process.terminate()
            process.join(5)
            if process.is_alive():
                os.kill(process.pid, 9)
                process.join(5)
