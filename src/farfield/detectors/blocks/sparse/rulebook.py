"""Rulebooks: which input cell meets which output cell under which element of the kernel.

A rulebook depends on the occupied cells only. It is found once a frame and shared by all layers on the same cells.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import torch
from torch import Tensor

from farfield.detectors.blocks.sparse.tensor import Triple, decode_keys


@dataclass(frozen=True, eq=False)
class Rulebook:
    """One kernel over one set of cells.

    Attributes:
        keys_in: Input cells, shape (n_in,), int64, ascending.
        shape_in: Input grid.
        keys: Output cells, shape (n_out,), int64, ascending.
        shape: Output grid.
        table: Row of the input cell under each kernel element, ``n_in`` for none, shape (n_out, K), int32.
        symmetric: Input and output cells are the same and the kernel is odd: the transposed table is the mirrored one.
    """

    keys_in: Tensor
    shape_in: Triple
    keys: Tensor
    shape: Triple
    table: Tensor
    symmetric: bool = field(default=False)

    @cached_property
    def transposed(self) -> Tensor:
        """Row of the output cell that each input cell feeds through each kernel element, ``n_out`` for none.

        Shape (n_in, K), int32.
        """
        if self.symmetric:
            return self.table.flip(1)
        n_in, (n_out, size) = len(self.keys_in), self.table.shape
        transposed = self.table.new_full((n_in + 1, size), n_out)
        rows = torch.arange(n_out, dtype=torch.int32, device=self.table.device)
        transposed.scatter_(0, self.table.long(), rows[:, None].expand(-1, size))
        return transposed[:n_in]

    @cached_property
    def inverse(self) -> "Rulebook":
        """The rulebook that leads back: input and output change places."""
        book = Rulebook(self.keys, self.shape, self.keys_in, self.shape_in, self.transposed)
        book.__dict__["transposed"] = self.table
        return book


def kernel_offsets(kernel: Triple) -> list[Triple]:
    """Steps (dz, dx, dy) of each element of an odd kernel from its centre, in the order of the weights."""
    z, x, y = (range(-(size // 2), size - size // 2) for size in kernel)
    return list(product(z, x, y))


def submanifold_rulebook(keys: Tensor, shape: Triple, kernel: Triple) -> Rulebook:
    """Outputs where the inputs are (Graham et al., 2018, "Submanifold sparse convolutional networks").

    Raises:
        ValueError: If the kernel is even along some axis.
    """
    if any(size % 2 == 0 for size in kernel):
        raise ValueError(f"Expected a submanifold kernel that is odd along every axis; got {kernel}.")
    table = neighbour_table(keys, keys, shape, kernel_offsets(kernel))
    return Rulebook(keys, shape, keys, shape, table, symmetric=True)


def strided_rulebook(keys: Tensor, shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Rulebook:
    """Outputs at every cell that some input reaches.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    out_shape = conv_shape(shape, kernel, stride, padding)
    frame, *place = decode_keys(keys, shape).unbind(1)
    reached, sources = [], []
    for element in product(*map(range, kernel)):
        number, inside = frame, torch.ones_like(frame, dtype=torch.bool)
        for axis in range(3):
            start = place[axis] + padding[axis] - element[axis]
            cell = torch.div(start, stride[axis], rounding_mode="floor")
            inside &= (cell * stride[axis] == start) & (cell >= 0) & (cell < out_shape[axis])
            number = number * out_shape[axis] + cell
        source = inside.nonzero().squeeze(1)
        reached.append(number[source])
        sources.append(source)
    out_keys, rows = torch.unique(torch.cat(reached), return_inverse=True)
    table = torch.full((len(out_keys), len(sources)), len(keys), dtype=torch.int32, device=keys.device)
    for element_number, (source, row) in enumerate(zip(sources, rows.split([len(s) for s in sources]), strict=True)):
        table[row, element_number] = source.int()
    return Rulebook(keys, shape, out_keys, out_shape, table)


def conv_shape(shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Triple:
    """Output grid of a convolution.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    z, x, y = ((n + 2 * p - k) // s + 1 for n, k, s, p in zip(shape, kernel, stride, padding, strict=True))
    if min(z, x, y) < 1:
        raise ValueError(f"Expected a grid that holds kernel {kernel} with padding {padding}; got {shape}.")
    return z, x, y


def shifted_keys(keys: Tensor, shape: Triple, offset: Triple) -> tuple[Tensor, Tensor]:
    """Keys of the cells ``offset`` (dz, dx, dy) away, and which of them lie inside the grid."""
    depth, nx, ny = shape
    _, iz, ix, iy = decode_keys(keys, shape).unbind(1)
    dz, dx, dy = offset
    inside = (iz + dz >= 0) & (iz + dz < depth) & (ix + dx >= 0) & (ix + dx < nx) & (iy + dy >= 0) & (iy + dy < ny)
    return keys + (dz * nx + dx) * ny + dy, inside


def neighbour_table(keys: Tensor, query_keys: Tensor, shape: Triple, offsets: Sequence[Triple]) -> Tensor:
    """Find the neighbours of cells.

    Args:
        keys: Occupied cells, shape (n,), int64, ascending, each once.
        query_keys: Cells whose neighbours are wanted, shape (m,), int64, on the same grid.
        shape: Cells along z, x and y.
        offsets: Steps (dz, dx, dy) to the K neighbours.

    Returns:
        Row in ``keys`` of each neighbour, ``n`` where it is not occupied or outside the grid, shape (m, K), int32: so
        features with one row appended can be indexed as they are.
    """
    table = torch.full((len(query_keys), len(offsets)), len(keys), dtype=torch.int32, device=keys.device)
    if len(keys) == 0:
        return table
    for column, offset in enumerate(offsets):
        wanted, inside = shifted_keys(query_keys, shape, offset)
        row = torch.searchsorted(keys, wanted).clamp_(max=len(keys) - 1)
        table[:, column] = torch.where(inside & (keys[row] == wanted), row, len(keys))
    return table


def dilate(keys: Tensor, shape: Triple, offsets: Sequence[Triple]) -> Tensor:
    """Grow a set of cells.

    Args:
        keys: Cells, shape (n,), int64.
        shape: Cells along z, x and y.
        offsets: Steps (dz, dx, dy) from each cell to the cells to add; steps out of the grid add nothing.

    Returns:
        The cells and all added ones, ascending, each once, shape (m,), int64.
    """
    grown = [keys]
    for offset in offsets:
        moved, inside = shifted_keys(keys, shape, offset)
        grown.append(moved[inside])
    return torch.unique(torch.cat(grown))
