"""The table of docs/sizing.md is what its sums give, and what the plan gives for the same inputs."""

import ast
import operator
import re
from pathlib import Path

import pytest

from farfield.sizing import DATASET_SIZES

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "sizing.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "benchmarks" / "results" / "sizing.txt").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.partition("| what | sum | result |")[2].partition("\n\n")[0].splitlines()[2:]
]
OPERATORS = {ast.Mult: operator.mul, ast.Div: operator.truediv}


def worked_out(node: ast.AST) -> float:
    if isinstance(node, ast.BinOp):
        return float(OPERATORS[type(node.op)](worked_out(node.left), worked_out(node.right)))
    assert isinstance(node, ast.Constant)
    return float(node.value)


def test_the_table_has_all_that_was_worked_out_twice() -> None:
    printed = re.findall(r"^.{46} *([\d,.]+) +([\d,.]+)$", RESULTS, flags=re.MULTILINE)
    assert len(printed) >= len(ROWS) >= 11
    assert all(by_hand == planned for by_hand, planned in printed)
    assert RESULTS.partition("==== hand")[2].partition("====")[0].rstrip().endswith("equal")


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_result_is_that_of_its_sum_and_of_the_plan(row: list[str]) -> None:
    _, text, result = row
    value, figure = worked_out(ast.parse(text, mode="eval").body), result.split()[0]
    decimals = len(figure.partition(".")[2])
    assert f"{value:.{decimals}f}" == figure
    planned = [float(number.replace(",", "")) for number in re.findall(r"([\d,.]+)$", RESULTS, flags=re.MULTILINE)]
    assert any(number == pytest.approx(value, rel=1e-3) for number in planned)


def test_the_page_states_the_published_sizes_that_plans_take() -> None:
    size = DATASET_SIZES["kradar"]
    for number, stated in (
        (size.frame_bytes["tesseract"] * 1195, "360 GB of tesseracts"),
        (size.frame_bytes["cloud"] * 1195, "7 GB of os2-64"),
        (size.frame_bytes["camera"] * 1195, "4.5 GB a camera"),
        (size.packed_bytes["tesseract"] / 1e-3, "519 MB"),
        (size.frame_bytes["tesseract"] / 1e-3, "301 MB"),
        (size.whole_frame_bytes * 35_000 / 1e3, "16 TB"),
    ):
        assert stated in PAGE
        figure = stated.split()[0]
        assert f"{number / 1e9:.{len(figure.partition('.')[2])}f}" == figure
    assert f"{DATASET_SIZES['cirrus'].frames:,}" in PAGE
