"""Start a training from other weights: what of them fits is taken, made to fit, or left; all of it is reported.

For each tensor of the network, in this order: the same name (after ``rename``) and shape, taken; rows of classes, by
the class' name, and the numbers of a new class' anchor from that of theirs nearest in size; columns of the input, by
theirs; the mean over columns where nobody names them; another odd kernel, or one of two dimensions, into the middle;
else the network's own first values. A file of which little fits must not pass in silence: taking less than
``least_taken`` of the parameters is an error.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from farfield.detectors.network import AnchorRow, ClassRows, InputColumns, Network
from farfield.detectors.weights import load_weights, resolve_weights
from farfield.errors import ConfigError
from farfield.training.config import InitConfig
from farfield.training.param_groups import is_within
from farfield.vocabulary.counts import count_of

_SHAPELESS = (
    "score_threshold",
    "nms_iou",
    "max_boxes",
    "far_weight",
    "full_points",
    "score_bands",
)  # settings that no weight depends on
_SHOWN = 12
_OTHER = "of other classes"


@dataclass(frozen=True, kw_only=True)
class TransferReport:
    """What a network took of other weights.

    Args:
        weights: Which ones, as the experiment names them.
        sha256: Of their file; empty for tensors in memory.
        share: Share of the network's parameters that were taken.
        shares: The same by what was done: ``taken`` whole, ``adapted``, ``by_class``; and ``fresh``.
        taken: Names of tensors that were taken whole.
        adapted: Of tensors that were made to fit, how.
        by_class: Of tensors that were taken by rows of classes, how many rows of how many.
        fresh: Of tensors that were not taken, why.
        unused: Names of tensors of the weights that found no place.
        shapes: Shape of every tensor that is named, of the network and, if unused, of the weights.
        classes: The network's classes that are ``shared`` with the weights, and those that are ``fresh``.
        settings: Settings in which the two differ, one sentence each.
    """

    weights: str
    sha256: str
    share: float
    shares: Mapping[str, float]
    taken: Sequence[str]
    adapted: Mapping[str, str]
    by_class: Mapping[str, str]
    fresh: Mapping[str, str]
    unused: Sequence[str]
    shapes: Mapping[str, Sequence[int]]
    classes: Mapping[str, Sequence[str]]
    settings: Sequence[str]

    def to_json(self) -> dict[str, Any]:
        """Everything, as JSON values."""
        shares = {name: round(share, 6) for name, share in self.shares.items()}
        return {**asdict(self), "share": round(self.share, 6), "shares": shares}

    def brief(self) -> dict[str, Any]:
        """What travels with the trained weights."""
        return {"weights": self.weights, "sha256": self.sha256, "share": round(self.share, 6)}

    def lines(self) -> Iterator[str]:
        """The same for the user."""
        changed = {**self.adapted, **self.by_class}
        tensors = len(self.taken) + len(changed) + len(self.fresh)
        yield (
            f"starts from {self.weights}: {100 * self.share:.1f} % of the parameters; {len(self.taken)} of {tensors} "
            f"tensors loaded, {len(self.adapted)} adapted to other shapes, {len(self.by_class)} loaded by class, "
            f"{len(self.fresh)} initialised; {len(self.unused)} of the file not used"
        )
        groups = [f"{word}: {', '.join(names)}" for word, names in self.classes.items() if names]
        yield from [f"  classes {'; '.join(groups)}"] if groups else []
        tensors_by_name = [*changed.items(), *self.fresh.items(), *((name, "unused") for name in self.unused)]
        for name, what in tensors_by_name[:_SHOWN]:
            yield f"  {name} {_shape(self.shapes[name])}: {what}"
        if len(tensors_by_name) > _SHOWN:
            yield f"  and {len(tensors_by_name) - _SHOWN} more in start.json"
        for sentence in self.settings:
            yield f"  setting {sentence}"

    def __str__(self) -> str:
        return "\n".join(self.lines())


@dataclass(frozen=True, kw_only=True)
class _SourceWeights:
    """Tensors to take from, under the names that they have here, and what is known of them."""

    weights: str
    sha256: str
    tensors: Mapping[str, Tensor]
    network: Network | None = None
    rows: ClassRows = field(default_factory=dict)
    sizes_m: Mapping[str, Sequence[float]] = field(default_factory=dict)
    columns: InputColumns = field(default_factory=dict)


@dataclass
class _TransferTally:
    """What was done with each tensor so far."""

    taken: list[str] = field(default_factory=list)
    adapted: dict[str, str] = field(default_factory=dict)
    by_class: dict[str, str] = field(default_factory=dict)
    fresh: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("taken", "adapted", "by_class"), 0))


@torch.no_grad()
def start_network(
    network: Network, weights: str | Mapping[str, Tensor], settings: InitConfig | None = None
) -> TransferReport:
    """Give a network what fits of a trained detector's weights; the module's text says by which rules.

    Args:
        network: Is changed.
        weights: A bundled detector's name, a run's folder, a weights file, or tensors by name. Of plain tensors nobody
            knows classes nor columns: rows of classes are taken if the shape is the same.
        settings: What to take; by default all that fits.

    Raises:
        FarfieldError: If there are no such weights.
        ConfigError: If they are another detector's, hold a number that is not finite, or too little of them fits.
    """
    chosen = settings or InitConfig()
    source = _source_weights(weights, chosen.rename)
    if source.network is not None:
        _check_kind(network, source.network, source.weights)
    _check_finite(source)
    own, tally = network.state_dict(), _TransferTally()
    parameters = {name for name, _ in network.named_parameters()}
    undeclared = _undeclared_rows(network, source.network)
    for name, tensor in own.items():
        fit = _fit(name, tensor, source, network, chosen, name in undeclared)
        if isinstance(fit, str):
            tally.fresh[name] = f"fresh: {fit}"
            continue
        kind, count, description = fit
        if kind == "taken":
            tally.taken.append(name)
        else:
            (tally.by_class if kind == "by_class" else tally.adapted)[name] = description
        tally.counts[kind] += count if name in parameters else 0
    total = sum(parameter.numel() for parameter in network.parameters())
    _check_enough(sum(tally.counts.values()) / total, own, source, tally, chosen)
    return _report(network, source, tally, total)


def _report(network: Network, source: _SourceWeights, tally: _TransferTally, total: int) -> TransferReport:
    own, unused = network.state_dict(), sorted(set(source.tensors) - set(network.state_dict()))
    share = sum(tally.counts.values()) / total
    trained = source.network.config if source.network is not None else None
    names, others = network.config.class_names, set(trained.class_names) if trained is not None else set()
    classes = {"shared": [n for n in names if n in others], "fresh": [n for n in names if n not in others]}
    differences = () if trained is None else _differences(trained.model_dump(), network.config.model_dump())
    return TransferReport(
        weights=source.weights,
        sha256=source.sha256,
        share=share,
        shares={**{kind: count / total for kind, count in tally.counts.items()}, "fresh": 1.0 - share},
        taken=tally.taken,
        adapted=tally.adapted,
        by_class=tally.by_class,
        fresh=tally.fresh,
        unused=unused,
        shapes={
            **{name: list(source.tensors[name].shape) for name in unused},
            **{name: list(tensor.shape) for name, tensor in own.items()},
        },
        classes=classes if trained is not None else {},
        settings=list(differences),
    )


def _source_weights(weights: str | Mapping[str, Tensor], rename: Mapping[str, str]) -> _SourceWeights:
    """The weights' tensors under the names that they have here."""
    if not isinstance(weights, str):
        return _SourceWeights(weights="tensors in memory", sha256="", tensors=_renamed(weights, rename))
    path = resolve_weights(weights)
    with torch.random.fork_rng(devices=[]):  # what is drawn afterwards does not depend on what was loaded
        trained, _ = load_weights(path)
    return _SourceWeights(
        weights=weights,
        sha256=hashlib.sha256(Path(path).read_bytes()).hexdigest(),
        tensors=_renamed(trained.state_dict(), rename),
        network=trained,
        rows=_renamed(trained.class_rows(), rename),
        sizes_m=trained.config.anchor_sizes_m,
        columns=_renamed(trained.input_columns(), rename),
    )


