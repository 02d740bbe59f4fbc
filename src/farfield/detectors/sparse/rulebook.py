"""Rulebooks: which input cell meets which output cell under which element of the kernel.

A rulebook depends on the occupied cells only. It is found once a frame and shared by all layers on the same cells.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise, product
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from farfield.detectors.sparse.cells import Triple, decode_keys, neighbour_pairs

_KEY_BITS = 62
BLOCK_PAIRS = 256
_RADIX_SORTED = 2**15 + 1
_SHORT = 2**15


@dataclass(frozen=True, eq=False)
class Rulebook:
    """One kernel over one set of cells, as pairs of an input and an output, those of each kernel element together.

    The pairs of one kernel element are a run; each of the K elements has one. Runs are filled up to whole blocks of
    BLOCK_PAIRS with pairs of some input and output ``n_out``, which no sum takes, so that one batched product serves
    all of them; not so the last run of a symmetric rulebook, where each cell meets itself.

    Attributes:
        keys_in: Input cells, shape (n_in,), int64, ascending.
        shape_in: Input grid.
        keys: Output cells, shape (n_out,), int64, ascending.
        shape: Output grid.
        sources: Input row of each pair, shape (p,), int32, fillers included.
        targets: Output row of each pair, shape (p,), int32, fillers included.
        counts: Number of pairs of each run, without fillers.
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

    @property
    def size(self) -> int:
        """Elements of the kernel."""
        return len(self.counts)

    def elements(self) -> Iterator[tuple[int, slice]]:
        """Number of each kernel element that has pairs, and where these are."""
        start = 0
        for number, count in zip(self.numbers, self.counts, strict=True):
            if count:
                yield number, slice(start, start + count)
            start += _blocks(count) * BLOCK_PAIRS

    @cached_property
    def block_elements(self) -> Tensor:
        """Kernel element of each block of pairs, int64; the last run of a symmetric rulebook is not in blocks."""
        blocks = [_blocks(count) for count in self.counts]
        if self.symmetric:
            blocks[-1] = 0
        numbers = [number for number, size in zip(self.numbers, blocks, strict=True) for _ in range(size)]
        return torch.tensor(numbers, dtype=torch.int64, device=self.keys.device)

    @cached_property
    def by_target(self) -> tuple[Tensor, Tensor]:
        """The pairs of each output together.

        Returns:
            Numbers of the pairs, fillers left out, int64, and where those of each output start, shape (n_out,), int64.
        """
        narrow = self.targets.short() if len(self.keys) < _SHORT else self.targets  # radix sort: half the passes
        order = torch.sort(narrow, stable=True).indices[: sum(self.counts)]
        held = torch.bincount(self.targets, minlength=len(self.keys))[: len(self.keys)]
        return order, held.cumsum(0).sub_(held)

    @cached_property
    def inverse(self) -> "Rulebook":
        """The rulebook that leads back: input and output change places."""
        if self.symmetric:
            raise ValueError("Expected a rulebook between different cells; a symmetric one is its own inverse.")
        cells = (self.keys, self.shape, self.keys_in, self.shape_in)
        filler = self.targets == len(self.keys)
        sources, targets = self.targets.masked_fill(filler, 0), self.sources.masked_fill(filler, len(self.keys_in))
        back = Rulebook(*cells, sources, targets, self.counts, self.numbers)
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
    cell, neighbour, counts = neighbour_pairs(keys, shape, offsets[:half])
    index, filler = _in_blocks((0, *accumulate(counts)), counts, keys.device)
    cell, neighbour = cell.index_select(0, index), neighbour.index_select(0, index)
    own = torch.arange(len(keys), dtype=torch.int32, device=keys.device)
    sources = torch.cat([neighbour, cell, own])
    targets = torch.cat([cell.masked_fill_(filler, len(keys)), neighbour.masked_fill_(filler, len(keys)), own])
    mirrored = (*range(half), *range(len(offsets) - 1, half, -1), half)
    return Rulebook(keys, shape, keys, shape, sources, targets, (*counts, *counts, len(keys)), mirrored, symmetric=True)


