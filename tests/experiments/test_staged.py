"""A training in stages goes on with the settings that it was begun with, and no others."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from farfield.datasets import Dataset
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError, DatasetError
from farfield.experiments import staged
from farfield.experiments.calibrating import CalibrationSummary, calibrate_scores
from farfield.experiments.catalogue import find
from farfield.experiments.schema import Experiment, load_experiment
from farfield.experiments.staged import DONE, FIRST, StagedTraining, train_in_stages
from farfield.training.report import TrainingReport


@pytest.fixture
def experiment(tmp_path: Path) -> Experiment:
    """One whose data are not there: it ends when the first stage opens them."""
    tree = load_experiment(find("pointpillars-cirrus-sim")).model_dump(mode="json")
    data = {"path": str(tmp_path / "data"), "clouds": ["gaussian"]}
    tree |= {"data": {"cirrus": data}, "method": {"name": "mixed", "shares": {"cirrus": 1}}}
    return Experiment.model_validate(tree)


def changed(experiment: Experiment, steps: int) -> Experiment:
    return experiment.model_copy(update={"training": experiment.training.model_copy(update={"steps": steps})})


def test_stages_of_other_settings_are_refused(experiment: Experiment, tmp_path: Path) -> None:
    folder, stages = tmp_path / "run", StagedTraining(held_frames=2)
    begun = changed(experiment, 40)
    with pytest.raises(DatasetError, match="found no folder there"):
        train_in_stages(begun, folder, stages)
    with pytest.raises(ConfigError, match=r"run: .*other settings: experiment\.training\.steps was 40, is 400"):
        train_in_stages(changed(experiment, 400), folder, stages)
    with pytest.raises(ConfigError, match=r"other settings: stages\.held_frames was 2, is 3\. "):
        train_in_stages(begun, folder, replace(stages, held_frames=3))
    with pytest.raises(DatasetError, match="found no folder there"):  # it goes on
        train_in_stages(begun, folder, stages)
    (folder / DONE).write_text("done")
    assert train_in_stages(begun, folder, stages).parent.parent == folder
    with pytest.raises(ConfigError, match=r"experiment\.training\.steps was 40, is 400"):
        train_in_stages(changed(experiment, 400), folder, stages)


@pytest.mark.parametrize("name", [FIRST, DONE])
def test_stages_of_unknown_settings_are_refused(name: str, experiment: Experiment, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / name).touch()
    with pytest.raises(ConfigError, match=f"run: expected .*settings.json, found {name} without"):
        train_in_stages(experiment, tmp_path / "run")


SMALL = {
    "name": "pointpillars",
    "grid": {"range_m": 64.0, "half_width_m": 16.0, "cell_m": 0.5},
    "pillar_channels": 8,
    "widths": (8, 8, 8),
    "depths": (0, 0, 0),
    "neck_width": 8,
    "anchors": {"car": {"size_m": (4.6, 1.95, 1.7), "z_m": -1.15}},
    "score_threshold": 0.001,
}


def recorded(labels: set[str], weights: Path, sources: Sequence[tuple[Dataset, str]]) -> CalibrationSummary:
    labels.update(str(name) for data, _ in sources for frame in data for name in frame.boxes.label)
    return calibrate_scores(weights, sources)


def test_all_stages_end_in_calibrated_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Learn, mine, learn on with other batches, calibrate on frames of neither; classes by the stream's aliases."""
    pytest.importorskip("embreex")
    simulated = {"preset": "cirrus-sim-mini", "sequences": 2, "frames": 3, "sensors": "gaussian"}
    data = {"path": str(tmp_path / "data"), "clouds": ["gaussian"], "aliases": {"vehicle": "car"}}
    tree = {
        "name": "tiny",
        "data": {"cirrus": data | {"simulate": simulated}},
        "method": {"name": "mixed", "shares": {"cirrus": 1}},
        "detector": SMALL,
        "training": {"steps": 4, "batch_size": 1, "precision": "fp32"},
    }
    reports: list[str] = []
    report = TrainingReport()
    report.say = reports.append
    labels = set[str]()
    monkeypatch.setattr(staged, "calibrate_scores", partial(recorded, labels))
    stages = StagedTraining(held_frames=1, mined_frames=2, least_score=0.0)
    weights = train_in_stages(Experiment.model_validate(tree), tmp_path / "run", stages, report)
    provenance = load_weights(weights)[1]
    assert load_weights(weights)[0].config.score_bands is not None
    seeds = [
        load_weights(folder / "weights.safetensors")[1]["experiment"]["training"]["seed"]
        for folder in (tmp_path / "run" / FIRST, weights.parent)
    ]
    assert seeds[0] != seeds[1]
    assert provenance["calibration"]["boxes"] > 0
    assert "car" in labels
    assert "vehicle" not in labels
    assert train_in_stages(Experiment.model_validate(tree), tmp_path / "run", stages, report) == weights
    assert "done before" in reports[-1]
