import numpy as np
import pytest
from pydantic import ValidationError

torch = pytest.importorskip("torch")

from small import batch_of, cloud_of

from farfield.detectors import DETECTORS
from farfield.detectors.config import VoxelGridConfig
from farfield.detectors.layers import fold_batch_norm
from farfield.detectors.sparse import SparseTensor
from farfield.detectors.voxelnet.middle import MiddleLayers
from farfield.detectors.voxelnet.network import VoxelFeatureEncoder, VoxelNet, VoxelNetConfig, grouped

GRID = VoxelGridConfig(range_m=64.0, half_width_m=20.0, z_min_m=-3.0, z_max_m=1.0, cell_m=(0.5, 0.5, 0.5))
SMALL = VoxelNetConfig(
    grid=GRID,
    vfe_widths=(8, 16),
    voxel_channels=16,
    middle_widths=(16, 16, 16),
    widths=(16, 32, 32),
    depths=(1, 2, 2),
    neck_width=32,
)
DEPTH = 9
COLUMNS = ("x_m", "y_m", "z_m", "intensity", "lag_s")


@pytest.fixture
def network():
    torch.manual_seed(3)
    return VoxelNet(SMALL)


def voxels(count, *, batch=1, nx=13, ny=12, channels=5):
    cells = batch * DEPTH * nx * ny
    keys = torch.randperm(cells)[:count].sort().values
    return SparseTensor(torch.randn(count, channels), keys, (DEPTH, nx, ny), batch)


def corners(nx, ny, channels=5):
    indices = torch.cartesian_prod(torch.arange(2), *(torch.tensor([0, size - 1]) for size in (DEPTH, nx, ny)))
    features = torch.randn(len(indices), channels)
    return SparseTensor.from_indices(features, indices, (DEPTH, nx, ny), 2)


CASES = {
    "scattered": lambda: voxels(40, nx=17, ny=14),
    "batch of two": lambda: voxels(60, batch=2),
    "corners": lambda: corners(13, 12),
    "fewer cells than the borders are deep": lambda: voxels(9, nx=5, ny=2),
    "one voxel": lambda: voxels(1),
    "all voxels": lambda: voxels(DEPTH * 8 * 7, nx=8, ny=7),
    "no voxel": lambda: voxels(0),
}


@pytest.fixture
def middle():
    """Middle layers with norms in use: their statistics and weights are not the initial ones."""
    torch.manual_seed(5)
    layers = MiddleLayers(5, (6, 7, 4), DEPTH)
    for name, value in layers.state_dict().items():
        if "norm" in name and value.is_floating_point():
            value.uniform_(0.5, 1.5) if name.endswith(("weight", "var")) else value.normal_(std=0.5)
    return layers


def published(layers, volume):
    """The middle layers as nn.Conv3d and nn.BatchNorm3d say them, in float64; returns image and modules."""
    steps = [((2, 1, 1), (1, 1, 1)), ((1, 1, 1), (0, 1, 1)), ((2, 1, 1), (1, 1, 1))]
    modules = []
    for layer, (stride, padding) in zip(layers.layers, steps, strict=True):
        _, c_in, c_out = layer.conv.weight.shape
        conv = torch.nn.Conv3d(c_in, c_out, 3, stride, padding, bias=False).double()
        norm = torch.nn.BatchNorm3d(c_out, eps=1e-3, momentum=0.1).double()
        with torch.no_grad():
            conv.weight.copy_(layer.conv.weight.view(3, 3, 3, c_in, c_out).permute(4, 3, 0, 1, 2))
        norm.load_state_dict(layer.norm.state_dict())
        modules += [conv, norm.train(layers.training), torch.nn.ReLU()]
    stack = torch.nn.Sequential(*modules)
    return stack(volume.double()).transpose(1, 2).flatten(1, 2), stack


@pytest.mark.parametrize("mode", ["sparse", "dense"])
@pytest.mark.parametrize("training", [False, True], ids=["evaluation", "training"])
@pytest.mark.parametrize("case", CASES)
def test_middle_layers_equal_published_ones_and_so_do_gradients_and_statistics(middle, case, training, mode):
    middle.mode = mode
    middle.train(training)
    sparse = CASES[case]()
    ours, theirs = (sparse.features.clone().requires_grad_() for _ in range(2))
    expected, stack = published(middle, sparse.replace(theirs).dense())
    image = middle(sparse.replace(ours))
    torch.testing.assert_close(image.double(), expected, rtol=1e-4, atol=1e-4)
    asked = torch.randn(image.shape)
    (image * asked).sum().backward()
    (expected * asked).sum().backward()
    scale = max(1.0, float(theirs.grad.abs().max()) if len(theirs) else 1.0)
    torch.testing.assert_close(ours.grad / scale, theirs.grad / scale, rtol=1e-3, atol=1e-4)
    for layer, conv, norm in zip(middle.layers, stack[::3], stack[1::3], strict=True):
        weight = conv.weight.grad.permute(2, 3, 4, 1, 0).reshape(layer.conv.weight.shape)
        for mine, other in ((layer.conv.weight, weight), (layer.norm.weight, norm.weight.grad)):
            largest = other.abs().max().clamp(min=1.0)
            torch.testing.assert_close(mine.grad / largest, (other / largest).float(), rtol=1e-3, atol=1e-4)
        torch.testing.assert_close(layer.norm.bias.grad.double(), norm.bias.grad, rtol=1e-3, atol=1e-3)
        for name, value in layer.norm.state_dict().items():
            torch.testing.assert_close(value.double(), norm.state_dict()[name].double(), rtol=1e-5, atol=1e-6)


