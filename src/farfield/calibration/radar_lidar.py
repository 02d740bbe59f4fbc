"""Radar to LiDAR: x, y, yaw, frame offset and the time offset within a frame, from many frames of one sequence.

``p_radar = R(yaw) (p_lidar + v (dt - lag)) + t`` (the LiDAR's near faces, moved to the time of the radar), with
residuals in range and azimuth. x and dt separate only where relative speeds differ; otherwise the solution says so and
the prior on dt stands. A mean range bias of the radar moves with x and is part of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float

from farfield.calibration.bird import Maps, Start, correlate
from farfield.calibration.moments import Moment
from farfield.calibration.problems import Parameter, Solution, Told, solve, untold
from farfield.calibration.radar_pairs import PARAMETERS, Pairs, notes_of, standing
from farfield.calibration.targets import Peaks, Targets, find_peaks, find_targets
from farfield.errors import DatasetError

RANGE_CELL_M = 0.462890625  # of K-Radar
AZIMUTH_CELL_RAD = np.radians(1.0)
_SIGMA_RANGE_M = 0.2
_SIGMA_AZIMUTH_RAD = np.radians(0.45)
_SIGMA_FACE_M = 0.12
GATES_M = (1.6, 1.0, 0.8, 0.8)
"""How far matched objects may be from one another, round by round."""
LEAST_MATCHES = 12
_GLINT = 0.25  # of an object's width: by how much its brightest point is off its middle
_ALIKE = 0.5  # correlation of what an object's matches err by
_UNKNOWN_M_S = 14.0  # how fast what is taken to stand may be, where its velocity is not known
_FOLDS = 4  # times that whole frames may move from the time offset into the frame offset
_LOOSE_S = 0.3
_SAME_M = 0.25  # a frame
_MAPS_SHARE = 0.5  # of the time
_ROUNDS, _GAIN = 3, 1e-3
_TURNS_RAD = np.radians([-0.5, -0.25, 0.0, 0.25, 0.5])
SYSTEMATIC = np.array([0.04, 0.04, np.radians(0.08), 0.004])
"""What more objects do not average away, one sigma: range bias, glint that favours a side, tracking of velocities; set
from simulated drives with known truth."""


@dataclass(frozen=True, kw_only=True)
class RadarPose:
    """A calibration: ``radar_T_lidar`` has yaw and translation only; the radar runs ``frames`` frames and dt ahead.

    Args:
        x_m: Translation of ``radar_T_lidar``.
        y_m: Its y.
        z_m: Its z.
        yaw_rad: Its yaw.
        frames: Radar frames to add to those that the data set pairs.
        time_offset_s: How much later the radar measured than the sweep's own time, after that.
    """

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float = 0.0
    frames: int = 0
    time_offset_s: float = 0.0

    @property
    def vector(self) -> Float[np.ndarray, " 4"]:
        """The four values that are solved for."""
        return np.array([self.x_m, self.y_m, self.yaw_rad, self.time_offset_s])


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarCalibration:
    """What was found.

    Args:
        pose: The calibration.
        solution: x, y, yaw and time offset with covariance.
        echoes_above_m: How much higher than the LiDAR's faces the radar's echoes lie with the given z, the median.
        notes: What the data cannot tell, as sentences.
        range_m: Residuals in range of the matches, shape (n,).
        azimuth_rad: Their residuals in azimuth, shape (n,).
        rivals: Cost of each frame offset that was tried, against the best in standard errors.
    """

    pose: RadarPose
    solution: Solution
    echoes_above_m: float
    notes: tuple[str, ...]
    range_m: Float[np.ndarray, " n"]
    azimuth_rad: Float[np.ndarray, " n"]
    rivals: dict[int, float]

    @property
    def residual(self) -> dict[str, float]:
        """Median absolute residuals in centimetres, degrees and radar cells."""
        ranges, angles = (float(np.median(np.abs(each))) for each in (self.range_m, self.azimuth_rad))
        return {
            "matches": float(len(self.range_m)),
            "range_cm": 100 * ranges,
            "range_cells": ranges / RANGE_CELL_M,
            "azimuth_deg": float(np.degrees(angles)),
            "azimuth_cells": angles / AZIMUTH_CELL_RAD,
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """Maps and objects of all frames, made once.

    Args:
        moments: Frames of one sequence.
        targets: LiDAR targets by number of the frame.
        peaks: Radar peaks by number of the LiDAR frame that they are paired with.
        period_s: Time between frames.
    """

    moments: Sequence[Moment]
    targets: Mapping[int, Targets]
    peaks: Mapping[int, Peaks]
    period_s: float = 0.1

    @classmethod
    def of(cls, moments: Sequence[Moment], *, period_s: float = 0.1) -> "Evidence":
        """Find the objects of all frames."""
        peaks = {each.number: find_peaks(each) for each in moments}
        targets = dict(zip(peaks, find_targets(moments), strict=True))
        return cls(moments=moments, targets=targets, peaks=peaks, period_s=period_s)

    @cached_property
    def maps(self) -> Maps:
        """Bird's-eye maps; what one start correlates, later ones find again."""
        return Maps(self.moments)

    @cached_property
    def speeds(self) -> Mapping[int, Float[np.ndarray, "n 2"]]:
        """Velocities of the targets of each frame in m/s, the usual one where they are not known."""
        return {number: _speeds(each, self.period_s) for number, each in self.targets.items()}


