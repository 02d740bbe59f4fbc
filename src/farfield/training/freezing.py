"""Parts of a network that stay as they are, for all steps or for the first of them.

A parameter without gradient is not enough: batch normalisation in training mode moves its statistics, and weight decay
shrinks what only has a gradient of zero. Frozen parts are in evaluation mode, and their parameters have no gradient,
which the optimiser passes by.
"""

from collections.abc import Collection, Mapping
from fnmatch import fnmatchcase

from torch import nn

from farfield.errors import ConfigError


def frozen_now(until: Mapping[str, float], step: int, steps: int) -> tuple[str, ...]:
    """The parts that are frozen at a step.

    Args:
        until: Share of the steps until which each part stays.
        step: Number of the step, from 0.
        steps: Of the whole training.
    """
    return tuple(name for name, share in until.items() if share >= 1 or step < round(share * steps))


def frozen_names(network: nn.Module, patterns: Collection[str]) -> set[str]:
    """Names of the parameters that lie in the named parts of a network, or whose name fits a pattern.

    Raises:
        ConfigError: If a part holds no parameter, or all of them would be frozen.
    """
    names = [name for name, _ in network.named_parameters()]
    found: set[str] = set()
    for pattern in patterns:
        found |= within(names, pattern, "training.start.freeze")
    if found and len(found) == len(names):
        raise ConfigError("training.start.freeze: expected some part to train, got every one.")
    return found


def frozen_modules(network: nn.Module, patterns: Collection[str]) -> list[nn.Module]:
    """The modules of the frozen parts, whose batch statistics stay as they are too."""
    frozen = frozen_names(network, patterns)
    found = []
    for name, module in network.named_modules():
        own = [f"{name}.{key}" if name else key for key, _ in module.named_parameters(recurse=False)]
        if any(is_within(name, pattern) for pattern in patterns) or (own and frozen.issuperset(own)):
            found.append(module)
    return found


def hold(network: nn.Module, patterns: Collection[str]) -> None:
    """Freeze these parts: no gradient, evaluation mode; the rest of the network is not touched.

    Raises:
        ConfigError: As :func:`frozen_names`.
    """
    frozen = frozen_names(network, patterns)
    for name, parameter in network.named_parameters():
        if name in frozen:
            parameter.requires_grad_(False)
            parameter.grad = None
    for module in frozen_modules(network, patterns):
        module.training = False


def within(names: Collection[str], pattern: str, where: str) -> set[str]:
    """Those of a network's names that lie in a part or fit a pattern.

    Raises:
        ConfigError: If there is none; it names the setting, ``where``.
    """
    found = {name for name in names if is_within(name, pattern)}
    if not found:
        parts = ", ".join(dict.fromkeys(name.partition(".")[0] for name in names))
        raise ConfigError(f"{where}: {pattern} is no part of the network; its parts are {parts}.")
    return found


def is_within(name: str, pattern: str) -> bool:
    """Whether a tensor or module is a part, lies in it, or fits a pattern."""
    return name == pattern or name.startswith(f"{pattern}.") or fnmatchcase(name, pattern)
