"""Import of OpenPCDet's checkpoints: PointPillars (``pointpillar.yaml``) and SECOND (``second.yaml``).

Widths and depths come from the shapes of the tensors; grid, anchors and thresholds are those of its KITTI files unless
other settings are given, since a checkpoint does not hold them. Its grids run over z, y, x and ours over z, x, y, so
kernels are turned. Every key of a checkpoint is used, ignored for a stated reason, or an error.
"""

import pickle
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from pydantic import ValidationError
from torch import Tensor

from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.contract import Network
from farfield.detectors.importing.layout import Rule, architecture, rules
from farfield.errors import ConfigError, FarfieldError, FileFormatError, fault_of

Kind = Literal["pointpillars", "second"]

_ANCHORS = {  # Car, Pedestrian, Cyclist: bottoms at -1.78, -0.6 and -0.6 m
    "vehicle": {"size_m": (3.9, 1.6, 1.56), "z_m": -1.78 + 1.56 / 2},
    "pedestrian": {"size_m": (0.8, 0.6, 1.73), "z_m": -0.6 + 1.73 / 2, "positive_iou": 0.5, "negative_iou": 0.35},
    "bicycle": {"size_m": (1.76, 0.6, 1.73), "z_m": -0.6 + 1.73 / 2, "positive_iou": 0.5, "negative_iou": 0.35},
}
_COMMON = {
    "features": "openpcdet",
    "head": "openpcdet",
    "matching": "iou",
    "anchors": _ANCHORS,
    "score_threshold": 0.1,
    "nms_iou": 0.01,
    "candidates": 4096,
    "max_boxes": 500,
}
KITTI_SETTINGS: dict[str, dict[str, Any]] = {
    "pointpillars": {
        **_COMMON,
        "grid": {"range_m": 69.12, "half_width_m": 39.68, "z_min_m": -3.0, "z_max_m": 1.0, "cell_m": 0.16},
        "max_points": 32,
    },
    "second": {
        **_COMMON,
        "grid": {
            "range_m": 70.4,
            "half_width_m": 40.0,
            "z_min_m": -3.0,
            "z_max_m": 1.0,
            "cell_m": (0.05, 0.05, 0.1),
            "extra_layers": 1,
        },
        "max_points": 5,
    },
}
"""What OpenPCDet's KITTI files set and its checkpoints do not hold."""

_NOTES = (
    "batch normalisation: eps 1e-3 as there; running statistics move by 0.01 in further training",
    "OpenPCDet drops pillars or voxels beyond the first 40,000 of a frame; none is dropped here",
)


@dataclass(frozen=True)
class ImportReport:
    """What became of every key of a checkpoint.

    Attributes:
        kind: The detector.
        mapped: Their key, and the one of ours that it went into.
        ignored: Their key, and why it is not needed.
        unknown: Keys that the detector has no place for; not empty only where the caller allowed it.
        notes: What else differs.
    """

    kind: str
    mapped: dict[str, str]
    ignored: dict[str, str]
    unknown: tuple[str, ...]
    notes: tuple[str, ...]

    def text(self, *, every_key: bool = False) -> str:
        """The report for people; ``every_key`` adds a line for each key that was used."""
        lines = [f"OpenPCDet checkpoint as {self.kind}: {len(self.mapped)} keys used, {len(self.ignored)} ignored"]
        lines += [f"  {theirs} -> {ours}" for theirs, ours in self.mapped.items() if every_key]
        reasons: dict[str, list[str]] = {}
        for key, reason in self.ignored.items():
            reasons.setdefault(reason, []).append(key)
        lines += [f"  ignored, {reason}: {', '.join(keys)}" for reason, keys in reasons.items()]
        lines += [f"  UNKNOWN, left out as allowed: {key}" for key in self.unknown]
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


