"""A Ray of this machine: the same files whoever works, after lost workers and killed commands, and nothing left."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
import pytest

from jobs.works import sources

pytest.importorskip("ray")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform == "win32", reason="signals")]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
COPY = """
import sys
from pathlib import Path
from jobs.works import Copy, sources
from farfield.jobs import JobJournal, JobOptions, run
from farfield.jobs.folders import held
from farfield.jobs.process import ended_by_signals
folder, engine, pause = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
try:
    with ended_by_signals(), held(folder / "out"):
        options = JobOptions(workers=int(sys.argv[4]), engine=engine)
        journal = JobJournal(folder / "out" / ".journal", "a")
        done = run(Copy(folder / "out", pause_s=pause), sources(folder.parent / "in", 12), options, journal=journal)
except KeyboardInterrupt:  # as a verb does
    sys.exit(130)
print(done.written, done.skipped)
"""
UNITS = """
import os, sys, time
from farfield.jobs import JobOptions, Unit, values
from jobs import works
count = int(sys.argv[1])
units = [Unit(str(number), parameters=number) for number in range(count)]
list(values(works.nothing, units[:10], JobOptions(workers=2, engine="ray")))
began = time.process_time()
assert sum(1 for _ in values(works.nothing, units, JobOptions(workers=2, engine="ray"))) == count
print(1e3 * (time.process_time() - began) / count)
"""


def begin(folder: Path, engine: str, pause_s: float = 0.0, workers: int = 2) -> subprocess.Popen[str]:
    words = [sys.executable, "-c", COPY, str(folder), engine, str(pause_s), str(workers)]
    return subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)


def output_of(command: subprocess.Popen[str]) -> str:
    printed, _ = command.communicate(timeout=600)
    assert command.returncode == 0
    return printed.split("\n")[0]


def tree(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "out").iterdir()}


def own_folders() -> set[Path]:
    return {path for path in Path(tempfile.gettempdir()).glob("farfield-ray-*") if any(path.iterdir())}


def of_ray(command: subprocess.Popen[str], beginning: str = "") -> list[psutil.Process]:
    """Processes of a command's Ray, by the beginning of their names."""
    processes = []
    for process in psutil.Process(command.pid).children(recursive=True):
        try:
            line = " ".join(process.cmdline())
        except psutil.Error:
            continue
        if line.startswith(beginning):
            processes.append(process)
    return processes


def begun(folder: Path) -> subprocess.Popen[str]:
    """A command that is at work, some units behind it and some before."""
    command = begin(folder, "ray", pause_s=1.0)
    until = time.monotonic() + 300
    journal = folder / "out" / ".journal"
    while not (journal.is_file() and journal.read_bytes().count(b"\n") > 1 and of_ray(command, "ray::do_units")):
        assert command.poll() is None
        assert time.monotonic() < until
        time.sleep(0.02)
    return command


@pytest.fixture
def expected(tmp_path: Path) -> dict[str, bytes]:
    sources(tmp_path / "in")
    (tmp_path / "one").mkdir()
    assert output_of(begin(tmp_path / "one", "local", workers=1)) == "12 0"
    return tree(tmp_path / "one")


def test_one_process_two_local_workers_and_two_of_ray_leave_the_same_bytes(
    tmp_path: Path, expected: dict[str, bytes]
) -> None:
    before = own_folders()
    for engine in ("local", "ray"):
        (tmp_path / engine).mkdir()
        assert output_of(begin(tmp_path / engine, engine)) == "12 0"
        assert tree(tmp_path / engine) == expected
        assert output_of(begin(tmp_path / engine, engine)) == "0 12"
    assert own_folders() <= before


def test_a_killed_worker_of_ray_costs_nothing(tmp_path: Path, expected: dict[str, bytes]) -> None:
    folder = tmp_path / "ray"
    folder.mkdir()
    command = begun(folder)
    of_ray(command, "ray::do_units")[0].kill()
    assert output_of(command) == "12 0"
    assert tree(folder) == expected


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_ended_command_leaves_no_process_and_goes_on(
    tmp_path: Path, expected: dict[str, bytes], ending: signal.Signals
) -> None:
    folder, before = tmp_path / "ray", own_folders()
    folder.mkdir()
    command = begun(folder)
    processes = of_ray(command)
    command.send_signal(ending)
    command.communicate(timeout=120)
    assert command.returncode == {signal.SIGTERM: 143, signal.SIGINT: 130}.get(ending, -ending)
    _, alive = psutil.wait_procs(processes, timeout=180)  # Ray's agents ask a dead server for a minute, and then end
    assert not alive
    if ending != signal.SIGKILL:
        assert own_folders() <= before
        assert not [*(folder / "out").glob(".*.part")]
    done = output_of(begin(folder, "ray"))
    assert done.split()[0] not in ("0", "12")
    assert tree(folder) == expected
    assert own_folders() <= before


def test_units_of_no_work_cost_the_command_little() -> None:
    words = [sys.executable, "-c", UNITS, "10000"]
    done = subprocess.run(words, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True, check=True)
    print(done.stdout)
    assert float(done.stdout) > 0  # the figure stands in the report of the run: no timed assertion


def test_a_grid_of_trainings_gives_the_same_weights_and_decisions(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("embreex")
    from safetensors.numpy import load_file

    support = Path(__file__).resolve().parents[1] / "support" / "tinygrid.py"
    trees = []
    for workers, engine in (("1", "local"), ("2", "ray")):
        out = tmp_path / engine
        words = [sys.executable, str(support), str(out), workers, engine]
        subprocess.run(words, check=True, env=ENVIRONMENT, capture_output=True, timeout=1500)
        weights = {path.parent.name: load_file(path) for path in out.glob("runs/*/weights.safetensors")}
        arrays = {(run, name): array.tobytes() for run, one in weights.items() for name, array in one.items()}
        trees.append(((out / "reproduction.json").read_bytes(), arrays))
    assert len(trees[0][1]) > 100
    assert trees[0] == trees[1]


def test_a_verb_leaves_the_same_bytes(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    words = [sys.executable, "-m", "farfield.cli", "simulate", "cirrus-sim-mini"]
    trees = []
    for name, flags in (("one", ["--workers", "1"]), ("ray", ["--workers", "2", "--engine", "ray"])):
        few = ["--frames", "4", "--sequences", "2", "--sensors", "gaussian"]
        subprocess.run([*words, str(tmp_path / name), *few, *flags], check=True, env=ENVIRONMENT, capture_output=True)
        files = [path for path in (tmp_path / name).rglob("*") if path.is_file()]
        trees.append({path.relative_to(tmp_path / name).as_posix(): path.read_bytes() for path in files})
    assert trees[0] == trees[1]
