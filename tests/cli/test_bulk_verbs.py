"""Every verb that goes over many frames gives the same files whoever works, and goes on after any end."""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import psutil
import pytest
from face_model import has_face_model
from whole import whole_or

from farfield.files.videos import write_film
from farfield.simulation.recording import record

pytest.importorskip("torch")
pytest.importorskip("embreex")

AT = 0.6  # of what a worker usually takes: the moment at which a verb without a journal is ended


def cirrus(folder: Path, frames: int = 8, sequences: int = 2) -> None:
    record("cirrus-sim-mini", folder, frames=frames, sequences=sequences, sensors="gaussian,uniform", workers=1)


def kradar(folder: Path) -> None:
    record("kradar-sim-mini", folder, frames=12, sensors="os2-64,cube", workers=1)


def faces(folder: Path) -> None:
    """Pictures of a portrait that walks by, large enough that a moment passes over each, and a film."""
    from matplotlib.cbook import get_sample_data
    from PIL import Image

    folder.mkdir()
    with get_sample_data("grace_hopper.jpg") as file:
        portrait = Image.open(file).convert("RGB")
    for number in range(12):
        picture = Image.new("RGB", (960, 640), (96, 104, 110))
        picture.paste(portrait, (10 * number, 20))
        picture.save(folder / f"{number:02}.png")
    if find_spec("av"):
        small = np.stack([np.array(portrait.resize((150, 176)))] * 20)
        write_film(folder / "film.mp4", iter(small), range(0, 2000, 100), Fraction(1, 1000))


MAKERS = {"faces": faces, "few": cirrus, "many": partial(cirrus, frames=40, sequences=6), "radar": kradar}


@dataclass(frozen=True)
class Verb:
    """A command; DATA stands in its words for its frames, OUT for what it writes.

    Args:
        line: Its words.
        data: Its frames, of ``MAKERS``.
        out: The name of what it writes.
        prints: It prints into that instead.
        beside: It writes beside its frames: OUT is a copy of them.
        journal: It keeps a journal for longer than a moment while it works.
    """

    line: str
    data: str = "few"
    out: str = "out"
    prints: bool = False
    beside: bool = False
    journal: bool = True

    def words(self, data: Path, folder: Path) -> list[str]:
        """The words for a folder, which holds a copy of the frames where the verb writes beside them."""
        out = folder / self.out
        if self.beside and not out.exists():
            shutil.copytree(data, out)
        given = {"DATA": str(data), "OUT": str(out)}
        return [given.get(word, word) for word in self.line.split()]


def reading(line: str, **settings: bool) -> Verb:
    return Verb(line, data="many", journal=False, **settings)


VERBS = {
    "simulate": Verb("simulate cirrus-sim-mini OUT --frames 8 --sequences 2 --sensors gaussian,uniform --cache"),
    "convert-kitti": Verb("convert DATA OUT --to kitti"),
    "convert-cirrus": Verb("convert DATA OUT --to cirrus"),
    "convert-boxes-csv": reading("convert DATA OUT --to boxes-csv"),
    "convert-radar-store": Verb("convert DATA OUT --to radar-store", data="radar"),
    "convert-cache": reading("convert OUT --to cache", beside=True),
    "predict": Verb("predict pointpillars-cirrus-sim DATA --out OUT --cloud gaussian", out="boxes.csv"),
    "evaluate": Verb(
        "evaluate pointpillars-cirrus-sim DATA --out OUT --clouds gaussian --replicates 3 --shown-frames 1"
    ),
    "stats": reading("stats DATA --name frames --out OUT --sweeps 120"),
    "compare": reading("compare DATA DATA --names one,other --out OUT --frames 0"),
    "doctor": reading("doctor DATA --frames 0 --json -", prints=True),
}
if has_face_model():
    VERBS["anonymize"] = Verb("anonymize DATA OUT", data="faces")
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
Once = Callable[[str, Callable[[Path], object]], Path]


def hashes(out: Path, leave: tuple[str, ...] = ("timing.json",)) -> dict[str, str]:
    """SHA-256 of all that a command left, but for what the clock measured."""
    files = [out] if out.is_file() else [path for path in sorted(out.rglob("*")) if path.is_file()]
    return {
        path.relative_to(out.parent).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
        if path.name not in leave
    }


