"""ResNet and ResNeXt trunks (He et al., CVPR 2016; Xie et al., CVPR 2017) without a classifier."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

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
