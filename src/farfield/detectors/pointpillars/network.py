"""PointPillars (Lang et al., CVPR 2019, arXiv 1812.05784) at long range.

Points -> pillars -> bird's-eye image -> three blocks of convolutions -> one anchor head -> rotated NMS. Differences
from the paper, each for long range: every point counts (no limit of points or pillars), anchors are assigned to a box
by the distance of its centre (boxes of visible parts overlap no anchor; ``matching: iou`` is the published way), and
intensity is left out by default. ``features`` and ``head`` set to ``openpcdet`` compute what OpenPCDet's checkpoints
expect.
"""

from collections.abc import Mapping, Sequence
from math import prod
from types import ModuleType
from typing import Annotated, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
from farfield.detectors.config import MAX_IMAGE_NUMBERS, Channels, GridConfig, check_blocks
from farfield.detectors.devices import constant, kernels_for
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.inputs import POSITION, CloudInput, Positions, features_of, stacked
from farfield.detectors.layers import (
    OPENPCDET_MOMENTUM,
    BevBackbone,
    fold_linear,
    normalise_rows,
    use_openpcdet_momentum,
)
from farfield.detectors.network import InputColumns, MapDetector
from farfield.detectors.voxels import first_points


class PointPillarsConfig(AnchorHeadConfig):
    """Everything that decides the shape of the network and its boxes."""

    name: str = "pointpillars"
    grid: GridConfig = GridConfig()
    pillar_channels: Channels = Field(32, description="numbers that describe a pillar")
    features: Literal["farfield", "openpcdet"] = Field("farfield", description="openpcdet: as its checkpoints expect")
    max_points: int = Field(0, ge=0, description="with features: openpcdet, a pillar's points that count; 0 for all")
    use_intensity: bool = Field(False, description="read intensities too")
    use_lag: bool = Field(False, description="read the age of each point's sweep: for several sweeps a frame")
    positions: Positions = Field(
        "absolute", description="relative: without the place on the ground, as adaptation needs"
    )
    widths: tuple[Channels, ...] = Field((32, 64, 128), description="channels of each block")
    depths: tuple[Annotated[int, Field(ge=0, le=64)], ...] = Field(
        (1, 4, 4), description="further convolutions of each block"
    )
    strides: tuple[Annotated[int, Field(ge=1, le=16)], ...] = Field((2, 2, 2), description="stride of each block")
    out_stride: int = Field(4, ge=1, description="stride of the anchors' grid, in pillars")
    neck_width: Channels = Field(96, description="channels of each block's output where they are joined")

    @model_validator(mode="after")
    def _one_set_of_features(self) -> "PointPillarsConfig":
        check_blocks(self.widths, self.depths, self.strides, self.out_stride)
        nx, ny = self.grid.shape(max(prod(self.strides), self.out_stride))
        if nx * ny * self.pillar_channels > MAX_IMAGE_NUMBERS:
            numbers = f"{nx} x {ny} pillars of {self.pillar_channels}"
            raise ValueError(f"expected an image of at most {MAX_IMAGE_NUMBERS:,} numbers, got {numbers}")
        if self.features == "farfield" and self.max_points:
            raise ValueError("expected max_points with features: openpcdet only; farfield's features count all points")
        if self.features == "openpcdet" and (self.use_intensity or self.use_lag):
            raise ValueError("expected use_intensity and use_lag off: openpcdet's features are x, y, z and intensity")
        if self.features == "openpcdet" and self.positions == "relative":
            raise ValueError("expected positions: absolute with features: openpcdet, which hold x and y")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the points that the network reads."""
        intensity = self.use_intensity or self.features == "openpcdet"
        return (*POSITION, *["intensity"] * intensity, *["lag_s"] * self.use_lag)

    @property
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""
        return self.grid.range_m


class PointPillars(MapDetector):
    """The network: its outputs are the anchor head's maps."""

    low_precision: ClassVar[tuple[str, ...]] = ("backbone", "head")

    def __init__(self, config: PointPillarsConfig | None = None) -> None:
        config = config or PointPillarsConfig()
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=config.columns)}
        multiple = int(np.prod(config.strides))
        shared = {"multiple": multiple, "channels": config.pillar_channels}
        self.encoder: PillarEncoder | OpenPCDetPillarEncoder
        if config.features == "openpcdet":
            self.encoder = OpenPCDetPillarEncoder(config.grid, config.columns, max_points=config.max_points, **shared)
        else:
            self.encoder = PillarEncoder(config.grid, config.columns, positions=config.positions, **shared)
        self.backbone = BevBackbone(
            config.pillar_channels,
            widths=config.widths,
            depths=config.depths,
            strides=config.strides,
            out_stride=config.out_stride,
            neck_width=config.neck_width,
        )
        anchors = AnchorGrid(
            config.anchors,
            nx=self.encoder.nx // config.out_stride,
            ny=self.encoder.ny // config.out_stride,
            cell_m=config.grid.cell_m * config.out_stride,
            y_min_m=self.encoder.y_min_m,
        )
        self.head = AnchorHead(config, self.backbone.channels, anchors)
        self.assigner, self.channels = self.head.assigner, self.backbone.channels
        if config.features == "openpcdet":
            use_openpcdet_momentum(self)

    def input_columns(self) -> InputColumns:
        """What the encoder's linear layer reads of a point."""
        return {"encoder.linear.weight": (1, self.encoder.features)}

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """Pillars, their image, and the backbone's features (sections 2.1 and 2.2)."""
        clouds, grid = batch["points"], self.head.anchors
        image = self.encoder(*stacked(clouds), len(clouds))
        features = self.backbone(in_type_of(self.backbone, image))
        return FeatureMap(values=features, cell_m=grid.cell_m, origin_m=(0.0, grid.y_min_m))


