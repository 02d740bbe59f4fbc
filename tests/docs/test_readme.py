"""What README and docs show is run, and is true."""

import ast
import math
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

import farfield as ff
from farfield.cli import VERBS
from farfield.cli._completion import flags_of

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/*.md")), ROOT / "examples" / "README.md"]
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


def test_readme_is_short() -> None:
    assert len(README.splitlines()) < 150


@pytest.fixture
def registered_here() -> Iterator[None]:
    """Forget afterwards what a page registers."""
    from farfield.datasets import DATASETS
    from farfield.detectors import DETECTORS
    from farfield.metrics import PROTOCOLS

    registries = [DATASETS, DETECTORS, PROTOCOLS, import_module("farfield.training.method").METHODS]
    before = [dict(registry._registered) for registry in registries]
    yield
    for registry, names in zip(registries, before, strict=True):
        registry._registered.clear()
        registry._registered.update(names)


def _run(page: str, *, given: dict[str, object] | None = None, blocks: slice = slice(None)) -> dict[str, object]:
    """Run the blocks of a page, one after the other, and give the names that they define."""
    module = sys.modules["page"] = ModuleType("page")  # so that what it defines can be pickled
    names = module.__dict__
    names.update(given or {})
    for block in _blocks((ROOT / "docs" / page).read_text(encoding="utf-8"), "python")[blocks]:
        exec(compile(block, page, "exec"), names)
    return names


def test_contracts_run_from_top_to_bottom(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, registered_here: None
) -> None:
    pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    names = _run("contracts.md")
    assert names["result"].to_json()["dds"]["0"]["dds"] == 1.0
    assert names["behind"].recipe["maps"][0]["name"] == "move"
    assert len(names["boxes"]) == 2
    assert names["METHODS"].origin("self-training") == "registered here"
    assert not (tmp_path / "runs").exists()
    assert names["near"].figures == {"recall": 1.0}
    # the experiment of the page trains its reader, detector and method
    (experiment,) = _blocks((ROOT / "docs" / "contracts.md").read_text(encoding="utf-8"), "yaml")
    Path("mine.yaml").write_text(experiment)
    names["Plan"](names["load_experiment"]("mine.yaml"), Path("runs/mine")).run()
    assert "vehicle" in ff.load_detector("runs/mine").info.classes


def test_conventions_run() -> None:
    pytest.importorskip("embreex")
    names = _run("conventions.md")
    assert len(names["both"]) == sum(len(names["frame"].cloud(name)) for name in ("gaussian", "uniform"))
    assert names["back"].reference == names["frame"].reference + "'"


def test_the_detector_and_the_protocol_of_the_pages_run(registered_here: None) -> None:
    pytest.importorskip("torch")
    from farfield.detectors import DETECTORS
    from farfield.testing import check_protocol

    _run("detectors.md", blocks=slice(1, 2))
    assert DETECTORS["wide-pillars"].config_class().name == "wide-pillars"
    _run("metrics.md", blocks=slice(1, 2))
    check_protocol("recall")


def _has(module: str, name: str) -> bool:
    """Whether ``from module import name`` works, of a part that nothing has imported yet too."""
    return hasattr(import_module(module), name) or find_spec(f"{module}.{name}") is not None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_pages_import_exists(page: Path) -> None:
    pytest.importorskip("torch")
    for block in _blocks(page.read_text(encoding="utf-8"), "python"):
        tree = ast.parse(block)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("farfield."):
                assert not [alias.name for alias in node.names if not _has(node.module, alias.name)], block
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "ff":
                assert hasattr(import_module("farfield"), node.attr), f"ff.{node.attr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_paths_of_pages_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    commands = "\n".join(_blocks(text, "bash")) + "\n" + "\n".join(re.findall(r"`(farfield [^`]+)`", text))
    for verb, rest in re.findall(r"\bfarfield ([a-z][a-z-]+)\b([^\n#|>]*)", commands):
        assert verb in VERBS, f"farfield {verb}"
        flags = re.findall(r"--[a-z][a-z-]+", rest)
        assert set(flags) <= set(flags_of(verb)), f"farfield {verb}{rest}"
    named = re.findall(r"`((?:benchmarks|docs|examples|src|tests)/[\w./-]+\.\w+)", text)
    named += [f"benchmarks/results/{name}" for name in re.findall(r"`(\w+\.txt)`", text) if "_" in name]
    assert not [name for name in named if not (ROOT / name).exists()]


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
    from farfield.datasets.cirrus.layout import Mapping, read_mapping

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
