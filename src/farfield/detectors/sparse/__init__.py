"""Sparse convolution in plain PyTorch: features on a sorted list of occupied cells, nothing to compile."""

from farfield.detectors.sparse.functional import sparse_conv
from farfield.detectors.sparse.layers import (
    InverseConv,
    SparseBlock,
    SparseConv,
    SparseSequential,
    SubmanifoldConv,
)
from farfield.detectors.sparse.neighbours import dilate, neighbour_table
from farfield.detectors.sparse.rulebook import (
    Rulebook,
    kernel_offsets,
    strided_rulebook,
    submanifold_rulebook,
)
from farfield.detectors.sparse.tensor import SparseTensor, decode_keys, encode_keys

__all__ = [
    "InverseConv",
    "Rulebook",
    "SparseBlock",
    "SparseConv",
    "SparseSequential",
    "SparseTensor",
    "SubmanifoldConv",
    "decode_keys",
    "dilate",
    "encode_keys",
    "kernel_offsets",
    "neighbour_table",
    "sparse_conv",
    "strided_rulebook",
    "submanifold_rulebook",
]
