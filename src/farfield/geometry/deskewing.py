"""Deskewing: the points of a sweep moved to where they would have been measured at one moment.

A point that was measured at ``t`` in the sensor's coordinates of that moment stands, in those of the reference moment,
at ``T(t_ref)^-1 T(t) p``, where ``T`` is ``world_T_sensor``. Between two poses the motion is a screw of constant speed,
``T0 exp(s log(T0^-1 T1))`` on SE(3): a chord instead of the arc would be off by 2 cm in a bend at 30 m/s and 30 degrees
a second. :func:`deskew` takes out the sensor's own motion alone: what moves by itself stays smeared by its speed times
the time, which :func:`deskew_boxes` takes out where boxes tell the velocities.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes, inside_box
from farfield.geometry.poses import exponential, logarithm


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Where a sensor was.

    Args:
        times_ns: When, increasing, shape (n,).
        world_T_sensor: Its poses, shape (n, 4, 4).

    Raises:
        ConfigError: If there are fewer than two, their numbers differ, times do not increase, or a pose is no rigid
            motion.
    """

    times_ns: Int64[np.ndarray, " n"]
    world_T_sensor: Float[np.ndarray, "n 4 4"]

    def __post_init__(self) -> None:
        if len(self.times_ns) != len(self.world_T_sensor) or len(self.times_ns) < 2:
            raise ConfigError(
                f"PoseTrack: expected two poses or more and a time each, got {len(self.world_T_sensor)} poses and "
                f"{len(self.times_ns)} times"
            )
        if (np.diff(self.times_ns) <= 0).any():
            raise ConfigError("PoseTrack: expected times that increase")
        turn = self.world_T_sensor[:, :3, :3]
        rigid = np.isfinite(self.world_T_sensor).all() and np.allclose(
            turn @ turn.transpose(0, 2, 1), np.eye(3), atol=1e-5
        )
        if not rigid or (np.linalg.det(turn) < 0).any():
            raise ConfigError("PoseTrack: expected rigid motions, 4 x 4 with a rotation and a translation")

    def at(self, times_ns: Int64[np.ndarray, " m"]) -> Float[np.ndarray, "m 4 4"]:
        """Poses at any moment, shape (m, 4, 4); up to half an interval before the first and after the last pose.

        Raises:
            ConfigError: If a moment lies farther out.
        """
        covered = self.covers(times_ns)
        if not covered.all():
            worst = int(times_ns[~covered][0])
            raise ConfigError(
                f"PoseTrack: expected a time within half an interval of {int(self.times_ns[0])} to "
                f"{int(self.times_ns[-1])} ns, got {worst} ns"
            )
        row = np.clip(np.searchsorted(self.times_ns, times_ns, side="right") - 1, 0, len(self.times_ns) - 2)
        segment_rows, which = np.unique(row, return_inverse=True)
        before, after = self.world_T_sensor[segment_rows], self.world_T_sensor[segment_rows + 1]
        twist = logarithm(np.linalg.inv(before) @ after)[which]
        step = self.times_ns[row + 1] - self.times_ns[row]
        share = (times_ns - self.times_ns[row]) / step
        return before[which] @ exponential(twist * share[:, None])

    def covers(self, times_ns: Int64[np.ndarray, " m"]) -> np.ndarray:
        """Whether a pose is known at each moment, shape (m,)."""
        early = (self.times_ns[1] - self.times_ns[0]) // 2
        late = (self.times_ns[-1] - self.times_ns[-2]) // 2
        return (times_ns >= self.times_ns[0] - early) & (times_ns <= self.times_ns[-1] + late)


@dataclass(frozen=True, eq=False)
class DeskewedSweep:
    """A sweep at one moment.

    Args:
        points_m: The points, in the order given, shape (n, 3).
        left: How many kept their place because no pose is known at their time.
    """

    points_m: Float[np.ndarray, "n 3"]
    left: int


def deskew(
    points_m: Float[np.ndarray, "n 3"],
    point_times_ns: Int64[np.ndarray, " n"],
    track: PoseTrack,
    *,
    reference_ns: int,
) -> DeskewedSweep:
    """Move the points of a sweep to where the sensor would have seen them at the reference moment.

    Args:
        points_m: In the sensor's coordinates of the moment at which each was measured, shape (n, 3).
        point_times_ns: That moment, shape (n,).
        track: Poses of the sensor.
        reference_ns: The moment; boxes and poses of the sweep must be those of this moment, too.

    Raises:
        ConfigError: If no pose is known at the reference moment.
    """
    columns, which = np.unique(point_times_ns, return_inverse=True)  # a scanner fires many rays at once
    ref_T_world = np.linalg.inv(track.at(np.array([reference_ns], dtype=np.int64))[0])
    covered = track.covers(columns)
    ref_T_column = np.broadcast_to(np.eye(4), (len(columns), 4, 4)).copy()
    if covered.any():
        ref_T_column[covered] = ref_T_world @ track.at(columns[covered])
    deskewed = np.empty((len(points_m), 3), dtype=np.float64)
    for begin in range(0, len(points_m), 1 << 16):  # bounds the matrices that are gathered
        part = slice(begin, begin + (1 << 16))
        matrix = ref_T_column[which[part]]
        deskewed[part] = np.einsum("nij,nj->ni", matrix[:, :3, :3], points_m[part]) + matrix[:, :3, 3]
    return DeskewedSweep(deskewed.astype(points_m.dtype), int((~covered)[which].sum()))


def deskew_boxes(
    points_m: Float[np.ndarray, "n 3"],
    point_times_ns: Int64[np.ndarray, " n"],
    boxes: Boxes,
    *,
    reference_ns: int,
    margin_m: float = 0.1,
) -> Float[np.ndarray, "n 3"]:
    """Move the points on road users to where these were at the reference moment, each by its box's velocity.

    For sweeps that are corrected for the sensor's own motion: what moves by itself is smeared still. A point belongs to
    a box if it lies in it once it is moved; of several the nearest centre takes it.

    Args:
        points_m: In the sensor's coordinates of the reference moment, as :func:`deskew` gives them, shape (n, 3).
        point_times_ns: When each was measured, shape (n,).
        boxes: Boxes at the reference moment, with velocities over ground; those of unknown velocity are left out.
        reference_ns: The moment.
        margin_m: By how much boxes grow.

    Returns:
        The points, in the order given, shape (n, 3).

    Raises:
        ConfigError: If the boxes have no velocities.
    """
    if boxes.velocity_m_s is None:
        raise ConfigError("deskew_boxes: expected boxes with velocities, got none. Track them first (farfield track).")
    later_s = (point_times_ns - reference_ns) / 1e9
    deskewed, nearest = points_m.astype(np.float64), np.full(len(points_m), np.inf)
    longest_s = float(np.abs(later_s).max(initial=0.0))
    for row in np.flatnonzero(np.isfinite(boxes.velocity_m_s).all(axis=1)):
        velocity = np.append(boxes.velocity_m_s[row], 0.0)[:3]
        radius_m = np.linalg.norm(boxes.size_m[row]) / 2 + 2 * margin_m + np.linalg.norm(velocity) * longest_s
        near = np.flatnonzero((np.abs(points_m - boxes.centre_m[row]) <= radius_m).all(axis=1))
        back = points_m[near] - later_s[near, None] * velocity
        away = np.linalg.norm(back - boxes.centre_m[row], axis=1)
        inside = inside_box(back, boxes, int(row), margin_m=margin_m) & (away < nearest[near])
        deskewed[near[inside]], nearest[near[inside]] = back[inside], away[inside]
    return deskewed.astype(points_m.dtype)
