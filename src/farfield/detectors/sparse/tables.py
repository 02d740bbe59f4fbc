"""Neighbour tables: for cells that lie close together on a small grid of a CPU, and for every grid on a GPU.

On a CPU, where most neighbours are occupied, looking all of them up and taking those that are not for zero costs less
than a list of the pairs that there are: one product a block of cells, and no sum over pairs afterwards.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from types import ModuleType

import torch
from torch import Tensor
from torch.nn import functional

from farfield.detectors.devices import kernels_for
from farfield.detectors.sparse.cells import MAX_MARKS, SparseTensor, Triple, decode_keys, encode_keys
from farfield.detectors.sparse.rulebook import conv_shape

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
    return NeighbourTable(sparse.keys, sparse.shape, _table_rows(sparse, sparse.indices(), kernel, (1, 1, 1), padding))


def strided_table(sparse: SparseTensor, kernel: Triple, stride: Triple, padding: Triple) -> NeighbourTable:
    """Outputs at every cell that some input reaches.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    shape = conv_shape(sparse.shape, kernel, stride, padding)
    keys = reached_map(occupied_map(sparse), kernel, stride, padding).view(-1).nonzero().squeeze(1)
    return NeighbourTable(keys, shape, _table_rows(sparse, decode_keys(keys, shape), kernel, stride, padding))


def occupied_map(sparse: SparseTensor) -> Tensor:
    """1 at the occupied cells, else 0, shape (b, 1, D, nx, ny), uint8."""
    mask = sparse.keys.new_zeros(sparse.batch_size * math.prod(sparse.shape), dtype=torch.uint8)
    return mask.index_fill_(0, sparse.keys, 1).view(sparse.batch_size, 1, *sparse.shape)


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
    for block, out_block in zip(rows.split(_ROWS), out.split(_ROWS), strict=True):
        gathered = padded.index_select(0, block.reshape(-1)).view(len(block), size * c_in)
        if bias is None:
            torch.mm(gathered, matrix, out=out_block)
        else:
            torch.addmm(bias, gathered, matrix, out=out_block)
    return out


def _table_rows(sparse: SparseTensor, outputs: Tensor, kernel: Triple, stride: Triple, padding: Triple) -> Tensor:
    """Row of the input under each kernel element of outputs b, iz, ix, iy; ``n_in`` for none, shape (n, K), int32."""
    count = len(sparse.keys)
    numbered = sparse.keys.new_full((sparse.batch_size * math.prod(sparse.shape),), count, dtype=torch.int32)
    numbered[sparse.keys] = torch.arange(count, dtype=torch.int32, device=numbered.device)
    around = [side for size in reversed(padding) for side in (size, size)]
    raster = functional.pad(numbered.view(-1, *sparse.shape), around, value=count)
    _, depth, nx, ny = raster.shape
    first = encode_keys(outputs * outputs.new_tensor([1, *stride]), (depth, nx, ny)).int()
    steps = [(z * nx + x) * ny + y for z, x, y in itertools.product(*map(range, kernel))]
    queries = first[:, None] + first.new_tensor(steps)
    return raster.view(-1).index_select(0, queries.view(-1)).view(queries.shape)


# Rulebooks for a GPU: the neighbour table itself, found without a number of it going to the host.
#
# The pairs of :class:`~farfield.detectors.sparse.rulebook.Rulebook` are what a CPU wants; their counts are read on
# the host. The Triton kernels read the table alone.

_KEY_BITS = 62


