"""Rulebooks: which input cell meets which output cell under which element of the kernel.

A rulebook depends on the occupied cells only. It is found once a frame and shared by all layers on the same cells.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, pairwise, product
from typing import NamedTuple

import torch
from torch import Tensor

from farfield.detectors.blocks.sparse.neighbours import neighbour_pairs
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
        counts: Number of pairs of each run; a run holds the pairs of one kernel element, and each of the K has one.
        numbers: Kernel element of each run.
        symmetric: Inputs and outputs are the same cells and the kernel is odd: its own inverse, the kernel mirrored.
    """

    keys_in: Tensor
    shape_in: Triple
    keys: Tensor
    shape: Triple
    sources: Tensor
    targets: Tensor
    counts: tuple[int, ...]
    numbers: tuple[int, ...]
    symmetric: bool = False

    def elements(self) -> Iterator[tuple[int, slice]]:
        """Number of each kernel element that has pairs, and where these are."""
        start = 0
        for number, count in zip(self.numbers, self.counts, strict=True):
            if count:
                yield number, slice(start, start + count)
            start += count

    def batches(self) -> Iterator[tuple[slice, slice]]:
        """Neighbouring runs with as many pairs each, for one batched product: which runs, and where their pairs are."""
        run, start = 0, 0
        for count, alike in groupby(self.counts):
            size = len(list(alike))
            if count:
                yield slice(run, run + size), slice(start, start + size * count)
            run, start = run + size, start + size * count

    @cached_property
    def run_elements(self) -> Tensor:
        """Kernel element of each run, shape (K,), int64."""
        return torch.tensor(self.numbers, device=self.keys.device)

    @cached_property
    def by_target(self) -> tuple[Tensor, Tensor]:
        """The pairs of each output together.

        Returns:
            Numbers of the pairs, shape (p,), int64, and where those of each output start, shape (n_out,), int64.
        """
        order = torch.sort(self.targets, stable=True).indices
        held = torch.bincount(self.targets, minlength=len(self.keys))
        return order, held.cumsum(0).sub_(held)

    @cached_property
    def inverse(self) -> "Rulebook":
        """The rulebook that leads back: input and output change places."""
        if self.symmetric:
            raise ValueError("Expected a rulebook between different cells; a symmetric one is its own inverse.")
        cells = (self.keys, self.shape, self.keys_in, self.shape_in)
        back = Rulebook(*cells, self.targets, self.sources, self.counts, self.numbers)
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
    half = len(offsets) // 2
    mine, theirs, counts = neighbour_pairs(keys, shape, offsets[:half])
    own = torch.arange(len(keys), dtype=torch.int32, device=keys.device)
    halves = list(zip(mine.split(counts), theirs.split(counts), strict=True))
    sources = torch.cat([rows for here, there in halves for rows in (there, here)] + [own])
    targets = torch.cat([rows for here, there in halves for rows in (here, there)] + [own])
    twice = tuple(count for count in counts for _ in range(2))
    mirrored = tuple(number for element in range(half) for number in (element, len(offsets) - 1 - element))
    runs = ((*twice, len(keys)), (*mirrored, half))
    return Rulebook(keys, shape, keys, shape, sources, targets, *runs, symmetric=True)


