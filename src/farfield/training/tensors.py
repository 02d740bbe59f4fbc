"""One tensor of trained weights made to fit another network's: other columns of the input, other kernels, other rows.

A response is kept where it can be: a new column starts at zero, an average over columns is scaled by their number, a
smaller kernel lies in the middle of a larger one of zeros.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

_SPARSE_KERNELS = {1: (0, 0), 9: (0, 1), 27: (1, 1)}  # offsets of a sparse convolution: half sizes along z, and x and y
_Named = tuple[int, Sequence[Any]] | None


def by_columns(own: Tensor, other: Tensor, mine: _Named, theirs: _Named) -> tuple[Tensor, int, str] | None:
    """Columns of the input taken by their names; new ones start at zero, those that are gone are dropped.

    Args:
        own: The tensor to fit.
        other: Theirs.
        mine: Axis of its columns, and their names.
        theirs: The same of theirs.

    Returns:
        The values, how many of them were taken, and what was done; None where names or shapes do not allow it.
    """
    if mine is None or theirs is None or mine[0] != theirs[0]:
        return None
    (axis, names), (_, others) = mine, theirs
    if not _alike_but(own, other, axis) or own.shape[axis] != len(names) or other.shape[axis] != len(others):
        return None
    place = {name: number for number, name in enumerate(others)}
    here = [number for number, name in enumerate(names) if name in place]
    if not here:
        return None
    value = torch.zeros_like(own)
    rows = other.to(own.dtype).movedim(axis, 0)
    value.movedim(axis, 0)[here] = rows[[place[names[number]] for number in here]]
    new = [str(name) for name in names if name not in place]
    gone = [str(name) for name in others if name not in set(names)]
    words = [f"{word} {_few(found)}" for word, found in (("at zero:", new), ("dropped:", gone)) if found]
    said = f"columns by name; {'; '.join(words)}" if words else "columns by name, in another order"
    return value, own.numel() // own.shape[axis] * len(here), said


def by_average(own: Tensor, other: Tensor, axis: int = 1) -> tuple[Tensor, int, str] | None:
    """The mean over their columns in each of ours, scaled by old over new: the response to equal columns stays.

    Args:
        own: The tensor to fit.
        other: Theirs.
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
    """A kernel of another odd size, or of two dimensions where three are wanted, laid into the middle.

    Args:
        own: A convolution's weights, shape (out, in, *kernel), or a sparse one's, shape (offsets, in, out).
        other: Theirs.

    Returns:
        As :func:`by_columns`.
    """
    if own.ndim == 3 and other.ndim == 3 and own.shape[1:] == other.shape[1:]:
        mine, theirs = _sparse_grid(own), _sparse_grid(other)
        if mine is None or theirs is None:
            return None
        value = _laid(mine, theirs)
        count = min(own.shape[0], other.shape[0]) * own[0].numel()
        return value.movedim((2, 3, 4), (0, 1, 2)).reshape(own.shape), count, _sizes(own.shape[:1], other.shape[:1])
    if own.ndim < 3 or own.shape[:2] != other.shape[:2] or own.ndim - other.ndim not in (0, 1):
        return None
    flat = other[:, :, None] if own.ndim > other.ndim else other
    if any(size % 2 == 0 for size in (*own.shape[2:], *flat.shape[2:])):
        return None  # even kernels have no middle
    value = _laid(own, flat)
    common = [min(a, b) for a, b in zip(own.shape[2:], flat.shape[2:], strict=True)]
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


def _laid(own: Tensor, other: Tensor) -> Tensor:
    """A kernel's middle in the middle of zeros, of the same number of dimensions."""
    value = torch.zeros_like(own)
    here, there = [slice(None)] * 2, [slice(None)] * 2
    for mine, theirs in zip(own.shape[2:], other.shape[2:], strict=True):
        size = min(mine, theirs)
        here.append(slice((mine - size) // 2, (mine + size) // 2))
        there.append(slice((theirs - size) // 2, (theirs + size) // 2))
    value[tuple(here)] = other[tuple(there)].to(own.dtype)
    return value


def _alike_but(own: Tensor, other: Tensor, axis: int) -> bool:
    """Whether two tensors have the same shape but for one axis."""
    if own.ndim != other.ndim or own.ndim <= axis:
        return False
    return all(a == b for k, (a, b) in enumerate(zip(own.shape, other.shape, strict=True)) if k != axis)


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
