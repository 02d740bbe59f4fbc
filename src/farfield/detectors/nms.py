"""Rotated non-maximum suppression with the exact IoU of :mod:`farfield.geometry.iou`: in numpy, and on any device.

:func:`rotated_nms` takes boxes on the host, :func:`nms_on_device` rows of a tensor where they are.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from farfield.detectors.devices import constant, kernels_for
from farfield.detectors.suppression import LEAST_IOU
from farfield.detectors.suppression import rotated_nms as rotated_nms
from farfield.geometry.boxes import Boxes

# Rotated suppression in plain PyTorch, on whatever device the boxes are: what :func:`rotated_nms` does in numpy.
#
# The method is that of :mod:`farfield.geometry.iou`, in float64, step by step: both keep the same boxes, but for
# overlaps within rounding (1e-15) of the threshold. Nothing but the number of overlapping pairs, and whether the last
# round changed anything, is copied to the host.

_BEV = (0, 1, 3, 4, 6)  # x, y, length, width, yaw of a row x, y, z, length, width, height, yaw
_SIGNS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
_PAIRS = 2**18  # at a time: float64 temporaries of 8 MiB
_GAPS = 2**22  # distances at a time
_ROUNDS = 4  # between two looks at whether anything changed
_LEAST_RISE = 1e-250
_MOST_BITS = 2**14  # boxes whose pairs a GPU writes down, a bit each in words of 32: 67 MB


def bev_intersection_m2(a: Tensor, b: Tensor) -> Tensor:
    """Area that the rectangles of each pair share; see :func:`farfield.geometry.iou.bev_intersection_m2`.

    Args:
        a: Rectangles as x, y, length, width (metres), yaw (radians), shape (n, 5), float64.
        b: The other rectangle of each pair, shape (n, 5), float64.

    Returns:
        Areas in square metres, shape (n,), float64.
    """
    at, bt = a.unbind(1), b.unbind(1)
    cos_b, sin_b = torch.cos(bt[4]), torch.sin(bt[4])
    dx, dy = at[0] - bt[0], at[1] - bt[1]
    x_centre, y_centre = dx * cos_b + dy * sin_b, dy * cos_b - dx * sin_b
    turn = at[4] - bt[4]
    cos, sin = torch.cos(turn), torch.sin(turn)
    half_l, half_w, x_max, y_max = at[2] / 2, at[3] / 2, bt[2] / 2, bt[3] / 2
    s, t = constant(_SIGNS, a.device)[:, :, None].unbind(1)
    xs = x_centre + s * (half_l * cos) + t * (-half_w * sin)
    ys = y_centre + s * (half_l * sin) + t * (half_w * cos)
    edges = _clamped_integral(xs, ys, xs.roll(-1, 0), ys.roll(-1, 0), x_max, y_max)
    area = 0.0 - edges[0] - edges[1] - edges[2] - edges[3]
    return torch.minimum(area.clamp(min=0.0), torch.minimum(at[2] * at[3], bt[2] * bt[3]))


def _clamped_integral(x0: Tensor, y0: Tensor, x1: Tensor, y1: Tensor, x_max: Tensor, y_max: Tensor) -> Tensor:
    """Signed integrals of clamp(y, -y_max, y_max) over each edge's part with |x| <= x_max, shape (4, n)."""
    run = x1 - x0
    slope = (y1 - y0) / torch.where(run == 0, 1.0, run)
    left, right = x0.clamp(-x_max, x_max), x1.clamp(-x_max, x_max)
    y_left, y_right = y0 + (left - x0) * slope, y0 + (right - x0) * slope
    low, high = torch.minimum(y_left, y_right), torch.maximum(y_left, y_right)
    rise = (high - low).clamp(min=_LEAST_RISE)
    below = ((-y_max - low) / rise).clamp(0.0, 1.0)
    above = ((high - y_max) / rise).clamp(0.0, 1.0)
    inside = (low.clamp(-y_max, y_max) + high.clamp(-y_max, y_max)) / 2
    mean = (above - below) * y_max + (1.0 - below - above) * inside
    return (right - left) * mean


