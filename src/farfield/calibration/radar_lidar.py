"""Radar to LiDAR: x, y, yaw, frame offset and the time offset within a frame, from many frames of one sequence.

Unknown are the vector (x, y, yaw, dt) and the whole frames by which the radar runs ahead; ``radar_matching`` states how
objects lie to one another and their whitened residuals, ``least_squares`` how they are minimised. x and dt separate
only where relative speeds differ; otherwise the solution says so and the prior on dt stands. A mean range bias of the
radar moves with x and is part of it. :func:`calibrate_radar` is the algorithm; :func:`refine_radar` starts near, and
:func:`appraise_radar` takes no step.
"""

from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, repeat

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from farfield.calibration.birds_eye_correlation import PoseHypothesis, correlate
from farfield.calibration.least_squares import (
    Parameter,
    Progress,
    Solution,
    appraise,
    consider_covariance,
    no_progress,
    solve,
)
from farfield.calibration.radar_features import THIN_M
from farfield.calibration.radar_matching import (
    PARAMETERS,
    MatchedObjects,
    RadarEvidence,
    RadarPose,
    azimuth_sigma_rad,
    match_frame,
    match_objects,
    move_targets,
    observation_shares,
    peak_costs,
    polar_residuals,
    radar_range_m,
    whitened_residuals,
)
from farfield.errors import DatasetError
from farfield.vocabulary.counts import count_of

RANGE_CELL_M = 0.462890625  # of K-Radar
AZIMUTH_CELL_RAD = np.radians(1.0)
GATES_M = (1.6, 1.0, 0.8, 0.8)
"""How far matched objects may be from one another, round by round."""
LEAST_MATCHES = 12
_MORE_ROUNDS = 6  # with the last gate, until the solution rests
_AT_REST = np.array([5e-4, 5e-4, np.radians(0.005)])  # x, y, yaw
_FOLDS = 4  # times that whole frames may move from the time offset into the frame offset
_LOOSE_S = 0.3
_MAPS_SHARE = 0.5  # of the time
_STEPS = np.array([0.05, 0.1, np.radians(0.2), 0.005])  # first ones of a search: x, y, yaw, time offset
_NEAR_STEPS, _NEAR_COST = 0.02, 1e-3  # where it ends: in those steps, and in squared sigmas a frame
_MOST_EVALUATIONS = 200

SYSTEMATIC = np.array([0.03, 0.025, np.radians(0.05), 0.004])
"""Of x, y, yaw and time offset whatever the objects, one sigma: range bias, side lobes, tracking of velocities; this
and the following set from simulated drives with known truth."""
_TILT_RAD, _TILTED_M = np.radians(0.2), 40.0
"""Near cars are seen outward and far ones inward of where they are, or the other way: one sigma, and where none is."""
_BESIDE_M = 0.04  # how far all cars are seen to one side
_MOST_SIGMAS = 3.0  # of a match: what errs by more does not count so much

