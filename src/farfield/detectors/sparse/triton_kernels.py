"""Sparse convolution on a GPU: implicit matrix products over the neighbour table, written in Triton.

Gathered rows never reach the GPU's memory; sums are float32. Rows come sorted by their set of neighbours, so that a
program skips kernel elements that none of its rows has.
"""

from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from farfield.detectors.devices import jit

triton: Any = import_module("triton")
tl: Any = import_module("triton.language")

_BLOCK_ROWS = 64
_PARTIAL_BYTES = 2**26


@jit
def _gather_product_kernel(  # type: ignore[no-untyped-def]
    features, weight, table, order, bias, added, out, count, none,
    size: tl.constexpr, c_in: tl.constexpr, c_out: tl.constexpr,
    block_rows: tl.constexpr, block_in: tl.constexpr, block_out: tl.constexpr,
    ordered: tl.constexpr, biased: tl.constexpr, residual: tl.constexpr, relu: tl.constexpr,
):  # fmt: skip
    row = tl.program_id(0) * block_rows + tl.arange(0, block_rows)
    column = tl.program_id(1) * block_out + tl.arange(0, block_out)
    row_in, column_in = row < count, column < c_out
    total = tl.zeros((block_rows, block_out), dtype=tl.float32)
    for element in range(size):
        source = tl.load(table + row.to(tl.int64) * size + element, mask=row_in, other=none)
        occupied = source < none
        if tl.max(occupied.to(tl.int32), axis=0) > 0:
            for start in range(0, c_in, block_in):
                channel = start + tl.arange(0, block_in)
                there = occupied[:, None] & (channel < c_in)[None, :]
                left = tl.load(features + source.to(tl.int64)[:, None] * c_in + channel[None, :], mask=there, other=0.0)
                entry = (element * c_in + channel)[:, None] * c_out + column[None, :]
                right = tl.load(weight + entry, mask=(channel < c_in)[:, None] & column_in[None, :], other=0.0)
                total += tl.dot(left, right, input_precision="ieee")
    if biased:
        total += tl.load(bias + column, mask=column_in, other=0.0).to(tl.float32)[None, :]
    target = row.to(tl.int64)
    if ordered:
        target = tl.load(order + row, mask=row_in, other=0).to(tl.int64)
    entry = target[:, None] * c_out + column[None, :]
    real = row_in[:, None] & column_in[None, :]
    if residual:
        total += tl.load(added + entry, mask=real, other=0.0).to(tl.float32)
    if relu:
        total = tl.maximum(total, 0.0)
    tl.store(out + entry, total.to(out.dtype.element_ty), mask=real)


@jit
def _weight_gradient_kernel(  # type: ignore[no-untyped-def]
    features, gradient, table, order, partial, count, none, share,
    size: tl.constexpr, c_in: tl.constexpr, c_out: tl.constexpr,
    block_rows: tl.constexpr, block_in: tl.constexpr, block_out: tl.constexpr,
):  # fmt: skip
    element, part = tl.program_id(0), tl.program_id(1)
    tiles = (c_out + block_out - 1) // block_out
    channel = (tl.program_id(2) // tiles) * block_in + tl.arange(0, block_in)
    column = (tl.program_id(2) % tiles) * block_out + tl.arange(0, block_out)
    channel_in, column_in = channel < c_in, column < c_out
    total = tl.zeros((block_in, block_out), dtype=tl.float32)
    for start in range(0, share, block_rows):
        row = part * share + start + tl.arange(0, block_rows)
        row_in = row < count
        source = tl.load(table + row.to(tl.int64) * size + element, mask=row_in, other=none)
        occupied = source < none
        if tl.max(occupied.to(tl.int32), axis=0) > 0:
            target = tl.load(order + row, mask=row_in, other=0).to(tl.int64)
            there = channel_in[:, None] & occupied[None, :]
            left = tl.load(features + source.to(tl.int64)[None, :] * c_in + channel[:, None], mask=there, other=0.0)
            there = occupied[:, None] & column_in[None, :]
            right = tl.load(gradient + target[:, None] * c_out + column[None, :], mask=there, other=0.0)
            total += tl.dot(left, right, input_precision="ieee")
    entry = ((part * size + element) * c_in + channel).to(tl.int64)[:, None] * c_out + column[None, :]
    tl.store(partial + entry, total, mask=channel_in[:, None] & column_in[None, :])


def gather_product(
    features: Tensor,
    weight: Tensor,
    order: Tensor | None,
    table: Tensor,
    bias: Tensor | None = None,
    relu: bool = False,
    added: Tensor | None = None,
) -> Tensor:
    """Rows ``sum_k features[table[:, k]] @ weight[k] + bias + added``, put back in order.

    Args:
        features: Input rows, shape (n_in, c_in).
        weight: Kernel, shape (K, c_in, c_out), of the features' dtype: float32, float16 or bfloat16.
        order: Output row of each row of the table, shape (n_out,), int64; None where they are in order.
        table: Input row under each kernel element, ``n_in`` for none, shape (n_out, K), int32.
        bias: Added to each row, shape (c_out,).
        relu: Make negative numbers of the result zero.
        added: Added to the result, shape (n_out, c_out).

    Returns:
        Output rows, shape (n_out, c_out).
    """
    size, c_in, c_out = weight.shape
    out = features.new_empty(len(table), c_out)
    if len(table) == 0:
        return out
    block_out = _tile(c_out)
    grid = (triton.cdiv(len(table), _BLOCK_ROWS), triton.cdiv(c_out, block_out))
    _gather_product_kernel[grid](
        features.contiguous(), weight.contiguous(), table, table if order is None else order,
        out if bias is None else bias, out if added is None else added.contiguous(), out, len(table), len(features),
        size, c_in, c_out, _BLOCK_ROWS, min(_tile(c_in), 32), block_out,
        order is not None, bias is not None, added is not None, relu,
    )  # fmt: skip
    return out


def weight_gradient(features: Tensor, gradient: Tensor, order: Tensor, table: Tensor) -> Tensor:
    """Gradient of the weights, shape (K, c_in, c_out), float32.

    Partial sums are added in a fixed order, so the same input gives the same gradient.

    Args:
        features: Input rows, shape (n_in, c_in).
        gradient: Gradient of the output rows, shape (n_out, c_out), of the features' dtype.
        order: Output row of each row of the table, shape (n_out,), int64.
        table: Input row under each kernel element, ``n_in`` for none, shape (n_out, K), int32.
    """
    (count, size), c_in, c_out = table.shape, features.shape[1], gradient.shape[1]
    most = max(1, _PARTIAL_BYTES // (4 * size * c_in * c_out))
    parts = max(1, min(triton.cdiv(count, 16 * _BLOCK_ROWS), most, 64))
    share = triton.cdiv(triton.cdiv(count, parts), _BLOCK_ROWS) * _BLOCK_ROWS
    partial = torch.empty(parts, size, c_in, c_out, dtype=torch.float32, device=features.device)
    block_in, block_out = _tile(c_in), _tile(c_out)
    grid = (size, parts, triton.cdiv(c_in, block_in) * triton.cdiv(c_out, block_out))
    _weight_gradient_kernel[grid](
        features.contiguous(), gradient.contiguous(), table, order, partial, count, len(features), share,
        size, c_in, c_out, _BLOCK_ROWS, block_in, block_out,
    )  # fmt: skip
    return partial.sum(0)


def _tile(channels: int) -> int:
    """Width of a tile: a power of two, 16 to 64."""
    return min(max(16, 2 ** (channels - 1).bit_length()), 64)
