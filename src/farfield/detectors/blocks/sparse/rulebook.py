"""Rulebooks: which input cell meets which output cell under which element of the kernel.

A rulebook depends on the occupied cells only. It is found once a frame and shared by all layers on the same cells.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from farfield.detectors.blocks.sparse.neighbours import neighbour_pairs
from farfield.detectors.blocks.sparse.tensor import Triple, decode_keys

_KEY_BITS = 62
BLOCK_PAIRS = 256
_RADIX_SORTED = 2**15 + 1


@dataclass(frozen=True, eq=False)
class Rulebook:
    """One kernel over one set of cells, as pairs of an input and an output, those of each kernel element together.

    The pairs of one kernel element are a run; each of the K elements has one. Runs are filled up to whole blocks of
    BLOCK_PAIRS with pairs of input 0 and output ``n_out``, which no sum takes, so that one batched product serves all
    of them; not so the last run of a symmetric rulebook, where each cell meets itself.

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
        order = torch.sort(self.targets, stable=True).indices[: sum(self.counts)]
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
    mine, theirs, counts = neighbour_pairs(keys, shape, offsets[:half])
    own = torch.arange(len(keys), dtype=torch.int32, device=keys.device)
    halves = list(zip(mine.split(counts), theirs.split(counts), strict=True))
    sources = _join([rows for here, there in halves for rows in (there, here)], 0, own)
    targets = _join([rows for here, there in halves for rows in (here, there)], len(keys), own)
    twice = tuple(count for count in counts for _ in range(2))
    mirrored = tuple(number for element in range(half) for number in (element, len(offsets) - 1 - element))
    runs = ((*twice, len(keys)), (*mirrored, half))
    return Rulebook(keys, shape, keys, shape, sources, targets, *runs, symmetric=True)


def _blocks(pairs: int) -> int:
    return -(-pairs // BLOCK_PAIRS)


def _join(runs: Sequence[Tensor], filler: int, *rest: Tensor) -> Tensor:
    """Runs one after the other, each filled up to whole blocks, then what remains as it is."""
    fillers = runs[0].new_full((BLOCK_PAIRS,), filler) if runs else None
    parts = []
    for run in runs:
        parts.append(run)
        if fillers is not None and len(run) % BLOCK_PAIRS:
            parts.append(fillers[: -len(run) % BLOCK_PAIRS])
    return torch.cat([*parts, *rest])


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
    cells, *place = decode_keys(keys.to(narrow), shape).unbind(1)
    phase, astray = torch.zeros_like(cells), {}
    for axis, (index, size, k, s, p) in enumerate(zip(place, out_shape, kernel, stride, padding, strict=True)):
        index = index + p
        shift = s.bit_length() - 1  # an integer division takes ten times as long
        quotient = index >> shift if s == 1 << shift else torch.div(index, s, rounding_mode="floor")
        cells = cells * size + quotient
        phase = phase * s + (index - quotient * s)
        if not bool(((index >= k - s) & (quotient < size)).all()):
            astray[axis] = quotient  # by some element an input would reach a cell outside the grid
    order = _order(phase, math.prod(stride))
    ends = [0, *phase.bincount(minlength=math.prod(stride)).cumsum(0).tolist()]
    runs = _runs(kernel, stride)
    parts = [slice(*ends[run.phase : run.phase + 2]) for run in runs]
    rows, cells = order.int(), cells.index_select(0, order)
    shifts = [(z * out_shape[1] + x) * out_shape[2] + y for z, x, y in (run.step for run in runs)]
    sources = [rows[part] for part in parts]
    reached = [cells[part] - shift for part, shift in zip(parts, shifts, strict=True)]
    counts = tuple(part.stop - part.start for part in parts)
    numbers, above = tuple(run.number for run in runs), frames * math.prod(out_shape)
    if not astray:
        return _join(sources, 0), _join(reached, above), counts, numbers
    source, cell = torch.cat(sources), torch.cat(reached)
    fits = torch.ones_like(source, dtype=torch.bool)
    lengths = torch.tensor(counts, device=keys.device)
    for axis, quotient in astray.items():
        step = quotient.new_tensor([run.step[axis] for run in runs]).repeat_interleave(lengths)
        index = quotient.index_select(0, source) - step
        fits &= (index >= 0) & (index < out_shape[axis])
    kept = fits.nonzero().squeeze(1)
    edges = [0, *torch.searchsorted(kept, lengths.cumsum(0)).tolist()]
    counts = tuple(end - start for start, end in pairwise(edges))
    source, cell = source.index_select(0, kept), cell.index_select(0, kept)
    return _join(source.split(counts), 0), _join(cell.split(counts), above), counts, numbers


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
