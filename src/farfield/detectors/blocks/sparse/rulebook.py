"""Rulebooks: which input cell meets which output cell under which element of the kernel.

A rulebook depends on the occupied cells only. It is found once a frame and shared by all layers on the same cells.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import torch
from torch import Tensor

from farfield.detectors.blocks.sparse.neighbours import neighbour_columns
from farfield.detectors.blocks.sparse.tensor import Triple, decode_keys

_KEY_BITS = 62


@dataclass(frozen=True, eq=False)
class Rulebook:
    """One kernel over one set of cells, as pairs of an input and an output, those of each kernel element together.

    Attributes:
        keys_in: Input cells, shape (n_in,), int64, ascending.
        shape_in: Input grid.
        keys: Output cells, shape (n_out,), int64, ascending.
        shape: Output grid.
        sources: Input row of each pair, shape (p,), int32.
        targets: Output row of each pair, shape (p,), int32.
        counts: Number of pairs of each of the K kernel elements.
        symmetric: Inputs and outputs are the same cells and the kernel is odd: its own inverse, the kernel mirrored.
    """

    keys_in: Tensor
    shape_in: Triple
    keys: Tensor
    shape: Triple
    sources: Tensor
    targets: Tensor
    counts: tuple[int, ...]
    symmetric: bool = False

    def elements(self) -> Iterator[tuple[int, slice]]:
        """Number of each kernel element that has pairs, and where these are."""
        start = 0
        for number, count in enumerate(self.counts):
            if count:
                yield number, slice(start, start + count)
            start += count

    @cached_property
    def by_target(self) -> tuple[Tensor, Tensor]:
        """The pairs of each output together.

        Returns:
            Numbers of the pairs, shape (p,), int64, and where those of each output start, shape (n_out,), int64.
        """
        ordered, order = torch.sort(self.targets, stable=True)
        outputs = torch.arange(len(self.keys), dtype=torch.int32, device=ordered.device)
        return order, torch.searchsorted(ordered, outputs)

    @cached_property
    def inverse(self) -> "Rulebook":
        """The rulebook that leads back: input and output change places."""
        if self.symmetric:
            raise ValueError("Expected a rulebook between different cells; a symmetric one is its own inverse.")
        back = Rulebook(self.keys, self.shape, self.keys_in, self.shape_in, self.targets, self.sources, self.counts)
        back.__dict__["inverse"] = self
        return back

    @cached_property
    def table(self) -> Tensor:
        """Row of the input under each kernel element, ``n_in`` for none, shape (n_out, K), int32."""
        size = len(self.counts)
        table = self.sources.new_full((len(self.keys) * size,), len(self.keys_in))
        for number, pairs in self.elements():
            table[self.targets[pairs].long() * size + number] = self.sources[pairs]
        return table.view(-1, size)

    @cached_property
    def similar(self) -> tuple[Tensor, Tensor]:
        """The table with similar rows together, for the GPU, where a block skips what none of its rows has.

        Returns:
            Output row of each row, shape (n_out,), int64, and the table in that order, shape (n_out, K), int32.
        """
        missing = self.table == len(self.keys_in)
        rarest_first = missing.sum(0).argsort(descending=True)[:_KEY_BITS]
        key = torch.zeros(len(self.table), dtype=torch.int64, device=missing.device)
        for column in missing[:, rarest_first].unbind(1):
            key = (key << 1) + ~column
        order = torch.sort(key, stable=True).indices
        return order, self.table[order]


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
    offsets = kernel_offsets(kernel)
    centre = len(offsets) // 2
    mine: list[Tensor] = []
    theirs: list[Tensor] = []
    for column in neighbour_columns(keys, keys, shape, offsets[:centre]):
        row = (column < len(keys)).nonzero().squeeze(1)
        mine.append(row.int())
        theirs.append(column.index_select(0, row))
    own = [torch.arange(len(keys), dtype=torch.int32, device=keys.device)]
    sources, targets = [*theirs, *own, *mine[::-1]], [*mine, *own, *theirs[::-1]]
    counts = tuple(len(rows) for rows in sources)
    return Rulebook(keys, shape, keys, shape, torch.cat(sources), torch.cat(targets), counts, symmetric=True)


def strided_rulebook(keys: Tensor, shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Rulebook:
    """Outputs at every cell that some input reaches.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    out_shape = conv_shape(shape, kernel, stride, padding)
    frame, *place = decode_keys(keys, shape).unbind(1)
    frames = int(frame[-1]) + 1 if len(keys) else 1
    narrow = torch.int32 if frames * out_shape[0] * out_shape[1] * out_shape[2] < 2**31 else torch.int64
    steps = (out_shape[1] * out_shape[2], out_shape[2], 1)
    along_z, along_x, along_y = (
        [(cell.to(narrow), reached) for cell, reached in _reached_along(*axis)]
        for axis in zip(place, out_shape, kernel, stride, padding, steps, strict=True)
    )
    first = (frame * (out_shape[0] * steps[0])).to(narrow)
    sources, cells = [], []
    for (z, z_reached), (x, x_reached) in product(along_z, along_x):
        column, column_reached = first + z + x, z_reached & x_reached
        for y, y_reached in along_y:
            source = (column_reached & y_reached).nonzero().squeeze(1)
            sources.append(source.int())
            cells.append((column + y).index_select(0, source))
    ordered, order = torch.sort(torch.cat(cells), stable=True)
    new = torch.ones_like(ordered, dtype=torch.bool)
    torch.ne(ordered[1:], ordered[:-1], out=new[1:])
    targets = torch.empty_like(order, dtype=torch.int32)
    targets[order] = new.cumsum(0, dtype=torch.int32) - 1
    counts = tuple(len(rows) for rows in sources)
    book = Rulebook(keys, shape, ordered[new].long(), out_shape, torch.cat(sources), targets, counts)
    book.__dict__["by_target"] = (order, new.nonzero().squeeze(1))  # at hand already
    return book


def _reached_along(
    index: Tensor, out_size: int, size: int, stride: int, padding: int, step: int
) -> list[tuple[Tensor, Tensor]]:
    """Along one axis, the output that each input reaches by each kernel element.

    Returns:
        For each kernel element: the output's index times ``step``, and whether there is one, shape (n,) each.
    """
    reached = []
    for element in range(size):
        start = index + (padding - element)
        cell = start if stride == 1 else torch.div(start, stride, rounding_mode="floor")
        exact = (cell >= 0) & (cell < out_size)
        reached.append((cell * step, exact if stride == 1 else exact & (cell * stride == start)))
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
