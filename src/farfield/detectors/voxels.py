"""Voxels: points to the occupied cells of a 3D grid, one mean feature row each (SECOND's mean VFE)."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from torch import Tensor

from farfield.detectors.devices import constant
from farfield.detectors.inputs import POSITION, Positions, features_of, stacked
from farfield.detectors.renaming import renamed
from farfield.detectors.sparse.tensor import SparseTensor, Triple, decode_keys
from farfield.detectors.triton_jit import kernels_for

_MAX_CELLS = 4_000_000_000
OLD_NAMES = {"grid.voxel_m": "grid.cell_m"}
"""Old names of settings in a detector with a voxel grid."""
MEAN_FEATURES = ("dx", "dy", "dz", "x", "y", "z", "log_count")
"""What :func:`mean_voxels` gives of each voxel, before the means of further columns."""


def mean_features(positions: Positions) -> tuple[str, ...]:
    """Names of what :func:`mean_voxels` gives of each voxel; relative positions lack x and y."""
    return tuple(name for name in MEAN_FEATURES if positions == "absolute" or name not in ("x", "y"))


class VoxelGridConfig(BaseModel):
    """Where a voxel detector looks, and how finely.

    Cell counts along x and y are rounded up to a multiple of the network's coarsest stride, so the grid may reach a
    little farther than range_m.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    range_m: float = Field(250.0, gt=0, description="forward reach, x from 0")
    half_width_m: float = Field(50.0, gt=0, description="lateral reach, y from -half_width_m to +half_width_m")
    z_min_m: float = Field(-6.0, description="points below are dropped; generous, since roads climb over 250 m")
    z_max_m: float = Field(6.0, description="points above are dropped")
    cell_m: tuple[float, float, float] = Field(
        (0.1, 0.1, 0.2), description="cell size along x, y and z; one number for a cube"
    )
    extra_layers: int = Field(0, ge=0, le=64, description="empty layers above, as SECOND's grid has one (41 for 40)")

    @model_validator(mode="before")
    @classmethod
    def _old_name(cls, settings: Any) -> Any:
        return renamed(settings, {"voxel_m": "cell_m"})

    @field_validator("cell_m", mode="before")
    @classmethod
    def _cube(cls, cell_m: Any) -> Any:
        return (cell_m,) * 3 if isinstance(cell_m, int | float) else cell_m

    @model_validator(mode="after")
    def _fits(self) -> "VoxelGridConfig":
        if not min(self.cell_m) > 0:
            raise ValueError(f"expected a voxel size above 0 along x, y and z, got {self.cell_m}")
        if not self.z_max_m > self.z_min_m:
            raise ValueError(f"expected z_max_m above z_min_m, got {self.z_max_m} and {self.z_min_m}")
        volume_m3 = self.range_m * 2 * self.half_width_m * (self.z_max_m - self.z_min_m)
        cells = volume_m3 / math.prod(self.cell_m)
        if not cells <= _MAX_CELLS:
            raise ValueError(f"expected at most {_MAX_CELLS:,} voxels, got {cells:,.0f}: take a larger cell_m")
        return self

    def shape(self, multiple: int) -> Triple:
        """Cells along z, x and y; ``multiple`` divides the last two."""
        dx, dy, dz = self.cell_m
        along = ((self.range_m, dx), (2 * self.half_width_m, dy))
        nx, ny = (math.ceil(round(length / step, 6) / multiple) * multiple for length, step in along)
        return math.ceil(round((self.z_max_m - self.z_min_m) / dz, 6)) + self.extra_layers, nx, ny

    def y_min_m(self, multiple: int) -> float:
        """The grid's right edge in metres: padding is shared between both sides."""
        return -self.shape(multiple)[2] * self.cell_m[1] / 2


def voxel_keys(points: Tensor, batch: Tensor, grid: VoxelGridConfig, multiple: int) -> tuple[Tensor, Tensor]:
    """Number the voxel of each point.

    Args:
        points: x, y, z (metres) first, shape (n, >= 3). Points outside the grid, or not finite, are dropped.
        batch: Frame number of each point, shape (n,), int64.
        grid: The voxel grid.
        multiple: The network's coarsest stride.

    Returns:
        Rows of the points inside the grid, shape (m,), int64, and the key of each one's voxel, shape (m,), int64, as
        :func:`~farfield.detectors.sparse.tensor.encode_keys` numbers them.
    """
    depth, nx, ny = shape = grid.shape(multiple)
    kernels = kernels_for(points.device, "triton_voxels")
    if kernels is not None and points.dtype == torch.float32:
        given = numbers(grid, multiple, points.device)
        key = kernels.voxel_keys(points.contiguous(), batch, given, shape, depth - grid.extra_layers)
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
    kept = []
    for cloud in clouds:
        rows, key = voxel_keys(cloud, torch.zeros(len(cloud), dtype=torch.long, device=cloud.device), grid, multiple)
        kept.append(cloud[rows[first_points(key, limit)]])
    return kept


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
        first, given = 0 if positions == "absolute" else 2, numbers(grid, multiple, points.device)
        features = kernels.mean_features(points.contiguous(), rows, keys, member, given, shape, first)
        return SparseTensor(features, keys, shape, len(clouds))
    keys, member, count = torch.unique(key, return_inverse=True, return_counts=True)
    points, count = points[rows], count[:, None].to(points.dtype)
    centre = voxel_centres_m(keys, grid, multiple).to(points.dtype)
    values = torch.cat([points[:, :3] - centre[member], points[:, features_of(columns)]], 1)
    mean = values.new_zeros(len(keys), values.shape[1]).index_add(0, member, values) / count
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
