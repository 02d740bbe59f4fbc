"""A sparse 3D encoder and a sparse bird's-eye pyramid: features at occupied cells only, at every stride.

Strided layers have kernels as wide as their strides, so that no layer adds cells: each cell has one parent. The coarse
stages give the reach (VoxelNeXt, section 3.1, "additional down-sampling"); their features come back to the fine cells.
"""

from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn

from farfield.detectors.sparse import (
    InverseConv,
    SparseBlock,
    SparseConv,
    SparseSequential,
    SparseTensor,
    SubmanifoldConv,
)

Triple = tuple[int, int, int]
FLAT: Triple = (1, 3, 3)


def normalised(conv: nn.Module, channels: int, relu: bool = True) -> SparseBlock:
    """A sparse convolution with its batch normalisation."""
    return SparseBlock(conv, nn.BatchNorm1d(channels, eps=1e-3), relu=relu)


class ResidualBlock(nn.Module):
    """Two submanifold convolutions beside the identity (He et al. 2016, figure 2).

    Args:
        channels: Channels in and out.
        kernel: Size along z, x and y.
    """

    def __init__(self, channels: int, kernel: Triple = (3, 3, 3)) -> None:
        super().__init__()
        self.first = normalised(SubmanifoldConv(channels, channels, kernel), channels)
        self.second = normalised(SubmanifoldConv(channels, channels, kernel), channels)

    def plan(self, sparse: SparseTensor) -> SparseTensor:
        """Find the rulebook that both convolutions share."""
        return self.first.plan(sparse)

    def forward(self, sparse: SparseTensor) -> SparseTensor:
        """Apply the block; the cells stay."""
        return cast(SparseTensor, self.second(self.first(sparse), sparse.features))


class VoxelEncoder(SparseSequential):
    """Voxels to coarser voxels: a submanifold layer, then stages of residual blocks; each further stage halves.

    Args:
        c_in: Channels of the voxels.
        widths: Channels of each stage; the first works on the voxels themselves.
        depths: Residual blocks of each stage.
    """

    def __init__(self, c_in: int, widths: Sequence[int], depths: Sequence[int]) -> None:
        layers: list[nn.Module] = [normalised(SubmanifoldConv(c_in, widths[0], (3, 3, 3)), widths[0])]
        layers += [ResidualBlock(widths[0]) for _ in range(depths[0])]
        for before, width, depth in zip(widths, widths[1:], depths[1:], strict=False):
            layers.append(normalised(SparseConv(before, width, (2, 2, 2), (2, 2, 2), (0, 0, 0)), width))
            layers += [ResidualBlock(width) for _ in range(depth)]
        super().__init__(*layers)


def merge_heights(sparse: SparseTensor) -> SparseTensor:
    """Sum the features of the cells above one another: a map of depth 1 (VoxelNeXt, section 3.1)."""
    keys, member = torch.unique(flat_keys(sparse), return_inverse=True)
    # A GPU adds in an order of its own; rounded from double precision the sums come out the same in practice.
    sums = sparse.features.new_zeros(len(keys), sparse.features.shape[1], dtype=torch.float64)
    features = sums.index_add(0, member, sparse.features.double()).to(sparse.features.dtype)
    return SparseTensor(features, keys, (1, *sparse.shape[1:]), sparse.batch_size, sparse.rulebooks)


def flat_keys(sparse: SparseTensor, stride: int = 1) -> Tensor:
    """Key of each cell's column in the map of depth 1 whose cells are ``stride`` times as long, shape (n,), int64."""
    frame, _, ix, iy = sparse.indices().unbind(1)
    _, nx, ny = sparse.shape
    columns = [torch.div(index, stride, rounding_mode="floor") for index in (ix, iy)]
    return (frame * (nx // stride) + columns[0]) * (ny // stride) + columns[1]


class SparsePyramid(nn.Module):
    """A bird's-eye encoder and decoder on occupied cells (HEDNet, section 3.2, on maps of depth 1).

    Every level halves the resolution; on the way back a level's features are added to those of the finer one.

    Args:
        widths: Channels of each level, the finest first.
        depth: Residual blocks a level on the way down; one on the way up.
    """

    def __init__(self, widths: Sequence[int], depth: int) -> None:
        super().__init__()
        self.levels, self.down, self.up, self.smooth = (nn.ModuleList() for _ in range(4))
        for level, width in enumerate(widths):
            self.levels.append(nn.Sequential(*[ResidualBlock(width, FLAT) for _ in range(depth)]))
            if level == 0:
                continue
            before, book, pair = widths[level - 1], f"pyramid {level}", (1, 2, 2)
            self.down.append(normalised(SparseConv(before, width, pair, pair, (0, 0, 0), book=book), width))
            self.up.append(normalised(InverseConv(width, before, pair, book), before))
            self.smooth.append(ResidualBlock(before, FLAT))

    def forward(self, sparse: SparseTensor) -> SparseTensor:
        """Map to map of the same cells."""
        kept = [cast(SparseTensor, self.levels[0](sparse))]
        for down, level in zip(self.down, self.levels[1:], strict=True):
            kept.append(level(down(kept[-1])))
        sparse = kept.pop()
        for up, smooth in zip(reversed(self.up), reversed(self.smooth), strict=True):
            fine = kept.pop()
            sparse = smooth(fine.replace(fine.features + up(sparse).features))
        return sparse