def _renamed(tree: Mapping[str, Any], rename: Mapping[str, str]) -> dict[str, Any]:
    """Names with their longest beginning that ``rename`` has exchanged; beginnings end at a dot."""
    renamed = {}
    for name, value in tree.items():
        fitting = [old for old in rename if name == old or name.startswith(f"{old}.") or not old]
        old = max(fitting, key=len, default=None)
        renamed[name if old is None else (rename[old] + name[len(old) :]).removeprefix(".")] = value
    return renamed


def _fit(
    name: str, own: Tensor, source: _SourceWeights, network: Network, chosen: InitConfig, other_classes: bool
) -> tuple[str, int, str] | str:
    """Change a tensor in place: what was done, how many values were taken, in words; or why it stays fresh."""
    other, rows, columns = source.tensors.get(name), network.class_rows(), network.input_columns()
    if any(is_within(name, pattern) for pattern in chosen.skip):
        return "left out by training.start.skip"
    if chosen.head == "fresh" and (name.startswith("head.") or name in rows):
        return "training.start.head is fresh"
    if other is None:
        return "the weights have no such tensor"
    like = nearest_sizes(network.config.anchor_sizes_m, source.sizes_m)
    pairs = _OTHER if other_classes else _pairs(rows.get(name), source.rows.get(name), own, other, like)
    if not isinstance(pairs, str) and pairs is not None:
        axis, here, there, description = pairs
        own.movedim(axis, 0)[here] = other.movedim(axis, 0)[there].to(own.dtype)
        count = own.numel() // own.shape[axis] * len(here)
        return "by_class", count, f"{len(here)} of {count_of(own.shape[axis], 'row')}, by class{description}"
    own_columns, source_columns = columns.get(name), source.columns.get(name)
    named_alike = own_columns is None or source_columns is None or list(own_columns[1]) == list(source_columns[1])
    if pairs is None and own.shape == other.shape and named_alike:
        own.copy_(other)
        return "taken", own.numel(), ""
    fitted = None
    if pairs != _OTHER and name not in rows:
        fitted = _made_to_fit(name, own, other, source, columns, chosen)
    if fitted is None:
        return pairs or f"{tuple(other.shape)} there, {tuple(own.shape)} here"
    own.copy_(fitted[0])
    return "adapted", fitted[1], fitted[2]


