import pytest

torch = pytest.importorskip("torch")

from torch import nn
from torch.nn.functional import conv3d, conv_transpose3d

from farfield.detectors.sparse import (
    InverseConv,
    SparseBlock,
    SparseConv,
    SparseSequential,
    SparseTensor,
    SubmanifoldConv,
    cells,
    dilate,
    kernel_offsets,
    layers,
    neighbour_table,
    rulebook,
    submanifold_rulebook,
)

SHAPE = (7, 12, 10)


def random_sparse(seed=0, shape=SHAPE, batch=2, channels=5, share=0.2, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    occupied = torch.rand((batch, *shape), generator=generator) < share
    indices = occupied.nonzero()
    features = torch.randn(len(indices), channels, generator=generator, dtype=torch.float64).to(dtype)
    order = torch.randperm(len(indices), generator=generator)
    return SparseTensor.from_indices(features[order], indices[order], shape, batch)


def dense_weight(layer):
    """(K, c_in, c_out) to the layout of conv3d."""
    return layer.weight.view(*layer.kernel, layer.c_in, layer.c_out).permute(4, 3, 0, 1, 2)


def at_sites(dense, sparse):
    b, z, x, y = sparse.indices().unbind(1)
    return dense[b, :, z, x, y]


def gradients_of(value, seed, *leaves):
    cotangent = torch.randn(value.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.autograd.grad((value * cotangent.to(value.dtype)).sum(), leaves)


def compare(layer, sparse, dense_of):
    """Values and gradients of a layer against ``dense_of(dense input, dense weight)`` taken at the output sites."""
    features = sparse.features.clone().requires_grad_()
    out = layer(sparse.replace(features))
    expected = at_sites(dense_of(sparse.replace(features).dense(), dense_weight(layer)), out)
    torch.testing.assert_close(out.features, expected)
    leaves = [features, *layer.parameters()]
    for got, want in zip(gradients_of(out.features, 1, *leaves), gradients_of(expected, 1, *leaves), strict=True):
        torch.testing.assert_close(got, want)
    return out


@pytest.mark.parametrize("kernel", [(3, 3, 3), (1, 3, 3), (3, 1, 1), (1, 1, 1), (5, 3, 1), (1, 1, 5)])
@pytest.mark.parametrize("bias", [False, True])
def test_submanifold_is_dense_at_the_sites(kernel, bias):
    layer = SubmanifoldConv(5, 6, kernel, bias).double()
    padding = tuple(size // 2 for size in kernel)
    out = compare(layer, random_sparse(), lambda x, w: conv3d(x, w, layer.bias, padding=padding))
    assert out.shape == SHAPE


STRIDED = [
    ((3, 3, 3), (2, 2, 2), (1, 1, 1)),
    ((3, 3, 3), (2, 2, 2), (0, 1, 1)),
    ((3, 3, 3), (1, 1, 1), (1, 1, 1)),
    ((3, 1, 1), (2, 1, 1), (0, 0, 0)),
    ((2, 2, 2), (2, 2, 2), (0, 0, 0)),
    ((1, 4, 2), (1, 3, 2), (0, 2, 1)),
    ((1, 1, 1), (2, 2, 2), (0, 0, 0)),
]


@pytest.mark.parametrize(("kernel", "stride", "padding"), STRIDED)
def test_strided_is_dense_and_complete(kernel, stride, padding):
    layer = SparseConv(5, 6, kernel, stride, padding).double()
    sparse = random_sparse(share=0.05)
    out = compare(layer, sparse, lambda x, w: conv3d(x, w, stride=stride, padding=padding))
    ones = sparse.replace(torch.ones_like(sparse.features[:, :1])).dense()
    reached = conv3d(ones, torch.ones(1, 1, *kernel, dtype=ones.dtype), stride=stride, padding=padding) > 0
    torch.testing.assert_close(out.indices(), reached[:, 0].nonzero())
    assert out.shape == tuple(reached.shape[2:])


@pytest.mark.parametrize(("kernel", "stride", "padding"), STRIDED)
def test_inverse_is_transposed_convolution_at_the_inputs(kernel, stride, padding):
    sparse = random_sparse(share=0.1)
    down = SparseConv(5, 4, kernel, stride, padding, book="down").double()
    up = InverseConv(4, 3, kernel, book="down").double()
    middle = down(sparse)
    middle = middle.replace(middle.features.detach())

    def transposed(x, w):
        size = [(n - 1) * s - 2 * p + k for n, s, p, k in zip(x.shape[2:], stride, padding, kernel, strict=True)]
        extra = [n - m for n, m in zip(SHAPE, size, strict=True)]
        return conv_transpose3d(x, w.transpose(0, 1), stride=stride, padding=padding, output_padding=extra)

    back = compare(up, middle, transposed)
    torch.testing.assert_close(back.keys, sparse.keys)
    assert back.shape == sparse.shape


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.bfloat16, 0.03), (torch.float16, 4e-3)])
def test_precisions(dtype, tolerance):
    sparse = random_sparse(channels=16, share=0.3)
    for layer in (SubmanifoldConv(16, 32), SparseConv(16, 32, (3, 3, 3), (2, 2, 2), (1, 1, 1))):
        exact = layer.double()(sparse).features
        got = layer.to(dtype)(sparse.replace(sparse.features.to(dtype))).features
        assert got.dtype == dtype
        assert (got.double() - exact).abs().max() < tolerance * exact.abs().max()


