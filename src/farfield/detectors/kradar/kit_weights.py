"""Import of RTNH's checkpoints as K-Radar's kit saves them; layers, names and shapes are the rows of ``kit_layers``.

Three forms: a softmax head on cells of one point (``cfg_RTNH.yml``), OpenPCDet's anchor head behind a simplified
PointNet in the wide region (``cfg_RTNH_wide.yml``), and that in the narrow one (``v1_0/cfg_RTNH.yml``). Region, anchors
and thresholds are in no checkpoint: those of the configuration that it looks like are taken unless others are given.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

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
    sparse_kernel,
    stored_shape,
    turned,
)
from farfield.detectors.kradar.kit_layers import KitForm, KitLayer
from farfield.detectors.kradar.radar_detector import FORMS
from farfield.detectors.layers import Upsampling
from farfield.detectors.network import Network
from farfield.errors import ConfigError
from farfield.vocabulary.kradar import REGIONS_M

ORIGIN = "K-Radar's kit"
_MOST_STAGES = 6
_WIDTHS = (64, 128, 256)  # ENCODING.CHANNEL of all three configurations
_LAYERS = {round((high - low) / 0.4): name for name, (*_, low, high) in REGIONS_M.items()}  # along z, of 0.4 m
_EDGE = (
    "it also reads cells whose centres lie 0.2 m below the region's lower limits: our region narrow leaves them out",
)
_USUAL: dict[str, tuple[Any, ...]] = {
    "input": (4, 5),
    "cell": (0, 32),
    "first": (64,),
    "widths": (_WIDTHS,),
    "neck": (256,),
    "classes": (1, 2),
}
_NOTES = (
    "no real checkpoint of the kit was seen: names, shapes and what each layer computes follow its source",
    "not in a checkpoint, so as the kit's configuration has them: region, anchors, thresholds, the maximum as pooling",
    "spconv 2 multiplies by input_conv's numbers as (inputs, outputs) in the order of memory: so are they read",
    "biases before a batch normalisation stand in its running mean; eps 1e-5 as there",
    "the kit drops cells beyond a quarter of the raster; none is dropped here",
)


def import_rtnh(
    path: Path, *, settings: Mapping[str, Any] | None = None, allow_unknown: bool = False
) -> tuple[Network, ImportReport]:
    """Build the network of ours that computes what an RTNH of K-Radar's kit does.

    Args:
        path: The checkpoint, ``.pt``: ``models/model_N.pt`` or ``utils/util_N.pt`` of the kit's logs.
        settings: Settings of the detector that replace those of the kit's configuration, such as ``grid`` and
            ``anchors`` (in the order of its ``ANCHOR_GENERATOR_CONFIG``).
        allow_unknown: Report keys that the detector has no place for instead of failing.

    Returns:
        The network in evaluation mode on the CPU, and what became of every key.

    Raises:
        FileFormatError: If the file is no checkpoint, or holds more than tensors and plain values.
        ConfigError: If keys are missing, unknown or of another shape (all are named), if a number is not finite or none
            that a training leaves, or the settings do not fit.
    """
    state = read_checkpoint(path)
    form, settings = kit_form(path, state), settings or {}
    config = config_of(path, "rtnh", {**_settings(path, form, settings), **settings})
    usual = _configuration(form)
    taken = f"taken as {usual.path}, with {', '.join(config.class_names)}; kernels as spconv {form.layout} stores them"
    notes = (taken, *_odd_sizes(form), *(() if config.first_cell == "at the limit" else _EDGE), *_NOTES)
    options: dict[str, Any] = {"ignore": _reason_to_ignore, "notes": notes, "allow_unknown": allow_unknown}
    faults = tuple(_faults(state, form))
    network, report = import_by_rules(path, state, config, kit_rules(form), origin=ORIGIN, problems=faults, **options)
    data = {"path": "K-Radar", "clouds": ["radar"], "options": {"reference": "radar", **usual.options}}
    return network, replace(report, data=data)


def is_rtnh(names: Collection[str]) -> bool:
    """Whether tensors of these names are an RTNH of the kit, whole or in part."""
    parts = ("backbone.spconv", "backbone.subm", "backbone.toBEV", "backbone.convtrans2d")
    return sum(any(name.startswith(part) for name in names) for part in parts) >= 2


def kit_form(path: Path, state: Mapping[str, Tensor]) -> KitForm:
    """The sizes of a checkpoint, from the shapes of its tensors; the kit's usual one where a tensor is missing.

    Raises:
        ConfigError: If its layers are none of an RTNH.
    """
    if not is_rtnh(state):
        shown = ", ".join(list(state)[:5])
        raise ConfigError(f"{path}: expected keys of RTNH as K-Radar's kit names them, got {shown}...")
    numbers = range(_MOST_STAGES)
    stages = next((i for i in numbers if not any(k.startswith(f"backbone.spconv{i}.") for k in state)), _MOST_STAGES)
    widths = tuple(_size(state, f"backbone.bn{i}.weight", 0, _WIDTHS[min(i, 2)]) for i in range(stages or len(_WIDTHS)))
    cell = "pre_processor.simplified_pointnet.weight"
    softmax = any(name.startswith("head.conv_reg.") for name in state)
    rows = _size(state, "head.conv_cls.bias", 0, 3) - 1 if softmax else _size(state, "head.conv_box.bias", 0, 28) // 7
    sizes: dict[str, Any] = {
        "cell": _size(state, cell, 0, 32) if cell in state else 0,
        "first": _size(state, "backbone.input_conv.bias", 0, widths[0]),
        "widths": widths,
        "neck": _size(state, "backbone.bnt0.weight", 0, 256),
        "head": "softmax" if softmax else "anchors",
        "classes": max(rows // 2, 1),
    }
    made = [_with_layout(state, layout, sizes) for layout in LAYOUTS]
    return max(made, key=lambda form: _fitting(state, form))  # of equal ones the first


def kit_rules(form: KitForm) -> list[Rule]:
    """All tensors of ours and where they come from."""
    plan: list[Rule] = []
    per_cell = partial(anchor_head, per_cell=2 * form.classes)
    for layer, _, stage in form.layers():
        ours = "encoder.lift" if layer.kind == "point" and form.cell else layer.ours
        if layer.kind == "head" and form.head == "anchors":
            continue
        plan.append(Rule(f"{ours}.weight", (f"{layer.theirs}.weight",), _conversion(layer, stage, form.layout)))
        if layer.norm is not None:
            plan += _norm_with_bias(layer.norm[1], layer.norm[0], f"{layer.theirs}.bias")
        elif layer.biased:
            plan.append(Rule(f"{ours}.bias", (f"{layer.theirs}.bias",), same))
    if form.head == "anchors":
        names = [layer.theirs for layer, _, _ in form.layers() if layer.kind == "head"]
        plan += [
            Rule(f"head.{part}", tuple(f"{name}.{part}" for name in names), per_cell) for part in ("weight", "bias")
        ]
    return plan


def _conversion(layer: KitLayer, stage: int, layout: Layout) -> Any:
    if layer.kind == "sparse":
        return partial(sparse_kernel, layout=layout)
    if layer.kind == "point":
        return partial(_as_multiplied, layout=layout)
    return partial(_upsampling, stride=2**stage) if layer.kind == "transposed" else same


def _as_multiplied(kernel: Tensor, *, layout: Layout) -> Tensor:
    """A kernel of one cell, in any layout of spconv, to a linear layer's matrix, (outputs, inputs).

    spconv multiplies by its numbers seen as (inputs, outputs), without turning them: ``spconv/pytorch/conv.py``,
    ``weight.view(self.in_channels, self.out_channels)``, in every release from 2.0.0 to 2.3.8, for kernels that it
    stores as (outputs, 1, 1, 1, inputs); ``spconv/conv.py`` of 1.x does, for kernels stored as (1, 1, 1, inputs,
    outputs).
    """
    if kernel.ndim != 5:
        return kernel.float()  # its shape is reported as wrong
    outputs, inputs = {"1.x": (4, 3), "2.x": (0, 4), "2.x native": (3, 4)}[layout]
    return kernel.float().reshape(kernel.shape[inputs], kernel.shape[outputs]).T.contiguous()


def _upsampling(kernel: Tensor, *, stride: int) -> Tensor:
    """A transposed convolution's kernel over y, x to that of the ordinary one over x, y that computes the same."""
    return Upsampling.kernel_of(turned(kernel), stride)


