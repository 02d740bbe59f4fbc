"""Weather in the mean teacher's strong view: off is off to the bit, and what a box loses it is not punished for."""

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from test_teacher import method_of, run, start  # noqa: F401

from farfield.adaptation.pseudo_labels import PseudoLabels, in_weather
from farfield.detectors.inputs import Inputs
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError
from farfield.frame import Boxes
from farfield.training.config import WeatherConfig


def strong(**weather: Any) -> dict[str, Any]:
    return {"strong": {"weather": {"sensor": "luminar-h2", **weather}}}


def test_weather_that_is_off_is_no_weather_to_the_bit_and_that_is_on_is_not(planned: Any, start: Any) -> None:  # noqa: F811
    weights = start()
    named = {
        name: load_weights(run(planned, name, method_of(weights, **changes)) / "weights.safetensors")[0].state_dict()
        for name, changes in (("plain", {}), ("off", strong(probability=0.0)), ("on", strong(probability=1.0)))
    }
    alike = {
        other: all(torch.equal(value, named[other][name]) for name, value in named["plain"].items())
        for other in ("off", "on")
    }
    assert alike == {"off": True, "on": False}


def test_the_lidar_is_to_be_named(planned: Any, start: Any) -> None:  # noqa: F811
    weights = start()
    with pytest.raises(ConfigError, match="sensor"):
        run(planned, "unnamed", method_of(weights, strong={"weather": {"probability": 1.0}}))


def test_confident_boxes_that_lose_all_their_points_are_ignored() -> None:
    """Opaque ice over the whole front: ahead all is lost, behind nothing."""
    config = WeatherConfig(
        probability=1.0, kinds=("ice",), sensor="os2-64", coverage=(1.0, 1.0), transmission=(1e-6, 1e-6)
    )
    centre = np.array([[20.0, 0, 0], [-20.0, 0, 0]])
    boxes = Boxes(centre_m=centre, size_m=np.full((2, 3), 2.0), yaw_rad=np.zeros(2), label=["vehicle"] * 2)
    cloud = torch.from_numpy(np.repeat(centre, 30, axis=0).astype(np.float32))
    inputs = Inputs({"points": [cloud, cloud.clone()]})
    found = [PseudoLabels(boxes, boxes[:0]), PseudoLabels(boxes[:1], boxes[1:])]
    rng = np.random.default_rng(0)
    clouds, (one, two) = in_weather(inputs, found, {"points": ("x_m", "y_m", "z_m")}, config, rng)
    assert [len(each) for each in clouds["points"]] == [30, 30]
    assert all((each[:, 0] < 0).all() for each in clouds["points"])
    assert one.confident.centre_m[:, 0].tolist() == [-20.0]
    assert one.ignored.centre_m[:, 0].tolist() == [20.0]
    assert len(two.confident) == 0
    assert len(two.ignored) == 2
    assert len(inputs["points"][0]) == 60  # the teacher's view stays as it is


def test_half_of_the_frames_stay_as_they_are_where_half_are_asked_for() -> None:
    config = WeatherConfig(probability=0.5, kinds=("fog",), sensor="os2-64")
    cloud = torch.from_numpy(np.random.default_rng(1).uniform(-30, 30, (400, 3)).astype(np.float32))
    inputs = Inputs({"points": [cloud] * 200})
    none = [PseudoLabels(Boxes.empty(), Boxes.empty())] * 200
    clouds, _ = in_weather(inputs, none, {"points": ("x_m", "y_m", "z_m")}, config, np.random.default_rng(2))
    same = [torch.equal(each, cloud) for each in clouds["points"]]
    assert np.mean(same) == pytest.approx(0.5, abs=0.12)
