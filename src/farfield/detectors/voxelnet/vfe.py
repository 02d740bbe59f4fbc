"""Voxel feature encoding (VoxelNet: Zhou and Tuzel, CVPR 2018, section 2.1.1), without padding.

The points of a whole batch are grouped by sorting the numbers of their voxels. The paper keeps at most 35 random points
of a voxel; here they are chosen by a hash of their coordinates, so that the same cloud gives the same features whatever
the order of its points.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from farfield.detectors.folding import fold_linear
from farfield.detectors.inputs import Positions, features_of, stacked
from farfield.detectors.sparse import SparseTensor
from farfield.detectors.voxels import VoxelGridConfig, voxel_keys

_POSITION = ("x", "y", "z")


class PointLayer(nn.Module):
    """Fully connected layer, batch normalisation over the points, ReLU.

    Args:
        c_in: Features a point.
        c_out: Features after it.
    """

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.linear = nn.Linear(c_in, c_out, bias=False)
        self.norm: nn.Module = nn.BatchNorm1d(c_out, eps=1e-3, momentum=0.1)

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, c_in) to (n, c_out). One point alone has no variance: it uses the running statistics."""
        norm, out = self.norm, self.linear(features)
        if isinstance(norm, nn.BatchNorm1d) and norm.training and len(out) < 2:
            scale = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
            return torch.relu((out - norm.running_mean) * scale + norm.bias)
        return torch.relu(norm(out))

    def fold_norm(self) -> None:
        """Fold the normalisation into the linear layer, for inference."""
        if isinstance(self.norm, nn.BatchNorm1d):
            self.linear, self.norm = fold_linear(self.linear, self.norm), nn.Identity()


class VoxelFeatureEncoder(nn.Module):
    """Points of a batch to one feature row each voxel that holds a point.

    A point is described by its position and its offset from the mean of its voxel's points, as in the paper (in units
    of the grid and of a voxel), and by its intensity. Each VFE layer doubles what :class:`PointLayer` gives by the
    maximum over the voxel; a last layer and a maximum make the voxel's features.

    Args:
        grid: The voxel grid.
        columns: Columns of the points; those after the position are features as they are.
        multiple: The network's coarsest stride, which must divide the grid.
        widths: Channels after each VFE layer, even numbers.
        channels: Features a voxel.
        max_points: Points of a voxel that count.
        positions: Relative ones leave x and y out of a point's description.
    """

    def __init__(
        self,
        grid: VoxelGridConfig,
        columns: Sequence[str],
        *,
        multiple: int,
        widths: Sequence[int] = (32, 128),
        channels: int = 128,
        max_points: int = 35,
        positions: Positions = "absolute",
    ) -> None:
        super().__init__()
        self.grid, self.multiple, self.max_points = grid, multiple, max_points
        self.extra = features_of(columns)
        self.first = 0 if positions == "absolute" else 2  # of x, y and z
        extra = [columns[index] for index in self.extra]
        self.features = (*_POSITION[self.first :], *extra, "dx of mean", "dy of mean", "dz of mean")
        c_in = len(self.features)
        self.layers = nn.ModuleList()
        for width in widths:
            self.layers.append(PointLayer(c_in, width // 2))
            c_in = width
        self.last = PointLayer(c_in, channels)

    def forward(self, clouds: Sequence[Tensor]) -> SparseTensor:
        """Encode the points of each frame, shape (n, columns), in float32."""
        points, batch = stacked(clouds)
        rows, key = voxel_keys(points, batch, self.grid, self.multiple)
        points, keys, member = grouped(points[rows], key, self.max_points)
        with torch.autocast(points.device.type, enabled=False):
            features = self._describe(points, member, len(keys))
            for layer in self.layers:
                features = layer(features)
                features = torch.cat([features, _maximum(features, member, len(keys))[member]], 1)
            pooled = _maximum(self.last(features), member, len(keys))
        return SparseTensor(pooled, keys, self.grid.shape(self.multiple), len(clouds))

    def _describe(self, points: Tensor, member: Tensor, voxel_count: int) -> Tensor:
        xyz = points[:, :3]
        sums = xyz.new_zeros(voxel_count, 3).index_add(0, member, xyz)
        to_mean = xyz - (sums / member.bincount(minlength=voxel_count)[:, None])[member]
        grid = self.grid
        scale = xyz.new_tensor([grid.range_m, grid.half_width_m, max(abs(grid.z_min_m), abs(grid.z_max_m))])
        return torch.cat(
            [(xyz / scale)[:, self.first :], points[:, self.extra], to_mean / xyz.new_tensor(grid.cell_m)], 1
        )


def grouped(points: Tensor, key: Tensor, limit: int) -> tuple[Tensor, Tensor, Tensor]:
    """Sort points by voxel and keep at most ``limit`` of each voxel.

    Args:
        points: x, y, z first, shape (n, >= 3), float32.
        key: Voxel of each point, shape (n,), int64.
        limit: Points of a voxel to keep; which ones depends on their coordinates alone.

    Returns:
        The kept points, voxel by voxel, shape (m, c); the voxels, shape (v,), ascending; the voxel's row of each kept
        point, shape (m,).
    """
    order = torch.argsort(_hash(points), stable=True)
    order = order[torch.argsort(key[order], stable=True)]
    keys, member, count = torch.unique_consecutive(key[order], return_inverse=True, return_counts=True)
    start = torch.cumsum(count, 0) - count
    kept = torch.arange(len(key), device=key.device) - start[member] < limit
    return points[order[kept]], keys, member[kept]


def _hash(points: Tensor) -> Tensor:
    """A number that looks random, from the bits of the coordinates, shape (n,), int64."""
    bits = points[:, :3].float().contiguous().view(torch.int32).long()
    mixed = (bits * bits.new_tensor([73856093, 19349663, 83492791])).sum(1)
    mixed = (mixed ^ (mixed >> 29)) * 0x1CE4E5B9BF58476D
    return mixed ^ (mixed >> 32)


def _maximum(features: Tensor, member: Tensor, voxel_count: int) -> Tensor:
    """Largest value of each voxel, shape (v, c). After ReLU zero is the least, so the maximum may start from it."""
    pooled = features.new_zeros(voxel_count, features.shape[1])
    return pooled.scatter_reduce(0, member[:, None].expand_as(features), features, "amax")
