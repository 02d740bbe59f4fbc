"""The engine of this machine: order, workers that die, errors, stopping, memory."""

import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import psutil
import pytest

from farfield.errors import ConfigError, FileFormatError
from farfield.jobs import ENGINES, HERE, BulkError, JobJournal, JobOptions, Unit, run, values
from farfield.jobs.local import LocalEngine
from farfield.jobs.process import VARIABLES, ended_by_signals, one_thread, pythons_interrupt
from farfield.jobs.runs import available_bytes, fitting
from jobs import works

UNITS = [Unit(str(number), parameters=number) for number in range(24)]
TWO = JobOptions(workers=2)


def test_values_come_in_order_from_any_number_of_workers() -> None:
    squares = [number**2 for number in range(24)]
    for bulk in (HERE, TWO, JobOptions(workers=3)):
        assert [done.value for done in values(works.square, UNITS, bulk)] == squares
    found = [done.value for done in values(works.slowest_first, UNITS, TWO)]
    assert [number for number, _ in found] == list(range(24))
    assert len({process for _, process in found}) == 2


def test_units_of_a_group_go_to_one_worker() -> None:
    grouped = [Unit(str(number), parameters=number, group=str(number // 8)) for number in range(24)]
    found = [done.value for done in values(works.slowest_first, grouped, TWO)]
    assert [number for number, _ in found] == list(range(24))
    assert all(len({process for _, process in found[first : first + 8]}) == 1 for first in (0, 8, 16))


def test_a_work_that_wants_it_gets_a_process_for_each_unit(tmp_path: Path) -> None:
    for bulk in (HERE, TWO):
        found = [done.value for done in values(works.Alone(), UNITS[:4], bulk)]
        assert [number for number, _ in found] == list(range(4))
        assert len({process for _, process in found} - {os.getpid()}) == 4
        journal = JobJournal(tmp_path / f"{bulk.workers}.jsonl", "")
        assert run(works.Alone(), UNITS[:4], bulk, journal=journal).written == 4
        kept = journal.values([unit.name for unit in UNITS[:4]])
        assert len({process for _, process in kept} - {os.getpid()}) == 4
    assert not workers_of(os.getpid())


def test_a_bounded_number_is_under_way() -> None:
    taken: list[int] = []

    class Counted(list):
        def __getitem__(self, index):
            taken.append(index)
            return super().__getitem__(index)

    many = Counted(Unit(str(number), parameters=number) for number in range(500))
    results = LocalEngine().run(works.square, many, workers=2, ordered=True)
    next(results)
    time.sleep(0.3)
    assert len(set(taken)) < 100  # the type checks look at one more
    results.close()


def test_an_error_keeps_its_kind_and_words() -> None:
    for bulk in (HERE, TWO):
        with pytest.raises(FileFormatError, match=r"a\.xyz, line 3: expected numbers, found words\. Fix it\."):
            list(values(works.damaged, UNITS, bulk))
    assert not workers_of(os.getpid())


def test_a_unit_that_kills_its_worker_twice_is_named_and_all_others_are_done() -> None:
    found: list[int] = []
    with pytest.raises(BulkError, match=r"1 of 24 units .* 3 \(was ended by SIGKILL"):
        found.extend(done.value for done in values(works.kill_at_three, UNITS, TWO))
    assert found == [number for number in range(24) if number != 3]
    assert not workers_of(os.getpid())


def test_a_worker_that_dies_on_its_way_is_started_once_more(tmp_path: Path) -> None:
    (tmp_path / "once").touch()
    work = works.DiesOnArrival(tmp_path)
    assert [done.value for done in values(work, UNITS, TWO)] == list(range(24))
    for number in range(8):
        (tmp_path / str(number)).touch()
    with pytest.raises(BulkError, match="could not start: it was ended by SIGKILL"):
        list(values(work, UNITS, TWO))
    assert not workers_of(os.getpid())


def test_what_cannot_travel_is_refused() -> None:
    with pytest.raises(BulkError, match="can be sent to another process"):
        list(values(lambda unit: unit, UNITS, TWO))
    code = "from farfield.jobs import *\ndef f(u): return UnitResult()\n"
    code += "list(values(f, [Unit('a'), Unit('b')], JobOptions(workers=2)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "stand in a module" in done.stderr
    with pytest.raises(ConfigError, match="1 or more"):
        JobOptions(workers=-1)


def workers_of(process: int) -> list[psutil.Process]:
    return [p for p in psutil.Process(process).children(recursive=True) if p.status() != psutil.STATUS_ZOMBIE]


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_command_whatever_ends_it(ending: int, tmp_path: Path) -> None:
    for number in range(40):
        (tmp_path / f"{number}.in").write_text("x")
    (tmp_path / "out").mkdir()
    code = f"""
import signal, sys
from pathlib import Path
from jobs.works import Copy
from farfield.jobs import JobJournal, JobOptions, Unit, run
signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
folder = Path({str(tmp_path)!r})
units = [Unit(str(n), (folder / f"{{n}}.in",), n) for n in range(40)]
run(Copy(folder / "out", pause_s=0.2), units, JobOptions(workers=2), journal=JobJournal(folder / "out" / ".journal"))
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    command = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL, env=environment)
    until = time.monotonic() + 60
    while not list((tmp_path / "out").glob("*.txt")):
        assert time.monotonic() < until
        time.sleep(0.01)
    workers = workers_of(command.pid)
    assert len(workers) == 2
    command.send_signal(ending)
    status = command.wait(30)
    assert status == {signal.SIGINT: -signal.SIGINT, signal.SIGTERM: 143, signal.SIGKILL: -signal.SIGKILL}[ending]
    _, alive = psutil.wait_procs(workers, timeout=10)
    assert not alive
    assert not list((tmp_path / "out").glob(".*.part"))


def test_one_thread_and_back(monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch")
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    torch.set_num_threads(2)
    with one_thread():
        assert torch.get_num_threads() == 1
        assert {os.environ[name] for name in VARIABLES} == {"1"}
    assert torch.get_num_threads() == 2
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert "MKL_NUM_THREADS" not in os.environ


def test_memory_limits_the_workers(tmp_path: Path) -> None:
    assert fitting(8, 10**9, exactly=False, available=3 * 10**9) == 3
    assert fitting(8, 10**9, exactly=False, available=10**8) == 1
    assert fitting(8, 0, exactly=True, available=10**8) == 8
    with pytest.raises(BulkError, match="--workers 3 fits"):
        fitting(8, 10**9, exactly=True, available=3 * 10**9)
    with pytest.raises(BulkError, match="Close other programs"):
        fitting(2, 10**9, exactly=True, available=10**8)
    for name, text in (("max", "1000000"), ("current", "600000"), ("stat", "anon 1\ninactive_file 100000\n")):
        (tmp_path / f"memory.{name}").write_text(text)
    assert available_bytes(tmp_path) == 500_000
    (tmp_path / "memory.max").write_text("max\n")
    assert available_bytes(tmp_path) > 500_000


def test_as_many_workers_as_there_are_cores_and_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(6)), raising=False)
    automatic = JobOptions(workers=0)
    assert [automatic.num_workers(works.square, count) for count in (1, 7, 8, 1000)] == [1, 1, 2, 6]
    assert JobOptions(workers=4).num_workers(works.square, 2) == 2


def test_an_engine_of_another_package_does_the_work_of_any_verb(tmp_path: Path) -> None:
    """Registered by its name: what a verb gives it is units and work, what it gives back is theirs."""
    asked: list[tuple[int, int]] = []

    class Backwards:
        def run(self, work, units, *, workers, ordered):
            asked.append((len(units), workers))
            places = range(len(units)) if ordered else reversed(range(len(units)))
            for place in places:
                yield place, work(units[place])

    ENGINES.register("backwards")(Backwards)
    assert [done.value for done in values(works.square, UNITS, JobOptions(workers=3, engine="backwards"))][:3] == [
        0,
        1,
        4,
    ]
    (tmp_path / "1.in").write_text("x")
    units = [Unit("1", (tmp_path / "1.in",), 1)]
    assert (
        run(works.Copy(tmp_path), units, JobOptions(engine="backwards"), journal=JobJournal(tmp_path / ".j")).written
        == 1
    )
    assert asked == [(24, 3), (1, 1)]
    with pytest.raises(ConfigError, match="Expected a bulk engine, one of local"):
        list(values(works.square, UNITS, JobOptions(engine="cluster")))


class Swallows:
    """Python drops what is raised while an object is cleared away, a signal's exit too."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)


def counted_under_a_lost_signal(done: list[int]) -> None:
    with ended_by_signals():
        for result in values(works.square, UNITS):
            done.append(result.value)
            if len(done) == 3:
                Swallows()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_whose_exit_was_lost_ends_the_work_after_the_unit() -> None:
    done: list[int] = []
    with pytest.raises(SystemExit) as ended:
        counted_under_a_lost_signal(done)
    assert ended.value.code == 143
    assert len(done) == 3


def interrupted_in_a_library(number: int) -> None:
    """Libraries replace what a signal raises in their code by an error of their own."""
    with ended_by_signals():
        try:
            os.kill(os.getpid(), number)
            time.sleep(0.01)
        except BaseException:
            raise ValueError("Invalid affine transformation matrix") from None


@pytest.mark.parametrize(("number", "ending"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)])
def test_what_a_library_makes_of_a_signal_is_not_told(number: int, ending: type[BaseException]) -> None:
    before = signal.getsignal(number)
    with pytest.raises(ending):
        interrupted_in_a_library(number)
    assert signal.getsignal(number) is before
    with pytest.raises(ValueError, match="a fault"), ended_by_signals():
        raise ValueError("a fault")


def imported_and_waited(name: str, modules: list[ModuleType]) -> None:
    with ended_by_signals():
        modules.append(importlib.import_module(name))
        time.sleep(5)


@pytest.mark.parametrize(("number", "ending"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)])
def test_a_signal_during_an_import_waits_for_its_end(
    number: int, ending: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Modules of pybind11 end the process by "terminate called" where a signal raises in their initialisation."""
    lines = f"import os, time\nos.kill(os.getpid(), {number})\ntime.sleep(0.2)\nwhole = True\n"
    (tmp_path / f"compiled_{number}.py").write_text(lines)
    monkeypatch.syspath_prepend(tmp_path)
    modules: list[ModuleType] = []
    with pytest.raises(ending):
        imported_and_waited(f"compiled_{number}", modules)
    assert [module.whole for module in modules] == [True]


def test_asyncio_finds_the_handler_by_which_it_ends_its_tasks_in_order() -> None:
    with ended_by_signals():
        own = signal.getsignal(signal.SIGINT)
        assert own is not signal.default_int_handler
        with pythons_interrupt():
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert signal.getsignal(signal.SIGINT) is own
