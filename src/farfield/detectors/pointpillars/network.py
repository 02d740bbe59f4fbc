"""PointPillars (Lang et al., CVPR 2019, arXiv 1812.05784) at long range.

Points -> pillars -> bird's-eye image -> three blocks of convolutions -> one anchor head -> rotated NMS. Differences
from the paper, each for long range: every point counts (no limit of points or pillars), anchors are assigned to a box
by the distance of its centre (boxes of visible parts overlap no anchor; ``matching: iou`` is the published way), and
intensity is left out by default. ``features`` and ``head`` set to ``openpcdet`` compute what OpenPCDet's checkpoints
expect.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator
from torch import Tensor

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
from farfield.detectors.bev import BevBackbone
from farfield.detectors.contract import Channels, InputColumns, MapDetector
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.grid import GridConfig
from farfield.detectors.inputs import POSITION, CloudInput, Positions, stacked
from farfield.detectors.openpcdet_features import OpenPCDetPillarEncoder, use_openpcdet_momentum
from farfield.detectors.pointpillars.pillars import PillarEncoder


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
        self.encoder = _encoder(config, multiple)
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


def _encoder(config: PointPillarsConfig, multiple: int) -> PillarEncoder | OpenPCDetPillarEncoder:
    shared = {"multiple": multiple, "channels": config.pillar_channels}
    if config.features == "openpcdet":
        return OpenPCDetPillarEncoder(config.grid, config.columns, max_points=config.max_points, **shared)
    return PillarEncoder(config.grid, config.columns, positions=config.positions, **shared)
