"""Every verb that goes over many frames gives the same files whoever works, and goes on after any end."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import psutil
import pytest

from farfield.cli import main
from farfield.recording import record

pytest.importorskip("torch")
pytest.importorskip("embreex")

FEW = ["--sensors", "gaussian,uniform", "--sequences", "2"]


def cirrus(folder: Path, frames: int = 8) -> None:
    record("cirrus-sim-mini", folder, frames=frames, sequences=2, sensors="gaussian,uniform", workers=1)


@dataclass(frozen=True)
class Verb:
    """A command: its words before the folder to write into, and after it; DATA stands for its frames."""

    before: str
    after: str = ""
    reads: bool = True

    def words(self, data: Path, out: Path) -> list[str]:
        words = f"{self.before} OUT {self.after}".split()
        return [str(data) if word == "DATA" else word.replace("OUT", str(out)) for word in words]


VERBS = {
    "simulate": Verb(
        "simulate cirrus-sim-mini", "--frames 8 --sequences 2 --sensors gaussian,uniform --cache", reads=False
    ),
    "convert-kitti": Verb("convert DATA", "--to kitti"),
    "convert-cirrus": Verb("convert DATA", "--to cirrus"),
    "convert-boxes-csv": Verb("convert DATA", "--to boxes-csv"),
    "predict": Verb("predict pointpillars-cirrus-sim DATA --out", "--cloud gaussian"),
    "evaluate": Verb(
        "evaluate pointpillars-cirrus-sim DATA --out", "--clouds gaussian --replicates 3 --shown-frames 1"
    ),
    "stats": Verb("stats DATA --name frames --out", "--sweeps 4"),
}
NAMES = {"predict": "boxes.csv"}


def hashes(out: Path, leave: tuple[str, ...] = ("timing.json",)) -> dict[str, str]:
    """SHA-256 of all that a command left, but for what the clock measured."""
    files = [out] if out.is_file() else [path for path in sorted(out.rglob("*")) if path.is_file()]
    return {
        path.relative_to(out.parent).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
        if path.name not in leave
    }


@pytest.fixture(scope="module")
def data(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    return made_once("bulk-frames", cirrus)


@pytest.fixture(scope="module")
def whole(data: Path, made_once: Callable[[str, Callable[[Path], object]], Path]) -> Callable[[str], dict[str, str]]:
    """What each verb leaves that one process does."""
    return lambda name: hashes(made_once(f"bulk-{name}", partial(_by_one, name, data)) / NAMES.get(name, "out"))


def _by_one(name: str, data: Path, folder: Path) -> None:
    folder.mkdir()
    assert main([*VERBS[name].words(data, folder / NAMES.get(name, "out")), "--workers", "1"]) == 0


def command(name: str, data: Path, folder: Path) -> list[str]:
    out = folder / NAMES.get(name, "out")
    return [sys.executable, "-m", "farfield.cli", *VERBS[name].words(data, out), "--workers", "2"]


ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}


@pytest.mark.parametrize(
    "name", [name if name in ("simulate", "predict") else pytest.param(name, marks=pytest.mark.slow) for name in VERBS]
)
def test_two_workers_leave_the_same_bytes_as_one_process(
    name: str, data: Path, whole: Callable[[str], dict[str, str]], tmp_path: Path
) -> None:
    assert subprocess.run(command(name, data, tmp_path), env=ENVIRONMENT, stdout=subprocess.DEVNULL).returncode == 0
    assert hashes(tmp_path / NAMES.get(name, "out")) == whole(name)


def begun(folder: Path, running: subprocess.Popen) -> list[psutil.Process]:
    """Wait until both workers are at work; a moment later something is written and something is not."""
    until = time.monotonic() + 120
    while running.poll() is None and time.monotonic() < until:
        with suppress(psutil.Error, OSError):  # what comes and goes meanwhile: other processes, folders
            workers = [p for p in psutil.Process(running.pid).children() if "farfield.bulk.worker" in p.cmdline()]
            if len(workers) == 2 and any(path.is_file() for path in folder.rglob("*.jsonl")):
                return workers
        time.sleep(0.005)
    raise AssertionError("the workers were never seen at work")


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["a worker", "SIGKILL", "SIGTERM", "SIGINT"])
@pytest.mark.parametrize("name", ["simulate", "convert-kitti", "convert-cirrus", "predict", "evaluate"])
def test_whatever_ends_a_command_the_next_one_completes_it(
    name: str, ending: str, data: Path, whole: Callable[[str], dict[str, str]], tmp_path: Path
) -> None:
    words, quiet = command(name, data, tmp_path), subprocess.DEVNULL
    running = subprocess.Popen(words, env=ENVIRONMENT, stdout=quiet, stderr=quiet)
    workers = begun(tmp_path, running)
    if ending == "a worker":
        workers[0].kill()
        assert running.wait(300) == 0
    else:
        running.send_signal(getattr(signal, ending))
        status = {"SIGKILL": -signal.SIGKILL, "SIGTERM": 143, "SIGINT": 130}[ending]
        assert running.wait(60) == status
        assert not psutil.wait_procs(workers, timeout=30)[1]  # no process is left
        if ending != "SIGKILL":
            left = [path for path in tmp_path.rglob("*") if path.name.endswith(".part") or "unfinished-" in path.name]
            assert left == []
        assert subprocess.run(words, env=ENVIRONMENT, stdout=quiet, stderr=quiet).returncode == 0
    assert hashes(tmp_path / NAMES.get(name, "out")) == whole(name)
    assert not [path for path in tmp_path.iterdir() if path.name != NAMES.get(name, "out")]


@pytest.mark.slow
@pytest.mark.parametrize("words", [["doctor", "DATA", "--json"], ["convert", "DATA", "--to", "cache", "--overwrite"]])
def test_what_stands_elsewhere_is_equal_too(words: list[str], tmp_path: Path) -> None:
    """The doctor prints, and a cache stands beside its clouds."""
    data = tmp_path / "data"
    cirrus(data)
    words = [str(data) if word == "DATA" else word for word in words]
    said = []
    for workers in ("1", "2"):
        run = [sys.executable, "-m", "farfield.cli", *words, "--workers", workers]
        done = subprocess.run(run, env=ENVIRONMENT, stdout=subprocess.PIPE, check=True)
        said.append((done.stdout, hashes(data)))
    assert said[0] == said[1]