def begin(name: str, data: Path, folder: Path, workers: int = 2) -> subprocess.Popen:
    """Start a verb; what it says while it works goes nowhere."""
    verb = VERBS[name]
    words = [sys.executable, "-m", "farfield.cli", *verb.words(data, folder), "--workers", str(workers)]
    quiet = subprocess.DEVNULL
    if not verb.prints:
        return subprocess.Popen(words, env=ENVIRONMENT, stdout=quiet, stderr=quiet)
    with (folder / verb.out).open("wb") as file:
        return subprocess.Popen(words, env=ENVIRONMENT, stdout=file, stderr=quiet)


def workers_of(running: subprocess.Popen) -> list[psutil.Process]:
    with suppress(psutil.Error):
        return [p for p in psutil.Process(running.pid).children() if "farfield.jobs.worker" in p.cmdline()]
    return []


def cpu_s(worker: psutil.Process) -> float:
    with suppress(psutil.Error):
        return sum(worker.cpu_times()[:2])
    return 0.0


@pytest.fixture(scope="module")
def data(made_once: Once) -> Callable[[str], Path]:
    """The frames of each verb."""
    return lambda name: made_once(f"bulk-{VERBS[name].data}", MAKERS[VERBS[name].data])


@pytest.fixture(scope="module")
def whole(data: Callable[[str], Path], made_once: Once) -> Callable[[str], dict[str, str]]:
    """What each verb leaves that one process does."""
    return lambda name: hashes(made_once(f"bulk-one-{name}", partial(_by_one, name, data(name))) / VERBS[name].out)


def _by_one(name: str, data: Path, folder: Path) -> None:
    folder.mkdir()
    assert begin(name, data, folder, workers=1).wait(600) == 0


@pytest.fixture(scope="module")
def usual(data: Callable[[str], Path], made_once: Once) -> Callable[[str], float]:
    """Seconds of CPU that the busiest worker of a verb takes where nothing ends it."""
    return lambda name: float((made_once(f"bulk-two-{name}", partial(_by_two, name, data(name))) / "cpu_s").read_text())


def _by_two(name: str, data: Path, folder: Path) -> None:
    folder.mkdir()
    running, most = begin(name, data, folder), 0.0
    while running.poll() is None:
        most = max([most, *map(cpu_s, workers_of(running))])
        time.sleep(0.01)
    assert running.returncode == 0
    (folder / "cpu_s").write_text(f"{most}")


@pytest.mark.parametrize(
    "name", [name if name in ("simulate", "predict") else pytest.param(name, marks=pytest.mark.slow) for name in VERBS]
)
def test_two_workers_leave_the_same_bytes_as_one_process(
    name: str, data: Callable[[str], Path], whole: Callable[[str], dict[str, str]], tmp_path: Path
) -> None:
    assert begin(name, data(name), tmp_path).wait(600) == 0
    assert hashes(tmp_path / VERBS[name].out) == whole(name)


def begun(folder: Path, running: subprocess.Popen, usual_s: float) -> list[psutil.Process]:
    """Wait until both workers are at work: something is written and something is not, or one is well on its way."""
    until = time.monotonic() + 120
    while running.poll() is None and time.monotonic() < until:
        workers = workers_of(running)
        with suppress(OSError):  # folders that come and go
            if len(workers) == 2 and (
                max(map(cpu_s, workers)) > AT * usual_s
                if usual_s
                else any(path.is_file() for path in folder.rglob("*.jsonl"))
            ):
                return workers
        time.sleep(0.005)
    raise AssertionError("the workers were never seen at work")


ENDINGS = ("a worker", "SIGKILL", "SIGTERM", "SIGINT")
ENDED = [(name, ending) for index, name in enumerate(VERBS) for ending in whole_or(ENDINGS, (ENDINGS[index % 4],))]
"""One mechanism ends them all: each verb is ended in one way; FARFIELD_WHOLE=1 tries every way on every verb."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ending"), ENDED)
def test_whatever_ends_a_command_the_next_one_completes_it(
    name: str,
    ending: str,
    data: Callable[[str], Path],
    whole: Callable[[str], dict[str, str]],
    usual: Callable[[str], float],
    tmp_path: Path,
) -> None:
    verb, usual_s = VERBS[name], 0.0 if VERBS[name].journal else usual(name)
    running = begin(name, data(name), tmp_path)
    workers = begun(tmp_path, running, usual_s)
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
        assert begin(name, data(name), tmp_path).wait(600) == 0
    assert hashes(tmp_path / verb.out) == whole(name)
    assert not [path for path in tmp_path.iterdir() if path.name != verb.out]
