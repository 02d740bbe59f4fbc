"""Real frames of two radars in one form: a network starts on one, goes on to the other, is interrupted and resumes.

Nine turns and ten frames say nothing of accuracy: what is held is that they load, train and go on.
"""

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from farfield.datasets import Dataset, open_dataset
from farfield.datasets.maps import CommonRadar
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights
from farfield.evaluation import detect
from farfield.experiments.plan import Plan
from farfield.experiments.schema import experiment_of
from farfield.training.method import LABELLED
from farfield.training.report import TrainingReport

FORMS = {
    "radiate": {
        "column": "strength",
        "unit": "db",
        "db_per_one": 127.5,
        "doppler": False,
        "height": False,
        "cell_m": 0.4,
    },
    "astyx": {"column": "magnitude_db", "unit": "db"},
    "view_of_delft": {"column": "rcs_dbsm", "unit": "db"},
}
STEPS = 50
GRID = {"range_m": 64.0, "half_width_m": 16.0, "z_min_m": -6.0, "z_max_m": 8.0, "cell_m": [0.8, 0.8, 14.0]}


class StoppedError(Exception):
    """What ends a training in the middle."""


class Stops(TrainingReport):
    """Ends the training after some steps, and hears what it says."""

    def __init__(self, after: int) -> None:
        self.after, self.begun_at, self.said = after, -1, list[str]()

    def say(self, text: str) -> None:
        self.said.append(text)

    def on_train_start(self, step: int, steps: int) -> None:
        self.begun_at = step

    def step(self, step: int, losses: dict[str, float]) -> None:
        if step == self.after:
            raise StoppedError


def seen(root: Path, name: str) -> Dataset:
    options = {"radar_share": 0.05} if name == "radiate" else {}
    data = open_dataset(root / name, **options)
    form = CommonRadar(floor_db=(0.0,), **FORMS[name]).fitted(data[index] for index in range(len(data)))
    return data.mapped(form)


def plan(data: Dataset, folder: Path, **start) -> Plan:
    tree = {
        "name": folder.name,
        "data": {"path": "given", "clouds": ["radar"]},
        "detector": {
            "name": "rtn",
            "grid": {
                "range_m": 64.0,
                "half_width_m": 16.0,
                "z_min_m": -6.0,
                "z_max_m": 8.0,
                "cell_m": [0.8, 0.8, 14.0],
            },
            "planes": 8,
            "depths": [1, 1],
            "strides": [2, 2],
            "neck_width": 16,
            "use_doppler": True,
            "use_flags": True,
            "proposals": "anchors",
        },
        "training": {
            "steps": STEPS,
            "batch_size": 1,
            "min_points": 0,
            "precision": "fp32",
            "threads": 1,
            "workers": 0,
            "checkpoint_every_s": 0.001,
            "unannotated": "skip",
            **({"start": start} if start else {}),
        },
    }
    return Plan(experiment_of(tree), folder, data={LABELLED: data})


@pytest.mark.slow
def test_two_real_radars_one_after_the_other(shared_real: Path, tmp_path: Path) -> None:
    turns, frames = seen(shared_real, "radiate"), seen(shared_real, "astyx")
    assert (len(turns), len(frames)) == (9, 10)
    flags = [data[0].cloud("radar").extra for data in (turns, frames)]
    assert [float(each["has_doppler"][0]) for each in flags] == [0.0, 1.0]
    assert [float(each["has_height"][0]) for each in flags] == [0.0, 1.0]
    for each in flags:
        assert -1.0 <= each["power"].min() < each["power"].max() <= 4.0
    first = plan(turns, tmp_path / "turns").run()
    start = {"weights": str(tmp_path / "turns"), "freeze": {"trunk": 0.5}, "statistics": {"reestimate_batches": 5}}
    again = {"rates": {"trunk": 0.3}, **start}
    stops = Stops(30)
    with pytest.raises(StoppedError):
        plan(frames, tmp_path / "frames", **again).run(stops)
    assert any("100.0 % of the parameters" in line for line in stops.said)
    goes_on = Stops(-1)
    weights = plan(frames, tmp_path / "frames", **again).run(goes_on)
    assert 0 < goes_on.begun_at <= 30
    whole = plan(frames, tmp_path / "whole", **again).run()
    one, other = (load_weights(path)[0].state_dict() for path in (weights, whole))
    assert all(torch.equal(value, other[name]) for name, value in one.items())
    theirs = load_weights(first)[0].state_dict()
    assert not all(torch.equal(value, theirs[name]) for name, value in one.items())
    losses = [json.loads(line)["loss"] for line in (tmp_path / "whole" / "log.jsonl").read_text().splitlines()]
    assert len(losses) == STEPS
    assert np.mean(losses[-10:]) < np.mean(losses[:10])
    found = detect(Detector.load(weights), frames, cloud="radar", annotated_only=True)
    assert set(found.annotations) == set(frames.keys)
    two = seen(shared_real, "view_of_delft")
    assert [float(two[0].cloud("radar").extra[name][0]) for name in ("has_doppler", "has_height")] == [1.0, 1.0]
    assert set(detect(Detector.load(weights), two, cloud="radar", annotated_only=True).annotations) == set(two.keys)
