"""A fully sparse centre-based detector: its cost follows the points, not the area.

In the line of VoxelNeXt (Chen et al., CVPR 2023, arXiv 2303.11301) and SAFDNet (Zhang et al., CVPR 2024, arXiv
2403.05817): points -> voxels -> sparse 3D encoder -> heights summed to a bird's-eye map of occupied cells -> sparse
pyramid with coarse stages -> diffusion to the empty centres -> heat and boxes at occupied cells -> local maxima ->
rotated NMS. Nothing is as large as the range. Differences from the papers, each for long range: strided layers add no
cells, so a single point is one path to the map; cells vote for the centre that should be occupied; heights of boxes are
relative to the points of their cell, since roads climb over 250 m; and any occupied cell can be assigned to a box.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise, product
from typing import Annotated, ClassVar, Literal, NamedTuple, cast

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from farfield.detectors.config import OLD_NAMES, Channels, VoxelGridConfig
from farfield.detectors.devices import constant
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.inputs import POSITION, CloudInput, Positions
from farfield.detectors.network import InputColumns, MapDetector
from farfield.detectors.sparse import (
    FLAT,
    InverseConv,
    SparseConv,
    SparseSequential,
    SparseTensor,
    SubmanifoldConv,
    dilate,
    neighbour_table,
    normalised,
)
from farfield.detectors.sparse.cells import Triple
from farfield.detectors.sparsecentre.head import CentreHead, CentreHeadConfig
from farfield.detectors.voxels import mean_features, mean_voxels

Depth = Annotated[int, Field(ge=0, le=64)]


class SparseCentreConfig(CentreHeadConfig):
    """Everything that decides the shape of the network and its boxes."""

    old_names = OLD_NAMES

    name: str = "sparsecentre"
    grid: VoxelGridConfig = VoxelGridConfig(cell_m=(0.2, 0.2, 0.25))
    use_intensity: bool = Field(False, description="read intensities too")
    use_lag: bool = Field(False, description="read the age of each point's sweep: for several sweeps a frame")
    positions: Positions = Field(
        "absolute", description="relative: without the place on the ground, as adaptation needs"
    )
    widths: tuple[Channels, ...] = Field((16, 32, 64), description="of the 3D stages; each but the first halves")
    depths: tuple[Depth, ...] = Field((1, 1, 2), description="further convolutions of each block")
    pyramid_widths: tuple[Channels, ...] = Field((96, 96, 128, 128), description="of the map's levels; each halves")
    pyramid_depth: Depth = Field(1, description="further sparse convolutions at each step back up")
    vote_threshold: float = Field(0.3, ge=0, le=1, description="cells with a foreground score above this vote")
    vote_least: int = Field(16, ge=0, description="so many best cells of a frame vote in any case")
    vote_ring: int = Field(1, ge=0, le=8, description="cells around a voted one that become occupied")
    vote_reach_m: float = Field(10.0, gt=0, description="longest vote along x and along y")
    head_depth: Depth = Field(1, description="residual blocks after the diffusion")

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the points that the network reads."""
        return (*POSITION, *["intensity"] * self.use_intensity, *["lag_s"] * self.use_lag)

    @property
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""
        return self.grid.range_m

    @property
    def map_stride(self) -> int:
        """Voxels along the edge of a cell of the map."""
        return int(2 ** (len(self.widths) - 1))

    @property
    def multiple(self) -> int:
        """The coarsest stride, in voxels."""
        return int(self.map_stride * 2 ** (len(self.pyramid_widths) - 1))

    @model_validator(mode="after")
    def _strides_fit(self) -> "SparseCentreConfig":
        if not 1 <= len(self.widths) == len(self.depths) <= 5 or not 1 <= len(self.pyramid_widths) <= 6:
            raise ValueError("expected 1 to 5 widths, as many depths, and 1 to 6 pyramid_widths")
        layers = self.grid.shape(self.multiple)[0]
        if layers % self.map_stride:
            raise ValueError(f"expected voxel layers that {self.map_stride} divides, got {layers}: set extra_layers")
        if self.grid.cell_m[0] != self.grid.cell_m[1]:
            raise ValueError(f"expected voxels as long as wide, got {self.grid.cell_m}")
        return self


