"""Batch statistics of a network taken anew on the frames that it is going to learn from, without any gradient."""

from collections.abc import Iterable, Mapping

import torch
from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm

from farfield.detectors.contract import Network
from farfield.training.method import Batch


def norms_of(network: nn.Module) -> list[_BatchNorm]:
    """The batch normalisations that keep statistics."""
    return [each for each in network.modules() if isinstance(each, _BatchNorm) and each.track_running_stats]


@torch.no_grad()
def reestimate(network: Network, batches: Iterable[Mapping[str, Batch]]) -> int:
    """Forget the running mean and variance of every batch normalisation and average those of some batches.

    Each batch counts alike (a cumulative average). All parts of the network take part, also those that will be frozen.

    Args:
        network: Is changed: its statistics, nothing else; it is in training mode afterwards.
        batches: Frames of each stream; those of all streams go through the network together, as in a step.

    Returns:
        How many batches there were.
    """
    norms = norms_of(network)
    momenta = [norm.momentum for norm in norms]
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # a cumulative average
    network.train()
    count = 0
    for batch in batches:
        count += 1
        parts = list(batch.values())
        inputs = parts[0].inputs
        for other in parts[1:]:
            inputs = inputs + other.inputs
        labelled = all(len(part.targets) == len(part) for part in parts)
        network(inputs, [target for part in parts for target in part.targets] if labelled else None)
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum
    return count
