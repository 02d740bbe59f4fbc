"""Sparse convolution: gather, multiply, sum; with a hand-written gradient that stores only the rulebook."""

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from farfield.detectors.sparse.device_books import DeviceBook
from farfield.detectors.sparse.rulebook import BLOCK_PAIRS, Rulebook
from farfield.detectors.sparse.tables import NeighbourTable, table_product
from farfield.detectors.triton_jit import has_triton

_MAX_PRODUCT_BYTES = 2**28
_GATHERED_BYTES = 2**22  # stays in the cache
_LARGE_KERNEL = 1024
_ROWS_AT_ONCE = 64
_BATCHED = (torch.bfloat16, torch.float16)


def sparse_conv(
    features: Tensor,
    weight: Tensor,
    book: Rulebook | DeviceBook | NeighbourTable,
    bias: Tensor | None = None,
    relu: bool = False,
    added: Tensor | None = None,
) -> Tensor:
    """Convolve the features of occupied cells.

    Args:
        features: Input rows, shape (n_in, c_in).
        weight: Kernel, shape (K, c_in, c_out), of the features' dtype.
        book: Which input meets which output; by a table there is no gradient.
        bias: Added to each output, shape (c_out,), of the features' dtype.
        relu: Make negative outputs zero.
        added: Added to the outputs before that, shape (n_out, c_out).

    Returns:
        Output rows, shape (n_out, c_out).
    """
    if isinstance(book, NeighbourTable):
        return completed(table_product(features, weight, book.rows, bias), relu, added)
    given = (features, weight) if bias is None else (features, weight, bias)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in given):
        out: Tensor = _SparseConv.apply(features, weight, book)
        return completed(out if bias is None else out + bias, relu, added)
    return gather_product(features, weight, book, bias, relu, added)


def completed(rows: Tensor, relu: bool, added: Tensor | None) -> Tensor:
    """Rows that nobody else holds, something added to them, and rectified."""
    rows = rows if added is None else added.to(rows.dtype) + rows
    return rows.relu_() if relu else rows


def _add_bias(rows: Tensor, bias: Tensor | None) -> Tensor:
    """``rows + bias``, in place.

    PyTorch adds a vector to rows of 16 bfloat16 numbers one by one, so many rows are taken for one long one.
    """
    if bias is None:
        return rows
    whole = len(rows) // _ROWS_AT_ONCE * _ROWS_AT_ONCE
    rows[:whole].view(-1, _ROWS_AT_ONCE * len(bias)).add_(bias.repeat(_ROWS_AT_ONCE))
    rows[whole:].add_(bias)
    return rows


class _SparseConv(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, weight: Tensor, book: Rulebook | DeviceBook) -> Tensor:
        ctx.save_for_backward(features, weight)
        ctx.book = book
        return gather_product(features, weight, book)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        features, weight = ctx.saved_tensors
        book: Rulebook | DeviceBook = ctx.book
        gradient = gradients[0].contiguous()
        to_features = to_weight = None
        if ctx.needs_input_grad[0]:
            back = weight.transpose(1, 2)
            to_features = gather_product(gradient, *((back.flip(0), book) if book.symmetric else (back, book.inverse)))
        if ctx.needs_input_grad[1]:
            to_weight = weight_gradient(features, gradient, book).to(weight.dtype)
        return to_features, to_weight, None


def gather_product(
    features: Tensor,
    weight: Tensor,
    book: Rulebook | DeviceBook,
    bias: Tensor | None = None,
    relu: bool = False,
    added: Tensor | None = None,
) -> Tensor:
    """Each output the sum of ``features[source] @ weight[element]`` over its pairs, and the bias; no gradient.

    Products are made one kernel element at a time and written side by side; then each output sums its own. That reads
    and writes every number once, where adding up element by element would go over the outputs K times.
    """
    kernels = _gpu_kernels(features)
    if kernels is not None:
        rows = (None, book.table) if _in_order(features, book) else book.similar
        made: Tensor = kernels.gather_product(features, weight, *rows, bias, relu, added)
        return made
    assert isinstance(book, Rulebook), "a table is for the kernels alone"
    return completed(_pair_product(features, weight, book, bias), relu, added)


def _in_order(features: Tensor, book: Rulebook | DeviceBook) -> bool:
    """Whether kernels take the rows as they come.

    Matrix units multiply more in less time than sorting the rows takes; float32 has none, and a training sorts once for
    three products.
    """
    return isinstance(book, DeviceBook) and features.element_size() == 2 and not torch.is_grad_enabled()


