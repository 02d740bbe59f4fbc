"""Import of OpenPCDet's checkpoints: PointPillars (``pointpillar.yaml``) and SECOND (``second.yaml``).

Widths and depths come from the shapes of the tensors; grid, anchors and thresholds are those of its KITTI files unless
other settings are given, since a checkpoint does not hold them. Its grids run over z, y, x and ours over z, x, y, so
kernels are turned. Every key of a checkpoint is used, ignored for a stated reason, or an error.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
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


_SHOWN = 40  # faults of a checkpoint that a message lists
_NORM = ("weight", "bias", "running_mean", "running_var")
_MIDDLE = ("conv_input", "conv1.0", *(f"conv{stage}.{layer}" for stage in (2, 3, 4) for layer in range(3)), "conv_out")


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
        lines += [f"  {source} -> {ours}" for source, ours in self.mapped.items() if every_key]
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
        kind: Its detector (default: recognised by its keys).
        settings: Settings of the detector that replace those of OpenPCDet's KITTI file, such as ``grid``, ``anchors``
            (in the order of its ``CLASS_NAMES``) and ``max_points``.
        allow_unknown: Report keys that the detector has no place for instead of failing.

    Returns:
        The network in evaluation mode on the CPU, and what became of every key.

    Raises:
        FileFormatError: If the file is no checkpoint, or holds more than tensors and plain values.
        ConfigError: If keys are missing, unknown or of another shape, if a number is not finite or none that a training
            leaves, or the settings do not fit.
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
    fault = unsound({name: tensor for name, tensor in state.items() if name in used})
    problems += [] if fault is None else [f"  {fault[0]}: expected numbers as a training leaves them, got {fault[1]}"]
    problems += [
        _misfit(rule, ours[rule.ours], expected[rule.ours])
        for rule in plan
        if rule.ours in ours and ours[rule.ours].shape != expected[rule.ours].shape
    ]
    if problems:
        hint = "" if missing or allow_unknown else "\nUnknown keys can be left out (--allow-unknown)."
        shown = problems[:_SHOWN] + [f"  and {len(problems) - _SHOWN} more"] * (len(problems) > _SHOWN)
        raise ConfigError(f"{path}: not the {kind} that the settings describe:\n" + "\n".join(shown) + hint)
    counters = {name: torch.tensor(0) for name in expected if name.endswith("num_batches_tracked")}
    network.load_state_dict({**ours, **counters}, assign=True)
    mapped = {key: name for key, name in used.items() if key in state}
    return network.eval(), ImportReport(kind, mapped, ignored, unknown, _NOTES)


def read_checkpoint(path: Path) -> dict[str, Tensor]:
    """The model's tensors of a checkpoint file; nothing in it is executed.

    Raises:
        FileFormatError: If the file is no checkpoint, or holds more than tensors and plain values.
    """
    content = load_torch(
        path,
        expected="a PyTorch checkpoint of tensors and plain values",
        fix="Save its 'model_state' alone with torch.save where it was made.",
    )
    state = content.get("model_state", content) if isinstance(content, dict) else content
    strange = [] if not isinstance(state, dict) else [str(k) for k, v in state.items() if not isinstance(v, Tensor)]
    if not isinstance(state, dict) or not state or strange:
        content_words = f"other values at {', '.join(strange[:5])}" if strange else type(state).__name__
        raise FileFormatError(path, where="model_state", expected="a dictionary of tensors", got=content_words)
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


def _misfit(rule: Rule, converted: Tensor, expected: Tensor) -> str:
    hint = "; has each of its classes one of the anchors?" if rule.ours.startswith("head.") else ""
    shapes = f"expected shape {tuple(expected.shape)} as {rule.ours}, got {tuple(converted.shape)}"
    return f"  {', '.join(rule.theirs)}: {shapes}{hint}"


def architecture(kind: str, state: Mapping[str, Tensor]) -> dict[str, Any]:
    """Widths, depths and strides, from the shapes in a checkpoint.

    Raises:
        ConfigError: If a tensor that they follow from is missing.
    """
    blocks = [index for index in range(16) if any(key.startswith(f"backbone_2d.blocks.{index}.") for key in state)]
    depths = [_highest(state, f"backbone_2d.blocks.{index}.") // 3 for index in blocks]
    widths = [_shape(state, f"backbone_2d.blocks.{index}.1.weight", 4)[0] for index in blocks]
    upsampling = [_shape(state, f"backbone_2d.deblocks.{index}.0.weight", 4)[2] for index in blocks]
    necks = {_shape(state, f"backbone_2d.deblocks.{index}.0.weight", 4)[1] for index in blocks}
    if not blocks or len(necks) != 1:
        raise ConfigError(f"Expected blocks in backbone_2d and one width of all deblocks; got widths {sorted(necks)}.")
    first = 1 if kind == "second" else 2
    strides = [first, *(after // before for before, after in pairwise(upsampling))]
    shared = {
        "widths": widths,
        "depths": depths,
        "strides": strides,
        "out_stride": max(first // upsampling[0], 1),
        "neck_width": necks.pop(),
    }
    if kind == "pointpillars":
        return {**shared, "pillar_channels": _shape(state, "vfe.pfn_layers.0.linear.weight", 2)[0]}
    stages = ("conv_input.1", "conv2.0.1", "conv3.0.1", "conv4.0.1", "conv_out.1")
    channels = [_shape(state, f"backbone_3d.{stage}.weight", 1)[0] for stage in stages]
    return {**shared, "middle_widths": channels[:4], "middle_out": channels[4]}


def rules(kind: str, config: Any, state: Mapping[str, Tensor]) -> list[Rule]:
    """All tensors of ours and where they come from; the layout of sparse kernels follows from ``state``."""
    if kind == "pointpillars":
        linear = Rule("encoder.linear.weight", ("vfe.pfn_layers.0.linear.weight",), _same)
        plan = [linear, *_norm_rules("encoder.norm", "vfe.pfn_layers.0.norm")]
    else:
        plan = _middle_rules(state)
    first = partial(_first_after_stacking, channels=config.middle_out) if kind == "second" else _turned
    for block, depth in enumerate(config.depths):
        for layer in range(depth + 1):
            convert = first if block == layer == 0 else _turned
            source, ours = f"backbone_2d.blocks.{block}", f"backbone.blocks.{block}.{layer}"
            plan.append(Rule(f"{ours}.0.weight", (f"{source}.{3 * layer + 1}.weight",), convert))
            plan += _norm_rules(f"{ours}.1", f"{source}.{3 * layer + 2}")
        source, ours = f"backbone_2d.deblocks.{block}", f"backbone.necks.{block}"
        plan.append(Rule(f"{ours}.0.weight", (f"{source}.0.weight",), _turned))
        plan += _norm_rules(f"{ours}.1", f"{source}.1")
    head = partial(_head, per_cell=2 * len(config.anchors))
    for part in ("weight", "bias"):
        names = tuple(f"dense_head.{conv}.{part}" for conv in ("conv_cls", "conv_box", "conv_dir_cls"))
        plan.append(Rule(f"head.{part}", names, head))
    return plan


def _middle_rules(state: Mapping[str, Tensor]) -> list[Rule]:
    convert, plan = _sparse_kernel(state), []
    for index, name in enumerate(_MIDDLE):
        plan.append(Rule(f"middle.{index}.conv.weight", (f"backbone_3d.{name}.0.weight",), convert))
        plan += _norm_rules(f"middle.{index}.norm", f"backbone_3d.{name}.1")
    return plan


def _norm_rules(ours: str, source: str) -> list[Rule]:
    return [Rule(f"{ours}.{part}", (f"{source}.{part}",), _same) for part in _NORM]


def _same(tensor: Tensor) -> Tensor:
    return tensor.float()


def _turned(kernel: Tensor) -> Tensor:
    """Kernels over y, x to kernels over x, y."""
    return kernel.float().transpose(2, 3).contiguous() if kernel.ndim == 4 else kernel.float()


def _first_after_stacking(kernel: Tensor, *, channels: int) -> Tensor:
    """Their image stacks the layers of z within each channel; ours stacks the channels within each layer."""
    if kernel.ndim != 4 or kernel.shape[1] % channels:
        return kernel.float()  # its shape is reported as wrong
    turned = _turned(kernel)
    apart = turned.view(turned.shape[0], channels, -1, *turned.shape[2:])
    return apart.transpose(1, 2).reshape(turned.shape)


def _head(*parts: Tensor, per_cell: int) -> Tensor:
    """Three convolutions, whose outputs run anchor by anchor, to one whose outputs run number by number."""
    alike = len({part.shape[1:] for part in parts}) == 1
    if not alike or any(part.ndim == 0 or len(part) % per_cell for part in parts):
        return torch.cat([part.float().reshape(-1) for part in parts])  # its shape is reported as wrong
    apart = [part.float().view(per_cell, -1, *part.shape[1:]).transpose(0, 1) for part in parts]
    joined = torch.cat(apart)
    return joined.reshape(-1, *joined.shape[2:])


def _sparse_kernel(state: Mapping[str, Tensor]) -> Callable[[Tensor], Tensor]:
    """Turn a sparse kernel into (z x y, c_in, c_out), from the layout that the first layer's shape shows.

    spconv 1.x stores (z, y, x, c_in, c_out), 2.x (c_out, z, y, x, c_in), and 2.x with its native algorithm
    (z, y, x, c_out, c_in). Only the first layer has other inputs than outputs, so only it shows which.
    """
    name = "backbone_3d.conv_input.0.weight"
    shape, width = _shape(state, name, 5), _shape(state, "backbone_3d.conv_input.1.weight", 1)[0]
    layouts = {
        (3, 3, 3, 4, width): (0, 2, 1, 3, 4),
        (width, 3, 3, 3, 4): (1, 3, 2, 4, 0),
        (3, 3, 3, width, 4): (0, 2, 1, 4, 3),
    }
    if shape not in layouts:
        shown = " or ".join(map(str, layouts))
        raise ConfigError(f"{name}: expected shape {shown}, since voxels have x, y, z and intensity; got {shape}.")
    return partial(_permuted, order=layouts[shape])


def _permuted(kernel: Tensor, *, order: tuple[int, ...]) -> Tensor:
    if kernel.ndim != 5:
        return kernel.float()  # its shape is reported as wrong
    turned = kernel.float().permute(order)
    return turned.reshape(-1, *turned.shape[3:])


def _shape(state: Mapping[str, Tensor], key: str, axes: int) -> tuple[int, ...]:
    if key not in state:
        raise ConfigError(f"Expected the key {key} in the checkpoint; it is missing.")
    if state[key].ndim != axes:
        raise ConfigError(f"{key}: expected {axes} axes, got shape {tuple(state[key].shape)}.")
    if 0 in state[key].shape:
        raise ConfigError(f"{key}: expected numbers, got none, of shape {tuple(state[key].shape)}.")
    return tuple(state[key].shape)


def _highest(state: Mapping[str, Tensor], prefix: str) -> int:
    """Highest layer number that follows a prefix; 0 where none does."""
    heads = (key[len(prefix) :].split(".")[0] for key in state if key.startswith(prefix))
    return max((int(head) for head in heads if head.isascii() and head.isdecimal() and len(head) < 6), default=0)
