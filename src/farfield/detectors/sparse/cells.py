"""Features on the occupied cells of a batch of 3D grids, and the search for a cell's occupied neighbours."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from farfield.detectors.devices import kernels_for

Triple = tuple[int, int, int]


def encode_keys(indices: Tensor, shape: Triple) -> Tensor:
    """Number cells: ``((b * D + iz) * nx + ix) * ny + iy``.

    Args:
        indices: b, iz, ix, iy of each cell, shape (n, 4), int64, inside the grid.
        shape: Cells along z, x and y.
    """
    depth, nx, ny = shape
    return ((indices[:, 0] * depth + indices[:, 1]) * nx + indices[:, 2]) * ny + indices[:, 3]


def decode_keys(keys: Tensor, shape: Triple) -> Tensor:
    """The inverse of :func:`encode_keys`: b, iz, ix, iy of each cell, shape (n, 4), int64."""
    depth, nx, ny = shape
    rest = torch.div(keys, ny, rounding_mode="floor")
    above = torch.div(rest, nx, rounding_mode="floor")
    frame = torch.div(above, depth, rounding_mode="floor")
    within = [
        torch.sub(index, whole, alpha=size)
        for index, whole, size in ((above, frame, depth), (rest, above, nx), (keys, rest, ny))
    ]
    return torch.stack([frame, *within], 1)


@dataclass(frozen=True, eq=False)
class SparseTensor:
    """Features of the occupied cells of a batch of grids.

    Attributes:
        features: One row a cell, shape (n, c).
        keys: Number of each cell as in :func:`encode_keys`, shape (n,), int64, ascending, each once.
        shape: Cells along z, x and y.
        batch_size: Number of frames; some may have no cell.
        rulebooks: Rulebooks found so far, shared by all tensors derived from this one.
        close: The cells lie close together on a small grid: in half precision on a CPU, where no gradient is asked for,
            they are convolved by neighbour tables.
    """

    features: Tensor
    keys: Tensor
    shape: Triple
    batch_size: int
    rulebooks: dict[Any, Any] = field(default_factory=dict, repr=False)
    close: bool = False

    def __post_init__(self) -> None:
        if self.features.ndim != 2 or self.keys.shape != self.features.shape[:1] or self.keys.dtype != torch.int64:
            raise ValueError(
                "Expected features (n, c) and int64 keys (n,); got features "
                f"{tuple(self.features.shape)} and {self.keys.dtype} keys {tuple(self.keys.shape)}."
            )
        if not 0 < self.batch_size * math.prod(self.shape) < 2**63:
            raise ValueError(f"Expected 1 to 2**63 - 1 cells; got {self.batch_size} frames of {self.shape}.")

    @classmethod
    def from_indices(cls, features: Tensor, indices: Tensor, shape: Triple, batch_size: int) -> "SparseTensor":
        """Sort cells given in any order.

        Args:
            features: One row a cell, shape (n, c).
            indices: b, iz, ix, iy of each cell, shape (n, 4), int64; each cell once.
            shape: Cells along z, x and y.
            batch_size: Number of frames.

        Raises:
            ValueError: If a cell lies outside the grid or comes twice.
        """
        limits = indices.new_tensor([batch_size, *shape])
        if not bool(((indices >= 0) & (indices < limits)).all()):
            raise ValueError(f"Expected cells inside {batch_size} frames of {shape}; got some outside.")
        keys, order = torch.sort(encode_keys(indices, shape))
        if bool((keys[1:] == keys[:-1]).any()):
            raise ValueError("Expected each cell once; got some twice: merge their features first.")
        return cls(features[order], keys, shape, batch_size)

    def indices(self) -> Tensor:
        """Frame and place of each cell: b, iz, ix, iy, shape (n, 4), int64."""
        return decode_keys(self.keys, self.shape)

    def dense(self) -> Tensor:
        """The whole grid, zero where no cell is occupied, shape (batch_size, c, D, nx, ny); differentiable."""
        channels = self.features.shape[1]
        cells = self.features.new_zeros(self.batch_size * math.prod(self.shape), channels)
        grid = cells.index_copy_(0, self.keys, self.features).view(self.batch_size, *self.shape, channels)
        return grid.permute(0, 4, 1, 2, 3)

    def replace(self, features: Tensor) -> "SparseTensor":
        """Other features on the same cells."""
        return replace(self, features=features)

    def moved(self, features: Tensor, keys: Tensor, shape: Triple) -> "SparseTensor":
        """Features on other cells of the same frames, with the rulebooks found so far."""
        return replace(self, features=features, keys=keys, shape=shape)

    def split(self, n: int) -> "tuple[SparseTensor, SparseTensor]":
        """The first ``n`` frames, and the rest; both have at least one. Rulebooks are found anew."""
        cells = n * math.prod(self.shape)
        edge = int(torch.searchsorted(self.keys, cells))
        one = replace(self, features=self.features[:edge], keys=self.keys[:edge], batch_size=n, rulebooks={})
        return one, replace(
            self,
            features=self.features[edge:],
            keys=self.keys[edge:] - cells,
            batch_size=self.batch_size - n,
            rulebooks={},
        )


# Which cells are occupied around a cell: a bitmap of the grid, or binary search where that would be too large.

MAX_MARKS = 2**28
"""Cells of a grid that a GPU may mark, a byte each."""
_MAX_BITMAP_CELLS = 2**30  # two tables of 128 MiB
_WORD_BITS = 5  # 32 cells to a word
_WORDS_PER_CELL = 256


def neighbour_table(keys: Tensor, query_keys: Tensor, shape: Triple, offsets: Sequence[Triple]) -> Tensor:
    """Find the neighbours of cells.

    Args:
        keys: Occupied cells, shape (n,), int64, ascending, each once.
        query_keys: Cells whose neighbours are looked up, shape (m,), int64, on the same grid.
        shape: Cells along z, x and y.
        offsets: Steps (dz, dx, dy) to the K neighbours.

    Returns:
        Row in ``keys`` of each neighbour, ``n`` where it is not occupied or outside the grid, shape (m, K), int32: so
        features with one row appended can be indexed as they are.
    """
    kernels = kernels_for(keys.device, "sparse.triton_books")
    if kernels is not None and len(offsets):
        rows: Tensor = kernels.find_rows(keys, query_keys, offsets, shape=shape)[0]
        return rows
    table = torch.full((len(query_keys) * len(offsets),), len(keys), dtype=torch.int32, device=keys.device)
    if len(keys) == 0 or len(table) == 0:
        return table.view(len(query_keys), len(offsets))
    numbering = Numbering.around(keys, query_keys, shape, offsets)
    queries = numbering.numbers(query_keys)[:, None] + numbering.steps(offsets, keys.device)
    pairs, rows_found = occupied(numbering, numbering.numbers(keys), queries.view(-1))
    table[pairs] = rows_found
    return table.view(len(query_keys), len(offsets))


def neighbour_pairs(keys: Tensor, shape: Triple, offsets: Sequence[Triple]) -> tuple[Tensor, Tensor, tuple[int, ...]]:
    """Find the neighbours that occupied cells are to one another.

    Args:
        keys: Occupied cells, shape (n,), int64, ascending, each once.
        shape: Cells along z, x and y.
        offsets: Steps (dz, dx, dy) to the K neighbours.

    Returns:
        Row of each cell that has a neighbour, that neighbour's row, shape (p,), int32, those of each step together and
        ascending, and the number of pairs of each step.
    """
    if len(keys) == 0 or len(offsets) == 0:
        none = torch.zeros(0, dtype=torch.int32, device=keys.device)
        return none, none, (0,) * len(offsets)
    numbering = Numbering.around(keys, keys, shape, offsets)
    numbers = numbering.numbers(keys)
    queries = numbering.steps(offsets, keys.device)[:, None] + numbers
    pairs, neighbour = occupied(numbering, numbers, queries.view(-1))
    edges = torch.searchsorted(pairs, torch.arange(len(offsets) + 1, device=keys.device) * len(keys)).tolist()
    counts = tuple(end - start for start, end in pairwise(edges))
    cell = (pairs.int() if queries.numel() < 2**31 else pairs).remainder_(len(keys)).int()
    return cell, neighbour, counts


class Numbering:
    """Numbers for the cells of a grid with empty cells between its lines, planes and frames.

    A step from any cell then leads to its neighbour or to an empty cell, so that borders need no check.
    Numbers ascend as keys do.

    Args:
        shape: Cells along z, x and y.
        margin: Empty cells along each, as many as the longest step.
        frames: Number of grids.
    """

    def __init__(self, shape: Triple, margin: Triple, frames: int) -> None:
        self.shape, self.margin, self.frames = shape, margin, frames
        self.plane, self.line = shape[1] + margin[1], shape[2] + margin[2]
        planes = frames * (shape[0] + margin[0]) + 2 * margin[0]
        self.size = (planes * self.plane + 2 * margin[1]) * self.line + 2 * margin[2] + 1
        self.dtype = torch.int32 if self.size < 2**31 else torch.int64

    @classmethod
    def around(cls, keys: Tensor, query_keys: Tensor, shape: Triple, offsets: Sequence[Triple]) -> "Numbering":
        """A numbering of all these cells that is safe for these steps; neither set of keys is empty."""
        z, x, y = (max(abs(step) for step in along) for along in zip(*offsets, strict=True))
        last = keys[-1] if keys is query_keys else torch.maximum(keys[-1], query_keys.max())
        return cls(shape, (z, x, y), int(last) // (shape[0] * shape[1] * shape[2]) + 1)

    def numbers(self, keys: Tensor) -> Tensor:
        """Number of each key, shape (n,), int32 where that is wide enough."""
        keys = keys.to(self.dtype)
        above_line = torch.div(keys, self.shape[2], rounding_mode="floor")
        above_plane = torch.div(above_line, self.shape[1], rounding_mode="floor")
        z, x, y = self.margin
        number = keys + above_line * y + above_plane * (x * self.line)
        first = (z * self.plane + x) * self.line + y
        if self.frames > 1:
            frame = torch.div(above_plane, self.shape[0], rounding_mode="floor")
            number += frame * (z * self.plane * self.line)
        return number.add_(first)

    def steps(self, offsets: Sequence[Triple], device: torch.device) -> Tensor:
        """What each step (dz, dx, dy) adds to a number, shape (K,)."""
        steps = [(dz * self.plane + dx) * self.line + dy for dz, dx, dy in offsets]
        return torch.tensor(steps, dtype=self.dtype, device=device)


def occupied(numbering: Numbering, numbers: Tensor, queries: Tensor) -> tuple[Tensor, Tensor]:
    """Find numbers among others.

    Args:
        numbering: How cells are numbered.
        numbers: Occupied cells, shape (n,), ascending, each once.
        queries: Cells to look up, shape (m,).

    Returns:
        Which of them are occupied, shape (p,), int64, ascending, and their rows in ``numbers``, int32.
    """
    words = numbering.size >> _WORD_BITS
    if numbering.size <= _MAX_BITMAP_CELLS and words <= _WORDS_PER_CELL * (len(numbers) + 4096):
        return _look_up(words + 1, numbers, queries)
    row = torch.searchsorted(numbers, queries, out_int32=True).clamp_(max=len(numbers) - 1)
    hits = (numbers.index_select(0, row) == queries).nonzero().squeeze(1)
    return hits, row.index_select(0, hits)


def _look_up(words: int, numbers: Tensor, queries: Tensor) -> tuple[Tensor, Tensor]:
    """:func:`occupied` by a bitmap: a cell's row is that of its word's first cell plus the bits set below its own."""
    mask = (1 << _WORD_BITS) - 1
    word = numbers >> _WORD_BITS
    bits = torch.zeros(words, dtype=torch.int32, device=numbers.device)
    bits.index_add_(0, word, torch.bitwise_left_shift(torch.ones_like(numbers), numbers & mask))
    new = torch.ones_like(word, dtype=torch.bool)
    torch.ne(word[1:], word[:-1], out=new[1:])
    first = new.nonzero().squeeze(1)
    start = torch.empty_like(bits)
    start.scatter_(0, word.index_select(0, first).long(), first.int())
    bit = bits.index_select(0, queries >> _WORD_BITS)
    bit.bitwise_right_shift_(queries & mask).bitwise_and_(1)
    hits = bit.nonzero().squeeze(1)
    hit_numbers = queries.index_select(0, hits)
    word = hit_numbers >> _WORD_BITS
    higher = torch.bitwise_left_shift(torch.full_like(hit_numbers, -1), hit_numbers & mask)
    below = bits.index_select(0, word).bitwise_and_(higher.bitwise_not_())
    return hits, start.index_select(0, word).add_(_count_bits(below))


def _count_bits(words: Tensor) -> Tensor:
    """Bits set in each int32 that is not negative: sums of 2, 4 and 8 bits side by side, then of the bytes."""
    words -= (words >> 1) & 0x55555555
    words = (words & 0x33333333).add_((words >> 2).bitwise_and_(0x33333333))
    words = (words + (words >> 4)).bitwise_and_(0x0F0F0F0F)
    words += words >> 8
    return (words + (words >> 16)).bitwise_and_(0x3F)


def dilate(
    keys: Tensor,
    shape: Triple,
    offsets: Sequence[Triple],
    *,
    others: Tensor | None = None,
    frames: int | None = None,
) -> Tensor:
    """Grow a set of cells.

    Args:
        keys: Cells, shape (n,), int64, in any order.
        shape: Cells along z, x and y.
        offsets: Steps (dz, dx, dy) from each cell to the cells to add; steps out of the grid add nothing.
        others: Cells that are added as they are, shape (k,), int64.
        frames: Number of grids: with it, a GPU marks the cells on all of them where they are few enough.

    Returns:
        The cells and all added ones, ascending, each once, shape (m,), int64.
    """
    depth, nx, ny = shape
    kernels = kernels_for(keys.device, "sparse.triton_books")
    if kernels is not None and frames is not None and frames * depth * nx * ny <= MAX_MARKS:
        marks = torch.zeros(frames * depth * nx * ny, dtype=torch.uint8, device=keys.device)
        kernels.mark(marks, keys, [(0, 0, 0), *offsets], shape=shape)
        if others is not None:
            marks.index_fill_(0, others, 1)
        return marks.nonzero().squeeze(1)
    _, iz, ix, iy = decode_keys(keys, shape).unbind(1)
    grown = [keys] if others is None else [keys, others]
    for dz, dx, dy in offsets:
        inside = _within(iz, dz, depth) & _within(ix, dx, nx) & _within(iy, dy, ny)
        grown.append((keys + ((dz * nx + dx) * ny + dy))[inside])
    return torch.unique(torch.cat(grown))


def _within(index: Tensor, step: int, size: int) -> Tensor:
    return index < size - step if step >= 0 else index >= -step
