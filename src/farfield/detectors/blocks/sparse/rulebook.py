"""Rulebooks: which input cell meets which output cell under which element of the kernel.

A rulebook depends on the occupied cells only. It is found once a frame and shared by all layers on the same cells.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import torch
from torch import Tensor

from farfield.detectors.blocks.sparse.blocks import Block, BlockTable
from farfield.detectors.blocks.sparse.neighbours import neighbour_columns
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
    symmetric: bool = False

    @cached_property
    def transposed(self) -> Tensor:
        """Row of the output cell that each input cell feeds through each kernel element, ``n_out`` for none.

        Shape (n_in, K), int32.
        """
        if self.symmetric:
            return self.table.flip(1)
        n_in, (n_out, size) = len(self.keys_in), self.table.shape
        transposed = self.table.new_full((n_in + 1, size), n_out)  # the last row takes what leads nowhere
        rows = torch.arange(n_out, dtype=torch.int32, device=self.table.device)
        transposed.scatter_(0, self.table.long(), rows[:, None].expand(-1, size))
        return transposed[:n_in]

    @cached_property
    def inverse(self) -> "Rulebook":
        """The rulebook that leads back: input and output change places."""
        book = Rulebook(self.keys, self.shape, self.keys_in, self.shape_in, self.transposed)
        book.__dict__.update(transposed=self.table, inverse=self)
        return book

    @cached_property
    def similar(self) -> BlockTable:
        """The table in an order that puts similar rows together."""
        return BlockTable(self.table, len(self.keys_in))

    def blocks(self, rows: int) -> list[Block]:
        """The table cut into blocks of ``rows`` similar rows."""
        if self.table.shape[1] == 1:
            return [Block(None, None, self.table)]
        return self.similar.blocks(rows)


def kernel_offsets(kernel: Triple) -> list[Triple]:
    """Steps (dz, dx, dy) of each element of an odd kernel from its centre, in the order of the weights."""
    z, x, y = (range(-(size // 2), size - size // 2) for size in kernel)
    return list(product(z, x, y))


def submanifold_rulebook(keys: Tensor, shape: Triple, kernel: Triple) -> Rulebook:
    """Outputs where the inputs are (Graham et al., 2018, "Submanifold sparse convolutional networks").

    Half of the neighbours are searched; the other half sees the same pairs from the other side.

    Raises:
        ValueError: If the kernel is even along some axis.
    """
    if any(size % 2 == 0 for size in kernel):
        raise ValueError(f"Expected a submanifold kernel that is odd along every axis; got {kernel}.")
    offsets, count = kernel_offsets(kernel), len(keys)
    centre = len(offsets) // 2
    rows = torch.arange(count, dtype=torch.int32, device=keys.device)
    columns = [rows] * len(offsets)
    for number, column in enumerate(neighbour_columns(keys, keys, shape, offsets[:centre])):
        mirrored = torch.full((count + 1,), count, dtype=torch.int32, device=keys.device)
        mirrored.scatter_(0, column.long(), rows)  # the last place takes what has no neighbour
        columns[number], columns[-1 - number] = column, mirrored[:count]
    return Rulebook(keys, shape, keys, shape, torch.stack(columns, 1), symmetric=True)


def strided_rulebook(keys: Tensor, shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Rulebook:
    """Outputs at every cell that some input reaches.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    out_shape = conv_shape(shape, kernel, stride, padding)
    frame, *place = decode_keys(keys, shape).unbind(1)
    axes = [
        _reached_along(index, size, *rest)
        for index, size, *rest in zip(place, out_shape, kernel, stride, padding, strict=True)
    ]
    frames = int(frame[-1]) + 1 if len(keys) else 1
    narrow = torch.int32 if frames * out_shape[0] * out_shape[1] * out_shape[2] < 2**31 else torch.int64
    reached, elements, sources = [], [], []
    for (z, ez, z_in), (x, ex, x_in), (y, ey, y_in) in product(*axes):
        source = (z_in & x_in & y_in).nonzero().squeeze(1)
        cell = ((frame * out_shape[0] + z) * out_shape[1] + x) * out_shape[2] + y
        reached.append(cell[source].to(narrow))
        elements.append(((ez * kernel[1] + ex) * kernel[2] + ey)[source])
        sources.append(source)
    ordered, order = torch.sort(torch.cat(reached))
    first = torch.ones_like(ordered, dtype=torch.bool)
    torch.ne(ordered[1:], ordered[:-1], out=first[1:])
    out_keys, row = ordered[first].long(), first.cumsum(0) - 1
    size = kernel[0] * kernel[1] * kernel[2]
    table = torch.full((len(out_keys) * size,), len(keys), dtype=torch.int32, device=keys.device)
    table[row * size + torch.cat(elements)[order]] = torch.cat(sources)[order].int()
    return Rulebook(keys, shape, out_keys, out_shape, table.view(-1, size))


def _reached_along(index: Tensor, out_size: int, size: int, stride: int, padding: int) -> list[tuple[Tensor, ...]]:
    """Along one axis, the outputs that each input reaches: at most ``ceil(size / stride)``.

    Returns:
        For each of them: output index, kernel element, and whether it exists, shape (n,) each.
    """
    last = torch.div(index + padding, stride, rounding_mode="floor")
    reached = []
    for back in range(-(-size // stride)):
        cell = last - back
        element = index + padding - cell * stride
        reached.append((cell, element, (element < size) & (cell >= 0) & (cell < out_size)))
    return reached


def conv_shape(shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Triple:
    """Output grid of a convolution.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    z, x, y = ((n + 2 * p - k) // s + 1 for n, k, s, p in zip(shape, kernel, stride, padding, strict=True))
    if min(z, x, y) < 1:
        raise ValueError(f"Expected a grid that holds kernel {kernel} with padding {padding}; got {shape}.")
    return z, x, y
