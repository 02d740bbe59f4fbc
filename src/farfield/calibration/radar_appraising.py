"""What matched objects say of a radar's pose as it stands, without a step of a solver: for a page on which it moves."""

from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.calibration.problems import appraise
from farfield.calibration.radar_lidar import GATES_M, LEAST_MATCHES, RadarCalibration
from farfield.calibration.radar_matching import (
    RadarEvidence,
    RadarPose,
    match_frame,
    match_objects,
    move_targets,
    observation_shares,
    polar_residuals,
    whitened_residuals,
)
from farfield.calibration.radar_pairs import PARAMETERS, MatchedObjects, radar_notes
from farfield.calibration.radar_systematic import systematic_covariance
from farfield.errors import DatasetError


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
            f"{len(pairs.track)} objects of both sensors lie within {gate_m:g} m of one another, expected "
            f"{LEAST_MATCHES}: move the cloud nearer, or refine"
        )
    rows, counted = partial(whitened_residuals, pairs=pairs), observation_shares(pairs, pose.vector)
    solution = appraise(rows, pose.vector, PARAMETERS, group=pairs.track, share=counted)
    solution = replace(solution, covariance=solution.covariance + systematic_covariance(pairs, pose.vector))
    above = float(np.median(pairs.radar_m[:, 2] - pairs.lidar_m[:, 2])) - pose.z_m
    residual = polar_residuals(pose.vector, pairs)
    found = RadarCalibration(
        pose=pose,
        solution=solution,
        echoes_above_m=above,
        notes=radar_notes(pose.frames, solution, {}, pairs, above),
        range_m=residual[:, 0],
        azimuth_rad=residual[:, 1],
        rivals={},
    )
    return found, pairs


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