_CLEAR = 2.0  # standard errors by which another frame offset is worse
_BLOCK = 4  # neighbouring frames see the same objects


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarCalibration:
    """A radar's pose and time against a LiDAR.

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
        ranges, angles = (float(np.median(np.abs(column))) for column in (self.range_m, self.azimuth_rad))
        return {
            "matches": float(len(self.range_m)),
            "range_cm": 100 * ranges,
            "range_cells": ranges / RANGE_CELL_M,
            "azimuth_deg": float(np.degrees(angles)),
            "azimuth_cells": angles / AZIMUTH_CELL_RAD,
        }


def calibrate_radar(
    evidence: RadarEvidence,
    guess: RadarPose,
    *,
    reach_m: float = 3.0,
    frames: int = 4,
    progress: Progress = no_progress,
) -> RadarCalibration:
    """Find the radar's pose and time from a rough start.

    Args:
        evidence: Frames of one sequence; 20 or more.
        guess: About right: +-2 m, +-3 degrees, +-3 frames.
        reach_m: How far x and y are searched.
        frames: How many frame offsets to each side are tried.
        progress: Is called with the share that is finished; may raise to end it.

    Raises:
        DatasetError: If too few objects match.
    """
    # 1. A start for each frame offset, from bird's-eye maps.
    around = PoseHypothesis(frames=guess.frames, yaw_rad=guess.yaw_rad, x_m=guess.x_m, y_m=guess.y_m, score=0.0)
    starts = correlate(
        evidence.maps, around, reach_m=reach_m, frames=frames, progress=lambda share: progress(_MAPS_SHARE * share)
    )

    # 2. Match objects and solve from each start.
    candidates: list[_Candidate] = []
    for number, start in enumerate(starts):
        progress(_MAPS_SHARE + (1 - _MAPS_SHARE) * number / len(starts))
        if (candidate := _solve_start(evidence, start, guess)) is not None:
            candidates.append(candidate)
    if not candidates:
        raise DatasetError(
            f"radar-lidar: expected {LEAST_MATCHES} objects that both sensors see, found fewer in "
            f"{count_of(len(evidence.sensor_pairs), 'frame')}. Take more frames, a busier road, or a nearer start."
        )
    most = max(len(pairs.track) for _, pairs, _ in candidates)
    candidates = [row for row in candidates if 2 * len(row[1].track) >= most]  # few matches fit anything

    # 3. The frame offset at which all peaks cost least.
    costs = np.array([peak_costs(evidence, pose, guess) for pose, _, _ in candidates])
    best = _least_cost(costs)

    # 4. Solve again from where all peaks lie nearest, with whole frames of the time in the frame offset.
    end = _search_peaks(evidence, candidates[best], guess)
    if abs(end[0].time_offset_s) > evidence.period_s / 2:
        end = _fold_time_offset(evidence, end[0].vector, end[0].frames, guess) or end
    pose, pairs, solution = end

    # 5. How much worse the other frame offsets are, the best of each.
    costs[best] = peak_costs(evidence, pose, guess)
    rivals: dict[int, float] = {}
    for i in np.argsort(np.nanmean(costs, axis=1), kind="stable"):
        if candidates[i][0].frames != pose.frames:
            rivals.setdefault(candidates[i][0].frames, standard_errors_worse(costs[i], costs[best]))

    # 6. Sigma with its systematic part, residuals, and what the data cannot tell.
    return _report(pose, pairs, solution, rivals, guess.z_m)


_Candidate = tuple[RadarPose, MatchedObjects, Solution]


def _solve_start(evidence: RadarEvidence, start: PoseHypothesis, guess: RadarPose) -> _Candidate | None:
    """Solve from a start of the maps; a time offset of whole frames goes into the frame offset.

    Where speeds differ, the objects tell the whole time, however many frames the start is off.
    """
    value = np.array([start.x_m, start.y_m, start.yaw_rad, guess.time_offset_s])
    loose = (*PARAMETERS[:3], replace(PARAMETERS[3], prior_sigma=_LOOSE_S))
    first = _match_and_solve(evidence, value, start.frames, guess, loose, GATES_M)
    return None if first is None else _fold_time_offset(evidence, first[1].value, start.frames, guess)


def _match_and_solve(
    evidence: RadarEvidence,
    value: Float[np.ndarray, " 4"],
    frames: int,
    guess: RadarPose,
    parameters: tuple[Parameter, ...],
    gates_m: tuple[float, ...],
) -> tuple[MatchedObjects, Solution] | None:
    """Match and solve in turn, with a narrower gate each time and then the last one, until the solution rests.

    The prior stands where the last solution did: it holds what the data do not tell, and does not draw what they tell
    weakly towards a rough start.
    """
    result, mean = None, guess.vector
    for number, gate_m in enumerate(chain(gates_m, repeat(gates_m[-1], _MORE_ROUNDS)), start=1):
        pairs = match_objects(evidence, value, frames, gate_m)
        if len(pairs.track) < LEAST_MATCHES:
            return None
        rows = partial(whitened_residuals, pairs=pairs)
        share = observation_shares(pairs, value)
        solution = solve(rows, mean, parameters, group=pairs.track, share=share, begin=value)
        value, result = solution.value, (pairs, solution)
        if number >= len(gates_m) and (np.abs(value - mean)[:3] < _AT_REST).all():
            break
        mean = np.append(value[:3], guess.time_offset_s)
    return result


def _fold_time_offset(
    evidence: RadarEvidence, value: Float[np.ndarray, " 4"], frames: int, guess: RadarPose
) -> _Candidate | None:
    """Solve again from a solution, with whole frames of its time offset in the frame offset, until none is left."""
    result = None
    for _ in range(_FOLDS):
        late = round(float(value[3] / evidence.period_s))
        value, frames = value - [0.0, 0.0, 0.0, late * evidence.period_s], frames - late
        result = _match_and_solve(evidence, value, frames, guess, PARAMETERS, GATES_M[-2:])
        if result is None:
            return None
        value = result[1].value
        if abs(value[3]) <= evidence.period_s / 2:
            break
    assert result is not None
    return _radar_pose(value, frames, guess), *result


def _least_cost(costs: Float[np.ndarray, "tries frames"]) -> int:
    """The try that costs least in the radar frames that it shares with the others: not all have as many peaks."""
    best = 0
    for i in range(1, len(costs)):
        if np.nansum(costs[i] - costs[best]) < 0:
            best = i
    return best


def _search_peaks(evidence: RadarEvidence, candidate: _Candidate, guess: RadarPose) -> _Candidate:
    """Solve again from where all peaks together lie nearest to the LiDAR's objects.

    Which of neighbouring peaks an object matches depends on where the search comes from, and holds it there; the least
    distance of all peaks is one position, wherever it is searched from.
    """
    pose, _, _ = candidate
    corners = np.vstack([np.zeros(4), np.eye(4)])
    nearest = minimize(
        _mean_peak_cost,
        corners[0],
        args=(evidence, pose, guess),
        method="Nelder-Mead",
        options={"initial_simplex": corners, "xatol": _NEAR_STEPS, "fatol": _NEAR_COST, "maxfev": _MOST_EVALUATIONS},
    )
    value = pose.vector + nearest.x * _STEPS
    end = _match_and_solve(evidence, value, pose.frames, guess, PARAMETERS, GATES_M[-2:])
    return candidate if end is None else (_radar_pose(end[1].value, pose.frames, guess), *end)


def _mean_peak_cost(
    steps: Float[np.ndarray, " 4"], evidence: RadarEvidence, pose: RadarPose, guess: RadarPose
) -> float:
    """How far all peaks lie from the LiDAR's objects so many steps from a pose."""
    there = _radar_pose(pose.vector + steps * _STEPS, pose.frames, guess)
    return float(np.nanmean(peak_costs(evidence, there, guess)))


