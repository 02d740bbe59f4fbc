"""Layers that several detectors share, and the folding of their batch normalisation for inference.

Normalisation of rows whose number varies (points, pillars, voxels: a frame may have one of them, or none), transposed
convolution as an ordinary one, folding, and the two-dimensional backbone of PointPillars and SECOND.
"""

import copy
import math
from typing import Protocol, TypeGuard, TypeVar, runtime_checkable

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

AnyModule = TypeVar("AnyModule", bound=nn.Module)

OPENPCDET_MOMENTUM = 0.01
"""Of batch normalisation, as OpenPCDet trains."""


def normalise_rows(norm: nn.Module, features: Tensor) -> Tensor:
    """Normalise rows, shape (n, c); with fewer than two of them by the running statistics, in training too.

    One row has no spread, so ``nn.BatchNorm1d`` refuses it in training.
    """
    if isinstance(norm, nn.BatchNorm1d) and len(features) < 2:
        scale, shift = affine(norm)
        return (features * scale + shift).to(features.dtype)
    normalised: Tensor = norm(features)
    return normalised


def affine(norm: nn.BatchNorm1d | nn.BatchNorm2d | nn.BatchNorm3d) -> tuple[Tensor, Tensor]:
    """Scale and shift, shape (c,) each, of a batch normalisation in evaluation mode."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = torch.rsqrt(norm.running_var + norm.eps)
    if norm.weight is not None:
        scale = scale * norm.weight
    shift = -norm.running_mean * scale
    return scale, shift if norm.bias is None else shift + norm.bias


def use_openpcdet_momentum(network: nn.Module) -> None:
    """Let running statistics move as slowly as OpenPCDet's: of use for further training only."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            module.momentum = OPENPCDET_MOMENTUM


# Transposed convolution as an ordinary one, which libraries compute several times as fast in bfloat16 on a CPU.


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
        width = 3 if overlap else 1
        self.c_out, self.stride = c_out, stride
        self.conv = nn.Conv2d(c_in, c_out * stride**2, width, padding=width // 2, bias=False)
        bound = 1 / math.sqrt(c_out * (width * stride) ** 2)  # as nn.ConvTranspose2d draws its weights
        if not self.conv.weight.is_meta:
            nn.init.uniform_(self.conv.weight, -bound, bound)

    @classmethod
    def of(cls, layer: nn.ConvTranspose2d) -> "Upsampling":
        """The same function as a transposed convolution that :meth:`fits`."""
        stride = layer.stride[0]
        overlap = layer.kernel_size[0] == 3 * stride
        upsampling = cls(layer.in_channels, layer.out_channels, stride, overlap=overlap)
        upsampling.conv.weight = nn.Parameter(cls.kernel_of(layer.weight.detach(), stride))
        if layer.bias is not None:
            upsampling.conv.bias = nn.Parameter(layer.bias.detach().repeat(stride**2))
        return upsampling.to(layer.weight.device)

    @staticmethod
    def kernel_of(kernel: Tensor, stride: int) -> Tensor:
        """The convolution's kernel, (c_out * stride^2, c_in, w, w), of a transposed one's, (c_in, c_out, k, k).

        Args:
            kernel: Its sides are ``stride`` or three times as long.
            stride: Of the transposed convolution.
        """
        width = kernel.shape[2] // stride
        # input cell i reaches output cell stride * (i - padding) + k: kernel element k = stride * (reach - 1 - d) + row
        parts = kernel.unflatten(3, (width, stride)).unflatten(2, (width, stride)).flip(2, 4)
        return parts.permute(3, 5, 1, 0, 2, 4).flatten(0, 2).contiguous()

    @staticmethod
    def fits(layer: nn.Module) -> TypeGuard[nn.ConvTranspose2d]:
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


# Fold batch normalisation into the layer before it: the same function, one pass less over every feature map.

_CONVOLUTIONS = (nn.Conv1d, nn.Conv2d, nn.Conv3d, nn.ConvTranspose2d)
_NORMS = (nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d)


@runtime_checkable
class Foldable(Protocol):
    """A module that folds its normalisation by itself."""

    def fold_norm(self) -> None:
        """Fold each normalisation into the layer before it, in place."""


def fold_batch_norm(model: AnyModule) -> AnyModule:
    """Return an evaluation-mode copy in which every (convolution or linear layer, batch norm) pair is one layer.

    Adjacent pairs inside ``nn.Sequential`` count, and whatever a module with a method ``fold_norm`` folds by itself. A
    transposed convolution in such a pair becomes an ordinary one where that can express it.
    """
    folded = copy.deepcopy(model).eval()
    for module in list(folded.modules()):
        if isinstance(module, nn.Sequential):
            _fold_sequence(module)
        elif isinstance(module, Foldable):
            module.fold_norm()
    return folded


def _fold_sequence(sequence: nn.Sequential) -> None:
    for index in range(len(sequence) - 1):
        first, second = sequence[index], sequence[index + 1]
        if not isinstance(second, _NORMS):
            continue
        if isinstance(first, Upsampling) or Upsampling.fits(first):
            sequence[index] = upsampling = first if isinstance(first, Upsampling) else Upsampling.of(first)
            upsampling.fold(*affine(second))
        elif isinstance(first, _CONVOLUTIONS):
            transpose = isinstance(first, nn.ConvTranspose2d)
            sequence[index] = fuse_conv_bn_eval(first, second, transpose=transpose)
        elif isinstance(first, nn.Linear) and isinstance(second, nn.BatchNorm1d):
            sequence[index] = fold_linear(first, second)
        else:
            continue
        sequence[index + 1] = nn.Identity()


def fold_linear(linear: nn.Linear, norm: nn.BatchNorm1d) -> nn.Linear:
    """One linear layer that does what a linear layer and its normalisation do in evaluation mode."""
    scale, shift = affine(norm)
    folded = nn.Linear(linear.in_features, linear.out_features)
    with torch.no_grad():
        folded.weight.copy_(linear.weight * scale[:, None])
        folded.bias.copy_(shift if linear.bias is None else shift + linear.bias * scale)
    return folded


# The two-dimensional backbone of PointPillars and SECOND: strided blocks, then all of them at one resolution.


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
