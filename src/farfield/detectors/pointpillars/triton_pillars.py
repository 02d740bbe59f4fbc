"""Points to the image of pillars on a GPU in two kernels, written in Triton; for inference, where nothing is kept.

The plain version of :class:`farfield.detectors.pointpillars.network.PillarEncoder` groups points by sorting. Here sums
and maxima go straight to the cells of the image: no number of points or pillars is read by the host. Sums are of
float64, where those of float32 numbers near one another are exact: whatever their order, the image is the same.
"""

from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from farfield.detectors.devices import jit

triton: Any = import_module("triton")
tl: Any = import_module("triton.language")

_BLOCK = 64


@jit
def _cell_of(points, batch, grid, row, there, columns, nx, ny):  # type: ignore[no-untyped-def]
    """x, y, z, cell numbers as floats, key and whether inside, with true divisions as on a CPU."""
    at = points + row.to(tl.int64) * columns
    x = tl.load(at, mask=there, other=0.0)
    y = tl.load(at + 1, mask=there, other=0.0)
    z = tl.load(at + 2, mask=there, other=0.0)
    cell = tl.load(grid)
    ix = tl.floor(tl.div_rn(x, cell))
    iy = tl.floor(tl.div_rn(y - tl.load(grid + 1), cell))
    inside = there & (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny) & (z >= tl.load(grid + 2)) & (z < tl.load(grid + 3))
    ix, iy = tl.where(inside, ix, 0.0), tl.where(inside, iy, 0.0)
    frame = tl.load(batch + row, mask=there, other=0)
    return x, y, z, ix, iy, (frame * nx + ix.to(tl.int64)) * ny + iy.to(tl.int64), inside


@jit
def _sums_kernel(points, batch, grid, sums, count, columns, nx, ny, block: tl.constexpr):  # type: ignore[no-untyped-def]
    row = tl.program_id(0) * block + tl.arange(0, block)
    x, y, z, _, _, key, inside = _cell_of(points, batch, grid, row, row < count, columns, nx, ny)
    out = sums + key * 4
    tl.atomic_add(out, x.to(tl.float64), mask=inside)
    tl.atomic_add(out + 1, y.to(tl.float64), mask=inside)
    tl.atomic_add(out + 2, z.to(tl.float64), mask=inside)
    tl.atomic_add(out + 3, tl.where(inside, 1.0, 0.0).to(tl.float64), mask=inside)


@jit
def _put(features, column, index, values):  # type: ignore[no-untyped-def]
    return tl.where(column[None, :] == index, values[:, None], features)


@jit
def _image_kernel(  # type: ignore[no-untyped-def]
    points, batch, grid, sums, weight, bias, image, count, columns, nx, ny,
    first: tl.constexpr, extra: tl.constexpr, channels: tl.constexpr, wide: tl.constexpr, across: tl.constexpr,
    block: tl.constexpr,
):  # fmt: skip
    row = tl.program_id(0) * block + tl.arange(0, block)
    x, y, z, ix, iy, key, inside = _cell_of(points, batch, grid, row, row < count, columns, nx, ny)
    cell = tl.load(grid)
    points_there = tl.load(sums + key * 4 + 3, mask=inside, other=1.0)
    dx = x - (tl.load(sums + key * 4, mask=inside, other=0.0) / points_there).to(tl.float32)
    dy = y - (tl.load(sums + key * 4 + 1, mask=inside, other=0.0) / points_there).to(tl.float32)
    dz = z - (tl.load(sums + key * 4 + 2, mask=inside, other=0.0) / points_there).to(tl.float32)
    column = tl.arange(0, wide)
    features = tl.zeros((block, wide), dtype=tl.float32)
    if first == 0:
        features = _put(features, column, 0, x / tl.load(grid + 4))
        features = _put(features, column, 1, y / tl.load(grid + 5))
    features = _put(features, column, 2 - first, z / tl.load(grid + 6))
    features = _put(features, column, 3 - first, dx / cell)
    features = _put(features, column, 4 - first, dy / cell)
    features = _put(features, column, 5 - first, dz / cell)
    features = _put(features, column, 6 - first, (x - (ix + 0.5) * cell) / cell)
    features = _put(features, column, 7 - first, (y - ((iy + 0.5) * cell + tl.load(grid + 1))) / cell)
    features = _put(features, column, 8 - first, tl.log(1.0 + points_there.to(tl.float32)))
    at = points + row.to(tl.int64) * columns
    for number in tl.static_range(extra):
        features = _put(features, column, 9 - first + number, tl.load(at + 3 + number, mask=inside, other=0.0))
    channel = tl.arange(0, across)
    in_weight = (column < 9 - first + extra)[:, None] & (channel < channels)[None, :]
    matrix = tl.load(weight + channel[None, :] * (9 - first + extra) + column[:, None], mask=in_weight, other=0.0)
    product = tl.dot(features, matrix, input_precision="ieee")
    product += tl.load(bias + channel, mask=channel < channels, other=0.0)[None, :]
    out = image + key[:, None] * channels + channel[None, :]
    tl.atomic_max(out, tl.maximum(product, 0.0), mask=inside[:, None] & (channel < channels)[None, :] & (product > 0))


def image(
    points: Tensor,
    batch: Tensor,
    frames: int,
    weight: Tensor,
    bias: Tensor,
    grid: Tensor,
    *,
    nx: int,
    ny: int,
    first: int,
) -> Tensor:
    """The image of pillars, shape (frames, nx, ny, channels), float32, zero where no point fell.

    Args:
        points: x, y, z and further features, shape (n, columns), float32, contiguous.
        batch: Frame number of each, shape (n,), int64.
        frames: Number of frames.
        weight: Of the linear layer, shape (channels, features), float32.
        bias: Likewise, shape (channels,).
        grid: Edge of a cell, right edge of the grid, lowest and highest z, and scales of x, y, z, metres, shape (7,).
        nx: Cells along x.
        ny: Cells along y.
        first: First of x, y, z that describes a point.
    """
    channels, columns = len(weight), points.shape[1]
    sums = points.new_zeros(frames * nx * ny, 4, dtype=torch.float64)
    out = points.new_zeros(frames, nx, ny, channels)
    if len(points):
        programs = (triton.cdiv(len(points), _BLOCK),)
        _sums_kernel[programs](points, batch, grid, sums, len(points), columns, nx, ny, _BLOCK)
        wide, across = (max(16, triton.next_power_of_2(size)) for size in (weight.shape[1], channels))
        _image_kernel[programs](
            points, batch, grid, sums, weight.contiguous(), bias, out, len(points), columns, nx, ny,
            first, columns - 3, channels, wide, across, _BLOCK,
        )  # fmt: skip
    return out


def takes(weight: Tensor) -> bool:
    """Whether the kernels can hold a linear layer's weight, (channels, features), in a program."""
    return weight.shape[0] <= 128 and weight.shape[1] <= 64 and weight.dtype == torch.float32
