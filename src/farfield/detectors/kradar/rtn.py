"""RTN, the Radar Tensor Network without Height (K-Radar: Paek, Kong and Wijaya, NeurIPS 2022, appendix E.1, E.3).

The whole cube in the region -> a bird's-eye image, the layers of height as its channels -> ResNet-50 or ResNeXt-101 ->
maps of all stages brought to one -> the head of RTNH -> rotated NMS. No configuration of RTN was ever released. What is
taken here, from the released trunk and the memory that table 9 states: four stages at strides 1, 2, 4 and 4 (the last
one dilated) behind a 7 x 7 convolution of stride 1, ResNeXt-101 as 32 x 8d, its only kind there.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.config import Channels
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.inputs import features_of
from farfield.detectors.kradar.radar_detector import (
    RadarDetector,
    RadarDetectorConfig,
    RadarNeck,
    cell_table,
    located,
    scaled_power,
)
from farfield.detectors.network import InputColumns

_DEPTHS = {"resnet50": (3, 4, 6, 3), "resnext101": (3, 4, 23, 3)}


class RTNConfig(RadarDetectorConfig):
    """Everything that decides the shape of the network and its boxes."""

    name: str = "rtn"
    trunk: Literal["resnet50", "resnext101"] = Field("resnet50", description="the backbone")
    height: Literal["channels", "mean"] = Field(
        "channels", description="mean: average the layers into one channel, as the released code's bird's-eye map does"
    )
    planes: Channels = Field(64, description="planes of the first stage")
    group_width: Channels = Field(8, description="with trunk: resnext101, channels of each of its 32 groups")
    strides: tuple[Annotated[int, Field(ge=1, le=4)], ...] = Field(
        (1, 2, 2, 1), min_length=1, max_length=4, description="stride of each stage"
    )
    depths: tuple[Annotated[int, Field(ge=1, le=64)], ...] | None = Field(
        None, description="bottlenecks of each stage; those of the trunk if left out"
    )

    @model_validator(mode="after")
    def _trunk_fits(self) -> "RTNConfig":
        if len(self.stage_depths) != len(self.strides):
            raise ValueError(f"expected as many depths as strides, got {self.depths} and {self.strides}")
        width = self.planes * self.group_width
        if self.trunk == "resnext101" and (width < 64 or width % 64):
            raise ValueError(f"expected planes times group_width to be a multiple of 64, got {width}")
        return self

    @property
    def stage_depths(self) -> tuple[int, ...]:
        """Bottlenecks of each stage."""
        return _DEPTHS[self.trunk][: len(self.strides)] if self.depths is None else self.depths


class RTN(RadarDetector):
    """The network: its outputs are the head's maps."""

    low_precision: ClassVar[tuple[str, ...]] = ("trunk", "neck", "head")

    def __init__(self, config: RTNConfig | None = None) -> None:
        config = config or RTNConfig()
        super().__init__(config)
        layers = 1 if config.height == "mean" else config.grid.shape(1)[0]
        self.read = features_of(config.columns)
        grouped = {"groups": 32, "group_width": config.group_width} if config.trunk == "resnext101" else {}
        self.trunk = ResNet(
            layers * len(self.read),
            depths=config.stage_depths,
            planes=config.planes,
            strides=config.strides,
            **grouped,
        )
        self.multiple = max(self.trunk.strides)
        self.neck = RadarNeck(self.trunk.widths, self.trunk.strides, config.neck_width, overlap=False)
        self.add_head(self.neck.channels, self.multiple)

    def input_columns(self) -> InputColumns:
        """What the first convolution reads: each column at each height of the grid, or the mean over heights."""
        config = self.config
        depth, low, cell = config.grid.shape(1)[0], config.grid.z_min_m, config.grid.cell_m[2]
        places = ["mean"] if config.height == "mean" else [f"z {low + (k + 0.5) * cell:.2f} m" for k in range(depth)]
        channels = [f"{config.columns[index]} at {height}" for index in self.read for height in places]
        return {"trunk.stem.0.weight": (1, channels)}

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """Dense map of the cells, 2D dense convolution blocks and neck (appendix E.1 and E.3)."""
        image = in_type_of(self.trunk, self.dense_map(batch["points"]))
        return self.on_raster(self.neck(self.trunk(image)))

    def dense_map(self, clouds: Sequence[Tensor]) -> Tensor:
        """Power (and Doppler) of every cell, zero where none is known, layers of height as channels, (b, c, nx, ny)."""
        config = self.config
        depth, nx, ny = config.grid.shape(self.multiple)
        points, key = located(clouds, config.grid, self.multiple, config.low_m)
        values = scaled_power(points, config.columns, log=config.power == "log")[:, self.read]
        table, _ = cell_table(values, key, len(clouds) * depth * nx * ny)
        image = table.view(len(clouds), depth, nx, ny, len(self.read))
        image = image.mean(1, keepdim=True) if config.height == "mean" else image
        return image.permute(0, 4, 1, 2, 3).flatten(1, 2).contiguous(memory_format=torch.channels_last)