def test_background_is_not_zero_and_differs_at_the_borders(middle):
    image = middle.eval()(voxels(0, nx=13, ny=12))[0]
    centre = image[:, 6, 6]
    assert (centre > 0).any()
    assert torch.equal(image[:, 3, 4], centre)
    assert not torch.allclose(image[:, 0, 6], centre)
    assert not torch.allclose(image[:, 6, 11], centre)


def test_folded_middle_layers_are_the_same_function(middle):
    sparse = voxels(40)
    middle.eval()
    with torch.no_grad():
        folded = fold_batch_norm(middle)
        for mode in ("sparse", "dense"):
            folded.mode = middle.mode = mode
            torch.testing.assert_close(folded(sparse), middle(sparse), rtol=1e-4, atol=1e-4)
    assert not any(isinstance(m, torch.nn.BatchNorm3d) for m in folded.modules())


def test_weights_move_between_dense_and_sparse(network, scene):
    dense = VoxelNet(SMALL.model_copy(update={"middle": "dense"}))
    dense.load_state_dict(network.state_dict())
    batch = batch_of(cloud_of(network, scene.cloud()))
    with torch.no_grad():
        for one, other in zip(network.eval()(batch), dense.eval()(batch), strict=True):
            torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-4)


def test_encoder_equals_a_loop_over_voxels(rng):
    torch.manual_seed(1)
    encoder = VoxelFeatureEncoder(GRID, COLUMNS, multiple=8, widths=(8, 12), channels=10).eval()
    points = np.column_stack([rng.uniform(0, 4, 400), rng.uniform(-2, 2, 400), rng.uniform(-3, 1, 400)])
    cloud = torch.from_numpy(np.column_stack([points, rng.uniform(0, 1, (400, 2))])).float()
    with torch.no_grad():
        found = encoder([cloud[:300], cloud[300:]])
        for frame, part in enumerate((cloud[:300], cloud[300:])):
            place = np.floor((part.numpy()[:, :3] - [0, -20, -3]) / 0.5).astype(int)
            own = found.indices()[:, 0] == frame
            assert own.sum() == len(np.unique(place, axis=0))
            for (_, iz, ix, iy), row in zip(found.indices()[own].tolist(), found.features[own], strict=True):
                inside = part[torch.from_numpy((place == [ix, iy, iz]).all(1))]
                offset = (inside[:, :3] - inside[:, :3].mean(0)) / 0.5
                features = torch.cat([inside[:, :3] / torch.tensor([64.0, 20.0, 3.0]), inside[:, 3:], offset], 1)
                for layer in encoder.layers:
                    features = torch.relu(layer.norm(layer.linear(features)))
                    features = torch.cat([features, features.max(0).values.expand_as(features)], 1)
                expected = torch.relu(encoder.last.norm(encoder.last.linear(features))).max(0).values
                torch.testing.assert_close(row, expected, rtol=1e-4, atol=1e-5)


def test_at_most_35_points_of_a_voxel_count_whatever_their_order(rng):
    points = torch.from_numpy(rng.uniform(0, 1, (300, 5))).float()
    key = torch.from_numpy(np.repeat([9, 4, 7], [200, 20, 80]))
    kept, keys, member = grouped(points, key, 35)
    assert keys.tolist() == [4, 7, 9]
    assert member.bincount().tolist() == [20, 35, 35]
    shuffle = torch.from_numpy(rng.permutation(300))
    again = grouped(points[shuffle], key[shuffle], 35)[0]
    assert torch.equal(kept, again)
    rows = {tuple(row) for row in points[key == 9].tolist()}
    chosen = [tuple(row) for row in kept[member == 2].tolist()]
    assert set(chosen) <= rows
    assert len(set(chosen)) == 35
    first = points[key == 9][:, 0]  # no place is preferred: 35 of 200 uniform numbers have a mean near theirs
    assert abs(float(kept[member == 2][:, 0].mean() - first.mean())) < 4 * float(first.std()) / 35**0.5


def test_default_is_the_published_network_on_the_padded_grid():
    network = VoxelNet()
    assert VoxelNetConfig().grid.shape(8) == (10, 1256, 504)
    assert network.middle.channels == 128
    assert len(network.head.anchors) == 628 * 252 * 16
    assert network.backbone.channels == 768
    assert [layer.linear.weight.shape for layer in network.encoder.layers] == [(16, 7), (64, 32)]
    assert (DETECTORS["voxelnet"].network_class, DETECTORS["voxelnet"].config_class) == (VoxelNet, VoxelNetConfig)


@pytest.mark.parametrize(
    "change", [{"cell_m": (0.2, 0.3, 0.4)}, {"cell_m": (0.5, 0.5, 1.0)}, {"z_max_m": -4.0}, {"cell_m": (0, 0, 0)}]
)
def test_grids_that_cannot_work_are_refused(change):
    with pytest.raises(ValidationError, match=r"expected|greater"):
        VoxelNetConfig(grid=GRID.model_dump() | change)


def test_same_input_same_output_whatever_the_order_of_points(network, scene, rng):
    network.eval()
    cloud = cloud_of(network, scene.cloud())
    shuffled = cloud[torch.from_numpy(rng.permutation(len(cloud)))]
    with torch.no_grad():
        one, other = network(batch_of(cloud))[0], network(batch_of(shuffled))[0]
    assert torch.equal(one, other)


def test_low_precision_stays_near(network, scene):
    network.train()
    batch = batch_of(cloud_of(network, scene.cloud()))
    for _ in range(5):
        network(batch)
    network.eval()
    reduced = fold_batch_norm(network)
    for name in network.low_precision:
        reduced.get_submodule(name).bfloat16()
    with torch.no_grad():
        exact, near = network(batch), reduced(batch)
    for a, b in zip(exact, near, strict=True):
        assert b.dtype == torch.bfloat16
        assert (a - b).abs().mean() < 0.05 * a.abs().mean() + 1e-3
