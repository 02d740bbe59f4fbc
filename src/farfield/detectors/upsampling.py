"""Transposed convolution as an ordinary one, which libraries compute several times as fast in bfloat16 on a CPU."""

import math

import torch
from torch import Tensor, nn


class Upsampling(nn.Module):
    """The function of ``nn.ConvTranspose2d`` whose kernel is one or three times its stride.

    Each input cell becomes a patch of stride x stride output cells. With a kernel of three strides and a padding of one
    (in input cells), a patch depends on the 3 x 3 cells around its own: an ordinary 3 x 3 convolution gives all the
    patch's values as channels, ordered (row, column, channel), and they are then laid out.

    Args:
        c_in: Input channels.
        c_out: Output channels.
        stride: Output cells along each side of an input cell.
        overlap: A kernel of three strides, otherwise of one.
    """

    def __init__(self, c_in: int, c_out: int, stride: int, *, overlap: bool) -> None:
        super().__init__()
        reach = 3 if overlap else 1
        self.c_out, self.stride = c_out, stride
        self.conv = nn.Conv2d(c_in, c_out * stride**2, reach, padding=reach // 2, bias=False)
        bound = 1 / math.sqrt(c_out * (reach * stride) ** 2)  # as nn.ConvTranspose2d draws its weights
        if not self.conv.weight.is_meta:
            nn.init.uniform_(self.conv.weight, -bound, bound)

    @classmethod
    def of(cls, layer: nn.ConvTranspose2d) -> "Upsampling":
        """The same function as a transposed convolution that :meth:`fits`."""
        stride, reach = layer.stride[0], layer.kernel_size[0] // layer.stride[0]
        made = cls(layer.in_channels, layer.out_channels, stride, overlap=reach == 3)
        # input cell i reaches output cell stride * (i - padding) + k: kernel element k = stride * (reach - 1 - d) + row
        parts = layer.weight.detach().unflatten(3, (reach, stride)).unflatten(2, (reach, stride)).flip(2, 4)
        made.conv.weight = nn.Parameter(parts.permute(3, 5, 1, 0, 2, 4).flatten(0, 2).contiguous())
        if layer.bias is not None:
            made.conv.bias = nn.Parameter(layer.bias.detach().repeat(stride**2))
        return made.to(layer.weight.device)

    @staticmethod
    def fits(layer: nn.Module) -> bool:
        """Whether :meth:`of` can express a layer."""
        if not isinstance(layer, nn.ConvTranspose2d) or layer.groups != 1 or layer.stride[0] != layer.stride[1]:
            return False
        stride = layer.stride[0]
        plain = layer.dilation == (1, 1) and layer.output_padding == (0, 0)
        shapes = ((stride,) * 2, (0, 0)), ((3 * stride,) * 2, (stride,) * 2)
        return plain and (layer.kernel_size, layer.padding) in shapes

    def forward(self, image: Tensor) -> Tensor:
        """Map (b, c_in, nx, ny) to (b, c_out, stride * nx, stride * ny)."""
        patches = self.conv(image)
        if self.stride == 1:
            return patches
        rows = patches.permute(0, 2, 3, 1).unflatten(3, (self.stride, self.stride, self.c_out))
        return rows.transpose(2, 3).flatten(3, 4).flatten(1, 2).permute(0, 3, 1, 2)

    def fold(self, scale: Tensor, shift: Tensor) -> None:
        """Multiply every output channel by a scale and add a shift, shapes (c_out,)."""
        scale, shift = scale.repeat(self.stride**2), shift.repeat(self.stride**2)
        with torch.no_grad():
            if self.conv.bias is not None:
                shift = shift + self.conv.bias * scale
            self.conv.bias = nn.Parameter(shift)
            self.conv.weight.mul_(scale[:, None, None, None])
