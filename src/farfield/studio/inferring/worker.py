"""The process that detects: it gets a detector's name and a frame's number, and gives boxes or what went wrong."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable
from typing import IO, Any

from farfield.datasets.base import Dataset
from farfield.errors import FarfieldError
from farfield.frame import Boxes, Frame
from farfield.jobs.worker import receive, send

Load = Callable[[str], Callable[[Frame], Boxes]]


def load(name: str) -> Any:
    """A detector by its name."""
    from farfield.api import load_detector

    return load_detector(name)


def work(source: IO[bytes], target: IO[bytes]) -> None:
    """Answer until the other end closes: first come data set and loader, then ``(name, index)`` again and again.

    Answers are ``("boxes", Boxes)``, in the data set's coordinates, or ``("failed", sentence)``.
    """
    data, loader = receive(source)
    loaded: dict[str, Any] = {}
    while True:
        name, index = receive(source)
        send(target, _answer(data, loader, loaded, name, index))


def _answer(data: Dataset, loader: Load, loaded: dict[str, Any], name: str, index: int) -> tuple[str, Any]:
    from farfield.evaluation import plan_detection

    try:
        if name not in loaded:
            loaded[name] = loader(name)
        detections = next(plan_detection(loaded[name], data.select([index]), in_own=True).detections())
        return "boxes", Boxes.empty(scored=True) if detections is None else detections.boxes
    except FarfieldError as error:
        return "failed", str(error)
    except Exception as error:  # noqa: BLE001
        return "failed", f"{type(error).__name__}: {str(error)[:300]}"


class Worker:
    """The process, from the server's side; started at the first question, and anew after it died.

    Args:
        data: The data set.
        loader: Gives a detector by its name; runs in the process.
    """

    def __init__(self, data: Dataset, loader: Load = load) -> None:
        self.data, self.loader = data, loader
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, name: str, index: int) -> Boxes:
        """Detect in one frame; waits.

        Raises:
            FarfieldError: With what went wrong.
        """
        try:
            process = self._started()
            send(process.stdin, (name, index))
            kind, value = receive(process.stdout)
        except (EOFError, OSError, ValueError):
            code = self._ended()
            raise FarfieldError(
                f"the process that detects ended (status {code}), perhaps for want of memory; ask again to start anew"
            ) from None
        if kind == "failed":
            raise FarfieldError(value)
        boxes: Boxes = value
        return boxes

    def _started(self) -> "subprocess.Popen[bytes]":
        process = self._process
        if process is None or process.poll() is not None:
            self.stop()
            command = [sys.executable, "-m", __name__]
            environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
            process = subprocess.Popen(  # noqa: S603
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
            )
            self._process = process
            send(process.stdin, (self.data, self.loader))
        return process

    def _ended(self) -> int | None:
        process, code = self._process, None
        if process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = process.wait(5)
        self.stop()
        return code

    def stop(self) -> None:
        """End the process."""
        process, self._process = self._process, None  # two threads may come here: who asks, and who ends the studio
        if process is None:
            return
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            with contextlib.suppress(OSError):
                if stream is not None:
                    stream.close()


def main() -> None:
    """Serve the process that started this one; what libraries print goes to the terminal."""
    own = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with contextlib.suppress(EOFError, OSError, KeyboardInterrupt):
        work(sys.stdin.buffer, own)


if __name__ == "__main__":
    main()