def strided_rulebook(keys: Tensor, shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Rulebook:
    """Outputs at every cell that some input reaches.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    out_shape = conv_shape(shape, kernel, stride, padding)
    sources, cells, counts, numbers = _reached(keys, shape, out_shape, kernel, stride, padding)
    ordered, order = torch.sort(cells, stable=True)
    new = torch.ones_like(ordered, dtype=torch.bool)
    torch.ne(ordered[1:], ordered[:-1], out=new[1:])
    starts = new.nonzero().squeeze(1)
    targets = torch.empty_like(order, dtype=torch.int32)
    targets[order] = new.cumsum(0, dtype=torch.int32).sub_(1)
    reached = ordered.index_select(0, starts).long()
    book = Rulebook(keys, shape, reached, out_shape, sources, targets, counts, numbers)
    book.__dict__["by_target"] = (order, starts)  # at hand already
    return book


def _reached(
    keys: Tensor, shape: Triple, out_shape: Triple, kernel: Triple, stride: Triple, padding: Triple
) -> tuple[Tensor, Tensor, tuple[int, ...], tuple[int, ...]]:
    """Which output each input reaches by which element.

    An input reaches outputs by those elements only that leave the remainder, along each axis, which its place plus the
    padding leaves after division by the stride. So inputs are put together by their remainders first.

    Returns:
        Row of the input and key of the output of each pair, shape (p,), the number of pairs of each run, and its
        kernel element. Elements that meet the same inputs come one after the other.
    """
    frames = int(keys[-1]) // math.prod(shape) + 1 if len(keys) else 1
    narrow = torch.int32 if 2 * frames * max(math.prod(shape), math.prod(out_shape)) < 2**31 else torch.int64
    cells, *place = decode_keys(keys.to(narrow), shape).unbind(1)
    phase, astray = torch.zeros_like(cells), {}
    for axis, (index, size, k, s, p) in enumerate(zip(place, out_shape, kernel, stride, padding, strict=True)):
        index = index + p
        quotient = index if s == 1 else torch.div(index, s, rounding_mode="floor")
        cells = cells * size + quotient
        phase = phase * s + (index - quotient * s)
        if not bool(((index >= k - s) & (quotient < size)).all()):
            astray[axis] = quotient  # by some element an input would reach a cell outside the grid
    order = torch.sort(phase, stable=True).indices
    ends = [0, *phase.bincount(minlength=math.prod(stride)).cumsum(0).tolist()]
    runs = _runs(kernel, stride)
    parts = [slice(*ends[run.phase : run.phase + 2]) for run in runs]
    rows, cells = order.int(), cells.index_select(0, order)
    shifts = [(z * out_shape[1] + x) * out_shape[2] + y for z, x, y in (run.step for run in runs)]
    source = torch.cat([rows[part] for part in parts])
    cell = torch.cat([cells[part] - shift for part, shift in zip(parts, shifts, strict=True)])
    counts = [part.stop - part.start for part in parts]
    numbers = tuple(run.number for run in runs)
    if not astray:
        return source, cell, tuple(counts), numbers
    fits = torch.ones_like(source, dtype=torch.bool)
    lengths = torch.tensor(counts, device=keys.device)
    for axis, quotient in astray.items():
        step = quotient.new_tensor([run.step[axis] for run in runs]).repeat_interleave(lengths)
        index = quotient.index_select(0, source) - step
        fits &= (index >= 0) & (index < out_shape[axis])
    kept = fits.nonzero().squeeze(1)
    edges = [0, *torch.searchsorted(kept, lengths.cumsum(0)).tolist()]
    counts = [end - start for start, end in pairwise(edges)]
    return source.index_select(0, kept), cell.index_select(0, kept), tuple(counts), numbers


class _Run(NamedTuple):
    """One element of a strided kernel: its inputs' remainder, its number, and how far back its outputs lie."""

    phase: int
    number: int
    step: Triple


def _runs(kernel: Triple, stride: Triple) -> list[_Run]:
    """The elements of a kernel, those with the same remainder by the stride together."""
    runs = []
    for number, (z, x, y) in enumerate(product(*map(range, kernel))):
        phase = (z % stride[0] * stride[1] + x % stride[1]) * stride[2] + y % stride[2]
        runs.append(_Run(phase, number, (z // stride[0], x // stride[1], y // stride[2])))
    return sorted(runs)


def conv_shape(shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Triple:
    """Output grid of a convolution.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    z, x, y = ((n + 2 * p - k) // s + 1 for n, k, s, p in zip(shape, kernel, stride, padding, strict=True))
    if min(z, x, y) < 1:
        raise ValueError(f"Expected a grid that holds kernel {kernel} with padding {padding}; got {shape}.")
    return z, x, y