@pytest.mark.parametrize(
    "ways",
    [{"_has_onednn": lambda: True, "_LARGE_KERNEL": 0}, {"_has_onednn": lambda: False}, {"_MAX_PRODUCT_BYTES": 0}],
)
def test_every_way_to_multiply_agrees(ways, monkeypatch):
    for name, value in ways.items():
        monkeypatch.setattr(layers, name, value)
    sparse = random_sparse(channels=16, dtype=torch.float32)
    for layer in (SubmanifoldConv(16, 24, bias=True), SparseConv(16, 24, bias=True)):
        results = []
        for dtype in (torch.float32, torch.float64):
            features = sparse.features.to(dtype).requires_grad_()
            out = layer.to(dtype)(sparse.replace(features)).features
            with torch.no_grad():
                again = layer(sparse.replace(features)).features
            results.append([out, again, *gradients_of(out, 4, features, *layer.parameters())])
        for got, exact in zip(*results, strict=True):
            assert (got - exact).abs().max() < 3e-6 * exact.abs().max()


def test_table_holds_the_pairs_and_similar_rows_come_together():
    sparse = random_sparse()
    book = submanifold_rulebook(sparse.keys, SHAPE, (3, 3, 3))
    expected = neighbour_table(sparse.keys, sparse.keys, SHAPE, kernel_offsets((3, 3, 3)))
    assert torch.equal(book.table, expected)
    order, table = book.similar
    assert torch.equal(table, expected[order])
    assert sorted(order.tolist()) == list(range(len(expected)))

    def needless(rows):
        return sum(int((block < len(expected)).any(0).sum()) for block in rows.split(16))

    assert needless(table) < needless(expected)


@pytest.mark.parametrize("short", [0, 2**15])
def test_pairs_of_each_output_come_together(short, monkeypatch):
    monkeypatch.setattr(rulebook, "_SHORT", short)
    book = submanifold_rulebook(random_sparse(share=0.7).keys, SHAPE, (3, 3, 3))
    order, starts = book.by_target
    held = book.targets[order].tensor_split(starts[1:])
    assert [set(bag.tolist()) for bag in held] == [{row} for row in range(len(book.keys))]
    assert sorted(order.tolist()) == (book.targets < len(book.keys)).nonzero().squeeze(1).tolist()


def test_rulebooks_can_be_found_first():
    sparse, one_by_one = random_sparse(dtype=torch.float32), backbone()
    planned = SparseSequential(*one_by_one)
    cells = planned.plan(sparse)
    found = dict(sparse.rulebooks)
    out = planned(sparse)
    assert sparse.rulebooks == found
    assert cells.shape == out.shape
    assert torch.equal(cells.keys, out.keys)
    expected = one_by_one(SparseTensor(sparse.features, sparse.keys.clone(), SHAPE, 2))
    torch.testing.assert_close(out.features, expected.features)


def test_autocast_computes_in_bfloat16_and_keeps_gradients_in_float32():
    layer = SubmanifoldConv(16, 8)
    sparse = random_sparse(channels=16, dtype=torch.float32)
    exact = gradients_of(layer(sparse).features, 2, layer.weight)[0]
    with torch.autocast("cpu", torch.bfloat16):
        out = layer(sparse)
    assert out.features.dtype == torch.bfloat16
    gradient = gradients_of(out.features, 2, layer.weight)[0]
    assert gradient.dtype == torch.float32
    assert (gradient - exact).abs().max() < 0.03 * exact.abs().max()


