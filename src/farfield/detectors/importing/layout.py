"""Where each tensor of an OpenPCDet checkpoint goes, and how its axes are turned.

Facts of OpenPCDet's PointPillar and SECONDNet (Apache-2.0): names, shapes and the order of axes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from farfield.errors import ConfigError

_NORM = ("weight", "bias", "running_mean", "running_var")
_MIDDLE = ("conv_input", "conv1.0", *(f"conv{stage}.{layer}" for stage in (2, 3, 4) for layer in range(3)), "conv_out")


@dataclass(frozen=True)
class Rule:
    """One tensor of ours and those of theirs that it is made of."""

    ours: str
    theirs: tuple[str, ...]
    convert: Callable[..., Tensor]


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
    found = _pillar_rules() if kind == "pointpillars" else _middle_rules(state)
    first = partial(_first_after_stacking, channels=config.middle_out) if kind == "second" else _turned
    for block, depth in enumerate(config.depths):
        for layer in range(depth + 1):
            convert = first if block == layer == 0 else _turned
            theirs, ours = f"backbone_2d.blocks.{block}", f"backbone.blocks.{block}.{layer}"
            found.append(Rule(f"{ours}.0.weight", (f"{theirs}.{3 * layer + 1}.weight",), convert))
            found += _norm_rules(f"{ours}.1", f"{theirs}.{3 * layer + 2}")
        theirs, ours = f"backbone_2d.deblocks.{block}", f"backbone.necks.{block}"
        found.append(Rule(f"{ours}.0.weight", (f"{theirs}.0.weight",), _turned))
        found += _norm_rules(f"{ours}.1", f"{theirs}.1")
    head = partial(_head, per_cell=2 * len(config.anchors))
    for part in ("weight", "bias"):
        names = tuple(f"dense_head.{conv}.{part}" for conv in ("conv_cls", "conv_box", "conv_dir_cls"))
        found.append(Rule(f"head.{part}", names, head))
    return found


def _pillar_rules() -> list[Rule]:
    linear = Rule("encoder.linear.weight", ("vfe.pfn_layers.0.linear.weight",), _same)
    return [linear, *_norm_rules("encoder.norm", "vfe.pfn_layers.0.norm")]


def _middle_rules(state: Mapping[str, Tensor]) -> list[Rule]:
    convert, found = _sparse_kernel(state), []
    for index, name in enumerate(_MIDDLE):
        found.append(Rule(f"middle.{index}.conv.weight", (f"backbone_3d.{name}.0.weight",), convert))
        found += _norm_rules(f"middle.{index}.norm", f"backbone_3d.{name}.1")
    return found


def _norm_rules(ours: str, theirs: str) -> list[Rule]:
    return [Rule(f"{ours}.{part}", (f"{theirs}.{part}",), _same) for part in _NORM]


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
    return tuple(state[key].shape)


def _highest(state: Mapping[str, Tensor], prefix: str) -> int:
    """Highest layer number that follows a prefix."""
    heads = (key[len(prefix) :].split(".")[0] for key in state if key.startswith(prefix))
    return max(int(head) for head in heads if head.isdecimal())
