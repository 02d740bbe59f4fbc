"""Occupied cells of a grid in numpy: their numbers, and tables of which cell meets which under a kernel.

What :mod:`farfield.detectors.sparse` does in PyTorch for a batch, here for one frame and without it: an exported
network takes the tables as inputs and makes the products.
"""

from itertools import product

import numpy as np
from jaxtyping import Float, Float32, Int

Triple = tuple[int, int, int]


def split_keys(keys: Int[np.ndarray, " n"], shape: Triple) -> Int[np.ndarray, "3 n"]:
    """z, x and y of cells that are numbered ``(iz * nx + ix) * ny + iy``, shape (3, n)."""
    rest, iy = np.divmod(keys, shape[2])
    iz, ix = np.divmod(rest, shape[1])
    return np.stack([iz, ix, iy])


def rows_among(keys: Int[np.ndarray, " n"], queries: Int[np.ndarray, "*m"]) -> Int[np.ndarray, "*m"]:
    """Row of each queried number among ascending ones, ``n`` where it is not there."""
    if not len(keys):
        return np.zeros(queries.shape, dtype=np.int64)
    row = np.minimum(np.searchsorted(keys, queries), len(keys) - 1)
    return np.where(keys[row] == queries, row, len(keys))


def neighbour_table(
    keys: Int[np.ndarray, " n"], queries: Int[np.ndarray, " m"], shape: Triple, kernel: Triple
) -> Int[np.ndarray, "m k"]:
    """Row in ``keys`` of each neighbour of the queried cells under a kernel around it, ``n`` for none.

    Args:
        keys: Occupied cells, ascending.
        queries: Cells whose neighbours are sought.
        shape: Cells along z, x and y.
        kernel: Odd size along z, x and y.
    """
    index = split_keys(queries, shape)
    table = np.full((len(queries), int(np.prod(kernel))), len(keys), dtype=np.int64)
    for number, step in enumerate(product(*(range(-(size // 2), size // 2 + 1) for size in kernel))):
        inside = np.ones(len(queries), dtype=np.bool_)
        for along, by, size in zip(index, step, shape, strict=True):
            if by:
                inside &= (along + by >= 0) & (along + by < size)
        rows = np.flatnonzero(inside)
        table[rows, number] = rows_among(keys, queries[rows] + (step[0] * shape[1] + step[1]) * shape[2] + step[2])
    return table


def strided_shape(shape: Triple, kernel: Triple, stride: Triple, padding: Triple) -> Triple:
    """Output grid of a convolution."""
    sizes = zip(shape, kernel, stride, padding, strict=True)
    depth, nx, ny = ((size + 2 * pad - wide) // step + 1 for size, wide, step, pad in sizes)
    return depth, nx, ny


def strided_table(
    keys: Int[np.ndarray, " n"], shape: Triple, kernel: Triple, stride: Triple, padding: Triple
) -> tuple[Int[np.ndarray, " m"], Triple, Int[np.ndarray, "m k"]]:
    """Outputs at every cell that some input reaches.

    Args:
        keys: Occupied cells, ascending.
        shape: Cells along z, x and y.
        kernel: Size along z, x and y.
        stride: Step along them.
        padding: Empty cells on both sides along them.

    Returns:
        Output cells, ascending; their grid; and row of the input under each kernel element, ``n`` for none.
    """
    out_shape, index = strided_shape(shape, kernel, stride, padding), split_keys(keys, shape)
    sources, targets = [], []
    for step in product(*map(range, kernel)):
        fits = np.ones(len(keys), dtype=np.bool_)
        target = np.zeros(len(keys), dtype=np.int64)
        for along, by, every, pad, size in zip(index, step, stride, padding, out_shape, strict=True):
            output, rest = np.divmod(along + (pad - by), every)
            fits &= (rest == 0) & (output >= 0) & (output < size)
            target = target * size + output
        rows = np.flatnonzero(fits)
        sources.append(rows)
        targets.append(target[rows])
    reached, member = np.unique(np.concatenate(targets), return_inverse=True)
    table = np.full((len(reached), len(sources)), len(keys), dtype=np.int64)
    first = 0
    for number, rows in enumerate(sources):
        table[member[first : first + len(rows)], number] = rows
        first += len(rows)
    return reached, out_shape, table


def means_by_group(
    values: Float[np.ndarray, "n c"], member: Int[np.ndarray, " n"], groups: int
) -> Float[np.ndarray, "g c"]:
    """Mean of the rows of each group, in float64; sums of float32 numbers near one another are exact there."""
    count = np.bincount(member, minlength=groups)
    sums = [np.bincount(member, weights=column, minlength=groups) for column in values.T.astype(np.float64)]
    return np.column_stack(sums) / count[:, None] if sums else np.zeros((groups, 0))


def first_of_groups(member: Int[np.ndarray, " n"], limit: int) -> Int[np.ndarray, " k"]:
    """Rows of the items that are among the first ``limit`` of their group, ascending; 0 takes all."""
    if limit == 0:
        return np.arange(len(member))
    order = np.argsort(member, kind="stable")
    _, start, count = np.unique(member[order], return_index=True, return_counts=True)
    rank = np.arange(len(member)) - np.repeat(start, count)
    return np.sort(order[rank < limit])


def in_float32(values: Float[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """The numbers as float32, contiguous: what an exported network reads."""
    return np.ascontiguousarray(values, dtype=np.float32)
