"""Weights of other codebases: which network a checkpoint is, and the one of ours that computes the same."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from torch import Tensor

from farfield.detectors.checkpoints import ImportReport, read_checkpoint
from farfield.detectors.kradar.kit_weights import import_rtnh, is_rtnh
from farfield.detectors.network import Network
from farfield.detectors.openpcdet import import_openpcdet, recognise_openpcdet
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError, FarfieldError
from farfield.vocabulary.counts import count_of

CheckpointKind = Literal["pointpillars", "second", "rtnh"]
NAMES: dict[CheckpointKind, str] = {
    "pointpillars": "OpenPCDet's PointPillars",
    "second": "OpenPCDet's SECOND",
    "rtnh": "RTNH of K-Radar's kit",
}


@dataclass(frozen=True)
class CheckpointFacts:
    """What a file of weights is.

    Attributes:
        what: In words; ``unknown`` where it is none that is read.
        tensors: How many it holds.
        numbers: In all of them.
        parts: Tensors by the first word of their names.
        fate: What ``import-weights`` or ``predict`` would do with it.
        fault: Why it would not; empty where it would.
        notes: What a user must know of an import.
    """

    what: str
    tensors: int
    numbers: int
    parts: Mapping[str, int]
    fate: str
    fault: str = ""
    notes: tuple[str, ...] = ()


def import_checkpoint(
    path: Path,
    kind: CheckpointKind | None = None,
    *,
    settings: Mapping[str, Any] | None = None,
    allow_unknown: bool = False,
) -> tuple[Network, ImportReport]:
    """Build the network of ours that computes what a checkpoint's does.

    Args:
        path: The checkpoint, as OpenPCDet or K-Radar's kit saves it.
        kind: Its detector (default: recognised by its keys).
        settings: Settings of the detector that replace those of its own configuration.
        allow_unknown: Report keys that the detector has no place for instead of failing.

    Returns:
        The network in evaluation mode on the CPU, and what became of every key.

    Raises:
        FileFormatError: If the file is no checkpoint, or holds more than tensors and plain values.
        ConfigError: If it is none of the detectors, or does not fit the one that it is.
    """
    kind = kind or recognise_checkpoint(names := list(read_checkpoint(path)))
    if kind is None:
        shown = ", ".join(names[:5])
        raise ConfigError(
            f"{path}: expected keys of OpenPCDet's PointPillars or SECOND, or of RTNH of K-Radar's kit, got {shown}..."
        )
    if kind == "rtnh":
        return import_rtnh(path, settings=settings, allow_unknown=allow_unknown)
    return import_openpcdet(path, kind, settings=settings, allow_unknown=allow_unknown)


def recognise_checkpoint(names: list[str]) -> CheckpointKind | None:
    """Which detector a checkpoint with tensors of these names is; None for none that is read."""
    return "rtnh" if is_rtnh(names) else recognise_openpcdet(names)


def examine_checkpoint(path: Path) -> CheckpointFacts:
    """Say what a file of weights is: ours, one that can be imported, or unknown; an import is tried in memory.

    Args:
        path: A ``.safetensors`` file, or what ``torch.save`` wrote.

    Raises:
        FileFormatError: If it is no file of tensors alone.
    """
    if path.suffix.lower() == ".safetensors":
        network, _ = load_weights(path)
        what = f"{network.config.name} of Farfield, for {', '.join(network.config.class_names)}"
        return _facts(what, network.state_dict(), f"nothing to import: farfield predict {path.name}")
    state = read_checkpoint(path)
    kind = recognise_checkpoint(list(state))
    if kind is None:
        return _facts("unknown", state, "import-weights would refuse it", "no names of a network that is imported")
    try:
        _, report = import_checkpoint(path, kind)
    except FarfieldError as error:
        fault = str(error).removeprefix(f"{path}: ")
        return _facts(NAMES[kind], state, "import-weights would refuse it", fault)
    used, ignored = count_of(len(report.mapped), "tensor"), len(report.ignored)
    fate = f"import-weights would use {used}, leave out {ignored} and miss none"
    return _facts(NAMES[kind], state, fate, notes=report.notes)


def _facts(
    what: str, state: Mapping[str, Tensor], fate: str, fault: str = "", notes: tuple[str, ...] = ()
) -> CheckpointFacts:
    parts = Counter(name.split(".")[0] for name in state)
    numbers = sum(tensor.numel() for tensor in state.values())
    return CheckpointFacts(what, len(state), numbers, dict(parts), fate, fault, notes)
