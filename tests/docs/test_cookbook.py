"""The recipes of docs/cookbook.md run as they stand, and so does the Python of the pages that start from other kits."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import page_blocks
import pytest

from farfield.experiments.schema import load_experiment

ROOT = Path(__file__).resolve().parents[2]
COOKBOOK = (ROOT / "docs" / "cookbook.md").read_text("utf-8")
RECIPES = re.findall(r"^## (\d+)\. ([^\n]+)\n(.*?)(?=^## |\Z)", COOKBOOK, flags=re.MULTILINE | re.DOTALL)
HEAVY = {"*detect*": "torch", "*simulate*": "embreex"}
WRITTEN = {
    "1": ["doctor.json"],
    "9": ["frame.png"],
    "10": ["sweeps.html"],
    "11": ["scores.json"],
    "12": ["dds.json", "nuscenes.json"],
    "16": ["my-sweeps/mapping.yaml"],
    "17": ["data/kitti/training/label_2/000000.txt", "data/labels"],
    "18": ["tracks.csv"],
    "19": ["boxes.csv", "frame.csv"],
    "20": ["corner/report.html"],
    "21": ["runs/sleet/weights.safetensors", "sleet.csv"],
}


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder from which all recipes start."""
    folder = tmp_path_factory.mktemp("cookbook") / "my-sweeps"
    assert page_blocks.main(["new-dataset", str(folder)]) == 0
    return folder


@pytest.fixture
def kitchen(sweeps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working folder with a copy of the sweeps; what a recipe registers is forgotten."""
    from farfield.metrics import PROTOCOLS

    shutil.copytree(sweeps, tmp_path / "my-sweeps")
    monkeypatch.chdir(tmp_path)
    before = dict(PROTOCOLS._registered)
    yield tmp_path
    PROTOCOLS._registered.clear()
    PROTOCOLS._registered.update(before)


def _recipe(number: str, title: str, text: str) -> object:
    marks = [pytest.mark.slow] if any(mark in title for mark in HEAVY) else []
    return pytest.param(number, title, text, id=number, marks=marks)


def test_recipes_are_numbered() -> None:
    assert [int(number) for number, *_ in RECIPES] == list(range(1, 22))
    (first,) = page_blocks.blocks_of(COOKBOOK.partition("\n## ")[0])
    assert first == ("bash", "farfield new-dataset my-sweeps\n")


@pytest.mark.parametrize(("number", "title", "text"), [_recipe(*recipe) for recipe in RECIPES])
def test_a_recipe_runs(kitchen: Path, number: str, title: str, text: str) -> None:
    for mark, module in HEAVY.items():
        if mark in title:
            pytest.importorskip(module)
    blocks = page_blocks.blocks_of(text)
    assert blocks
    for language, code in blocks:
        page_blocks.run_block(language, code, f"cookbook.md, {number}")
    assert [name for name in WRITTEN.get(number, []) if not (kitchen / name).exists()] == []


PEERS = {
    "from-openpcdet.md": [["convert", "my-sweeps", "data/custom", "--to", "openpcdet"]],
    "from-mmdetection3d.md": [["convert", "my-sweeps", "data/custom", "--to", "openpcdet"]],
    "from-nuscenes-devkit.md": [["convert", "my-sweeps", "nuscenes", "--to", "nuscenes"]],
    "from-kradar-kit.md": [
        ["simulate", "kradar-sim-mini", "data/mini", "--frames", "2", "--sensors", "os2-64,sparse", "--workers", "1"]
    ],
}
"""By page: what makes the data that its Python reads."""


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[pytest.mark.slow] if "kradar" in page else []) for page in PEERS]
)
def test_the_python_of_a_page_for_those_who_come_runs(
    kitchen: Path, page: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if "kradar" in page:
        pytest.importorskip("embreex")
    for words in PEERS[page]:
        assert page_blocks.main(words) == 0
    blocks = page_blocks.blocks_of((ROOT / "docs" / page).read_text("utf-8"), "python")
    assert blocks
    for language, code in blocks:
        page_blocks.run_block(language, code, page)
    shown = capsys.readouterr().out
    assert "kradar" not in page or "power" in shown
    assert "nuscenes" not in page or "45" in shown


def test_the_rows_of_other_kits_become_our_boxes(kitchen: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same car in OpenPCDet's and mmdetection3d's rows is our first annotated box: a score of 1 within 35 m."""
    assert page_blocks.main(["convert", "my-sweeps", "data/custom", "--to", "openpcdet"]) == 0
    for page in ("from-openpcdet.md", "from-mmdetection3d.md"):
        capsys.readouterr()
        ((_, code),) = page_blocks.blocks_of((ROOT / "docs" / page).read_text("utf-8"), "python")
        page_blocks.run_block("python", code, page)
        near = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("0-35"))
        assert near.split()[-3:] == ["1.0000", "1.0000", "1.0000"], near


def test_the_tutorial_s_experiment_is_one(kitchen: Path) -> None:
    pytest.importorskip("torch")
    ((_, text),) = page_blocks.blocks_of((ROOT / "docs" / "tutorial.md").read_text("utf-8"), "yaml")
    Path("street.yaml").write_text(text)
    settings = load_experiment("street.yaml")
    assert settings.name == "street"
    assert settings.training.start.weights == "pointpillars-cirrus-sim"
    assert settings.data["streets"].donors.copies == 20
