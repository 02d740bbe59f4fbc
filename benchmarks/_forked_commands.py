"""Commands as forks of a process that has imported what they need: most of a short command's time is its imports."""

import importlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from farfield.cli import main
from farfield.files.atomic import write_text

_STARTED = multiprocessing.get_context("fork")


class ForkedCommand:
    """A command of farfield in a session of its own, with the few methods of ``subprocess.Popen`` that are needed.

    Args:
        words: The verb and its words.
        folder: Where it runs.
        environment: What its surroundings have besides.
        imported: A file that takes the names of the modules that it has at its end.
    """

    def __init__(self, words: Sequence[str], folder: Path, environment: Mapping[str, str], imported: Path) -> None:
        read, write = os.pipe()
        self.process = _STARTED.Process(target=_work, args=(words, folder, environment, imported, read, write))
        self.process.start()
        self.pid: int = self.process.pid or 0
        os.close(write)
        self.stderr = os.fdopen(read, encoding="utf-8", errors="replace")

    @property
    def returncode(self) -> int | None:
        """The exit status, negative for a signal; None while it runs."""
        return self.process.exitcode

    def poll(self) -> int | None:
        """The same."""
        return self.process.exitcode

    def wait(self, timeout: float = 60.0) -> int:
        """Wait for its end."""
        self.process.join(timeout)
        if self.process.exitcode is None:
            raise subprocess.TimeoutExpired("farfield", timeout)
        return self.process.exitcode

    def communicate(self, timeout: float) -> tuple[str, str]:
        """Wait for its end; nothing, and what it said on its error stream."""
        with self.stderr:
            words = self.stderr.read()
        self.wait(timeout)
        return "", words

    def send_signal(self, number: int) -> None:
        """Send it a signal, if it runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill it."""
        self.send_signal(signal.SIGKILL)


def _work(
    words: Sequence[str], folder: Path, environment: Mapping[str, str], imported: Path, read: int, write: int
) -> None:
    """Be the command, and end."""
    os.close(read)
    os.setsid()
    os.chdir(folder)
    os.environ.update(environment)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(write, 2)
    os.close(write)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False, buffering=1)
    sys.argv = ["farfield", *words]
    status = main([*words])
    if status == 0:
        write_text(imported, json.dumps([name for name in sys.modules if name != "__main__"]))
    sys.exit(status)


def import_all(imported: Path) -> None:
    """Import what a command had at its end, so that the next has it from the start."""
    for name in json.loads(imported.read_text()) if imported.is_file() else ():
        if name not in sys.modules:
            with suppress(Exception):
                importlib.import_module(name)
