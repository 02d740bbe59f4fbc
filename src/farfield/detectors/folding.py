"""Fold batch normalisation into the layer before it: the same function, one pass less over every feature map."""

import copy

import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from farfield.detectors.norm import affine
from farfield.detectors.upsampling import Upsampling

_CONVOLUTIONS = (nn.Conv1d, nn.Conv2d, nn.Conv3d, nn.ConvTranspose2d)
_NORMS = (nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d)


def fold_batch_norm(model: nn.Module) -> nn.Module:
    """Return an evaluation-mode copy in which every (convolution or linear layer, batch norm) pair is one layer.

    Adjacent pairs inside ``nn.Sequential`` count, and whatever a module with a method ``fold_norm`` folds by itself. A
    transposed convolution in such a pair becomes an ordinary one where that can express it.
    """
    folded = copy.deepcopy(model).eval()
    for module in list(folded.modules()):
        if isinstance(module, nn.Sequential):
            _fold_sequence(module)
        elif hasattr(module, "fold_norm"):
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
