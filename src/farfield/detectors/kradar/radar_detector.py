"""What RTN and RTNH share: cells of radar clouds, the two regions with their anchors, the neck, the head."""

from collections.abc import Sequence
from typing import Any, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
from farfield.detectors.config import OLD_NAMES, VoxelGridConfig
from farfield.detectors.features import FeatureMap
from farfield.detectors.inputs import POSITION, CloudInput, stacked
from farfield.detectors.kradar.softmax_head import SoftmaxHead
from farfield.detectors.layers import Upsampling
from farfield.detectors.network import MapDetector
from farfield.detectors.sparse import SparseTensor
from farfield.detectors.voxels import first_points, voxel_keys
from farfield.vocabulary.kradar import REGIONS_M

Position = tuple[float, float, float]

# Radar clouds on their own raster: every point is a cell of 0.4 m, so a cloud is a sparse cube of power.

POWER, DOPPLER = "power", "doppler_m_s"
LOG_POWER_UNIT = 0.01
"""With ``power: log`` a power p, over 1e13, becomes log(1 + p / 0.01): K-Radar's noise lies near 0.01."""


_NARROW = REGIONS_M["narrow"]


class RadarGridConfig(VoxelGridConfig):
    """The raster, in the radar's frame; K-Radar's narrow region (driving corridor) by default."""

    range_m: float = Field(_NARROW[1], gt=0, description="forward reach, x from 0")
    half_width_m: float = Field(_NARROW[3], gt=0, description="lateral reach, y from -half_width_m to +half_width_m")
    z_min_m: float = Field(_NARROW[4], description="cells below are dropped")
    z_max_m: float = Field(_NARROW[5], description="cells above are dropped")
    cell_m: tuple[float, float, float] = Field((0.4, 0.4, 0.4), description="the radar's cell along x, y and z")


FLAGS = ("has_doppler", "has_height")


def cell_columns(use_doppler: bool, use_flags: bool = False) -> tuple[str, ...]:
    """Columns of the points that a radar network reads: position, power, Doppler and what is known if asked for."""
    return (*POSITION, POWER, *[DOPPLER] * use_doppler, *FLAGS * use_flags)


def scaled_power(points: Tensor, columns: Sequence[str], *, log: bool) -> Tensor:
    """The points, shape (n, columns), with their power as it is or, floored at 0, as log(1 + p / 0.01)."""
    if not log:
        return points
    index = columns.index(POWER)
    power = torch.log1p(points[:, index : index + 1].clamp(min=0.0) / LOG_POWER_UNIT)
    return torch.cat([points[:, :index], power, points[:, index + 1 :]], 1)


def in_unit_grid(points: Tensor, grid: VoxelGridConfig) -> Tensor:
    """The points, shape (n, c), with their position as shares of the grid, from -1 to 1.

    Metres would drown the power: x reaches 72, the logarithm of the power about 8, and what follows is normalised as a
    whole.
    """
    low = points.new_tensor([0.0, -grid.half_width_m, grid.z_min_m])
    high = points.new_tensor([grid.range_m, grid.half_width_m, grid.z_max_m])
    return torch.cat([(points[:, :3] - low) / (high - low) * 2 - 1, points[:, 3:]], 1)


def located(
    clouds: Sequence[Tensor], grid: VoxelGridConfig, multiple: int, low_m: Position = (0.0, 0.0, 0.0)
) -> tuple[Tensor, Tensor]:
    """The points of a batch that lie on the raster, shape (n, c), and the cell of each, shape (n,), int64.

    Args:
        clouds: The points of each frame, x, y and z (metres) first.
        grid: The raster.
        multiple: The network's coarsest stride.
        low_m: How far beyond the grid's lower limits the raster begins along x, y and z: not above 0.
    """
    points, batch = stacked(clouds)
    moved = points if low_m == (0.0, 0.0, 0.0) else points[:, :3] - points.new_tensor(low_m)
    rows, key = voxel_keys(moved, batch, grid, multiple)
    return points[rows], key


