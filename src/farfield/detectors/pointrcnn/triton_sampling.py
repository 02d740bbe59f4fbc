"""Farthest point sampling on a GPU in one kernel, a program a frame; imported for CUDA tensors only, needs Triton.

The plain version launches a handful of kernels for each chosen point, thousands of times. Here one program walks
through a frame's whole sequence. It rounds as the plain version does (same order of sums, none fused), and of equal
gaps the lowest row wins as there, so both choose the same points.
"""

from collections.abc import Sequence

import torch
import triton  # type: ignore[import-not-found,unused-ignore]
import triton.language as tl  # type: ignore[import-not-found,unused-ignore]
from torch import Tensor

_BLOCK = 2048  # points that a program handles at once


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


def farthest_points(points: Tensor, lengths: Sequence[int], count: int) -> Tensor:
    """Chosen rows of all frames as :func:`farfield.detectors.pointrcnn.points.farthest_points` gives them.

    Args:
        points: x, y, z, float32 on a GPU, shape (n, 3).
        lengths: Rows of each frame.
        count: Points to choose of each frame.
    """
    length = torch.tensor(lengths, dtype=torch.int32, device=points.device)
    start = (length.cumsum(0) - length).int()
    gap2 = torch.full((len(points),), torch.inf, device=points.device)
    chosen = torch.empty(len(lengths), count, dtype=torch.long, device=points.device)
    _farthest[(len(lengths),)](
        points.T.contiguous(),
        start,
        length,
        gap2,
        chosen,
        len(points),
        count,
        block=_BLOCK,
        num_warps=16,
        enable_fp_fusion=False,
    )
    return chosen[torch.arange(count, device=points.device) < length[:, None]]