def _made_to_fit(
    name: str, own: Tensor, other: Tensor, source: _SourceWeights, columns: InputColumns, chosen: InitConfig
) -> tuple[Tensor, int, str] | None:
    """A tensor of other columns or another kernel; None where there is no rule."""
    reads = name in columns if columns else name == next((n for n, t in source.tensors.items() if t.ndim > 1), None)
    if not reads or (own.shape == other.shape and chosen.inputs != "match"):
        return by_kernel(own, other)
    if chosen.inputs == "fresh":
        return None
    fitted = by_columns(own, other, columns.get(name), source.columns.get(name)) if chosen.inputs == "match" else None
    unnamed = chosen.inputs == "average" or name not in source.columns or name not in columns
    fitted = by_average(own, other) if fitted is None and unnamed else fitted
    return fitted if fitted is not None else by_kernel(own, other)


def _check_finite(source: _SourceWeights) -> None:
    """Refuse weights of a training that went astray."""
    for name, tensor in source.tensors.items():
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise ConfigError(
                f"training.start: {source.weights} holds numbers that are not finite, the first in {name}: its "
                "training went astray. Take weights of an earlier checkpoint."
            )


def _check_enough(
    share: float, own: Mapping[str, Tensor], source: _SourceWeights, tally: _TransferTally, chosen: InitConfig
) -> None:
    """Refuse weights of which too little fits, with the names that are nearest to what was looked for."""
    if share > 0 and share >= chosen.least_taken:
        return
    largest = max(tally.fresh, key=lambda name: own[name].numel(), default=next(iter(own)))
    why = tally.fresh.get(largest, "")
    near = sorted(source.tensors, key=lambda name: -SequenceMatcher(None, largest, name, autojunk=False).ratio())[:3]
    nearest = ", ".join(f"{name} {_shape(source.tensors[name].shape)}" for name in near)
    amount = f"{100 * share:.1f} % of the parameters fit" if share else "nothing fits"
    raise ConfigError(
        f"training.start: of {source.weights} {amount}, expected at least {100 * chosen.least_taken:g} %. "
        f"{largest} {_shape(own[largest].shape)} is {why}; nearest there: {nearest}. "
        "Say what is called otherwise in training.start.rename, or lower training.start.least_taken."
    )


def _shape(sizes: Sequence[int]) -> str:
    return f"({' x '.join(map(str, sizes))})" if len(sizes) else "(one number)"


def _check_kind(network: Network, trained: Network, weights: str) -> None:
    if network.config.name != trained.config.name:
        raise ConfigError(
            f"training.start: {weights} is a {trained.config.name}, the experiment's detector a {network.config.name}. "
            "Choose weights of the same detector."
        )


def _undeclared_rows(network: Network, trained: Network | None) -> set[str]:
    """Tensors that may be of other classes, where the detector does not say which rows belong to which: its head's.

    Raises:
        ConfigError: If it has no head by that name.
    """
    if trained is None or network.class_rows() or network.config.class_names == trained.config.class_names:
        return set()
    names = {name for name in network.state_dict() if name.startswith("head.")}
    if not names:
        raise ConfigError(
            f"training.start: the classes differ, and {network.config.name} says neither class_rows() nor has it a "
            "submodule head. Define class_rows() in its network, or keep the weights' classes."
        )
    return names


