"""What tells whether an adaptation does what it should: gradients at the shared features, and a fresh linear probe."""

import math
from collections.abc import Iterable, Mapping, Sequence

import torch
from torch import Tensor
from torch.nn import functional

from farfield.detectors.features import Features, PointFeatures
from farfield.detectors.losses import sum_over_processes
from farfield.detectors.sparse.cells import SparseTensor

_PROBE_STEPS, _PROBE_RATE, _PROBE_DECAY = 200, 0.05, 1e-3


def total(losses: Iterable[Tensor]) -> Tensor:
    """The sum of some losses, at least one."""
    first, *others = losses
    return sum(others, start=first)


def shared_values(features: Features) -> Tensor:
    """The tensor of features that heads and discriminators share."""
    if isinstance(features, PointFeatures):
        return features.values
    return features.values.features if isinstance(features.values, SparseTensor) else features.values


def gradient_norms(losses: Mapping[str, Tensor], features: Sequence[Features]) -> dict[str, float]:
    """Norm of each loss' gradient at the shared features, over all processes; the training's own stay as they are.

    Behind a gradient reversal the norm is lambda times that of the discriminator's gradient. A loss that does not reach
    the features has 0.

    Args:
        losses: By name.
        features: Those that the losses were computed from, of one forward or of several.

    Returns:
        ``gradient_<name>`` of each.
    """
    values = [value for each in features if (value := shared_values(each)).requires_grad]
    found = {}
    for name, loss in losses.items():
        parts: Sequence[Tensor | None] = [None]
        if values and loss.requires_grad:
            with torch.autocast(loss.device.type, enabled=False):
                parts = torch.autograd.grad(loss, values, retain_graph=True, allow_unused=True)
        squares = sum(float(part.detach().float().square().sum()) for part in parts if part is not None)
        shared = sum_over_processes(torch.tensor(squares, dtype=torch.float64, device=loss.device))
        found[f"gradient_{name}"] = math.sqrt(float(shared))
    return found


def gradient_ratio(norms: Mapping[str, float], detection: str = "detection") -> float:
    """How hard the hardest other loss pulls over the detection's; NaN where that does not pull.

    Args:
        norms: What :func:`gradient_norms` gave.
        detection: Name of the detection's loss.
    """
    own = norms[f"gradient_{detection}"]
    others = [value for name, value in norms.items() if name != f"gradient_{detection}"]
    return max(others, default=math.nan) / own if own > 0 else math.nan


def probe_accuracy(one: Sequence[Tensor], other: Sequence[Tensor]) -> float:
    """Balanced accuracy of a fresh linear probe that tells two domains by their features.

    It learns on every second frame of each domain and is asked on the rest: logistic regression on standardised
    features, 200 full steps of Adam. A discriminator at 0.5 may be weak; where this too is at 0.5, a linear view tells
    nothing. ``2 (1 - 2 (1 - accuracy))`` is the proxy A-distance (Ben-David et al. 2010).

    Args:
        one: Features of each frame of a domain, shapes (n, c).
        other: Those of the other one.

    Returns:
        From 0 to 1; NaN with fewer than two frames with features in a domain.
    """
    domains = [[rows.detach().float() for rows in each if len(rows)] for each in (one, other)]
    if min(map(len, domains)) < 2:
        return math.nan
    learn, ask = ([torch.cat(each[part::2]) for each in domains] for part in (0, 1))
    mean = torch.cat(learn).mean(0)
    scale = torch.cat(learn).std(0).clamp(min=1e-6)
    learn, ask = ([(rows - mean) / scale for rows in each] for each in (learn, ask))
    weight, bias = fitted_probe(learn[0], learn[1])
    with torch.no_grad():
        shares = [float(((rows @ weight + bias > 0) == bool(domain)).float().mean()) for domain, rows in enumerate(ask)]
    return sum(shares) / 2


@torch.enable_grad()
def fitted_probe(one: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """Weight (c,) and bias of a logistic regression whose logit is positive for ``other``; both domains weigh alike."""
    weight = torch.zeros(one.shape[1], device=one.device, requires_grad=True)
    bias = torch.zeros((), device=one.device, requires_grad=True)
    optimiser = torch.optim.Adam([weight, bias], lr=_PROBE_RATE)
    for _ in range(_PROBE_STEPS):
        optimiser.zero_grad()
        wrong = [functional.softplus(sign * (rows @ weight + bias)).mean() for sign, rows in ((1, one), (-1, other))]
        (wrong[0] + wrong[1] + _PROBE_DECAY * weight.square().sum()).backward()
        optimiser.step()
    return weight.detach(), bias.detach()
