"""Help and lists behind a closed pipe, on a full disk, and without an output: no traceback, the right exit status."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from wrong_inputs import own_folder, run

from farfield.cli import VERBS
from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes

ROOT = Path(__file__).resolve().parents[2]


def farfield(words: str, **streams: object) -> tuple[int, str]:
    """Exit status and errors of a command in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    command = [sys.executable, "-m", "farfield.cli", *words.split()]
    done = subprocess.run(command, env=environment, stderr=subprocess.PIPE, timeout=100, check=False, **streams)
    return done.returncode, done.stderr.decode()


def closed(words: str) -> tuple[int, str]:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        return farfield(words, stdout=writing)
    finally:
        os.close(writing)


def check(words: str) -> None:
    status, errors = closed(words)
    assert (status, errors) == (141, ""), words
    with Path("/dev/full").open("w") as full:
        status, errors = farfield(words, stdout=full)
    assert status == 1, words
    assert errors.rstrip().endswith(
        "No space left on device. Make room, then run the same command again: what is done is kept."
    )
    assert errors.count("\n") == 1, errors


@pytest.mark.parametrize(
    "words", ["--help", "", "--version", "--completion bash", "predict --help", "score -h", "experiments"]
)
def test_nobody_reads_or_no_room_is_left(words: str) -> None:
    check(words)


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_the_help_of_every_verb(verb: str) -> None:
    check(f"{verb} --help")


@pytest.mark.parametrize("words", ["nonsense", "score", "--completion none"])
def test_errors_that_nobody_reads_leave_the_exit_status(words: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    command = f"exec '{sys.executable}' -m farfield.cli {words}"
    for stream in ("2>&-", "2>/dev/full", ">&- 2>&-"):
        done = subprocess.run(["sh", "-c", f"{command} {stream}"], env=environment, capture_output=True, check=False)
        assert done.returncode in ((1, 2) if "full" in stream else (2,)), (words, stream)
        assert done.stdout == b""


@pytest.mark.parametrize(
    "words",
    [
        "score . DATA/labels.csv",
        "score DATA/labels.csv . --format nuscenes",
        "track . --out a.csv",
        "track . --format nuscenes --out a.json",
        "report DATA/labels.csv --film a.gif --predictions .",
        "doctor DATA --mapping .",
        "import-weights . a.safetensors",
        "import-weights DATA/labels.csv a.safetensors --settings .",
        "train . --dry-run",
        "predict . DATA --out a.csv",
        "predict DATA/labels.csv DATA --out a.csv",
        "score DATA/labels.csv DATA/labels.csv --protocol kradar --conditions .",
        "compare-results . DATA/labels.csv",
        "calibrate lidar-camera DATA --pairs . --out a",
        "view DATA --predictions . --html a.html",
    ],
)
def test_a_folder_in_the_place_of_a_file_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    data = own_folder(tmp_path / "data")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    status, text = run(capsys, *words.replace("DATA", str(data)).split())
    assert status in (1, 2), text
    assert "Is a directory" not in text, text
    assert "expected" in text.lower(), text


def test_a_folder_is_no_file_to_read(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="the file: expected a regular file, found a folder"):
        read_bytes(tmp_path)