@dataclass(frozen=True, eq=False)
class DeviceBook:
    """One kernel over one set of cells, as a table.

    Attributes:
        keys_in: Input cells, shape (n_in,), int64, ascending.
        keys: Output cells, shape (n_out,), int64, ascending.
        shape: Output grid.
        table: Row of the input under each kernel element, ``n_in`` for none, shape (n_out, K), int32.
        met: A number a row that is equal where equal elements meet an input, shape (n_out,); None to count them.
        shape_in: Input grid.
        find_back: Finds the table that leads back, shape (n_in, K), int32, and its ``met``; None for a symmetric book.
    """

    keys_in: Tensor
    keys: Tensor
    shape: Triple
    table: Tensor
    met: Tensor | None
    shape_in: Triple
    find_back: "Callable[[], Found] | None" = None

    @property
    def size(self) -> int:
        """Elements of the kernel."""
        return self.table.shape[1]

    @property
    def symmetric(self) -> bool:
        """Inputs and outputs are the same cells and the kernel is odd: its own inverse, the kernel mirrored."""
        return self.find_back is None

    @cached_property
    def inverse(self) -> "DeviceBook":
        """The rulebook that leads back: input and output change places."""
        if self.find_back is None:
            raise ValueError("Expected a rulebook between different cells; a symmetric one is its own inverse.")
        forward, (table, met) = (self.table, self.met), self.find_back()
        book = DeviceBook(self.keys, self.keys_in, self.shape_in, table, met, self.shape, lambda: forward)
        book.__dict__["inverse"] = self
        return book

    @cached_property
    def similar(self) -> tuple[Tensor, Tensor]:
        """The table with similar rows together; see :attr:`farfield.detectors.sparse.rulebook.Rulebook.similar`."""
        if self.met is not None:
            order = torch.sort(self.met, stable=True).indices
            return order, self.table[order]
        present = self.table < len(self.keys_in)
        rarest_first = present.sum(0).argsort()[:_KEY_BITS]
        chosen = present.index_select(1, rarest_first).long()
        weight = torch.arange(chosen.shape[1] - 1, -1, -1, device=chosen.device)
        order = torch.sort(torch.bitwise_left_shift(chosen, weight).sum(1), stable=True).indices
        return order, self.table[order]


Found = tuple[Tensor, Tensor | None]
"""A table, and the ``met`` of a :class:`DeviceBook`."""


