"""The exponential average of weights and statistics that a training scores and exports."""

import copy
from collections.abc import Collection, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from farfield.training.freezing import is_within


def take_over(average: dict[str, Tensor], state: Mapping[str, Tensor]) -> None:
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


def state_of(module: nn.Module, average: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """A module's state with averaged values, in its own number types; ``prefix`` begins their names in the average."""
    return {name: average[prefix + name].to(value.dtype) for name, value in module.state_dict().items()}


def averaged(network: nn.Module, average: Mapping[str, Tensor], prefix: str) -> Any:
    """A copy of a network with averaged weights and statistics, in evaluation mode; ``prefix`` as in `state_of`."""
    copied = copy.deepcopy(network)
    copied.load_state_dict(state_of(network, average, prefix))
    return copied.eval()
