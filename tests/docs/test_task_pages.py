"""The pages of tasks are followed literally: each command and each line of Python, from top to bottom."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from farfield.datasets.folder import TABLE_NAME
from farfield.files.boxes_csv import COLUMNS

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
PAGES = {
    "score-boxes.md": ("DDS",),
    "own-data.md": ("Ready for training", "torch"),
    "read-kradar.md": ("os2-64", "embreex"),
    "train-far.md": ("250", "torch", "embreex"),
}
"""By page: words that its commands print, and the modules that it needs."""


def follow(page: Path, folder: Path, *, python: str, path: str = "") -> list[str]:
    """Run a page's blocks in a folder; what each printed.

    Args:
        page: The page.
        folder: Where to; it is empty.
        python: The interpreter whose Farfield is tried.
        path: ``PYTHONPATH``; none for what is installed.
    """
    shim = folder / ".bin" / "farfield"
    shim.parent.mkdir()
    shim.write_text(f'#!/bin/sh\nexec "{python}" -m farfield.cli "$@"\n')
    shim.chmod(0o755)
    environment = {**os.environ, "PATH": f"{shim.parent}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": path}
    told = []
    for language, block in BLOCK.findall(page.read_text("utf-8")):
        words = ["bash", "-euo", "pipefail", "-c", block] if language == "bash" else [python, "-c", block]
        done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{page.name}:\n{block}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        assert "Traceback" not in done.stderr
        told.append(done.stdout)
    return told


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_page_of_a_task_runs_as_it_stands(tmp_path: Path, name: str) -> None:
    for module in PAGES[name][1:]:
        pytest.importorskip(module)
    told = "\n".join(follow(ROOT / "docs" / name, tmp_path, python=sys.executable, path=str(ROOT / "src")))
    assert {"score-boxes.md": "DDS", "own-data.md": "Ready for training", "read-kradar.md": "os2-64"}.get(
        name, "250"
    ) in told


def test_the_page_of_own_data_lists_every_column_and_key() -> None:
    from farfield.datasets.folder import _BoxEntry

    text = (ROOT / "docs" / "own-data.md").read_text("utf-8")
    first = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    columns = set(re.findall(r"`(\w+)`", " ".join(first)))
    assert set(COLUMNS) == columns & set(COLUMNS)
    assert all(f"`{key}`" in text for key in _BoxEntry.model_fields)
    assert TABLE_NAME in text


def test_pages_say_when_boxes_are_annotated_in_the_field_s_words() -> None:
    pages = {path.name: " ".join(path.read_text("utf-8").split()) for path in (ROOT / "docs").glob("*.md")}
    assert not [name for name, text in pages.items() if re.search(r"\bsits? off\b|belong to the Gaussian clock", text)]
    assert "annotated at the Gaussian sweep's time" in pages["cirrus.md"]


def test_an_example_is_sound_and_nothing_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from farfield.cli import main

    assert main(["new-dataset", str(tmp_path / "a")]) == 0
    assert main(["doctor", str(tmp_path / "a"), "--workers", "1"]) == 0
    assert main(["new-dataset", str(tmp_path / "b")]) == 0
    assert (tmp_path / "a" / "0003.npy").read_bytes() == (tmp_path / "b" / "0003.npy").read_bytes()
    assert main(["new-dataset", str(tmp_path / "a")]) == 1
    assert "nothing is written over" in capsys.readouterr().err