def _pairs(
    own_rows: tuple[int, Sequence[Any]] | None,
    source_rows: tuple[int, Sequence[Any]] | None,
    own: Tensor,
    other: Tensor,
    like: Mapping[str, str],
) -> tuple[int, list[int], list[int], str] | str | None:
    """Rows to take, their rows there, their axis, in words; None for the whole, a text for nothing and why."""
    shapes = f"{tuple(other.shape)} there, {tuple(own.shape)} here"
    if own_rows is None or source_rows is None or list(own_rows[1]) == list(source_rows[1]):
        return None if own.shape == other.shape else shapes
    (axis, names), (_, others) = own_rows, source_rows
    rest, rest_there = (tuple(t.shape[:axis] + t.shape[axis + 1 :]) for t in (own, other))
    if rest != rest_there or len(names) != own.shape[axis] or len(others) != other.shape[axis]:
        return shapes
    row_of, pairs, sized = {name: row for row, name in enumerate(others)}, list[tuple[int, int]](), dict[str, str]()
    for row, name in enumerate(names):
        if name not in row_of and isinstance(name, AnchorRow) and name.label in like:
            sized[name.label] = like[name.label]
            name = name._replace(label=like[name.label])
        if name in row_of:
            pairs.append((row, row_of[name]))
    description = "".join(f"; anchor of {new} from {old}, nearest in size" for new, old in sized.items())
    return (axis, [row for row, _ in pairs], [row for _, row in pairs], description) if pairs else "no class of theirs"


def nearest_sizes(own_m: Mapping[str, Sequence[float]], source_m: Mapping[str, Sequence[float]]) -> dict[str, str]:
    """For each class that the source does not have, the source's whose anchor is nearest in size.

    Nearest is the least sum, over length, width and height, of the logarithm of the two sizes' ratio, without sign.

    Args:
        own_m: Length, width and height of the network's anchors, metres, by class.
        source_m: The same of the source's.
    """
    nearest = {}
    for name, size_m in own_m.items():
        if name not in source_m and source_m:
            distance = {
                other: sum(abs(math.log(a / b)) for a, b in zip(size_m, other_m, strict=True))
                for other, other_m in source_m.items()
            }
            nearest[name] = min(distance, key=distance.__getitem__)
    return nearest


def _differences(source: Mapping[str, Any], own: Mapping[str, Any], where: str = "") -> Iterator[str]:
    """Settings in which two configurations differ, but for those that only choose boxes."""
    for name in dict.fromkeys([*source, *own]):
        old, new, key = source.get(name), own.get(name), f"{where}{name}"
        if isinstance(old, dict) and isinstance(new, dict):
            yield from _differences(old, new, f"{key}.")
        elif key not in _SHAPELESS and _words(old) != _words(new):
            yield f"{key}: {_words(old)}, now {_words(new)}"


def _words(value: Any) -> str:
    """A setting's value as a user writes it, its numbers to six digits.

    >>> _words({"size_m": (0.8, 0.4), "z_m": -0.3999999999999999}), _words(None)
    ('size_m 0.8 x 0.4, z_m -0.4', 'none')
    """
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(part)}" for name, part in value.items())
    if isinstance(value, list | tuple):
        return " x ".join(map(_words, value))
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


# One tensor made to fit another network's. A response is preserved where it can be: a new column starts at zero, an
# average over columns is scaled by their number, a smaller kernel lies in the middle of a larger one of zeros.

_SPARSE_KERNELS = {1: (0, 0), 9: (0, 1), 27: (1, 1)}  # offsets of a sparse convolution: half sizes along z, and x and y
_Named = tuple[int, Sequence[Any]] | None


def by_columns(
    own: Tensor, other: Tensor, own_columns: _Named, source_columns: _Named
) -> tuple[Tensor, int, str] | None:
    """Columns of the input taken by their names; new ones start at zero, those that are gone are dropped.

    Args:
        own: The tensor to fit.
        other: The source's.
        own_columns: Axis of its columns, and their names.
        source_columns: The same of the source.

    Returns:
        The values, how many of them were taken, and what was done; None where names or shapes do not allow it.
    """
    if own_columns is None or source_columns is None or own_columns[0] != source_columns[0]:
        return None
    (axis, names), (_, others) = own_columns, source_columns
    if not _alike_but(own, other, axis) or own.shape[axis] != len(names) or other.shape[axis] != len(others):
        return None
    column_of = {name: number for number, name in enumerate(others)}
    here = [number for number, name in enumerate(names) if name in column_of]
    if not here:
        return None
    value = torch.zeros_like(own)
    rows = other.to(own.dtype).movedim(axis, 0)
    value.movedim(axis, 0)[here] = rows[[column_of[names[number]] for number in here]]
    new = [str(name) for name in names if name not in column_of]
    gone = [str(name) for name in others if name not in set(names)]
    changes = [
        f"{word} {', '.join(columns[:4])}" + (f" and {len(columns) - 4} more" if len(columns) > 4 else "")
        for word, columns in (("at zero:", new), ("dropped:", gone))
        if columns
    ]
    description = f"columns by name; {'; '.join(changes)}" if changes else "columns by name, in another order"
    return value, own.numel() // own.shape[axis] * len(here), description


