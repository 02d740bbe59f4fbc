"""Farthest point sampling on a GPU in one kernel, a program a frame; imported for CUDA tensors only, needs Triton.

The plain version launches a handful of kernels for each chosen point, thousands of times. Here one program walks
through a frame's whole sequence. It rounds as the plain version does (same order of sums, none fused), and of equal
gaps the lowest row wins as there, so both choose the same points. Gaps of up to 16,384 points a frame stay in
registers: a step reads the coordinates, which the multiprocessor's cache holds, and searches the largest gap once.
"""

from collections.abc import Sequence

import torch
import triton  # type: ignore[import-not-found,unused-ignore]
import triton.language as tl  # type: ignore[import-not-found,unused-ignore]
from torch import Tensor

from farfield.detectors.devices import sent

_BLOCK = 2048  # points that a program handles at once
_HELD = 16384  # points whose gaps fit in a program's registers
_LEAST = 128  # four parts of a warp
_OF_A_WARP = 128  # points of each part


@triton.jit  # type: ignore[misc,unused-ignore]
def _farthest(columns, starts, lengths, gap2, chosen, total, count, block: tl.constexpr):  # type: ignore[no-untyped-def]
    frame = tl.program_id(0)
    start, length = tl.load(starts + frame), tl.load(lengths + frame)
    slot = tl.arange(0, block)
    current = 0
    for step in range(tl.minimum(count, length)):
        tl.store(chosen + frame * count + step, start + current)
        at = columns + start + current
        x0, y0, z0 = tl.load(at), tl.load(at + total), tl.load(at + 2 * total)
        best, winner = -1.0, 0
        for base in range(0, length, block):
            real = base + slot < length
            row = start + base + slot
            dx = tl.load(columns + row, mask=real, other=0.0) - x0
            dy = tl.load(columns + total + row, mask=real, other=0.0) - y0
            dz = tl.load(columns + 2 * total + row, mask=real, other=0.0) - z0
            gap = tl.minimum(tl.load(gap2 + row, mask=real, other=0.0), dx * dx + dy * dy + dz * dz)
            tl.store(gap2 + row, gap, mask=real)
            value, where = tl.max(tl.where(real, gap, -1.0), 0), tl.argmax(tl.where(real, gap, -1.0), 0)
            winner = tl.where(value > best, base + where, winner)
            best = tl.maximum(best, value)
        current = winner


@triton.jit  # type: ignore[misc,unused-ignore]
def _nearer(gap2, at, stride, x0, y0, z0):  # type: ignore[no-untyped-def]
    dx, dy, dz = tl.load(at) - x0, tl.load(at + stride) - y0, tl.load(at + 2 * stride) - z0
    return tl.minimum(gap2, dx * dx + dy * dy + dz * dz)


@triton.jit  # type: ignore[misc,unused-ignore]
def _farther(one, row, other, other_row):  # type: ignore[no-untyped-def]
    first = (one > other) | ((one == other) & (row < other_row))
    return tl.where(first, one, other), tl.where(first, row, other_row)


@triton.jit  # type: ignore[misc,unused-ignore]
def _farthest_held(columns, starts, lengths, chosen, stride, count, part: tl.constexpr):  # type: ignore[no-untyped-def]
    frame = tl.program_id(0)
    start, length = tl.load(starts + frame), tl.load(lengths + frame)
    row = tl.arange(0, part)  # of four parts: of one whole the compiler keeps too much at once
    first = columns + frame * 4 * part
    at = first + row
    gap2_a = tl.where(row < length, float("inf"), -1.0)
    gap2_b = tl.where(row + part < length, float("inf"), -1.0)
    gap2_c = tl.where(row + 2 * part < length, float("inf"), -1.0)
    gap2_d = tl.where(row + 3 * part < length, float("inf"), -1.0)
    current = 0
    for step in range(tl.minimum(count, length)):
        tl.store(chosen + frame * count + step, (start + current).to(tl.int64))
        x0, y0, z0 = tl.load(first + current), tl.load(first + current + stride), tl.load(first + current + 2 * stride)
        gap2_a = _nearer(gap2_a, at, stride, x0, y0, z0)
        gap2_b = _nearer(gap2_b, at + part, stride, x0, y0, z0)
        gap2_c = _nearer(gap2_c, at + 2 * part, stride, x0, y0, z0)
        gap2_d = _nearer(gap2_d, at + 3 * part, stride, x0, y0, z0)
        most = tl.maximum(tl.maximum(gap2_a, gap2_b), tl.maximum(gap2_c, gap2_d))
        slot = tl.where(gap2_c == most, row + 2 * part, row + 3 * part)
        slot = tl.where(gap2_a == most, row, tl.where(gap2_b == most, row + part, slot))
        _, current = tl.reduce((most, slot), 0, _farther)


def farthest_points(points: Tensor, lengths: Sequence[int], count: int) -> Tensor:
    """Chosen rows of all frames as :func:`farfield.detectors.pointrcnn.points.farthest_points` gives them.

    Args:
        points: x, y, z, float32 on a GPU, shape (n, 3).
        lengths: Rows of each frame.
        count: Points to choose of each frame.
    """
    length = sent(torch.tensor(lengths, dtype=torch.int32), points.device)
    start = (length.cumsum(0) - length).int()
    chosen = torch.empty(len(lengths), count, dtype=torch.long, device=points.device)
    longest = max(lengths)
    if longest == 0:
        return chosen.new_empty(0)
    if longest <= _HELD:
        part = max(_LEAST, triton.next_power_of_2(longest)) // 4
        slot = torch.arange(4 * part, device=points.device)
        columns = points.T[:, torch.where(slot < length[:, None], start[:, None] + slot, 0)].contiguous()
        warps = min(max(part // _OF_A_WARP, 1), 32)
        _farthest_held[(len(lengths),)](
            columns,
            start,
            length,
            chosen,
            columns[0].numel(),
            count,
            part=part,
            num_warps=warps,
            enable_fp_fusion=False,
        )
    else:
        gap2 = torch.full((len(points),), torch.inf, device=points.device)
        _farthest[(len(lengths),)](
            points.T.contiguous(), start, length, gap2, chosen, len(points), count,
            block=_BLOCK, num_warps=16, enable_fp_fusion=False,
        )  # fmt: skip
    return chosen[torch.arange(count, device=points.device) < length[:, None]]