def submanifold_book(keys: Tensor, shape: Triple, kernel: Triple) -> DeviceBook:
    """Outputs where the inputs are; see :func:`farfield.detectors.sparse.rulebook.submanifold_rulebook`.

    Raises:
        ValueError: If the kernel is even along some axis.
    """
    if any(size % 2 == 0 for size in kernel):
        raise ValueError(f"Expected a submanifold kernel that is odd along every axis; got {kernel}.")
    kernels = kernels_for(keys.device, "sparse.triton_books")
    if kernels is not None:
        centred = (kernel[0] // 2, kernel[1] // 2, kernel[2] // 2)
        table, met = kernels.find_rows(keys, keys, _steps(kernel, centred), shape=shape)
        return DeviceBook(keys, keys, shape, table, met, shape)
    frame, *indices = decode_keys(keys, shape).unbind(1)
    along = [at[:, None] + _counted(size, at) - size // 2 for at, size in zip(indices, kernel, strict=True)]
    return DeviceBook(keys, keys, shape, _rows_under_kernel(keys, frame, along, shape), None, shape)


def strided_book(
    keys: Tensor, shape: Triple, kernel: Triple, stride: Triple, padding: Triple, frames: int | None = None
) -> DeviceBook:
    """Outputs at every cell that some input reaches; see :func:`farfield.detectors.sparse.rulebook.strided_rulebook`.

    Args:
        keys: Input cells, shape (n,), int64, ascending, each once.
        shape: Their grid.
        kernel: Size along z, x and y, like the following.
        stride: Step.
        padding: Empty cells on both sides.
        frames: Number of grids; what the last key says if left out.

    Raises:
        ValueError: If the kernel does not fit the padded grid.
    """
    out_shape = conv_shape(shape, kernel, stride, padding)
    kernels = kernels_for(keys.device, "sparse.triton_books")
    if kernels is not None and len(keys):
        frames = frames or int(keys[-1]) // math.prod(shape) + 1
        if frames * math.prod(out_shape) <= MAX_MARKS:
            return _marked_book(kernels, keys, shape, out_shape, _steps(kernel, padding), stride, frames)
    frame, *indices = decode_keys(keys, shape).unbind(1)
    along, even = [], []
    for at, size, step, border in zip(indices, kernel, stride, padding, strict=True):
        reached_index = at[:, None] + border - _counted(size, at)
        along.append(torch.div(reached_index, step, rounding_mode="floor"))
        even.append(along[-1] * step == reached_index)
    cells = _cells(frame, along, out_shape, even)
    reached = torch.unique(cells)[int(bool((cells < 0).any())) :]
    frame, *indices = decode_keys(reached, out_shape).unbind(1)
    axes = zip(indices, kernel, stride, padding, strict=True)
    under = [at[:, None] * step - border + _counted(size, at) for at, size, step, border in axes]
    table = _rows_under_kernel(keys, frame, under, shape)
    return DeviceBook(keys, reached, out_shape, table, None, shape, lambda: (_rows_of_keys(reached, cells), None))


def _marked_book(
    kernels: ModuleType,
    keys: Tensor,
    shape: Triple,
    out_shape: Triple,
    steps: list[Triple],
    stride: Triple,
    frames: int,
) -> DeviceBook:
    """The book by kernels: outputs are marked on the whole grid, a byte a cell, and listed."""
    marks = torch.zeros(frames * math.prod(out_shape), dtype=torch.uint8, device=keys.device)
    inwards = {"shape": out_shape, "shape_sought": shape, "stride": stride, "back": True}
    kernels.mark(marks, keys, steps, **inwards)
    reached = marks.nonzero().squeeze(1)
    table, met = kernels.find_rows(keys, reached, steps, shape=shape, shape_sought=out_shape, stride=stride)

    find_back = partial(kernels.find_rows, reached, keys, steps, **inwards)
    return DeviceBook(keys, reached, out_shape, table, met, shape, find_back)


def _steps(kernel: Triple, before: Triple) -> list[Triple]:
    """Steps of each element of a kernel whose first one lies so many cells before."""
    z, x, y = (range(-first, size - first) for size, first in zip(kernel, before, strict=True))
    return list(product(z, x, y))


def _counted(size: int, like: Tensor) -> Tensor:
    return torch.arange(size, device=like.device)


def _cells(frame: Tensor, along: Sequence[Tensor], shape: Triple, fits: Sequence[Tensor] | None = None) -> Tensor:
    """Key of the cell under each element of a kernel, -1 for those that do not fit or lie outside, shape (n, K).

    Args:
        frame: Frame of each cell, shape (n,).
        along: Places along z, x and y, shape (n, k) with as many as the kernel is long there.
        shape: The grid.
        fits: Which of them count, likewise; all if left out.
    """
    inside = [(at >= 0) & (at < size) for at, size in zip(along, shape, strict=True)]
    if fits is not None:
        inside = [one & other for one, other in zip(inside, fits, strict=True)]
    z, x, y = along
    planes = (frame[:, None] * shape[0] + z)[:, :, None] * shape[1] + x[:, None]
    keys = planes[..., None] * shape[2] + y[:, None, None]
    inside_all = inside[0][:, :, None, None] & inside[1][:, None, :, None] & inside[2][:, None, None]
    return torch.where(inside_all, keys, -1).flatten(1)


def _rows_under_kernel(keys: Tensor, frame: Tensor, along: Sequence[Tensor], shape: Triple) -> Tensor:
    """Rows of such cells among the keys, ``len(keys)`` where there is none, shape (n, K), int32."""
    return _rows_of_keys(keys, _cells(frame, along, shape))


def _rows_of_keys(keys: Tensor, queries: Tensor) -> Tensor:
    """Row of each wanted key, ``len(keys)`` where it is not among them, int32."""
    if len(keys) == 0:
        return torch.zeros_like(queries, dtype=torch.int32)
    row = torch.searchsorted(keys, queries.contiguous(), out_int32=True).clamp_(max=len(keys) - 1)
    return torch.where(keys[row] == queries, row, len(keys))