def calibrate_radar(
    evidence: Evidence, guess: RadarPose, *, reach_m: float = 3.0, frames: int = 4, told: Told = untold
) -> RadarCalibration:
    """Find the radar's pose and time from a rough start.

    Args:
        evidence: Frames of one sequence; 20 or more.
        guess: About right: +-2 m, +-3 degrees, +-3 frames.
        reach_m: How far x and y are searched.
        frames: How many frame offsets to each side are tried.
        told: Is told the share that is done; may raise to end it.

    Raises:
        DatasetError: If too few objects match.
    """
    around = Start(frames=guess.frames, yaw_rad=guess.yaw_rad, x_m=guess.x_m, y_m=guess.y_m, score=0.0)
    starts = correlate(
        evidence.maps, around, reach_m=reach_m, frames=frames, told=lambda done: told(_MAPS_SHARE * done)
    )
    tried: list[_Tried] = []
    for place, start in enumerate(starts):
        told(_MAPS_SHARE + (1 - _MAPS_SHARE) * place / len(starts))
        if (refined := _refined(evidence, start, guess)) is not None:
            tried.append(refined)
    if not tried:
        raise DatasetError(
            f"radar-lidar: expected {LEAST_MATCHES} objects that both sensors see, found fewer in "
            f"{len(evidence.moments)} frames. Take more frames, a busier road, or a nearer start."
        )
    most = max(len(pairs.track) for _, pairs, _ in tried)
    tried = [each for each in tried if 2 * len(each[1].track) >= most]  # few matches fit anything
    costs = np.array([_costs(evidence, pose, guess) for pose, _, _ in tried])
    order = np.argsort(np.nanmean(costs, axis=1), kind="stable")
    best = int(order[0])
    end = _polished(evidence, tried[best], guess)
    if abs(end[0].time_offset_s) > evidence.period_s / 2:
        end = _folded(evidence, end[0].vector, end[0].frames, guess) or end
    pose, pairs, solution = end
    costs[best] = _costs(evidence, pose, guess)
    rivals: dict[int, float] = {}
    for i in order[1:]:  # the best of each frame offset
        if tried[i][0].frames != pose.frames:
            rivals.setdefault(tried[i][0].frames, standing(costs[i], costs[best]))
    above = float(np.median(pairs.radar_m[:, 2] - pairs.lidar_m[:, 2])) - guess.z_m
    solution = replace(solution, covariance=solution.covariance + np.diag(SYSTEMATIC**2))
    residual = polar(solution.value, pairs)
    return RadarCalibration(
        pose=pose,
        solution=solution,
        echoes_above_m=above,
        notes=notes_of(pose.frames, solution, rivals, pairs, above),
        range_m=residual[:, 0],
        azimuth_rad=residual[:, 1],
        rivals=rivals,
    )


