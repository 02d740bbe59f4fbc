import math

import numpy as np
import pytest
from pydantic import ValidationError

torch = pytest.importorskip("torch")

from farfield.detectors.config import VoxelGridConfig
from farfield.detectors.voxels import mean_voxels, voxel_keys

COLUMNS = ("x_m", "y_m", "z_m", "intensity", "lag_s")
GRID = VoxelGridConfig(range_m=20.0, half_width_m=5.0, z_min_m=-3.0, z_max_m=1.0, cell_m=(0.5, 0.4, 0.8))


def random_cloud(seed, count=3000):
    rng = np.random.default_rng(seed)
    low, high = [-1, -6, -4, 0, 0], [22, 6, 2, 1, 0.5]
    # a coarse cluster, so that many voxels hold several points
    points = rng.uniform(low, high, (count, 5))
    points[: count // 2, :3] = rng.normal([10, 1, -1], 0.5, (count // 2, 3))
    return torch.from_numpy(points.astype(np.float32))


def brute_force(clouds, multiple):
    """Points of each voxel, by a loop in double precision."""
    y_min = GRID.y_min_m(multiple)
    depth, nx, ny = GRID.shape(multiple)
    voxels = {}
    for frame, cloud in enumerate(clouds):
        for point in cloud.double().tolist():
            cell = (
                frame,
                math.floor((point[2] + 3.0) / 0.8),
                math.floor(point[0] / 0.5),
                math.floor((point[1] - y_min) / 0.4),
            )
            if 0 <= cell[1] < depth and 0 <= cell[2] < nx and 0 <= cell[3] < ny:
                voxels.setdefault(cell, []).append(point)
    return {cell: np.array(voxels[cell]) for cell in sorted(voxels)}


def test_shape_pads_both_sides_and_keeps_published_sizes():
    assert GRID.shape(8) == (5, 40, 32)
    assert GRID.y_min_m(8) == pytest.approx(-6.4)
    voxelnet = VoxelGridConfig(cell_m=(0.2, 0.2, 0.4), z_min_m=-3.0, z_max_m=1.0)
    assert voxelnet.shape(1) == (10, 1250, 500)
    assert voxelnet.shape(8) == (10, 1256, 504)
    second = VoxelGridConfig(
        range_m=70.4, half_width_m=40.0, z_min_m=-3.0, z_max_m=1.0, cell_m=(0.05, 0.05, 0.1), extra_layers=1
    )
    assert second.shape(8) == (41, 1408, 1600)


@pytest.mark.parametrize("multiple", [1, 8])
def test_mean_features_by_brute_force(multiple):
    clouds = [random_cloud(1), torch.zeros(0, 5), random_cloud(2)]
    sparse = mean_voxels(clouds, GRID, multiple, columns=COLUMNS)
    truth = brute_force(clouds, multiple)
    assert sparse.batch_size == 3
    assert sparse.shape == GRID.shape(multiple)
    assert [tuple(row) for row in sparse.indices().tolist()] == list(truth)
    assert max(len(points) for points in truth.values()) > 5
    rows = []
    for (_, iz, ix, iy), points in truth.items():
        mean = points.mean(axis=0)
        centre = [(ix + 0.5) * 0.5, (iy + 0.5) * 0.4 + GRID.y_min_m(multiple), (iz + 0.5) * 0.8 - 3.0]
        rows.append(
            [*(mean[:3] - centre) / [0.5, 0.4, 0.8], *mean[:3] / [20, 5, 3], math.log1p(len(points)), mean[3], mean[4]]
        )
    np.testing.assert_allclose(sparse.features.numpy(), rows, atol=2e-5)
    published = mean_voxels(clouds, GRID, multiple, columns=COLUMNS, published=True).features.numpy()
    np.testing.assert_allclose(published, [points.mean(axis=0)[:4] for points in truth.values()], atol=2e-5)


@pytest.mark.parametrize(("flags", "width"), [({}, 7), ({"columns": COLUMNS[:4]}, 8), ({"columns": COLUMNS}, 9)])
def test_flags_add_features(flags, width):
    sparse = mean_voxels([random_cloud(3)], GRID, 8, **flags)
    assert sparse.features.shape[1] == width
    assert sparse.features[:, :6].abs().max() < 1.3


def test_same_points_give_the_same_bytes_and_any_order_the_same_voxels():
    cloud = random_cloud(4)
    first, again = (mean_voxels([cloud], GRID, 8) for _ in range(2))
    assert torch.equal(first.features, again.features)
    shuffled = mean_voxels([cloud[torch.randperm(len(cloud), generator=torch.Generator().manual_seed(0))]], GRID, 8)
    assert torch.equal(first.keys, shuffled.keys)
    torch.testing.assert_close(first.features, shuffled.features, atol=1e-5, rtol=0)


def test_points_outside_or_not_finite_are_dropped():
    inside = [10.0, 0.0, 0.0, 0.5, 0.0]
    outside = [[-0.01, 0, 0, 0, 0], [20.01, 0, 0, 0, 0], [10, 5.01, 0, 0, 0], [10, 0, -3.01, 0, 0], [10, 0, 1.01, 0, 0]]
    broken = [[math.nan, 0, 0, 0, 0], [10, math.inf, 0, 0, 0], [10, 0, -math.inf, 0, 0], [1e30, 0, 0, 0, 0]]
    points = torch.tensor([*outside, inside, *broken])
    rows, key = voxel_keys(points, torch.zeros(len(points), dtype=torch.int64), GRID, 1)
    assert rows.tolist() == [len(outside)]
    assert len(key) == 1
    sparse = mean_voxels([points], GRID, 1, columns=COLUMNS)
    assert len(sparse.keys) == 1
    assert sparse.features.isfinite().all()


def test_empty_clouds_give_empty_voxels():
    sparse = mean_voxels([torch.zeros(0, 5), torch.zeros(0, 5)], GRID, 8)
    assert sparse.features.shape == (0, 7)
    assert sparse.batch_size == 2


@pytest.mark.parametrize(
    "wrong",
    [
        {"cell_m": (0.0, 0.1, 0.1)},
        {"cell_m": (0.1, -0.1, 0.1)},
        {"cell_m": (0.001, 0.001, 0.001)},
        {"cell_m": (math.nan, 0.1, 0.1)},
        {"z_min_m": 1.0, "z_max_m": 1.0},
        {"range_m": math.inf},
        {"half_width_m": 0.0},
        {"extra_layers": -1},
    ],
)
def test_senseless_grids_are_refused(wrong):
    with pytest.raises(ValidationError):
        VoxelGridConfig(**wrong)


def test_the_order_of_a_clouds_points_changes_no_mean():
    cloud = random_cloud(4, 20_000)
    order = torch.from_numpy(np.random.default_rng(5).permutation(len(cloud)))
    as_read, shuffled = (mean_voxels([rows], GRID, 4, columns=COLUMNS) for rows in (cloud, cloud[order]))
    assert torch.equal(as_read.features, shuffled.features)