# Pillars (PointPillars, section 2.1): points to a bird's-eye image, without Python loops and without a point limit.
#
# Dynamic voxelisation: every point counts, none is dropped or padded. Points of a whole batch are grouped at once by
# sorting their cell numbers.

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

        The first three are those of the paper, scaled to the grid; the fourth (logarithm) takes the role of intensity.
        """
        xyz = points[:, :3]
        # Sums of float32 numbers near one another are exact in float64: then the order of the points does not matter.
        exact = torch.cat([xyz, xyz.new_ones(len(xyz), 1)], 1).double()
        sums = exact.new_zeros(pillar_count, 4).index_add(0, member, exact)
        count = sums[:, 3:].to(xyz.dtype)
        to_mean = xyz - (sums[:, :3] / sums[:, 3:]).to(xyz.dtype)[member]
        iy, ix = key % self.ny, torch.div(key, self.ny, rounding_mode="floor") % self.nx
        centre = torch.stack([(ix + 0.5) * self.grid.cell_m, (iy + 0.5) * self.grid.cell_m + self.y_min_m], 1)
        to_centre = (xyz[:, :2] - centre) / self.grid.cell_m
        scaled = xyz / xyz.new_tensor([self.grid.range_m, self.grid.half_width_m, self.grid.z_max_m])
        parts = [scaled[:, self.first :], to_mean / self.grid.cell_m, to_centre, torch.log1p(count)[member]]
        return torch.cat([*parts, points[:, self.extra]], 1)


# Features and constants of PointPillars and SECOND as OpenPCDet computes them: what its checkpoints expect.
#
# Coordinates go in as they are, in metres, and only the first points of a pillar or voxel count, in the cloud's
# order.

_OFFSETS = tuple(f"d{axis}_m of {where}" for where in ("mean", "centre") for axis in "xyz")
_OPENPCDET_FEATURES = ("x_m", "y_m", "z_m", "intensity", *_OFFSETS)


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
        self.features = _OPENPCDET_FEATURES
        self.nx, self.ny = grid.shape(multiple)
        self.y_min_m = grid.y_min_m(multiple)
        self.linear = nn.Linear(10, channels, bias=False)
        self.norm: nn.Module = nn.BatchNorm1d(channels, eps=1e-3, momentum=OPENPCDET_MOMENTUM)

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
        sums = xyz.new_zeros(len(count), 3, dtype=torch.float64).index_add(0, member, xyz.double())
        mean = (sums / count[:, None]).to(xyz.dtype)
        iy, ix = key % self.ny, torch.div(key, self.ny, rounding_mode="floor") % self.nx
        height = xyz.new_full((len(key),), (grid.z_min_m + grid.z_max_m) / 2)
        across = (iy + 0.5) * grid.cell_m + self.y_min_m
        centre = torch.stack([(ix + 0.5) * grid.cell_m, across, height], 1)
        return torch.cat([xyz, points[:, [self.intensity]], xyz - mean[member], xyz - centre], 1)