_Tried = tuple[RadarPose, Pairs, Solution]


def _refined(evidence: Evidence, start: Start, guess: RadarPose) -> _Tried | None:
    """Solve from a start of the maps; a time offset of whole frames goes into the frame offset.

    Where speeds differ, the objects tell the whole time, however many frames the start is off.
    """
    value, frames = np.array([start.x_m, start.y_m, start.yaw_rad, guess.time_offset_s]), start.frames
    loose = (*PARAMETERS[:3], replace(PARAMETERS[3], prior_sigma=_LOOSE_S))
    first = _solved(evidence, value, frames, guess, loose, GATES_M)
    if first is None:
        return None
    return _folded(evidence, first[1].value, frames, guess)


def _folded(evidence: Evidence, value: Float[np.ndarray, " 4"], frames: int, guess: RadarPose) -> _Tried | None:
    """Solve again from a solution, with whole frames of its time offset in the frame offset, until none is left."""
    found = None
    for _ in range(_FOLDS):
        late = round(float(value[3] / evidence.period_s))
        value, frames = value - [0.0, 0.0, 0.0, late * evidence.period_s], frames - late
        found = _solved(evidence, value, frames, guess, PARAMETERS, GATES_M[-2:])
        if found is None:
            return None
        value = found[1].value
        if abs(value[3]) <= evidence.period_s / 2:
            break
    assert found is not None
    return _posed(value, frames, guess), *found


def _posed(value: Float[np.ndarray, " 4"], frames: int, guess: RadarPose) -> RadarPose:
    x, y, yaw, time_s = (float(each) for each in value)
    return RadarPose(x_m=x, y_m=y, z_m=guess.z_m, yaw_rad=yaw, frames=frames, time_offset_s=time_s)


def _polished(evidence: Evidence, found: _Tried, guess: RadarPose) -> _Tried:
    """Solve again from turns about the matched objects' middle to each side, and keep what explains the peaks best.

    Which of neighbouring peaks an object matches depends on where the search comes from, and holds it there.
    """
    least = float(np.nanmean(_costs(evidence, found[0], guess)))
    for _ in range(_ROUNDS):
        ends = [end for turn in _TURNS_RAD if (end := _turned(evidence, found, turn, guess)) is not None]
        costs = [float(np.nanmean(_costs(evidence, end[0], guess))) for end in ends]
        if not ends or min(costs) > least - _GAIN:
            break
        found, least = ends[int(np.argmin(costs))], min(costs)
    return found


def _turned(evidence: Evidence, found: _Tried, turn_rad: float, guess: RadarPose) -> _Tried | None:
    """Where a solution leads to that is turned, with the time offset as it was guessed."""
    pose, pairs, _ = found
    middle, still = pairs.lidar_m.mean(axis=0, keepdims=True), np.zeros((1, 2))
    value = np.array([pose.x_m, pose.y_m, pose.yaw_rad + turn_rad, guess.time_offset_s])
    value[:2] += (placed(pose.vector, middle, still, still[0, :1]) - placed(value, middle, still, still[0, :1]))[0]
    end = _solved(evidence, value, pose.frames, guess, PARAMETERS, GATES_M[-2:])
    return None if end is None else (_posed(end[1].value, pose.frames, guess), *end)


