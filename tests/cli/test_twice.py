"""Two commands at once in one folder: one waits or is refused, and what they leave is what one leaves."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("embreex")

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}


def started(*words: object) -> subprocess.Popen:
    command = [sys.executable, "-m", "farfield.cli", *map(str, words), "--workers", "1"]
    return subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_convert_twice_at_once_leaves_what_one_leaves(simulated_cirrus: Path, tmp_path: Path) -> None:
    one = started("convert", simulated_cirrus, tmp_path / "one", "--to", "kitti")
    words = one.communicate(timeout=120)[1]
    assert one.returncode == 0, words
    for _ in range(2):
        both = [started("convert", simulated_cirrus, tmp_path / "two", "--to", "kitti") for _ in range(2)]
        ended = [(command.communicate(timeout=120)[1], command.returncode) for command in both]
        assert 0 in [status for _, status in ended]
        assert all(status == 0 or "expected no other command that writes there" in words for words, status in ended)
        assert contents(tmp_path / "two") == contents(tmp_path / "one")
