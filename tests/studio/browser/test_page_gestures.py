"""Random gestures in two windows over a bad link: what is stored is what was shown, and nothing is stuck."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
from _studio_random_hands import run_gestures


@pytest.mark.first
@pytest.mark.slow
def test_what_is_stored_is_what_was_shown(chromium: Any, tmp_path: Path) -> None:
    run = run_gestures(chromium, tmp_path, gestures=500, seed=1, episode=50, rest_ms=40)
    assert run.faults == []
    assert run.gestures == 500
    assert run.edits > 40
    assert run.keys > 20
