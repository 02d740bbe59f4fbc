"""``farfield sync`` that is killed at any moment: the next one leaves the bytes of one that was not."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

START = 1_700_000_000_000_000_000
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}


@pytest.fixture
def stamps(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Five hours of a lidar and a camera."""
    folder = tmp_path / "rig"
    folder.mkdir()
    for name, count, period in (("lidar", 180_000, 100_000_000), ("camera", 540_000, 33_333_333)):
        times = START + np.arange(count) * period + rng.integers(-500_000, 500_000, count)
        (folder / f"{name}.txt").write_text("\n".join(map(str, times.tolist())) + "\n")
    return folder


def begun_table(out: Path) -> bool:
    return any(path.stat().st_size > 0 for path in out.glob(".matches.csv.*.part"))


def table_alone(out: Path) -> bool:
    return (out / "matches.csv").exists()


def contents(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in out.iterdir()}


def command(stamps: Path, out: Path) -> list[str]:
    return [sys.executable, "-m", "farfield.cli", "sync", str(stamps), "--to", "lidar", "--out", str(out)]


@pytest.mark.slow
@pytest.mark.parametrize("moment", [begun_table, table_alone])
def test_a_killed_sync_is_done_again_to_the_same_bytes(
    stamps: Path, tmp_path: Path, moment: Callable[[Path], bool]
) -> None:
    assert (
        subprocess.run(command(stamps, tmp_path / "whole"), env=ENVIRONMENT, stdout=subprocess.DEVNULL).returncode == 0
    )
    out = tmp_path / "killed"
    running = subprocess.Popen(command(stamps, out), env=ENVIRONMENT, stdout=subprocess.DEVNULL)
    until = time.monotonic() + 120
    while running.poll() is None and time.monotonic() < until and not (out.is_dir() and moment(out)):
        time.sleep(0.002)
    running.send_signal(signal.SIGKILL)
    assert running.wait() == -signal.SIGKILL
    assert not (out / "sync.html").exists()
    assert subprocess.run(command(stamps, out), env=ENVIRONMENT, stdout=subprocess.DEVNULL).returncode == 0
    assert contents(out) == contents(tmp_path / "whole")  # nothing of the killed one is left
