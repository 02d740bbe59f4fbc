"""Which parts of a network learn, and how fast: learning rates by part, frozen parts, the optimiser's groups.

A parameter without gradient is not enough to freeze it: batch normalisation in training mode moves its statistics, and
weight decay shrinks what only has a gradient of zero. Frozen parts are in evaluation mode, and their parameters have no
gradient, which the optimiser passes by.
"""

import math
from collections.abc import Collection, Mapping
from fnmatch import fnmatchcase
from typing import Any

import torch
from torch import nn

from farfield.errors import ConfigError
from farfield.training.config import StartConfig, TrainingConfig
from farfield.vocabulary.counts import count_of


def rates_of(network: nn.Module, start: StartConfig | None) -> dict[str, float]:
    """The rate of each parameter over the training's, by name; the longest name or pattern that fits counts.

    With ``layer_decay`` the parts in the order in which the network has them, first to last, learn at
    ``decay ** (number of parts after it)``.

    Raises:
        ConfigError: If a name or pattern fits no parameter.
    """
    names = [name for name, _ in network.named_parameters()]
    rates = dict.fromkeys(names, 1.0)
    for pattern, rate in sorted(_said(network, start).items(), key=lambda pair: len(pair[0])):
        for name in within(names, pattern, "training.start.rates"):
            rates[name] = rate
    return rates


def _said(network: nn.Module, start: StartConfig | None) -> Mapping[str, float]:
    if start is None:
        return {}
    if start.layer_decay is None:
        return start.rates
    parts = [name for name, part in network.named_children() if any(True for _ in part.parameters())]
    if len(parts) < 2:
        raise ConfigError(f"training.start.layer_decay: expected a network of several parts, got {', '.join(parts)}.")
    return {name: start.layer_decay ** (len(parts) - 1 - number) for number, name in enumerate(parts)}


def always_frozen(network: nn.Module, start: StartConfig | None) -> set[str]:
    """Names of the parameters that no step trains: they stay out of the optimiser."""
    until = {} if start is None else start.frozen_until
    return frozen_names(network, frozen_now(until, 1, 1))


def groups_of(
    trained: list[nn.Parameter], rates: Mapping[int, float], *, weight_decay: float, rate: float = 1.0
) -> list[dict[str, Any]]:
    """An optimiser's groups: by rate, and within each those with weight decay and those (norms, biases) without.

    Args:
        trained: The parameters.
        rates: Rates of parameters, by ``id``, where they are not 1.
        weight_decay: Of the matrices and kernels.
        rate: Multiplies them all.
    """
    groups: list[dict[str, Any]] = []
    for own in sorted({rates.get(id(parameter), 1.0) for parameter in trained} or {1.0}):
        chosen = [parameter for parameter in trained if rates.get(id(parameter), 1.0) == own]
        groups += [
            {"params": [p for p in chosen if p.ndim > 1], "weight_decay": weight_decay, "rate": rate * own},
            {"params": [p for p in chosen if p.ndim <= 1], "weight_decay": 0.0, "rate": rate * own},
        ]
    return groups


def set_rates(optimizer: torch.optim.Optimizer, peak_now: float | int) -> None:
    """Give each group the schedule's rate of this step times its own."""
    for group in optimizer.param_groups:
        group["lr"] = peak_now * group.get("rate", 1.0)


def describe_parts(network: nn.Module, config: TrainingConfig) -> list[str]:
    """A line for each part of the network: its parameters, its rate, and until which step it is frozen."""
    start = config.start
    rates, until = rates_of(network, start), {} if start is None else start.frozen_until
    frozen = {name: round(share * config.steps) for name, share in until.items()}
    lines, names = [], [name for name, _ in network.named_parameters()]
    held = {pattern: within(names, pattern, "training.start.freeze") for pattern in frozen}
    for part in dict.fromkeys(name.partition(".")[0] for name in names):
        own = [(name, p) for name, p in network.named_parameters() if name.partition(".")[0] == part]
        kinds: dict[tuple[float, int], list[int]] = {}
        for name, parameter in own:
            last = max((frozen[pattern] for pattern, inside in held.items() if name in inside), default=0)
            kinds.setdefault((rates[name], last), []).append(parameter.numel())
        for (rate, last), sizes in kinds.items():
            if last >= config.steps:
                description = "frozen, not in the optimiser"
            else:
                description = f"rate {rate * config.learning_rate:g} at its peak"
                description += f", frozen for the first {last} of {count_of(config.steps, 'step')}" if last else ""
            lines.append(f"{part}: {len(sizes)} tensors, {sum(sizes)} parameters, {description}")
    return lines


def one_cycle(step: int, config: TrainingConfig) -> float:
    """Learning rate at a step: a cosine up over the warm-up, a cosine down to nearly nothing (Smith 2018)."""
    peak, rise = config.learning_rate, max(1.0, config.warmup * config.steps)
    if step < rise:
        return peak * (0.1 + 0.9 * (1 - math.cos(math.pi * step / rise)) / 2)
    return peak * (1e-3 + (1 - 1e-3) * (1 + math.cos(math.pi * (step - rise) / max(1.0, config.steps - rise))) / 2)


# Frozen parts, for all steps or for the first of them


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
    frozen: set[str] = set()
    for pattern in patterns:
        frozen |= within(names, pattern, "training.start.freeze")
    if frozen and len(frozen) == len(names):
        raise ConfigError("training.start.freeze: expected some part to train, got every one.")
    return frozen


def frozen_modules(network: nn.Module, patterns: Collection[str]) -> list[nn.Module]:
    """The modules of the frozen parts, whose batch statistics stay as they are too."""
    frozen = frozen_names(network, patterns)
    modules = []
    for name, module in network.named_modules():
        own = [f"{name}.{key}" if name else key for key, _ in module.named_parameters(recurse=False)]
        if any(is_within(name, pattern) for pattern in patterns) or (own and frozen.issuperset(own)):
            modules.append(module)
    return modules


def freeze(network: nn.Module, patterns: Collection[str]) -> None:
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
    inside = {name for name in names if is_within(name, pattern)}
    if not inside:
        parts = ", ".join(dict.fromkeys(name.partition(".")[0] for name in names))
        raise ConfigError(f"{where}: {pattern} is no part of the network; its parts are {parts}.")
    return inside


def is_within(name: str, pattern: str) -> bool:
    """Whether a tensor or module is a part, lies in it, or fits a pattern."""
    return name == pattern or name.startswith(f"{pattern}.") or fnmatchcase(name, pattern)
