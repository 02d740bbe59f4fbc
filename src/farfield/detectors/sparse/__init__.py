"""Sparse convolution in plain PyTorch: features on a sorted list of occupied cells, nothing to compile."""

from farfield.detectors.sparse.cells import SparseTensor, decode_keys, dilate, encode_keys, neighbour_table
from farfield.detectors.sparse.layers import (
    FLAT,
    InverseConv,
    SparseBlock,
    SparseConv,
    SparseSequential,
    SubmanifoldConv,
    normalised,
    sparse_conv,
)
from farfield.detectors.sparse.rulebook import (
    Rulebook,
    kernel_offsets,
    strided_rulebook,
    submanifold_rulebook,
)

__all__ = [
    "FLAT",
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
    "normalised",
    "sparse_conv",
    "strided_rulebook",
    "submanifold_rulebook",
]
