"""VoxelNet (Zhou and Tuzel, CVPR 2018, arXiv 1711.06396) at long range (Cirrus, section V.A).

Points -> voxels of 0.2 x 0.2 x 0.4 m with learned features -> 3D convolutions -> region proposal network -> boxes.
Differences from the paper: the 3D convolutions compute only what a point reaches (the same function, see
``middle.py``); 1250 x 500 cells are padded to 1256 x 504, since the three strides must divide them; losses and
assignment are those of the house's anchor head (focal loss, direction bins, assignment by distance).
"""

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator
from torch import Tensor

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
from farfield.detectors.bev import BevBackbone
from farfield.detectors.contract import Channels, InputColumns, MapDetector
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.inputs import POSITION, CloudInput, Positions
from farfield.detectors.voxelnet.middle import MiddleLayers, middle_depths
from farfield.detectors.voxelnet.vfe import VoxelFeatureEncoder
from farfield.detectors.voxels import OLD_NAMES, VoxelGridConfig

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
