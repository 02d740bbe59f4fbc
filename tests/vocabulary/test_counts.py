"""Numbers of things in words."""

import re
from pathlib import Path

import numpy as np
import pytest

from farfield.vocabulary.counts import count_of

SOURCES = Path(__file__).resolve().parents[2] / "src" / "farfield"


@pytest.mark.parametrize(
    ("words", "count", "one", "more", "spec"),
    [
        ("0 frames", 0, "frame", "", ""),
        ("1 frame", 1, "frame", "", ""),
        ("2 boxes", 2, "box", "", ""),
        ("1 match", np.int64(1), "match", "", ""),
        ("3 classes", np.int32(3), "class", "", ""),
        ("1 frame is", 1, "frame is", "frames are", ""),
        ("2,000 frames are", 2000, "frame is", "frames are", ","),
    ],
)
def test_a_single_thing_has_its_own_word(words: str, count: int, one: str, more: str, spec: str) -> None:
    assert count_of(count, one, more, spec=spec) == words


def test_no_message_writes_an_s_by_itself() -> None:
    by_hand = re.compile(r"""'e?s' if [^{}]{1,40} [!>=]+ 1 else ''|'' if [^{}]{1,40} == 1 else 'e?s'""")
    files = [*SOURCES.rglob("*.py"), *SOURCES.rglob("*.html")]
    rows = [f"{path.name}: {match[0]}" for path in files for match in by_hand.finditer(path.read_text())]
    assert rows == [], "use count_of"
