"""A flat or sloping road with one car on it, of which a sensor at the origin sees the sides that face it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

CAR = (4.6, 1.9, 1.5)


def sides(
    centre: tuple[float, float], yaw_rad: float, size: tuple[float, float, float], *, step_m: float, base_m: float
) -> Float[np.ndarray, "n 3"]:
    """Points on the faces that look at the origin, on a grid, from 0.2 m over its base to its top."""
    length, width, height = size
    turn = np.array([[np.cos(yaw_rad), np.sin(yaw_rad)], [-np.sin(yaw_rad), np.cos(yaw_rad)]])
    u, v = np.arange(-length / 2, length / 2 + 1e-9, step_m), np.arange(-width / 2, width / 2 + 1e-9, step_m)
    ego = -np.array(centre) @ turn.T
    faces = []
    if abs(ego[0]) > length / 2:
        faces.append(np.column_stack([np.full(len(v), np.sign(ego[0]) * length / 2), v]))
    if abs(ego[1]) > width / 2:
        faces.append(np.column_stack([u, np.full(len(u), np.sign(ego[1]) * width / 2)]))
    plan = np.concatenate(faces) @ turn + centre
    heights = np.append(np.arange(0.2, height, max(step_m, 0.15)), height)
    return np.column_stack([np.tile(plan, (len(heights), 1)), base_m + np.repeat(heights, len(plan))])


def road(
    rng: np.random.Generator, *, slope: float = 0.0, base_m: float = -1.9, count: int = 60_000, reach_m: float = 70.0
) -> Float[np.ndarray, "n 3"]:
    """A road about the sensor, rising along x, with a centimetre or two of noise."""
    xy = rng.uniform(-reach_m, reach_m, (count, 2))
    return np.column_stack([xy, base_m + slope * xy[:, 0] + rng.normal(0, 0.015, count)])


def scene(
    rng: np.random.Generator,
    centre: tuple[float, float],
    yaw_rad: float,
    size: tuple[float, float, float] = CAR,
    *,
    step_m: float = 0.1,
    slope: float = 0.0,
) -> Float[np.ndarray, "n 3"]:
    """Road and object together, as a sensor's float32."""
    base = -1.9 + slope * centre[0]
    return np.concatenate([road(rng, slope=slope), sides(centre, yaw_rad, size, step_m=step_m, base_m=base)]).astype(
        np.float32
    )


def seen_past(points: Float[np.ndarray, "n 3"], box: Sequence[float]) -> Float[np.ndarray, "m 3"]:
    """Points that a sensor at the origin sees past a box (x, y, z, length, width, height, yaw): not through it."""
    x, y, z, length, width, height, yaw = box
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    start, end = -np.array([x, y, z]) @ turn, (points - [x, y, z]) @ turn
    step, half = end - start, np.array([length, width, height]) / 2 - 1e-3
    with np.errstate(divide="ignore"):
        ways = np.sort(np.stack([(-half - start) / step, (half - start) / step]), axis=0)
    enters, leaves = ways[0].max(axis=1), ways[1].min(axis=1)
    return points[~((enters < leaves) & (enters < 0.999) & (leaves > 0))]
