"""The door for detectors of other packages: registry, decorator, catalogue."""

from importlib.metadata import EntryPoint

import numpy as np
import pytest
from pydantic import ValidationError

torch = pytest.importorskip("torch")


from torch import nn

from farfield import registry
from farfield.cli import main
from farfield.detectors import DETECTORS, DetectorSpec, build_detector, detector
from farfield.detectors.catalogue import catalogue
from farfield.detectors.config import DetectorConfig
from farfield.detectors.features import PointFeatures
from farfield.detectors.inputs import CloudInput
from farfield.detectors.losses import normaliser
from farfield.detectors.network import Network
from farfield.detectors.pointpillars.network import PointPillarsConfig
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import ConfigError
from farfield.frame import Boxes
from farfield.registry import PluginError
from farfield.testing import detectors as checks


class MeanConfig(DetectorConfig):
    """Settings of a detector that places one box at the mean of the points."""

    name: str = "mean"
    range_m: float = 64.0

    @property
    def class_names(self):
        return ("vehicle",)

    @property
    def reach_m(self):
        return self.range_m


def first_centre(boxes, inputs):
    """Assigner: the centre of the first box."""
    del inputs
    return boxes.centre_m[:1].astype("float32")


class Mean(Network):
    """Two clouds in, one box a frame out."""

    assigner = staticmethod(first_centre)
    channels = 4

    def __init__(self, config):
        super().__init__(config)
        self.inputs = {
            "lidar": CloudInput(columns=("x_m", "y_m", "z_m", "intensity")),
            "radar": CloudInput(columns=("x_m", "y_m", "z_m", "power")),
        }
        self.linear, self.head_layer = nn.Linear(4, 4), nn.Linear(4, 3)

    def encode(self, batch):
        clouds = [torch.cat(pair) for pair in zip(batch["lidar"], batch["radar"], strict=True)]
        rows = torch.cat(clouds)
        return PointFeatures(values=self.linear(rows), xyz=rows[:, :3], lengths=[len(cloud) for cloud in clouds])

    def head(self, features, targets=None):
        parts = features.values.split(list(features.lengths))
        return torch.stack([self.head_layer(part).sum(0) / max(len(part), 1) for part in parts])

    def losses(self, outputs, targets):
        centres = [(frame, torch.from_numpy(centre)) for frame, centre in enumerate(targets) if len(centre)]
        error = sum(((outputs[frame] - centre[0]).square().sum() for frame, centre in centres), 0 * outputs.sum())
        return {"centre": error / normaliser(torch.tensor(float(len(centres))))}

    def decode(self, outputs):
        box = {"size_m": np.ones((1, 3)), "yaw_rad": np.zeros(1), "label": "vehicle", "score": np.ones(1)}
        return [Boxes(centre_m=row[None].double().numpy(), **box) for row in outputs]


@pytest.fixture
def mean():
    detector("mean", config=MeanConfig, paper="a mean")(Mean)
    yield
    del DETECTORS._registered["mean"]


@pytest.fixture
def plugins(monkeypatch):
    """Entry points of another package: one that works, and one that fails to import."""
    points = [
        EntryPoint("theirs", "test_kinds:THEIRS", "farfield.detectors"),
        EntryPoint("torn", "no_such_package:KIND", "farfield.detectors"),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)


class TheirConfig(MeanConfig):
    name: str = "theirs"


THEIRS = DetectorSpec(name="theirs", paper="theirs, 2026", config=TheirConfig, network="test_kinds:Mean")


@pytest.mark.parametrize(
    "check",
    [check for check in checks.CHECKS if check is not checks.check_place],
    ids=lambda check: check.__name__,
)
@pytest.mark.usefixtures("mean")
def test_a_registered_detector_of_two_clouds_goes_through_the_same_checks(check):
    check(checks.built("mean", {"range_m": 50}))


@pytest.mark.usefixtures("mean")
def test_a_registered_detector_is_found_by_name_and_travels(tmp_path):
    network = build_detector(MeanConfig(), seed=1)
    save_weights(tmp_path / "w.safetensors", network.state_dict(), config=network.config, provenance={})
    assert isinstance(load_weights(tmp_path / "w.safetensors")[0], Mean)
    assert DETECTORS.origin("mean") == "registered here"
    assert Detector(network, device="cpu").columns == ("x_m", "y_m", "z_m", "intensity", "power")


def test_names_of_built_in_detectors_and_of_other_configurations_are_refused():
    with pytest.raises(ConfigError, match="built in"):
        detector("second", config=type("Config", (MeanConfig,), {"__annotations__": {"name": str}, "name": "second"}))
    with pytest.raises(ConfigError, match='name: str = "other"'):
        detector("other", config=MeanConfig)


def test_a_configuration_belongs_to_its_detector():
    assert PointPillarsConfig(name="pointpillars") == PointPillarsConfig()
    with pytest.raises(ValidationError, match="SecondConfig"):
        PointPillarsConfig(name="second")
    with pytest.raises(ValidationError, match="one of pointpillars"):
        PointPillarsConfig(name="no-such")


@pytest.mark.usefixtures("plugins")
def test_the_catalogue_lists_other_packages_detectors_and_names_what_is_broken(capsys):
    entries = {entry.name: entry for entry in catalogue()}
    assert list(entries)[:7] == list(DETECTORS.builtin)
    assert (entries["theirs"].paper, entries["theirs"].scores, entries["theirs"].origin) == (
        "theirs, 2026",
        {},
        "test_kinds",
    )
    assert "no_such_package" in entries["torn"].broken
    with pytest.raises(PluginError, match="no_such_package"):
        _ = DETECTORS["torn"]
    assert main(["detectors"]) == 0
    shown = capsys.readouterr().out
    assert "theirs, 2026" in shown
    assert "torn" in shown
    assert "no_such_package" in shown
    assert checks.built("theirs", {}).config.name == "theirs"
