"""docs/flags.md says what the parsers of the verbs say."""

import sys
from pathlib import Path

import pytest

from farfield.cli import VERBS
from farfield.cli._completion import flags_of

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_flags_is_the_parsers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    flags = __import__("flags")
    text = (ROOT / "docs" / "flags.md").read_text(encoding="utf-8")
    assert flags.page() == text, "run: python tools/flags.py --write"
    for verb in VERBS:
        section = text.partition(f"## farfield {verb}\n")[2].partition("\n## ")[0]
        assert all(f"`{flag}`" in section for flag in set(flags_of(verb)) - {"--help", "--help-all", "--verbose"})
    sys.modules.pop("flags")
