"""RTNH: its two forms, dense and sparse execution, the published architecture, Doppler."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import batch_of, cloud_of, losses_of, small_detector
from torch.nn import functional

from farfield.detectors import build_detector
from farfield.detectors.kradar.radar_detector import CellEncoder, RadarGridConfig, in_unit_grid
from farfield.detectors.kradar.rtnh import RadarBackbone, RTNHConfig, dense_block
from farfield.detectors.layers import fold_batch_norm
from farfield.detectors.runtime import Detector
from farfield.detectors.sparse import SparseTensor
from farfield.errors import ConfigError
from farfield.frame import Boxes, Cloud

COLUMNS = ("x_m", "y_m", "z_m", "power")

SHAPE = (6, 12, 8)


def some_cells(share: float, channels: int, *, batch: int = 2, seed: int = 0) -> SparseTensor:
    generator = torch.Generator().manual_seed(seed)
    keys = (torch.rand(batch * 6 * 12 * 8, generator=generator) < share).nonzero().squeeze(1)
    return SparseTensor(torch.randn(len(keys), channels, generator=generator), keys, SHAPE, batch)


def backbone(execution: str) -> RadarBackbone:
    torch.manual_seed(1)
    built = RadarBackbone(5, widths=(8, 12, 16), neck_width=6, depth=6, execution=execution)
    for module in built.modules():  # statistics and shifts that would show a value at an empty cell
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.running_mean, -0.5, 0.5)
            torch.nn.init.uniform_(module.bias, 0.1, 0.5)
    return built


@pytest.mark.parametrize("share", [0.02, 0.4, 1.0])
@pytest.mark.parametrize("folded", [False, True])
@pytest.mark.parametrize("slab_bytes", [1, 20_000, 2**22])  # a layer of height at a time, four, all
def test_dense_and_sparse_are_one_function(share, folded, slab_bytes, monkeypatch):
    monkeypatch.setattr("farfield.detectors.kradar.rtnh.SLAB_BYTES", slab_bytes)
    monkeypatch.setattr("farfield.detectors.kradar.rtnh.WHOLE_BYTES", 0)
    sparse, dense = (backbone(execution).eval() for execution in ("sparse", "dense"))
    if folded:
        sparse, dense = fold_batch_norm(sparse), fold_batch_norm(dense)
    with torch.no_grad():
        a, b = sparse(some_cells(share, 5)), dense(some_cells(share, 5))
    assert a.shape == (2, 18, 12, 8)
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.4])
@pytest.mark.parametrize("execution", ["sparse", "dense"])
def test_half_precision_is_the_same_function(share, execution):
    exact, rounded = (fold_batch_norm(backbone(way).eval()) for way in ("sparse", execution))
    rounded.bfloat16()
    cells = some_cells(share, 5)
    with torch.no_grad():
        a, b = exact(cells), rounded(cells.replace(cells.features.bfloat16()))
    assert (a - b).norm() <= 0.02 * a.norm()


def test_dense_and_sparse_train_alike():
    gradients, statistics = [], []
    for execution in ("sparse", "dense"):
        network = backbone(execution).train()
        network(some_cells(0.2, 5)).square().mean().backward()
        gradients.append([p.grad for p in network.parameters()])
        statistics.append([b for name, b in network.named_buffers() if "running" in name])
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-5)
    for a, b in zip(*statistics, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


def test_a_collapsed_height_has_whole_gradients_in_bfloat16():
    # 32 channels, 20 layers: oneDNN leaves most of this gradient unset on CPUs with matrix tiles
    block = RadarBackbone(32, widths=(32,), neck_width=8, depth=20).to_bev[0].train()
    volume = torch.randn(2, 20, 180, 32, 32, generator=torch.Generator().manual_seed(0)).permute(0, 4, 1, 2, 3)
    slope = torch.randn(2, 32, 1, 180, 32, generator=torch.Generator().manual_seed(1))
    block.norm = torch.nn.Identity()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        out, _ = dense_block(block, volume, torch.ones(2, 1, 20, 180, 32, dtype=torch.uint8))
    (out.float() * slope).sum().backward()
    slope = slope * (out > 0)
    exact = torch.einsum("bizxy,boxy->zio", volume.double(), slope.squeeze(2).double())
    assert (block.conv.weight.grad - exact).norm() <= 0.02 * exact.norm()


def test_a_dense_block_is_pytorchs_convolution_where_something_is_reached():
    block = backbone("dense").eval().stages[1][0]
    volume = some_cells(0.05, 8).dense()
    occupied = (volume.abs().sum(1, keepdim=True) > 0).to(torch.uint8)
    out, reached = dense_block(block, volume, occupied)
    weight = block.conv.weight.view(3, 3, 3, 8, 12).permute(4, 3, 0, 1, 2)
    exact = functional.conv3d(volume.double(), weight.double(), None, 2, 1)
    norm = block.norm
    level = (exact - norm.running_mean.view(-1, 1, 1, 1)) / (norm.running_var + norm.eps).sqrt().view(-1, 1, 1, 1)
    level = level * norm.weight.view(-1, 1, 1, 1) + norm.bias.view(-1, 1, 1, 1)
    by_hand = functional.conv3d(occupied.float(), torch.ones(1, 1, 3, 3, 3), None, 2, 1) > 0
    assert torch.equal(reached > 0, by_hand)
    torch.testing.assert_close(out.double(), level.relu() * by_hand, rtol=1e-4, atol=1e-5)


def test_published_network_has_the_published_layers():
    with torch.device("meta"):
        network = build_detector(RTNHConfig())
    # RadarSparseBackbone's convolutions; their biases, which the normalisation cancels, are left out.
    convolutions = 27 * (64 * 64 * 3 + 64 * 128 + 128 * 128 * 2 + 128 * 256 + 256 * 256 * 2)
    collapsing = 20 * 64 * 64 + 10 * 128 * 128 + 5 * 256 * 256
    neck = 256 * (64 * 3**2 + 128 * 6**2 + 256 * 12**2)
    norms = 2 * (4 * (64 + 128 + 256) + 3 * 256)
    head = 769 * (3 + 16)
    expected = 5 * 64 + convolutions + collapsing + neck + norms + head
    assert sum(p.numel() for p in network.parameters()) == expected
    layers = [layer[0] for layer in network.backbone.neck.layers]
    assert [layer.stride * layer.conv.kernel_size[0] for layer in layers] == [3, 6, 12]
    assert [layer.stride * layer.conv.padding[0] for layer in layers] == [1, 2, 4]


def test_forms_bring_their_settings_and_an_experiment_changes_them():
    published, wide = RTNHConfig(), RTNHConfig(form="wide")
    assert published.grid.shape(4) == (20, 180, 32)
    assert wide.grid.shape(4) == (24, 180, 80)
    assert published.class_names == ("vehicle",)
    assert wide.class_names == ("vehicle", "large_vehicle")
    assert (published.score_threshold, published.nms_iou) == (0.3, 0.1)
    assert (wide.score_threshold, wide.nms_iou, wide.candidates, wide.head) == (0.1, 0.01, 4096, "openpcdet")
    assert (wide.max_points, wide.cell_channels) == (4, 32)
    bottoms = {name: round(a.z_m - a.size_m[2] / 2, 6) for name, a in wide.anchors.items()}
    assert bottoms == {"vehicle": -1.08, "large_vehicle": -1.08}
    assert RTNHConfig(form="wide", nms_iou=0.2).nms_iou == 0.2
    assert RTNHConfig.model_validate_json(wide.model_dump_json()) == wide


def test_simplified_pointnet_counts_missing_points_as_zeros():
    grid = RadarGridConfig(range_m=1.6, half_width_m=0.8, z_min_m=0.0, z_max_m=0.4)
    torch.manual_seed(0)
    encoder = CellEncoder(grid, COLUMNS, multiple=1, channels=16, max_points=2)
    points = torch.tensor([[0.1, -0.7, 0.2, 1.0], [0.2, -0.6, 0.2, 3.0], [0.3, -0.5, 0.2, 9.0], [1.3, 0.7, 0.1, 2.0]])
    cells = encoder([points])
    learned = points @ encoder.linear.weight.T
    torch.testing.assert_close(cells.features[0], learned[:2].amax(0))  # full: the first two, no zeros
    torch.testing.assert_close(cells.features[1], learned[3].clamp(min=0))  # one point and one missing
    assert cells.keys.tolist() == [0, 15]
    alone = encoder([points[[3, 1]]])  # one point a cell, unsorted
    torch.testing.assert_close(alone.features, learned[[1, 3]].clamp(min=0))
    assert alone.keys.tolist() == [0, 15]


def test_wide_form_learns_both_classes(scene):
    settings = {"form": "wide", "anchors": RTNHConfig(form="wide").anchors, "max_points": 4}
    network = small_detector("rtnh", **settings)
    boxes = Boxes(
        centre_m=scene.boxes.centre_m[:2],
        size_m=np.array([[4.4, 1.8, 1.4], [9.0, 3.0, 3.5]]),
        yaw_rad=np.array([0.0, np.pi / 2]),
        label=np.array(["vehicle", "large_vehicle"]),
    )
    cloud = cloud_of(network, scene.cloud())
    gaps = np.hypot(*(cloud.numpy()[:, None, :2] - boxes.centre_m[:, :2]).transpose(2, 0, 1))
    cloud = cloud[torch.from_numpy(gaps.min(1) < 5.0)]
    optimizer = torch.optim.AdamW(network.parameters(), 5e-3)
    for _ in range(40):
        optimizer.zero_grad()
        sum(losses_of(network, [cloud], [boxes]).values()).backward()
        optimizer.step()
    found = fold_batch_norm(network).predict(batch_of(cloud))[0]
    for number, name in enumerate(boxes.label):
        best = found[found.label == name][0:1]
        np.testing.assert_allclose(best.centre_m[0], boxes.centre_m[number], atol=0.7)


def test_doppler_is_read_where_asked_for(rng):
    points = rng.uniform([0, -6, -2], [70, 6, 5], (200, 3)).astype(np.float32)
    power, doppler = rng.uniform(0, 1, 200).astype(np.float32), rng.normal(0, 1, 200).astype(np.float32)
    doppler[3], none = np.nan, np.zeros(200, np.float32)
    network = small_detector("rtnh", use_doppler=True, score_threshold=0.0)
    detector = Detector(network, precision="fp32", device="cpu")
    cloud = Cloud(points, None, {"power": power, "doppler_m_s": doppler})
    tensor = cloud_of(network, cloud)
    assert tensor.shape == (200, 5)
    assert tensor[3, 4] == 0
    moving, still = detector(cloud), detector(Cloud(points, None, {"power": power, "doppler_m_s": none}))
    assert moving.score.tolist() != still.score.tolist()
    with pytest.raises(ConfigError, match="doppler_m_s"):
        detector(Cloud(points, None, {"power": power}))


def test_log_power_tames_strong_cells():
    points = torch.tensor([[1.0, 0.0, 0.0, power] for power in (-1.0, 0.0, 0.01, 10.0)])
    from farfield.detectors.kradar.radar_detector import scaled_power

    np.testing.assert_allclose(
        scaled_power(points, COLUMNS, log=True)[:, 3], [0, 0, np.log(2), np.log(1001)], rtol=1e-6
    )
    assert torch.equal(scaled_power(points, COLUMNS, log=False), points)


def test_unit_positions_are_another_scale_of_the_same_layer():
    grid = RadarGridConfig()
    corners = torch.tensor([[0.0, -6.4, -2.0, 0.3], [72.0, 6.4, 6.0, 0.3], [36.0, 0.0, 2.0, 0.3]])
    expected = torch.tensor([[-1.0, -1.0, -1.0, 0.3], [1.0, 1.0, 1.0, 0.3], [0.0, 0.0, 0.0, 0.3]])
    torch.testing.assert_close(in_unit_grid(corners, grid), expected)
    metres, unit = (
        CellEncoder(grid, COLUMNS, multiple=4, channels=6, unit_positions=u).double() for u in (False, True)
    )
    half, middle = torch.tensor([36.0, 6.4, 4.0]).double(), torch.tensor([36.0, 0.0, 2.0]).double()
    with torch.no_grad():
        unit.linear.weight[:, 3] = metres.linear.weight[:, 3]
        unit.linear.weight[:, :3] = metres.linear.weight[:, :3] * half
        unit.linear.bias.copy_(metres.linear.bias + metres.linear.weight[:, :3] @ middle)
    share = torch.rand(200, 4, generator=torch.Generator().manual_seed(0)).double()
    cloud = torch.cat([share[:, :3] * 2 * half + middle - half, share[:, 3:]], 1)
    torch.testing.assert_close(unit([cloud]).features, metres([cloud]).features)
