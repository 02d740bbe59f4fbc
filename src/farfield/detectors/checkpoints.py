"""Checkpoints of other codebases: read without executing anything, and turned into a network of ours by rules.

A rule names a tensor of ours, the keys of theirs that it is made of, and how. Every key of a checkpoint is used,
ignored for a stated reason, or an error.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import torch
from pydantic import ValidationError
from torch import Tensor

from farfield.detectors.network import Network, build_detector
from farfield.detectors.soundness import unsound
from farfield.detectors.spec import DETECTORS
from farfield.detectors.torch_files import load_torch
from farfield.errors import ConfigError, FileFormatError, fault_of

_SHOWN = 40  # faults of a checkpoint that a message lists
NORM_PARTS = ("weight", "bias", "running_mean", "running_var")
"""Tensors of a batch normalisation that a result depends on."""

_STATES = ("model_state", "model_state_dict")  # OpenPCDet's name, K-Radar's


@dataclass(frozen=True)
class Rule:
    """One tensor of ours and those of theirs that it is made of."""

    ours: str
    theirs: tuple[str, ...]
    convert: Callable[..., Tensor]


@dataclass(frozen=True)
class ImportReport:
    """What became of every key of a checkpoint.

    Attributes:
        origin: Whose checkpoint it is.
        kind: The detector.
        mapped: Their key, and the one of ours that it went into.
        ignored: Their key, and why it is not needed.
        unknown: Keys that the detector has no place for; not empty only where the caller allowed it.
        notes: What else differs.
        data: The data that it reads, as an experiment names them; empty where that is not known.
    """

    origin: str
    kind: str
    mapped: dict[str, str]
    ignored: dict[str, str]
    unknown: tuple[str, ...]
    notes: tuple[str, ...]
    data: Mapping[str, Any] = field(default_factory=dict)

    def text(self, *, every_key: bool = False) -> str:
        """The report for people; ``every_key`` adds a line for each key that was used."""
        lines = [f"{self.origin} checkpoint as {self.kind}: {len(self.mapped)} keys used, {len(self.ignored)} ignored"]
        lines += [f"  {source} -> {ours}" for source, ours in self.mapped.items() if every_key]
        reasons: dict[str, list[str]] = {}
        for key, reason in self.ignored.items():
            reasons.setdefault(reason, []).append(key)
        lines += [f"  ignored, {reason}: {', '.join(keys)}" for reason, keys in reasons.items()]
        lines += [f"  UNKNOWN, left out as allowed: {key}" for key in self.unknown]
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


def read_checkpoint(path: Path) -> dict[str, Tensor]:
    """The model's tensors of a checkpoint file; nothing in it is executed.

    Args:
        path: The file: a state dict, or one beside plain values under ``model_state`` or ``model_state_dict``.

    Raises:
        FileFormatError: If the file is no checkpoint, or holds more than tensors and plain values.
    """
    content = load_torch(
        path,
        expected="a PyTorch checkpoint of tensors and plain values",
        fix="Save its 'model_state' alone with torch.save where it was made.",
    )
    names = [name for name in _STATES if isinstance(content, dict) and name in content]
    state = content[names[0]] if names else content
    strange = [] if not isinstance(state, dict) else [str(k) for k, v in state.items() if not isinstance(v, Tensor)]
    if not isinstance(state, dict) or not state or strange:
        content_words = f"other values at {', '.join(strange[:5])}" if strange else type(state).__name__
        where = names[0] if names else _STATES[0]
        raise FileFormatError(path, where=where, expected="a dictionary of tensors", got=content_words)
    return {str(key): value for key, value in state.items()}


def config_of(path: Path, kind: str, settings: Mapping[str, Any]) -> Any:
    """The configuration of a detector, from the settings that a checkpoint and its user give.

    Args:
        path: The checkpoint, for messages.
        kind: Name of the detector.
        settings: Under our names.

    Raises:
        ConfigError: If they do not fit the detector.
    """
    try:
        return DETECTORS[kind].config_class.model_validate({"name": kind, **settings})
    except ValidationError as error:
        lines = [f"  {'.'.join(map(str, item['loc']))}: {fault_of(item)}" for item in error.errors()]
        raise ConfigError(f"{path}: settings that do not fit {kind}:\n" + "\n".join(lines)) from error


def import_by_rules(
    path: Path,
    state: Mapping[str, Tensor],
    config: Any,
    plan: Sequence[Rule],
    *,
    origin: str,
    ignore: Callable[[str], str | None],
    notes: Sequence[str],
    allow_unknown: bool,
    problems: Sequence[str] = (),
) -> tuple[Network, ImportReport]:
    """Build the network of a configuration with the tensors that rules make of a checkpoint's.

    Args:
        path: The checkpoint, for messages.
        state: Its tensors.
        config: The configuration of ours.
        plan: A rule for each tensor of ours.
        origin: Whose checkpoint it is.
        ignore: Why a key is not needed, or None.
        notes: What else differs, for the report.
        allow_unknown: Report keys that the detector has no place for instead of failing.
        problems: Faults that the caller met, a line each.

    Returns:
        The network in evaluation mode on the CPU, and what became of every key.

    Raises:
        ConfigError: If there are problems, keys are missing, unknown or of another shape, or if a number is not finite
            or none that a training leaves: all are named, up to 40.
    """
    with torch.device("meta"):
        network = build_detector(config)
    expected = network.state_dict()
    used = {key: rule.ours for rule in plan for key in rule.theirs}
    ignored = {key: reason for key in state if key not in used and (reason := ignore(key)) is not None}
    unknown = tuple(key for key in state if key not in used and key not in ignored)
    missing = [key for key in used if key not in state]
    faults = [f"  missing: {key}" for key in missing]
    faults += [f"  unknown: {key}" for key in unknown if not allow_unknown]
    faults += problems
    whole = not missing and not problems
    ours = {rule.ours: rule.convert(*(state[key] for key in rule.theirs)) for rule in plan} if whole else {}
    fault = unsound({name: tensor for name, tensor in state.items() if name in used})
    faults += [] if fault is None else [f"  {fault[0]}: expected numbers as a training leaves them, got {fault[1]}"]
    faults += [
        _misfit(rule, ours[rule.ours], expected[rule.ours])
        for rule in plan
        if rule.ours in ours and ours[rule.ours].shape != expected[rule.ours].shape
    ]
    if faults:
        hint = "" if not unknown or missing or allow_unknown else "\nUnknown keys can be left out (--allow-unknown)."
        shown = faults[:_SHOWN] + [f"  and {len(faults) - _SHOWN} more"] * (len(faults) > _SHOWN)
        raise ConfigError(f"{path}: not the {config.name} that the settings describe:\n" + "\n".join(shown) + hint)
    counters = {name: torch.tensor(0) for name in expected if name.endswith("num_batches_tracked")}
    network.load_state_dict({**ours, **counters}, assign=True)
    mapped = {key: name for key, name in used.items() if key in state}
    return network.eval(), ImportReport(origin, config.name, mapped, ignored, unknown, tuple(notes))


def _misfit(rule: Rule, converted: Tensor, expected: Tensor) -> str:
    hint = "; has each of its classes one of the anchors?" if rule.ours.startswith("head.") else ""
    shapes = f"expected shape {tuple(expected.shape)} as {rule.ours}, got {tuple(converted.shape)}"
    return f"  {', '.join(rule.theirs)}: {shapes}{hint}"


# What rules convert: their grids run over z, y, x and ours over z, x, y.

COUNTER = "a count of batches that no result depends on"
Layout = Literal["1.x", "2.x", "2.x native"]
LAYOUTS: dict[Layout, tuple[int, ...]] = {"1.x": (0, 2, 1, 3, 4), "2.x": (1, 3, 2, 4, 0), "2.x native": (0, 2, 1, 4, 3)}
"""Versions of spconv, and where its kernels have z, x, y, inputs and outputs: 1.x stores (z, y, x, in, out), 2.x
(out, z, y, x, in), and 2.x with its native algorithm (z, y, x, out, in)."""


def stored_shape(layout: Layout, kernel: tuple[int, int, int], c_in: int, c_out: int) -> tuple[int, ...]:
    """The shape in which a version of spconv stores a kernel over z, y, x."""
    shapes = {"1.x": (*kernel, c_in, c_out), "2.x": (c_out, *kernel, c_in), "2.x native": (*kernel, c_out, c_in)}
    return shapes[layout]


def norm_rules(ours: str, source: str) -> list[Rule]:
    """Rules of a batch normalisation."""
    return [Rule(f"{ours}.{part}", (f"{source}.{part}",), same) for part in NORM_PARTS]


def same(tensor: Tensor) -> Tensor:
    """A tensor as it is, in float32."""
    return tensor.float()


def turned(kernel: Tensor) -> Tensor:
    """Kernels over y, x to kernels over x, y."""
    return kernel.float().transpose(2, 3).contiguous() if kernel.ndim == 4 else kernel.float()


def anchor_head(*parts: Tensor, per_cell: int) -> Tensor:
    """Three convolutions, whose outputs run anchor by anchor, to one whose outputs run number by number."""
    alike = len({part.shape[1:] for part in parts}) == 1
    if not alike or any(part.ndim == 0 or len(part) % per_cell for part in parts):
        return torch.cat([part.float().reshape(-1) for part in parts])  # its shape is reported as wrong
    apart = [part.float().view(per_cell, -1, *part.shape[1:]).transpose(0, 1) for part in parts]
    joined = torch.cat(apart)
    return joined.reshape(-1, *joined.shape[2:])


def sparse_kernel(kernel: Tensor, *, layout: Layout) -> Tensor:
    """A kernel as spconv stores it to ours, (z x y, c_in, c_out)."""
    if kernel.ndim != 5:
        return kernel.float()  # its shape is reported as wrong
    ours = kernel.float().permute(LAYOUTS[layout])
    return ours.reshape(-1, *ours.shape[3:])


def shape_of(state: Mapping[str, Tensor], key: str, axes: int) -> tuple[int, ...]:
    """The shape of a tensor that has so many axes.

    Raises:
        ConfigError: If it is missing, empty, or has others.
    """
    if key not in state:
        raise ConfigError(f"Expected the key {key} in the checkpoint; it is missing.")
    if state[key].ndim != axes:
        raise ConfigError(f"{key}: expected {axes} axes, got shape {tuple(state[key].shape)}.")
    if 0 in state[key].shape:
        raise ConfigError(f"{key}: expected numbers, got none, of shape {tuple(state[key].shape)}.")
    return tuple(state[key].shape)