def _solved(
    evidence: Evidence,
    value: Float[np.ndarray, " 4"],
    frames: int,
    guess: RadarPose,
    parameters: tuple[Parameter, ...],
    gates_m: tuple[float, ...],
) -> tuple[Pairs, Solution] | None:
    """Match and solve in turn, with a narrower gate each time; the prior then stands where the last solution did.

    It holds what the data do not tell, and does not draw what they tell weakly towards a rough start.
    """
    found, mean = None, guess.vector
    for gate_m in gates_m:
        pairs = match_objects(evidence, value, frames, gate_m)
        if len(pairs.track) < LEAST_MATCHES:
            return None
        rows = partial(whitened, pairs=pairs)
        counted = shares(pairs, value)
        solution = solve(rows, mean, parameters, group=pairs.track, share=counted, begin=value)
        value, found = solution.value, (pairs, solution)
        mean = np.append(value[:3], guess.time_offset_s)
    return found


def shares(pairs: Pairs, value: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " n"]:
    """For how many observations each match counts: an object's echo errs alike in all of its frames.

    One whose velocity is not known may drive: it lies wrong by the time between LiDAR and radar times that speed.
    """
    _, which, count = np.unique(pairs.track, return_inverse=True, return_counts=True)
    moved_m = np.where(pairs.tracked, 0.0, _UNKNOWN_M_S) * (value[3] - pairs.lag_s)
    return np.asarray(1.0 / ((1.0 + _ALIKE * (count[which] - 1.0)) * (1.0 + (moved_m / _SIGMA_RANGE_M) ** 2)))


