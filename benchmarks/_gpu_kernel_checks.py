"""Triton's kernels against their plain versions at small sizes and odd cases, on a GPU or in Triton's interpreter.

    TRITON_INTERPRET=1 python benchmarks/_gpu_kernel_checks.py cpu

The interpreter must be chosen before Triton is imported, so that has a process of its own.
"""

import sys
from itertools import product

import numpy as np
import torch
from _gpu_cases import SHAPE, STRIDED, cells, drawn

from farfield.detectors import nms, triton_nms, triton_voxels, voxels
from farfield.detectors.anchors import head as on_device
from farfield.detectors.anchors import triton_decode
from farfield.detectors.anchors.grid import AnchorGrid, cirrus_anchors
from farfield.detectors.config import GridConfig
from farfield.detectors.devices import constant
from farfield.detectors.inputs import stacked
from farfield.detectors.pointpillars import triton_pillars
from farfield.detectors.pointpillars.network import PillarEncoder
from farfield.detectors.sparse import layers, strided_rulebook, submanifold_rulebook, triton_books, triton_kernels
from farfield.detectors.sparse.rulebook import kernel_offsets


def books(device):
    """Tables and marks are those of the rulebooks of pairs."""
    for keys in (cells(0.4), cells(0.02), cells(1.0, 1), cells(0.4)[:1], cells(0.4)[:0]):
        there = keys.to(device)
        for kernel in ((3, 3, 3), (1, 3, 3), (1, 1, 1), (5, 3, 1)):
            table, met = triton_books.find_rows(there, there, kernel_offsets(kernel), shape=SHAPE)
            expected = submanifold_rulebook(keys, SHAPE, kernel).table
            assert torch.equal(table.cpu(), expected), kernel
            present = expected < len(keys)
            assert len(met.unique()) == len(present.unique(dim=0)), kernel
        for kernel, stride, padding in STRIDED:
            pairs = strided_rulebook(keys, SHAPE, kernel, stride, padding)
            steps = [
                tuple(e - p for e, p in zip(element, padding, strict=True)) for element in product(*map(range, kernel))
            ]
            marks = torch.zeros(3 * int(np.prod(pairs.shape)), dtype=torch.uint8, device=device)
            inwards = {"shape": pairs.shape, "shape_sought": SHAPE, "stride": stride, "back": True}
            triton_books.mark(marks, there, steps, **inwards)
            out = marks.nonzero().squeeze(1)
            assert torch.equal(out.cpu(), pairs.keys)
            outwards = {"shape": SHAPE, "shape_sought": pairs.shape, "stride": stride}
            assert torch.equal(triton_books.find_rows(there, out, steps, **outwards)[0].cpu(), pairs.table)
            back, _ = triton_books.find_rows(out, there, steps, **inwards)
            assert torch.equal(back.cpu(), pairs.inverse.table)


def convolution(device):
    """Products and gradients of the weights are those of pairs in float64, in every number type."""
    exactness = {torch.float32: 1e-6, torch.bfloat16: 1e-2, torch.float16: 2e-3}
    keys, generator = cells(0.4, 1), torch.Generator().manual_seed(0)
    strided = strided_rulebook(keys, SHAPE, *STRIDED[0])
    books_of = (submanifold_rulebook(keys, SHAPE, (3, 3, 3)), strided, strided.inverse)
    dtypes = list(exactness) if device == "cuda" else [torch.float32]  # the interpreter multiplies bfloat16 wrongly
    for book, (c_in, c_out), dtype in product(books_of, ((5, 20), (40, 16)), dtypes):
        sizes = ((len(book.keys_in), c_in), (len(book.counts), c_in, c_out), (len(book.keys), c_out))
        features, weight, gradient = (torch.randn(size, generator=generator) for size in sizes)
        exact = layers.gather_product(features.double(), weight.double(), book)
        exact_weight = layers.weight_gradient(features.double(), gradient.double(), book)
        rows = tuple(rows.to(device) for rows in book.similar)
        features, weight, gradient = (part.to(device, dtype) for part in (features, weight, gradient))
        got = triton_kernels.gather_product(features, weight, *rows)
        got_weight = triton_kernels.weight_gradient(features, gradient, *rows)
        assert (got.dtype, got_weight.dtype) == (dtype, torch.float32)
        for value, truth in ((got, exact), (got_weight, exact_weight)):
            assert value.shape == truth.shape
            error = float((value.cpu().double() - truth).abs().max() / truth.abs().max())
            assert error < exactness[dtype], (c_in, c_out, dtype, error)