class SparseCentre(MapDetector):
    """The network: its outputs are the centre head's, for occupied cells."""

    work: ClassVar[Literal["dense", "rows"]] = "rows"
    low_precision: ClassVar[tuple[str, ...]] = ("encoder", "to_map", "pyramid", "diffusion", "refine", "head")

    def __init__(self, config: SparseCentreConfig | None = None) -> None:
        config = config or SparseCentreConfig()
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=config.columns)}
        self.features = (*mean_features(config.positions), *config.columns[len(POSITION) :])
        width = config.pyramid_widths[0]
        self.encoder = VoxelEncoder(len(self.features), config.widths, config.depths)
        self.to_map = normalised(SubmanifoldConv(config.widths[-1], width, (1, 1, 1)))
        self.pyramid = SparsePyramid(config.pyramid_widths, config.pyramid_depth)
        cell_m = config.grid.cell_m[0] * config.map_stride
        self.diffusion = CentreDiffusion(
            width,
            threshold=config.vote_threshold,
            least=config.vote_least,
            ring=config.vote_ring,
            reach_cells=config.vote_reach_m / cell_m,
        )
        self.refine = nn.Sequential(*[ResidualBlock(width, FLAT) for _ in range(config.head_depth)])
        _, nx, ny = config.grid.shape(config.multiple)
        shape, y_min_m = (nx // config.map_stride, ny // config.map_stride), config.grid.y_min_m(config.multiple)
        self.head = CentreHead(config, width, shape=shape, cell_m=cell_m, y_min_m=y_min_m)
        self.assigner, self.channels = self.head.assigner, width

    def input_columns(self) -> InputColumns:
        """What the first convolution reads of a voxel."""
        return {"encoder.0.conv.weight": (1, self.features)}

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """Voxels, sparse encoder, pyramid, diffusion and refinement; ``aux`` holds votes and heights for the head."""
        config = self.config
        read = {"columns": config.columns, "positions": config.positions}
        # Voxels, and the sparse 3D encoder; heights are summed to a bird's-eye map of occupied cells.
        voxels = mean_voxels(batch["points"], config.grid, config.multiple, **read)
        bev = merge_heights(self.to_map(self.encoder(voxels.replace(in_type_of(self.encoder, voxels.features)))))
        bev = self.pyramid(bev)
        # Occupied cells of an object make the cell at its centre occupied.
        diffused = self.diffusion(bev, self._heights_m(voxels, bev.keys))
        refined = self.refine(diffused.sparse)
        return FeatureMap(
            values=refined,
            cell_m=self.head.cell_m,
            origin_m=(0.0, self.head.y_min_m),
            aux={"votes": bev.replace(diffused.votes), "height_m": refined.replace(diffused.height_m[:, None])},
        )

    def _heights_m(self, voxels: SparseTensor, keys: Tensor) -> Tensor:
        """Mean height of the points' voxels in each cell of the map, shape (n,)."""
        grid = self.config.grid
        height = voxels.features[:, mean_features(self.config.positions).index("z")]
        height_m = height * max(abs(grid.z_min_m), abs(grid.z_max_m))
        cell = torch.searchsorted(keys, flat_keys(voxels, self.config.map_stride))
        return means_at(height_m, cell, len(keys))[0]


# A sparse 3D encoder and a sparse bird's-eye pyramid: features at occupied cells only, at every stride.
#
# Strided layers have kernels as wide as their strides, so that no layer adds cells: each cell has one parent. The
# coarse stages give the reach (VoxelNeXt, section 3.1, "additional down-sampling"); their features come back to the
# fine cells.


class ResidualBlock(nn.Module):
    """Two submanifold convolutions beside the identity (He et al. 2016, figure 2).

    Args:
        channels: Channels in and out.
        kernel: Size along z, x and y.
    """

    def __init__(self, channels: int, kernel: Triple = (3, 3, 3)) -> None:
        super().__init__()
        self.first = normalised(SubmanifoldConv(channels, channels, kernel))
        self.second = normalised(SubmanifoldConv(channels, channels, kernel))

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
        layers: list[nn.Module] = [normalised(SubmanifoldConv(c_in, widths[0], (3, 3, 3)))]
        layers += [ResidualBlock(widths[0]) for _ in range(depths[0])]
        for before, width, depth in zip(widths, widths[1:], depths[1:], strict=False):
            layers.append(normalised(SparseConv(before, width, (2, 2, 2), (2, 2, 2), (0, 0, 0))))
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
    depth, nx, ny = sparse.shape
    column = sparse.keys.remainder(nx * ny)
    if stride > 1:
        line = torch.div(column, ny, rounding_mode="floor")
        places = [torch.div(at, stride, rounding_mode="floor") for at in (line, torch.sub(column, line, alpha=ny))]
        column = torch.add(places[1], places[0], alpha=ny // stride)
    if sparse.batch_size == 1:
        return column
    frame = torch.div(sparse.keys, depth * nx * ny, rounding_mode="floor")
    return torch.add(column, frame, alpha=(nx // stride) * (ny // stride))


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
            self.down.append(normalised(SparseConv(before, width, pair, pair, (0, 0, 0), book=book)))
            self.up.append(normalised(InverseConv(width, before, pair, book)))
            self.smooth.append(ResidualBlock(before, FLAT))

    def forward(self, sparse: SparseTensor) -> SparseTensor:
        """Map to map of the same cells."""
        levels = [cast(SparseTensor, self.levels[0](sparse))]
        for down, level in zip(self.down, self.levels[1:], strict=True):
            levels.append(level(down(levels[-1])))
        sparse = levels.pop()
        for up, smooth in zip(reversed(self.up), reversed(self.smooth), strict=True):
            fine = levels.pop()
            sparse = smooth(fine.replace(fine.features + up(sparse).features))
        return sparse


# Feature diffusion: occupied cells of an object make the cell at its centre occupied, with features of their own.
#
# A sparse map has no cell where no point fell, and the centre of an object seen from one side is often such a place.
# SAFDNet (arXiv 2403.05817, section 3.3) spreads the cells that it takes for foreground over a neighbourhood fixed by
# class. Here each foreground cell also predicts the step to its object's centre, as in FSD (arXiv 2207.10035, section
# 3.1), and a small neighbourhood of that place becomes occupied: a trailer of 15 m is reached without filling a disc.


class DiffusedMap(NamedTuple):
    """A map after diffusion.

    Attributes:
        sparse: The map with its new cells.
        height_m: Reference height of each cell, shape (n,).
        votes: Foreground logit and step to the centre (x, y, in cells) of each cell before, shape (m, 3), float32.
    """

    sparse: SparseTensor
    height_m: Tensor
    votes: Tensor


class CentreDiffusion(nn.Module):
    """Spread foreground cells to the centres that they predict.

    Args:
        channels: Channels of the map.
        threshold: Cells with a foreground score above this vote.
        least: So many best cells of each frame vote in any case: the branch learns from its first step.
        ring: Cells around a voted one that become occupied as well.
        reach_cells: Longest step along x and along y.
    """

    def __init__(self, channels: int, *, threshold: float, least: int, ring: int, reach_cells: float) -> None:
        super().__init__()
        self.threshold, self.least, self.reach_cells = threshold, least, reach_cells
        side = range(-ring, ring + 1)
        self.ring = [(0, dx, dy) for dx, dy in product(side, side) if (dx, dy) != (0, 0)]
        self.vote = nn.Linear(channels, 3)
        self.carry = nn.Linear(channels + 2, channels)
        with torch.no_grad():
            self.vote.weight.normal_(std=0.01)
            self.vote.bias.copy_(torch.tensor([-2.2, 0.0, 0.0]))

    def forward(self, sparse: SparseTensor, height_m: Tensor) -> DiffusedMap:
        """Grow the map.

        Args:
            sparse: A map of depth 1.
            height_m: Reference height of each cell, shape (m,).
        """
        votes = self.vote(sparse.features).float()
        score, steps = torch.sigmoid(votes[:, 0]), votes[:, 1:].clamp(-self.reach_cells, self.reach_cells)
        rows, voted, rest = self._landing(sparse, score.detach(), steps)
        keys = dilate(voted, sparse.shape, self.ring, others=sparse.keys, frames=sparse.batch_size)
        carried = self.carry(torch.cat([sparse.features[rows], rest.to(sparse.features.dtype)], 1))
        carried = carried * score[rows, None].to(carried.dtype)
        landed, stayed = torch.searchsorted(keys, voted), torch.searchsorted(keys, sparse.keys)
        joined = torch.cat([carried.double(), height_m[rows, None].double()], 1)
        means, has_height = means_at(joined, landed, len(keys))
        features, height = means[:, :-1].to(carried.dtype), means[:, -1].detach().to(height_m.dtype)
        features = features.index_add(0, stayed, sparse.features.to(features.dtype))
        has_height = has_height.index_fill(0, stayed, True)
        height = _spread(height.index_copy(0, stayed, height_m), has_height, keys, sparse.shape, self.ring)
        grown = SparseTensor(features, keys, sparse.shape, sparse.batch_size, sparse.rulebooks)
        return DiffusedMap(grown, height, votes)

    def _landing(self, sparse: SparseTensor, score: Tensor, steps: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Rows of the voting cells, keys of the cells they vote for, and their places in those cells, (v, 2)."""
        _, nx, ny = sparse.shape
        indices, chosen, edges = sparse.indices(), score > self.threshold, [0, len(score)]
        if sparse.batch_size > 1:
            frames = torch.arange(sparse.batch_size + 1, device=score.device) * (nx * ny)
            edges = torch.searchsorted(sparse.keys, frames).tolist()
        for start, end in pairwise(edges):
            best = torch.topk(score[start:end], min(self.least, end - start)).indices
            chosen[start:end].index_fill_(0, best, True)
        target = indices[:, 2:] + 0.5 + steps
        cell = torch.floor(target.detach()).long()
        inside = (cell >= 0) & (cell < constant((float(nx), float(ny)), cell.device, torch.long))
        rows = (inside.all(1) & chosen).nonzero().squeeze(1)
        target, cell = target[rows], cell[rows]
        keys = (indices[rows, 0] * nx + cell[:, 0]) * ny + cell[:, 1]
        return rows, keys, target - cell - 0.5


def means_at(values: Tensor, group: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Mean of the rows that fall to each place, zero where none does.

    Sums are of float64, where those of float32 numbers near one another are exact, so that the order of a GPU's
    additions does not matter.

    Args:
        values: Rows, shape (n, ...).
        group: Number of each row's place, shape (n,), int64.
        count: Number of places.

    Returns:
        The means, shape (count, ...), of the values' dtype, and whether rows fall there, shape (count,).
    """
    total = values.new_zeros(count, *values.shape[1:], dtype=torch.float64).index_add(0, group, values.double())
    rows = total.new_zeros(count).index_add_(0, group, total.new_ones(len(group)))
    divisor = rows.clamp(min=1).reshape(-1, *[1] * (values.dim() - 1))
    return (total / divisor).to(values.dtype), rows > 0


def _spread(
    height_m: Tensor, has_height: Tensor, keys: Tensor, shape: tuple[int, int, int], ring: list[tuple[int, int, int]]
) -> Tensor:
    """Give cells without a height the mean of their neighbours'."""
    empty = (~has_height).nonzero().squeeze(1)
    table = neighbour_table(keys, keys[empty], shape, ring)
    weight = torch.cat([has_height, has_height.new_zeros(1)]).to(height_m.dtype)[table]
    around = torch.cat([height_m, height_m.new_zeros(1)])[table]
    return height_m.index_copy(0, empty, (around * weight).sum(1) / weight.sum(1).clamp(min=1))