def _norm_with_bias(ours: str, theirs: str, bias: str) -> list[Rule]:
    """Rules of a normalisation behind a convolution with a bias, which ours has not: the mean takes it up."""
    mean = Rule(f"{ours}.running_mean", (f"{theirs}.running_mean", bias), _less)
    return [mean if rule.ours == mean.ours else rule for rule in norm_rules(ours, theirs)]


def _less(mean: Tensor, bias: Tensor) -> Tensor:
    return mean.float() - bias.float()


def _size(state: Mapping[str, Tensor], name: str, axis: int, usual: int) -> int:
    tensor = state.get(name)
    return tensor.shape[axis] if tensor is not None and tensor.ndim > axis and 0 not in tensor.shape else usual


def _with_layout(state: Mapping[str, Tensor], layout: Layout, sizes: dict[str, Any]) -> KitForm:
    """The form if this version of spconv stored the kernels."""
    depth = _size(state, "backbone.toBEV0.weight", 1 if layout == "2.x" else 0, 20)
    numbers = _size(state, "pre_processor.simplified_pointnet.weight", 1, 4)
    point = state.get("backbone.input_conv.weight")
    with_doppler = stored_shape(layout, (1, 1, 1), 5, sizes["first"])
    if not sizes["cell"] and point is not None and tuple(point.shape) == with_doppler:
        numbers = 5
    return KitForm(input=numbers, depth=depth, layout=layout, **sizes)


