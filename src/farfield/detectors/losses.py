"""The losses of SECOND and PointPillars (section 3.4 and equations 1 to 3 there), on sparse targets."""

import torch
from torch import Tensor
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
    flat = logits.reshape(-1).float()
    right = flat[positive]
    as_positive = alpha * torch.sigmoid(-right) ** gamma * functional.softplus(-right)
    as_positive = as_positive if weight is None else as_positive * weight
    uncounted = flat[torch.cat([positive, ignored])]
    every, surplus = (_as_negative(x, alpha, gamma).sum() for x in (flat, uncounted))
    return every - surplus + as_positive.sum()


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
