"""Every verb where it is stopped, where nobody reads what it says, where nothing can be written, and with odd names."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from whole import whole_or

from farfield.cli import VERBS, main

ROOT = Path(__file__).resolve().parents[2]
ODD = "a\nb <b>&'\""
WORDS = {
    "demo": "demo --out OUT",
    "doctor": "doctor DATA",
    "stats": "stats DATA --out OUT",
    "radar": "radar DATA --out OUT",
    "show": "show DATA --out OUT/a.png",
    "view": "view DATA --port 0 --no-open",
    "annotate": "annotate DATA --port 0 --no-open",
    "new-dataset": "new-dataset OUT",
    "simulate": "simulate cirrus-sim-mini OUT",
    "convert": "convert DATA OUT --to kitti",
    "formats": "formats",
    "detectors": "detectors",
    "experiments": "experiments",
    "bench": "bench --only boxes-csv --minutes 0.05 --json OUT/a.json",
    "train": "train pointpillars-cirrus-sim --out OUT",
    "adapt": "adapt pointpillars-cirrus-sim DATA --out OUT",
    "reproduce": "reproduce cirrus --out OUT",
    "import-weights": "import-weights DATA/0.npy OUT/a.safetensors",
    "export": "export pointpillars-cirrus-sim OUT/a.onnx",
    "predict": "predict pointpillars-cirrus-sim DATA --out OUT/boxes.csv",
    "evaluate": "evaluate pointpillars-cirrus-sim DATA --out OUT",
    "track": "track DATA/labels.csv --out OUT/tracks.csv",
    "sync": "sync DATA --out OUT",
    "calibrate": "calibrate radar-lidar DATA --out OUT",
    "odometry": "odometry DATA --out OUT",
    "anonymize": "anonymize DATA OUT",
    "depth": "depth DATA --out OUT",
    "score": "score DATA/found.csv DATA/labels.csv --json OUT/a.json",
    "worst": "worst DATA",
    "compare-results": "compare-results OUT/a.json OUT/b.json",
    "compare": "compare DATA DATA --out OUT",
    "report": "report DATA",
}
"""A command of each verb. Not all of them can do their work on these data: then they have to say why."""


WRITING = sorted(
    set(VERBS) - {"view", "annotate", "train", "adapt", "reproduce", "demo"} - whole_or(set(), {"bench", "export"})
)
"""Verbs that write what they find and end by themselves; two of them simulate or compile for half a minute."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("every") / "sweeps"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for number in range(4):
        points = rng.uniform([1, -20, -2, 0], [60, 20, 1, 1], (20_000, 4)).astype(np.float32)
        np.save(folder / f"{number}.npy", points)
    return folder


def command(verb: str, data: Path, out: Path) -> list[str]:
    words = [word.replace("DATA", str(data)).replace("OUT", str(out)) for word in WORDS[verb].split()]
    return [sys.executable, "-m", "farfield.cli", *words]


def environment(**changes: str | None) -> dict[str, str]:
    changed = {**os.environ, "PYTHONPATH": str(ROOT / "src"), **changes}
    return {name: value for name, value in changed.items() if value is not None}


def test_every_verb_has_a_command() -> None:
    assert set(WORDS) == set(VERBS)


def end_myself(*_: object, **__: object) -> int:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(5)
    return 0


