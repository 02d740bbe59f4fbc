"""Simulated frames, and a tiny run of a method on them."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

sys.path.append(str(Path(__file__).parents[1] / "detectors"))  # the small detectors of its small.py


@pytest.fixture(scope="session")
def data(simulated_cirrus: Path) -> Path:
    """Three mini frames in the Cirrus layout."""
    pytest.importorskip("torch")
    return simulated_cirrus


Planned = Callable[..., Any]


@pytest.fixture
def planned(data: Path, tmp_path: Path) -> Planned:
    """Plan a run of a method: its folder's name, the method's settings, the detector and settings of the training."""
    from small import SMALL

    from farfield.experiments.plan import Plan
    from farfield.experiments.schema import Experiment

    def make(
        folder: str, method: dict[str, Any], detector: str = "pointpillars", streams: Any = None, **training: Any
    ) -> Plan:
        loop = {"steps": 3, "batch_size": 2, "precision": "fp32", "threads": 1, "workers": 0, "log_every_steps": 1}
        one = {"path": str(data), "clouds": ["gaussian"]}
        groups = one if streams is None else {name: {**one, **changes} for name, changes in streams.items()}
        tree = {
            "name": "tiny",
            "data": groups,
            "method": method,
            "detector": {"name": detector, **SMALL[detector].settings, **training.pop("changes", {})},
            "training": {**loop, **training},
        }
        return Plan(Experiment.model_validate(tree), tmp_path / folder)

    return make
