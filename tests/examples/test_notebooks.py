"""The notebooks of examples/ run from top to bottom, and each cell's last value is shown as a notebook would."""

import ast
import base64
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "examples" / "notebooks").glob("*.ipynb"))
PICTURES = {"detect_and_score": 4, "first_look": 3, "own_arrays": 5, "train_small": 2}


def cells(path: Path) -> list[str]:
    tree = json.loads(path.read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in tree["cells"] if cell["cell_type"] == "code"]


def shown(code: str, names: dict[str, Any]) -> Any:
    """Run a cell and give the value of its last line, if that is an expression."""
    tree = ast.parse(code)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)


def pictures(value: Any) -> Iterator[bytes]:
    """The pictures that a notebook draws of a value."""
    if hasattr(value, "savefig"):
        drawn = io.BytesIO()
        value.savefig(drawn, format="png")
        yield drawn.getvalue()
    elif hasattr(value, "_repr_html_"):
        for data in re.findall(r'src="data:image/png;base64,([^"]+)"', value._repr_html_()):
            yield base64.b64decode(data)


def test_there_are_four() -> None:
    assert {path.stem for path in NOTEBOOKS} == set(PICTURES)
    page = (NOTEBOOKS[0].parents[1] / "README.md").read_text(encoding="utf-8")
    assert all(f"notebooks/{path.name}" in page for path in NOTEBOOKS)


def test_no_outputs_are_kept() -> None:
    for path in NOTEBOOKS:
        tree = json.loads(path.read_text(encoding="utf-8"))
        assert not [cell for cell in tree["cells"] if cell.get("outputs") or cell.get("execution_count")], path.name


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if "farfield[detect" in path.read_text(encoding="utf-8"):
        pytest.importorskip("torch")
    if "simulate" in path.read_text(encoding="utf-8"):
        pytest.importorskip("embreex")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "notebook"}
    drawn: list[bytes] = []
    for code in cells(path):
        value = shown(code, names)
        assert "\n" not in repr(value) or isinstance(value, (list, np.ndarray))
        drawn += pictures(value)
    assert len(drawn) == PICTURES[path.stem]
    for number, data in enumerate(drawn):
        (tmp_path / f"{path.stem}-{number}.png").write_bytes(data)
        picture = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
        assert min(picture.shape[:2]) > 150
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20
