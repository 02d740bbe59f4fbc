"""Targets on a sparse map: boxes assigned to occupied cells, their codes, and the losses of both.

Distances on the ground decide, since a cell of the map is where points fell or a vote landed, not where a grid has one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from farfield.detectors.contract import range_weights
from farfield.detectors.device_nms import wrapped
from farfield.geometry.boxes import Boxes

_LOG_SIZE = (float(np.log(0.05)), float(np.log(40.0)))


@dataclass(frozen=True, eq=False)
class CentreTargets:
    """The boxes of one frame.

    Args:
        centre_m: Centres, shape (n, 3).
        size_m: Length, width, height, shape (n, 3).
        yaw_rad: Headings, shape (n,).
        kind: Numbers of the classes, shape (n,).
        weight: Weight of each box in the loss, shape (n,).
    """

    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]

    def ignoring(self, unsure: "CentreTargets") -> "CentreTargets":
        """These targets and, with no weight, those of unsure boxes: near them hardly anything is background.

        Args:
            unsure: The targets of the unsure boxes.
        """
        return CentreTargets(
            np.concatenate([self.centre_m, unsure.centre_m]),
            np.concatenate([self.size_m, unsure.size_m]),
            np.concatenate([self.yaw_rad, unsure.yaw_rad]),
            np.concatenate([self.kind, unsure.kind]),
            np.concatenate([self.weight, np.zeros_like(unsure.weight)]),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxesOfClasses:
    """The boxes of a frame that are of the detector's classes and have their centre on the map.

    Args:
        classes: Names by number.
        shape: Cells of the map along x and y.
        cell_m: Edge length of a cell.
        y_min_m: Right edge of the map.
        far_weight: Extra weight of a box per 100 m of range.
    """

    classes: tuple[str, ...]
    shape: tuple[int, int]
    cell_m: float
    y_min_m: float
    far_weight: float = 0.0

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> CentreTargets:
        """Targets of one frame; its points are not looked at."""
        del inputs
        names, (nx, ny) = self.classes, self.shape
        kind = np.array([names.index(name) if name in names else -1 for name in boxes.label], dtype=np.int64)
        x, y = boxes.centre_m[:, 0], boxes.centre_m[:, 1] - self.y_min_m
        here = (kind >= 0) & (x >= 0) & (x < nx * self.cell_m) & (y >= 0) & (y < ny * self.cell_m)
        kept = boxes[here]
        return CentreTargets(kept.centre_m, kept.size_m, kept.yaw_rad, kind[here], range_weights(kept, self.far_weight))


class BoxTensors(NamedTuple):
    """The boxes of one frame as tensors, float32; see :class:`CentreTargets`."""

    centre_m: Tensor
    size_m: Tensor
    yaw_rad: Tensor
    kind: Tensor
    weight: Tensor

    @classmethod
    def of(cls, target: CentreTargets, device: torch.device) -> "BoxTensors":
        """Copy a frame's targets to the device."""
        floats = [target.centre_m, target.size_m, target.yaw_rad, target.weight]
        centre, size, yaw, weight = (torch.from_numpy(np.asarray(part)).float().to(device) for part in floats)
        return cls(centre, size, yaw, torch.from_numpy(target.kind).to(device), weight)


class Assignment(NamedTuple):
    """Targets of the n occupied cells of a frame.

    Attributes:
        heat: Target heat, shape (n, classes): 1 at the cell nearest to a box's centre, a Gaussian around it.
        heat_weight: Weight of that one, zero elsewhere, shape (n, classes).
        cell: Rows of the cells that learn a box, shape (k,).
        box: Which box each of them learns, shape (k,).
        weight: Their weights; those of one box add up to the box's weight, shape (k,).
    """

    heat: Tensor
    heat_weight: Tensor
    cell: Tensor
    box: Tensor
    weight: Tensor


def assign(
    place_m: Tensor, truth: BoxTensors, classes: int, *, gaussian_m: float, assign_m: float, box_m: float
) -> Assignment:
    """Assign a frame's boxes to its occupied cells by distance on the ground.

    Args:
        place_m: Centres of the cells, shape (n, 2).
        truth: The boxes.
        classes: Number of classes.
        gaussian_m: Standard deviation of the heat around a centre.
        assign_m: A box with no occupied cell this near has no target.
        box_m: Cells this near to a centre learn its box, beside the nearest one.
    """
    heat, heat_weight = place_m.new_zeros(2, len(place_m), classes).unbind(0)
    if len(place_m) == 0 or len(truth.kind) == 0:
        none = truth.kind.new_zeros(0)
        return Assignment(heat, heat_weight, none, none, place_m.new_zeros(0))
    gap = (place_m[:, None] - truth.centre_m[None, :, :2]).norm(dim=2)
    bell = torch.exp(-0.5 * (gap / gaussian_m) ** 2)
    heat = heat.scatter_reduce(1, truth.kind.expand_as(bell), bell, "amax")
    least, nearest = gap.min(0)
    reached = least <= assign_m
    peak = nearest[reached] * classes + truth.kind[reached]
    heat_weight = heat_weight.view(-1).scatter_reduce(0, peak, truth.weight[reached], "amax").view_as(heat)
    heat = torch.where(heat_weight > 0, 1.0, heat)
    assigned = gap <= box_m
    assigned[nearest[reached], reached.nonzero().squeeze(1)] = True
    box = torch.where(assigned, gap, torch.inf).argmin(1)
    cell = assigned.any(1).nonzero().squeeze(1)
    box = box[cell]
    share = torch.bincount(box, minlength=len(truth.kind)).clamp(min=1)
    return Assignment(heat, heat_weight, cell, box, (truth.weight / share)[box])


