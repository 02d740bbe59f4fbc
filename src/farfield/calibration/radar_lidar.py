"""Radar to LiDAR: x, y, yaw, frame offset and the time offset within a frame, from many frames of one sequence.

``radar_matching`` says how objects lie to one another. x and dt separate only where relative speeds differ; otherwise
the solution says so and the prior on dt stands. A mean range bias of the radar moves with x and is part of it.
"""

from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, repeat

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from farfield.calibration.bird import PoseHypothesis, correlate
from farfield.calibration.problems import Parameter, Progress, Solution, no_progress, solve
from farfield.calibration.radar_matching import (
    RadarEvidence,
    RadarPose,
    match_objects,
    observation_shares,
    peak_costs,
    polar_residuals,
    whitened_residuals,
)
from farfield.calibration.radar_pairs import PARAMETERS, MatchedObjects, radar_notes, standard_errors_worse
from farfield.calibration.radar_systematic import systematic_covariance
from farfield.errors import DatasetError

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
_MOST_TRIED = 200


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


def calibrate_radar(
    evidence: RadarEvidence, guess: RadarPose, *, reach_m: float = 3.0, frames: int = 4, told: Progress = no_progress
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
    around = PoseHypothesis(frames=guess.frames, yaw_rad=guess.yaw_rad, x_m=guess.x_m, y_m=guess.y_m, score=0.0)
    starts = correlate(
        evidence.maps, around, reach_m=reach_m, frames=frames, told=lambda done: told(_MAPS_SHARE * done)
    )
    tried: list[_Tried] = []
    for place, start in enumerate(starts):
        told(_MAPS_SHARE + (1 - _MAPS_SHARE) * place / len(starts))
        if (refined := _solve_start(evidence, start, guess)) is not None:
            tried.append(refined)
    if not tried:
        raise DatasetError(
            f"radar-lidar: expected {LEAST_MATCHES} objects that both sensors see, found fewer in "
            f"{len(evidence.moments)} frames. Take more frames, a busier road, or a nearer start."
        )
    most = max(len(pairs.track) for _, pairs, _ in tried)
    tried = [each for each in tried if 2 * len(each[1].track) >= most]  # few matches fit anything
    costs = np.array([peak_costs(evidence, pose, guess) for pose, _, _ in tried])
    best = _least_cost(costs)
    end = _search_peaks(evidence, tried[best], guess)
    if abs(end[0].time_offset_s) > evidence.period_s / 2:
        end = _fold_time_offset(evidence, end[0].vector, end[0].frames, guess) or end
    pose, pairs, solution = end
    costs[best] = peak_costs(evidence, pose, guess)
    rivals: dict[int, float] = {}
    for i in np.argsort(np.nanmean(costs, axis=1), kind="stable"):  # the best of each frame offset
        if tried[i][0].frames != pose.frames:
            rivals.setdefault(tried[i][0].frames, standard_errors_worse(costs[i], costs[best]))
    above = float(np.median(pairs.radar_m[:, 2] - pairs.lidar_m[:, 2])) - guess.z_m
    solution = replace(solution, covariance=solution.covariance + systematic_covariance(pairs, solution.value))
    residual = polar_residuals(solution.value, pairs)
    return RadarCalibration(
        pose=pose,
        solution=solution,
        echoes_above_m=above,
        notes=radar_notes(pose.frames, solution, rivals, pairs, above),
        range_m=residual[:, 0],
        azimuth_rad=residual[:, 1],
        rivals=rivals,
    )


_Tried = tuple[RadarPose, MatchedObjects, Solution]


def _least_cost(costs: Float[np.ndarray, "tries frames"]) -> int:
    """The try that costs least in the radar frames that it shares with the others: not all have as many peaks."""
    best = 0
    for i in range(1, len(costs)):
        if np.nansum(costs[i] - costs[best]) < 0:
            best = i
    return best


def _solve_start(evidence: RadarEvidence, start: PoseHypothesis, guess: RadarPose) -> _Tried | None:
    """Solve from a start of the maps; a time offset of whole frames goes into the frame offset.

    Where speeds differ, the objects tell the whole time, however many frames the start is off.
    """
    value, frames = np.array([start.x_m, start.y_m, start.yaw_rad, guess.time_offset_s]), start.frames
    loose = (*PARAMETERS[:3], replace(PARAMETERS[3], prior_sigma=_LOOSE_S))
    first = _match_and_solve(evidence, value, frames, guess, loose, GATES_M)
    if first is None:
        return None
    return _fold_time_offset(evidence, first[1].value, frames, guess)


def _fold_time_offset(
    evidence: RadarEvidence, value: Float[np.ndarray, " 4"], frames: int, guess: RadarPose
) -> _Tried | None:
    """Solve again from a solution, with whole frames of its time offset in the frame offset, until none is left."""
    found = None
    for _ in range(_FOLDS):
        late = round(float(value[3] / evidence.period_s))
        value, frames = value - [0.0, 0.0, 0.0, late * evidence.period_s], frames - late
        found = _match_and_solve(evidence, value, frames, guess, PARAMETERS, GATES_M[-2:])
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


def _search_peaks(evidence: RadarEvidence, found: _Tried, guess: RadarPose) -> _Tried:
    """Solve again from where all peaks together lie nearest to the LiDAR's objects.

    Which of neighbouring peaks an object matches depends on where the search comes from, and holds it there; the least
    distance of all peaks is one place, wherever it is searched from.
    """
    pose, _, _ = found
    corners = np.vstack([np.zeros(4), np.eye(4)])
    nearest = minimize(
        _peaks_away,
        corners[0],
        args=(evidence, pose, guess),
        method="Nelder-Mead",
        options={"initial_simplex": corners, "xatol": _NEAR_STEPS, "fatol": _NEAR_COST, "maxfev": _MOST_TRIED},
    )
    value = pose.vector + nearest.x * _STEPS
    end = _match_and_solve(evidence, value, pose.frames, guess, PARAMETERS, GATES_M[-2:])
    return found if end is None else (_posed(end[1].value, pose.frames, guess), *end)


def _peaks_away(steps: Float[np.ndarray, " 4"], evidence: RadarEvidence, begun: RadarPose, guess: RadarPose) -> float:
    """How far all peaks lie from the LiDAR's objects so many steps from where the search began."""
    there = _posed(begun.vector + steps * _STEPS, begun.frames, guess)
    return float(np.nanmean(peak_costs(evidence, there, guess)))


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
    found, mean = None, guess.vector
    for number, gate_m in enumerate(chain(gates_m, repeat(gates_m[-1], _MORE_ROUNDS)), start=1):
        pairs = match_objects(evidence, value, frames, gate_m)
        if len(pairs.track) < LEAST_MATCHES:
            return None
        rows = partial(whitened_residuals, pairs=pairs)
        counted = observation_shares(pairs, value)
        solution = solve(rows, mean, parameters, group=pairs.track, share=counted, begin=value)
        value, found = solution.value, (pairs, solution)
        if number >= len(gates_m) and (np.abs(value - mean)[:3] < _AT_REST).all():
            break
        mean = np.append(value[:3], guess.time_offset_s)
    return found


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
    found = _match_and_solve(evidence, guess.vector, guess.frames, guess, PARAMETERS, GATES_M)
    if found is None:
        raise DatasetError(f"radar-lidar: expected {LEAST_MATCHES} objects that both sensors see, found fewer")
    _, pairs, solution = _search_peaks(evidence, (_posed(found[1].value, guess.frames, guess), *found), guess)
    systematic = systematic_covariance(pairs, solution.value)
    return RefinedPose(value=solution.value, covariance=solution.covariance + systematic, systematic=systematic)
