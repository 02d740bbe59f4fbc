"""Batch statistics of a network taken anew on the frames that it is going to learn from, without any gradient."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import torch
from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm

from farfield.detectors.network import Network
from farfield.files.atomic import write_text
from farfield.training.method import Batch

STATISTICS_NAME = "statistics.json"
"""In a run's folder: from how many batches its statistics were taken anew, and the scores before and after."""


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


def keep_reestimated(folder: Path, batches: int, scores: Sequence[float | None]) -> str:
    """Write what taking the statistics anew did, as ``statistics.json``.

    Args:
        folder: The run's.
        batches: How many batches they were taken from.
        scores: Mean AP on held-out frames before and after, neither of them trained a step; None without such frames.

    Returns:
        The same as a sentence.
    """
    before, after = scores
    write_text(folder / STATISTICS_NAME, json.dumps({"batches": batches, "before": before, "after": after}) + "\n")
    said = f"batch statistics taken anew from {batches} batches"
    if before is None or after is None:
        return said
    return f"{said}: {before:.3f} mean AP on held-out frames before, {after:.3f} after"
