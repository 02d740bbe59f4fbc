"""Neighbour tables on a GPU in one kernel each, written in Triton; see :mod:`farfield.detectors.sparse.tables`.

PyTorch takes some fifty calls for a table, and a network dozens of tables a frame: on a GPU the calls are the cost, not
the search. Here a program decodes the cells of some rows, steps to each kernel element and searches the keys.
"""

from collections.abc import Sequence
from functools import lru_cache
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from farfield.detectors.devices import jit
from farfield.detectors.sparse.cells import Triple

triton: Any = import_module("triton")
tl: Any = import_module("triton.language")

_LANES = 1024  # rows x elements of a program
_BITS = 62


@jit
def _met(  # type: ignore[no-untyped-def]
    sought, offsets, row, row_in, element, element_in, z_size, x_size, y_size, z_there, x_there, y_there,
    z_step: tl.constexpr, x_step: tl.constexpr, y_step: tl.constexpr, back: tl.constexpr,
):  # fmt: skip
    """Keys of the cells that the steps of some elements lead to from some rows, -1 for none.

    Forward, from an output: place * stride + step on the input's grid. Back, from an input: (place - step) / stride.
    """
    dz = tl.load(offsets + element * 3, mask=element_in, other=0)[None, :]
    dx = tl.load(offsets + element * 3 + 1, mask=element_in, other=0)[None, :]
    dy = tl.load(offsets + element * 3 + 2, mask=element_in, other=0)[None, :]
    key = tl.load(sought + row, mask=row_in, other=0)[:, None]
    rest = key // y_size
    y = key - rest * y_size
    above = rest // x_size
    x = rest - above * x_size
    frame = above // z_size
    z = above - frame * z_size
    if back:
        z, x, y = z - dz, x - dx, y - dy
        fits = (z >= 0) & (x >= 0) & (y >= 0) & (z % z_step == 0) & (x % x_step == 0) & (y % y_step == 0)
        z, x, y = z // z_step, x // x_step, y // y_step
    else:
        z, x, y = z * z_step + dz, x * x_step + dx, y * y_step + dy
        fits = (z >= 0) & (x >= 0) & (y >= 0)
    fits = fits & (z < z_there) & (x < x_there) & (y < y_there)
    return tl.where(fits, ((frame * z_there + z) * x_there + x) * y_there + y, -1)


@jit
def _rows_kernel(  # type: ignore[no-untyped-def]
    keys, sought, offsets, table, met, known_count, count, halvings, z_size, x_size, y_size, z_there, x_there, y_there,
    z_step: tl.constexpr, x_step: tl.constexpr, y_step: tl.constexpr, back: tl.constexpr,
    size: tl.constexpr, wide: tl.constexpr, block: tl.constexpr, bits: tl.constexpr,
):  # fmt: skip
    row = tl.program_id(0) * block + tl.arange(0, block)
    element = tl.arange(0, wide)
    row_in, element_in = row < count, element < size
    real = row_in[:, None] & element_in[None, :]
    query = _met(
        sought, offsets, row, row_in, element, element_in, z_size, x_size, y_size, z_there, x_there, y_there,
        z_step, x_step, y_step, back,
    )  # fmt: skip
    low = tl.zeros((block, wide), dtype=tl.int32)
    high = low + known_count
    for _ in range(halvings):
        middle = (low + high) // 2
        undecided = low < high
        less = tl.load(keys + middle, mask=undecided, other=0) < query
        low = tl.where(undecided & less, middle + 1, low)
        high = tl.where(undecided & (less == 0), middle, high)
    there = tl.load(keys + low, mask=low < known_count, other=-2)
    hit = real & (there == query)
    entry = row.to(tl.int64)[:, None] * size + element[None, :]
    tl.store(table + entry, tl.where(hit, low, known_count), mask=real)
    bit = tl.full((1, wide), 1, tl.int64) << (element % bits).to(tl.int64)[None, :]
    tl.store(met + row, tl.sum(tl.where(hit, bit, 0), axis=1), mask=row_in)


