"""Start a training from other weights: tensors are taken by name and shape, rows of classes by the class' name.

What did not match keeps its own first values, and all of it is reported: a file of which little fits must not pass in
silence.
"""

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from farfield.detectors.contract import Network
from farfield.detectors.weights import load_weights, resolve_weights
from farfield.errors import ConfigError

_SHAPELESS = ("score_threshold", "nms_iou", "max_boxes", "far_weight")  # settings that no weight depends on


@dataclass(frozen=True, kw_only=True)
class Start:
    """What a network took of other weights.

    Args:
        weights: Which ones, as asked for.
        sha256: Of their file.
        share: Share of the network's parameters that were taken.
        taken: Names of tensors that were taken whole.
        by_class: Of tensors that were taken by rows of classes, how many rows of how many.
        fresh: Of tensors that were not taken, why.
        unused: Names of tensors of the weights that found no place.
        classes: The network's classes that are ``shared`` with the weights, and those that are ``fresh``.
        settings: Settings in which the two differ, one sentence each.
    """

    weights: str
    sha256: str
    share: float
    taken: Sequence[str]
    by_class: Mapping[str, str]
    fresh: Mapping[str, str]
    unused: Sequence[str]
    classes: Mapping[str, Sequence[str]]
    settings: Sequence[str]

    def to_json(self) -> dict[str, Any]:
        """Everything, as JSON values."""
        return {**asdict(self), "share": round(self.share, 6)}

    def brief(self) -> dict[str, Any]:
        """What travels with the trained weights."""
        return {"weights": self.weights, "sha256": self.sha256, "share": round(self.share, 6)}

    def lines(self) -> Iterator[str]:
        """The same for the user."""
        tensors = len(self.taken) + len(self.by_class) + len(self.fresh)
        yield (
            f"starts from {self.weights}: {100 * self.share:.1f} % of the parameters; of {tensors} tensors "
            f"{len(self.taken)} taken whole, {len(self.by_class)} by class, {len(self.fresh)} fresh, "
            f"{len(self.unused)} of theirs unused"
        )
        groups = [f"{word}: {', '.join(names)}" for word, names in self.classes.items() if names]
        yield f"  classes {'; '.join(groups)}"
        for name, why in [*self.by_class.items(), *self.fresh.items()][:_SHOWN]:
            yield f"  {name}: {why}"
        hidden = len(self.by_class) + len(self.fresh) - _SHOWN
        if hidden > 0:
            yield f"  and {hidden} more in start.json"
        for sentence in self.settings:
            yield f"  setting {sentence}"


_SHOWN = 12
_OTHER = "of other classes"


@torch.no_grad()
def start_network(network: Network, weights: str) -> Start:
    """Give a network what fits of a trained detector's weights.

    A tensor of the same name and shape is taken. Where the classes differ, tensors whose rows belong to classes
    (:meth:`~farfield.detectors.contract.Network.class_rows`) take those of the classes that both know. All others keep
    the values that they have.

    Args:
        network: Is changed.
        weights: A bundled detector's name, a run's folder or a weights file.

    Raises:
        FarfieldError: If there are no such weights.
        ConfigError: If they are another detector's, or nothing fits.
    """
    path = resolve_weights(weights)
    with torch.random.fork_rng(devices=[]):  # what is drawn afterwards does not depend on what was loaded
        trained, _ = load_weights(path)
    _check_kind(network, trained, weights)
    theirs, rows, known = trained.state_dict(), network.class_rows(), trained.class_rows()
    unsaid = _unsaid(network, trained)
    taken, by_class, fresh, count = [], dict[str, str](), dict[str, str](), 0
    parameters = {name for name, _ in network.named_parameters()}
    for name, own in network.state_dict().items():
        other = theirs.get(name)
        if other is None:
            fresh[name] = "fresh: the weights have no such tensor"
            continue
        pairs = _OTHER if name in unsaid else _pairs(rows.get(name), known.get(name), own, other)
        if isinstance(pairs, str):
            fresh[name] = f"fresh: {pairs}"
            continue
        if pairs is None:
            own.copy_(other)
            taken.append(name)
        else:
            axis, here, there = pairs
            own.movedim(axis, 0)[here] = other.movedim(axis, 0)[there].to(own.dtype)
            by_class[name] = f"{len(here)} of {own.shape[axis]} rows, by class"
        whole = 1.0 if pairs is None else len(pairs[1]) / own.shape[pairs[0]]
        count += round(whole * own.numel()) if name in parameters else 0
    share = count / sum(parameter.numel() for parameter in network.parameters())
    if not count:
        raise ConfigError(f"training.start: nothing of {weights} fits; {next(iter(fresh.items()))}.")
    names, others = network.config.class_names, set(trained.config.class_names)
    return Start(
        weights=weights,
        sha256=hashlib.sha256(Path(path).read_bytes()).hexdigest(),
        share=share,
        taken=taken,
        by_class=by_class,
        fresh=fresh,
        unused=sorted(set(theirs) - set(network.state_dict())),
        classes={"shared": [n for n in names if n in others], "fresh": [n for n in names if n not in others]},
        settings=list(_differences(trained.config.model_dump(), network.config.model_dump())),
    )


