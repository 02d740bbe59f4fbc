"""RTN: its trunks beside their published sizes, the dense map, the neck."""

import subprocess
import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from torch import nn

from farfield.detectors import build_detector
from farfield.detectors.kradar.radar_detector import RadarNeck
from farfield.detectors.kradar.rtn import Bottleneck, ResNet, RTNConfig, StridedPointwise
from farfield.detectors.layers import fold_batch_norm

CLASSIFIER = 2048 * 1000 + 1000


@pytest.mark.parametrize(
    ("depths", "groups", "group_width", "published"),
    [
        ((3, 4, 6, 3), 1, 64, 25_557_032),  # ResNet-50
        ((3, 4, 23, 3), 32, 8, 88_791_336),  # ResNeXt-101 32x8d
        ((3, 4, 23, 3), 64, 4, 83_455_272),  # ResNeXt-101 64x4d
        ((3, 4, 23, 3), 32, 4, 44_177_704),  # ResNeXt-101 32x4d
    ],
)
def test_trunks_have_the_published_number_of_parameters(depths, groups, group_width, published):
    with torch.device("meta"):
        trunk = ResNet(3, depths=depths, groups=groups, group_width=group_width)
    assert sum(p.numel() for p in trunk.parameters()) + CLASSIFIER == published


def test_a_group_sees_its_own_channels_alone():
    torch.manual_seed(0)
    grouped = Bottleneck(64, 16, groups=4, group_width=16).eval()
    middle = grouped.layers[3]
    assert (middle.in_channels, middle.out_channels, middle.groups) == (16, 16, 4)
    image = torch.randn(1, 16, 5, 5)
    changed = image.clone()
    changed[:, :4] += 1
    same = (middle(image) == middle(changed)).flatten(2).all(2)[0]
    assert same.tolist() == [False] * 4 + [True] * 12


def test_stages_come_out_at_their_strides_and_the_last_may_be_dilated():
    trunk = ResNet(4, depths=(1, 1, 1, 1), planes=8, strides=(1, 2, 2, 1))
    maps = trunk(torch.randn(1, 4, 24, 16))
    assert [tuple(m.shape) for m in maps] == [(1, 32, 24, 16), (1, 64, 12, 8), (1, 128, 6, 4), (1, 256, 6, 4)]
    assert trunk.stages[3][0].layers[3].dilation == (2, 2)
    assert (trunk.widths, trunk.strides) == ([32, 64, 128, 256], [1, 2, 4, 4])


@pytest.mark.parametrize("overlap", [True, False])
def test_every_cell_of_a_stage_reaches_the_output(overlap):
    neck = RadarNeck([3, 5, 7], [1, 2, 4], 2, overlap=overlap)
    for layer in neck.layers:
        nn.init.ones_(layer[0].conv.weight)
    maps = [torch.ones(1, 3, 24, 16), torch.ones(1, 5, 12, 8), torch.ones(1, 7, 6, 4)]
    assert neck(maps).shape == (1, 6, 24, 16)
    assert all((layer[0](m) > 0).all() for layer, m in zip(neck.layers, maps, strict=True))


def small_rtn(**changes):
    grid = {"range_m": 3.2, "half_width_m": 1.6, "z_min_m": 0.0, "z_max_m": 1.2}
    return build_detector(RTNConfig(grid=grid, planes=8, depths=(1, 1), strides=(1, 2), **changes), seed=0)


def test_dense_map_has_height_as_channels(rng):
    cells = np.stack(np.meshgrid(np.arange(8), np.arange(8), np.arange(3), indexing="ij"), -1).reshape(-1, 3)
    points = torch.tensor(cells * 0.4 + [0.2, -1.4, 0.2], dtype=torch.float32)
    power = torch.tensor(rng.uniform(0, 5, len(cells)), dtype=torch.float32)
    cloud = torch.column_stack([points, power])[torch.tensor(rng.permutation(len(cells)))]
    expected = power.view(8, 8, 3).permute(2, 0, 1)[None]
    assert torch.equal(small_rtn().dense_map([cloud]), expected)
    torch.testing.assert_close(small_rtn(height="mean").dense_map([cloud]), expected.mean(1, keepdim=True))
    torch.testing.assert_close(small_rtn(power="log").dense_map([cloud]), torch.log1p(expected / 0.01))


def test_doppler_adds_a_map_of_its_own():
    network = small_rtn(use_doppler=True)
    cloud = torch.tensor([[0.2, -1.4, 0.2, 2.0, -1.5]])
    image = network.dense_map([cloud, cloud[:0]])
    assert image.shape == (2, 6, 8, 8)
    assert image.nonzero().tolist() == [[0, 0, 0, 0], [0, 3, 0, 0]]
    assert (float(image[0, 0, 0, 0]), float(image[0, 3, 0, 0])) == (2.0, -1.5)


def test_settings_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="as many depths as strides"):
        RTNConfig(depths=(1, 1))
    with pytest.raises(ValueError, match="multiple of 64"):
        RTNConfig(trunk="resnext101", planes=10, group_width=8)
    with pytest.raises(ValueError, match="as long as wide"):
        RTNConfig(grid={"cell_m": [0.4, 0.8, 0.4]})


NARROW = """
import torch
from farfield.detectors.kradar.rtn import Bottleneck
torch.manual_seed(0)
block = Bottleneck(8, 8, stride=2).to(memory_format=torch.channels_last)
for _ in range(10):
    image = torch.randn(3, 8, 180, 80).to(memory_format=torch.channels_last)
    block(image.requires_grad_()).square().mean().backward()
"""


def test_a_narrow_strided_block_ends_its_steps():
    """oneDNN's backward pass of a 1 x 1 convolution with a stride crashed there, on AVX-512."""
    done = subprocess.run([sys.executable, "-c", NARROW], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize("channels", [8, 24])
def test_a_strided_shortcut_is_the_convolution_that_it_stands_for(channels):
    torch.manual_seed(1)
    own, plain = StridedPointwise(channels, 16, 2), torch.nn.Conv2d(channels, 16, 1, 2, bias=False)
    plain.load_state_dict(own.state_dict())
    for height, width in ((12, 8), (7, 9), (1, 1)):
        image = torch.randn(2, channels, height, width)
        torch.testing.assert_close(own(image), plain(image), rtol=1e-5, atol=1e-5)
    norm = torch.nn.BatchNorm2d(16)
    norm.running_mean.normal_()
    both = torch.nn.Sequential(own, norm).eval()
    torch.testing.assert_close(fold_batch_norm(both)(image), both(image), rtol=1e-5, atol=1e-5)
