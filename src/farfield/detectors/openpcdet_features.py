"""Features and constants of PointPillars and SECOND as OpenPCDet computes them: what its checkpoints expect.

Coordinates go in as they are, in metres, and only the first points of a pillar or voxel count, in the cloud's order.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from farfield.detectors.folding import fold_linear
from farfield.detectors.grid import GridConfig
from farfield.detectors.norm import normalise_rows
from farfield.detectors.voxels import first_points

_OFFSETS = tuple(f"d{axis}_m of {where}" for where in ("mean", "centre") for axis in "xyz")
_DESCRIBED = ("x_m", "y_m", "z_m", "intensity", *_OFFSETS)
_MOMENTUM = 0.01  # of batch normalisation, as OpenPCDet trains


def use_openpcdet_momentum(network: nn.Module) -> None:
    """Let running statistics move as slowly as OpenPCDet's: of use for further training only."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            module.momentum = _MOMENTUM


class OpenPCDetPillarEncoder(nn.Module):
    """Points of a batch to a dense image of pillar features, from the ten published features of a point.

    They are x, y, z and intensity, the offset from the mean of the pillar's points, and the offset from the pillar's
    centre. A pillar with fewer points than ``max_points`` is padded by rows of zeros there, and what the layer makes of
    such a row takes part in the maximum: so it does here. In training, the padding does not enter the statistics.

    Args:
        grid: The bird's-eye grid.
        columns: Columns of the points, intensity among them.
        multiple: The network's coarsest stride, which must divide the grid.
        channels: Features a pillar.
        max_points: First points of a pillar that count, in the cloud's order; 0 for all, without padding.
    """

    def __init__(
        self, grid: GridConfig, columns: Sequence[str], *, multiple: int, channels: int, max_points: int
    ) -> None:
        super().__init__()
        self.grid, self.channels, self.max_points = grid, channels, max_points
        self.intensity = columns.index("intensity")
        self.features = _DESCRIBED
        self.nx, self.ny = grid.shape(multiple)
        self.y_min_m = grid.y_min_m(multiple)
        self.linear = nn.Linear(10, channels, bias=False)
        self.norm: nn.Module = nn.BatchNorm1d(channels, eps=1e-3, momentum=_MOMENTUM)

    def forward(self, points: Tensor, batch: Tensor, batch_size: int) -> Tensor:
        """Encode points.

        Args:
            points: Those of all frames of the batch, shape (n, columns).
            batch: Frame number of each point, shape (n,), int64.
            batch_size: Number of frames.

        Returns:
            Pillar features, shape (batch_size, channels, nx, ny), in channels_last memory, zero where no point fell.
        """
        grid = self.grid
        ix, iy = torch.floor(points[:, 0] / grid.cell_m), torch.floor((points[:, 1] - self.y_min_m) / grid.cell_m)
        keep = (ix >= 0) & (ix < self.nx) & (iy >= 0) & (iy < self.ny)
        keep &= (points[:, 2] >= grid.z_min_m) & (points[:, 2] < grid.z_max_m)
        key = ((batch * self.nx + ix.long()) * self.ny + iy.long())[keep]
        first = first_points(key, self.max_points)
        points, key = points[keep][first], key[first]
        pillars, member, count = torch.unique(key, return_inverse=True, return_counts=True)
        features = self._layer(self._describe(points, key, member, count))
        pooled = features.new_zeros(len(pillars), self.channels)
        pooled = pooled.scatter_reduce(0, member[:, None].expand_as(features), features, "amax")
        if self.max_points:
            padding = self._layer(points.new_zeros(1, 10)).to(pooled.dtype)
            pooled = torch.where((count < self.max_points)[:, None], torch.maximum(pooled, padding), pooled)
        canvas = pooled.new_zeros(batch_size * self.nx * self.ny, self.channels).index_copy(0, pillars, pooled)
        return canvas.view(batch_size, self.nx, self.ny, self.channels).permute(0, 3, 1, 2)

    def fold_norm(self) -> None:
        """Fold the normalisation into the linear layer, for inference."""
        if isinstance(self.norm, nn.BatchNorm1d):
            self.linear, self.norm = fold_linear(self.linear, self.norm), nn.Identity()

    def _layer(self, features: Tensor) -> Tensor:
        return torch.relu(normalise_rows(self.norm, self.linear(features)))

    def _describe(self, points: Tensor, key: Tensor, member: Tensor, count: Tensor) -> Tensor:
        xyz, grid = points[:, :3], self.grid
        mean = xyz.new_zeros(len(count), 3).index_add(0, member, xyz) / count[:, None]
        iy, ix = key % self.ny, torch.div(key, self.ny, rounding_mode="floor") % self.nx
        height = xyz.new_full((len(key),), (grid.z_min_m + grid.z_max_m) / 2)
        across = (iy + 0.5) * grid.cell_m + self.y_min_m
        centre = torch.stack([(ix + 0.5) * grid.cell_m, across, height], 1)
        return torch.cat([xyz, points[:, [self.intensity]], xyz - mean[member], xyz - centre], 1)
