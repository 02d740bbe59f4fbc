"""Neighbour tables for a GPU: those of the rulebooks of pairs, found without them."""

from types import ModuleType

import pytest

torch = pytest.importorskip("torch")

from _gpu_cases import SHAPE, STRIDED, cells

from farfield.detectors.sparse import layers, strided_rulebook, submanifold_rulebook
from farfield.detectors.sparse.cells import SparseTensor
from farfield.detectors.sparse.tables import DeviceBook, strided_book, submanifold_book

SOME = [cells(0.4), cells(0.02), cells(1.0, 1), cells(0.4)[:1], cells(0.4)[:0]]


@pytest.mark.parametrize("keys", SOME)
@pytest.mark.parametrize("kernel", [(3, 3, 3), (1, 3, 3), (1, 1, 1), (5, 3, 1)])
def test_submanifold_tables_are_those_of_the_pairs(keys, kernel):
    book, pairs = submanifold_book(keys, SHAPE, kernel), submanifold_rulebook(keys, SHAPE, kernel)
    assert torch.equal(book.table, pairs.table)
    assert (book.shape, book.size, book.symmetric) == (pairs.shape, pairs.size, True)
    order, table = book.similar
    assert torch.equal(table, book.table[order])
    assert torch.equal(order.sort().values, torch.arange(len(keys)))
    with pytest.raises(ValueError, match="its own inverse"):
        _ = book.inverse


@pytest.mark.parametrize("keys", SOME)
@pytest.mark.parametrize(("kernel", "stride", "padding"), STRIDED)
def test_strided_tables_are_those_of_the_pairs_there_and_back(keys, kernel, stride, padding):
    book = strided_book(keys, SHAPE, kernel, stride, padding)
    pairs = strided_rulebook(keys, SHAPE, kernel, stride, padding)
    assert torch.equal(book.keys, pairs.keys)
    assert book.shape == pairs.shape
    assert torch.equal(book.table, pairs.table)
    assert torch.equal(book.inverse.table, pairs.inverse.table)
    assert book.inverse.inverse is book
    assert (book.inverse.shape, book.inverse.keys is keys) == (SHAPE, True)


def test_similar_rows_come_together_as_in_the_rulebook():
    keys = cells(0.4)
    order, _ = submanifold_book(keys, SHAPE, (3, 3, 3)).similar
    expected, table = submanifold_rulebook(keys, SHAPE, (3, 3, 3)).similar
    missing = table == len(keys)
    assert torch.equal((submanifold_book(keys, SHAPE, (3, 3, 3)).table[order] == len(keys)).sum(1), missing.sum(1))
    assert len(order) == len(expected)


def test_an_even_kernel_is_refused():
    with pytest.raises(ValueError, match="odd along every axis"):
        submanifold_book(cells(0.4), SHAPE, (2, 3, 3))


def _product(features, weight, order, table, bias=None, relu=False, added=None):
    padded = torch.cat([features, features.new_zeros(1, features.shape[1])])
    made = torch.einsum("nki,kio->no", padded[table.long()], weight)
    made = torch.empty_like(made).index_copy_(0, order, made) + (0 if bias is None else bias)
    made = made if added is None else made + added
    return made.relu() if relu else made


def _weight_gradient(features, gradient, order, table):
    padded = torch.cat([features, features.new_zeros(1, features.shape[1])])
    return torch.einsum("nki,no->kio", padded[table.long()], gradient[order])


def looked_up():
    """The kernels' work, done plainly from the table."""
    module = ModuleType("looked_up")
    module.gather_product, module.weight_gradient = _product, _weight_gradient
    return module


def test_layers_with_tables_compute_and_learn_as_with_pairs(monkeypatch):
    torch.manual_seed(0)
    network = layers.SparseSequential(
        layers.SubmanifoldConv(4, 8),
        layers.SparseConv(8, 12, book="down"),
        layers.SubmanifoldConv(12, 12),
        layers.InverseConv(12, 6, (3, 3, 3), "down", bias=True),
    )
    keys, results = cells(0.4), []
    values = torch.randn(len(keys), 4)
    for kernels in (False, True):
        if kernels:
            monkeypatch.setattr(layers, "has_kernels", lambda device, dtype: True)
            monkeypatch.setattr(layers, "_import_kernels", looked_up)
        given = values.clone().requires_grad_()
        sparse = SparseTensor(given, keys, SHAPE, 3)
        out = network(sparse)
        network.zero_grad()
        (out.features * out.features.detach().cos()).sum().backward()
        results.append([out.features, given.grad, *(parameter.grad.clone() for parameter in network.parameters())])
        assert any(isinstance(book, DeviceBook) for book in sparse.rulebooks.values()) is kernels
    for expected, got in zip(*results, strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-5)