@jit
def _marks_kernel(  # type: ignore[no-untyped-def]
    sought, offsets, marks, count, z_size, x_size, y_size, z_there, x_there, y_there,
    z_step: tl.constexpr, x_step: tl.constexpr, y_step: tl.constexpr, back: tl.constexpr,
    size: tl.constexpr, wide: tl.constexpr, block: tl.constexpr,
):  # fmt: skip
    row = tl.program_id(0) * block + tl.arange(0, block)
    element = tl.arange(0, wide)
    row_in, element_in = row < count, element < size
    reached = _met(
        sought, offsets, row, row_in, element, element_in, z_size, x_size, y_size, z_there, x_there, y_there,
        z_step, x_step, y_step, back,
    )  # fmt: skip
    one = tl.full((block, wide), 1, tl.uint8)
    tl.store(marks + reached, one, mask=row_in[:, None] & element_in[None, :] & (reached >= 0))


@lru_cache(maxsize=256)
def _steps(offsets: tuple[Triple, ...], device: torch.device) -> Tensor:
    with torch.inference_mode(False):
        return torch.tensor(offsets, dtype=torch.int32, device=device)


def find_rows(
    keys: Tensor,
    sought: Tensor,
    offsets: Sequence[Triple],
    *,
    shape: Triple,
    shape_sought: Triple | None = None,
    stride: Triple = (1, 1, 1),
    back: bool = False,
) -> tuple[Tensor, Tensor]:
    """Rows of the cells that lie steps away from others.

    Args:
        keys: Cells to find, shape (n,), int64, ascending, each once.
        sought: Cells to start from, shape (m,), int64.
        offsets: The K steps along z, x and y.
        shape: The grid of ``keys``.
        shape_sought: That of ``sought``; by default the same.
        stride: From ``keys``' grid to a coarser one of ``sought``; with ``back`` the other way round.
        back: Find the places of which these are a step away: ``(place - step) / stride``.

    Returns:
        Their rows in ``keys``, ``n`` where there is none, shape (m, K), int32, and a number that is equal for equal
        sets of rows found, shape (m,).
    """
    size = len(offsets)
    table = torch.empty(len(sought), size, dtype=torch.int32, device=keys.device)
    met = torch.empty(len(sought), dtype=torch.int32 if size < 32 else torch.int64, device=keys.device)
    if len(sought) == 0:
        return table, met
    wide = triton.next_power_of_2(size)
    block = max(1, _LANES // wide)
    _rows_kernel[(triton.cdiv(len(sought), block),)](
        keys, sought, _steps(tuple(offsets), keys.device), table, met, len(keys), len(sought),
        len(keys).bit_length(), *(shape_sought or shape), *shape, *stride, back, size, wide, block, _BITS,
    )  # fmt: skip
    return table, met


def mark(
    marks: Tensor,
    sought: Tensor,
    offsets: Sequence[Triple],
    *,
    shape: Triple,
    shape_sought: Triple | None = None,
    stride: Triple = (1, 1, 1),
    back: bool = False,
) -> None:
    """Mark the cells that lie steps away from others, as :func:`find_rows` steps.

    Args:
        marks: One number a cell of all frames' grids of ``shape``, uint8; 1 is written.
        sought: Cells to start from, shape (m,), int64.
        offsets: As there, like the following.
        shape: The grid of the marks.
        shape_sought: That of ``sought``.
        stride: As there.
        back: As there.
    """
    if len(sought) == 0:
        return
    size = len(offsets)
    wide = triton.next_power_of_2(size)
    block = max(1, _LANES // wide)
    _marks_kernel[(triton.cdiv(len(sought), block),)](
        sought, _steps(tuple(offsets), marks.device), marks, len(sought),
        *(shape_sought or shape), *shape, *stride, back, size, wide, block,
    )  # fmt: skip
