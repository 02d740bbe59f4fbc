"""RTNH, the Radar Tensor Network with Height (K-Radar: Paek, Kong and Wijaya, NeurIPS 2022, section 3.4, appendix E).

The strongest cells of the radar's Cartesian cube -> sparse 3D convolutions at three resolutions -> each collapsed over
its height and brought to one bird's-eye map -> head -> rotated NMS. ``form: published`` is ``cfg_RTNH.yml`` of the
paper's benchmark; ``form: wide`` is the current one, ``cfg_RTNH_wide.yml``. Differences from the released code: all
boxes of a frame keep the cells assigned to them, frames without boxes teach background, there is no limit on the
number of cells, and convolutions that a normalisation follows have no bias, which it would cancel.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field
from torch import Tensor

from farfield.detectors.contract import Channels, InputColumns
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.kradar.backbone import RadarBackbone
from farfield.detectors.kradar.cells import CellEncoder
from farfield.detectors.kradar.config import RadarDetector, RadarDetectorConfig


class RTNHConfig(RadarDetectorConfig):
    """Everything that decides the shape of the network and its boxes; the widths are the published ones."""

    name: str = "rtnh"
    max_points: Annotated[int, Field(ge=0, le=1000)] = Field(
        0, description="0: a linear layer on each cell's mean; else the maximum over so many points (PointNet)"
    )
    positions: Literal["metres", "unit"] = Field("metres", description="unit: as shares of the grid, -1 to 1")
    cell_channels: Channels = Field(64, description="channels of the first layer of cells")
    widths: tuple[Channels, ...] = Field(
        (64, 128, 256), min_length=1, max_length=6, description="channels of each block"
    )
    execution: Literal["auto", "sparse", "dense"] = Field("auto", description="one function, two ways to compute it")


class RTNH(RadarDetector):
    """The network: its outputs are the head's maps."""

    low_precision: ClassVar[tuple[str, ...]] = ("backbone", "head")

    def __init__(self, config: RTNHConfig | None = None) -> None:
        config = config or RTNHConfig()
        super().__init__(config)
        multiple = 2 ** (len(config.widths) - 1)
        self.encoder = CellEncoder(
            config.grid,
            config.columns,
            multiple=multiple,
            channels=config.cell_channels,
            max_points=config.max_points,
            log_power=config.power == "log",
            unit_positions=config.positions == "unit",
        )
        self.backbone = RadarBackbone(
            config.cell_channels,
            widths=config.widths,
            neck_width=config.neck_width,
            depth=config.grid.shape(multiple)[0],
            execution=config.execution,
        )
        self.add_head(self.backbone.channels, multiple)

    def input_columns(self) -> InputColumns:
        """What the encoder's linear layer reads of a cell."""
        return {"encoder.linear.weight": (1, self.encoder.columns)}

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """Occupied cells, 3D sparse convolution blocks and neck (appendix E.1 and E.2)."""
        cells = self.encoder(batch["points"])
        return self.on_raster(self.backbone(cells.replace(in_type_of(self.backbone, cells.features))))