def _blocks(pairs: int) -> int:
    return -(-pairs // BLOCK_PAIRS)


def _in_blocks(starts: Sequence[int], counts: Sequence[int], device: torch.device) -> tuple[Tensor, Tensor]:
    """Runs one after the other, each filled up to whole blocks.

    Args:
        starts: Where each run begins among the pairs that are there.
        counts: Number of pairs of each run.
        device: Where the result shall lie.

    Returns:
        Which pair to take, shape (p,), int64, and which of them are fillers, shape (p,), bool; a filler takes the last
        pair of its run.
    """
    runs = [(start, count, _blocks(count)) for start, count in zip(starts, counts, strict=False)]
    firsts = [start + BLOCK_PAIRS * block for start, _, size in runs for block in range(size)]
    lasts = [start + count - 1 for start, count, size in runs for _ in range(size)]
    first, last = torch.tensor([firsts, lasts], dtype=torch.int64, device=device)[:, :, None].unbind(0)
    taken = first + torch.arange(BLOCK_PAIRS, device=device)
    filler = taken > last
    return torch.minimum(taken, last).view(-1), filler.view(-1)


def strided_rulebook(keys: Tensor, shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Rulebook:
    """Outputs at every cell that some input reaches.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    out_shape = conv_shape(shape, kernel, stride, padding)
    sources, cells, counts, numbers = _reached(keys, shape, out_shape, kernel, stride, padding)
    total = sum(counts)
    ordered, order = (part[:total] for part in torch.sort(cells, stable=True))
    new = torch.ones_like(ordered, dtype=torch.bool)
    torch.ne(ordered[1:], ordered[:-1], out=new[1:])
    starts = new.nonzero().squeeze(1)
    targets = torch.full_like(sources, len(starts))
    targets.scatter_(0, order, new.cumsum(0, dtype=torch.int32).sub_(1))
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
        kernel element. Fillers have a key above all others.
    """
    frames = int(keys[-1]) // math.prod(shape) + 1 if len(keys) else 1
    narrow = torch.int32 if 2 * frames * max(math.prod(shape), math.prod(out_shape)) < 2**31 else torch.int64
    cells, *indices = decode_keys(keys.to(narrow), shape).unbind(1)
    phase, astray = torch.zeros_like(cells), {}
    axes = zip(indices, shape, out_shape, kernel, stride, padding, strict=True)
    for axis, (index, inside, size, k, s, p) in enumerate(axes):
        index = index + p
        shift = s.bit_length() - 1  # an integer division takes ten times as long
        quotient = index >> shift if s == 1 << shift else torch.div(index, s, rounding_mode="floor")
        cells = cells * size + quotient
        phase = phase * s + (index - quotient * s)
        below = p < k - s and bool((index < k - s).any())
        if below or ((inside - 1 + p) // s >= size and bool((quotient >= size).any())):
            astray[axis] = quotient  # by some element an input would reach a cell outside the grid
    order = _order(phase, math.prod(stride))
    ends = [0, *phase.bincount(minlength=math.prod(stride)).cumsum(0).tolist()]
    runs = _runs(kernel, stride)
    starts = [ends[run.phase] for run in runs]
    counts = tuple(ends[run.phase + 1] - ends[run.phase] for run in runs)
    chosen, filler = _in_blocks(starts, counts, keys.device)
    shifts = [(z * out_shape[1] + x) * out_shape[2] + y for z, x, y in (run.step for run in runs)]
    sources = order.index_select(0, chosen).int()
    reached = cells.index_select(0, sources) - _to_pairs(shifts, counts, cells)
    if astray:
        fits = ~filler
        for axis, quotient in astray.items():
            index = quotient.index_select(0, sources) - _to_pairs([run.step[axis] for run in runs], counts, cells)
            fits &= (index >= 0) & (index < out_shape[axis])
        inside_rows = fits.nonzero().squeeze(1)
        filled = torch.tensor([_blocks(count) * BLOCK_PAIRS for count in counts], device=keys.device)
        edges = [0, *torch.searchsorted(inside_rows, filled.cumsum(0)).tolist()]
        counts = tuple(end - start for start, end in pairwise(edges))
        chosen, filler = _in_blocks(edges, counts, keys.device)
        chosen = inside_rows.index_select(0, chosen)
        sources, reached = sources.index_select(0, chosen), reached.index_select(0, chosen)
    reached.masked_fill_(filler, frames * math.prod(out_shape))
    return sources, reached, counts, tuple(run.number for run in runs)


def _to_pairs(values: Sequence[int], counts: Sequence[int], like: Tensor) -> Tensor:
    """One number for each run, said again for each of its pairs and fillers, shape (p,)."""
    blocks = [value for value, count in zip(values, counts, strict=True) for _ in range(_blocks(count))]
    return like.new_tensor(blocks)[:, None].expand(-1, BLOCK_PAIRS).reshape(-1)


def _order(numbers: Tensor, above: int) -> Tensor:
    """What sorts numbers below ``above``, equal ones as they come, shape (n,), int64.

    PyTorch sorts integers by radix on the CPU, but only so many of them: some more make that four times as fast.
    """
    missing = _RADIX_SORTED - len(numbers)
    if 0 < missing < 2 * len(numbers) and numbers.device.type == "cpu":
        return torch.sort(functional.pad(numbers, (0, missing), value=above), stable=True).indices[: len(numbers)]
    return torch.sort(numbers, stable=True).indices


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
