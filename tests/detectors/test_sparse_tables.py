"""Sparse convolution by neighbour tables, beside pairs and PyTorch's dense convolution."""

import pytest

torch = pytest.importorskip("torch")

from torch.nn.functional import conv3d

from farfield.detectors.sparse import SparseConv, SparseTensor, SubmanifoldConv
from farfield.detectors.sparse.rulebook import Rulebook, strided_rulebook, submanifold_rulebook
from farfield.detectors.sparse.tables import NeighbourTable, strided_table, submanifold_table, table_product

SHAPE = (6, 11, 8)
STRIDED = [
    ((3, 3, 3), (1, 1, 1), (1, 1, 1)),
    ((3, 3, 3), (2, 2, 2), (1, 1, 1)),
    ((3, 3, 3), (2, 1, 1), (1, 1, 1)),
    ((6, 1, 1), (1, 1, 1), (0, 0, 0)),
    ((3, 3, 3), (1, 1, 1), (2, 2, 2)),  # outputs beyond the grid of the inputs
    ((2, 2, 2), (2, 2, 2), (0, 0, 0)),
    ((3, 5, 1), (2, 3, 1), (0, 1, 0)),
]


def cells(share=0.3, channels=5, batch=3, dtype=torch.float64) -> SparseTensor:
    """Cells in all frames but the second."""
    generator = torch.Generator().manual_seed(0)
    occupied = torch.rand((batch, *SHAPE), generator=generator) < share
    occupied[1] = False
    indices = occupied.nonzero()
    features = torch.randn(len(indices), channels, generator=generator, dtype=torch.float64).to(dtype)
    return SparseTensor.from_indices(features, indices, SHAPE, batch)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("kernel", [(3, 3, 3), (1, 3, 3), (5, 1, 3)])
def test_a_submanifold_table_is_that_of_the_pairs(kernel, share):
    sparse = cells(share)
    table = submanifold_table(sparse, kernel)
    pairs = submanifold_rulebook(sparse.keys, SHAPE, kernel)
    assert table.keys is sparse.keys
    assert torch.equal(table.rows, pairs.table)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(("kernel", "stride", "padding"), STRIDED)
def test_a_strided_table_is_that_of_the_pairs(kernel, stride, padding, share):
    sparse = cells(share)
    table = strided_table(sparse, kernel, stride, padding)
    pairs = strided_rulebook(sparse.keys, SHAPE, kernel, stride, padding)
    assert table.shape == pairs.shape
    assert torch.equal(table.keys, pairs.keys)
    by_element = torch.full_like(table.rows, len(sparse.keys))
    for number, run in pairs.elements():
        by_element[pairs.targets[run].long(), number] = pairs.sources[run]
    assert torch.equal(table.rows, by_element)


@pytest.mark.parametrize(("kernel", "stride", "padding"), STRIDED)
@pytest.mark.parametrize("bias", [False, True])
def test_its_product_is_pytorchs_dense_convolution(kernel, stride, padding, bias, monkeypatch):
    monkeypatch.setattr("farfield.detectors.sparse.tables._ROWS", 50)  # several blocks and a rest
    sparse = cells()
    weight = torch.randn(kernel[0] * kernel[1] * kernel[2], 5, 7, dtype=torch.float64)
    shift = torch.randn(7, dtype=torch.float64) if bias else None
    table = strided_table(sparse, kernel, stride, padding)
    out = SparseTensor(table_product(sparse.features, weight, table.rows, shift), table.keys, table.shape, 3)
    dense = conv3d(sparse.dense(), weight.view(*kernel, 5, 7).permute(4, 3, 0, 1, 2), shift, stride, padding)
    b, z, x, y = out.indices().unbind(1)
    torch.testing.assert_close(out.features, dense[b, :, z, x, y], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("layer", [SubmanifoldConv(5, 7), SparseConv(5, 7), SparseConv(5, 7, stride=(1, 1, 1))])
def test_layers_take_tables_for_close_cells_in_half_precision_without_gradients(layer):
    layer = layer.bfloat16()
    apart = cells(dtype=torch.bfloat16)
    close = SparseTensor(apart.features, apart.keys, SHAPE, 3, close=True)
    assert isinstance(layer.rulebook(close), Rulebook)  # gradients may be asked for
    with torch.no_grad():
        assert isinstance(layer.rulebook(apart), Rulebook)
        assert isinstance(layer.rulebook(close), NeighbourTable)
        assert layer.rulebook(close) is layer.rulebook(close)
        by_pairs, by_table = layer(apart), layer(close)
        assert by_table.close
        assert isinstance(layer.float().rulebook(close), Rulebook)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            assert isinstance(layer.rulebook(close), NeighbourTable)
    assert torch.equal(by_table.keys, by_pairs.keys)
    torch.testing.assert_close(by_table.features, by_pairs.features, rtol=0.02, atol=0.02)


def test_a_named_layer_keeps_the_pairs_for_its_way_back():
    close = SparseTensor(cells().features.bfloat16(), cells().keys, SHAPE, 3, close=True)
    with torch.no_grad():
        assert isinstance(SparseConv(5, 7, book="down").bfloat16().rulebook(close), Rulebook)


def test_an_even_submanifold_kernel_is_refused():
    with pytest.raises(ValueError, match="odd along every axis"):
        submanifold_table(cells(), (2, 3, 3))


def test_no_rows_are_multiplied_whatever_the_number_of_threads(monkeypatch):
    """Large kernels go to oneDNN where there are several threads; it takes no empty image."""
    from farfield.detectors.sparse import layers

    monkeypatch.setattr(layers, "_has_onednn", lambda: True)
    out = torch.full((0, 64), 1.0)
    layers._multiply(torch.zeros(0, 64), torch.zeros(64, 64), out)
    assert out.shape == (0, 64)
