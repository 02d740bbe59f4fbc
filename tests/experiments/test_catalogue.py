"""The experiments that ship: names, files, and that each is valid."""

from pathlib import Path

import pytest

from farfield.errors import ConfigError
from farfield.experiments.catalogue import find, names, shipped

ENTRIES = shipped()


def test_names_are_those_of_the_files() -> None:
    assert len(names()) == len(set(names())) == len(ENTRIES) >= 24
    assert all(entry.name.replace("-", "_") == entry.path.stem for entry in ENTRIES)
    assert {"pointpillars-cirrus-sim", "rtnh-kradar"} <= set(names())


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_every_shipped_experiment_is_valid_and_listed_as_it_is(entry) -> None:
    pytest.importorskip("torch")
    from farfield.experiments.schema import load_experiment
    from farfield.simulation import find_preset

    experiment = load_experiment(entry.path)
    listed = entry.name, entry.detector, Path(entry.data), entry.steps
    assert listed == (experiment.name, experiment.detector.name, experiment.data.path, experiment.training.steps)
    assert not experiment.data.path.is_absolute()
    simulate = experiment.data.simulate
    assert entry.simulated == (simulate.preset if simulate else "")
    if simulate:
        assert find_preset(simulate.preset).name == simulate.preset
    else:
        assert f"farfield train {entry.name} -o data.path=" in entry.path.read_text(encoding="utf-8")
    assert entry.title.endswith(".")
    assert 20 < len(entry.title) < 90


@pytest.mark.parametrize(
    "name",
    [
        "pointpillars-cirrus-sim",
        "pointpillars_cirrus_sim",
        "pointpillars_cirrus_sim.yaml",
        "pointpillars-cirrus-sim.yaml",
        Path("pointpillars-cirrus_sim"),
    ],
)
def test_an_experiment_is_found_by_its_name(name: str | Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pointpillars-cirrus-sim").mkdir()  # a run's folder is no experiment
    assert find(name).read_text(encoding="utf-8").splitlines()[3] == "name: pointpillars-cirrus-sim"


def test_a_file_wins_over_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "second_kitti.yaml").write_text("name: mine")
    assert find("second_kitti.yaml") == Path("second_kitti.yaml")
    assert find("second_kitti") != Path("second_kitti.yaml")
    assert find(tmp_path / "second_kitti.yaml").is_file()


@pytest.mark.parametrize("wrong", ["pointpilars-cirrus-sim", "experiments/pointpillars_cirrus_sim.yaml"])
def test_what_is_not_there_is_an_error_that_names_close_ones(wrong: str) -> None:
    with pytest.raises(ConfigError, match=r"Did you mean pointpillars-cirrus-sim .*farfield experiments lists"):
        find(wrong)
    with pytest.raises(ConfigError, match="found nothing"):
        find("")
