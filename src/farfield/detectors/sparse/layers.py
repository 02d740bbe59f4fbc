"""Sparse convolution layers. Each maps a SparseTensor to a SparseTensor.

Weights have shape (K, c_in, c_out); the K kernel elements run over z, x and y as in ``nn.Conv3d``. A flat map is a grid
of depth 1 with kernels (1, 3, 3).
"""

import math
from abc import ABC, abstractmethod
from typing import Any, cast

import torch
from torch import nn

from farfield.detectors.norm import affine, normalise_rows
from farfield.detectors.sparse.device_books import DeviceBook, strided_book, submanifold_book
from farfield.detectors.sparse.functional import completed, has_kernels, sparse_conv
from farfield.detectors.sparse.rulebook import Rulebook, strided_rulebook, submanifold_rulebook
from farfield.detectors.sparse.tables import (
    NeighbourTable,
    strided_table,
    submanifold_table,
)
from farfield.detectors.sparse.tensor import SparseTensor, Triple

Book = Rulebook | DeviceBook | NeighbourTable
"""What says which input meets which output: pairs, or a table where a GPU or close cells want one."""


class _Conv(nn.Module, ABC):
    def __init__(self, c_in: int, c_out: int, kernel: Triple, bias: bool, book: str | None) -> None:
        super().__init__()
        self.c_in, self.c_out, self.kernel, self.book = c_in, c_out, kernel, book
        self.weight = nn.Parameter(torch.empty(math.prod(kernel), c_in, c_out))
        self.bias = nn.Parameter(torch.empty(c_out)) if bias else None
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Draw weights as ``nn.Conv3d`` does: uniform within the inverse square root of the fan-in."""
        bound = 1 / math.sqrt(self.weight.shape[0] * self.c_in)
        nn.init.uniform_(self.weight, -bound, bound)
        if self.bias is not None:
            nn.init.uniform_(self.bias, -bound, bound)

    @abstractmethod
    def rulebook(self, sparse: SparseTensor) -> Book:
        """The rulebook of the layer on these cells, or its table where they lie close together."""

    def dtype(self, device: str) -> torch.dtype:
        """What the layer computes in."""
        return torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else self.weight.dtype

    def by_table(self, sparse: SparseTensor) -> bool:
        """Whether to convolve these cells by a neighbour table."""
        device = sparse.keys.device.type
        return sparse.close and device == "cpu" and not torch.is_grad_enabled() and self.dtype(device).itemsize == 2

    def by_kernels(self, sparse: SparseTensor) -> bool:
        """Whether Triton kernels convolve these cells."""
        device = sparse.keys.device.type
        return has_kernels(device, self.dtype(device))

    def plan(self, sparse: SparseTensor) -> SparseTensor:
        """Find the rulebook; gives the cells after the layer, without features."""
        book = self.rulebook(sparse)
        return sparse.moved(sparse.features.new_empty(len(book.keys), 0), book.keys, book.shape)

    def forward(self, sparse: SparseTensor, relu: bool = False, added: torch.Tensor | None = None) -> SparseTensor:
        """Apply the layer; add something to its outputs, shape (n_out, c_out), and apply ReLU, if asked."""
        book = self.rulebook(sparse)
        dtype = self.dtype(sparse.features.device.type)
        bias = None if self.bias is None else self.bias.to(dtype)
        features = sparse_conv(sparse.features.to(dtype), self.weight.to(dtype), book, bias, relu, added)
        return sparse.moved(features, book.keys, book.shape)

    def extra_repr(self) -> str:
        return f"{self.c_in}, {self.c_out}, kernel={self.kernel}, book={self.book!r}"


class SubmanifoldConv(_Conv):
    """Convolution whose outputs stand where its inputs do (Graham et al., 2018).

    Args:
        c_in: Input channels.
        c_out: Output channels.
        kernel: Size along z, x and y, each odd.
        bias: Add a learned constant.
        book: Name of the rulebook. Layers on the same cells with the same kernel share one in any case.
    """

    def __init__(
        self, c_in: int, c_out: int, kernel: Triple = (3, 3, 3), bias: bool = False, book: str | None = None
    ) -> None:
        super().__init__(c_in, c_out, kernel, bias, book)

    def rulebook(self, sparse: SparseTensor) -> Book:
        """The shared rulebook or table, found on first use."""
        # The stored rulebook keeps the keys alive, so that their id stays theirs.
        tabled = self.by_table(sparse)
        name = ("submanifold", tabled, self.kernel, sparse.shape, id(sparse.keys))
        if name not in sparse.rulebooks:
            find = submanifold_book if self.by_kernels(sparse) else submanifold_rulebook
            sparse.rulebooks[name] = (
                submanifold_table(sparse, self.kernel) if tabled else find(sparse.keys, sparse.shape, self.kernel)
            )
        return cast(Book, sparse.rulebooks[name])


class SparseConv(_Conv):
    """Convolution, possibly strided, that makes every cell occupied which an input reaches.

    Args:
        c_in: Input channels.
        c_out: Output channels.
        kernel: Size along z, x and y.
        stride: Step along z, x and y.
        padding: Empty cells added on both sides along z, x and y.
        bias: Add a learned constant.
        book: Name under which an :class:`InverseConv` finds the rulebook.
    """

    def __init__(
        self,
        c_in: int,
        c_out: int,
        kernel: Triple = (3, 3, 3),
        stride: Triple = (2, 2, 2),
        padding: Triple = (1, 1, 1),
        bias: bool = False,
        book: str | None = None,
    ) -> None:
        super().__init__(c_in, c_out, kernel, bias, book)
        self.stride, self.padding = stride, padding

    def rulebook(self, sparse: SparseTensor) -> Book:
        """The shared rulebook or table, found on first use; an :class:`InverseConv` needs the rulebook."""
        tabled = self.book is None and self.by_table(sparse)
        name = ("strided", tabled, self.kernel, self.stride, self.padding, sparse.shape, id(sparse.keys))
        if name not in sparse.rulebooks:
            cells = (sparse.keys, sparse.shape, self.kernel, self.stride, self.padding)
            if tabled:
                sparse.rulebooks[name] = strided_table(sparse, *cells[2:])
            elif self.by_kernels(sparse):
                sparse.rulebooks[name] = strided_book(*cells, sparse.batch_size)
            else:
                sparse.rulebooks[name] = strided_rulebook(*cells)
        book = cast(Book, sparse.rulebooks[name])
        if self.book is not None and sparse.rulebooks.setdefault(self.book, book) is not book:
            raise ValueError(f"Expected rulebook {self.book!r} at one set of cells; got a second: name it otherwise.")
        return book


class InverseConv(_Conv):
    """The way back of a :class:`SparseConv`: its outputs stand where that layer's inputs were.

    Args:
        c_in: Input channels.
        c_out: Output channels.
        kernel: Size along z, x and y, that of the layer to undo.
        book: Name of that layer's rulebook.
        bias: Add a learned constant.
    """

    def __init__(self, c_in: int, c_out: int, kernel: Triple, book: str, bias: bool = False) -> None:
        super().__init__(c_in, c_out, kernel, bias, book)

    def rulebook(self, sparse: SparseTensor) -> Rulebook | DeviceBook:
        """That layer's rulebook with input and output exchanged."""
        book = sparse.rulebooks.get(self.book)
        if book is None or book.keys is not sparse.keys:
            raise ValueError(f"Expected cells made by the SparseConv with book={self.book!r}; got others.")
        if book.size != len(self.weight):
            raise ValueError(f"Expected the kernel of book {self.book!r}; got {self.kernel}.")
        return cast(Rulebook | DeviceBook, book.inverse)


