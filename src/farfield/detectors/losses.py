"""The losses of SECOND and PointPillars (section 3.4 and equations 1 to 3 there) on sparse targets, and normalisers.

A normaliser sums over the processes of a training, so that several of them compute what one would with the whole batch.
"""

from typing import Any

import torch
from torch import Tensor, distributed
from torch.nn import functional


def at_least_single(values: Tensor) -> Tensor:
    """The values in single precision, or in double where they are so already."""
    return values.to(torch.promote_types(values.dtype, torch.float32))


def focal_loss(
    logits: Tensor,
    positive: Tensor,
    ignored: Tensor,
    *,
    weight: Tensor | None = None,
    alpha: float = 0.25,
    gamma: float = 2.0,
) -> Tensor:
    """Focal loss summed over all anchors (Lin et al. 2017, equation 5).

    Args:
        logits: One logit an anchor, any shape.
        positive: Flat indices of the positive anchors, shape (p,).
        ignored: Flat indices of the anchors that do not count, shape (i,).
        weight: Weight of each positive, shape (p,); 1 if left out.
        alpha: Weight of the positives; the negatives weigh 1 - alpha.
        gamma: Exponent that mutes what is already well classified.

    Returns:
        A scalar, not normalised.
    """
    logit = logits.reshape(-1).float()
    right = logit[positive]
    as_positive = alpha * torch.sigmoid(-right) ** gamma * functional.softplus(-right)
    as_positive = as_positive if weight is None else as_positive * weight
    uncounted = logit[torch.cat([positive, ignored])]
    all_negative, surplus = (_as_negative(x, alpha, gamma).sum() for x in (logit, uncounted))
    return all_negative - surplus + as_positive.sum()


def _as_negative(logits: Tensor, alpha: float, gamma: float) -> Tensor:
    return (1 - alpha) * torch.sigmoid(logits) ** gamma * functional.softplus(logits)


def box_loss(predicted: Tensor, target: Tensor, *, weight: Tensor | None = None, beta: float = 1 / 9) -> Tensor:
    """Smooth L1 over box codes, the heading through the sine of its error; summed, shapes (p, 7), weights (p,)."""
    heading = torch.sin(predicted[:, 6:] - target[:, 6:])
    error = torch.cat([predicted[:, :6] - target[:, :6], heading], 1)
    loss = functional.smooth_l1_loss(error, torch.zeros_like(error), beta=beta, reduction="none").sum(1)
    return (loss if weight is None else loss * weight).sum()


def direction_loss(logits: Tensor, backwards: Tensor, *, weight: Tensor | None = None) -> Tensor:
    """Cross-entropy between along and against the anchor's heading; summed, shapes (p, 2), (p,) and weights (p,)."""
    loss = functional.cross_entropy(logits, backwards, reduction="none")
    return (loss if weight is None else loss * weight).sum()


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
