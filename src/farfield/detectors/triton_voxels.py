"""Points to voxels on a GPU, written in Triton; see :mod:`farfield.detectors.voxels`.

Cells are numbered with true divisions, as on a CPU: PyTorch divides by a number on a GPU by multiplying with its
inverse, which moves points on the border of two cells to the other one.
"""

from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from farfield.detectors.devices import jit

triton: Any = import_module("triton")
tl: Any = import_module("triton.language")

_BLOCK = 256


@jit
def _cell(value, first, step):  # type: ignore[no-untyped-def]
    return tl.floor(tl.div_rn(value - first, step))


@jit
def _keys_kernel(  # type: ignore[no-untyped-def]
    points, batch, keys, grid, count, columns, depth, layers, nx, ny, block: tl.constexpr
):
    row = tl.program_id(0) * block + tl.arange(0, block)
    there = row < count
    at = points + row.to(tl.int64) * columns
    ix = _cell(tl.load(at, mask=there, other=0.0), tl.load(grid), tl.load(grid + 3))
    iy = _cell(tl.load(at + 1, mask=there, other=0.0), tl.load(grid + 1), tl.load(grid + 4))
    iz = _cell(tl.load(at + 2, mask=there, other=0.0), tl.load(grid + 2), tl.load(grid + 5))
    inside = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny) & (iz >= 0) & (iz < layers)
    ix, iy, iz = tl.where(inside, ix, 0.0), tl.where(inside, iy, 0.0), tl.where(inside, iz, 0.0)
    frame = tl.load(batch + row, mask=there, other=0)
    key = ((frame * depth + iz.to(tl.int64)) * nx + ix.to(tl.int64)) * ny + iy.to(tl.int64)
    tl.store(keys + row, tl.where(inside, key, -1), mask=there)


@jit
def _centre(key, grid, depth, nx, ny):  # type: ignore[no-untyped-def]
    rest = key // ny
    iy = key - rest * ny
    above = rest // nx
    ix = rest - above * nx
    iz = above % depth
    x = (ix.to(tl.float32) + 0.5) * tl.load(grid + 3) + tl.load(grid)
    y = (iy.to(tl.float32) + 0.5) * tl.load(grid + 4) + tl.load(grid + 1)
    z = (iz.to(tl.float32) + 0.5) * tl.load(grid + 5) + tl.load(grid + 2)
    return x, y, z


@jit
def _sums_kernel(  # type: ignore[no-untyped-def]
    points, rows, keys, member, sums, grid, count, columns, depth, nx, ny,
    extra: tl.constexpr, block: tl.constexpr,
):  # fmt: skip
    number = tl.program_id(0) * block + tl.arange(0, block)
    there = number < count
    cell = tl.load(member + number, mask=there, other=0)
    x, y, z = _centre(tl.load(keys + cell, mask=there, other=0), grid, depth, nx, ny)
    at = points + tl.load(rows + number, mask=there, other=0) * columns
    out = sums + cell * (4 + extra)
    tl.atomic_add(out, (tl.load(at, mask=there, other=0.0) - x).to(tl.float64), mask=there)
    tl.atomic_add(out + 1, (tl.load(at + 1, mask=there, other=0.0) - y).to(tl.float64), mask=there)
    tl.atomic_add(out + 2, (tl.load(at + 2, mask=there, other=0.0) - z).to(tl.float64), mask=there)
    tl.atomic_add(out + 3, tl.where(there, 1.0, 0.0).to(tl.float64), mask=there)
    for column in tl.static_range(extra):
        value = tl.load(at + 3 + column, mask=there, other=0.0)
        tl.atomic_add(out + 4 + column, value.to(tl.float64), mask=there)


@jit
def _means_kernel(  # type: ignore[no-untyped-def]
    sums, keys, features, grid, count, depth, nx, ny, first: tl.constexpr, extra: tl.constexpr, block: tl.constexpr
):
    cell = tl.program_id(0) * block + tl.arange(0, block)
    there = cell < count
    x, y, z = _centre(tl.load(keys + cell, mask=there, other=0), grid, depth, nx, ny)
    at = sums + cell.to(tl.int64) * (4 + extra)
    points = tl.load(at + 3, mask=there, other=1.0)
    dx = (tl.load(at, mask=there, other=0.0) / points).to(tl.float32)
    dy = (tl.load(at + 1, mask=there, other=0.0) / points).to(tl.float32)
    dz = (tl.load(at + 2, mask=there, other=0.0) / points).to(tl.float32)
    out = features + cell.to(tl.int64) * (7 - first + extra)
    tl.store(out, dx / tl.load(grid + 3), mask=there)
    tl.store(out + 1, dy / tl.load(grid + 4), mask=there)
    tl.store(out + 2, dz / tl.load(grid + 5), mask=there)
    if first == 0:
        tl.store(out + 3, (x + dx) / tl.load(grid + 6), mask=there)
        tl.store(out + 4, (y + dy) / tl.load(grid + 7), mask=there)
    out = out - first
    tl.store(out + 5, (z + dz) / tl.load(grid + 8), mask=there)
    tl.store(out + 6, tl.log(1.0 + points.to(tl.float32)), mask=there)
    for column in tl.static_range(extra):
        mean = (tl.load(at + 4 + column, mask=there, other=0.0) / points).to(tl.float32)
        tl.store(out + 7 + column, mean, mask=there)


def voxel_keys(points: Tensor, batch: Tensor, grid: Tensor, shape: tuple[int, int, int], layers: int) -> Tensor:
    """Key of each point's voxel, -1 outside the grid, shape (n,), int64.

    Args:
        points: x, y, z first, shape (n, columns), float32, contiguous.
        batch: Frame number of each, shape (n,), int64.
        grid: First edge and step along x, y, z, and scales of x, y, z, metres, shape (9,), float32.
        shape: Cells along z, x and y.
        layers: Lowest of those along z that points may lie in.
    """
    keys = torch.empty_like(batch)
    if len(points):
        _keys_kernel[(triton.cdiv(len(points), _BLOCK),)](
            points, batch, keys, grid, len(points), points.shape[1], shape[0], layers, *shape[1:], _BLOCK
        )
    return keys


def mean_features(
    points: Tensor,
    rows: Tensor,
    keys: Tensor,
    member: Tensor,
    grid: Tensor,
    shape: tuple[int, int, int],
    first: int,
) -> Tensor:
    """Features of each voxel as :func:`farfield.detectors.voxels.mean_voxels` describes them.

    Args:
        points: As of :func:`voxel_keys`; the columns after the position are features.
        rows: Those of points inside the grid, shape (m,), int64.
        keys: The voxels, shape (k,), int64.
        member: Number of each such point's voxel, shape (m,), int64.
        grid: As there.
        shape: As there.
        first: First of x, y, z whose mean is a feature.
    """
    extra = points.shape[1] - 3
    sums = points.new_zeros(len(keys), 4 + extra, dtype=torch.float64)
    features = points.new_empty(len(keys), 7 - first + extra)
    if len(rows):
        _sums_kernel[(triton.cdiv(len(rows), _BLOCK),)](
            points, rows, keys, member, sums, grid, len(rows), points.shape[1], *shape, extra, _BLOCK
        )
        _means_kernel[(triton.cdiv(len(keys), _BLOCK),)](
            sums, keys, features, grid, len(keys), *shape, first, extra, _BLOCK
        )
    return features