def backbone():
    return nn.Sequential(
        SparseBlock(SubmanifoldConv(5, 8), nn.BatchNorm1d(8)),
        SparseBlock(SparseConv(8, 12, book="down"), nn.BatchNorm1d(12)),
        SparseBlock(SubmanifoldConv(12, 12), nn.BatchNorm1d(12), relu=False),
        SparseBlock(InverseConv(12, 4, (3, 3, 3), book="down"), nn.BatchNorm1d(4)),
    )


@pytest.mark.parametrize("cells", [0, 1])
@pytest.mark.parametrize("training", [True, False])
def test_empty_and_single_cells_survive_both_ways(cells, training):
    network = backbone().train(training)
    indices = torch.tensor([[0, 1, 2, 3]])[:cells]
    features = torch.ones(cells, 5, requires_grad=True)
    out = network(SparseTensor.from_indices(features, indices, SHAPE, 2))
    assert out.features.shape == (cells, 4)
    out.dense().sum().backward()
    for value in (features, *network.parameters()):
        assert value.grad is not None
        assert value.grad.isfinite().all()


def test_folding_keeps_the_function():
    network = backbone().double()
    sparse = random_sparse()
    for _ in range(3):
        network(sparse)
    network.eval()
    with torch.no_grad():
        expected = network(sparse).features
        for block in network:
            block.fold_norm()
            assert isinstance(block.norm, nn.Identity)
        torch.testing.assert_close(network(sparse).features, expected)


def test_layers_share_rulebooks_and_frames_do_not_mix():
    sparse = random_sparse(batch=2, dtype=torch.float32)
    network = backbone().eval()
    whole = network(sparse).dense()
    assert sum(key != "down" for key in sparse.rulebooks) == 3
    per_frame = sparse.indices()[:, 0]
    for frame in range(2):
        mine = per_frame == frame
        indices = sparse.indices()[mine] * torch.tensor([0, 1, 1, 1])
        alone = network(SparseTensor.from_indices(sparse.features[mine], indices, SHAPE, 1)).dense()
        torch.testing.assert_close(alone[0], whole[frame])


def test_dense_is_differentiable_and_indices_round_trip():
    sparse = random_sparse()
    features = sparse.features.clone().requires_grad_()
    dense = sparse.replace(features).dense()
    torch.testing.assert_close(at_sites(dense, sparse), features)
    torch.testing.assert_close(gradients_of(at_sites(dense, sparse), 3, features), gradients_of(features, 3, features))
    assert (dense != 0).sum() == (sparse.features != 0).sum()


BITMAP_LIMITS = [2**30, 0]  # look-up in a bitmap, binary search


@pytest.mark.parametrize("limit", BITMAP_LIMITS)
def test_neighbours_and_dilation_by_brute_force(limit, monkeypatch):
    monkeypatch.setattr(cells, "_MAX_BITMAP_CELLS", limit)
    sparse = random_sparse(share=0.1)
    offsets = kernel_offsets((3, 3, 5))
    place = {tuple(row): number for number, row in enumerate(sparse.indices().tolist())}
    table = neighbour_table(sparse.keys, sparse.keys[::3], SHAPE, offsets).tolist()
    for row, (b, z, x, y) in zip(table, sparse.indices()[::3].tolist(), strict=True):
        assert row == [place.get((b, z + dz, x + dx, y + dy), len(place)) for dz, dx, dy in offsets]
    grown = {
        (b, z + dz, x + dx, y + dy)
        for b, z, x, y in place
        for dz, dx, dy in [*offsets, (0, 0, 0)]
        if 0 <= z + dz < SHAPE[0] and 0 <= x + dx < SHAPE[1] and 0 <= y + dy < SHAPE[2]
    }
    dilated = SparseTensor(torch.zeros(len(grown), 1), dilate(sparse.keys, SHAPE, offsets), SHAPE, 2)
    assert dilated.indices().tolist() == [list(cell) for cell in sorted(grown)]