# ResNet and ResNeXt trunks (He et al., CVPR 2016; Xie et al., CVPR 2017) without a classifier.

EXPANSION = 4
"""A bottleneck's output has four times its planes (ResNet, table 1)."""


class StridedPointwise(nn.Conv2d):
    """A 1 x 1 convolution with a stride, as one without on every stride-th cell: the same function.

    oneDNN 3's own, on AVX-512 with channels last and fewer than 16 input channels, writes past its memory in the
    backward pass: a crash of the process, or one later.
    """

    def __init__(self, c_in: int, c_out: int, stride: int) -> None:
        super().__init__(c_in, c_out, 1, stride, bias=False)

    def forward(self, image: Tensor) -> Tensor:
        """Map (b, c_in, h, w) to (b, c_out, h / stride, w / stride)."""
        down, across = self.stride
        return functional.conv2d(image[:, :, ::down, ::across], self.weight, self.bias)


class Bottleneck(nn.Module):
    """1 x 1, 3 x 3 and 1 x 1 convolutions beside the identity (ResNet, figure 5, right; ResNeXt, figure 3, c).

    Args:
        c_in: Input channels.
        planes: A quarter of the output channels.
        groups: Groups of the 3 x 3 convolution, ResNeXt's cardinality.
        group_width: Channels of a group at 64 planes; 64 with one group is ResNet.
        stride: Step of the 3 x 3 convolution.
        dilation: Spacing of its elements.
    """

    def __init__(
        self, c_in: int, planes: int, *, groups: int = 1, group_width: int = 64, stride: int = 1, dilation: int = 1
    ) -> None:
        super().__init__()
        width, c_out = planes * group_width // 64 * groups, EXPANSION * planes
        self.layers = nn.Sequential(
            nn.Conv2d(c_in, width, 1, bias=False),
            nn.BatchNorm2d(width),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, width, 3, stride, dilation, dilation, groups, bias=False),
            nn.BatchNorm2d(width),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, c_out, 1, bias=False),
            nn.BatchNorm2d(c_out),
        )
        self.shortcut: nn.Module = nn.Identity()
        if stride != 1 or c_in != c_out:
            self.shortcut = nn.Sequential(StridedPointwise(c_in, c_out, stride), nn.BatchNorm2d(c_out))

    def forward(self, image: Tensor) -> Tensor:
        """Map (b, c_in, h, w) to (b, 4 * planes, h / stride, w / stride)."""
        return torch.relu_(self.layers(image) + self.shortcut(image))


class ResNet(nn.Module):
    """Stem and stages of bottlenecks; the map of every stage comes out.

    Args:
        c_in: Channels of the image.
        depths: Bottlenecks of each stage: 3, 4, 6, 3 is ResNet-50, 3, 4, 23, 3 is ResNeXt-101.
        planes: Planes of the first stage; each further stage doubles them.
        strides: Stride of each stage. A stage after the first with stride 1 dilates its convolutions by 2 instead.
        groups: Groups of the 3 x 3 convolutions.
        group_width: Channels of a group at 64 planes.
        stem_stride: Stride of the 7 x 7 convolution; 2 in the papers, with a pooling layer after it, 1 in RTN, without.
    """

    def __init__(
        self,
        c_in: int,
        *,
        depths: Sequence[int] = (3, 4, 6, 3),
        planes: int = 64,
        strides: Sequence[int] = (1, 2, 2, 2),
        groups: int = 1,
        group_width: int = 64,
        stem_stride: int = 1,
    ) -> None:
        super().__init__()
        self.stem = nn.Sequential(
            nn.Conv2d(c_in, planes, 7, stem_stride, 3, bias=False), nn.BatchNorm2d(planes), nn.ReLU(inplace=True)
        )
        self.stages = nn.ModuleList()
        self.widths: list[int] = []
        self.strides: list[int] = []
        before, reached = planes, stem_stride
        for number, (depth, stride) in enumerate(zip(depths, strides, strict=True)):
            dilation = 2 if number and stride == 1 else 1
            shared = {"groups": groups, "group_width": group_width, "dilation": dilation}
            blocks = [Bottleneck(before, planes, stride=stride, **shared)]
            blocks += [Bottleneck(EXPANSION * planes, planes, **shared) for _ in range(depth - 1)]
            self.stages.append(nn.Sequential(*blocks))
            before, planes, reached = EXPANSION * planes, 2 * planes, reached * stride
            self.widths.append(before)
            self.strides.append(reached)
        self._start()

    def _start(self) -> None:
        """Draw weights after He et al. (ICCV 2015)."""
        for module in self.modules():
            if isinstance(module, nn.Conv2d) and not module.weight.is_meta:
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, image: Tensor) -> list[Tensor]:
        """Map (b, c_in, h, w) to one map a stage, (b, widths[i], h / strides[i], w / strides[i])."""
        image = self.stem(image)
        maps = []
        for stage in self.stages:
            image = stage(image)
            maps.append(image)
        return maps
