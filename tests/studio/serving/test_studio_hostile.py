"""Hostile clients: random and malformed messages of five windows at once beside a person who annotates."""

from pathlib import Path

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from _studio_hostile import run_hostile


@pytest.mark.slow
def test_nothing_foreign_nothing_stuck_and_no_wrong_edit(tmp_path: Path) -> None:
    run = run_hostile(tmp_path, messages=600, seed=7, seconds=60)
    assert run.faults == []
    assert run.messages == 600
    assert run.edits > 30
