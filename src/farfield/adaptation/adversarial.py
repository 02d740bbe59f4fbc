"""Networks that tell the domain of a cell by its features, their loss, and the reversal of its gradient (DANN).

None of them has a normalisation.
"""

import itertools
import math
from typing import Any, Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from farfield.adaptation.cells import Cells, values_at
from farfield.detectors.features import FeatureMap, Features
from farfield.detectors.inputs import Inputs
from farfield.detectors.losses import normaliser, sum_over_processes
from farfield.detectors.network import Network
from farfield.detectors.sparse.cells import SparseTensor
from farfield.training.method import MethodSettings, ParamGroup

Form = Literal["auto", "patch", "rows"]


class Adversarial(MethodSettings):
    """Settings of a discriminator between two domains; all are ours."""

    lambda_max: float = Field(0.1, ge=0, description="strength of the reversed gradient in the end; 0 is the control")
    form: Form = Field("auto", description="patch for dense maps, rows (each cell for itself) for sparse features")
    loss: Literal["bce", "least_squares"] = "bce"
    smoothing: float = Field(0.0, ge=0, lt=1, description="of the domain's labels; 0.1 where it is always right")
    rate: float = Field(0.5, gt=0, description="the discriminator's learning rate over the trunk's")
    clip: float = Field(1.0, gt=0, description="largest norm of the discriminator's own gradient")
    labels: Literal["domain", "coin"] = Field("domain", description="coin: the control, labels by a coin a frame")

    @property
    def param_groups(self) -> dict[str, ParamGroup]:
        """How the module ``discriminator`` is trained."""
        return {"discriminator": ParamGroup(rate=self.rate, clip=self.clip)}


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
    dtype = next(judge.parameters()).dtype
    if isinstance(judge, RowDiscriminator):
        logits: Tensor = judge(reverse(values_at(features, cells), strength).to(dtype))
        return logits.squeeze(1).float()
    assert isinstance(features, FeatureMap)
    assert not isinstance(features.values, SparseTensor)
    image = judge(reverse(features.values, strength).to(dtype))
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
    """Mean over both domains of the share of cells judged right, over all processes; NaN where one has none."""
    right = ((logits > 0).float() == domain).float()
    parts = [part for mask in (1 - domain, domain) for part in ((right * mask).sum(), mask.sum())]
    near, all_near, far, all_far = sum_over_processes(torch.stack(parts))
    return (near / all_near + far / all_far) / 2


def shuffled_domains(domain: Tensor, frame: Tensor, rng: np.random.Generator) -> Tensor:
    """The domains with both exchanged in each frame for which a coin falls so: what a control is trained on."""
    coins = rng.random(int(frame.max()) + 1 if len(frame) else 0) < 0.5
    exchanged = torch.from_numpy(coins).to(frame.device)[frame]
    return torch.where(exchanged, 1 - domain, domain)


class AdversarialLoss:
    """The loss between two domains of a step.

    Args:
        settings: Strength, form and control.
        judge: The discriminator.

    Attributes:
        noted: Figures of the last call: lambda, the discriminator's accuracy on the batch, cells of each domain.
    """

    def __init__(self, settings: Adversarial, judge: nn.Module) -> None:
        self.settings, self.judge = settings, judge
        self.noted: dict[str, Tensor | float] = {}

    def __call__(
        self,
        features: Features,
        cells: Cells,
        domain: Tensor,
        scheduled: float,
        rng: np.random.Generator,
        *,
        weight: Tensor | None = None,
    ) -> Tensor:
        """The loss, whose gradient reaches the features reversed.

        Args:
            features: Of the batch, both domains in it.
            cells: Those that count.
            domain: 0 or 1 for each, shape (n,), float.
            scheduled: The schedule's value at this step; lambda is ``lambda_max`` times it.
            rng: Throws the coins of the control.
            weight: Weight of each cell, shape (n,).
        """
        strength = self.settings.lambda_max * scheduled
        logits = logits_of(self.judge, features, cells, strength)
        self.noted = {"occupied": cells.share}
        return self._loss(logits, domain, cells.frame, strength, rng, weight)

    def between(
        self,
        source: tuple[Features, Cells],
        target: tuple[Features, Cells],
        scheduled: float,
        rng: np.random.Generator,
    ) -> Tensor:
        """The loss between two sets of features, such as of frames that went through the trunk one after the other.

        Args:
            source: Features, and those of their cells that count.
            target: The same.
            scheduled: The schedule's value at this step.
            rng: Throws the coins of the control.
        """
        strength = self.settings.lambda_max * scheduled
        logits = torch.cat([logits_of(self.judge, *domain_cells, strength) for domain_cells in (source, target)])
        domain = torch.ones_like(logits)
        domain[: len(source[1])] = 0.0
        frame = torch.cat([source[1].frame, len(source[0]) + target[1].frame])
        self.noted = {"occupied_source": source[1].share, "occupied_target": target[1].share}
        return self._loss(logits, domain, frame, strength, rng, None)

    def _loss(
        self,
        logits: Tensor,
        domain: Tensor,
        frame: Tensor,
        strength: float,
        rng: np.random.Generator,
        weight: Tensor | None,
    ) -> Tensor:
        settings = self.settings
        truth = domain if settings.labels == "domain" else shuffled_domains(domain, frame, rng)
        self.noted |= {
            "lambda": strength,
            "discriminator_accuracy": balanced_accuracy(logits, truth),
            "cells_of_source": float((domain == 0).sum()),
            "cells_of_target": float((domain == 1).sum()),
        }
        with torch.autocast(logits.device.type, enabled=False):
            return domain_loss(logits, truth, weight=weight, form=settings.loss, smoothing=settings.smoothing)


# Gradient reversal (Ganin et al., JMLR 2016) and its schedule


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
