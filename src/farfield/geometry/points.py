"""Points and boxes: which points lie inside which box."""

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.boxes import Boxes

BOX_MARGIN_M = 0.05
"""By how much boxes grow where points are counted: annotators leave little room, and range noise takes some."""


def box_coordinates_m(points_m: Float[np.ndarray, "n 3"], boxes: Boxes, index: int) -> Float[np.ndarray, "n 3"]:
    """Express points in the frame of box ``index``: origin at its centre, x along its heading; shape (n, 3)."""
    offset = points_m.astype(np.float64) - boxes.centre_m[index]
    cos, sin = np.cos(boxes.yaw_rad[index]), np.sin(boxes.yaw_rad[index])
    return np.stack(
        [offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin, offset[:, 2]], axis=1
    )


def inside_box(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes, index: int, *, margin_m: float = 0.0
) -> Bool[np.ndarray, " n"]:
    """Whether each point lies in box ``index`` or on its surface, shape (n,)."""
    return (np.abs(box_coordinates_m(points_m, boxes, index)) <= boxes.size_m[index] / 2 + margin_m).all(axis=1)


def points_in_boxes(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes, *, margin_m: float = 0.0
) -> list[Int[np.ndarray, " _"]]:
    """Indices of the points inside each box, surface included.

    Args:
        points_m: Points x, y, z, shape (n, 3).
        boxes: m boxes.
        margin_m: Grow each face outwards by this much.

    Returns:
        One sorted index array a box. A point may be in several boxes.
    """
    x, y = np.ascontiguousarray(points_m[:, 0]), points_m[:, 1]
    reach = np.hypot(*(boxes.size_m[:, :2].T / 2 + margin_m)) * (1 + 1e-6) + 1e-3  # also covers float32 rounding
    found = []
    for index, (centre_x, centre_y) in enumerate(boxes.centre_m[:, :2]):
        near = np.flatnonzero(np.abs(x - centre_x) <= reach[index])  # cheap, and leaves few
        near = near[np.abs(y[near] - centre_y) <= reach[index]]
        found.append(near[inside_box(points_m[near], boxes, index, margin_m=margin_m)])
    return found


def count_points_in_boxes(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes, *, margin_m: float = 0.0
) -> Int[np.ndarray, " m"]:
    """Number of points inside each box, surface included, shape (m,)."""
    inside = points_in_boxes(points_m, boxes, margin_m=margin_m)
    return np.array([len(indices) for indices in inside], dtype=np.int64)