def heat_loss(logits: Tensor, heat: Tensor, weight: Tensor) -> Tensor:
    """Penalty-reduced focal loss, summed (CornerNet, arXiv 1808.01244, equation 1, alpha 2 and beta 4).

    Args:
        logits: Shape (n, classes).
        heat: Target heat in [0, 1], shape (n, classes).
        weight: Weight of the positives, zero at all others, shape (n, classes).
    """
    logits = logits.float()
    score = torch.sigmoid(logits)
    as_positive = weight * (1 - score) ** 2 * functional.softplus(-logits)
    as_negative = (1 - heat) ** 4 * score**2 * functional.softplus(logits)
    return (as_positive + torch.where(weight > 0, 0.0, as_negative)).sum()


def vote_loss(votes: Tensor, place_m: Tensor, truth: BoxTensors, cell_m: float) -> tuple[Tensor, Tensor]:
    """Focal loss on the foreground and smooth L1 on the step to the centre, summed; each box counts the same.

    A cell is foreground where its centre lies in a box that is half a cell larger on every side.

    Args:
        votes: Foreground logit and step, shape (n, 3).
        place_m: Centres of the cells, shape (n, 2).
        truth: The boxes.
        cell_m: Edge length of a cell.
    """
    votes, count = votes.float(), len(truth.kind)
    away = place_m[:, None] - truth.centre_m[None, :, :2]
    cos, sin = torch.cos(truth.yaw_rad), torch.sin(truth.yaw_rad)
    local = torch.stack([away[..., 0] * cos + away[..., 1] * sin, away[..., 1] * cos - away[..., 0] * sin], 2)
    inside = (local.abs() <= (truth.size_m[:, :2] + cell_m) / 2).all(2)
    cell = inside.any(1).nonzero().squeeze(1)
    gap = torch.where(inside, away.norm(dim=2), torch.inf)[cell]
    box = gap.argmin(1) if len(cell) else truth.kind.new_zeros(0)
    weight = (truth.weight / torch.bincount(box, minlength=count).clamp(min=1))[box]
    logits, right = votes[:, 0], votes[cell, 0]
    negative = torch.sigmoid(logits) ** 2 * functional.softplus(logits)
    positive = weight * torch.sigmoid(-right) ** 2 * functional.softplus(-right)
    step = -away[cell, box] / cell_m
    error = functional.smooth_l1_loss(votes[cell, 1:], step, beta=1 / 9, reduction="none").sum(1)
    return positive.sum() + negative.sum() - negative[cell].sum(), (error * weight).sum()


def encode(truth: BoxTensors, box: Tensor, place_m: Tensor, height_m: Tensor, cell_m: float) -> Tensor:
    """Target codes of cells, shape (k, 10).

    Offset of the centre in cells, height of the centre above the cell's reference height (metres), logarithm of the
    size, sine and cosine of twice the yaw (the axis, which any view shows) and of the yaw (which end is the front).

    Args:
        truth: The boxes.
        box: Which box each cell is assigned to, shape (k,).
        place_m: Centres of the cells, shape (k, 2).
        height_m: Reference heights of the cells, shape (k,).
        cell_m: Edge length of a cell.
    """
    yaw = truth.yaw_rad[box]
    centre = truth.centre_m[box]
    turns = torch.stack([torch.sin(2 * yaw), torch.cos(2 * yaw), torch.sin(yaw), torch.cos(yaw)], 1)
    offset = (centre[:, :2] - place_m) / cell_m
    return torch.cat([offset, (centre[:, 2] - height_m)[:, None], torch.log(truth.size_m[box]), turns], 1)


def decode(codes: Tensor, place_m: Tensor, height_m: Tensor, cell_m: float) -> Tensor:
    """Invert :func:`encode`: rows x, y, z, l, w, h, yaw, shape (k, 7), float64."""
    codes = codes.double()
    size = torch.exp(codes[:, 3:6].clamp(*_LOG_SIZE))
    yaw = torch.atan2(codes[:, 6], codes[:, 7]) / 2
    backwards = torch.sin(yaw) * codes[:, 8] + torch.cos(yaw) * codes[:, 9] < 0
    yaw = wrapped(yaw + torch.pi * backwards)
    z = height_m.double() + codes[:, 2]
    return torch.cat([place_m.double() + codes[:, :2] * cell_m, z[:, None], size, yaw[:, None]], 1)
