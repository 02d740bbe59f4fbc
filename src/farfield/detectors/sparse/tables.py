"""Neighbour tables: the other way to convolve, for cells that lie close together on a small grid.

Where most neighbours are occupied, looking all of them up and taking those that are not for zero costs less than a list
of the pairs that there are: one product a block of cells, and no sum over pairs afterwards.
"""

import functools
import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from farfield.detectors.sparse.rulebook import conv_shape
from farfield.detectors.sparse.tensor import SparseTensor, Triple, decode_keys, encode_keys

_ROWS = 2048  # whose neighbours fill the caches, and few enough calls


@dataclass(frozen=True, eq=False)
class NeighbourTable:
    """One kernel over one set of cells, as the input under each kernel element of each output.

    Attributes:
        keys: Output cells, shape (n_out,), int64, ascending.
        shape: Output grid.
        rows: Row of the input under each kernel element, ``n_in`` for none, shape (n_out, K), int32.
    """

    keys: Tensor
    shape: Triple
    rows: Tensor


def submanifold_table(sparse: SparseTensor, kernel: Triple) -> NeighbourTable:
    """Outputs where the inputs are.

    Raises:
        ValueError: If the kernel is even along some axis.
    """
    if any(size % 2 == 0 for size in kernel):
        raise ValueError(f"Expected a submanifold kernel that is odd along every axis; got {kernel}.")
    padding = (kernel[0] // 2, kernel[1] // 2, kernel[2] // 2)
    return NeighbourTable(sparse.keys, sparse.shape, _rows(sparse, sparse.indices(), kernel, (1, 1, 1), padding))


def strided_table(sparse: SparseTensor, kernel: Triple, stride: Triple, padding: Triple) -> NeighbourTable:
    """Outputs at every cell that some input reaches.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    shape = conv_shape(sparse.shape, kernel, stride, padding)
    keys = reached_map(occupied_map(sparse), kernel, stride, padding).view(-1).nonzero().squeeze(1)
    return NeighbourTable(keys, shape, _rows(sparse, decode_keys(keys, shape), kernel, stride, padding))


def occupied_map(sparse: SparseTensor) -> Tensor:
    """1 at the occupied cells, else 0, shape (b, 1, D, nx, ny), uint8."""
    flat = sparse.keys.new_zeros(sparse.batch_size * math.prod(sparse.shape), dtype=torch.uint8)
    return flat.index_fill_(0, sparse.keys, 1).view(sparse.batch_size, 1, *sparse.shape)


def reached_map(occupied: Tensor, kernel: Triple, stride: Triple, padding: Triple) -> Tensor:
    """The cells that some input reaches, in the form of :func:`occupied_map`."""
    reached = functional.pad(occupied, [side for size in reversed(padding) for side in (size, size)])
    for axis, (size, step) in enumerate(zip(kernel, stride, strict=True), 2):
        span = reached.shape[axis] - size + 1
        reached = functools.reduce(torch.bitwise_or, [reached.narrow(axis, start, span) for start in range(size)])
        reached = reached.index_select(axis, torch.arange(0, span, step, device=reached.device))
    return reached


def table_product(features: Tensor, weight: Tensor, rows: Tensor, bias: Tensor | None) -> Tensor:
    """Convolve by a table: the products of a block of cells with all elements of the kernel at once, no gradient.

    Args:
        features: Input rows, shape (n_in, c_in).
        weight: Kernel, shape (K, c_in, c_out), of the features' dtype.
        rows: Row of the input under each kernel element, shape (n_out, K), int32.
        bias: Added to each output, shape (c_out,).

    Returns:
        Output rows, shape (n_out, c_out).
    """
    size, c_in, c_out = weight.shape
    padded = functional.pad(features, (0, 0, 0, 1))
    matrix = weight.reshape(size * c_in, c_out)
    out = features.new_empty(len(rows), c_out)
    for some, made in zip(rows.split(_ROWS), out.split(_ROWS), strict=True):
        gathered = padded.index_select(0, some.reshape(-1)).view(len(some), size * c_in)
        if bias is None:
            torch.mm(gathered, matrix, out=made)
        else:
            torch.addmm(bias, gathered, matrix, out=made)
    return out


def _rows(sparse: SparseTensor, outputs: Tensor, kernel: Triple, stride: Triple, padding: Triple) -> Tensor:
    """Row of the input under each kernel element of outputs b, iz, ix, iy; ``n_in`` for none, shape (n, K), int32."""
    count = len(sparse.keys)
    numbered = sparse.keys.new_full((sparse.batch_size * math.prod(sparse.shape),), count, dtype=torch.int32)
    numbered[sparse.keys] = torch.arange(count, dtype=torch.int32, device=numbered.device)
    around = [side for size in reversed(padding) for side in (size, size)]
    raster = functional.pad(numbered.view(-1, *sparse.shape), around, value=count)
    _, depth, nx, ny = raster.shape
    first = encode_keys(outputs * outputs.new_tensor([1, *stride]), (depth, nx, ny)).int()
    steps = [(z * nx + x) * ny + y for z, x, y in itertools.product(*map(range, kernel))]
    wanted = first[:, None] + first.new_tensor(steps)
    return raster.view(-1).index_select(0, wanted.view(-1)).view(wanted.shape)