def _pair_product(features: Tensor, weight: Tensor, book: Rulebook, bias: Tensor | None) -> Tensor:
    c_out = weight.shape[2]
    if len(book.sources) * c_out * features.element_size() > _MAX_PRODUCT_BYTES:
        return _add_bias(_add_up(features, weight, book), bias)
    products = features.new_empty(len(book.sources), c_out)
    if features.dtype in _BATCHED:
        _multiply_blocks(features, weight, book, products)
    else:
        for element, pairs in book.elements():
            if not (book.symmetric and element == len(weight) // 2):
                _multiply(features.index_select(0, book.sources[pairs]), weight[element], products[pairs])
    if book.symmetric:  # each output once, so that the bias can be added here
        _multiply(features, weight[len(weight) // 2], products[len(products) - len(features) :], bias)
    order, starts = book.by_target
    if len(starts) == 0:
        return features.new_zeros(0, c_out)
    out = functional.embedding_bag(order, products, starts, mode="sum")
    return out if book.symmetric else _add_bias(out, bias)


def _multiply_blocks(features: Tensor, weight: Tensor, book: Rulebook, products: Tensor) -> None:
    """Products in half precision, many blocks at once: a call costs oneDNN as much as a small product."""
    c_in, c_out = weight.shape[1:]
    elements = book.block_elements
    in_blocks = len(elements) * BLOCK_PAIRS
    at_once = max(1, _GATHERED_BYTES // (BLOCK_PAIRS * c_in * features.element_size()))
    sources, out = (
        book.sources[:in_blocks].split(at_once * BLOCK_PAIRS),
        products[:in_blocks].view(-1, BLOCK_PAIRS, c_out),
    )
    for rows, numbers, made in zip(sources, elements.split(at_once), out.split(at_once), strict=True):
        gathered = features.index_select(0, rows).view(-1, BLOCK_PAIRS, c_in)
        torch.bmm(gathered, weight.index_select(0, numbers), out=made)


def _add_up(features: Tensor, weight: Tensor, book: Rulebook) -> Tensor:
    """The same in less memory: sums in float32, element by element."""
    total = features.new_zeros(len(book.keys), weight.shape[2], dtype=_exact(features))
    for element, pairs in book.elements():
        product = features.index_select(0, book.sources[pairs]) @ weight[element]
        total.index_add_(0, book.targets[pairs].long(), product.to(total.dtype))
    return total.to(features.dtype)


def weight_gradient(features: Tensor, gradient: Tensor, book: Rulebook | DeviceBook) -> Tensor:
    """Gradient of the weights, shape (K, c_in, c_out), at least float32."""
    kernels = _gpu_kernels(features)
    if kernels is not None:
        total: Tensor = kernels.weight_gradient(features, gradient, *book.similar)
        return total
    assert isinstance(book, Rulebook), "a table is for the kernels alone"
    total = features.new_zeros(len(book.counts), features.shape[1], gradient.shape[1], dtype=_exact(features))
    for element, pairs in book.elements():
        entered = features.index_select(0, book.sources[pairs])
        total[element] = entered.t() @ gradient.index_select(0, book.targets[pairs])
    return total


def _exact(features: Tensor) -> torch.dtype:
    return torch.promote_types(features.dtype, torch.float32)


def _multiply(rows: Tensor, matrix: Tensor, out: Tensor, bias: Tensor | None = None) -> None:
    """``out = rows @ matrix + bias``.

    PyTorch sends float32 products on the CPU to MKL, which leaves AVX-512 unused on processors of other makers; 1x1
    convolutions go to oneDNN, which uses it, if there is more than one thread: 2.4 times as fast on Zen 5. That pays
    for the copy of the result where the product is large.
    """
    c_in, c_out = matrix.shape
    large = len(rows) > 0 and c_in * c_out >= _LARGE_KERNEL  # a convolution takes no image without rows
    if large and rows.dtype == torch.float32 and rows.device.type == "cpu" and _has_onednn():
        image = rows.view(1, len(rows), 1, c_in).permute(0, 3, 1, 2)
        product = functional.conv2d(image, matrix.t().reshape(c_out, c_in, 1, 1), bias)
        out.copy_(product.permute(0, 2, 3, 1).view(-1, c_out))
    elif bias is None:
        torch.mm(rows, matrix, out=out)
    else:
        torch.addmm(bias, rows, matrix, out=out)


def _has_onednn() -> bool:
    return torch.get_num_threads() > 1 and torch.backends.mkldnn.is_available()


def has_kernels(device: str, dtype: torch.dtype) -> bool:
    """Whether there are Triton kernels for numbers of a type on a kind of device."""
    return device == "cuda" and dtype != torch.float64 and _import_kernels() is not None


def _gpu_kernels(features: Tensor) -> ModuleType | None:
    """The Triton kernels, for tensors that they can take."""
    return _import_kernels() if has_kernels(features.device.type, features.dtype) else None


@cache
def _import_kernels() -> ModuleType | None:
    return import_module("farfield.detectors.sparse.triton_kernels") if has_triton() else None