def _radar_pose(value: Float[np.ndarray, " 4"], frames: int, guess: RadarPose) -> RadarPose:
    x, y, yaw, time_s = (float(number) for number in value)
    return RadarPose(x_m=x, y_m=y, z_m=guess.z_m, yaw_rad=yaw, frames=frames, time_offset_s=time_s)


def standard_errors_worse(costs: Float[np.ndarray, " frames"], best: Float[np.ndarray, " frames"]) -> float:
    """By how many standard errors a rival is worse, over the frames that both have, in blocks."""
    gap = costs - best
    blocks = [part[np.isfinite(part)].sum() for part in np.array_split(gap, max(len(gap) // _BLOCK, 2))]
    spread = float(np.std(blocks, ddof=1) * np.sqrt(len(blocks)))
    return float(np.sum(blocks)) / max(spread, 1e-9)


# Sigma and notes


def _report(
    pose: RadarPose, pairs: MatchedObjects, solution: Solution, rivals: dict[int, float], z_m: float
) -> RadarCalibration:
    above_m = float(np.median(pairs.radar_m[:, 2] - pairs.lidar_m[:, 2])) - z_m
    covariance = solution.covariance + systematic_covariance(pairs, solution.value)
    solution = replace(solution, covariance=covariance)
    residual = polar_residuals(solution.value, pairs)
    return RadarCalibration(
        pose=pose,
        solution=solution,
        echoes_above_m=above_m,
        notes=radar_notes(pose.frames, solution, rivals, pairs, above_m),
        range_m=residual[:, 0],
        azimuth_rad=residual[:, 1],
        rivals=rivals,
    )


def systematic_covariance(pairs: MatchedObjects, value: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "4 4"]:
    """Covariance of x, y, yaw and time offset by what all echoes err by alike: glint and side lobes of vehicles.

    No number of matched objects averages it away. A car's echo is drawn to the nearer corner when it is near, and by
    side lobes when it is far, on one side of the road as on the other. It does to y and yaw what the matches let it do:
    where posts tell them, little.

    Args:
        pairs: The matches.
        value: x, y, yaw and time offset.
    """
    range_m = radar_range_m(pairs)
    wide = (pairs.width_m >= THIN_M) / azimuth_sigma_rad(pairs)
    azimuth = np.stack([wide * _TILT_RAD * (1.0 - _TILTED_M / range_m), wide * _BESIDE_M / range_m])
    errors = np.stack([np.zeros_like(azimuth), np.clip(azimuth, -_MOST_SIGMAS, _MOST_SIGMAS)], axis=-1)
    rows, share = partial(whitened_residuals, pairs=pairs), observation_shares(pairs, value)
    return consider_covariance(rows, value, PARAMETERS, errors, share=share) + np.diag(SYSTEMATIC**2)


def radar_notes(
    frames: int, solution: Solution, rivals: dict[int, float], pairs: MatchedObjects, above_m: float
) -> tuple[str, ...]:
    """What the data cannot tell, as sentences."""
    notes = [*solution.unobserved, "x includes the mean range bias of the radar's echoes"]
    notes.append(
        f"z is not observed: kept as given (one cell of elevation is 0.7 m at 40 m; echoes lie {above_m:+.1f} m off)"
    )
    spread = float(np.percentile(pairs.velocity_m_s[:, 0], 90) - np.percentile(pairs.velocity_m_s[:, 0], 10))
    if solution.sigma[3] > 0.6 * PARAMETERS[3].prior_sigma:
        notes.append(f"x and time offset cannot be told apart here (speed spread {spread:.1f} m/s)")
    close = sorted(offset for offset, worse in rivals.items() if worse < _CLEAR)
    if close:
        named = ", ".join(f"{offset - frames:+d}" for offset in close)
        notes.append(f"frame offset is not certain: {named} frames explain the objects nearly as well")
    return tuple(dict.fromkeys(notes))


# From a near start, and without a step


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinedPose:
    """A radar's pose by matched objects.

    Args:
        value: x, y, yaw and time offset.
        covariance: Their covariance, the systematic part included.
        systematic: That part of it.
    """

    value: Float[np.ndarray, " 4"]
    covariance: Float[np.ndarray, "4 4"]
    systematic: Float[np.ndarray, "4 4"]


def refine_radar(evidence: RadarEvidence, guess: RadarPose) -> RefinedPose:
    """Solve from a near start by matched objects alone, with the frame offset as given.

    Args:
        evidence: Frames of one sequence.
        guess: Within half a metre and two degrees.

    Raises:
        DatasetError: If fewer than twelve objects match.
    """
    first = _match_and_solve(evidence, guess.vector, guess.frames, guess, PARAMETERS, GATES_M)
    if first is None:
        raise DatasetError(f"radar-lidar: expected {LEAST_MATCHES} objects that both sensors see, found fewer")
    start = (_radar_pose(first[1].value, guess.frames, guess), *first)
    _, pairs, solution = _search_peaks(evidence, start, guess)
    systematic = systematic_covariance(pairs, solution.value)
    return RefinedPose(value=solution.value, covariance=solution.covariance + systematic, systematic=systematic)


def appraise_radar(
    evidence: RadarEvidence, pose: RadarPose, *, gate_m: float = GATES_M[0]
) -> tuple[RadarCalibration, MatchedObjects]:
    """What matched objects say of a pose as it stands: residuals, sigma, what is not observed; no step is taken.

    Args:
        evidence: Frames of one sequence.
        pose: Any; where objects lie farther off than the gate, they do not match.
        gate_m: How far matched objects may be from one another.

    Returns:
        The pose with its residuals, and the objects that they are of.

    Raises:
        DatasetError: If fewer than twelve objects match.
    """
    pairs = match_objects(evidence, pose.vector, pose.frames, gate_m)
    if len(pairs.track) < LEAST_MATCHES:
        raise DatasetError(
            f"{count_of(len(pairs.track), 'object')} of both sensors lie within {gate_m:g} m of one another, expected "
            f"{LEAST_MATCHES}: move the cloud nearer, or refine"
        )
    rows, share = partial(whitened_residuals, pairs=pairs), observation_shares(pairs, pose.vector)
    solution = appraise(rows, pose.vector, PARAMETERS, group=pairs.track, share=share)
    return _report(pose, pairs, solution, {}, pose.z_m), pairs


def frame_matches(
    evidence: RadarEvidence, pose: RadarPose, number: int, *, gate_m: float = GATES_M[0]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Matched objects of one LiDAR frame.

    Args:
        evidence: Frames of one sequence.
        pose: The radar's.
        number: Number of the LiDAR frame; nothing matches in one that the evidence does not hold.
        gate_m: How far they may be from one another.

    Returns:
        Where the LiDAR's objects lie in the radar's frame, shape (n, 2), and the radar's peaks, shape (n, 2).
    """
    if number not in evidence.targets:
        return np.zeros((0, 2)), np.zeros((0, 2))
    columns = match_frame(evidence, pose.vector, number, number + pose.frames, gate_m)
    at = move_targets(pose.vector, columns[0], columns[2], columns[3])
    return at, columns[5][:, :2]