def placed(
    value: Float[np.ndarray, " 4"],
    lidar_m: Float[np.ndarray, "n 3"],
    velocity_m_s: Float[np.ndarray, "n 2"],
    lag_s: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 2"]:
    """LiDAR targets in the radar's frame at the radar's time."""
    at = lidar_m[:, :2] + velocity_m_s * (value[3] - lag_s)[:, None]
    cos, sin = np.cos(value[2]), np.sin(value[2])
    return at @ np.array([[cos, sin], [-sin, cos]]) + value[:2]


def _speeds(targets: Targets, period_s: float) -> Float[np.ndarray, "n 2"]:
    """Velocities; where they are not known, or differ by noise only, the usual one of the frame.

    Noise in velocities would pose as a spread of speeds and claim to tell x from the time offset.
    """
    known = np.isfinite(targets.velocity[:, 0])
    usual = np.median(targets.velocity[known], axis=0) if known.any() else np.zeros(2)
    with np.errstate(invalid="ignore"):
        own = np.linalg.norm(targets.velocity - usual, axis=1) > _SAME_M
    return np.where((known & own)[:, None], targets.velocity, usual) / period_s


def match_objects(evidence: Evidence, value: Float[np.ndarray, " 4"], offset: int, gate_m: float) -> Pairs:
    """Pairs that are each other's nearest."""
    rows = [match_frame(evidence, value, number, number + offset, gate_m) for number in evidence.targets]
    lidar, width, speed, lag, tracked, radar, track = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Pairs(
        lidar_m=lidar, width_m=width, velocity_m_s=speed, lag_s=lag, radar_m=radar, track=track, tracked=tracked
    )


def _squares(at: Float[np.ndarray, "n 2"], peaks_m: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "n m"]:
    """Squared distances from each to each: for dozens faster than a tree."""
    return np.asarray((at[:, :1] - peaks_m[:, 0]) ** 2 + (at[:, 1:] - peaks_m[:, 1]) ** 2)


def match_frame(
    evidence: Evidence, value: Float[np.ndarray, " 4"], number: int, other: int, gate_m: float
) -> tuple[np.ndarray, ...]:
    """Columns of the pairs of one LiDAR frame and one radar frame."""
    targets = evidence.targets[number]
    peaks = evidence.peaks[other].place_m if other in evidence.peaks else np.zeros((0, 3))
    kept, partner = np.zeros(len(targets.place_m), dtype=bool), np.zeros(len(targets.place_m), dtype=int)
    speed = evidence.speeds[number]
    if len(kept) and len(peaks):
        away = _squares(placed(value, targets.place_m, speed, targets.lag_s), peaks)
        partner = away.argmin(axis=1)
        row = np.arange(len(kept))
        kept = (away[row, partner] < gate_m**2) & (away.argmin(axis=0)[partner] == row)
    width = targets.size_m.max(axis=1, initial=0.0)
    columns = (targets.place_m, width, speed, targets.lag_s, np.isfinite(targets.velocity[:, 0]))
    return *(each[kept] for each in columns), peaks[partner[kept]].reshape(-1, 3), targets.track[kept]


def polar(value: Float[np.ndarray, " 4"], pairs: Pairs) -> Float[np.ndarray, "n 2"]:
    """Residuals in range and azimuth, metres and radians: LiDAR minus radar."""
    at = placed(value, pairs.lidar_m, pairs.velocity_m_s, pairs.lag_s)
    seen = pairs.radar_m[:, :2]
    turn = np.arctan2(at[:, 1], at[:, 0]) - np.arctan2(seen[:, 1], seen[:, 0])
    return np.column_stack([np.hypot(at[:, 0], at[:, 1]) - np.hypot(seen[:, 0], seen[:, 1]), turn])


def whitened(value: Float[np.ndarray, " 4"], pairs: Pairs) -> Float[np.ndarray, "n 2"]:
    """:func:`polar` divided by sigma."""
    reach = np.hypot(pairs.radar_m[:, 0], pairs.radar_m[:, 1])
    across = np.hypot(_SIGMA_AZIMUTH_RAD, np.hypot(_SIGMA_FACE_M, _GLINT * pairs.width_m) / np.maximum(reach, 1.0))
    return polar(value, pairs) / np.column_stack([np.full(len(reach), _SIGMA_RANGE_M), across])


def _costs(evidence: Evidence, pose: RadarPose, guess: RadarPose) -> Float[np.ndarray, " frames"]:
    """Mean truncated squared distance of each radar frame's peaks to LiDAR targets, NaN where there is none.

    A radar frame counts for every frame offset alike, whatever it matched; the priors' cost is spread over the frames.
    """
    costs = np.full(len(evidence.peaks), np.nan)
    away = (pose.vector - guess.vector) / [each.prior_sigma for each in PARAMETERS]
    for row, (other, peaks) in enumerate(evidence.peaks.items()):
        targets = evidence.targets.get(other - pose.frames)
        if targets is None or not len(targets.place_m) or not len(peaks.place_m):
            continue
        at = placed(pose.vector, targets.place_m, evidence.speeds[other - pose.frames], targets.lag_s)
        square = _squares(at, peaks.place_m).min(axis=0)
        near = np.hypot(peaks.place_m[:, 0], peaks.place_m[:, 1])
        sigma = np.hypot(_SIGMA_RANGE_M, 0.5 * _SIGMA_AZIMUTH_RAD * near)
        costs[row] = float(np.minimum(square / sigma**2, 9.0).sum())
    return costs + 0.5 * float(away @ away) / max(int(np.isfinite(costs).sum()), 1)


def refine_radar(evidence: Evidence, guess: RadarPose) -> Solution:
    """Solve from a near start by matched objects alone, with the frame offset as given.

    Args:
        evidence: Frames of one sequence.
        guess: Within half a metre and two degrees.

    Returns:
        x, y, yaw and time offset; sigma holds the systematic part.

    Raises:
        DatasetError: If fewer than twelve objects match.
    """
    found = _solved(evidence, guess.vector, guess.frames, guess, PARAMETERS, GATES_M)
    if found is None:
        raise DatasetError(f"radar-lidar: expected {LEAST_MATCHES} objects that both sensors see, found fewer")
    _, _, solution = _polished(evidence, (_posed(found[1].value, guess.frames, guess), *found), guess)
    return replace(solution, covariance=solution.covariance + np.diag(SYSTEMATIC**2))
