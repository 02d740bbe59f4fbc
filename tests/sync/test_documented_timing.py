"""The code of docs/timing.md runs, and what it says there is so."""

import re
import shlex
from pathlib import Path

import pytest

from farfield.cli import main

PAGE = Path(__file__).resolve().parents[2] / "docs" / "timing.md"


def test_the_page_runs() -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    names: dict = {}
    exec(compile(block, PAGE.name, "exec"), names)
    assert names["table"].residual_ns[:3, 0].tolist() == [4_000_000, 3_999_999, 3_999_998]
    assert names["groups"][0].partners == {"camera": (4_000_000, 0)}
    clock = names["fit_clock"](names["lidar"], names["lidar"] + names["table"].residual_ns[:, 0], modulo_ns=33_333_333)
    assert abs(clock.drift_ppm + 0.01) < 1e-3


def test_the_commands_of_the_recording_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("embreex")
    pytest.importorskip("rosbags")
    section = PAGE.read_text(encoding="utf-8").partition("## A recording to test on")[2]
    (block,) = re.findall(r"^```bash\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(tmp_path)
    for line in block.splitlines():
        program, *words = shlex.split(line)
        assert program == "farfield"
        assert main([*words, *(["--sensors", "gaussian,uniform"] if words[0] == "simulate" else [])]) == 0
    assert (tmp_path / "raw" / "segment_00_truth.json").is_file()
    assert (tmp_path / "synced" / "sync.html").is_file()
