"""``farfield experiments``, and training by a shipped experiment's name."""

from pathlib import Path

import pytest
import yaml

from farfield.cli import main
from farfield.experiments.catalogue import shipped


def test_the_table_names_all_experiments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiments"]) == 0
    said = capsys.readouterr().out
    for entry in shipped():
        (line,) = (line for line in said.splitlines() if line.startswith(f"{entry.name} "))
        assert entry.detector in line
        assert f"{entry.steps:,}" in line
        assert entry.title in line


def test_an_experiment_is_printed_as_its_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["experiments", "rtnh_kradar"]) == 0
    said = capsys.readouterr().out
    assert yaml.safe_load(said)["name"] == "rtnh-kradar"
    assert said.splitlines()[0] == "# RTNH as published with K-Radar (cfg_RTNH.yml, benchmark v1.0)."


def test_an_unknown_experiment_exits_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiments", "rtnh-kradr"]) == 1
    assert "Did you mean rtnh-kradar" in capsys.readouterr().err


def test_a_shipped_experiment_trains_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No clone, no file: the data are simulated below the current folder, and a run is left there."""
    pytest.importorskip("torch")
    pytest.importorskip("embreex")
    monkeypatch.chdir(tmp_path)
    small = {
        "data.path": "data/mini",
        "data.simulate": "{preset: cirrus-sim-mini, sequences: 1, frames: 2}",
        "detector.grid": "{range_m: 64.0, half_width_m: 20.0, cell_m: 1.0}",
        "detector.widths": "[8, 8, 8]",
        "detector.neck_width": "16",
        "training.steps": "1",
        "training.batch_size": "1",
    }
    words = [word for key, value in small.items() for word in ("-o", f"{key}={value}")]
    assert main(["train", "pointpillars_cirrus_sim", *words]) == 0
    assert (tmp_path / "runs" / "pointpillars-cirrus-sim" / "weights.safetensors").is_file()
    assert (tmp_path / "data" / "mini" / "simulation.json").is_file()
    assert "preset cirrus-sim-mini, seed 0: 2 frames" in capsys.readouterr().err


def test_data_that_are_absent_are_named_with_the_way_to_set_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    assert main(["train", "second-kitti"]) == 1
    assert "farfield train second-kitti -o data.path=FOLDER" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
