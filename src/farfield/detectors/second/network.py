"""SECOND (Yan, Mao and Li, Sensors 18(10):3337, 2018) at long range.

Points -> voxels -> sparse 3D convolutions -> bird's-eye image -> two blocks of convolutions -> one anchor head ->
rotated NMS. Differences from the paper, each for long range and one key away from what was published: voxels of 0.1 m
(``grid.cell_m``, published 0.05 x 0.05 x 0.1 m), half the widths behind the sparse layers, so that two cores keep up
(published ``middle_out: 128``, ``widths: [128, 256]``, ``neck_width: 256``), a taller grid, since roads climb over
250 m, no limit of points (``max_points: 5``), and anchors assigned to a box by the distance of its centre
(``matching: iou``). ``features`` and ``head`` set to ``openpcdet`` compute what OpenPCDet's checkpoints expect.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator
from torch import Tensor

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
from farfield.detectors.config import OLD_NAMES, Channels, VoxelGridConfig, check_blocks
from farfield.detectors.features import FeatureMap
from farfield.detectors.inputs import POSITION, CloudInput, Positions
from farfield.detectors.layers import BevBackbone, use_openpcdet_momentum
from farfield.detectors.network import InputColumns, MapDetector
from farfield.detectors.sparse import SparseConv, SparseSequential, SparseTensor, SubmanifoldConv, normalised
from farfield.detectors.voxels import first_points_of_voxels, mean_features, mean_voxels

_MIDDLE_STRIDE = 8
_Z_STEPS = ((3, 2, 1), (3, 2, 1), (3, 2, 0), (3, 2, 0))  # kernel, stride and padding along z where z shrinks


class SecondConfig(AnchorHeadConfig):
    """Everything that decides the shape of the network and its boxes."""

    old_names = OLD_NAMES

    name: str = "second"
    grid: VoxelGridConfig = VoxelGridConfig()
    features: Literal["farfield", "openpcdet"] = Field("farfield", description="openpcdet: as its checkpoints expect")
    max_points: int = Field(0, ge=0, description="first points of a voxel that count; 0 for all")
    use_intensity: bool = Field(False, description="read intensities too")
    use_lag: bool = Field(False, description="read the age of each point's sweep: for several sweeps a frame")
    positions: Positions = Field(
        "absolute", description="relative: without the place on the ground, as adaptation needs"
    )
    middle_widths: tuple[Channels, Channels, Channels, Channels] = Field(
        (16, 32, 64, 64), description="channels of the convolutions in space"
    )
    middle_out: Channels = Field(64, description="channels of each remaining layer of z, which are then stacked")
    widths: tuple[Channels, ...] = Field((64, 128), description="channels of each block")
    depths: tuple[Annotated[int, Field(ge=0, le=64)], ...] = Field(
        (5, 5), description="further convolutions of each block"
    )
    strides: tuple[Annotated[int, Field(ge=1, le=16)], ...] = Field((1, 2), description="stride of each block")
    out_stride: int = Field(1, ge=1, description="stride of the anchors' grid, in cells of the bird's-eye image")
    neck_width: Channels = Field(128, description="channels of each block's output where they are joined")

    @model_validator(mode="after")
    def _grid_suits(self) -> "SecondConfig":
        check_blocks(self.widths, self.depths, self.strides, self.out_stride)
        if self.grid.cell_m[0] != self.grid.cell_m[1]:
            raise ValueError(f"expected voxels as long as wide, got {self.grid.cell_m}: the anchors' cells are square")
        if folded_layers(self.grid.shape(1)[0]) < 1:
            fewest = next(layers for layers in range(1, 1000) if folded_layers(layers) >= 1)
            raise ValueError(
                f"expected a grid of at least {fewest} layers along z, since the sparse convolutions halve z four "
                f"times; got {self.grid.shape(1)[0]}: take a smaller cell_m along z, or move z_min_m and z_max_m apart"
            )
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


def folded_layers(layers: int) -> int:
    """Layers of z that the sparse convolutions leave; zero or less if the grid is too thin."""
    for kernel, stride, padding in _Z_STEPS:
        layers = (layers + 2 * padding - kernel) // stride + 1
    return layers


class SparseMiddle(SparseSequential):
    """The sparse middle layers (section 3.1.2): three strides of 2, then a last one along z only.

    Args:
        c_in: Features a voxel.
        widths: Channels at strides 1, 2, 4 and 8.
        c_out: Channels of the output.
    """

    def __init__(self, c_in: int, widths: tuple[int, int, int, int], c_out: int) -> None:
        layers = [normalised(SubmanifoldConv(c_in, widths[0])), normalised(SubmanifoldConv(widths[0], widths[0]))]
        for width, wider, z_padding in zip(widths, widths[1:], (1, 1, 0), strict=False):
            layers.append(normalised(SparseConv(width, wider, (3, 3, 3), (2, 2, 2), (z_padding, 1, 1))))
            layers += [normalised(SubmanifoldConv(wider, wider)) for _ in range(2)]
        layers.append(normalised(SparseConv(widths[3], c_out, (3, 1, 1), (2, 1, 1), (0, 0, 0))))
        super().__init__(*layers)


def stack_z(sparse: SparseTensor) -> Tensor:
    """A bird's-eye image whose channels are those of all layers of z, lowest layer first.

    Args:
        sparse: Features on a grid of D layers, shape (n, c).

    Returns:
        Image of shape (b, D * c, nx, ny), in channels_last memory, zero where no cell is occupied.
    """
    (depth, nx, ny), channels = sparse.shape, sparse.features.shape[1]
    frame, iz, ix, iy = sparse.indices().unbind(1)
    row = ((frame * nx + ix) * ny + iy) * depth + iz
    cells = sparse.features.new_zeros(sparse.batch_size * nx * ny * depth, channels)
    image = cells.index_copy(0, row, sparse.features)
    return image.view(sparse.batch_size, nx, ny, depth * channels).permute(0, 3, 1, 2)


class Second(MapDetector):
    """The network: its outputs are the anchor head's maps."""

    low_precision: ClassVar[tuple[str, ...]] = ("middle", "backbone", "head")

    def __init__(self, config: SecondConfig | None = None) -> None:
        config = config or SecondConfig()
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=config.columns)}
        self.multiple = _MIDDLE_STRIDE * int(np.prod(config.strides))
        depth, nx, ny = config.grid.shape(self.multiple)
        self.middle = SparseMiddle(self._feature_count(), config.middle_widths, config.middle_out)
        self.backbone = BevBackbone(
            folded_layers(depth) * config.middle_out,
            widths=config.widths,
            depths=config.depths,
            strides=config.strides,
            out_stride=config.out_stride,
            neck_width=config.neck_width,
        )
        stride = _MIDDLE_STRIDE * config.out_stride
        anchors = AnchorGrid(
            config.anchors,
            nx=nx // stride,
            ny=ny // stride,
            cell_m=config.grid.cell_m[0] * stride,
            y_min_m=config.grid.y_min_m(self.multiple),
        )
        self.head = AnchorHead(config, self.backbone.channels, anchors)
        self.assigner, self.channels = self.head.assigner, self.backbone.channels
        if config.features == "openpcdet":
            use_openpcdet_momentum(self)

    def _feature_count(self) -> int:
        return len(self._features())

    def _features(self) -> tuple[str, ...]:
        """Names of a voxel's features."""
        columns, means = self.config.columns, mean_features(self.config.positions)
        return columns if self.config.features == "openpcdet" else (*means, *columns[len(POSITION) :])

    def input_columns(self) -> InputColumns:
        """What the first convolution reads of a voxel."""
        return {"middle.0.conv.weight": (1, self._features())}

    def voxels(self, clouds: Sequence[Tensor]) -> SparseTensor:
        """The occupied voxels of a batch with their mean features (section 3.1.1, with the mean for the VFE)."""
        config = self.config
        clouds = first_points_of_voxels(clouds, config.grid, self.multiple, config.max_points)
        published = config.features == "openpcdet"
        read = {"columns": config.columns, "published": published, "positions": config.positions}
        return mean_voxels(clouds, config.grid, self.multiple, **read)

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """Voxels, sparse middle layers and the bird's-eye backbone (section 3.1)."""
        features = self.backbone(stack_z(self.middle(self.voxels(batch["points"]))))
        grid = self.head.anchors
        return FeatureMap(values=features, cell_m=grid.cell_m, origin_m=(0.0, grid.y_min_m))
