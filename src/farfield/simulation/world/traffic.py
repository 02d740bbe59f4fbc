"""Motion of the road users: car-following along lanes, straight walks and crossings, and no two bodies in one place."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from farfield.geometry.boxes import wrap_angle_rad
from farfield.geometry.iou import bev_intersection_m2

STEP_S = 0.1


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses of n actors at every 0.1 s, and in between by interpolation.

    Args:
        position_m: Middle of each body's bottom in the world, shape (n, steps, 3).
        yaw_rad: Headings in the world, shape (n, steps).
    """

    position_m: Float[np.ndarray, "n steps 3"]
    yaw_rad: Float[np.ndarray, "n steps"]

    def at(
        self, time_s: float, *, rows: slice | Int[np.ndarray, " m"] = slice(None)
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
        """Positions (m, 3) and headings (m,) of some actors, all unless named, at a continuous time."""
        before, share = self._place(time_s)
        a, b = self.position_m[rows, before], self.position_m[rows, before + 1]
        turn = wrap_angle_rad(self.yaw_rad[rows, before + 1] - self.yaw_rad[rows, before])
        return a + share * (b - a), wrap_angle_rad(self.yaw_rad[rows, before] + share * turn)

    def velocity_m_s(self, time_s: float) -> Float[np.ndarray, "n 3"]:
        """Velocities in the world at a continuous time, shape (n, 3)."""
        before, _ = self._place(time_s)
        change: Float[np.ndarray, "n 3"] = self.position_m[:, before + 1] - self.position_m[:, before]
        return change / STEP_S

    def _place(self, time_s: float) -> tuple[int, float]:
        last = self.position_m.shape[1] - 1
        before = min(int(time_s / STEP_S), last - 1)
        return before, time_s / STEP_S - before


def follow(
    progress_m: Float[np.ndarray, " n"],
    desired_m_s: Float[np.ndarray, " n"],
    length_m: Float[np.ndarray, " n"],
    leader: Int[np.ndarray, " n"],
    *,
    steps: int,
) -> Float[np.ndarray, "n steps"]:
    """Drive along lanes by the Intelligent Driver Model (Treiber, Hennecke and Helbing, 2000, equations 3 and 4).

    Args:
        progress_m: Where each vehicle's middle starts, along its own direction.
        desired_m_s: Speed each would drive on an empty road.
        length_m: Lengths of the bodies.
        leader: Index of the vehicle in front in the same lane, or -1.
        steps: Number of moments, ``STEP_S`` apart, the first at the start.

    Returns:
        Progress at every moment, shape (n, steps). Bodies in a lane stay at least one metre apart.
    """
    time_gap_s, standstill_m, accelerate_m_s2, brake_m_s2 = 1.3, 2.0, 1.2, 2.5
    led = leader >= 0
    ahead = np.where(led, leader, 0)
    reach = (length_m + length_m[ahead]) / 2
    gap = np.where(led, progress_m[ahead] - progress_m - reach, 1e6)
    speed = np.minimum(desired_m_s, np.maximum(gap - standstill_m, 0.0) / time_gap_s)
    path = np.empty((len(progress_m), steps))
    path[:, 0] = progress_m
    order = np.argsort(-progress_m, kind="stable")
    for step in range(1, steps):
        closing = np.where(led, speed - speed[ahead], 0.0)
        wish = standstill_m + np.maximum(
            speed * (time_gap_s + closing / (2 * np.sqrt(accelerate_m_s2 * brake_m_s2))), 0
        )
        change = accelerate_m_s2 * (1 - (speed / desired_m_s) ** 4 - (wish / np.maximum(gap, 0.1)) ** 2)
        speed = np.maximum(speed + STEP_S * np.clip(change, -8.0, accelerate_m_s2), 0.0)
        position = path[:, step - 1] + STEP_S * speed
        gap = np.where(led, position[ahead] - position - reach, 1e6)
        if (gap < 1.0).any():
            position = _keep_apart(position, ahead, led, reach, order)
            speed = (position - path[:, step - 1]) / STEP_S
            gap = np.where(led, position[ahead] - position - reach, 1e6)
        path[:, step] = position
    return path


def _keep_apart(
    position: Float[np.ndarray, " n"],
    ahead: Int[np.ndarray, " n"],
    led: Bool[np.ndarray, " n"],
    reach: Float[np.ndarray, " n"],
    order: Int[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Hold vehicles back, leaders first, so that a metre stays between bodies."""
    kept = position.copy()
    for index in order:
        if led[index]:
            kept[index] = min(kept[index], kept[ahead[index]] - reach[index] - 1.0)
    return kept


def in_conflict(
    position_m: Float[np.ndarray, "n steps 3"],
    yaw_rad: Float[np.ndarray, "n steps"],
    size_m: Float[np.ndarray, "n 3"],
    loose: Bool[np.ndarray, " n"],
    *,
    margin_m: float,
    every: int = 2,
) -> Bool[np.ndarray, " n"]:
    """Which loose actors would ever touch another one that stays.

    Args:
        position_m: Positions at all steps.
        yaw_rad: Headings at all steps.
        size_m: Sizes.
        loose: Actors that may be taken away: those that cross or walk freely, later ones yielding to earlier ones.
        margin_m: Distance below which bodies count as touching.
        every: Check every so many steps.

    Returns:
        True for each actor to take away, shape (n,).
    """
    gone = np.zeros(len(size_m), dtype=bool)
    if not loose.any():
        return gone
    reach = float(np.hypot(size_m[:, 0], size_m[:, 1]).max()) + margin_m
    seen: list[Int[np.ndarray, "k 2"]] = []
    for step in range(0, position_m.shape[1], every):
        tree = cKDTree(position_m[:, step, :2])
        pairs = tree.query_pairs(reach, output_type="ndarray")
        pairs = pairs[loose[pairs].any(axis=1)]
        rows = np.column_stack([position_m[:, step, :2], size_m[:, :2] + margin_m, yaw_rad[:, step]])
        half = np.hypot(rows[:, 2], rows[:, 3]) / 2
        offset = rows[pairs[:, 0], :2] - rows[pairs[:, 1], :2]
        pairs = pairs[np.hypot(offset[:, 0], offset[:, 1]) < half[pairs].sum(axis=1)]
        if len(pairs):
            seen.append(pairs[bev_intersection_m2(rows[pairs[:, 0]], rows[pairs[:, 1]]) > 0])
    touching = np.unique(np.concatenate(seen), axis=0) if seen else np.zeros((0, 2), dtype=np.int64)
    for first, second in touching[np.argsort(touching.max(axis=1), kind="stable")]:
        if gone[first] or gone[second]:
            continue
        gone[max(first, second) if loose[max(first, second)] else min(first, second)] = True
    return gone
