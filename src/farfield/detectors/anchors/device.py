"""Boxes of anchors on the device that the maps are on: what :mod:`farfield.detectors.anchors.grid` does, in PyTorch."""

import math
from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor

from farfield.detectors.anchors.best import best_anchors
from farfield.detectors.anchors.grid import DIRECTION_OFFSET_RAD, SIZE_RATIOS, AnchorGrid
from farfield.detectors.device_nms import kept_boxes, wrapped
from farfield.detectors.devices import constant
from farfield.detectors.triton_jit import kernels_for
from farfield.geometry.boxes import Boxes

_NEARLY_ONE = 1 - 1e-9  # an encoded residual of exactly pi/2 is not wrapped


def anchor_rows(grid: AnchorGrid, index: Tensor) -> Tensor:
    """The anchors with these flat indices, shape (k,), as x, y, z, l, w, h, yaw, shape (k, 7), float64."""
    cell, slot = index // grid.per_cell, index % grid.per_cell
    kind, heading = slot // 2, slot % 2
    ix, iy = cell // grid.ny, cell % grid.ny
    place = [
        i.double() * float(step) + float(first)
        for i, step, first in zip((ix, iy), grid.step_m, grid.first_m, strict=True)
    ]
    kinds = [(float(z), *map(float, size)) for z, size in zip(grid.z_m, grid.sizes_m, strict=True)]
    headings = constant(tuple(map(float, grid.headings_rad)), index.device)
    return torch.cat([torch.stack(place, 1), constant(tuple(kinds), index.device)[kind], headings[heading, None]], 1)


def decode(code: Tensor, backwards: Tensor, anchors: Tensor) -> Tensor:
    """Boxes of codes, as :func:`farfield.detectors.anchors.grid.decode`: rows x, y, z, l, w, h, yaw, shape (k, 7)."""
    diagonal = torch.hypot(anchors[:, 3], anchors[:, 4])
    centre = code[:, :3] * torch.stack([diagonal, diagonal, anchors[:, 5]], 1) + anchors[:, :3]
    least, most = map(math.log, SIZE_RATIOS)
    size = torch.exp(code[:, 3:6].clamp(least, most)) * anchors[:, 3:6]
    half_turns = torch.round(code[:, 6] / math.pi * _NEARLY_ONE)
    yaw = wrapped(anchors[:, 6] + (code[:, 6] - math.pi * half_turns) + math.pi * backwards.double())
    return torch.cat([centre, size, yaw[:, None]], 1)


def decoded(grid: AnchorGrid, codes: Tensor, directions: Tensor, index: Tensor) -> Tensor:
    """Boxes of the anchors with these numbers, as :meth:`AnchorGrid.decode`.

    Args:
        grid: The anchors.
        codes: Codes of all of them, shape (n, 7).
        directions: Both directions' logits of all of them, shape (n, 2).
        index: Which to decode, shape (k,), int64.

    Returns:
        Rows x, y, z, l, w, h, yaw, shape (k, 7), float64.
    """
    kernels = kernels_for(codes.device, "anchors.triton_decode")
    if kernels is not None:
        return cast(Tensor, kernels.decoded(codes, directions, index, **constants(grid, codes.device)))
    code, direction = codes[index].double(), (directions[index, 1] > directions[index, 0]).long()
    anchors = anchor_rows(grid, index)
    if grid.style == "farfield":
        return decode(code, direction, anchors)
    rows = decode(code, torch.zeros_like(direction), anchors)
    fixed = torch.remainder(rows[:, 6] - DIRECTION_OFFSET_RAD, 2 * math.pi) >= math.pi
    turned = wrapped(rows[:, 6] + math.pi * (fixed.long() != direction).double())
    return torch.cat([rows[:, :6], turned[:, None]], 1)


def constants(grid: AnchorGrid, device: torch.device) -> dict[str, Any]:
    """The anchors' numbers as the kernel takes them."""
    kinds = [(float(z), *map(float, size)) for z, size in zip(grid.z_m, grid.sizes_m, strict=True)]
    place_m = (*map(float, grid.step_m), *map(float, grid.first_m))
    return {
        "place": constant((*place_m, math.pi, *map(math.log, SIZE_RATIOS), DIRECTION_OFFSET_RAD, _NEARLY_ONE), device),
        "kinds": constant(tuple(kinds), device),
        "headings": constant(tuple(map(float, grid.headings_rad)), device),
        "per_cell": grid.per_cell,
        "ny": grid.ny,
        "fixed": grid.style != "farfield",
    }


def boxes_there(maps: Sequence[Tensor], grid: AnchorGrid, config: Any) -> list[Boxes]:
    """The boxes of each frame after suppression, best first, without a copy of anything else to the host.

    Args:
        maps: Logits, codes and directions of :class:`~farfield.detectors.anchors.head.AnchorMaps`.
        grid: The anchors.
        config: The head's settings.
    """
    return [_frame(one, grid, config) for one in zip(*maps, strict=True)]


def _frame(maps: tuple[Tensor, ...], grid: AnchorGrid, config: Any) -> Boxes:
    logits, codes, directions = maps
    index, score = best_anchors(logits, limit=config.candidates, score_threshold=config.score_threshold)
    number = index % grid.per_cell // 2 if logits.ndim == 1 else logits[index].argmax(1)
    rows = decoded(grid, codes, directions, index)
    return kept_boxes(rows, score, number, grid.names, iou_threshold=config.nms_iou, limit=config.max_boxes)
