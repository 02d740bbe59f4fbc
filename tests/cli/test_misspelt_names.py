"""A misspelt name is answered with the one that was meant, and before anything else is complained of."""

from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "drive").mkdir()
    np.save(tmp_path / "drive" / "0.npy", np.random.default_rng(0).uniform(1, 50, (500, 4)) * [1, 1, 0.05, 0.02])
    (tmp_path / "own.yaml").write_text("data: {path: drive}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["predict", "pointpilars-roads", "driv"], "pointpillars-roads"),
        (["evaluate", "pointpilars-roads", "driv"], "pointpillars-roads"),
        (["predict", "pointpillars-roads", "driv"], "drive"),
        (["stats", "driv"], "drive"),
        (["stats", "open-sweps"], "open-sweeps"),
        (["evaluate", "pointpillars-roads", "open-sweeps", "--split", "aveneu"], "avenue"),
        (["evaluate", "pointpillars-roads", "open-sweeps", "--protocol", "nuscene"], "nuscenes"),
        (["train", "own.yml"], "own.yaml"),
        (["convert", "drive", "out", "--to", "kiti"], "kitti"),
    ],
)
def test_the_name_that_was_meant_is_named(
    words: list[str], meant: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if words[0] in {"predict", "evaluate", "train"}:
        pytest.importorskip("torch")
    assert main(words) in (1, 2)
    shown = capsys.readouterr().err
    assert f"Did you mean {meant}?" in shown
    assert len(shown.splitlines()) <= 4, shown


def test_the_sweeps_that_ship_are_predicted_by_their_name(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    assert main(["predict", "pointpillars-roads", "open-sweeps", "--dry-run"]) == 0
    assert "would write the boxes of 12 frames" in capsys.readouterr().out


def test_labels_beside_a_folder_of_clouds_are_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "labels.csv").write_text("frame,label\n")
    assert main(["stats", str(folder)]) == 1
    shown = capsys.readouterr().err
    assert "there is drive (folder): open that, with labels.csv moved into it" in shown
    assert "own.yaml" not in shown.partition("One folder deeper")[2]
    assert len(shown.splitlines()) == 1


def test_a_part_of_a_data_set_is_predicted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    assert main(["predict", "pointpillars-roads", "open-sweeps", "--split", "corner", "--dry-run"]) == 0
    assert "would write the boxes of 8 frames" in capsys.readouterr().out
