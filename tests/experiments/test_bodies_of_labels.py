"""Whole bodies or visible parts: what the labels of a few sweeps teach, beside what the source does."""

import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("embreex")

sys.path.append(str(Path(__file__).parents[1] / "detectors"))  # the small detectors of its small.py

from small import small_detector

from farfield.datasets import open_dataset
from farfield.detectors.weights import save_weights
from farfield.experiments.adapting import AdaptationOptions
from farfield.experiments.adapting.job import AdaptationJob
from farfield.jobs import JobOptions
from farfield.training.report import TrainingReport


@pytest.fixture
def small_weights(tmp_path: Path) -> Path:
    """Weights that say that they learnt from simulated Cirrus frames."""
    network = small_detector("pointpillars")
    data = {"path": "data", "clouds": ["gaussian"]}
    provenance = {"experiment": {"data": data}}
    path = tmp_path / "weights.safetensors"
    save_weights(path, network.state_dict(), config=network.config, provenance=provenance)
    return path


def test_labels_that_teach_hold_whole_bodies_too(small_weights: Path, simulated_cirrus: Path, tmp_path: Path) -> None:
    labelled = {
        whole: AdaptationJob(
            start=str(small_weights),
            labelled_source=None,
            data=open_dataset(simulated_cirrus),
            folder=tmp_path,
            choices=AdaptationOptions(whole_bodies=whole),
            bulk=JobOptions(),
            report=TrainingReport(),
            began=0.0,
            learn_from=simulated_cirrus,
        ).labelled
        for whole in (False, True)
    }
    assert [labels.extent for labels in labelled.values()] == ["visible", "full"]
    bodies = open_dataset(simulated_cirrus).annotation(0).full_boxes
    np.testing.assert_array_equal(labelled[True].boxes(0).size_m, bodies.size_m)
    assert labelled[True].contradiction(labelled[True].frames) == ""
    warning = "warning: labelled boxes hold whole bodies and those of the source the parts that the sensor sees"
    assert labelled[True].contradiction(labelled[False].frames).startswith(warning)
    warning = "warning: labelled boxes hold the parts that the sensor sees and those of the source whole bodies"
    assert labelled[False].contradiction(labelled[True].frames).startswith(warning)
