"""Fixtures that all tests share."""

import gc
import importlib.util
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
from _pytest import runner
from hypothesis import settings

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# The same examples at every run, so that a red run is the change's own. To explore:  HYPOTHESIS_PROFILE=explore
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None, max_examples=2000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# The suite starts a hundred processes: each compiles all sources anew where the environment forbids to keep bytecode.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A shell's background job starts with SIGINT ignored, and hands that on to each process that a test interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Collecting makes a million objects that live to the end. Looking through them again and again took half the time of
# collecting and a share of every test.
gc.disable()


def pytest_collection_finish() -> None:
    """Leave what was collected out of all searches for garbage; these go on as often as ever."""
    gc.freeze()
    gc.collect()  # counts what is left: the next whole search comes when there is a quarter more of that
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip tests that need a GPU or FARFIELD_WHOLE where there is none, and begin with the longest.

    One that takes minutes and begins last would leave the other workers without work.
    """
    for item in () if os.environ.get("FARFIELD_WHOLE") else items:
        if item.get_closest_marker("whole"):
            item.add_marker(pytest.mark.skip(reason="runs with FARFIELD_WHOLE=1"))
    items.sort(key=lambda item: item.get_closest_marker("first") is None)  # the others stay in their order
    marked = [item for item in items if item.get_closest_marker("gpu")]
    if marked and not importlib.import_module("torch").cuda.is_available():
        for item in marked:
            item.add_marker(pytest.mark.skip(reason="needs a CUDA GPU"))


def _roomy(call: Callable[[], object]) -> object:
    return call()


# CPython takes its stack in chunks of 16 kB. The deep calls of the shape checks cross the end of one a million times,
# and each time memory is mapped and given back; a function that seems to need a lot gets a chunk with room beneath it.
_roomy.__code__ = _roomy.__code__.replace(co_stacksize=(1 << 17) + 100)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> object:
    """Run each test in a stack of one piece."""
    return _roomy(partial(runner.pytest_runtest_protocol, item, nextitem))


def pytest_runtest_setup() -> None:
    """Check the first calls of every function anew in each test (``tests/support/shapes.py``)."""
    if "shapes" in sys.modules:
        sys.modules["shapes"].begin_test()


def pytest_runtest_teardown() -> None:
    """Give back the threads that a test's training took: they would quarrel with the other workers ever after."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def shared_real() -> Path:
    """The folder of real frames beside the project; tests that need it skip where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "real"
    if not folder.is_dir():
        pytest.skip("no real data beside the project")
    return folder


@pytest.fixture(scope="session")
def shared_open() -> Path:
    """The folder of real sweeps that may be shipped, beside the project; tests that need it skip where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "open"
    if not folder.is_dir():
        pytest.skip("no open data beside the project")
    return folder


def _made_once(home: Path, name: str, make: Callable[[Path], object]) -> Path:
    home.mkdir(exist_ok=True)
    with (home / f"{name}.lock").open("w") as lock:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)  # let go when the file is closed, or its process killed
        if not (home / f"{name}.made").exists():
            shutil.rmtree(home / name, ignore_errors=True)
            make(home / name)
            (home / f"{name}.made").touch()
    return home / name


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], object]], Path]:
    """Gives a folder by its name, made by whichever worker asks first; the others wait, and nobody writes into it."""
    base = tmp_path_factory.getbasetemp()
    return partial(_made_once, (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared")


class _OneAtATime:
    """Lets one worker compile while the others wait: what it compiled, they then find in numba's cache."""

    def __init__(self, compiler: Callable[..., object], path: Path) -> None:
        self.compiler, self.path, self.depth = compiler, path, 0

    def __call__(self, dispatcher: object, signature: object) -> object:
        with self.path.open("w") as lock:
            if fcntl is not None and not self.depth:  # one kernel's compilation asks for that of others
                fcntl.flock(lock, fcntl.LOCK_EX)
            self.depth += 1
            try:
                return self.compiler(dispatcher, signature)
            finally:
                self.depth -= 1


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Several workers that compile the same kernels at once took a tenth of the suite's time."""
    if "PYTEST_XDIST_WORKER" not in os.environ or importlib.util.find_spec("numba") is None:
        yield
        return
    from numba.core.dispatcher import Dispatcher

    with pytest.MonkeyPatch.context() as patch:
        once = _OneAtATime(Dispatcher.compile, tmp_path_factory.getbasetemp().parent / "compiling.lock")
        patch.setattr(Dispatcher, "compile", lambda self, signature: once(self, signature))
        yield


def _three_frames(root: Path) -> None:
    from farfield.datasets.cirrus import CirrusWriter
    from farfield.simulation import simulate_sequence

    for frame in simulate_sequence("cirrus-sim-mini", seed=5, sequence=1, frames=3):
        CirrusWriter(root).write(frame)


@pytest.fixture(scope="session")
def simulated_cirrus(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """Three simulated frames of one drive in the Cirrus layout; read only."""
    pytest.importorskip("embreex")
    return made_once("cirrus", _three_frames)


@pytest.fixture
def without_shape_checks() -> Iterator[None]:
    """Let the errors that users meet answer, not the shape checks that only tests run."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
