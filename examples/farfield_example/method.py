"""A training method of one's own: gradient reversal between two streams (Ganin and Lempitsky, ICML 2015, section 3).

A judge learns to tell source from target by the features of the map's cells; its gradient reaches the network with the
sign turned, so that the features of both become alike. Both streams go through the network in one forward pass.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.losses import normaliser
from farfield.detectors.network import Network
from farfield.training.method import Batch, Method, Stream


class Reversal(torch.autograd.Function):
    """The identity whose gradient is turned round and scaled."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, weight: float) -> Tensor:
        """The values as they are."""
        ctx.weight = weight
        return values.view_as(values)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        """The gradient turned round."""
        return -ctx.weight * gradients[0], None


class GradientReversal(Method):
    """Learn from labelled source frames, and make the features of unlabelled target frames like theirs."""

    streams: ClassVar[Mapping[str, Stream]] = {"source": Stream(), "target": Stream(labelled=False)}

    def __init__(self, network: Network, weight: float = 0.1, cells: int = 4096) -> None:
        self.weight, self.cells = weight, cells
        self.modules = nn.ModuleDict({"detector": network, "judge": nn.Linear(network.channels, 1)})

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Tensor]:
        """The detector's losses on the source, and the judge's on both."""
        network, labelled = cast(Network, self.modules["detector"]), batch["source"]
        features = network.encode(labelled.inputs + batch["target"].inputs)
        source, target = features.split(len(labelled))
        losses = network.losses(network.head(source, labelled.targets), labelled.targets)
        draw = torch.Generator().manual_seed(step)
        for name, part, domain in (("source", source, 0.0), ("target", target, 1.0)):
            rows = part.rows(limit=self.cells, generator=draw).values.float()
            logit = self.modules["judge"](Reversal.apply(rows, self.weight)).squeeze(1)
            error = functional.binary_cross_entropy_with_logits(logit, torch.full_like(logit, domain), reduction="sum")
            losses[f"domain_{name}"] = error / normaliser(logit.new_tensor(float(len(logit))))
        return losses
