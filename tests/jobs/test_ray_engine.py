"""Tasks of Ray against a Ray that does them here, one by one, and loses those it is told to: no cluster is needed."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from farfield.cli import main
from farfield.errors import ConfigError, FileFormatError, MissingExtraError
from farfield.jobs import BulkError, FailedTask, JobJournal, JobOptions, Unit, local, ray_engine, run, runs, values
from farfield.jobs.ray_engine import RayEngine
from jobs import works

UNITS = [Unit(str(number), parameters=number) for number in range(24)]


def two() -> JobOptions:
    return JobOptions(workers=2, engine="ray")


class OneByOne:
    """What the engine calls of Ray; the task that began last ends first."""

    def __init__(self) -> None:
        names = ("WorkerCrashedError", "OutOfMemoryError", "NodeDiedError", "ObjectLostError")
        error = type("RayError", (Exception,), {})
        self.exceptions = SimpleNamespace(RayError=error, **{name: type(name, (error,), {}) for name in names})
        self.deaths: list[str] = []
        self.resources: dict[str, Any] = {}
        self.waiting: list[Callable[[], Any]] = []
        self.cancelled: list[bool] = []
        self.most = 0
        self.loses: Callable[[list[Unit]], str] = lambda units: ""
        self.machines = [{"Alive": True, "Resources": {"CPU": 3.0, "memory": 5e9}}]

    def put(self, value: Any) -> Any:
        return value

    def get(self, task: Any) -> Any:
        return task() if callable(task) else task

    def remote(self, **resources: Any) -> Callable[[Callable[..., bytes]], SimpleNamespace]:
        self.resources = resources
        return lambda function: SimpleNamespace(remote=lambda *words: self._begun(function, *words))

    def _begun(self, function: Callable[..., bytes], box: Any, home: Any, units: Sequence[bytes]) -> Callable[[], Any]:
        def task() -> bytes:
            kind = self.loses([ray_engine.pickle.loads(unit) for unit in units])
            if kind:
                self.deaths.append(kind)
                raise getattr(self.exceptions, kind)("gone")
            return function(box, home, units)

        self.waiting.append(task)
        self.most = max(self.most, len(self.waiting))
        return task

    def wait(self, tasks: list[Any], num_returns: int, timeout: float) -> tuple[list[Any], list[Any]]:
        ended = [self.waiting.pop() for _ in range(min(num_returns, len(self.waiting)))]
        return ended, [task for task in tasks if task not in ended]

    def cancel(self, task: Any, force: bool) -> None:
        self.cancelled.append(force)

    def nodes(self) -> list[dict[str, Any]]:
        return self.machines


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> OneByOne:
    here = OneByOne()
    monkeypatch.setattr(ray_engine, "_connected", lambda address, workers: here)
    monkeypatch.setattr(ray_engine, "_threads", [None])  # the tests' own threads stay
    monkeypatch.setattr(runs, "find_spec", lambda name: name)
    monkeypatch.setitem(sys.modules, "ray", here)  # type: ignore[arg-type]
    return here


def test_values_come_in_order_and_no_more_tasks_are_under_way_than_workers(ray: OneByOne) -> None:
    assert [done.value for done in values(works.square, UNITS, two())] == [number**2 for number in range(24)]
    assert ray.most == 2
    assert ray.resources == {"num_cpus": 1, "max_retries": 0}
    done = [index for index, _ in RayEngine().run(works.square, UNITS, workers=3, ordered=False)]
    assert done != sorted(done) == [*range(24)]
    assert ray.most == 3


def test_units_that_wait_for_a_slow_one_are_bounded(ray: OneByOne, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_engine, "AHEAD", 4)
    results = RayEngine().run(works.square, UNITS, workers=2, ordered=True)
    assert next(results)[0] == 0  # the first task ends last: only when no more may be taken
    results.close()
    assert len(UNITS) - len(ray.waiting) > 8


def test_the_files_and_the_journal_are_those_of_one_process(ray: OneByOne, tmp_path: Path) -> None:
    units = works.sources(tmp_path / "in")
    trees = []
    for name, options in (("one", JobOptions()), ("ray", two())):
        out = tmp_path / name
        out.mkdir()
        run(works.Copy(out), units, options, journal=JobJournal(out / ".journal", "a"))
        trees.append({path.name: path.read_bytes() for path in out.iterdir()})
    assert len(trees[0]) == 13
    assert trees[0] == trees[1]


def test_a_task_says_what_it_needs(ray: OneByOne) -> None:
    class Large(works.Copy):
        memory_bytes = 2_000_000_000

    list(values(works.Alone(), UNITS[:2], two()))
    assert ray.resources == {"num_cpus": 1, "max_retries": 0, "max_calls": 1}
    cluster = JobOptions(engine="ray", address="auto", workers=0)
    assert cluster.num_workers(Large(Path()), 100) == 2  # 5 GB: two of three cores
    assert cluster.num_workers(works.square, 100) == 3
    assert JobOptions(engine="ray", address="auto", workers=8).num_workers(works.square, 2) == 2
    ray.machines = [{"Alive": True, "Resources": {"CPU": 8.0, "memory": 1e9}}, {"Alive": False, "Resources": {}}]
    with pytest.raises(BulkError, match=r"a core and 2\.00 GB of memory for a worker, got 1 of at most 1\.00 GB"):
        cluster.num_workers(Large(Path()), 100)


def test_a_lost_worker_s_unit_is_done_once_more_and_named_after_its_second_death(ray: OneByOne) -> None:
    ray.loses = lambda units: "WorkerCrashedError" if units[0].name == "3" and not ray.deaths else ""
    assert [done.value for done in values(works.square, UNITS, two())] == [number**2 for number in range(24)]
    assert ray.deaths == ["WorkerCrashedError"]
    done: list[int] = []
    ray.loses = lambda units: "OutOfMemoryError" if units[0].name == "3" else ""
    with pytest.raises(BulkError, match=r"1 of 24 units .* 3 \(was ended by Ray for want of memory\)"):
        done.extend(result.value for result in values(works.square, UNITS, two()))
    assert done == [number**2 for number in range(24) if number != 3]


def test_of_a_group_that_is_lost_only_the_guilty_unit_is_named(ray: OneByOne) -> None:
    units = [Unit(str(number), parameters=number, group=str(number // 12)) for number in range(24)]
    sizes: list[int] = []

    def loses(batch: list[Unit]) -> str:
        sizes.append(len(batch))
        return "NodeDiedError" if "5" in [unit.name for unit in batch] else ""

    ray.loses = loses
    results = dict(RayEngine().run(works.square, units, workers=2, ordered=True))
    assert {index for index, result in results.items() if isinstance(result, FailedTask)} == {5}
    assert results[5] == FailedTask("was lost with its node")
    assert max(sizes) == local.GROUP
    assert sizes.count(2) == 2  # a task crosses no group: 10, 2, 10, 2


def test_an_error_keeps_its_kind_and_words_and_leaves_the_rest(ray: OneByOne) -> None:
    with pytest.raises(FileFormatError, match=r"a\.xyz, line 3: expected numbers, found words\. Fix it\."):
        list(values(works.damaged, UNITS, two()))
    assert ray.cancelled[:1] == [False]  # what was under way is left in order, and ended only if it would not leave


def test_another_version_on_a_node_is_named(ray: OneByOne, monkeypatch: pytest.MonkeyPatch) -> None:
    versions = iter(["1", *"2" * 50])
    monkeypatch.setattr(ray_engine, "_version", lambda: next(versions))
    with pytest.raises(BulkError, match=r"node .* of the Ray cluster: expected Farfield 1, got 2\. Install one"):
        list(values(works.square, UNITS, two()))


def test_an_address_needs_the_engine_and_the_engine_its_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigError, match="--address auto: expected --engine ray, whose cluster it names; got --eng"):
        JobOptions(address="auto")
    words = ["simulate", "cirrus-sim-mini", str(tmp_path / "out"), "--frames", "2"]
    assert main([*words, "--address", "10.0.0.1:6379"]) == 1
    assert "--address 10.0.0.1:6379: expected --engine ray" in capsys.readouterr().err
    monkeypatch.setattr(runs, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="--engine ray needs ray"):
        JobOptions(engine="ray")
    assert main([*words, "--engine", "ray"]) == 1
    assert "--engine ray needs ray. Install it with: " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("address", ["ray://10.0.0.1:10001", "host:", ":6379", "host:99999"])
def test_an_address_that_is_none_is_named(address: str) -> None:
    with pytest.raises(BulkError, match=r"expected auto, HOST or HOST:PORT, such as"):
        ray_engine._join(None, address)


def test_a_cluster_that_does_not_answer_is_named() -> None:
    with pytest.raises(BulkError, match=r"127\.0\.0\.1:1: expected a Ray cluster, got: Connection refused\. Start one"):
        ray_engine._join(None, "127.0.0.1:1")