def cell_table(features: Tensor, key: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """Mean features of every cell, zero where there is no point; a radar cloud has one point a cell.

    Args:
        features: Of the points, shape (n, c).
        key: Cell of each point, shape (n,), int64.
        cells: Number of cells of the batch.

    Returns:
        The table, shape (cells, c), and the number of points in each cell, shape (cells,).
    """
    count = torch.bincount(key, minlength=cells)
    table = features.new_zeros(cells, features.shape[1]).index_add_(0, key, features)
    return table / count.clamp(min=1)[:, None], count


class CellEncoder(nn.Module):
    """Points to occupied cells with learned features.

    Args:
        grid: The raster.
        columns: Columns of the points: position, power, further features.
        multiple: The network's coarsest stride.
        channels: Features a cell.
        max_points: 0 for RTNH as published: position and power through one 1 x 1 x 1 convolution. Otherwise the
            "simplified PointNet" of its wide form: a linear layer and the maximum over the first so many points of a
            cell, where missing points count as zeros.
        lifted: Features that a second linear layer makes of a cell's, as the kit's wide form does; 0: there is none.
        low_m: How far beyond the grid's lower limits the raster begins along x, y and z.
        log_power: Read the logarithm of the power.
        unit_positions: Read positions as shares of the grid, -1 to 1, instead of metres.
    """

    def __init__(
        self,
        grid: VoxelGridConfig,
        columns: Sequence[str],
        *,
        multiple: int,
        channels: int,
        max_points: int = 0,
        lifted: int = 0,
        low_m: Position = (0.0, 0.0, 0.0),
        log_power: bool = False,
        unit_positions: bool = False,
    ) -> None:
        super().__init__()
        self.grid, self.multiple, self.max_points, self.low_m = grid, multiple, max_points, low_m
        self.log_power, self.unit_positions = log_power, unit_positions
        self.columns = tuple(columns)
        self.linear = nn.Linear(len(self.columns), channels, bias=max_points == 0)
        self.lift = nn.Linear(channels, lifted) if lifted else nn.Identity()
        self.channels = lifted or channels

    def forward(self, clouds: Sequence[Tensor]) -> SparseTensor:
        """Encode the points of each frame, shape (n, columns), in float32."""
        shape = self.grid.shape(self.multiple)
        points, key = located(clouds, self.grid, self.multiple, self.low_m)
        points = in_unit_grid(points, self.grid) if self.unit_positions else points
        features = scaled_power(points, self.columns, log=self.log_power)
        cells = len(clouds) * shape[0] * shape[1] * shape[2]
        with torch.autocast(points.device.type, enabled=False):
            if self.max_points:
                pooled, keys = self._pooled(features, key, cells)
            else:
                table, count = cell_table(features, key, cells)
                keys = count.nonzero().squeeze(1)
                pooled = self.linear(table.index_select(0, keys))
            pooled = self.lift(pooled)
        return SparseTensor(pooled, keys, shape, len(clouds))

    def _pooled(self, features: Tensor, key: Tensor, cells: int) -> tuple[Tensor, Tensor]:
        count = torch.bincount(key, minlength=cells)
        keys = count.nonzero().squeeze(1)
        if len(keys) < len(key):  # somewhere two points share a cell
            counted = first_points(key, self.max_points)
            features, key = features[counted], key[counted]
        row = torch.cumsum(count > 0, 0)[key] - 1
        if len(keys) == len(key) and self.max_points > 1:  # one point a cell, and zeros beside it
            learned = torch.relu(self.linear(features))
            return torch.zeros_like(learned).index_copy_(0, row, learned), keys
        padded = (count.index_select(0, keys) < self.max_points)[:, None]
        learned = self.linear(features)
        start = torch.where(padded, 0.0, -torch.inf).to(learned.dtype).expand(-1, learned.shape[1])
        return start.scatter_reduce(0, row[:, None].expand_as(learned), learned, "amax"), keys


_SEDAN = {"size_m": (4.2, 2.1, 2.0), "z_m": 0.0, "positive_iou": 0.5, "negative_iou": 0.2}
_BOTTOM_M = -1.08

FORMS: dict[str, dict[str, Any]] = {
    "published": {  # cfg_RTNH.yml, benchmark v1.0
        "grid": {},
        "anchors": {"vehicle": _SEDAN},
        "box_weight": 1.0,
        "max_points": 0,
        "cell_channels": 64,
        "score_threshold": 0.3,
        "nms_iou": 0.1,
    },
    "wide": {  # cfg_RTNH_wide.yml, benchmark v2.0
        "grid": {"half_width_m": REGIONS_M["wide"][3], "z_max_m": REGIONS_M["wide"][5]},
        "anchors": {
            "vehicle": {**_SEDAN, "z_m": _BOTTOM_M + 1.0},
            "large_vehicle": {
                "size_m": (9.5, 3.2, 3.7),
                "z_m": _BOTTOM_M + 1.85,
                "positive_iou": 0.45,
                "negative_iou": 0.15,
            },
        },
        "head": "openpcdet",
        "matching": "iou",
        "candidates": 4096,
        "max_points": 4,
        "cell_channels": 32,
        "score_threshold": 0.1,
        "nms_iou": 0.01,
    },
}
"""Settings that each form stands for; what an experiment sets itself comes first."""


class RadarDetectorConfig(AnchorHeadConfig):
    """Settings that RTN and RTNH share. ``form`` decides what the others are unless they are given."""

    old_names = OLD_NAMES

    form: Literal["published", "wide"] = Field(
        "published",
        description="published: narrow region, Sedan, softmax head; wide: two classes, OpenPCDet's anchor head",
    )
    grid: RadarGridConfig = RadarGridConfig()
    proposals: Literal["predicted", "anchors"] = Field(
        "predicted", description="with form: published, what must overlap a box to be assigned to it"
    )
    power: Literal["linear", "log"] = Field("linear", description="log: log(1 + power / 0.01) instead of the power")
    use_doppler: bool = Field(False, description="also read the cells' Doppler")
    use_flags: bool = Field(False, description="also read whether Doppler and height are known: several radars")
    neck_width: int = Field(256, ge=1, le=4096, description="channels that each stage gives to the bird's-eye map")
    first_cell: Literal["at the limit", "before it"] = Field(
        "at the limit",
        description="before it: the raster begins and ends a cell before the grid's limits, as the kit numbers cells",
    )

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, settings: Any) -> Any:
        if not isinstance(settings, dict):
            return settings
        usual = FORMS.get(str(settings.get("form", "published")), {})
        return {**{key: value for key, value in usual.items() if key in cls.model_fields}, **settings}

    @model_validator(mode="after")
    def _square_cells(self) -> "RadarDetectorConfig":
        if self.grid.cell_m[0] != self.grid.cell_m[1]:
            raise ValueError(f"expected cells as long as wide, got {self.grid.cell_m}: the anchors' cells are square")
        return self

    @property
    def low_m(self) -> Position:
        """How far beyond the grid's lower limits the raster begins along x, y and z: 0, or a cell below it."""
        if self.first_cell == "at the limit":
            return 0.0, 0.0, 0.0
        dx, dy, dz = self.grid.cell_m
        return -dx, -dy, -dz

    @property
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""
        return self.grid.range_m

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the points that the network reads."""
        return cell_columns(self.use_doppler, self.use_flags)


class RadarNeck(nn.Module):
    """Feature maps at several strides to the first one's, concatenated (appendix E.1).

    Args:
        widths: Channels of each map.
        strides: Stride of each map.
        channels: Channels that each map contributes.
        overlap: Kernels of three times the stride, as RTNH's; otherwise as wide as the stride, 3 at stride 1.
    """

    def __init__(self, widths: Sequence[int], strides: Sequence[int], channels: int, *, overlap: bool) -> None:
        super().__init__()
        self.layers = nn.ModuleList()
        for width, stride in zip(widths, strides, strict=True):
            up = Upsampling(width, channels, stride, overlap=overlap or stride == 1)
            self.layers.append(nn.Sequential(up, nn.BatchNorm2d(channels), nn.ReLU(inplace=True)))
        self.channels = channels * len(self.layers)

    def forward(self, maps: Sequence[Tensor]) -> Tensor:
        """Maps (b, c, nx / stride, ny / stride) to one of shape (b, channels, nx, ny)."""
        return torch.cat([layer(image) for layer, image in zip(self.layers, maps, strict=True)], 1)


class RadarDetector(MapDetector):
    """Reads radar points on their raster; its head has one set of anchors at every cell."""

    head: AnchorHead | SoftmaxHead

    def __init__(self, config: RadarDetectorConfig) -> None:
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=config.columns)}

    def add_head(self, c_in: int, multiple: int) -> None:
        """Make the head of the configuration's form, on a map of the raster's resolution."""
        config = self.config
        _, nx, ny = config.grid.shape(multiple)
        cell_m, (x_m, y_m, _) = config.grid.cell_m[0], config.low_m
        y_m += config.grid.y_min_m(multiple)
        anchors = AnchorGrid(config.anchors, nx=nx, ny=ny, cell_m=cell_m, x_min_m=x_m, y_min_m=y_m)
        if config.form == "wide":
            self.head = AnchorHead(config, c_in, anchors)
        else:
            self.head = SoftmaxHead(config, c_in, anchors, proposals=config.proposals)
        self.assigner, self.channels = self.head.assigner, c_in

    def on_raster(self, values: Tensor) -> FeatureMap:
        """The trunk's map, shape (b, c, nx, ny), with its place."""
        grid = self.head.anchors
        return FeatureMap(values=values, cell_m=grid.cell_m, origin_m=(grid.x_min_m, grid.y_min_m))