class SparseBlock(nn.Module):
    """Sparse convolution, batch normalisation, ReLU.

    Args:
        conv: The convolution.
        norm: Normalises its outputs. With fewer than two cells it uses its running statistics, in training too.
        relu: Apply ReLU at the end.
    """

    def __init__(self, conv: _Conv, norm: nn.Module, relu: bool = True) -> None:
        super().__init__()
        self.conv, self.norm, self.relu = conv, norm, relu

    def plan(self, sparse: SparseTensor) -> SparseTensor:
        """Find the rulebook; gives the cells after the block, without features."""
        return self.conv.plan(sparse)

    def forward(self, sparse: SparseTensor, added: torch.Tensor | None = None) -> SparseTensor:
        """Apply the block; what is added, shape (n_out, c), comes before ReLU."""
        if isinstance(self.norm, nn.Identity):
            return cast(SparseTensor, self.conv(sparse, self.relu, added))
        sparse = self.conv(sparse)
        return sparse.replace(completed(normalise_rows(self.norm, sparse.features), self.relu, added))

    @torch.no_grad()
    def fold_norm(self) -> None:
        """Move the normalisation of evaluation mode into the convolution, in place."""
        norm, conv = self.norm, self.conv
        if not isinstance(norm, nn.BatchNorm1d):
            return
        scale, shift = affine(norm)
        bias = shift if conv.bias is None else conv.bias * scale + shift
        conv.weight.mul_(scale)
        conv.bias = nn.Parameter(bias.clone())
        self.norm = nn.Identity()


class SparseSequential(nn.Sequential):
    """Layers one after the other, each with a method ``plan``.

    All rulebooks are found before the first product is made. Between the products, which need the caches for
    themselves, the same searches take half as long again (on a CPU: a tenth of the whole).
    """

    def plan(self, sparse: SparseTensor) -> SparseTensor:
        """Find the rulebooks; gives the cells after the last layer, without features."""
        for layer in self:
            sparse = cast(Any, layer).plan(sparse)
        return sparse

    def forward(self, sparse: SparseTensor) -> SparseTensor:
        """Apply the layers."""
        self.plan(sparse)
        return cast(SparseTensor, super().forward(sparse))
