"""Voxels: points to the occupied cells of a 3D grid, one mean feature row each (SECOND's mean VFE)."""

from collections.abc import Sequence

import torch
from torch import Tensor

from farfield.detectors.config import VoxelGridConfig
from farfield.detectors.devices import constant, kernels_for
from farfield.detectors.inputs import POSITION, Positions, features_of, stacked
from farfield.detectors.sparse.cells import SparseTensor, decode_keys

MEAN_FEATURES = ("dx", "dy", "dz", "x", "y", "z", "log_count")
"""What :func:`mean_voxels` gives of each voxel, before the means of further columns."""


def mean_features(positions: Positions) -> tuple[str, ...]:
    """Names of what :func:`mean_voxels` gives of each voxel; relative positions lack x and y."""
    return tuple(name for name in MEAN_FEATURES if positions == "absolute" or name not in ("x", "y"))


def voxel_keys(points: Tensor, batch: Tensor, grid: VoxelGridConfig, multiple: int) -> tuple[Tensor, Tensor]:
    """Number the voxel of each point.

    Args:
        points: x, y, z (metres) first, shape (n, >= 3). Points outside the grid, or not finite, are dropped.
        batch: Frame number of each point, shape (n,), int64.
        grid: The voxel grid.
        multiple: The network's coarsest stride.

    Returns:
        Rows of the points inside the grid, shape (m,), int64, and the key of each one's voxel, shape (m,), int64, as
        :func:`~farfield.detectors.sparse.cells.encode_keys` numbers them.
    """
    depth, nx, ny = shape = grid.shape(multiple)
    kernels = kernels_for(points.device, "triton_voxels")
    if kernels is not None and points.dtype == torch.float32:
        constants = numbers(grid, multiple, points.device)
        key = kernels.voxel_keys(points.contiguous(), batch, constants, shape, depth - grid.extra_layers)
        rows = (key >= 0).nonzero().squeeze(1)
        return rows, key[rows]
    dx, dy, dz = grid.cell_m
    ix = torch.floor(points[:, 0] / dx)
    iy = torch.floor((points[:, 1] - grid.y_min_m(multiple)) / dy)
    iz = torch.floor((points[:, 2] - grid.z_min_m) / dz)
    keep = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny) & (iz >= 0) & (iz < depth - grid.extra_layers)
    rows = keep.nonzero().squeeze(1)
    key = ((batch[rows] * depth + iz[rows].long()) * nx + ix[rows].long()) * ny + iy[rows].long()
    return rows, key


def first_points(member: Tensor, limit: int) -> Tensor:
    """Which points are among the first of their cell, in the order given.

    Args:
        member: Cell of each point, shape (n,), int64.
        limit: Points of a cell that count; 0 for all.

    Returns:
        Mask of shape (n,).
    """
    if limit == 0:
        return torch.ones_like(member, dtype=torch.bool)
    order = torch.argsort(member, stable=True)
    _, cell, count = torch.unique_consecutive(member[order], return_inverse=True, return_counts=True)
    rank = torch.arange(len(member), device=member.device) - (torch.cumsum(count, 0) - count)[cell]
    return torch.zeros_like(member, dtype=torch.bool).index_put_((order,), rank < limit)


def first_points_of_voxels(
    clouds: Sequence[Tensor], grid: VoxelGridConfig, multiple: int, limit: int
) -> Sequence[Tensor]:
    """The clouds, shape (n, columns), each with the first ``limit`` points of every voxel alone; 0 for all points."""
    if limit == 0:
        return clouds
    counted = []
    for cloud in clouds:
        rows, key = voxel_keys(cloud, torch.zeros(len(cloud), dtype=torch.long, device=cloud.device), grid, multiple)
        counted.append(cloud[rows[first_points(key, limit)]])
    return counted


def mean_voxels(
    clouds: Sequence[Tensor],
    grid: VoxelGridConfig,
    multiple: int,
    *,
    columns: Sequence[str] = POSITION,
    published: bool = False,
    positions: Positions = "absolute",
) -> SparseTensor:
    """Mean features of each voxel that holds a point.

    The features are: mean offset from the voxel's centre in voxel sizes (3), mean position scaled to the grid (3),
    logarithm of one plus the number of points (1), as ``MEAN_FEATURES`` names them, and the means of the columns after
    the position, such as intensity and lag.

    Args:
        clouds: Points of each frame, shape (n, columns).
        grid: The voxel grid.
        multiple: The network's coarsest stride.
        columns: Columns of the points.
        published: Mean x, y, z (metres) and intensity only, as SECOND's mean VFE: what imported weights expect.
        positions: Relative ones lack the mean x and y.
    """
    points, batch = stacked(clouds)
    rows, key = voxel_keys(points, batch, grid, multiple)
    shape = grid.shape(multiple)
    kernels = kernels_for(points.device, "triton_voxels")
    if kernels is not None and not published and points.dtype == torch.float32 and not points.requires_grad:
        keys, member = torch.unique(key, return_inverse=True)
        first, constants = 0 if positions == "absolute" else 2, numbers(grid, multiple, points.device)
        features = kernels.mean_features(points.contiguous(), rows, keys, member, constants, shape, first)
        return SparseTensor(features, keys, shape, len(clouds))
    keys, member, count = torch.unique(key, return_inverse=True, return_counts=True)
    points, count = points[rows], count[:, None].to(points.dtype)
    centre = voxel_centres_m(keys, grid, multiple).to(points.dtype)
    values = torch.cat([points[:, :3] - centre[member], points[:, features_of(columns)]], 1)
    # Sums of float32 numbers near one another are exact in float64: then the order of the points does not matter.
    exact = values.double()
    mean = (exact.new_zeros(len(keys), values.shape[1]).index_add(0, member, exact) / count).to(values.dtype)
    offset, rest = mean[:, :3], mean[:, 3:]
    position = centre + offset
    if published:
        strength = [columns[index] for index in features_of(columns)].index("intensity")
        features = torch.cat([position, rest[:, [strength]]], 1)
    else:
        scale = position.new_tensor([grid.range_m, grid.half_width_m, max(abs(grid.z_min_m), abs(grid.z_max_m))])
        scaled = (position / scale)[:, 0 if positions == "absolute" else 2 :]
        parts = [offset / position.new_tensor(grid.cell_m), scaled, torch.log1p(count)]
        features = torch.cat([*parts, rest], 1)
    return SparseTensor(features, keys, shape, len(clouds))


def numbers(grid: VoxelGridConfig, multiple: int, device: torch.device) -> Tensor:
    """First edge and step along x, y, z, and scales of x, y, z, as the kernels take them, shape (9,), float32."""
    first = (0.0, grid.y_min_m(multiple), grid.z_min_m)
    scale = (grid.range_m, grid.half_width_m, max(abs(grid.z_min_m), abs(grid.z_max_m)))
    return constant((*first, *grid.cell_m, *scale), device, torch.float32)


def voxel_centres_m(keys: Tensor, grid: VoxelGridConfig, multiple: int) -> Tensor:
    """Centres x, y, z of voxels in metres, shape (n, 3), float32."""
    _, iz, ix, iy = decode_keys(keys, grid.shape(multiple)).unbind(1)
    dx, dy, dz = grid.cell_m
    return torch.stack([(ix + 0.5) * dx, (iy + 0.5) * dy + grid.y_min_m(multiple), (iz + 0.5) * dz + grid.z_min_m], 1)
