"""How alike tracks and detections are: IoU, generalised IoU, distance, for many pairs at once."""

import numpy as np
from jaxtyping import Bool, Float

from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import bev_intersection_m2

_BEV = [0, 1, 3, 4, 6]
Flat = Float[np.ndarray, "p 7"]
"""Rows x, y, z (centre), length, width, height, yaw."""


def rows_of(boxes: Boxes) -> Flat:
    """Boxes as rows of seven numbers."""
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])


def iou_3d(a: Flat, b: Flat, *, generalised: bool = False) -> Float[np.ndarray, " p"]:
    """IoU of the i-th boxes, in [0, 1]; generalised (Rezatofighi et al., CVPR 2019) in (-1, 1].

    The generalised one takes as enclosing body the convex hull of both seen from above, times their common height.

    Args:
        a: Boxes as rows x, y, z, length, width, height, yaw, shape (p, 7).
        b: The other box of each pair, shape (p, 7).
        generalised: Which one.
    """
    top = np.minimum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    bottom = np.maximum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2)
    shared = np.zeros(len(a))
    reach = (np.hypot(a[:, 3], a[:, 4]) + np.hypot(b[:, 3], b[:, 4])) / 2
    meet = (np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1]) < reach) & (top > bottom)
    if meet.any():
        shared[meet] = bev_intersection_m2(a[meet][:, _BEV], b[meet][:, _BEV]) * (top - bottom)[meet]
    union = a[:, 3] * a[:, 4] * a[:, 5] + b[:, 3] * b[:, 4] * b[:, 5] - shared
    if not generalised:
        return shared / union
    high = np.maximum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    low = np.minimum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2)
    hull = np.maximum(hull_area_m2(np.concatenate([_corners(a), _corners(b)], axis=1)) * (high - low), union)
    return shared / union - (hull - union) / hull


def _corners(rows: Flat) -> Float[np.ndarray, "p 4 2"]:
    cos, sin = np.cos(rows[:, 6]), np.sin(rows[:, 6])
    half_l, half_w = rows[:, 3] / 2, rows[:, 4] / 2
    along, across = np.stack([half_l * cos, half_l * sin], 1), np.stack([-half_w * sin, half_w * cos], 1)
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return np.stack([rows[:, :2] + s * along + t * across for s, t in signs], axis=1)


def hull_area_m2(points_m: Float[np.ndarray, "p k 2"]) -> Float[np.ndarray, " p"]:
    """Areas of the convex hulls of p sets of k points: gift wrapping of all sets at the same time.

    From the lowest point on, each step goes to the point that lies furthest clockwise of all lines to others.
    """
    points = points_m - points_m.mean(axis=1, keepdims=True)
    x, y = np.ascontiguousarray(points[..., 0]), np.ascontiguousarray(points[..., 1])
    rows = np.arange(len(x))
    start = np.lexsort([x, y], axis=1)[:, 0] if len(x) else rows
    at, area = start, np.zeros(len(x))
    open_: Bool[np.ndarray, " p"] = np.ones(len(x), dtype=bool)
    heading = np.zeros(len(x))
    for _ in range(x.shape[1]):
        if not open_.any():
            break
        dx, dy = x - x[rows, at][:, None], y - y[rows, at][:, None]
        far = dx * dx + dy * dy
        turn = np.mod(np.arctan2(dy, dx) - heading[:, None] + 1e-9, 2 * np.pi)
        turn = np.where(far > 1e-18, turn, np.inf)
        nearest = turn.min(axis=1, keepdims=True)
        following = np.where(turn <= nearest + 2e-9, far, -1.0).argmax(axis=1)
        cross = x[rows, at] * y[rows, following] - y[rows, at] * x[rows, following]
        area += np.where(open_, cross, 0.0)
        heading = np.arctan2(dy[rows, following], dx[rows, following])
        at = following
        open_ = open_ & (np.abs(x[rows, at] - x[rows, start]) + np.abs(y[rows, at] - y[rows, start]) > 1e-9)
    return area / 2