@pytest.mark.parametrize("when", ["farfield.cli._run", "tyro.cli"])  # at work, and while words are parsed
@pytest.mark.parametrize(
    ("verb", "words"),
    [("convert", "again: it resumes where it stopped.\n"), ("score", "Run the same command again.\n")],
)
def test_a_verb_that_sigterm_ends_says_how_to_go_on(
    verb: str, words: str, when: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(when, end_myself)
    with pytest.raises(SystemExit) as ended:
        main([verb])
    assert ended.value.code == 143
    told = capsys.readouterr().err
    assert told.startswith(f"farfield {verb}: ended by SIGTERM. ")
    assert told.endswith(words)


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize(
    ("number", "status", "after_s"), [(signal.SIGINT, 130, 2.5), (signal.SIGTERM, 143, 6.0)], ids=["INT", "TERM"]
)
def test_a_stopped_verb_says_so_and_leaves_no_process(
    tmp_path: Path, data: Path, verb: str, number: int, status: int, after_s: float
) -> None:
    """While its modules are imported and at its work, or it had ended before."""
    mark = tmp_path.name
    running = subprocess.Popen(
        command(verb, data, tmp_path / "out"),
        cwd=tmp_path,
        env=environment(FARFIELD_TEST_RUN=mark),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with suppress(subprocess.TimeoutExpired):
        running.wait(after_s)
    ended = running.poll() is not None
    if not ended:
        running.send_signal(number)
    _, told = running.communicate(timeout=60)
    own = told.split("Exception ignored")[0]  # by the interpreter, where a signal meets its last steps
    assert "Traceback" not in own, own
    # a shell shows -2 as 130 and -15 as 143: the interpreter was not up yet, or was down already
    assert running.returncode in ((0, 1, 2) if ended else (0, 1, 2, status, -number)), told
    assert running.returncode != status or "Run the same command again" in told, told
    until = time.monotonic() + 20  # workers see that their command is gone, and go
    while (left := [path for path in Path("/proc").glob("[0-9]*/environ") if _marked(path, mark)]) and (
        time.monotonic() < until
    ):
        time.sleep(0.2)
    assert not left


def _marked(path: Path, mark: str) -> bool:
    try:
        return f"FARFIELD_TEST_RUN={mark}".encode() in path.read_bytes().split(b"\0")
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize("verb", WRITING)
def test_a_verb_whose_output_is_closed_or_full_ends_without_traceback(tmp_path: Path, data: Path, verb: str) -> None:
    words = command(verb, data, tmp_path / "out")
    pipe = subprocess.PIPE
    with subprocess.Popen(words, cwd=tmp_path, env=environment(), stdout=pipe, stderr=pipe) as closed:
        assert closed.stdout is not None
        assert closed.stderr is not None
        closed.stdout.close()  # as `| true` does
        told = closed.stderr.read().decode()
    assert "Traceback" not in told, told
    assert "Exception ignored" not in told, told
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command(verb, data, tmp_path / "full"), cwd=tmp_path, env=environment(), stdout=full, stderr=subprocess.PIPE
        )
    assert b"Traceback" not in done.stderr, done.stderr.decode()
    assert b"Exception ignored" not in done.stderr, done.stderr.decode()
    assert done.returncode in (0, 1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("verb", WRITING)
def test_a_verb_that_cannot_write_says_so(tmp_path: Path, data: Path, verb: str) -> None:
    """The folder to write into is a file; and no home, no cache can be written."""
    (tmp_path / "file").write_text("")
    nowhere = str(tmp_path / "file" / "cache")
    changed = environment(HOME=None, MPLCONFIGDIR=nowhere, XDG_CACHE_HOME=nowhere, NUMBA_CACHE_DIR=nowhere)
    for out in (tmp_path / "file" / "out", Path("/proc/none/out")):
        done = subprocess.run(command(verb, data, out), cwd=tmp_path, env=changed, capture_output=True, text=True)
        assert "Traceback" not in done.stderr, done.stderr
        own = "\n".join(line for line in done.stderr.splitlines() if line.startswith("farfield"))
        assert "Errno" not in own, own  # other packages may tell of their caches as they please
        assert done.returncode in (0, 1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("verb", WRITING)
def test_odd_names_harm_nothing(tmp_path: Path, data: Path, verb: str) -> None:
    odd = tmp_path / ODD
    odd.mkdir()
    for path in data.iterdir():
        (odd / f"{ODD}{path.name}").write_bytes(path.read_bytes())
    done = subprocess.run(
        command(verb, odd, tmp_path / "out" / ODD), cwd=tmp_path, env=environment(), capture_output=True, text=True
    )
    assert "Traceback" not in done.stderr, done.stderr
    for page in tmp_path.rglob("*.html"):
        assert "<b>&" not in page.read_text("utf-8"), page
