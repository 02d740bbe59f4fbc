"""Sparse convolution as gather and matrix product, with a hand-written gradient that stores only the rulebook."""

import importlib.util
import math
from functools import cache
from types import ModuleType
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from farfield.detectors.blocks.sparse.blocks import Block
from farfield.detectors.blocks.sparse.rulebook import Rulebook

_BLOCK_BYTES = 2**20  # what a block gathers should stay in the second-level cache
_USUAL_NEIGHBOURS = 16


def sparse_conv(features: Tensor, weight: Tensor, book: Rulebook, bias: Tensor | None = None) -> Tensor:
    """Convolve the features of occupied cells.

    Args:
        features: Input rows, shape (n_in, c_in).
        weight: Kernel, shape (K, c_in, c_out), of the features' dtype.
        book: Which input meets which output.
        bias: Added to each output, shape (c_out,), of the features' dtype.

    Returns:
        Output rows, shape (n_out, c_out).
    """
    out: Tensor = _SparseConv.apply(features, weight, bias, book)
    return out


class _SparseConv(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, weight: Tensor, bias: Tensor | None, book: Rulebook) -> Tensor:
        ctx.save_for_backward(features, weight)
        ctx.book = book
        return gather_product(features, weight, bias, book)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, Tensor | None, Tensor | None, None]:
        features, weight = ctx.saved_tensors
        book: Rulebook = ctx.book
        gradient = gradients[0].contiguous()
        to_features = to_weight = to_bias = None
        if ctx.needs_input_grad[0]:
            back = weight.transpose(1, 2)
            # A symmetric rulebook is its own inverse, read with the kernel mirrored.
            way = (back.flip(0), None, book) if book.symmetric else (back, None, book.inverse)
            to_features = gather_product(gradient, *way)
        if ctx.needs_input_grad[1]:
            to_weight = weight_gradient(features, gradient, book).to(weight.dtype)
        if ctx.needs_input_grad[2]:
            to_bias = gradient.sum(0)
        return to_features, to_weight, to_bias, None


def gather_product(features: Tensor, weight: Tensor, bias: Tensor | None, book: Rulebook) -> Tensor:
    """Rows ``sum_k features[table[:, k]] @ weight[k] + bias``, block by block; no gradient."""
    kernels = _gpu_kernels(features)
    if kernels is not None:
        product = kernels.gather_product(features, weight, book.similar.order, book.similar.table)
        return product if bias is None else product + bias
    c_in, c_out = weight.shape[1:]
    out = features.new_empty(len(book.table), c_out)
    padded = torch.cat([features, features.new_zeros(1, c_in)])
    as_conv = _is_conv_faster(features)
    # The kernel in the order in which the product reads it: a selection of elements is then a copy of whole rows.
    kernel = weight.permute(2, 0, 1).contiguous() if as_conv else weight.contiguous()
    blocks = _blocks(book, features)
    scratch = _scratch(blocks, padded)
    for block in blocks:
        if block.sources.numel() == 0:
            out[block.rows] = 0 if bias is None else bias
            continue
        gathered = _gather(padded, block, scratch)
        used = kernel if block.columns is None else kernel.index_select(1 if as_conv else 0, block.columns)
        if as_conv:
            product = functional.conv2d(_as_image(gathered), used.view(c_out, -1, 1, 1), bias)
            product = product.permute(0, 2, 3, 1).reshape(-1, c_out)
        elif bias is not None:
            product = torch.addmm(bias, gathered, used.view(-1, c_out))
        else:
            product = gathered @ used.view(-1, c_out)
        if block.rows is None:
            return product
        out.index_copy_(0, block.rows, product)
    return out


def weight_gradient(features: Tensor, gradient: Tensor, book: Rulebook) -> Tensor:
    """Gradient of the weights, shape (K, c_in, c_out), at least float32; summed block by block."""
    kernels = _gpu_kernels(features)
    if kernels is not None:
        total: Tensor = kernels.weight_gradient(features, gradient, book.similar.order, book.similar.table)
        return total
    size, c_in, c_out = book.table.shape[1], features.shape[1], gradient.shape[1]
    padded = torch.cat([features, features.new_zeros(1, c_in)])
    exact = torch.promote_types(features.dtype, torch.float32)
    total = torch.zeros(size, c_in, c_out, dtype=exact, device=features.device)
    as_conv = _is_conv_faster(features) and c_in * c_out >= 512
    blocks = _blocks(book, features)
    scratch = _scratch(blocks, padded)
    for block in blocks:
        if block.sources.numel() == 0:
            continue
        gathered = _gather(padded, block, scratch)
        arrived = gradient if block.rows is None else gradient.index_select(0, block.rows)
        if as_conv:
            where = (c_out, gathered.shape[1], 1, 1)
            part = torch.nn.grad.conv2d_weight(_as_image(gathered), where, _as_image(arrived))
            part = part.view(c_out, -1, c_in).permute(1, 2, 0)
        else:
            part = (gathered.t() @ arrived).view(-1, c_in, c_out)
        if block.columns is None:
            total += part
        else:
            total.index_add_(0, block.columns, part.to(total.dtype))
    return total


def _blocks(book: Rulebook, features: Tensor) -> list[Block]:
    if features.device.type != "cpu":
        return [Block(None, None, book.table)]
    row_bytes = features.shape[1] * features.element_size() * min(book.table.shape[1], _USUAL_NEIGHBOURS)
    rows = 2 ** round(math.log2(_BLOCK_BYTES / row_bytes))
    return book.blocks(min(max(rows, 512), 4096))


def _gather(padded: Tensor, block: Block, scratch: Tensor) -> Tensor:
    """Input rows side by side, shape (rows, kernel elements * c_in)."""
    rows = block.sources.numel()
    torch.index_select(padded, 0, block.sources.reshape(-1), out=scratch[:rows])
    return scratch[:rows].view(len(block.sources), -1)


def _scratch(blocks: list[Block], padded: Tensor) -> Tensor:
    """Room for what the largest block gathers."""
    return padded.new_empty(max((block.sources.numel() for block in blocks), default=0), padded.shape[1])


def _gpu_kernels(features: Tensor) -> ModuleType | None:
    """The Triton kernels, for tensors that they can take."""
    if features.device.type != "cuda" or features.dtype == torch.float64:
        return None
    return _import_kernels()


@cache
def _import_kernels() -> ModuleType | None:
    if importlib.util.find_spec("triton") is None:
        return None
    return importlib.import_module("farfield.detectors.blocks.sparse.triton_kernels")


def _is_conv_faster(features: Tensor) -> bool:
    """Whether a product of float32 matrices is better put as a 1x1 convolution.

    PyTorch sends float32 products on the CPU to MKL, which leaves AVX-512 unused on processors of other makers, and
    convolutions to oneDNN, which uses it: 2.4 times as fast on Zen 5.
    """
    return features.dtype == torch.float32 and features.device.type == "cpu" and torch.backends.mkldnn.is_available()


def _as_image(rows: Tensor) -> Tensor:
    """Rows (n, c) as an image (1, c, n, 1) in channels_last memory, without copying."""
    return rows.view(1, len(rows), 1, -1).permute(0, 3, 1, 2)