def _check_kind(network: Network, trained: Network, weights: str) -> None:
    if network.config.name != trained.config.name:
        raise ConfigError(
            f"training.start: {weights} is a {trained.config.name}, the experiment's detector a {network.config.name}. "
            "Choose weights of the same detector."
        )


def _unsaid(network: Network, trained: Network) -> set[str]:
    """Tensors that may be of other classes, where the detector does not say which rows belong to which: its head's.

    Raises:
        ConfigError: If it has no head by that name.
    """
    if network.class_rows() or network.config.class_names == trained.config.class_names:
        return set()
    found = {name for name in network.state_dict() if name.startswith("head.")}
    if not found:
        raise ConfigError(
            f"training.start: the classes differ, and {network.config.name} says neither class_rows() nor has it a "
            "submodule head. Define class_rows() in its network, or keep the weights' classes."
        )
    return found


def _pairs(
    mine: tuple[int, Sequence[Any]] | None, known: tuple[int, Sequence[Any]] | None, own: Tensor, other: Tensor
) -> tuple[int, list[int], list[int]] | str | None:
    """Rows to take and their rows there along an axis; None for the whole tensor, a text for nothing and why."""
    shapes = f"{tuple(other.shape)} there, {tuple(own.shape)} here"
    if mine is None or known is None or list(mine[1]) == list(known[1]):
        return None if own.shape == other.shape else shapes
    (axis, names), (_, others) = mine, known
    rest, rest_there = (tuple(t.shape[:axis] + t.shape[axis + 1 :]) for t in (own, other))
    if rest != rest_there or len(names) != own.shape[axis] or len(others) != other.shape[axis]:
        return shapes
    place = {name: row for row, name in enumerate(others)}
    here = [row for row, name in enumerate(names) if name in place]
    return (axis, here, [place[names[row]] for row in here]) if here else "no class of theirs"


def _differences(theirs: Mapping[str, Any], ours: Mapping[str, Any], where: str = "") -> Iterator[str]:
    """Settings in which two configurations differ, but for those that only choose boxes."""
    for name in dict.fromkeys([*theirs, *ours]):
        old, new, place = theirs.get(name), ours.get(name), f"{where}{name}"
        if isinstance(old, dict) and isinstance(new, dict):
            yield from _differences(old, new, f"{place}.")
        elif old != new and place not in _SHAPELESS:
            yield f"{place}: {old}, now {new}"


def frozen_names(network: nn.Module, patterns: Collection[str]) -> set[str]:
    """Names of the parameters that lie in the named parts of a network, or whose name fits a pattern.

    Raises:
        ConfigError: If a part holds no parameter, or all of them would be frozen.
    """
    names = [name for name, _ in network.named_parameters()]
    found: set[str] = set()
    for pattern in patterns:
        fitting = {name for name in names if _within(name, pattern)}
        if not fitting:
            parts = ", ".join(dict.fromkeys(name.partition(".")[0] for name in names))
            raise ConfigError(f"training.start.freeze: {pattern} is no part of the network; its parts are {parts}.")
        found |= fitting
    if found and len(found) == len(names):
        raise ConfigError("training.start.freeze: expected some part to train, got every one.")
    return found


def frozen_modules(network: nn.Module, patterns: Collection[str]) -> list[nn.Module]:
    """The modules of the frozen parts, whose batch statistics stay as they are too."""
    frozen = frozen_names(network, patterns)
    found = []
    for name, module in network.named_modules():
        own = [f"{name}.{key}" if name else key for key, _ in module.named_parameters(recurse=False)]
        if any(_within(name, pattern) for pattern in patterns) or (own and frozen.issuperset(own)):
            found.append(module)
    return found


def _within(name: str, pattern: str) -> bool:
    return name == pattern or name.startswith(f"{pattern}.") or fnmatchcase(name, pattern)