@pytest.mark.parametrize("limit", BITMAP_LIMITS)
@pytest.mark.parametrize("share", [0.02, 0.5, 1.0])
def test_pairs_of_neighbours_by_brute_force(share, limit, monkeypatch):
    monkeypatch.setattr(cells, "_MAX_BITMAP_CELLS", limit)
    shape, offsets = (3, 5, 70), kernel_offsets((3, 1, 5))[:7]  # lines of more than two words
    sparse = random_sparse(share=share, shape=shape)
    place = {tuple(row): number for number, row in enumerate(sparse.indices().tolist())}
    mine, theirs, counts = cells.neighbour_pairs(sparse.keys, shape, offsets)
    truth = [
        [(row, place[near]) for (b, z, x, y), row in place.items() if (near := (b, z + dz, x + dx, y + dy)) in place]
        for dz, dx, dy in offsets
    ]
    assert counts == tuple(len(pairs) for pairs in truth)
    assert list(zip(mine.tolist(), theirs.tolist(), strict=True)) == [pair for pairs in truth for pair in pairs]


def test_a_grid_beyond_32_bits_is_searched():
    shape = (40, 20_000, 20_000)
    indices = torch.tensor([[0, 39, 19_999, 19_998], [0, 39, 19_999, 19_999], [0, 0, 0, 0], [0, 38, 19_998, 19_999]])
    sparse = SparseTensor.from_indices(torch.ones(4, 1), indices, shape, 1)
    out = SubmanifoldConv(1, 1).requires_grad_(False)
    out.weight.fill_(1)
    assert out(sparse).features[:, 0].tolist() == [1, 3, 3, 3]
    strided = SparseConv(1, 1).requires_grad_(False)(sparse)
    assert strided.indices().tolist() == [[0, 0, 0, 0], [0, 19, 9999, 9999]]


def test_count_of_bits():
    words = torch.randint(0, 2**31, (1000,), generator=torch.Generator().manual_seed(0), dtype=torch.int32)
    words[:3] = torch.tensor([0, 1, 2**31 - 1])
    expected = [bin(word).count("1") for word in words.tolist()]
    assert cells._count_bits(words).tolist() == expected


def test_what_cannot_work_is_refused():
    sparse = random_sparse(dtype=torch.float32)
    with pytest.raises(ValueError, match="odd along every axis"):
        SubmanifoldConv(5, 5, (2, 3, 3))(sparse)
    with pytest.raises(ValueError, match="holds kernel"):
        SparseConv(5, 5, (11, 3, 3))(sparse)
    with pytest.raises(ValueError, match="book='up'"):
        InverseConv(5, 5, (3, 3, 3), book="up")(sparse)
    with pytest.raises(ValueError, match="some twice"):
        SparseTensor.from_indices(torch.zeros(2, 1), torch.zeros(2, 4, dtype=torch.int64), SHAPE, 1)
    with pytest.raises(ValueError, match="some outside"):
        SparseTensor.from_indices(torch.zeros(1, 1), torch.tensor([[0, 7, 0, 0]]), SHAPE, 1)
    with pytest.raises(ValueError, match="int64 keys"):
        SparseTensor(torch.zeros(2, 1), torch.zeros(3, dtype=torch.int64), SHAPE, 1)


@pytest.mark.gpu
@pytest.mark.parametrize("triton", [True, False])
def test_gpu_gives_what_the_cpu_gives(triton, monkeypatch):
    if not triton:
        monkeypatch.setattr(layers, "_import_kernels", lambda: None)
    results = []
    for device in ("cpu", "cuda"):
        torch.manual_seed(0)
        network = backbone().to(device)
        sparse = random_sparse(dtype=torch.float32)
        features = sparse.features.to(device).requires_grad_()
        out = network(SparseTensor(features, sparse.keys.to(device), SHAPE, 2)).features
        (out * out.detach().cos()).sum().backward()
        results.append([out, features.grad, *(parameter.grad for parameter in network.parameters())])
    for expected, got in zip(*results, strict=True):
        torch.testing.assert_close(got.cpu(), expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16])
def test_a_kernel_of_one_cell_is_a_product_of_rows(dtype):
    sparse, layer = random_sparse(dtype=dtype), SubmanifoldConv(5, 7, (1, 1, 1), bias=True).to(dtype)
    added = torch.randn(len(sparse.keys), 7).to(dtype)
    book = submanifold_rulebook(sparse.keys, SHAPE, (1, 1, 1))
    with torch.no_grad():
        got = layer(sparse, True, added)
        expected = layers.sparse_conv(sparse.features, layer.weight, book, layer.bias, True, added)
    assert torch.equal(got.features, expected)
    assert got.keys is sparse.keys
    assert not got.rulebooks
