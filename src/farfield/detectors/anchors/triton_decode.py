"""Boxes of anchors on a GPU in one kernel, written in Triton; see :func:`farfield.detectors.anchors.head.decoded`."""

from importlib import import_module
from typing import Any

from torch import Tensor

from farfield.detectors.devices import jit

triton: Any = import_module("triton")
tl: Any = import_module("triton.language")

_BLOCK = 64


@jit
def _wrapped(angle, pi):  # type: ignore[no-untyped-def]
    turned = angle + pi
    turned = turned - tl.floor(turned / (2 * pi)) * (2 * pi) - pi
    turned = tl.where(turned >= pi, -pi, turned)
    return tl.where((angle >= -pi) & (angle < pi), angle, turned)


@jit
def _decode_kernel(  # type: ignore[no-untyped-def]
    codes, directions, index, grid, kinds, headings, rows, count, per_cell, ny, code_step, code_apart,
    direction_step, direction_apart, fixed: tl.constexpr, block: tl.constexpr,
):  # fmt: skip
    # Numbers come from memory: written here they would be rounded to float32.
    pi, least, most = tl.load(grid + 4), tl.load(grid + 5), tl.load(grid + 6)
    offset, nearly_one = tl.load(grid + 7), tl.load(grid + 8)
    row = tl.program_id(0) * block + tl.arange(0, block)
    there = row < count
    anchor = tl.load(index + row, mask=there, other=0)
    cell = anchor // per_cell
    slot = anchor - cell * per_cell
    kind, heading = slot // 2, slot % 2
    ix = cell // ny
    iy = cell - ix * ny
    x = ix.to(tl.float64) * tl.load(grid) + tl.load(grid + 2)
    y = iy.to(tl.float64) * tl.load(grid + 1) + tl.load(grid + 3)
    z = tl.load(kinds + kind * 4, mask=there, other=0.0)
    length = tl.load(kinds + kind * 4 + 1, mask=there, other=1.0)
    width = tl.load(kinds + kind * 4 + 2, mask=there, other=1.0)
    height = tl.load(kinds + kind * 4 + 3, mask=there, other=1.0)
    code = codes + anchor * code_step
    diagonal = tl.sqrt(length * length + width * width)
    x += tl.load(code, mask=there, other=0.0).to(tl.float64) * diagonal
    y += tl.load(code + code_apart, mask=there, other=0.0).to(tl.float64) * diagonal
    z += tl.load(code + 2 * code_apart, mask=there, other=0.0).to(tl.float64) * height
    long = tl.load(code + 3 * code_apart, mask=there, other=0.0).to(tl.float64)
    wide = tl.load(code + 4 * code_apart, mask=there, other=0.0).to(tl.float64)
    high = tl.load(code + 5 * code_apart, mask=there, other=0.0).to(tl.float64)
    length *= tl.exp(tl.minimum(tl.maximum(long, least), most))
    width *= tl.exp(tl.minimum(tl.maximum(wide, least), most))
    height *= tl.exp(tl.minimum(tl.maximum(high, least), most))
    turn = tl.load(code + 6 * code_apart, mask=there, other=0.0).to(tl.float64)
    half_turns = turn / pi * nearly_one
    down = tl.floor(half_turns)
    up = half_turns - down
    odd = down - 2 * tl.floor(down / 2)
    half_turns = tl.where((up > 0.5) | ((up == 0.5) & (odd > 0)), down + 1, down)
    direction = directions + anchor * direction_step
    one = tl.load(direction, mask=there, other=0.0).to(tl.float32)
    other = tl.load(direction + direction_apart, mask=there, other=0.0).to(tl.float32)
    backwards = (other > one).to(tl.float64)
    straight = tl.load(headings + heading, mask=there, other=0.0) + (turn - pi * half_turns)
    if fixed:
        yaw = _wrapped(straight, pi)
        past = yaw - offset
        past = past - tl.floor(past / (2 * pi)) * (2 * pi)
        looks = (past >= pi).to(tl.float64)
        yaw = _wrapped(yaw + pi * (looks != backwards).to(tl.float64), pi)
    else:
        yaw = _wrapped(straight + pi * backwards, pi)
    row = rows + row * 7
    tl.store(row, x, mask=there)
    tl.store(row + 1, y, mask=there)
    tl.store(row + 2, z, mask=there)
    tl.store(row + 3, length, mask=there)
    tl.store(row + 4, width, mask=there)
    tl.store(row + 5, height, mask=there)
    tl.store(row + 6, yaw, mask=there)


def decoded(
    codes: Tensor,
    directions: Tensor,
    index: Tensor,
    *,
    grid: Tensor,
    kinds: Tensor,
    headings: Tensor,
    per_cell: int,
    ny: int,
    fixed: bool,
) -> Tensor:
    """Boxes of the anchors with these numbers, rows x, y, z, l, w, h, yaw, shape (k, 7), float64.

    Args:
        codes: Codes of all anchors, shape (n, 7).
        directions: Both directions' logits of all anchors, shape (n, 2).
        index: The anchors, shape (k,), int64.
        grid: Step of the grid along x and y, its first cell's x and y, metres; pi; logarithms of the least and the
            greatest ratio of a box's size to its anchor's; the heading that directions count from with ``fixed``; and
            what a turn is multiplied by before its half turns are counted; shape (9,), float64.
        kinds: z, length, width and height of each class' anchor, shape (classes, 4), float64.
        headings: The two headings, shape (2,), float64.
        per_cell: Anchors of a cell.
        ny: Cells along y.
        fixed: Directions count from a fixed heading, not from the anchor's own.
    """
    rows = index.new_empty(len(index), 7, dtype=kinds.dtype)
    if len(index):
        _decode_kernel[(triton.cdiv(len(index), _BLOCK),)](
            codes, directions, index, grid, kinds, headings, rows, len(index), per_cell, ny, *codes.stride(),
            *directions.stride(), fixed, _BLOCK,
        )  # fmt: skip
    return rows
