"""What exported networks read, prepared in numpy: the same as the encoders of the detectors prepare in PyTorch."""

from itertools import product
from typing import Any

import numpy as np
import pytest
import torch
from small import small_detector

from farfield.detectors.exporting.plans import plan_of
from farfield.detectors.kradar.radar_detector import located
from farfield.detectors.onnx import points as in_numpy
from farfield.detectors.onnx.cells import neighbour_table, strided_table
from farfield.detectors.onnx.readings import SecondReading
from farfield.detectors.pointrcnn import points as in_torch
from farfield.detectors.sparse.cells import SparseTensor
from farfield.detectors.sparse.cells import neighbour_table as torch_table
from farfield.detectors.sparse.tables import strided_table as torch_strided

SHAPE = (5, 12, 9)


@pytest.fixture
def keys(rng: np.random.Generator) -> np.ndarray:
    """Occupied cells of a small grid, corners among them."""
    last = int(np.prod(SHAPE)) - 1
    return np.unique(np.concatenate([[0, SHAPE[2] - 1, last], rng.integers(0, last, 120)]))


@pytest.mark.parametrize("kernel", [(3, 3, 3), (1, 3, 3), (1, 5, 5)])
def test_neighbours_are_those_of_the_torch_table(keys: np.ndarray, kernel: tuple[int, int, int]) -> None:
    steps = list(product(*(range(-(size // 2), size // 2 + 1) for size in kernel)))
    expected = torch_table(torch.from_numpy(keys), torch.from_numpy(keys), SHAPE, steps)
    assert np.array_equal(neighbour_table(keys, keys, SHAPE, kernel), expected.numpy())


@pytest.mark.parametrize(
    ("kernel", "stride", "padding"),
    [
        ((3, 3, 3), (2, 2, 2), (1, 1, 1)),
        ((3, 3, 3), (2, 2, 2), (0, 1, 1)),
        ((3, 1, 1), (2, 1, 1), (0, 0, 0)),
        ((2, 2, 2), (2, 2, 2), (0, 0, 0)),
        ((5, 1, 1), (1, 1, 1), (0, 0, 0)),
    ],
)
def test_strided_outputs_and_their_inputs_are_those_of_the_torch_table(
    keys: np.ndarray, kernel: tuple[int, int, int], stride: tuple[int, int, int], padding: tuple[int, int, int]
) -> None:
    sparse = SparseTensor(torch.zeros(len(keys), 1), torch.from_numpy(keys), SHAPE, 1)
    expected = torch_strided(sparse, kernel, stride, padding)
    cells, shape, table = strided_table(keys, SHAPE, kernel, stride, padding)
    assert shape == expected.shape
    assert np.array_equal(cells, expected.keys.numpy())
    assert np.array_equal(table, expected.rows.numpy())


def test_no_cells_have_no_tables() -> None:
    none = np.zeros(0, dtype=np.int64)
    assert neighbour_table(none, none, SHAPE, (3, 3, 3)).shape == (0, 27)
    cells, _, table = strided_table(none, SHAPE, (3, 3, 3), (2, 2, 2), (1, 1, 1))
    assert (len(cells), table.shape) == (0, (0, 27))


def test_mean_voxels_are_those_of_the_network(rng: np.random.Generator) -> None:
    network = small_detector("second")
    points = rng.uniform([-2, -25, -7], [70, 25, 7], (4000, 3)).astype(np.float32)
    reading = SecondReading(
        columns=network.config.columns,
        grid=network.config.grid,
        multiple=network.multiple,
        features="farfield",
        positions="absolute",
        levels=({"kernel": (3, 3, 3), "stride": (2, 2, 2), "padding": (1, 1, 1), "followed": True},),
    )
    expected = network.voxels([torch.from_numpy(points)])
    cells, features = reading.mean_voxels(points, published=False, positions="absolute", max_points=0)
    assert np.array_equal(cells, expected.keys.numpy())
    assert np.allclose(features, expected.features.numpy(), rtol=0, atol=2e-6)


def test_points_are_chosen_and_grouped_as_in_torch(rng: np.random.Generator) -> None:
    cloud = rng.uniform([0, -20, -2], [60, 20, 2], (3000, 3)).astype(np.float32)
    tensor, lengths = torch.from_numpy(cloud), [len(cloud)]
    assert np.array_equal(in_numpy.content_rank(cloud), in_torch.content_rank(tensor).numpy())
    bands = in_torch.BandConfig(edges_m=(0.0, 30.0, 64.0), shares=(0.5, 0.5))
    band, shares = bands.of(tensor), bands.shares
    expected = in_torch.first_of_bands(band, shares, 700).numpy()
    assert np.array_equal(in_numpy.first_of_bands(band.numpy(), shares, 700), expected)
    chosen = in_numpy.farthest_of_one(cloud, 200)
    spread = in_torch.spread_points(tensor, lengths, 300)[0].numpy()
    assert np.array_equal(in_numpy.spread_points(cloud, 300), spread)
    (group,) = in_torch.ball_query(tensor, lengths, tensor[chosen], [200], radii_m=[2.0], limits=[16])
    centre, point = in_numpy.ball_query(cloud, cloud[chosen], 2.0, 16)
    assert np.array_equal(centre, group.centre.numpy())
    assert np.array_equal(point, group.point.numpy())
    row, weight = in_torch.three_nearest(tensor, lengths, tensor[chosen], [200])
    near, share = in_numpy.three_nearest(cloud, cloud[chosen])
    assert np.array_equal(near, row.numpy())
    assert np.allclose(share, weight.numpy(), atol=1e-6)


def test_points_of_proposals_are_those_of_torch(rng: np.random.Generator) -> None:
    cloud = rng.uniform([0, -20, -2], [60, 20, 2], (3000, 3)).astype(np.float32)
    rois = np.concatenate([cloud[:40], rng.uniform(1, 5, (40, 3)), rng.uniform(-3, 3, (40, 1))], 1).astype(np.float32)
    tensors = torch.from_numpy(cloud), torch.from_numpy(rois)
    expected = in_torch.points_in_rois(tensors[0], [3000], tensors[1], [40], context_m=1.0, limit=24)
    roi, point = in_numpy.points_in_rois(cloud, rois, 1.0, 24)
    assert np.array_equal(roi, expected.centre.numpy())
    assert np.array_equal(point, expected.point.numpy())
    lengths = np.bincount(roi, minlength=40).tolist()
    local = in_numpy.in_roi_frames(cloud[point], rois[roi])
    chosen, counts = in_torch.farthest_points(torch.from_numpy(local), lengths, 8)
    assert np.array_equal(in_numpy.farthest_of_groups(local, roi, 8), chosen.numpy())
    (group,) = in_torch.ball_query(
        torch.from_numpy(local), lengths, torch.from_numpy(local)[chosen], counts, radii_m=[0.8], limits=[6]
    )
    centre, near = in_numpy.ball_query_of_groups(local, roi, chosen.numpy(), 0.8, 6)
    assert np.array_equal(centre, group.centre.numpy())
    assert np.array_equal(near, group.point.numpy())


@pytest.mark.parametrize("form", ["published", "wide"])
def test_a_graph_reads_cells_below_the_limits_and_lifts_them_as_the_network_does(
    form: str, rng: np.random.Generator
) -> None:
    options = {"lifted_channels": 6} if form == "wide" else {"first_cell": "before it"}
    network = small_detector("rtnh", form=form, **options).eval()
    reading, graph = plan_of(network)
    grid = network.config.grid
    low, high = (-1.0, -grid.half_width_m - 1, grid.z_min_m - 1), (grid.range_m, grid.half_width_m, grid.z_max_m)
    columns = len(network.config.columns) - 3
    points = np.concatenate([rng.uniform(low, high, (500, 3)), rng.uniform(0, 2, (500, columns))], 1).astype(np.float32)
    inputs = {name: torch.from_numpy(np.asarray(value)) for name, value in reading.inputs(points).items()}
    expected = network.encoder([torch.from_numpy(points)])
    assert reading.located(points)[1].tolist() == located_keys(network, points)
    rows = graph.cell_rows(inputs)
    torch.testing.assert_close(rows, expected.features)
    assert rows.shape[1] == network.encoder.channels


def located_keys(network: Any, points: np.ndarray) -> list[int]:
    """The cells of the points that lie on the raster of a network."""
    encoder = network.encoder
    _, keys = located([torch.from_numpy(points)], encoder.grid, encoder.multiple, encoder.low_m)
    return list(map(int, keys))
