"""What README and docs show is run, and is true."""

import math
import re
from pathlib import Path

import pytest

from farfield.cli import VERBS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
IMAGE_LIMIT = 500_000


def _blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def test_readme_python_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("embreex")
    (block,) = _blocks(README, "python")
    assert len([line for line in block.splitlines() if line.strip()]) <= 10
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {})
    shown = capsys.readouterr().out
    assert "Boxes(" in shown
    assert "wDDS" in shown
    assert (tmp_path / "frame.png").stat().st_size > 10_000


def test_readme_commands_exist() -> None:
    named = re.findall(r"`farfield ([\w-]+)", README)
    assert set(named) == set(VERBS)
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert {name for block in _blocks(README, "bash") for name in re.findall(r"^make (\S+)", block, re.M)} <= set(
        targets
    )


def test_pictures_are_there_and_small() -> None:
    shown = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", README)
    assert shown
    for name in shown:
        assert 10_000 < (ROOT / name).stat().st_size < IMAGE_LIMIT, name


def test_mapping_defaults_in_the_docs_are_the_defaults(tmp_path: Path) -> None:
    from farfield.datasets.cirrus.mapping import Mapping, read_mapping

    (block,) = _blocks((ROOT / "docs" / "cirrus.md").read_text(encoding="utf-8"), "yaml")
    (tmp_path / "mapping.yaml").write_text(block)
    written, default = read_mapping(tmp_path / "mapping.yaml").model_dump(), Mapping().model_dump()
    assert written.pop("layout") is not None
    default.pop("layout")
    assert written == default


def test_metric_table_in_the_docs_is_right() -> None:
    text = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    lines = re.findall(r"^\| (0(?:\.\d+)?) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", text, flags=re.MULTILINE)
    assert len(lines) == 4
    for epsilon, *factors in lines:
        wanted = [math.exp(float(epsilon) * range_m) for range_m in (70, 150, 250)]
        assert [float(factor) for factor in factors] == [round(value, 2) for value in wanted]


def test_every_metric_option_in_the_docs_exists() -> None:
    from dataclasses import fields

    from farfield.metrics.centre.dds import DdsSettings

    text = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    table = "\n".join(line for line in text.splitlines() if re.match(r"\| +\d+ \|", line))
    named = set(re.findall(r"`(\w+)(?:=[^`]*)?`", table))
    known = {field.name for field in fields(DdsSettings)}
    values = {"vehicle", "large_vehicle", "trailer"}
    assert {name for name in named if name in known} >= {"distance", "omega_range", "match", "ap", "aiou", "relabel"}
    assert named <= known | values
    for name, value in re.findall(r"`(\w+)=\"(\w+)\"`", table):
        DdsSettings(**{name: value})
