"""Averages: of weights and statistics over the steps, which a training exports; of batch statistics over batches."""

import copy
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from farfield.detectors.network import Network
from farfield.files.atomic import write_text
from farfield.training.method import Batch
from farfield.training.param_groups import is_within


def copy_state(average: dict[str, Tensor], state: Mapping[str, Tensor]) -> None:
    """Set each averaged tensor to the one of its name."""
    for name, value in average.items():
        value.copy_(state[name])


def follow(
    average: dict[str, Tensor], state: Mapping[str, Tensor], *, step: int, decay: float, frozen: Collection[str]
) -> None:
    """Draw the average to a state: closely at first, slowly later.

    Args:
        average: By name, in float32.
        state: What it follows, by the same names.
        step: Steps taken.
        decay: Share that the average keeps in a late step.
        frozen: Parts of the network that are held, and are taken over as they are.
    """
    decay = min(decay, (1 + step) / (10 + step))
    with torch.no_grad():
        for name, value in state.items():
            if any(is_within(name, part) for part in frozen):
                average[name].copy_(value)
                continue
            average[name].lerp_(value.to(average[name].device, torch.float32), 1 - decay)


def state_of(module: nn.Module, average: Mapping[str, Tensor], name: str) -> dict[str, Tensor]:
    """The state of the module ``name`` with its values in the average, in its own number types."""
    return {key: average[f"{name}.{key}"].to(value.dtype) for key, value in module.state_dict().items()}


def averaged(network: Network, average: Mapping[str, Tensor], name: str) -> Network:
    """A copy of a network, the module ``name``, with averaged weights and statistics, in evaluation mode."""
    copied = copy.deepcopy(network)
    copied.load_state_dict(state_of(network, average, name))
    return copied.eval()


# Batch statistics taken anew on the frames that are going to be learnt from, without any gradient

STATISTICS_NAME = "statistics.json"
"""In a run's folder: from how many batches its statistics were taken anew, and the scores before and after."""


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
    norms = [norm for norm in network.modules() if isinstance(norm, _BatchNorm) and norm.track_running_stats]
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


def save_reestimated(folder: Path, batches: int, scores: Sequence[float | None]) -> str:
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
    sentence = f"batch statistics taken anew from {batches} batches"
    if before is None or after is None:
        return sentence
    return f"{sentence}: {before:.3f} mean AP on held-out frames before, {after:.3f} after"
