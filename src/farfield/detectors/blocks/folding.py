"""Fold batch normalisation into the layer before it: the same function, one pass less over every feature map."""

import copy

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from farfield.detectors.blocks.pillars import PillarEncoder


def fold_batch_norm(model: nn.Module) -> nn.Module:
    """Return an evaluation-mode copy in which every (convolution, batch norm) pair is one convolution.

    Linear layers of :class:`PillarEncoder` are folded too. Only adjacent pairs inside ``nn.Sequential`` count.
    """
    folded = copy.deepcopy(model).eval()
    for module in list(folded.modules()):
        if isinstance(module, nn.Sequential):
            _fold_sequence(module)
        elif isinstance(module, PillarEncoder) and isinstance(module.norm, nn.BatchNorm1d):
            module.linear, module.norm = _fold_linear(module.linear, module.norm), nn.Identity()
    return folded


def _fold_sequence(sequence: nn.Sequential) -> None:
    for index in range(len(sequence) - 1):
        first, second = sequence[index], sequence[index + 1]
        if isinstance(second, nn.BatchNorm2d) and isinstance(first, nn.Conv2d | nn.ConvTranspose2d):
            transpose = isinstance(first, nn.ConvTranspose2d)
            sequence[index] = fuse_conv_bn_eval(first, second, transpose=transpose)
            sequence[index + 1] = nn.Identity()


def _fold_linear(linear: nn.Linear, norm: nn.BatchNorm1d) -> nn.Linear:
    scale: Tensor = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    folded = nn.Linear(linear.in_features, linear.out_features)
    with torch.no_grad():
        folded.weight.copy_(linear.weight * scale[:, None])
        folded.bias.copy_(norm.bias - norm.running_mean * scale)
    return folded