def by_average(own: Tensor, other: Tensor, axis: int = 1) -> tuple[Tensor, int, str] | None:
    """The mean over their columns in each of ours, scaled by old over new: the response to equal columns stays.

    Args:
        own: The tensor to fit.
        other: The source's.
        axis: Of the columns.

    Returns:
        As :func:`by_columns`.
    """
    if not _alike_but(own, other, axis):
        return None
    old, new = other.shape[axis], own.shape[axis]
    mean = other.to(own.dtype).sum(axis, keepdim=True) / new
    return mean.expand_as(own).clone(), own.numel(), f"the mean of {old} columns in each of {new}"


def by_kernel(own: Tensor, other: Tensor) -> tuple[Tensor, int, str] | None:
    """A kernel of another odd size, or of two dimensions for one of three, laid into the middle.

    Args:
        own: A convolution's weights, shape (out, in, *kernel), or a sparse one's, shape (offsets, in, out).
        other: The source's.

    Returns:
        As :func:`by_columns`.
    """
    if own.ndim == 3 and other.ndim == 3 and own.shape[1:] == other.shape[1:]:
        own_grid, source_grid = _sparse_grid(own), _sparse_grid(other)
        if own_grid is None or source_grid is None:
            return None
        value = _centred(own_grid, source_grid)
        count = min(own.shape[0], other.shape[0]) * own[0].numel()
        return value.movedim((2, 3, 4), (0, 1, 2)).reshape(own.shape), count, _sizes(own.shape[:1], other.shape[:1])
    if own.ndim < 3 or own.shape[:2] != other.shape[:2] or own.ndim - other.ndim not in (0, 1):
        return None
    deep = other[:, :, None] if own.ndim > other.ndim else other
    if any(size % 2 == 0 for size in (*own.shape[2:], *deep.shape[2:])):
        return None  # even kernels have no middle
    value = _centred(own, deep)
    common = [min(a, b) for a, b in zip(own.shape[2:], deep.shape[2:], strict=True)]
    count = own.shape[0] * own.shape[1] * int(torch.tensor(common).prod())
    return value, count, _sizes(own.shape[2:], other.shape[2:])


def _sizes(own: Sequence[int], other: Sequence[int]) -> str:
    there, here = (" x ".join(map(str, sizes)) for sizes in (other, own))
    return f"kernel of {there} in the middle of {here}"


def _sparse_grid(weight: Tensor) -> Tensor | None:
    """A sparse convolution's weights as (in, out, kz, kx, ky), if its offsets are a cube's, a layer's or one."""
    if weight.shape[0] not in _SPARSE_KERNELS:
        return None
    half_z, half = _SPARSE_KERNELS[weight.shape[0]]
    sizes = (2 * half_z + 1, 2 * half + 1, 2 * half + 1)
    return weight.view(*sizes, *weight.shape[1:]).movedim((0, 1, 2), (2, 3, 4))


def _centred(own: Tensor, other: Tensor) -> Tensor:
    """A kernel's middle in the middle of zeros, of the same number of dimensions."""
    value = torch.zeros_like(own)
    here, there = [slice(None)] * 2, [slice(None)] * 2
    for own_size, other_size in zip(own.shape[2:], other.shape[2:], strict=True):
        size = min(own_size, other_size)
        here.append(slice((own_size - size) // 2, (own_size + size) // 2))
        there.append(slice((other_size - size) // 2, (other_size + size) // 2))
    value[tuple(here)] = other[tuple(there)].to(own.dtype)
    return value


def _alike_but(own: Tensor, other: Tensor, axis: int) -> bool:
    """Whether two tensors have the same shape but for one axis."""
    if own.ndim != other.ndim or own.ndim <= axis:
        return False
    return all(a == b for k, (a, b) in enumerate(zip(own.shape, other.shape, strict=True)) if k != axis)