def _fitting(state: Mapping[str, Tensor], form: KitForm) -> int:
    """How many tensors have the shapes of a form."""
    return sum(name in state and tuple(state[name].shape) == shape for name, shape in form.shapes().items())


def _faults(state: Mapping[str, Tensor], form: KitForm) -> Iterator[str]:
    """A line for each tensor of another shape than the kit's layers of these sizes have."""
    for name, shape in form.shapes().items():
        if name in state and tuple(state[name].shape) != shape:
            yield f"  {name}: expected shape {shape} (spconv {form.layout}), got {tuple(state[name].shape)}"


def _odd_sizes(form: KitForm) -> Iterator[str]:
    """A note for each size that no configuration of the kit has."""
    for name, usual in _USUAL.items():
        size = getattr(form, name)
        if size not in usual:
            yield f"no configuration of the kit has {name} {size}: {' or '.join(map(str, usual))} there"


def _settings(path: Path, form: KitForm, others: Mapping[str, Any]) -> dict[str, Any]:
    """Our settings of a checkpoint's sizes, with what the kit's configuration of that form sets besides."""
    name = "published" if form.head == "softmax" else "wide"
    settings: dict[str, Any] = {
        "form": name,
        "cell_channels": form.cell or form.first,
        "lifted_channels": form.first if form.cell else 0,
        "max_points": 4 if form.cell else 0,
        "widths": form.widths,
        "neck_width": form.neck,
        "use_doppler": form.input == 5,
        # models/pre_processor/rdr_sparse_processor.py: ceil for the first form's cells, spconv's floor for the others
        "first_cell": "before it" if form.head == "softmax" and not form.cell else "at the limit",
    }
    if "grid" not in others:
        settings["grid"] = _region(path, form)
    if "anchors" not in others:
        usual = FORMS[name]["anchors"]
        if form.classes > len(usual):
            raise ConfigError(
                f"{path}: its head tells {form.classes} classes apart, and the kit's configurations for this head "
                f"{len(usual)}: name their anchors in --settings, in the order of the training."
            )
        settings["anchors"] = dict(list(usual.items())[: form.classes])
    return settings


class _Configuration(NamedTuple):
    """A configuration of the kit, and the options of K-Radar's data that it stands for."""

    path: str
    options: dict[str, Any]


def _configuration(form: KitForm) -> _Configuration:
    """The configuration of the kit that a checkpoint looks like.

    RDR_CUBE's GENERATE_SPARSE_CUBE.PICK_RATE 0.1 of the corridor's cells, or rdr_sparse.dir rtnh_wider_1p_1.
    """
    if form.head == "softmax":
        path = "none of the kit's: a softmax head behind a PointNet" if form.cell else "configs/cfg_RTNH.yml"
        return _Configuration(path, {"radar_rate": 0.1, "radar_region": "narrow", "radar_over": "region"})
    narrow = _LAYERS.get(form.depth) == "narrow"
    path = "configs/v1_0/cfg_RTNH.yml" if narrow else "configs/cfg_RTNH_wide.yml"
    return _Configuration(path, {"radar_rate": 0.01, "radar_region": "narrow" if narrow else "wide"})


def _region(path: Path, form: KitForm) -> dict[str, float]:
    """The grid of the region that has so many layers of cells along z."""
    if form.depth not in _LAYERS:
        expected = " or ".join(f"{layers} ({name})" for layers, name in sorted(_LAYERS.items()))
        raise ConfigError(
            f"{path}: backbone.toBEV0.weight is {form.depth} cells tall, expected {expected} as the kit's regions are: "
            "name the grid of its training in --settings."
        )
    _, range_m, _, half_width_m, z_min_m, z_max_m = REGIONS_M[_LAYERS[form.depth]]
    return {"range_m": range_m, "half_width_m": half_width_m, "z_min_m": z_min_m, "z_max_m": z_max_m}


def _reason_to_ignore(key: str) -> str | None:
    return COUNTER if key.endswith("num_batches_tracked") else None
