"""Numbers that no training leaves: what is not finite, absurdly large, or a spread below zero."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import Tensor

LARGEST = 1e10
"""No weight is larger; a flipped bit of a float32's exponent makes about 1e36 of 0.01."""
_STATISTICS = ("running_mean", "running_var")
"""Batch statistics are those of what a network reads, such as a radar's power, and may be larger."""


def unsound(tensors: Mapping[str, Tensor]) -> tuple[str, str] | None:
    """The first tensor with a number that no training leaves.

    Args:
        tensors: The state of a network by name, any shapes.

    Returns:
        Its name and what it holds, such as ``("head.weight", "nan at 17 of 64 numbers")``; None if all are sound.
    """
    for name, tensor in tensors.items():
        last = name.rpartition(".")[2]
        wrong = ~torch.isfinite(tensor)
        if last not in _STATISTICS and tensor.is_floating_point():
            wrong |= tensor.abs() > LARGEST
        if last in ("running_var", "num_batches_tracked"):
            wrong |= tensor < 0
        if bool(wrong.any()):
            values = tensor[wrong].reshape(-1)
            return name, f"{float(values[0]):g} in {len(values)} of {tensor.numel()} numbers"
    return None


def unlike(tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> tuple[str, str, str] | None:
    """The first tensor that is lacking, strange, or of another shape or number type than a network's.

    Args:
        tensors: What a file holds, by name.
        expected: The network's state; its values do not matter.

    Returns:
        Its name, what is expected and what stands there instead; None if all are alike.
    """
    for name in (*expected, *tensors):
        there, here = tensors.get(name), expected.get(name)
        if there is None or here is None or there.shape != here.shape or there.dtype != here.dtype or _odd(there):
            kind = f"{there.layout}, without numbers, of " if there is not None and _odd(there) else ""
            return name, _described(here), kind + _described(there)
    return None


def _described(tensor: Tensor | None) -> str:
    if tensor is None:
        return "no such tensor"
    return f"{str(tensor.dtype).removeprefix('torch.')} of shape {tuple(tensor.shape)}"


def _odd(tensor: Tensor) -> bool:
    """Whether a tensor is sparse, or has a shape and no numbers."""
    return tensor.layout != torch.strided or tensor.is_meta


def has_nan(outputs: Any) -> bool:
    """Whether a tensor of a network's outputs holds NaN, which no threshold passes: it would detect nothing.

    Args:
        outputs: A tensor, or tensors in mappings, sequences and dataclasses; other values do not matter.
    """
    return any(bool(torch.isnan(tensor).any()) for tensor in _tensors(outputs))


def _tensors(outputs: Any) -> Iterator[Tensor]:
    """The floating-point tensors within."""
    if isinstance(outputs, Tensor):
        if outputs.is_floating_point():
            yield outputs
        return
    if dataclasses.is_dataclass(outputs):
        outputs = [getattr(outputs, field.name) for field in dataclasses.fields(outputs)]
    elif isinstance(outputs, Mapping):
        outputs = list(outputs.values())
    for part in outputs if isinstance(outputs, list | tuple) else ():
        yield from _tensors(part)
