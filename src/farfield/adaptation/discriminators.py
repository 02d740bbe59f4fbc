"""Networks that tell the domain of a cell by its features, and their loss. None has a normalisation."""

import itertools
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from farfield.adaptation.cells import Cells, values_at
from farfield.adaptation.reversal import reverse
from farfield.detectors.contract import Network
from farfield.detectors.features import FeatureMap, Features
from farfield.detectors.inputs import Inputs
from farfield.detectors.processes import normaliser, sum_over_processes
from farfield.detectors.sparse.tensor import SparseTensor

Form = Literal["auto", "patch", "rows"]


class PatchDiscriminator(nn.Sequential):
    """A logit for each cell of a map, from a neighbourhood of 5 x 5: more would tell the density of the points.

    Args:
        channels: Features of a cell.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(
            nn.Conv2d(channels, 128, 3, padding=1),
            nn.LeakyReLU(0.2),
            nn.Conv2d(128, 64, 3, padding=1),
            nn.LeakyReLU(0.2),
            nn.Conv2d(64, 1, 1),
        )


class RowDiscriminator(nn.Sequential):
    """A logit for each row of features, from it alone.

    Args:
        channels: Features of a row.
    """

    def __init__(self, channels: int) -> None:
        widths = (channels, 256, 128, 64, 32)
        layers: list[nn.Module] = []
        for c_in, c_out in itertools.pairwise(widths):
            layers += [nn.Linear(c_in, c_out), nn.LeakyReLU(0.2)]
        super().__init__(*layers, nn.Linear(widths[-1], 1))


def discriminator(network: Network, form: Form = "auto") -> nn.Module:
    """A discriminator for the features of a network.

    Args:
        network: The detector's network; with ``"auto"`` it is shown an empty cloud, to see what its features are.
        form: By patches of dense maps, or by rows, which any features have.
    """
    if form == "rows" or (form == "auto" and not _is_dense(network)):
        return RowDiscriminator(network.channels)
    return PatchDiscriminator(network.channels)


@torch.no_grad()
def _is_dense(network: Network) -> bool:
    training, device = network.training, next(network.parameters()).device
    empty = {name: [torch.zeros(0, len(cloud.columns), device=device)] for name, cloud in network.inputs.items()}
    features = network.eval().encode(Inputs(empty))
    network.train(training)
    return isinstance(features, FeatureMap) and isinstance(features.values, Tensor)


def logits_of(judge: nn.Module, features: Features, cells: Cells, strength: float) -> Tensor:
    """The discriminator's logits at cells, shape (n,), float32; the features get their gradient reversed.

    Args:
        judge: The discriminator.
        features: Of the batch.
        cells: Where.
        strength: lambda; 0 leaves the features without a gradient.
    """
    if isinstance(judge, RowDiscriminator):
        logits: Tensor = judge(reverse(values_at(features, cells), strength).to(judge[0].weight.dtype))
        return logits.squeeze(1).float()
    assert isinstance(features, FeatureMap)
    assert not isinstance(features.values, SparseTensor)
    image = judge(reverse(features.values, strength).to(judge[0].weight.dtype))
    return image.reshape(-1)[cells.row].float()  # one channel: (b, 1, nx, ny) lies as (frame * nx + ix) * ny + iy


def domain_loss(
    logits: Tensor,
    domain: Tensor,
    *,
    weight: Tensor | None = None,
    form: Literal["bce", "least_squares"] = "bce",
    smoothing: float = 0.0,
) -> Tensor:
    """How badly a discriminator tells two domains: the mean of each domain's own mean, so ln 2 where it knows nothing.

    That is half of L_g = -[mean over near of log(1 - D) + mean over far of log D] (Wang et al., ICCVW 2019).

    Args:
        logits: Shape (n,).
        domain: 0 or 1 for each, shape (n,), float.
        weight: Weight of each in its domain's mean, shape (n,); 1 if left out.
        form: Binary cross-entropy, or least squares between the logit and -1/2 or 1/2.
        smoothing: Labels are smoothing / 2 and 1 - smoothing / 2.
    """
    target = domain * (1 - smoothing) + smoothing / 2
    if form == "bce":
        error = functional.binary_cross_entropy_with_logits(logits, target, reduction="none")
    else:
        error = (logits - (target - 0.5)).square()
    weight = torch.ones_like(logits) if weight is None else weight
    means = [(error * part).sum() / normaliser(part.sum()) for part in (weight * (1 - domain), weight * domain)]
    return (means[0] + means[1]) / 2


@torch.no_grad()
def balanced_accuracy(logits: Tensor, domain: Tensor) -> Tensor:
    """Mean over both domains of the share of cells that are told right, over all processes; NaN where one has none."""
    right = ((logits > 0).float() == domain).float()
    parts = [part for mask in (1 - domain, domain) for part in ((right * mask).sum(), mask.sum())]
    near, all_near, far, all_far = sum_over_processes(torch.stack(parts))
    return (near / all_near + far / all_far) / 2
