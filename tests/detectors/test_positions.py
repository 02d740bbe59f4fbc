"""Encoders that do not know where on the ground a point lies."""

import pytest

torch = pytest.importorskip("torch")

from small import SMALL, batch_of, small_detector

from farfield.detectors import DETECTORS
from farfield.detectors.features import FeatureMap


@pytest.mark.parametrize("name", ["pointpillars", "second", "sparsecentre", "voxelnet"])
def test_relative_positions_give_a_shifted_cloud_the_same_features(name: str) -> None:
    cloud = torch.rand(300, 5, generator=torch.Generator().manual_seed(0)) * torch.tensor([4.0, 4.0, 1.5, 1.0, 0.0])
    shift_m = torch.tensor([16.0, 0.0, 0.0, 0.0, 0.0])  # whole strides of each of them
    error = {}
    for positions in ("absolute", "relative"):
        network = small_detector(name, positions=positions).eval()
        columns = len(network.inputs["points"].columns)
        near = (cloud + torch.tensor([16.0, -2.0, -1.5, 0.0, 0.0]))[:, :columns]
        maps = [network.encode(batch_of(points)) for points in (near, near + shift_m[:columns])]
        one, other = (_dense(features) for features in maps)
        cells = round(16.0 / maps[0].cell_m)
        inner = slice(4, -4)  # away from the edges of the map
        one, other = one[:, :, :-cells][:, :, inner], other[:, :, cells:][:, :, inner]
        error[positions] = float((one - other).detach().abs().max() / (one.amax() - one.amin()).detach())
    assert error["relative"] < 2e-4
    assert error["absolute"] > 20 * error["relative"]


def _dense(features: FeatureMap) -> "torch.Tensor":
    return features.values if isinstance(features.values, torch.Tensor) else features.values.dense()[:, :, 0]


@pytest.mark.parametrize("name", ["pointpillars", "second"])
def test_imported_weights_want_positions(name: str) -> None:
    with pytest.raises(ValueError, match="expected positions: absolute with features: openpcdet"):
        DETECTORS[name].config_class(name=name, **SMALL[name].settings, features="openpcdet", positions="relative")
