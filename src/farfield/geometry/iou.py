"""Exact overlap of rotated boxes in float64: bird's-eye view (BEV) and 3D.

Method. In the frame of box B, where B is the rectangle |x| <= a, |y| <= b, the area of A inside B is a signed sum over
the four edges of A: a vertical line meets A in one interval [low, high], and the part of it inside B has the length
clamp(high) - clamp(low), clamp to [-b, b]. Summed over x, each edge adds the integral of its clamped height over its
own stretch of |x| <= a. That integrand is continuous in every coordinate, so nothing depends on whether a corner lies
"inside" or an edge "on" another one: coincident boxes, boxes turned by pi and shared edges are ordinary cases. Clipping
polygons or collecting edge intersections, as is usual, needs a tolerance there and fails by whole box areas.
All coordinates are taken relative to B's centre, so the error does not grow with the distance from the sensor.
"""

import numpy as np
from jaxtyping import Float, Int

from farfield.geometry.boxes import Boxes

_CHUNK = 1024  # pairs at a time: the temporaries stay in the processor's second-level cache
_BEV = [0, 1, 3, 4, 6]  # the columns x, y, length, width, yaw of a row with all seven
_EDGE_SIGNS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=np.float64)
_NEXT_EDGE = [1, 2, 3, 0]


def bev_intersection_m2(a: Float[np.ndarray, "n 5"], b: Float[np.ndarray, "n 5"]) -> Float[np.ndarray, " n"]:
    """Area that the rectangles of each pair share.

    Args:
        a: Rectangles as x, y, length, width (metres), yaw (radians), shape (n, 5).
        b: The other rectangle of each pair, shape (n, 5).

    Returns:
        Areas in square metres, shape (n,).
    """
    area = np.empty(len(a))
    for start in range(0, len(a), _CHUNK):
        part = slice(start, start + _CHUNK)
        area[part] = _intersection_chunk(a[part], b[part])
    return area


def _intersection_chunk(a: Float[np.ndarray, "n 5"], b: Float[np.ndarray, "n 5"]) -> Float[np.ndarray, " n"]:
    at, bt = np.ascontiguousarray(a.T), np.ascontiguousarray(b.T)
    cos_b, sin_b = np.cos(bt[4]), np.sin(bt[4])
    dx, dy = at[0] - bt[0], at[1] - bt[1]
    x_centre, y_centre = dx * cos_b + dy * sin_b, dy * cos_b - dx * sin_b
    turn = at[4] - bt[4]
    cos, sin = np.cos(turn), np.sin(turn)
    half_l, half_w, x_max, y_max = at[2] / 2, at[3] / 2, bt[2] / 2, bt[3] / 2
    xl, yl, xw, yw = half_l * cos, half_l * sin, -half_w * sin, half_w * cos
    s, t = _EDGE_SIGNS[:, :, None].transpose(1, 0, 2)
    xs, ys = x_centre + s * xl + t * xw, y_centre + s * yl + t * yw
    edges = _clamped_integral(xs, ys, xs[_NEXT_EDGE], ys[_NEXT_EDGE], x_max, y_max)
    area = 0.0 - edges[0] - edges[1] - edges[2] - edges[3]
    return np.clip(area, 0.0, np.minimum(at[2] * at[3], bt[2] * bt[3]))


def _clamped_integral(
    x0: Float[np.ndarray, "4 n"],
    y0: Float[np.ndarray, "4 n"],
    x1: Float[np.ndarray, "4 n"],
    y1: Float[np.ndarray, "4 n"],
    x_max: Float[np.ndarray, " n"],
    y_max: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "4 n"]:
    """Signed integrals of clamp(y, -y_max, y_max) over each edge's part with |x| <= x_max."""
    run = x1 - x0
    slope = (y1 - y0) / np.where(run == 0, 1.0, run)
    left, right = np.clip(x0, -x_max, x_max), np.clip(x1, -x_max, x_max)
    y_left, y_right = y0 + (left - x0) * slope, y0 + (right - x0) * slope
    low, high = np.minimum(y_left, y_right), np.maximum(y_left, y_right)
    rise = np.maximum(high - low, 1e-250)
    below = np.clip((-y_max - low) / rise, 0.0, 1.0)  # share of the stretch that lies under the rectangle
    above = np.clip((high - y_max) / rise, 0.0, 1.0)
    inside = (np.clip(low, -y_max, y_max) + np.clip(high, -y_max, y_max)) / 2
    mean = (above - below) * y_max + (1.0 - below - above) * inside
    return (right - left) * mean


def paired_iou(a: Boxes, b: Boxes, *, kind: str = "3d") -> Float[np.ndarray, " n"]:
    """Intersection over union of the i-th box of ``a`` with the i-th box of ``b``.

    Args:
        a: n boxes.
        b: n boxes.
        kind: ``"bev"`` for areas in the x-y plane, ``"3d"`` for volumes.

    Returns:
        IoU in [0, 1], shape (n,).

    Raises:
        ValueError: If the lengths differ or ``kind`` is unknown.
    """
    if len(a) != len(b):
        raise ValueError(f"paired_iou: expected as many boxes in b as in a ({len(a)}), got {len(b)}")
    if kind not in ("bev", "3d"):
        raise ValueError(f"paired_iou: expected kind to be one of 'bev', '3d', got {kind!r}")
    iou = np.zeros(len(a))
    for start in range(0, len(a), _CHUNK):
        part = slice(start, start + _CHUNK)
        rows_a = np.column_stack([a.centre_m[part], a.size_m[part], a.yaw_rad[part]])
        rows_b = np.column_stack([b.centre_m[part], b.size_m[part], b.yaw_rad[part]])
        iou[part] = _paired_chunk(rows_a, rows_b, bev=kind == "bev")
    return iou


