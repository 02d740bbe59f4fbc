"""Works that the tests of bulk work do, in a module since they travel to other processes."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from farfield.errors import FileFormatError
from farfield.files.atomic import write_text
from farfield.jobs import Unit, UnitResult


def nothing(unit: Unit) -> UnitResult:
    return UnitResult()


def square(unit: Unit) -> UnitResult:
    return UnitResult(value=unit.parameters**2, clock=time.time())


def slowest_first(unit: Unit) -> UnitResult:
    time.sleep(0.02 * (unit.parameters % 3))
    return UnitResult(value=[unit.parameters, os.getpid()])


def damaged(unit: Unit) -> UnitResult:
    if unit.parameters == 3:
        raise FileFormatError("a.xyz", where="line 3", expected="numbers", got="words", fix="Fix it.")
    return UnitResult(value=unit.parameters)


def kill_at_three(unit: Unit) -> UnitResult:
    """Dies at unit 3, whoever does it."""
    if unit.parameters == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return UnitResult(value=unit.parameters)


@dataclass(frozen=True)
class Copy:
    """Writes what stands in a unit's source, with a greeting; the first to come to ``fatal`` is killed."""

    folder: Path
    fatal: str = ""
    pause_s: float = 0.0

    def __call__(self, unit: Unit) -> UnitResult:
        if unit.name == self.fatal and not (self.folder.parent / "died").exists():
            (self.folder.parent / "died").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(self.pause_s)
        text = "".join(path.read_text() for path in unit.sources)
        path = self.folder / f"{unit.name}.txt"
        write_text(path, f"{unit.parameters} {text}")
        return UnitResult(files=(path,), value={"length": len(text)}, clock=time.time())


@dataclass
class DiesOnArrival:
    """Kills the process in which it is unpacked, as often as there are files to take away."""

    folder: Path

    def __setstate__(self, state: dict[str, Path]) -> None:
        self.__dict__.update(state)
        left = next(self.folder.iterdir(), None)
        if left is not None:
            left.unlink(missing_ok=True)
            os.kill(os.getpid(), signal.SIGKILL)

    def __call__(self, unit: Unit) -> UnitResult:
        return UnitResult(value=unit.parameters)


@dataclass(frozen=True)
class Alone:
    """Says which process did a unit; wants a new one for each."""

    own_process = True

    def __call__(self, unit: Unit) -> UnitResult:
        return UnitResult(value=[unit.parameters, os.getpid()])


def sources(folder: Path, count: int = 12) -> list[Unit]:
    """Units, each of a file of words."""
    folder.mkdir(exist_ok=True)
    units = []
    for number in range(count):
        path = folder / f"{number:02d}.in"
        if not path.exists():
            path.write_text("word " * number)
        units.append(Unit(f"{number:02d}", (path,), number))
    return units
