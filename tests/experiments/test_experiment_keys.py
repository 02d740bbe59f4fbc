"""The page of every key is written from the types."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")

from pydantic import BaseModel, Field

from farfield.detectors import DETECTORS

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tools"))

from experiment_keys import _rows, put_into, tables

PAGE = ROOT / "docs" / "experiments.md"


def test_the_page_is_today_s() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert put_into(page) == page, "run: python tools/experiment_keys.py docs/experiments.md"


def test_every_key_has_a_row_and_every_row_a_meaning() -> None:
    text = tables()
    from farfield.training.config import TrainingConfig

    assert all(f"| `training.{name}` |" in text for name in TrainingConfig.model_fields)
    assert all(f"where `name` is `{name}`" in text for name in DETECTORS.builtin)
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    assert not [line for line in rows if line.rsplit("|", 2)[1].strip() == ""]


def test_types_limits_and_defaults_are_said() -> None:
    class Inner(BaseModel):
        """A group within."""

        share: float = Field(0.5, gt=0, le=1, description="how much")

    class Group(BaseModel):
        needed: int = Field(description="a number")
        inner: Inner | None = None
        names: tuple[str, ...] = Field((), description="words")

    assert [*_rows(Group, "g.")] == [
        "| `g.needed` | whole number | **needed** | a number |\n",
        "| `g.inner` | group | none | a group within |\n",
        "| `g.inner.share` | number, above 0 to 1 | `0.5` | how much |\n",
        "| `g.names` | list of text | `[]` | words |\n",
    ]