def _paired_chunk(a: Float[np.ndarray, "n 7"], b: Float[np.ndarray, "n 7"], *, bev: bool) -> Float[np.ndarray, " n"]:
    """IoU of boxes as x, y, z, length, width, height, yaw; pairs that cannot meet are left out of the clipping."""
    iou = np.zeros(len(a))
    radius_m = (np.hypot(a[:, 3], a[:, 4]) + np.hypot(b[:, 3], b[:, 4])) / 2
    top = np.minimum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    bottom = np.maximum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2)
    near = np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1]) < radius_m
    if not bev:
        near &= top > bottom
    if not near.any():
        return iou
    if not near.all():
        a, b, top, bottom = a[near], b[near], top[near], bottom[near]
    shared = bev_intersection_m2(a[:, _BEV], b[:, _BEV])
    measure_a, measure_b = a[:, 3] * a[:, 4], b[:, 3] * b[:, 4]
    if not bev:
        # A height difference of boxes at z of 100 m may round above the lower height itself.
        shared = shared * np.minimum(top - bottom, np.minimum(a[:, 5], b[:, 5]))
        measure_a, measure_b = measure_a * a[:, 5], measure_b * b[:, 5]
    union = measure_a + measure_b - shared
    iou[near] = np.clip(np.divide(shared, union, out=np.zeros_like(shared), where=union > 0), 0.0, 1.0)
    return iou


def pairwise_iou(a: Boxes, b: Boxes, *, kind: str = "3d") -> Float[np.ndarray, "n m"]:
    """Intersection over union of every box of ``a`` with every box of ``b``.

    Pairs whose circumscribed circles do not meet are rejected before any clipping.

    Args:
        a: n boxes.
        b: m boxes.
        kind: ``"bev"`` or ``"3d"``.

    Returns:
        IoU in [0, 1], shape (n, m).
    """
    iou = np.zeros((len(a), len(b)))
    if kind not in ("bev", "3d"):
        raise ValueError(f"pairwise_iou: expected kind to be one of 'bev', '3d', got {kind!r}")
    rows = max(1, _MATRIX_AT_ONCE // max(len(b), 1))
    for start in range(0, len(a), rows):
        part = slice(start, start + rows)
        radius_m = (np.hypot(*a.size_m[part, :2].T)[:, None] + np.hypot(*b.size_m[:, :2].T)[None]) / 2
        gap_x = a.centre_m[part, 0, None] - b.centre_m[None, :, 0]
        gap_y = a.centre_m[part, 1, None] - b.centre_m[None, :, 1]
        pair = np.argwhere(gap_x**2 + gap_y**2 < radius_m**2)
        pair[:, 0] += start
        iou[pair[:, 0], pair[:, 1]] = iou_of_pairs(a, b, pair, kind=kind)
    return iou


def iou_of_pairs(a: Boxes, b: Boxes, pair: Int[np.ndarray, "p 2"], *, kind: str = "3d") -> Float[np.ndarray, " p"]:
    """Intersection over union of pairs of rows, however many: the rows are taken a block at a time.

    Args:
        a: n boxes.
        b: m boxes.
        pair: A row of ``a`` and one of ``b`` each.
        kind: ``"bev"`` or ``"3d"``.

    Returns:
        IoU in [0, 1], shape (p,).
    """
    parts = [pair[start : start + _PAIRS_AT_ONCE] for start in range(0, max(len(pair), 1), _PAIRS_AT_ONCE)]
    return np.concatenate([paired_iou(a[part[:, 0]], b[part[:, 1]], kind=kind) for part in parts])


_MATRIX_AT_ONCE, _PAIRS_AT_ONCE = 4_000_000, 64 * _CHUNK


def aligned_iou(a: Boxes, b: Boxes, *, kind: str = "yaw") -> Float[np.ndarray, " n"]:
    """IoU after the centres are aligned (Cirrus, section IV.A "Aligned Intersection over Union").

    Args:
        a: n boxes.
        b: n boxes.
        kind: ``"yaw"`` keeps both headings (3D), ``"scale"`` aligns them too (1 minus nuScenes' scale error),
            ``"bev"`` keeps headings and ignores heights.

    Returns:
        IoU in [0, 1], shape (n,).

    Raises:
        ValueError: If ``kind`` is unknown.
    """
    if kind == "scale":
        shared = np.prod(np.minimum(a.size_m, b.size_m), axis=1)
        return shared / (a.volume_m3 + b.volume_m3 - shared)
    if kind not in ("yaw", "bev"):
        raise ValueError(f"aligned_iou: expected kind to be one of 'yaw', 'scale', 'bev', got {kind!r}")
    origin = np.zeros_like(a.centre_m)
    return paired_iou(a.replace(centre_m=origin), b.replace(centre_m=origin), kind="3d" if kind == "yaw" else "bev")
