"""Sums over the processes of a training, so that several of them compute what one would with the whole batch."""

from typing import Any

import torch
from torch import Tensor, distributed


def process_count() -> int:
    """Processes that train together; 1 without torch.distributed."""
    return distributed.get_world_size() if distributed.is_available() and distributed.is_initialized() else 1


def sum_over_processes(values: Tensor) -> Tensor:
    """Sum of a tensor over all processes, differentiable; all of them must call it with the same shape.

    The gradient is that of the sum of what the processes minimise.
    """
    return values if process_count() == 1 else _Sum.apply(values)


def normaliser(weight: Tensor, *, least: float = 1.0) -> Tensor:
    """What a summed loss is divided by: the total weight in the batch, at least ``least``.

    With several processes it is the total over all of them, over their number. The mean of the processes' gradients,
    which is what training takes, is then the gradient of one process with the whole batch.

    Args:
        weight: Weight, or number, of what counts in this process' part of the batch; a scalar, or one a class.
        least: Smallest total.
    """
    return sum_over_processes(weight.detach().float()).clamp(min=least) / process_count()


class _Sum(torch.autograd.Function):
    """All-reduce forward and backward."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        """Sum the values."""
        del ctx
        total = values.contiguous().clone()
        distributed.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        """Sum the gradients: each process' loss depends on every process' values."""
        del ctx
        total = gradients[0].contiguous().clone()
        distributed.all_reduce(total)
        return total