def import_openpcdet(
    path: Path, kind: Kind | None = None, *, settings: Mapping[str, Any] | None = None, allow_unknown: bool = False
) -> tuple[Network, ImportReport]:
    """Build the network of ours that computes what an OpenPCDet checkpoint's does.

    Args:
        path: The checkpoint, ``.pth``.
        kind: Its detector; recognised by its keys unless given.
        settings: Settings of the detector that replace those of OpenPCDet's KITTI file, such as ``grid``, ``anchors``
            (in the order of its ``CLASS_NAMES``) and ``max_points``.
        allow_unknown: Report keys that the detector has no place for instead of failing.

    Returns:
        The network in evaluation mode on the CPU, and what became of every key.

    Raises:
        FileFormatError: If the file is no checkpoint, or holds more than tensors and plain values.
        ConfigError: If keys are missing, unknown or of another shape, or the settings do not fit.
    """
    state = read_checkpoint(path)
    kind = kind or _recognise(path, state)
    config = _config(path, kind, state, settings or {})
    with torch.device("meta"):
        network = build_detector(config)
    expected = network.state_dict()
    plan = rules(kind, config, state)
    used = {key: rule.ours for rule in plan for key in rule.theirs}
    ignored = {key: reason for key in state if key not in used and (reason := _reason_to_ignore(key)) is not None}
    unknown = tuple(key for key in state if key not in used and key not in ignored)
    missing = [key for key in used if key not in state]
    problems = [f"  missing: {key}" for key in missing]
    problems += [f"  unknown: {key}" for key in unknown if not allow_unknown]
    ours = {} if missing else {rule.ours: rule.convert(*(state[key] for key in rule.theirs)) for rule in plan}
    problems += [_misfit(rule, ours[rule.ours], expected[rule.ours]) for rule in plan if _misfits(rule, ours, expected)]
    if problems:
        hint = "" if missing or allow_unknown else "\nUnknown keys can be left out (--allow-unknown)."
        raise ConfigError(f"{path}: not the {kind} that the settings describe:\n" + "\n".join(problems) + hint)
    counters = {name: torch.tensor(0) for name in expected if name.endswith("num_batches_tracked")}
    network.load_state_dict({**ours, **counters}, assign=True)
    mapped = {key: name for key, name in used.items() if key in state}
    return network.eval(), ImportReport(kind, mapped, ignored, unknown, _NOTES)


def read_checkpoint(path: Path) -> dict[str, Tensor]:
    """The model's tensors of a checkpoint file; nothing in it is executed.

    Raises:
        FileFormatError: If the file is no checkpoint, or holds more than tensors and plain values.
    """
    if not path.is_file():
        raise FarfieldError(f"{path}: expected a checkpoint file, found nothing.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of pickle protocols other than the usual one
            content = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError, OSError, IndexError) as error:
        raise FileFormatError(
            path,
            where="pickle",
            expected="a PyTorch checkpoint of tensors and plain values",
            found=str(error).splitlines()[0][:200] if str(error) else type(error).__name__,
            mend="Save its 'model_state' alone with torch.save where it was made.",
        ) from error
    state = content.get("model_state", content) if isinstance(content, dict) else content
    strange = [] if not isinstance(state, dict) else [str(k) for k, v in state.items() if not isinstance(v, Tensor)]
    if not isinstance(state, dict) or not state or strange:
        found = f"other values at {', '.join(strange[:5])}" if strange else type(state).__name__
        raise FileFormatError(path, where="model_state", expected="a dictionary of tensors", found=found)
    return {str(key): value for key, value in state.items()}


def _recognise(path: Path, state: Mapping[str, Tensor]) -> Kind:
    if any(key.startswith("backbone_3d.") for key in state):
        return "second"
    if any(key.startswith("vfe.pfn_layers.") for key in state):
        return "pointpillars"
    shown = ", ".join(list(state)[:5])
    raise ConfigError(f"{path}: expected keys of OpenPCDet's PointPillars or SECOND, got {shown}...")


def _config(path: Path, kind: Kind, state: Mapping[str, Tensor], settings: Mapping[str, Any]) -> Any:
    derived = {"name": kind, **KITTI_SETTINGS[kind], **architecture(kind, state), **settings}
    try:
        return DETECTORS[kind].config_class.model_validate(derived)
    except ValidationError as error:
        lines = [f"  {'.'.join(map(str, item['loc']))}: {fault_of(item)}" for item in error.errors()]
        raise ConfigError(f"{path}: settings that do not fit {kind}:\n" + "\n".join(lines)) from error


def _reason_to_ignore(key: str) -> str | None:
    if key.endswith("num_batches_tracked"):
        return "a count of batches that no result depends on"
    if key == "global_step":
        return "the training's step count"
    if key.startswith("dense_head.anchors"):
        return "anchors follow from the settings"
    return None


def _misfits(rule: Rule, ours: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> bool:
    return rule.ours in ours and ours[rule.ours].shape != expected[rule.ours].shape


def _misfit(rule: Rule, found: Tensor, expected: Tensor) -> str:
    hint = "; has each of its classes one of the anchors?" if rule.ours.startswith("head.") else ""
    shapes = f"expected shape {tuple(expected.shape)} as {rule.ours}, got {tuple(found.shape)}"
    return f"  {', '.join(rule.theirs)}: {shapes}{hint}"
