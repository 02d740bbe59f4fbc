"""Sparse convolution as gather and matrix product, with a hand-written gradient that stores only the rulebook."""

from typing import Any

import torch
from torch import Tensor

from farfield.detectors.blocks.sparse.rulebook import Rulebook

_BLOCK_ROWS = 4096


def sparse_conv(features: Tensor, weight: Tensor, book: Rulebook, bias: Tensor | None = None) -> Tensor:
    """Convolve the features of occupied cells.

    Args:
        features: Input rows, shape (n_in, c_in).
        weight: Kernel, shape (K, c_in, c_out), of the features' dtype.
        book: Which input meets which output.
        bias: Added to each output, shape (c_out,).

    Returns:
        Output rows, shape (n_out, c_out).
    """
    out: Tensor = _SparseConv.apply(features, weight, book)
    return out if bias is None else out + bias


class _SparseConv(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, weight: Tensor, book: Rulebook) -> Tensor:
        ctx.save_for_backward(features, weight)
        ctx.book = book
        return gather_gemm(features, weight, book.table)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        features, weight = ctx.saved_tensors
        gradient = gradients[0].contiguous()
        to_features = to_weight = None
        if ctx.needs_input_grad[0]:
            to_features = gather_gemm(gradient, weight.transpose(1, 2), ctx.book.transposed)
        if ctx.needs_input_grad[1]:
            to_weight = weight_gradient(features, gradient, ctx.book.table).to(weight.dtype)
        return to_features, to_weight, None


def gather_gemm(features: Tensor, weight: Tensor, table: Tensor) -> Tensor:
    """Rows ``sum_k features[table[:, k]] @ weight[k]``, in blocks of rows that stay in the cache."""
    size, c_in, c_out = weight.shape
    padded = torch.cat([features, features.new_zeros(1, c_in)])
    matrix = weight.reshape(size * c_in, c_out)
    out = features.new_empty(len(table), c_out)
    for start in range(0, len(table), _BLOCK_ROWS):
        rows = slice(start, start + _BLOCK_ROWS)
        columns = padded.index_select(0, table[rows].reshape(-1)).view(-1, size * c_in)
        torch.mm(columns, matrix, out=out[rows])
    return out


def weight_gradient(features: Tensor, gradient: Tensor, table: Tensor) -> Tensor:
    """Gradient of the weights, shape (K, c_in, c_out), float32."""
    size, c_in, c_out = table.shape[1], features.shape[1], gradient.shape[1]
    padded = torch.cat([features, features.new_zeros(1, c_in)])
    total = torch.zeros(size * c_in, c_out, dtype=torch.float32, device=features.device)
    for start in range(0, len(table), _BLOCK_ROWS):
        rows = slice(start, start + _BLOCK_ROWS)
        columns = padded.index_select(0, table[rows].reshape(-1)).view(-1, size * c_in)
        total += columns.t() @ gradient[rows]
    return total.view(size, c_in, c_out)
