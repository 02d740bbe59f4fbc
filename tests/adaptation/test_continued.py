"""Going on from other weights: the start is theirs, the rest is plain training, and without a start it is refused."""

from collections.abc import Callable
from typing import Any

import pytest

torch = pytest.importorskip("torch")

from farfield.adaptation.continued import ContinuedTraining
from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError

TINY = {
    "grid": {"range_m": 32.0, "half_width_m": 8.0, "cell_m": 0.5},
    "widths": (8, 8, 8),
    "depths": (0, 0, 0),
    "neck_width": 8,
}


def test_it_goes_on_from_the_weights_of_another_run(planned: Callable[..., Any]) -> None:
    first = planned("first", {"name": "supervised"})
    weights = first.run()
    went_on = planned("second", {"name": "continued", "start": str(weights.parent)}, steps=1, learning_rate=1e-9)
    start, end = (load_weights(path)[0].state_dict() for path in (weights, went_on.run()))
    fresh = build_detector(went_on.experiment.detector, seed=went_on.experiment.training.seed).state_dict()
    head = "head.weight"
    assert torch.allclose(end[head], start[head], atol=1e-6)
    assert not torch.allclose(fresh[head], start[head], atol=1e-4)


def test_without_a_start_or_with_another_networks_it_is_refused(planned: Callable[..., Any]) -> None:
    network = build_detector(DETECTORS["pointpillars"].config_class(**TINY), seed=0)
    with pytest.raises(ConfigError, match=r"method continued: .*\n.*start"):
        ContinuedTraining(network)
    with pytest.raises(ConfigError, match="It has: start"):
        ContinuedTraining(network, start="pointpillars-cirrus-sim", pace=1)
    with pytest.raises(ConfigError, match="method continued: expected the weights"):
        ContinuedTraining(network, start="pointpillars-cirrus-sim")
