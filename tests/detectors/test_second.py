import numpy as np
import pytest
from pydantic import ValidationError

torch = pytest.importorskip("torch")

from small import batch_of, cloud_of, small_detector

from farfield.detectors.config import VoxelGridConfig
from farfield.detectors.second.network import Second, SecondConfig, SparseMiddle, folded_layers, stack_z
from farfield.detectors.sparse import SparseTensor

PUBLISHED = VoxelGridConfig(
    range_m=70.4, half_width_m=40.0, z_min_m=-3.0, z_max_m=1.0, cell_m=(0.05, 0.05, 0.1), extra_layers=1
)


def test_published_grid_leads_to_the_published_maps():
    with torch.device("meta"):
        network = Second(SecondConfig(grid=PUBLISHED, widths=(128, 256), neck_width=256, middle_out=128))
    assert PUBLISHED.shape(network.multiple) == (41, 1408, 1600)
    assert folded_layers(41) == 2
    assert network.backbone.blocks[0][0][0].in_channels == 256
    assert (network.head.anchors.nx, network.head.anchors.ny, network.head.in_channels) == (176, 200, 512)


def test_default_covers_the_range_asked_for():
    with torch.device("meta"):
        network = Second()
    grid = network.config.grid
    assert (grid.range_m, grid.half_width_m) == (250.0, 50.0)
    assert network.head.anchors.nx * network.head.anchors.cell_m >= 250.0
    assert network.head.anchors.y_min_m <= -50.0


@pytest.mark.parametrize("layers", [10, 24])
def test_a_grid_too_thin_for_the_strides_is_refused_with_the_least_that_fits(layers):
    with pytest.raises(ValidationError, match=f"at least 25 layers.*got {layers}"):
        SecondConfig(grid=VoxelGridConfig(z_min_m=-3.0, z_max_m=1.0, cell_m=(0.2, 0.2, 4.0 / layers)))
    SecondConfig(grid=VoxelGridConfig(z_min_m=-3.0, z_max_m=1.0, cell_m=(0.2, 0.2, 4.0 / 25)))


def test_oblong_voxels_are_refused():
    with pytest.raises(ValidationError, match="as long as wide"):
        SecondConfig(grid=VoxelGridConfig(cell_m=(0.1, 0.2, 0.2)))


def random_sparse(rng, channels, shape=(27, 16, 24), cells=150, batch=2):
    indices = np.unique(np.column_stack([rng.integers(0, n, cells) for n in (batch, *shape)]), axis=0)
    features = torch.from_numpy(rng.normal(size=(len(indices), channels))).float()
    return SparseTensor.from_indices(features, torch.from_numpy(indices), shape, batch)


def test_middle_equals_dense_convolutions_kept_to_the_reached_cells(rng):
    sparse, middle = random_sparse(rng, 5), SparseMiddle(5, (4, 6, 8, 8), 12).eval()
    steps = [(1, 1)] * 2 + [(2, 1), (1, 1), (1, 1)] * 2 + [(2, (0, 1, 1)), (1, 1), (1, 1), ((2, 1, 1), 0)]
    value, occupied = sparse.dense(), (sparse.dense().abs().sum(1, keepdim=True) > 0).float()
    with torch.no_grad():
        for block, (stride, padding) in zip(middle, steps, strict=True):
            for norm in (block.norm,):
                norm.running_mean.copy_(torch.from_numpy(rng.normal(size=norm.num_features)))
                norm.running_var.copy_(torch.from_numpy(rng.uniform(0.5, 2, norm.num_features)))
            kernel = block.conv.kernel
            weight = block.conv.weight.view(*kernel, *block.conv.weight.shape[1:]).permute(4, 3, 0, 1, 2)
            value = torch.nn.functional.conv3d(value, weight, stride=stride, padding=padding)
            if stride != 1:
                ones = torch.ones(1, 1, *kernel)
                occupied = (torch.nn.functional.conv3d(occupied, ones, stride=stride, padding=padding) > 0).float()
            norm = block.norm
            value = (value - norm.running_mean.view(-1, 1, 1, 1)) / (norm.running_var.view(-1, 1, 1, 1) + 1e-3).sqrt()
            value = torch.relu(value) * occupied
        found = middle(sparse).dense()
    assert found.shape == (2, 12, folded_layers(27), 2, 3)
    assert found.abs().sum() > 0
    torch.testing.assert_close(found, value, rtol=1e-4, atol=1e-5)


def test_stacked_layers_are_those_of_the_dense_grid(rng):
    sparse = random_sparse(rng, 3, shape=(4, 5, 6), cells=40)
    image = stack_z(sparse)
    assert image.is_contiguous(memory_format=torch.channels_last)
    dense = sparse.dense()
    torch.testing.assert_close(image, dense.transpose(1, 2).reshape(2, 12, 5, 6))


def test_half_precision_boxes_are_near_those_of_full_precision(scene):
    network = small_detector("second").eval()
    batch = batch_of(cloud_of(network, scene.cloud()))
    with torch.no_grad():
        full = network(batch).logits
        for name in network.low_precision:
            network.get_submodule(name).bfloat16()
        half = network(batch).logits
    assert half.dtype == torch.bfloat16
    torch.testing.assert_close(half.float(), full, rtol=0.05, atol=0.05)
