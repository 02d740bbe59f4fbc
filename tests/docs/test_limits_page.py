"""docs/limits.md says the limits that the code keeps."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_limits_is_the_constants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    limits = __import__("limits")
    assert limits.page() == (ROOT / "docs" / "limits.md").read_text(encoding="utf-8"), (
        "run: python tools/limits.py --write"
    )
    sys.modules.pop("limits")
