"""VoxelNet (Zhou and Tuzel, CVPR 2018, arXiv 1711.06396) at long range (Cirrus, section V.A).

Points -> voxels of 0.2 x 0.2 x 0.4 m with learned features -> 3D convolutions -> region proposal network -> boxes.
Differences from the paper: the 3D convolutions compute only what a point reaches (the same function, see
``middle.py``); 1250 x 500 cells are padded to 1256 x 504, since the three strides must divide them; losses and
assignment are those of the house's anchor head (focal loss, direction bins, assignment by distance).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
from farfield.detectors.config import OLD_NAMES, Channels, VoxelGridConfig, check_blocks
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.inputs import POSITION, CloudInput, Positions, features_of, stacked
from farfield.detectors.layers import BevBackbone, fold_linear
from farfield.detectors.network import InputColumns, MapDetector
from farfield.detectors.sparse import SparseTensor
from farfield.detectors.voxelnet.middle import MiddleLayers, middle_depths
from farfield.detectors.voxels import voxel_keys

_CIRRUS_GRID = VoxelGridConfig(range_m=250.0, half_width_m=50.0, z_min_m=-3.0, z_max_m=1.0, cell_m=(0.2, 0.2, 0.4))


class VoxelNetConfig(AnchorHeadConfig):
    """Everything that decides the shape of the network and its boxes; widths and grid are the published ones."""

    old_names = OLD_NAMES

    name: str = "voxelnet"
    grid: VoxelGridConfig = _CIRRUS_GRID
    max_points: int = Field(35, ge=1, le=10_000, description="points of a voxel that count")
    use_intensity: bool = Field(True, description="read the return strength; its scale differs between sensors")
    use_lag: bool = Field(False, description="read the age of each point's sweep: for several sweeps a frame")
    positions: Positions = Field(
        "absolute", description="relative: without the place on the ground, as adaptation needs"
    )
    vfe_widths: tuple[Annotated[Channels, Field(multiple_of=2)], ...] = Field(
        (32, 128), description="channels of the layers that encode a voxel's points"
    )
    voxel_channels: Channels = Field(128, description="numbers that describe a voxel")
    middle: Literal["sparse", "dense"] = Field("sparse", description="one function and one set of weights, two ways")
    middle_widths: tuple[Channels, Channels, Channels] = Field(
        (64, 64, 64), description="channels of the convolutions in space"
    )
    widths: tuple[Channels, ...] = Field((128, 128, 256), description="channels of each block")
    depths: tuple[Annotated[int, Field(ge=0, le=64)], ...] = Field(
        (3, 5, 5), description="further convolutions of each block"
    )
    strides: tuple[Annotated[int, Field(ge=1, le=16)], ...] = Field((2, 2, 2), description="stride of each block")
    out_stride: int = Field(2, ge=1, description="stride of the anchors' grid, in voxels")
    neck_width: Channels = Field(256, description="channels of each block's output where they are joined")

    @model_validator(mode="after")
    def _fits(self) -> "VoxelNetConfig":
        check_blocks(self.widths, self.depths, self.strides, self.out_stride)
        dx, dy, _ = self.grid.cell_m
        if dx != dy:
            raise ValueError(f"expected voxels as long as wide, got {dx} m x {dy} m")
        layers = self.grid.shape(1)[0]
        if min(middle_depths(layers)) < 1:
            raise ValueError(f"expected at least 5 layers of voxels in z for the middle layers, got {layers}")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the points that the network reads."""
        return (*POSITION, *["intensity"] * self.use_intensity, *["lag_s"] * self.use_lag)

    @property
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""
        return self.grid.range_m


class VoxelNet(MapDetector):
    """The network: its outputs are the anchor head's maps."""

    low_precision: ClassVar[tuple[str, ...]] = ("middle", "backbone", "head")

    def __init__(self, config: VoxelNetConfig | None = None) -> None:
        config = config or VoxelNetConfig()
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=config.columns)}
        multiple = math.prod(config.strides)
        depth, nx, ny = config.grid.shape(multiple)
        self.encoder = VoxelFeatureEncoder(
            config.grid,
            config.columns,
            multiple=multiple,
            widths=config.vfe_widths,
            channels=config.voxel_channels,
            max_points=config.max_points,
            positions=config.positions,
        )
        self.middle = MiddleLayers(config.voxel_channels, config.middle_widths, depth, config.middle)
        self.backbone = BevBackbone(
            self.middle.channels,
            widths=config.widths,
            depths=config.depths,
            strides=config.strides,
            out_stride=config.out_stride,
            neck_width=config.neck_width,
        )
        anchors = AnchorGrid(
            config.anchors,
            nx=nx // config.out_stride,
            ny=ny // config.out_stride,
            cell_m=config.grid.cell_m[0] * config.out_stride,
            y_min_m=config.grid.y_min_m(multiple),
        )
        self.head = AnchorHead(config, self.backbone.channels, anchors)
        self.assigner, self.channels = self.head.assigner, self.backbone.channels

    def input_columns(self) -> InputColumns:
        """What the first layer reads of a point."""
        return {"encoder.layers.0.linear.weight": (1, self.encoder.features)}

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """Voxel features, convolutional middle layers and the region proposal network's trunk (section 2.1)."""
        image, grid = self.middle(self.encoder(batch["points"])), self.head.anchors
        features = self.backbone(in_type_of(self.backbone, image))
        return FeatureMap(values=features, cell_m=grid.cell_m, origin_m=(0.0, grid.y_min_m))


# Voxel feature encoding (VoxelNet: Zhou and Tuzel, CVPR 2018, section 2.1.1), without padding.
#
# The points of a whole batch are grouped by sorting the numbers of their voxels. The paper keeps at most 35 random
# points of a voxel; here they are chosen by a hash of their coordinates, so that the same cloud gives the same
# features whatever the order of its points.

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
            assert norm.running_mean is not None
            assert norm.running_var is not None
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
    counted = torch.arange(len(key), device=key.device) - start[member] < limit
    return points[order[counted]], keys, member[counted]


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
