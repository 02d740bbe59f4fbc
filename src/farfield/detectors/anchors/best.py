"""Which anchors are decoded: the same ones on every device, in the same order, however many scores are equal."""

import math

import torch
from torch import Tensor

_MANY = 8  # times the limit: from there on the least score that can be among the best is found first


def logit(score: float) -> float:
    """The logit of a score; infinite for 0 and 1."""
    if not 0 < score < 1:
        return -math.inf if score <= 0 else math.inf
    return math.log(score / (1 - score))


def best_anchors(logits: Tensor, *, limit: int, score_threshold: float) -> tuple[Tensor, Tensor]:
    """The anchors of the highest scores, best first, of equal ones the first.

    Args:
        logits: Logit of each anchor, shape (n,), or of each of its classes, of which the highest counts, (n, classes).
        limit: So many at most.
        score_threshold: Of a lower score none.

    Returns:
        Their numbers, shape (k,), int64, and their scores, shape (k,), float64.
    """
    strength, least = logits.float() if logits.ndim == 1 else logits.float().amax(1), logit(score_threshold)
    index = (strength >= least).nonzero().squeeze(1)
    if len(index) > _MANY * limit:
        index = (strength >= torch.topk(strength, limit).values[-1]).nonzero().squeeze(1)
    order = torch.sort(strength[index], descending=True, stable=True).indices[:limit]
    index = index[order]
    return index, torch.sigmoid(strength[index].double())
