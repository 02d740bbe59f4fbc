"""docs/validation.md names tests that exist, covers all twelve, and its benchmark's last output has no failure."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "validation.md"
RESULTS = ROOT / "benchmarks" / "results" / "validation.txt"
NAMED = sorted(set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PAGE.read_text(encoding="utf-8"))))


@pytest.mark.parametrize(("path", "name"), NAMED, ids=[name for _, name in NAMED])
def test_a_named_test_exists(path: str, name: str) -> None:
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert name.startswith("test_")
    assert name in functions


def test_every_number_has_rows_with_tests_and_results() -> None:
    rows = re.findall(r"^\| (\d+) \|.*\| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    tested = {int(number) for number, tests in rows if "::test_" in tests}
    computed = {int(number) for number in re.findall(r"^ ?(\d+)  pass ", RESULTS.read_text(), re.MULTILINE)}
    assert tested == computed == set(range(1, 13))
    assert " 0 fail" in RESULTS.read_text()
    assert "FAIL" not in RESULTS.read_text()
