"""docs/formats.md says what the code registers."""

import sys
from pathlib import Path

import pytest

from farfield.datasets import DATASETS

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_formats_is_the_registries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    formats = __import__("formats")
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    assert formats.page() == text, "run: python tools/formats.py --write"
    assert all(f"### {name}\n" in text for name in DATASETS.builtin)
    sys.modules.pop("formats")
