"""The two-dimensional backbone of PointPillars and SECOND: strided blocks, then all of them at one resolution."""

import torch
from torch import Tensor, nn


def conv_norm_relu(c_in: int, c_out: int, *, stride: int = 1) -> nn.Sequential:
    """3 x 3 convolution, batch normalisation and ReLU."""
    return nn.Sequential(
        nn.Conv2d(c_in, c_out, 3, stride=stride, padding=1, bias=False),
        nn.BatchNorm2d(c_out, eps=1e-3, momentum=0.1),
        nn.ReLU(inplace=True),
    )


class BevBackbone(nn.Module):
    """Blocks of convolutions, each at twice the stride of the one before, brought to a common stride and concatenated.

    Args:
        c_in: Channels of the pillar image.
        widths: Channels of each block.
        depths: 3 x 3 convolutions of each block after its strided one.
        strides: Stride of each block's first convolution.
        out_stride: Stride of the output relative to the input.
        neck_width: Channels that each block contributes to the output.
    """

    def __init__(
        self,
        c_in: int,
        *,
        widths: tuple[int, ...],
        depths: tuple[int, ...],
        strides: tuple[int, ...],
        out_stride: int,
        neck_width: int,
    ) -> None:
        super().__init__()
        self.blocks, self.necks = nn.ModuleList(), nn.ModuleList()
        stride = 1
        for width, depth, step in zip(widths, depths, strides, strict=True):
            layers = [conv_norm_relu(c_in, width, stride=step)]
            layers += [conv_norm_relu(width, width) for _ in range(depth)]
            self.blocks.append(nn.Sequential(*layers))
            stride *= step
            self.necks.append(_neck(width, neck_width, stride, out_stride))
            c_in = width
        self.channels = neck_width * len(widths)

    def forward(self, image: Tensor) -> Tensor:
        """Map (b, c_in, h, w) to (b, channels, h / out_stride, w / out_stride)."""
        outputs = []
        for block, neck in zip(self.blocks, self.necks, strict=True):
            image = block(image)
            outputs.append(neck(image))
        return torch.cat(outputs, 1)


def _neck(width: int, neck_width: int, stride: int, out_stride: int) -> nn.Sequential:
    """Bring a block from its stride to the output's: transposed, plain or strided convolution without overlap."""
    if stride >= out_stride:
        factor = stride // out_stride
        layer: nn.Module = nn.ConvTranspose2d(width, neck_width, factor, stride=factor, bias=False)
    else:
        factor = out_stride // stride
        layer = nn.Conv2d(width, neck_width, factor, stride=factor, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(neck_width, eps=1e-3, momentum=0.1), nn.ReLU(inplace=True))
