"""Gradient reversal (Ganin et al., JMLR 2016, "Domain-adversarial training of neural networks") and its schedule."""

import math
from typing import Any

import torch
from torch import Tensor


class _Reversal(torch.autograd.Function):
    """The identity whose gradient is turned round and scaled."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, strength: float) -> Tensor:
        """The values as they are."""
        ctx.strength = strength
        return values.view_as(values)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        """The gradient times minus the strength."""
        return -ctx.strength * gradients[0], None


def reverse(values: Tensor, strength: float) -> Tensor:
    """The values, with a gradient of minus ``strength`` times what it would be.

    With a strength of 0 they are cut off, so that whatever is computed of them leaves no trace, not of rounding either,
    in what they were computed from. Stands between trunk and discriminator, never behind the loss.

    Args:
        values: Features.
        strength: lambda, at least 0.
    """
    reversed_values: Tensor = _Reversal.apply(values, strength) if strength else values.detach()
    return reversed_values


def schedule(progress: float) -> float:
    """DANN's schedule from 0 to nearly 1: 2 / (1 + exp(-10 p)) - 1.

    Args:
        progress: Share of the training that is done, p.

    >>> [round(schedule(p), 3) for p in (0.0, 0.1, 0.5, 1.0)]
    [0.0, 0.462, 0.987, 1.0]
    """
    return 2.0 / (1.0 + math.exp(-10.0 * progress)) - 1.0
