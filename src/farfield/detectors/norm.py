"""Batch normalisation of rows whose number varies: points, pillars, voxels. A frame may have one of them, or none."""

import torch
from torch import Tensor, nn


def normalise_rows(norm: nn.Module, features: Tensor) -> Tensor:
    """Normalise rows, shape (n, c); with fewer than two of them by the running statistics, in training too.

    One row has no spread, so ``nn.BatchNorm1d`` refuses it in training.
    """
    if isinstance(norm, nn.BatchNorm1d) and len(features) < 2:
        scale, shift = affine(norm)
        return (features * scale + shift).to(features.dtype)
    normalised: Tensor = norm(features)
    return normalised


def affine(norm: nn.Module) -> tuple[Tensor, Tensor]:
    """Scale and shift, shape (c,) each, of a batch normalisation in evaluation mode."""
    scale = torch.rsqrt(norm.running_var + norm.eps)
    if norm.weight is not None:
        scale = scale * norm.weight
    shift = -norm.running_mean * scale
    return scale, shift if norm.bias is None else shift + norm.bias
