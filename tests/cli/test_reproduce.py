"""``farfield reproduce``: words and refusals; the work itself is tested beside the room that does it."""

from pathlib import Path

import pytest

pytest.importorskip("torch")

from tinygrid import RUNS, tiny_grid

from farfield.cli import main
from farfield.papers import reproducing


def test_what_cannot_be_is_refused_before_anything_is_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "cirrus", "--minutes", "0"]) == 1
    assert "--minutes: expected more than 0" in capsys.readouterr().err
    assert main(["reproduce", "kradar", "--data", "nothing"]) == 1
    assert "--data: expected a folder" in capsys.readouterr().err
    assert main(["reproduce", "velodyne"]) == 2
    assert "expected one of cirrus, kradar, got 'velodyne'" in capsys.readouterr().err
    assert not [*tmp_path.rglob("*.json")]


@pytest.mark.first
@pytest.mark.slow
def test_a_plan_says_what_it_costs_and_runs_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("embreex")
    monkeypatch.setattr(reproducing, "load_grid", _tiny)
    out = tmp_path / "out"
    for _ in range(2):  # the second reads the plan that the first left
        assert main(["reproduce", "cirrus", "--plan", "--workers", "1", "--out", str(out)]) == 0
        said = capsys.readouterr().out
        assert f"{len(RUNS)} runs x 2 seeds, {2 * len(RUNS)} trainings; steps: grid 4" in said
        assert "core minutes" in said
        assert "C4: not run at this budget" in said
    assert sorted(path.name for path in out.iterdir()) == ["measured.json", "plan.json"]


def _tiny(paper: str) -> object:
    assert paper == "cirrus"
    return tiny_grid()
