"""The checks of detectors find what is wrong, and say how to fix it."""

import itertools
from functools import partial

import pytest
from pydantic import BaseModel, ConfigDict

torch = pytest.importorskip("torch")

from torch import nn

from farfield.detectors.anchors.grid import AnchorConfig
from farfield.detectors.config import GridConfig
from farfield.detectors.features import FeatureMap
from farfield.detectors.pointpillars.network import PointPillars, PointPillarsConfig
from farfield.testing import detectors as checks

CONFIG = PointPillarsConfig(
    grid=GridConfig(range_m=32.0, half_width_m=8.0, cell_m=0.5),
    anchors={"vehicle": AnchorConfig(size_m=(4.4, 1.8, 1.4), z_m=-1.2)},
    widths=(8, 8, 8),
    depths=(0, 0, 0),
    out_stride=2,
    neck_width=8,
)


def assign(assigner, module, boxes, inputs):
    """Assigner that carries a module along."""
    del module
    return assigner(boxes, inputs)


class Unused(PointPillars):
    """Has a layer that nothing reads."""

    def __init__(self, config):
        super().__init__(config)
        self.spare = nn.Linear(2, 2)


class Heavy(PointPillars):
    """Its assigner holds the network."""

    def __init__(self, config):
        super().__init__(config)
        self.assigner = partial(assign, self.assigner, self.head)


class Ordered(PointPillars):
    """Its features depend on the first point."""

    def encode(self, batch):
        features = super().encode(batch)
        first = torch.stack([cloud[:1].sum() for cloud in batch["points"]])
        return FeatureMap(
            values=features.values + first[:, None, None, None], cell_m=features.cell_m, origin_m=features.origin_m
        )


class Elsewhere(PointPillars):
    """Says that its features lie 40 m further left."""

    def encode(self, batch):
        features = super().encode(batch)
        return FeatureMap(values=features.values, cell_m=features.cell_m, origin_m=(0.0, 32.0))


class Forgetful(PointPillars):
    """Keeps a number that no weights file holds."""

    made = itertools.count()

    def __init__(self, config):
        super().__init__(config)
        self.shift = next(self.made)

    def decode(self, outputs):
        return [boxes.replace(centre_m=boxes.centre_m + self.shift) for boxes in super().decode(outputs)]


@pytest.mark.parametrize(
    ("kind", "check", "message"),
    [
        (Unused, checks.check_gradients, "none for spare.weight, spare.bias"),
        (Heavy, checks.check_assigner, "knows no module"),
        (Ordered, checks.check_order, "features depend on the points' order"),
        (Elsewhere, checks.check_place, "expected the change near"),
    ],
)
def test_what_is_wrong_is_named(kind, check, message):
    torch.manual_seed(3)
    check(PointPillars(CONFIG))
    torch.manual_seed(3)
    with pytest.raises(AssertionError, match=message):
        check(kind(CONFIG))


class Reading(PointPillars):
    """Looks at a weight while it is built."""

    def __init__(self, config):
        super().__init__(config)
        self.first = float(self.head.bias[0].detach())


def test_a_network_that_cannot_be_built_without_weights_is_named(monkeypatch):
    monkeypatch.setattr("farfield.detectors.pointpillars.network.PointPillars", Reading)
    with pytest.raises(AssertionError, match="built on the meta device"):
        checks.check_weights(Reading(CONFIG))


def test_what_a_weights_file_does_not_hold_is_noticed(monkeypatch):
    config = CONFIG.model_copy(update={"score_threshold": 0.0})
    checks.check_weights(PointPillars(config).eval())
    monkeypatch.setattr("farfield.detectors.pointpillars.network.PointPillars", Forgetful)
    with pytest.raises(AssertionError, match="keep what matters in the state dict"):
        checks.check_weights(Forgetful(config).eval())


class TinyConfig(BaseModel):
    """Settings that do not derive from DetectorConfig."""

    model_config = ConfigDict(frozen=True)
    name: str = "tiny"
    class_names: tuple[str, ...] = ("vehicle",)
    reach_m: float = 32.0


class ReachlessConfig(PointPillarsConfig):
    """Settings that forget to say how far they look."""

    name: str = "reachless"

    @property
    def reach_m(self):
        return None


def test_settings_that_no_experiment_takes_are_named():
    """Both passed once, and training failed with texts that named nothing."""
    network = PointPillars(CONFIG)
    checks.check_declared(network)
    for config, message in (
        (TinyConfig(), r"derive from farfield\.detectors\.DetectorConfig.*TinyConfig"),
        (ReachlessConfig.model_construct(**dict(CONFIG)), "reach_m of ReachlessConfig to give metres; got None"),
    ):
        network._config = config
        with pytest.raises(AssertionError, match=message):
            checks.check_declared(network)


class Untrainable(PointPillars):
    """Its losses fail where targets are those of a loader."""

    def losses(self, outputs, targets):
        raise KeyError("no such target")


def test_a_detector_that_an_experiment_cannot_train_is_named(monkeypatch):
    checks.check_training(PointPillars(CONFIG))
    monkeypatch.setattr("farfield.detectors.pointpillars.network.PointPillars", Untrainable)
    with pytest.raises(AssertionError, match=r"train the detector; it failed with KeyError: 'no such target'"):
        checks.check_training(PointPillars(CONFIG))
