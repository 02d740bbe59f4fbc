"""Rotated suppression on a GPU in two kernels, written in Triton; see :mod:`farfield.detectors.nms`.

The plain version takes some hundred calls, and on a GPU the calls are the cost. The same formulae, in float64: the
first kernel says of all pairs which box suppresses which, a bit each; the second settles what stays.
"""

from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from farfield.detectors.devices import jit

triton: Any = import_module("triton")
tl: Any = import_module("triton.language")

_BITS = 32  # boxes to a word
_WORDS = 4096  # that the second kernel reads at once


@jit
def _edge(x0, y0, x1, y1, x_max, y_max, least_rise: tl.constexpr):  # type: ignore[no-untyped-def]
    """The signed integral of clamp(y, -y_max, y_max) over an edge's part with |x| <= x_max."""
    run = x1 - x0
    slope = (y1 - y0) / tl.where(run == 0, 1.0, run)
    left = tl.minimum(tl.maximum(x0, -x_max), x_max)
    right = tl.minimum(tl.maximum(x1, -x_max), x_max)
    y_left, y_right = y0 + (left - x0) * slope, y0 + (right - x0) * slope
    low, high = tl.minimum(y_left, y_right), tl.maximum(y_left, y_right)
    rise = tl.maximum(high - low, least_rise)
    below = tl.minimum(tl.maximum((-y_max - low) / rise, 0.0), 1.0)
    above = tl.minimum(tl.maximum((high - y_max) / rise, 0.0), 1.0)
    inside = (tl.minimum(tl.maximum(low, -y_max), y_max) + tl.minimum(tl.maximum(high, -y_max), y_max)) / 2
    mean = (above - below) * y_max + (1.0 - below - above) * inside
    return (right - left) * mean


@jit
def _overlap_kernel(  # type: ignore[no-untyped-def]
    rows, limits, bits, count, words, width: tl.constexpr, least_rise: tl.constexpr
):
    first, word = tl.program_id(0) * width, tl.program_id(1)
    one, other = first + tl.arange(0, width), word * width + tl.arange(0, width)
    one_in, other_in = one < count, other < count
    a, b = rows + one * 7, rows + other * 7
    ax, ay = tl.load(a, mask=one_in, other=0.0), tl.load(a + 1, mask=one_in, other=0.0)
    al, aw = tl.load(a + 3, mask=one_in, other=0.0), tl.load(a + 4, mask=one_in, other=0.0)
    bx, by = tl.load(b, mask=other_in, other=0.0), tl.load(b + 1, mask=other_in, other=0.0)
    bl, bw = tl.load(b + 3, mask=other_in, other=0.0), tl.load(b + 4, mask=other_in, other=0.0)
    dx, dy = ax[:, None] - bx[None, :], ay[:, None] - by[None, :]
    radius = tl.sqrt(al * al + aw * aw)[:, None] / 2 + tl.sqrt(bl * bl + bw * bw)[None, :] / 2
    near = one_in[:, None] & other_in[None, :] & (one[:, None] < other[None, :]) & (dx * dx + dy * dy < radius * radius)
    bits_of_row = tl.zeros((width,), dtype=tl.int64)
    if tl.max(tl.max(near.to(tl.int32), axis=1), axis=0) > 0:
        a_yaw, b_yaw = tl.load(a + 6, mask=one_in, other=0.0), tl.load(b + 6, mask=other_in, other=0.0)
        cos_b, sin_b = tl.cos(b_yaw)[None, :], tl.sin(b_yaw)[None, :]
        x_centre, y_centre = dx * cos_b + dy * sin_b, dy * cos_b - dx * sin_b
        turn = a_yaw[:, None] - b_yaw[None, :]
        half_l, half_w = al[:, None] / 2, aw[:, None] / 2
        lx, ly = half_l * tl.cos(turn), half_l * tl.sin(turn)
        wx, wy = -half_w * tl.sin(turn), half_w * tl.cos(turn)
        x_max, y_max = bl[None, :] / 2 + 0.0 * dx, bw[None, :] / 2 + 0.0 * dx
        x0, y0 = x_centre + lx + wx, y_centre + ly + wy
        x1, y1 = x_centre - lx + wx, y_centre - ly + wy
        x2, y2 = x_centre - lx - wx, y_centre - ly - wy
        x3, y3 = x_centre + lx - wx, y_centre + ly - wy
        area = 0.0 - _edge(x0, y0, x1, y1, x_max, y_max, least_rise)
        area = area - _edge(x1, y1, x2, y2, x_max, y_max, least_rise)
        area = area - _edge(x2, y2, x3, y3, x_max, y_max, least_rise)
        area = area - _edge(x3, y3, x0, y0, x_max, y_max, least_rise)
        a_m2, b_m2 = (al * aw)[:, None], (bl * bw)[None, :]
        shared = tl.minimum(tl.maximum(area, 0.0), tl.minimum(a_m2, b_m2))
        union = a_m2 + b_m2 - shared
        iou = tl.where(union > 0, shared / tl.where(union > 0, union, 1.0), 0.0)
        bit = tl.full((1, width), 1, tl.int64) << tl.arange(0, width).to(tl.int64)[None, :]
        bits_of_row = tl.sum(tl.where(near & (iou > tl.load(limits)), bit, 0), axis=1)
    tl.store(bits + one.to(tl.int64) * words + word, bits_of_row, mask=one_in)


