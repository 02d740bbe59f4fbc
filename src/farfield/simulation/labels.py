"""Annotations: full boxes, and the boxes of the visible part as Cirrus' annotators drew them.

A road user is annotated where both patterns together hit it at least ``MIN_POINTS_BOTH`` times and the Gaussian pattern
at least ``MIN_POINTS_GAUSSIAN`` times. Its visible box is the smallest box of its true heading around those points,
``MARGIN_M`` wider on each side, not thinner than ``MIN_SIZE_M`` (growing away from the sensor), and never reaching
outside the full body grown by the margin.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.boxes import Boxes
from farfield.simulation.bodies.actors import Actor

MIN_POINTS_BOTH = 5
MIN_POINTS_GAUSSIAN = 3
MARGIN_M = 0.05
MIN_SIZE_M = {"vehicle": 0.3, "large_vehicle": 0.3, "trailer": 0.3}
_MIN_OTHER_M = 0.2
MOVING_M_S = 0.5
"""Speed over ground above which a road user is annotated as moving."""


@dataclass(frozen=True, eq=False)
class VisibleObjects:
    """What the annotators of one frame would draw.

    Args:
        visible: Boxes of the visible parts.
        full: Boxes of the whole bodies, in the same order.
        gaussian_points: Points of the Gaussian pattern on each.
        uniform_points: Points of the uniform pattern on each.
    """

    visible: Boxes
    full: Boxes
    gaussian_points: Int[np.ndarray, " n"]
    uniform_points: Int[np.ndarray, " n"]


def full_boxes(
    actors: Sequence[Actor],
    bottom_m: Float[np.ndarray, "n 3"],
    yaw_rad: Float[np.ndarray, " n"],
    velocity_m_s: Float[np.ndarray, "n 3"],
    lidar_T_world: Float[np.ndarray, "4 4"],
) -> Boxes:
    """Boxes around the whole bodies, in the sensor's frame, with their velocities over ground.

    Args:
        actors: n road users.
        bottom_m: Middle of their bottoms in the world, shape (n, 3).
        yaw_rad: Their headings in the world, shape (n,).
        velocity_m_s: Their velocities in the world, shape (n, 3).
        lidar_T_world: Pose of the world in the sensor's frame.
    """
    size = np.array([actor.size_m for actor in actors]).reshape(-1, 3)
    centre = bottom_m + np.array([0.0, 0.0, 0.5]) * size
    boxes = Boxes(
        centre_m=centre,
        size_m=size,
        yaw_rad=yaw_rad,
        label=[actor.label for actor in actors],
        track_id=np.array([actor.track_id for actor in actors], dtype=np.int64),
        velocity_m_s=velocity_m_s,
    )
    return boxes.transform(lidar_T_world)


def moving(boxes: Boxes) -> Bool[np.ndarray, " n"]:
    """Which boxes move: faster over ground than ``MOVING_M_S``; those of unknown velocity do not."""
    if boxes.velocity_m_s is None:
        return np.zeros(len(boxes), dtype=np.bool_)
    return np.asarray(np.linalg.norm(boxes.velocity_m_s, axis=1) > MOVING_M_S)


def mean_times_s(time_s: Float[np.ndarray, " p"], actor: Int[np.ndarray, " p"], count: int) -> Float[np.ndarray, " n"]:
    """When each road user was seen: the mean time of its points.

    A sweep takes a tenth of a second, in which traffic moves by metres. Annotators draw boxes round points, so a label
    shows its road user where it was when the points were measured.

    Args:
        time_s: Times of the points relative to the frame's moment, shape (p,).
        actor: Row of the road user each lies on, -1 for none, shape (p,).
        count: Number n of road users.

    Returns:
        Mean times, shape (n,); 0 for those without points.
    """
    on = actor >= 0
    total = np.bincount(actor[on], weights=time_s[on], minlength=count)
    return total / np.maximum(np.bincount(actor[on], minlength=count), 1)


def visible_boxes(full: Boxes, points_m: Float[np.ndarray, "p 3"], actor: Int[np.ndarray, " p"]) -> Boxes:
    """Shrink full boxes to the points that lie on their bodies.

    Args:
        full: n whole boxes.
        points_m: Points of both patterns, shape (p, 3).
        actor: Index of the box whose body each point lies on, shape (p,); every box must occur.

    Returns:
        n boxes of the same headings.
    """
    order = np.argsort(actor, kind="stable")
    owner = actor[order]
    offset = points_m[order].astype(np.float64) - full.centre_m[owner]
    cos, sin = np.cos(full.yaw_rad)[owner], np.sin(full.yaw_rad)[owner]
    local = np.stack(
        [offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin, offset[:, 2]], 1
    )
    first = np.searchsorted(owner, np.arange(len(full)))
    bound = full.size_m / 2 + MARGIN_M
    lower = np.clip(np.minimum.reduceat(local, first) - MARGIN_M, -bound, bound)
    upper = np.clip(np.maximum.reduceat(local, first) + MARGIN_M, -bound, bound)
    lower, upper = _thicken(lower, upper, full)
    middle = (lower + upper) / 2
    cos, sin = np.cos(full.yaw_rad), np.sin(full.yaw_rad)
    x, y = middle[:, 0] * cos - middle[:, 1] * sin, middle[:, 0] * sin + middle[:, 1] * cos
    return full.replace(centre_m=full.centre_m + np.stack([x, y, middle[:, 2]], axis=1), size_m=upper - lower)


def _thicken(
    lower: Float[np.ndarray, "n 3"], upper: Float[np.ndarray, "n 3"], full: Boxes
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Give each side its least thickness, growing away from the sensor first and staying within the full body."""
    bound = full.size_m / 2 + MARGIN_M
    least = np.array([MIN_SIZE_M.get(str(label), _MIN_OTHER_M) for label in full.label])[:, None]
    least = np.minimum(least, full.size_m)
    cos, sin = np.cos(full.yaw_rad), np.sin(full.yaw_rad)
    x, y = full.centre_m[:, 0], full.centre_m[:, 1]
    away = np.stack([x * cos + y * sin, y * cos - x * sin, full.centre_m[:, 2]], axis=1) > 0
    away[:, 2] = False  # heights grow downwards: the lower part is what gets hidden
    lack = np.maximum(least - (upper - lower), 0.0)
    grow_high = np.where(away, np.minimum(lack, bound - upper), np.maximum(lack - (lower + bound), 0.0))
    grow_low = lack - grow_high
    return lower - grow_low, upper + grow_high
