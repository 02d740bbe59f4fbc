"""The record of rates: written, read back, and refused where it is anything else."""

import json
from pathlib import Path
from typing import Any

import pytest
from made_rates import machine, rate

from farfield.errors import FileFormatError
from farfield.sizing import read_rates


@pytest.fixture
def tree() -> dict[str, Any]:
    measured: dict[str, Any] = machine(rate("stats", 0.5, reads=["cloud"])).model_dump(mode="json")
    return measured


def test_rates_are_read_back_with_a_plan_or_without(tree: dict[str, Any], tmp_path: Path) -> None:
    for name, content in (("alone", tree), ("planned", {"rates": tree, "plan": {}})):
        path = tmp_path / name
        path.write_text(json.dumps(content))
        assert read_rates(path) == machine(rate("stats", 0.5, reads=["cloud"]))


def test_median_and_spread() -> None:
    measured = rate("stats", 1.0).model_copy(update={"seconds": (0.9, 1.0, 1.4)})
    assert (measured.median_s, measured.spread) == (1.0, pytest.approx(0.5))
    assert machine().bytes_in(rate("stats", 1.0, reads=["cloud", "cloud", "cells"])) == 14.3e6


@pytest.mark.parametrize(
    ("where", "value"),
    [
        ("cores", 0),
        ("farfield_rates", 2),
        ("two_at_once", 1.5),
        ("disk_read_mb_s", 0),
        ("sizes", {"waymo": {}}),
        ("sizes", {"kradar": {"cloud": -1}}),
        ("rates.0.seconds", []),
        ("rates.0.seconds", [0.0]),
        ("rates.0.seconds", [1e9]),
        ("rates.0.reads", ["everything"]),
        ("rates.0.more", 1),
    ],
)
def test_other_values_are_refused_by_where_they_stand(
    tree: dict[str, Any], tmp_path: Path, where: str, value: Any
) -> None:
    *steps, last = where.split(".")
    inner: Any = tree
    for step in steps:
        inner = inner[int(step) if step.isdigit() else step]
    inner[last] = value
    path = tmp_path / "rates.json"
    path.write_text(json.dumps(tree))
    with pytest.raises(FileFormatError, match=f"rates.json, {where}") as refused:
        read_rates(path)
    assert "farfield bench --json" in str(refused.value)


@pytest.mark.parametrize("text", ["[]", "3", '{"rates": []}', '{"rates": {}}', "no JSON", '{"cores": NaN}'])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rates.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"rates\.json"):
        read_rates(path)
