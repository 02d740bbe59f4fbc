"""A sweep fitted to a map: point to plane, robust, with the directions that nothing observes left as predicted.

Residuals are distances to planes (Chen and Medioni 1992), weighted by Geman and McClure's function, whose scale falls
with the residuals' median. Directions of too little information keep the prediction (Zhang and Kaess, On degeneracy of
optimization-based state estimation problems, ICRA 2016, section IV): a wall seems to tell a little of the motion
along it, since fitted normals scatter, so the information is compared with what the normals' variance makes of nothing.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from farfield.geometry.deskewing import exponential
from farfield.odometry.surface_map import SurfaceMap

LEAST_INFORMATION = 2.0
"""A direction is observed if it has so many times the information that scattered normals alone make of it."""
_LEAST_SCATTER = 3e-5
_LEAST_PAIRS = 30
_SCALES = 3.0  # of the residuals' median
_LEAST_SCALE_M, _MOST_SCALE_M = 0.1, 1.0
_ITERATIONS = 25
_STILL_RAD, _STILL_M = 1e-4, 2e-3
_NEAR_RAD, _NEAR_M = 1e-3, 0.03  # steps until which every fourth point will do
_FEW = 4


@dataclass(frozen=True, eq=False)
class AlignmentFit:
    """Where a sweep lies.

    Args:
        world_T_sensor: Its pose, shape (4, 4).
        matched: Sum of the weights over the number of points: 1 if all lie on the map's planes.
        residual_m: Weighted root mean square of the distances to the planes.
        information: The least of any direction, as a multiple of what scatter makes, see :data:`LEAST_INFORMATION`.
        blind: Directions that were left as predicted, in the sensor's coordinates, turns (about an axis, times the
            lever arm) then translations, shape (k, 6); empty where all are observed.
        iterations: Steps taken.
    """

    world_T_sensor: Float[np.ndarray, "4 4"]
    matched: float
    residual_m: float
    information: float
    blind: Float[np.ndarray, "k 6"]
    iterations: int


def fit(
    surfaces: SurfaceMap,
    points_m: Float[np.ndarray, "n 3"],
    world_T_sensor: Float[np.ndarray, "4 4"],
    *,
    within_m: float,
) -> AlignmentFit | None:
    """Fit points to the surfaces, from a predicted pose.

    Args:
        surfaces: The map.
        points_m: Points in the sensor's coordinates, shape (n, 3).
        world_T_sensor: The predicted pose.
        within_m: Pairs lie nearer than this.

    Returns:
        None where fewer than 30 pairs are found.
    """
    pose = world_T_sensor.copy()
    every = _FEW if len(points_m) > _FEW * 10 * _LEAST_PAIRS else 1
    for iteration in range(1, _ITERATIONS + 1):
        lever = points_m[::every] @ pose[:3, :3].T
        rows, voxels = surfaces.nearest(lever + pose[:3, 3], within_m)
        if len(rows) < _LEAST_PAIRS:
            return None
        lever, normal = lever[rows], surfaces.normal[voxels]
        residual = ((lever + pose[:3, 3] - surfaces.mean_m[voxels]) * normal).sum(1)
        scale = min(max(_SCALES * float(np.median(np.abs(residual))), _LEAST_SCALE_M), _MOST_SCALE_M)
        weight = 1 / (1 + (residual / scale) ** 2) ** 2
        arm_m = float(np.sqrt((lever**2).sum(1).mean()))
        slope = np.concatenate([np.cross(lever, normal) / arm_m, normal], axis=1)
        weighted = slope * weight[:, None]
        information = weighted.T @ slope / weight.sum()
        wobble = np.maximum(surfaces.wobble[voxels], _LEAST_SCATTER) * weight / weight.sum()
        size, axes = eigh(information, _scattered(lever / arm_m, wobble))
        seen = size > LEAST_INFORMATION
        step = -axes[:, seen] @ ((axes[:, seen].T @ (weighted.T @ residual / weight.sum())) / size[seen])
        turn, along = step[:3] / arm_m, step[3:]
        pose[:3, :3] = exponential(np.concatenate([turn, np.zeros(3)])[None])[0, :3, :3] @ pose[:3, :3]
        pose[:3, 3] += along
        turned, moved = float(np.linalg.norm(turn)), float(np.linalg.norm(along))
        if every == 1 and turned < _STILL_RAD and moved < _STILL_M:
            break
        if (turned < _NEAR_RAD and moved < _NEAR_M) or iteration > _ITERATIONS // 2:
            every = 1
    unseen = axes[:, ~seen] / np.linalg.norm(axes[:, ~seen], axis=0)
    blind = unseen.T.reshape(-1, 2, 3) @ pose[:3, :3]
    return AlignmentFit(
        world_T_sensor=pose,
        matched=float(weight.sum() / len(points_m)),
        residual_m=float(np.sqrt((weight * residual**2).sum() / weight.sum())),
        information=float(size[0]),
        blind=blind.reshape(-1, 6),
        iterations=iteration,
    )


def _scattered(arm: Float[np.ndarray, "n 3"], wobble: Float[np.ndarray, " n"]) -> Float[np.ndarray, "6 6"]:
    """Information that normals would seem to give if they were nothing but their scatter, alike in all directions.

    Sum of ``w A A^T`` over the points, where ``A``, shape (6, 3), takes a normal to its slope: the cross product with
    the lever arm, and itself.
    """
    total = wobble.sum()
    mean = wobble @ arm
    spread = (arm * wobble[:, None]).T @ arm
    x, y, z = mean
    crossed = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[np.trace(spread) * np.eye(3) - spread, crossed], [crossed.T, total * np.eye(3)]])