def bias_and_relu(device):
    """A sparse convolution adds its bias and a residual and rectifies as the plain version, its rows sorted or not."""
    keys, generator = cells(0.3, 1), torch.Generator().manual_seed(1)
    book = submanifold_rulebook(keys, SHAPE, (3, 3, 3))
    sizes = ((len(keys), 20), (27, 20, 40), (40,), (len(keys), 40))
    features, weight, bias, residual = (torch.randn(size, generator=generator) for size in sizes)
    for relu, added, rows in product((False, True), (None, residual), (book.similar, (None, book.table.int()))):
        expected = layers.gather_product(features, weight, book, bias, relu, added)
        there = [None if part is None else part.to(device) for part in (*rows, bias, added)]
        got = triton_kernels.gather_product(features.to(device), weight.to(device), *there[:3], relu, there[3])
        torch.testing.assert_close(got.cpu(), expected, rtol=1e-5, atol=1e-5)
        assert bool((expected < 0).any()) is not relu


def suppression(device):
    """The same boxes stay, chains of equal scores among them."""
    rng = np.random.default_rng(0)
    for count, spread_m in ((1, 1), (2, 1), (31, 10), (33, 20), (200, 3), (300, 40)):
        rows = drawn(rng, count, spread_m)
        for threshold in (nms.LEAST_IOU, 0.1, 0.5):
            better, worse = nms.overlapping_pairs(torch.from_numpy(rows), threshold)
            alive = np.ones(count, dtype=bool)
            for one, other in sorted(zip(better.tolist(), worse.tolist(), strict=True)):
                alive[other] &= not alive[one]
            limits = torch.tensor([threshold], dtype=torch.float64, device=device)
            got = triton_nms.surviving_boxes(torch.from_numpy(rows).to(device), limits, 1e-250)
            np.testing.assert_array_equal(got.cpu().numpy() > 0, alive)
    level = torch.zeros(70, 7, dtype=torch.float64, device=device)
    level[:, 3:5] = 1.0
    limits = torch.tensor([0.1], dtype=torch.float64, device=device)
    assert triton_nms.surviving_boxes(level, limits, 1e-250).tolist() == [1] + [0] * 69


def decoding(device):
    """Boxes of codes are those of the host, however the codes lie in memory."""
    generator = torch.Generator().manual_seed(0)
    plain = AnchorGrid(cirrus_anchors(), nx=20, ny=30, cell_m=0.8, y_min_m=-12.0)
    for style, dtype in product(("farfield", "openpcdet"), (torch.float32, torch.bfloat16)):
        grid = plain.styled(style)
        codes = torch.randn(len(grid), 7, generator=generator) * 2
        codes[:50, 6], codes[50:100, 6], codes[100:150, 3] = torch.pi / 2, -torch.pi / 2, 9.0
        codes = codes.to(dtype).t().contiguous().t()
        directions = torch.randn(len(grid), 2, generator=generator).to(dtype)
        index = torch.cat([torch.arange(160), torch.randperm(len(grid), generator=generator)[:333]])
        direction = (directions[index, 1] > directions[index, 0]).long().numpy()
        expected = grid.decode(codes[index].double().numpy(), direction, index.numpy())
        there = torch.device(device)
        given = (codes.to(there), directions.to(there), index.to(there))
        got = triton_decode.decoded(*given, **on_device.constants(grid, there)).cpu().numpy()
        np.testing.assert_allclose(got[:, :6], expected[:, :6], rtol=1e-12, atol=1e-12)
        gap = np.abs(got[:, 6] - expected[:, 6])
        np.testing.assert_allclose(np.minimum(gap, 2 * np.pi - gap), 0, atol=1e-12)


