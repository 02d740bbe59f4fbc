"""How well a track of poses agrees with known ones: absolute and relative errors.

Absolute (ATE, Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012, section IV): the distance
of the places after the one rigid motion that brings the tracks together best (Umeyama, TPAMI 1991, without scale).
Relative (RPE, same paper, and Geiger et al., Are We Ready for Autonomous Driving?, CVPR 2012, for lengths): how far
apart the tracks tell the motion over one step, or over a stretch of the known way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from farfield.errors import ConfigError
from farfield.files.poses_csv import PoseTable
from farfield.frame import Drive
from farfield.geometry.poses import logarithm
from farfield.odometry.drift import differences, way_m

LENGTHS_M = (10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0)
_LEAST_POSES = 3


@dataclass(frozen=True)
class ErrorSpread:
    """What errors amount to, in their own unit.

    Args:
        rmse: Root of the mean square.
        mean: Mean.
        median: Median.
        std: Standard deviation.
        least: The smallest.
        most: The greatest.
    """

    rmse: float
    mean: float
    median: float
    std: float
    least: float
    most: float

    @classmethod
    def of(cls, errors: Float[np.ndarray, " n"]) -> "ErrorSpread":
        """That of some errors, of which there is one at least."""
        values = (
            np.sqrt((errors**2).mean()),
            errors.mean(),
            np.median(errors),
            errors.std(),
            errors.min(),
            errors.max(),
        )
        return cls(*map(float, values))


@dataclass(frozen=True)
class Stretches:
    """Relative errors over stretches of one length.

    Args:
        length_m: The length.
        place_percent: Mean error of the place at their end, in per cent of the length.
        turn_deg_per_100m: Mean error of the direction, degrees per 100 m.
        stretches: How many there were; they begin every 10 m.
    """

    length_m: float
    place_percent: float
    turn_deg_per_100m: float
    stretches: int


@dataclass(frozen=True)
class TrackAccuracy:
    """A track against known poses.

    Args:
        poses: How many were compared.
        way_m: Length of the known way.
        ate_m: Absolute errors of the place.
        step_m: Relative errors of the place over one step.
        step_deg: Relative errors of the direction over one step.
        by_length: Relative errors over stretches, the shortest first.
    """

    poses: int
    way_m: float
    ate_m: ErrorSpread
    step_m: ErrorSpread
    step_deg: ErrorSpread
    by_length: tuple[Stretches, ...]

    def __str__(self) -> str:
        lines = [f"{'':<14}{'rmse':>9}{'mean':>9}{'median':>9}{'std':>9}{'min':>9}{'max':>9}"]
        for name, spread in (("ATE m", self.ate_m), ("RPE m/step", self.step_m), ("RPE deg/step", self.step_deg)):
            values = (spread.rmse, spread.mean, spread.median, spread.std, spread.least, spread.most)
            lines.append(f"{name:<14}" + "".join(f"{value:>9.4f}" for value in values))
        lines += [
            f"RPE {one.length_m:g} m: {one.place_percent:.3f} %, {one.turn_deg_per_100m:.4f} deg/100 m "
            f"({one.stretches} stretches)"
            for one in self.by_length
        ]
        return "\n".join(lines)


def aligned(poses: Float[np.ndarray, "n 4 4"], reference: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
    """The track moved rigidly so that its places lie nearest to the known ones, in the mean of squares.

    Args:
        poses: The track, shape (n, 4, 4).
        reference: Known poses of the same moments.
    """
    own, other = poses[:, :3, 3], reference[:, :3, 3]
    covariance = (other - other.mean(axis=0)).T @ (own - own.mean(axis=0))
    left, _, right = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    motion = np.eye(4)
    motion[:3, :3] = left @ np.diag(signs) @ right
    motion[:3, 3] = other.mean(axis=0) - motion[:3, :3] @ own.mean(axis=0)
    moved: Float[np.ndarray, "n 4 4"] = motion @ poses
    return moved


def accuracy_of(
    poses: Float[np.ndarray, "n 4 4"],
    reference: Float[np.ndarray, "n 4 4"],
    *,
    breaks: Bool[np.ndarray, " n"] | None = None,
    lengths_m: Sequence[float] = LENGTHS_M,
) -> TrackAccuracy:
    """Compare a track with known poses of the same moments.

    Args:
        poses: The track, shape (n, 4, 4).
        reference: The known poses, in any world, shape (n, 4, 4).
        breaks: Moments before which the track knows no motion: no step or stretch goes over one.
        lengths_m: Lengths of the stretches; longer ones than the way are left out.

    Raises:
        ConfigError: If there are fewer than three poses, or not equally many.
    """
    if poses.shape != reference.shape or len(poses) < _LEAST_POSES:
        raise ConfigError(
            f"accuracy: expected {_LEAST_POSES} poses or more on both sides, got {len(poses)} and {len(reference)}"
        )
    placed = aligned(poses, reference)
    steps = [np.linalg.inv(track[:-1]) @ track[1:] for track in (reference, poses)]
    difference = np.linalg.inv(steps[0]) @ steps[1]
    unbroken = np.ones(len(difference), dtype=bool) if breaks is None or breaks[1:].all() else ~breaks[1:]
    difference = difference[unbroken]
    whole = float(way_m(reference)[-1])
    rows = []
    for length_m in lengths_m:
        if length_m > whole:
            break
        _, apart_m, turn_deg = differences(reference, poses, breaks=breaks, stretch_m=length_m)
        if len(apart_m):
            rows.append(
                Stretches(
                    length_m,
                    float(100 * apart_m.mean() / length_m),
                    float(100 * turn_deg.mean() / length_m),
                    len(apart_m),
                )
            )
    return TrackAccuracy(
        poses=len(poses),
        way_m=whole,
        ate_m=ErrorSpread.of(np.linalg.norm(placed[:, :3, 3] - reference[:, :3, 3], axis=1)),
        step_m=ErrorSpread.of(np.linalg.norm(difference[:, :3, 3], axis=1)),
        step_deg=ErrorSpread.of(np.degrees(np.linalg.norm(logarithm(difference)[:, :3], axis=1))),
        by_length=tuple(rows),
    )


def against_drive(table: PoseTable, drive: Drive) -> TrackAccuracy | None:
    """A track against the poses that a drive has; None where it has none, or fewer than three of the same frames.

    Args:
        table: The track.
        drive: The drive.
    """
    if drive.world_T_frame is None:
        return None
    row_of = {frame: row for row, (_, frame) in enumerate(drive.keys)}
    pairs = [(row, row_of[frame]) for row, frame in enumerate(table.frames) if frame in row_of]
    if len(pairs) < _LEAST_POSES:
        return None
    own, other = np.array(pairs).T
    begins = np.cumsum(table.begins)[own]  # pieces of the whole track, of which only some frames are known
    breaks = np.concatenate([[True], np.diff(begins) > 0])
    return accuracy_of(table.world_T_frame[own], drive.world_T_frame[other], breaks=breaks)


def accuracy_json(accuracy: TrackAccuracy) -> dict[str, Any]:
    """As JSON values."""
    return {
        **{name: vars(value) if isinstance(value, ErrorSpread) else value for name, value in vars(accuracy).items()},
        "by_length": [vars(one) for one in accuracy.by_length],
    }