@jit
def _either(a, b):  # type: ignore[no-untyped-def]
    return a | b


@jit
def _settle_kernel(  # type: ignore[no-untyped-def]
    bits, alive, count, words, width: tl.constexpr, wide: tl.constexpr, block: tl.constexpr
):
    word, lane = tl.arange(0, wide), tl.arange(0, width)
    box = word[:, None] * width + lane[None, :]
    changed = 1
    while changed > 0:
        gone = tl.zeros((wide,), dtype=tl.int64)
        for start in range(0, count, block):
            row = start + tl.arange(0, block)
            stays = tl.load(alive + row, mask=row < count, other=0)
            there = (stays > 0)[:, None] & (word < words)[None, :]
            gone = gone | tl.reduce(
                tl.load(bits + row.to(tl.int64)[:, None] * words + word[None, :], mask=there, other=0), 0, _either
            )
        now = 1 - ((gone[:, None] >> lane.to(tl.int64)[None, :]) & 1).to(tl.int32)
        before = tl.load(alive + box, mask=box < count, other=0)
        now = tl.where(box < count, now, 0)
        changed = tl.max(tl.max((now != before).to(tl.int32), axis=1), axis=0)
        tl.debug_barrier()
        tl.store(alive + box, now, mask=box < count)
        tl.debug_barrier()


def surviving_boxes(rows: Tensor, limits: Tensor, least_rise: float) -> Tensor:
    """Which boxes stay: those that no better box that stays overlaps by more than the threshold.

    Args:
        rows: Boxes as x, y, z, length, width, height, yaw, best first, shape (n, 7), float64.
        limits: The threshold, shape (1,), float64, on the boxes' device.
        least_rise: Stands in for the rise of level edges.

    Returns:
        1 for those that stay, 0 for the others, shape (n,), int32.
    """
    count = len(rows)
    alive = torch.ones(count, dtype=torch.int32, device=rows.device)
    if count < 2:
        return alive
    words = triton.cdiv(count, _BITS)
    bits = torch.empty(count, words, dtype=torch.int64, device=rows.device)
    _overlap_kernel[(words, words)](rows.contiguous(), limits, bits, count, words, _BITS, least_rise)
    wide = triton.next_power_of_2(words)
    _settle_kernel[(1,)](bits, alive, count, words, _BITS, wide, max(1, _WORDS // wide), num_warps=8)
    return alive