def clouds(columns, step_m):
    """Points of three frames, some outside the grid, some on borders of cells and many in a few cells."""
    generator = torch.Generator().manual_seed(0)
    width, least = torch.tensor([44.0, 24, 5, 1, 1])[:columns], torch.tensor([2.0, 12, 3.5, 0, 0])[:columns]
    made = [torch.rand(count, columns, generator=generator) * width - least for count in (700, 0, 300)]
    made[0][:50, :2] = torch.round(made[0][:50, :2] / step_m) * step_m
    made[2][:200, :2] = made[2][:200, :2] / 40 + 5.0
    return made


def voxel_means(device):
    """Voxels and their features are those of the CPU but for its rounding, whatever the order of the points."""
    columns = ("x_m", "y_m", "z_m", "intensity", "lag_s")
    for extra_layers, positions in product((0, 1), ("absolute", "relative")):
        grid = voxels.VoxelGridConfig(
            range_m=40, half_width_m=10, z_min_m=-3, z_max_m=1, cell_m=(0.4, 0.4, 0.5), extra_layers=extra_layers
        )
        given, shape = clouds(5, 0.4), grid.shape(8)
        expected = voxels.mean_voxels(given, grid, 8, columns=columns, positions=positions)
        points, batch = (part.to(device) for part in stacked(given))
        numbers = voxels.numbers(grid, 8, points.device)
        key = triton_voxels.voxel_keys(points, batch, numbers, shape, shape[0] - extra_layers)
        rows = (key >= 0).nonzero().squeeze(1)
        keys, member = torch.unique(key[rows], return_inverse=True)
        assert torch.equal(keys.cpu(), expected.keys)
        first = 0 if positions == "absolute" else 2
        got = triton_voxels.mean_features(points, rows, keys, member, numbers, shape, first)
        torch.testing.assert_close(got.cpu(), expected.features, rtol=1e-5, atol=1e-5)
        order = torch.randperm(len(rows), generator=torch.Generator().manual_seed(1)).to(device)
        again = triton_voxels.mean_features(points, rows[order], keys, member[order], numbers, shape, first)
        assert torch.equal(again, got)


def image_of(encoder, points, batch, device):
    """The kernels' image of pillars."""
    return triton_pillars.image(
        points.to(device),
        batch.to(device),
        3,
        encoder.linear.weight.to(device),
        encoder.linear.bias.to(device),
        constant(encoder.numbers, torch.device(device), torch.float32),
        nx=encoder.nx,
        ny=encoder.ny,
        first=encoder.first,
    )


def pillars(device):
    """The image of pillars is that of the CPU, whatever the order of the points."""
    for columns, positions in ((("x_m", "y_m", "z_m"), "absolute"), (("x_m", "y_m", "z_m", "a", "b"), "relative")):
        torch.manual_seed(0)
        config = GridConfig(range_m=20, half_width_m=8, cell_m=0.5)
        encoder = PillarEncoder(config, columns, multiple=8, channels=24, positions=positions).eval()
        encoder.norm.running_mean.normal_()
        points, batch = stacked(clouds(len(columns), 0.5))
        with torch.no_grad():
            encoder.fold_norm()
            expected = encoder(points, batch, 3)
            got = image_of(encoder, points, batch, device)
            order = torch.randperm(len(points), generator=torch.Generator().manual_seed(1))
            again = image_of(encoder, points[order], batch[order], device)
        assert torch.equal(again, got)
        assert (expected > 0).any()
        torch.testing.assert_close(got.permute(0, 3, 1, 2).cpu(), expected, rtol=1e-5, atol=1e-5)


_ALL = (books, convolution, bias_and_relu, suppression, decoding, voxel_means, pillars)
CHECKS = {check.__name__: check for check in _ALL}

if __name__ == "__main__":
    for check in CHECKS.values():
        check(sys.argv[1])
