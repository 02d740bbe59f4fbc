"""Pillars (PointPillars, section 2.1): points to a bird's-eye image, without Python loops and without a point limit.

Dynamic voxelisation: every point counts, none is dropped or padded. Points of a whole batch are grouped at once by
sorting their cell numbers.
"""

from collections.abc import Sequence
from types import ModuleType

import torch
from torch import Tensor, nn

from farfield.detectors.devices import constant
from farfield.detectors.folding import fold_linear
from farfield.detectors.grid import GridConfig
from farfield.detectors.inputs import Positions, features_of
from farfield.detectors.norm import normalise_rows
from farfield.detectors.triton_jit import kernels_for

_DESCRIBED = ("x", "y", "z", "dx of mean", "dy of mean", "dz of mean", "dx of centre", "dy of centre", "log_count")


class PillarEncoder(nn.Module):
    """Points of a batch to a dense image of pillar features.

    Args:
        grid: The bird's-eye grid.
        columns: Columns of the points; those after the position are features as they are.
        multiple: The network's coarsest stride, which must divide the grid.
        channels: Features a pillar.
        positions: Relative ones leave x and y out of a point's description.
    """

    def __init__(
        self,
        grid: GridConfig,
        columns: Sequence[str],
        *,
        multiple: int,
        channels: int,
        positions: Positions = "absolute",
    ) -> None:
        super().__init__()
        self.first = 0 if positions == "absolute" else 2  # of x, y and z
        self.grid, self.channels = grid, channels
        self.extra = features_of(columns)
        self.features = (*_DESCRIBED[self.first :], *[columns[index] for index in self.extra])
        self.nx, self.ny = grid.shape(multiple)
        self.y_min_m = grid.y_min_m(multiple)
        self.linear = nn.Linear(9 - self.first + len(self.extra), channels, bias=False)
        self.norm: nn.Module = nn.BatchNorm1d(channels, eps=1e-3, momentum=0.1)

    def forward(self, points: Tensor, batch: Tensor, batch_size: int) -> Tensor:
        """Encode points.

        Args:
            points: Those of all frames of the batch, shape (n, columns).
            batch: Frame number of each point, shape (n,), int64.
            batch_size: Number of frames.

        Returns:
            Pillar features, shape (batch_size, channels, nx, ny), in channels_last memory, zero where no point fell.
        """
        kernels = kernels_for(points.device, "pointpillars.triton_pillars")
        folded = isinstance(self.norm, nn.Identity) and self.linear.bias is not None
        if kernels is not None and folded and not torch.is_grad_enabled() and kernels.takes(self.linear.weight):
            return self._image(kernels, points, batch, batch_size)
        points, key = self._inside(points, batch)
        pillars, member = torch.unique(key, return_inverse=True)
        features = self._decorate(points, key, member, len(pillars))
        features = torch.relu(normalise_rows(self.norm, self.linear(features)))
        # ReLU makes zero the least feature, so a maximum that starts from zero is the plain maximum.
        pooled = features.new_zeros(len(pillars), self.channels)
        pooled = pooled.scatter_reduce(0, member[:, None].expand(-1, self.channels), features, "amax")
        canvas = pooled.new_zeros(batch_size * self.nx * self.ny, self.channels).index_copy(0, pillars, pooled)
        return canvas.view(batch_size, self.nx, self.ny, self.channels).permute(0, 3, 1, 2)

    @property
    def numbers(self) -> tuple[float, ...]:
        """Edge of a cell, right edge of the grid, lowest and highest z, and scales of x, y and z, metres."""
        grid = self.grid
        scales = (grid.range_m, grid.half_width_m, grid.z_max_m)
        return grid.cell_m, self.y_min_m, grid.z_min_m, grid.z_max_m, *scales

    def _image(self, kernels: ModuleType, points: Tensor, batch: Tensor, batch_size: int) -> Tensor:
        """The same by kernels, without a gradient."""
        image: Tensor = kernels.image(
            points.contiguous(),
            batch,
            batch_size,
            self.linear.weight,
            self.linear.bias,
            constant(self.numbers, points.device, torch.float32),
            nx=self.nx,
            ny=self.ny,
            first=self.first,
        )
        return image.permute(0, 3, 1, 2)

    def fold_norm(self) -> None:
        """Fold the normalisation into the linear layer, for inference."""
        if isinstance(self.norm, nn.BatchNorm1d):
            self.linear, self.norm = fold_linear(self.linear, self.norm), nn.Identity()

    def _inside(self, points: Tensor, batch: Tensor) -> tuple[Tensor, Tensor]:
        """Drop points outside the grid; number the cell of each remaining point."""
        ix = torch.floor(points[:, 0] / self.grid.cell_m)
        iy = torch.floor((points[:, 1] - self.y_min_m) / self.grid.cell_m)
        keep = (ix >= 0) & (ix < self.nx) & (iy >= 0) & (iy < self.ny)
        keep &= (points[:, 2] >= self.grid.z_min_m) & (points[:, 2] < self.grid.z_max_m)
        key = (batch * self.nx + ix.long()) * self.ny + iy.long()
        return points[keep], key[keep]

    def _decorate(self, points: Tensor, key: Tensor, member: Tensor, pillar_count: int) -> Tensor:
        """Describe each point: position, offset to its pillar's mean and to its centre, number of points there.

        The first three are those of the paper, scaled to the grid; the fourth (logarithm) stands in for intensity.
        """
        xyz = points[:, :3]
        ones = xyz.new_ones(len(xyz), 1)
        sums = xyz.new_zeros(pillar_count, 4).index_add(0, member, torch.cat([xyz, ones], 1))
        count = sums[:, 3:]
        to_mean = xyz - (sums[:, :3] / count)[member]
        iy, ix = key % self.ny, torch.div(key, self.ny, rounding_mode="floor") % self.nx
        centre = torch.stack([(ix + 0.5) * self.grid.cell_m, (iy + 0.5) * self.grid.cell_m + self.y_min_m], 1)
        to_centre = (xyz[:, :2] - centre) / self.grid.cell_m
        scaled = xyz / xyz.new_tensor([self.grid.range_m, self.grid.half_width_m, self.grid.z_max_m])
        parts = [scaled[:, self.first :], to_mean / self.grid.cell_m, to_centre, torch.log1p(count)[member]]
        return torch.cat([*parts, points[:, self.extra]], 1)