def bev_iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of the rectangles of each pair, shape (n,); arguments as of the intersection."""
    shared = bev_intersection_m2(a, b)
    union = a[:, 2] * a[:, 3] + b[:, 2] * b[:, 3] - shared
    return torch.where(union > 0, shared / torch.where(union > 0, union, 1.0), 0.0).clamp(0.0, 1.0)


def overlapping_pairs(ranked: Tensor, iou_threshold: float) -> tuple[Tensor, Tensor]:
    """Pairs of boxes that overlap by more than a threshold: the better one of each and the worse, (p,), int64.

    Args:
        ranked: Boxes as x, y, z, length, width, height, yaw, best first, shape (n, 7), float64.
        iou_threshold: As of :func:`nms_on_device`.
    """
    rectangles = torch.stack([ranked[:, index] for index in _BEV], 1)
    radius_m = torch.hypot(rectangles[:, 2], rectangles[:, 3]) / 2
    number = torch.arange(len(rectangles), device=rectangles.device)
    pairs_over = [number.new_zeros(2, 0)]
    for rows in number.split(max(1, _GAPS // max(len(rectangles), 1))):
        gap = torch.hypot(
            rectangles[rows, 0, None] - rectangles[None, :, 0], rectangles[rows, 1, None] - rectangles[None, :, 1]
        )
        near = (gap < radius_m[rows, None] + radius_m[None]) & (rows[:, None] < number[None])
        for pairs in near.nonzero().split(_PAIRS):
            better, worse = rows[pairs[:, 0]], pairs[:, 1]
            over = (bev_iou(rectangles[better], rectangles[worse]) > max(iou_threshold, LEAST_IOU)).nonzero().squeeze(1)
            pairs_over.append(torch.stack([better[over], worse[over]]))
    better, worse = torch.cat(pairs_over, 1)
    return better, worse


def nms_on_device(rows: Tensor, score: Tensor, *, iou_threshold: float, limit: int = 500) -> Tensor:
    """Greedy suppression in bird's-eye view, as :func:`farfield.detectors.nms.rotated_nms`, on the boxes' device.

    A box stays if no better one that stays overlaps it. That rule is applied to all boxes at once, again and again,
    until nothing changes: it settles whatever depends on a chain of k boxes in k rounds.

    Args:
        rows: Boxes as x, y, z, length, width, height, yaw, shape (n, 7), float64.
        score: Shape (n,).
        iou_threshold: A box that overlaps a better one by more than this is dropped.
        limit: Keep at most this many.

    Returns:
        Indices of the kept boxes, best first, shape (k,), int64.
    """
    order = torch.sort(score, descending=True, stable=True).indices
    return order[surviving_boxes(rows[order], iou_threshold)[:limit]]


def surviving_boxes(ranked: Tensor, iou_threshold: float) -> Tensor:
    """Which of the boxes stay, ascending, shape (k,), int64.

    Args:
        ranked: As of :func:`overlapping_pairs`.
        iou_threshold: As of :func:`nms_on_device`.
    """
    kernels = kernels_for(ranked.device, "triton_nms")
    if kernels is not None and len(ranked) <= _MOST_BITS:
        limits = constant((max(float(iou_threshold), LEAST_IOU),), ranked.device)
        index: Tensor = kernels.surviving_boxes(ranked, limits, _LEAST_RISE).nonzero().squeeze(1)
        return index
    better, worse = overlapping_pairs(ranked, iou_threshold)
    alive = torch.ones(len(ranked), device=ranked.device)
    settled = len(better) == 0
    while not settled:
        before = alive
        for _ in range(_ROUNDS):
            before, alive = alive, (torch.zeros_like(alive).index_add_(0, worse, alive[better]) == 0).to(alive.dtype)
        settled = torch.equal(before, alive)
    return (alive > 0).nonzero().squeeze(1)


def boxes_after_nms(
    ranked: Tensor, score: Tensor, kind: Tensor, names: Sequence[str], *, iou_threshold: float, limit: int
) -> Boxes:
    """What is left of a frame's boxes after suppression, best first: the one copy to the host.

    Args:
        ranked: As of :func:`overlapping_pairs`.
        score: Shape (n,), descending.
        kind: Number of each box's class, shape (n,), int64.
        names: The classes.
        iou_threshold: As of :func:`nms_on_device`.
        limit: As of :func:`nms_on_device`.
    """
    index = surviving_boxes(ranked, iou_threshold)[:limit]
    packed = torch.cat([ranked, score[:, None].double(), kind[:, None].double()], 1)[index].cpu().numpy()
    return Boxes(
        centre_m=packed[:, :3],
        size_m=packed[:, 3:6],
        yaw_rad=packed[:, 6],
        label=np.array(names, dtype=np.str_)[packed[:, 8].astype(np.int64)],
        score=packed[:, 7],
    )


def wrap_angle(angle_rad: Tensor) -> Tensor:
    """Angles in [-pi, pi), as :func:`farfield.geometry.boxes.wrap_angle_rad`."""
    turned = torch.remainder(angle_rad + torch.pi, 2 * torch.pi) - torch.pi
    turned = torch.where(turned >= torch.pi, -torch.pi, turned)
    return torch.where((angle_rad >= -torch.pi) & (angle_rad < torch.pi), angle_rad, turned)
