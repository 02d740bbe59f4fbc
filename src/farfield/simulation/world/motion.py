"""Paths of road users in continuous time, and no two bodies in one place."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.boxes import wrap_angle_rad
from farfield.geometry.iou import bev_intersection_m2

STEP_S = 0.1
_TOUCH_M2 = 1e-6  # rounding leaves 1e-16 between bodies apart
_BLOCK = 10  # steps that one coarse test of distance covers


def hermite(
    table: Float[np.ndarray, "n steps *rest"], time_s: float
) -> tuple[Float[np.ndarray, "n *rest"], Float[np.ndarray, "n *rest"]]:
    """Values and rates at a time, from values every ``STEP_S``, by cubic Hermite pieces with central differences.

    Both values and rates are continuous (Catmull and Rom, 1974); a uniform motion stays exactly uniform.
    """
    last = table.shape[1] - 1
    index = int(np.clip(time_s / STEP_S, 0, last - 1))
    u = float(np.clip(time_s / STEP_S - index, 0.0, 1.0))
    a, b = table[:, index], table[:, index + 1]
    before = table[:, index - 1] if index else 2 * a - b
    after = table[:, index + 2] if index + 2 <= last else 2 * b - a
    rise, ra, rb = b - a, (b - before) / 2, (after - a) / 2
    value = a + u * ra + u**2 * (3 * rise - 2 * ra - rb) + u**3 * (ra + rb - 2 * rise)
    rate = ra + 2 * u * (3 * rise - 2 * ra - rb) + 3 * u**2 * (ra + rb - 2 * rise)
    return value, rate / STEP_S


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses of n actors every 0.1 s, and smoothly in between.

    Args:
        position_m: Middle of each body's bottom in the world, shape (n, steps, 3).
        yaw_rad: Headings in the world, shape (n, steps).
        slope: Rise of the ground along the heading and to the left of it, shape (n, steps, 2).
    """

    position_m: Float[np.ndarray, "n steps 3"]
    yaw_rad: Float[np.ndarray, "n steps"]
    slope: Float[np.ndarray, "n steps 2"]

    def mirrored(self) -> "Motion":
        """The same on the other side of the x axis: what was on the left is on the right."""
        return Motion(self.position_m * [1.0, -1.0, 1.0], -self.yaw_rad, self.slope * [1.0, -1.0])

    def at(
        self, time_s: float, *, rows: slice | Int[np.ndarray, " m"] = slice(None)
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
        """Positions (m, 3) and headings (m,) of some actors, all unless named, at a continuous time."""
        return hermite(self.position_m[rows], time_s)[0], wrap_angle_rad(hermite(self.yaw_rad[rows], time_s)[0])

    def poses(self, time_s: float, *, rows: slice | Int[np.ndarray, " m"] = slice(None)) -> Float[np.ndarray, "m 4 4"]:
        """Poses in the world of some actors: on the ground, tilted with it."""
        position, yaw = self.at(time_s, rows=rows)
        slope = hermite(self.slope[rows], time_s)[0]
        forward = np.stack([np.cos(yaw), np.sin(yaw), slope[:, 0]], axis=1)
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        up = np.cross(forward, np.stack([-np.sin(yaw), np.cos(yaw), slope[:, 1]], axis=1))
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        out = np.zeros((len(yaw), 4, 4))
        out[:, :3, 0], out[:, :3, 1], out[:, :3, 2] = forward, np.cross(up, forward), up
        out[:, :3, 3], out[:, 3, 3] = position, 1.0
        return out

    def velocity_m_s(self, time_s: float) -> Float[np.ndarray, "n 3"]:
        """Velocities in the world at a continuous time, shape (n, 3)."""
        return hermite(self.position_m, time_s)[1]

    def travelled_m(self, row: int, time_s: float) -> float:
        """Distance that one actor has covered since time 0."""
        steps = np.linalg.norm(np.diff(self.position_m[row, :, :2], axis=0), axis=1)
        covered = np.concatenate([[0.0], np.cumsum(steps)])
        return float(hermite(covered[None], time_s)[0][0])


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
    removed = np.zeros(len(size_m), dtype=bool)
    if not loose.any():
        return removed
    steps = position_m.shape[1]
    still = np.ptp(position_m[..., :2], axis=1).max(axis=1) < 1e-6
    contacts = [
        _touching(position_m, yaw_rad, size_m, _near(position_m[:, :1], size_m, loose & still, still), [0], margin_m)
    ]
    for first in range(0, steps, _BLOCK):
        block = position_m[:, first : first + _BLOCK + 1]
        pairs = np.concatenate(
            [
                _near(block, size_m, loose & ~still, np.full(len(still), True)),
                _near(block, size_m, loose & still, ~still),
            ]
        )
        moments = list(range(first, min(first + _BLOCK, steps), every))
        contacts.append(_touching(position_m, yaw_rad, size_m, pairs, moments, margin_m))
    touching = np.unique(np.sort(np.concatenate(contacts), axis=1), axis=0)
    for first, second in touching[np.argsort(touching.max(axis=1), kind="stable")]:
        if removed[first] or removed[second]:
            continue
        removed[max(first, second) if loose[max(first, second)] else min(first, second)] = True
    return removed


def _near(
    block_m: Float[np.ndarray, "n k 3"],
    size_m: Float[np.ndarray, "n 3"],
    first_kind: Bool[np.ndarray, " n"],
    second_kind: Bool[np.ndarray, " n"],
) -> Int[np.ndarray, "p 2"]:
    """Pairs of one of each kind whose circles around their bodies and their ways over some steps overlap."""
    low, high = block_m[..., :2].min(axis=1), block_m[..., :2].max(axis=1)
    middle = ((low + high) / 2).astype(np.float32)
    radius_m = (np.hypot(*(high - low).T) / 2 + np.hypot(size_m[:, 0], size_m[:, 1]) / 2 + 0.5).astype(np.float32)
    first, second = np.flatnonzero(first_kind), np.flatnonzero(second_kind)
    x = middle[first, None, 0] - middle[None, second, 0]
    y = middle[first, None, 1] - middle[None, second, 1]
    row, column = np.nonzero(x * x + y * y < (radius_m[first, None] + radius_m[None, second]) ** 2)
    pairs = np.stack([first[row], second[column]], axis=1)
    return pairs[pairs[:, 0] != pairs[:, 1]]


def _touching(
    position_m: Float[np.ndarray, "n steps 3"],
    yaw_rad: Float[np.ndarray, "n steps"],
    size_m: Float[np.ndarray, "n 3"],
    pairs: Int[np.ndarray, "p 2"],
    moments: list[int],
    margin_m: float,
) -> Int[np.ndarray, "q 2"]:
    """Those pairs that touch at one of the moments."""
    half = np.hypot(size_m[:, 0] + margin_m, size_m[:, 1] + margin_m) / 2
    touching: list[Int[np.ndarray, "q 2"]] = [np.zeros((0, 2), dtype=np.int64)]
    for step in moments:
        a, b = pairs.T
        offset = position_m[a, step, :2] - position_m[b, step, :2]
        close = pairs[np.einsum("ij,ij->i", offset, offset) < (half[a] + half[b]) ** 2]
        if len(close):
            rows = np.column_stack([position_m[:, step, :2], size_m[:, :2] + margin_m, yaw_rad[:, step]])
            touching.append(close[bev_intersection_m2(rows[close[:, 0]], rows[close[:, 1]]) > _TOUCH_M2])
    return np.concatenate(touching)
