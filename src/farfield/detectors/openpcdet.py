"""Import of OpenPCDet's checkpoints: PointPillars (``pointpillar.yaml``) and SECOND (``second.yaml``).

Widths and depths come from the shapes of the tensors; grid, anchors and thresholds are those of its KITTI files unless
other settings are given, since a checkpoint does not hold them. Its grids run over z, y, x and ours over z, x, y, so
kernels are turned. Every key of a checkpoint is used, ignored for a stated reason, or an error.
"""

from collections.abc import Collection, Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from torch import Tensor

from farfield.detectors.checkpoints import (
    COUNTER,
    LAYOUTS,
    ImportReport,
    Layout,
    Rule,
    anchor_head,
    config_of,
    import_by_rules,
    norm_rules,
    read_checkpoint,
    same,
    shape_of,
    sparse_kernel,
    stored_shape,
    turned,
)
from farfield.detectors.network import Network
from farfield.errors import ConfigError

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


_MIDDLE = ("conv_input", "conv1.0", *(f"conv{stage}.{layer}" for stage in (2, 3, 4) for layer in range(3)), "conv_out")


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
    kind = kind or recognise_openpcdet(state)
    if kind is None:
        shown = ", ".join(list(state)[:5])
        raise ConfigError(f"{path}: expected keys of OpenPCDet's PointPillars or SECOND, got {shown}...")
    config = config_of(path, kind, {**KITTI_SETTINGS[kind], **architecture(kind, state), **(settings or {})})
    plan = rules(kind, config, state)
    options: dict[str, Any] = {"ignore": _reason_to_ignore, "notes": _NOTES, "allow_unknown": allow_unknown}
    return import_by_rules(path, state, config, plan, origin="OpenPCDet", **options)


def recognise_openpcdet(names: Collection[str]) -> Kind | None:
    """Which of the two detectors a checkpoint with tensors of these names is; None for neither."""
    if any(name.startswith("backbone_3d.") for name in names):
        return "second"
    return "pointpillars" if any(name.startswith("vfe.pfn_layers.") for name in names) else None


def _reason_to_ignore(key: str) -> str | None:
    if key.endswith("num_batches_tracked"):
        return COUNTER
    if key == "global_step":
        return "the training's step count"
    if key.startswith("dense_head.anchors"):
        return "anchors follow from the settings"
    return None


def architecture(kind: str, state: Mapping[str, Tensor]) -> dict[str, Any]:
    """Widths, depths and strides, from the shapes in a checkpoint.

    Raises:
        ConfigError: If a tensor that they follow from is missing.
    """
    blocks = [index for index in range(16) if any(key.startswith(f"backbone_2d.blocks.{index}.") for key in state)]
    depths = [_highest(state, f"backbone_2d.blocks.{index}.") // 3 for index in blocks]
    widths = [shape_of(state, f"backbone_2d.blocks.{index}.1.weight", 4)[0] for index in blocks]
    upsampling = [shape_of(state, f"backbone_2d.deblocks.{index}.0.weight", 4)[2] for index in blocks]
    necks = {shape_of(state, f"backbone_2d.deblocks.{index}.0.weight", 4)[1] for index in blocks}
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
        return {**shared, "pillar_channels": shape_of(state, "vfe.pfn_layers.0.linear.weight", 2)[0]}
    stages = ("conv_input.1", "conv2.0.1", "conv3.0.1", "conv4.0.1", "conv_out.1")
    channels = [shape_of(state, f"backbone_3d.{stage}.weight", 1)[0] for stage in stages]
    return {**shared, "middle_widths": channels[:4], "middle_out": channels[4]}


def rules(kind: str, config: Any, state: Mapping[str, Tensor]) -> list[Rule]:
    """All tensors of ours and where they come from; the layout of sparse kernels follows from ``state``."""
    if kind == "pointpillars":
        linear = Rule("encoder.linear.weight", ("vfe.pfn_layers.0.linear.weight",), same)
        plan = [linear, *norm_rules("encoder.norm", "vfe.pfn_layers.0.norm")]
    else:
        plan = _middle_rules(state)
    first = partial(_first_after_stacking, channels=config.middle_out) if kind == "second" else turned
    for block, depth in enumerate(config.depths):
        for layer in range(depth + 1):
            convert = first if block == layer == 0 else turned
            source, ours = f"backbone_2d.blocks.{block}", f"backbone.blocks.{block}.{layer}"
            plan.append(Rule(f"{ours}.0.weight", (f"{source}.{3 * layer + 1}.weight",), convert))
            plan += norm_rules(f"{ours}.1", f"{source}.{3 * layer + 2}")
        source, ours = f"backbone_2d.deblocks.{block}", f"backbone.necks.{block}"
        plan.append(Rule(f"{ours}.0.weight", (f"{source}.0.weight",), turned))
        plan += norm_rules(f"{ours}.1", f"{source}.1")
    head = partial(anchor_head, per_cell=2 * len(config.anchors))
    for part in ("weight", "bias"):
        names = tuple(f"dense_head.{conv}.{part}" for conv in ("conv_cls", "conv_box", "conv_dir_cls"))
        plan.append(Rule(f"head.{part}", names, head))
    return plan


def _middle_rules(state: Mapping[str, Tensor]) -> list[Rule]:
    convert, plan = partial(sparse_kernel, layout=_layout_of(state)), []
    for index, name in enumerate(_MIDDLE):
        plan.append(Rule(f"middle.{index}.conv.weight", (f"backbone_3d.{name}.0.weight",), convert))
        plan += norm_rules(f"middle.{index}.norm", f"backbone_3d.{name}.1")
    return plan


def _first_after_stacking(kernel: Tensor, *, channels: int) -> Tensor:
    """Their image stacks the layers of z within each channel; ours stacks the channels within each layer."""
    if kernel.ndim != 4 or kernel.shape[1] % channels:
        return kernel.float()  # its shape is reported as wrong
    ours = turned(kernel)
    apart = ours.view(ours.shape[0], channels, -1, *ours.shape[2:])
    return apart.transpose(1, 2).reshape(ours.shape)


def _layout_of(state: Mapping[str, Tensor]) -> Layout:
    """The version of spconv that stored the kernels: the first layer, with other inputs than outputs, shows it."""
    name = "backbone_3d.conv_input.0.weight"
    shape, width = shape_of(state, name, 5), shape_of(state, "backbone_3d.conv_input.1.weight", 1)[0]
    shapes: dict[tuple[int, ...], Layout] = {stored_shape(layout, (3, 3, 3), 4, width): layout for layout in LAYOUTS}
    if shape not in shapes:
        shown = " or ".join(map(str, shapes))
        raise ConfigError(f"{name}: expected shape {shown}, since voxels have x, y, z and intensity; got {shape}.")
    return shapes[shape]


def _highest(state: Mapping[str, Tensor], prefix: str) -> int:
    """Highest layer number that follows a prefix; 0 where none does."""
    heads = (key[len(prefix) :].split(".")[0] for key in state if key.startswith(prefix))
    return max((int(head) for head in heads if head.isascii() and head.isdecimal() and len(head) < 6), default=0)
