"""``farfield depth``: its example, what it says, and that SIGKILL changes no byte."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from farfield.cli import main
from farfield.files.depth_png import read_depth

pytest.importorskip("embreex")

FRAMES = 6


def hashes(folder: Path) -> dict[str, str]:
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def simulated(folder: Path) -> None:
    from farfield.simulation.recording import record

    record("kitti-sim-mini", folder, frames=FRAMES, sequences=2, workers=1)


@pytest.fixture(scope="module")
def data(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    return made_once("depth-frames", simulated)


def test_the_example(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """farfield depth data/kitti --out depth/ --uncertainty --picture first.png"""
    out, picture = tmp_path / "depth", tmp_path / "first.png"
    words = ["depth", str(data), "--out", str(out), "--uncertainty", "--picture", str(picture), "--workers", "1"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert f"{FRAMES} written, 0 had been written" in said
    assert "value / 256, to 255.996 m" in said
    maps = sorted((out / "depth").rglob("*.png"))
    assert len(maps) == FRAMES
    found = read_depth(maps[0]).depth_m
    assert np.isfinite(found).mean() > 0.3
    assert 1 < np.nanmin(found) < np.nanmax(found) < 256
    with Image.open(picture) as drawn:
        assert drawn.width > 1000
        assert np.asarray(drawn.convert("RGB")).std() > 30
    assert main([*words[:-2], "--workers", "2"]) == 0
    assert f"0 written, {FRAMES} had been written" in capsys.readouterr().out


def test_what_cannot_be_is_said(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, expected in (
        (["--cloud", "gaussian"], "expected cloud 'gaussian', found lidar"),
        (["--camera", "rear"], "expected calibrated camera 'rear', found camera"),
        (["--picture", "a.bmp"], "expected a name that ends with"),
    ):
        assert main(["depth", str(data), "--out", str(tmp_path / "out"), "--workers", "1", *words]) == 1
        assert expected in capsys.readouterr().err


@pytest.mark.slow
def test_killed_at_any_moment_the_next_run_gives_the_same_bytes(data: Path, tmp_path: Path) -> None:
    words = ["depth", str(data), "--uncertainty", "--workers", "2"]
    assert main([*words[:-1], "1", "--out", str(tmp_path / "whole")]) == 0
    killed, cut = tmp_path / "killed", 0
    command = [sys.executable, "-m", "farfield.cli", *words, "--out", str(killed)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    for count in (1, 2, 4):
        quiet = subprocess.DEVNULL
        run = subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True, env=environment)
        until = time.monotonic() + 120
        while len(list(killed.rglob("depth/*/*.png"))) < count and run.poll() is None:
            assert time.monotonic() < until
            time.sleep(0.002)
        if run.poll() is None:
            os.killpg(run.pid, signal.SIGKILL)
        run.wait(30)
        cut += len(list(killed.rglob("depth/*/*.png"))) < FRAMES
    assert cut >= 1
    assert main([*words, "--out", str(killed)]) == 0
    assert hashes(killed) == hashes(tmp_path / "whole")
