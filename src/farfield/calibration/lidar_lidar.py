"""LiDAR to LiDAR: point-to-plane registration (Chen and Medioni, 1992) of the sweeps of two sensors of one car.

Sought is the motion delta of ``target_T_source`` for which the distances ``n_i . (exp(delta) p_i - q_i) / 3 cm`` of the
second LiDAR's points p_i from the planes through q_i with normals n_i of the first one's sweeps are least, robustly,
with pairs taken anew in each round. :func:`register` is the algorithm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from farfield.calibration.least_squares import Parameter, Solution, motion_vector, rigid_motion, solve
from farfield.errors import DatasetError
from farfield.geometry.poses import invert, transform_points

_VOXEL_M = 0.25
_NEIGHBOURS = 10
_GATES_M = (2.0, 1.0, 0.5, 0.3, 0.3, 0.3, 0.3, 0.3)
_SIGMA_M = 0.03
_LEAST_POINTS = 200
_AT_REST_M = 1e-4
_PLANAR = 0.05  # of the variance of a neighbourhood across its plane
_NEAR_M = 50.0
_MOST_PAIRS = 6000  # of a frame, about
_SYSTEMATIC_M = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 8e-4])
"""Of the six, what no number of points averages away, one sigma: the foot of what stands on the ground bends its planes
upward; from made-up streets with known truth (``benchmarks/calibration_checks.py sigma``)."""

PARAMETERS = (
    *(
        Parameter(name=n, unit="rad", scale=np.radians(0.1), prior_sigma=np.radians(5.0))
        for n in ("roll", "pitch", "yaw")
    ),
    *(Parameter(name=n, unit="m", scale=0.01, prior_sigma=1.0) for n in ("x", "y", "z")),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Registration:
    """The pose of one LiDAR in another's frame.

    Args:
        target_T_source: Maps points of the second LiDAR to the first's frame, shape (4, 4).
        solution: Turns about and shifts along the first's axes from the last step, with sigma.
        rms_m: Root mean square distance from the planes.
        pairs: Points that had a plane within the last gate.
        start: What it began from, shape (4, 4); None where nothing was known.
    """

    target_T_source: Float[np.ndarray, "4 4"]
    solution: Solution
    rms_m: float
    pairs: int
    start: Float[np.ndarray, "4 4"] | None = None

    def to_json(self) -> dict[str, Any]:
        """Pose, sigma, residual and what is not observed."""
        return {
            "kind": "lidar-lidar",
            "target_T_source": self.target_T_source.tolist(),
            "rms_cm": 100 * self.rms_m,
            "pairs": self.pairs,
            "notes": list(self.solution.unobserved),
            **({} if self.start is None else {"change": self._change(self.start)}),
            **self.solution.to_json(),
        }

    def _change(self, start: Float[np.ndarray, "4 4"]) -> dict[str, float]:
        """Turns in degrees and shifts in centimetres from the start, by the names of the parameters."""
        vector = motion_vector(self.target_T_source @ invert(start)) * ([180 / np.pi] * 3 + [100.0] * 3)
        names = [f"{parameter.name}_{'deg' if parameter.unit == 'rad' else 'cm'}" for parameter in PARAMETERS]
        return dict(zip(names, vector.tolist(), strict=True))


def register(
    targets: Sequence[Float[np.ndarray, "_ 3"]],
    sources: Sequence[Float[np.ndarray, "_ 3"]],
    start: Float[np.ndarray, "4 4"] | None = None,
    *,
    gates_m: Sequence[float] = _GATES_M,
) -> Registration:
    """Find where a LiDAR stands in another's frame from sweeps taken at the same moments.

    Args:
        targets: Sweeps of the first LiDAR, one a frame.
        sources: Sweeps of the second.
        start: ``target_T_source`` to begin with.
        gates_m: Largest distance of a pair in each round.

    Raises:
        DatasetError: If fewer than 200 points have a plane nearby.
    """
    # 1. Voxelise; planes of the first LiDAR's sweeps.
    planes = [_planes(points) for points in targets]
    thin = [_voxelise(points) for points in sources]
    target_T_source = np.eye(4) if start is None else start.copy()
    solution, pairs = None, 0
    for gate_m in gates_m:
        # 2. Pairs of points and planes within the gate, in all frames.
        rows = [
            _pairs(plane, source, target_T_source, gate_m, number)
            for number, (plane, source) in enumerate(zip(planes, thin, strict=True))
        ]
        point, foot, normal, frame = (np.concatenate(column) for column in zip(*rows, strict=True))
        if (pairs := len(point)) < _LEAST_POINTS:
            raise DatasetError(
                f"registration: expected {_LEAST_POINTS} points within {gate_m:g} m of the other LiDAR's planes, got "
                f"{pairs}. Give a nearer start."
            )

        # 3. Robust least squares of the distances; points of ten degrees of a frame err together.
        residuals = partial(_plane_distances, points_m=point, feet_m=foot, normals=normal)
        block = frame * 1000 + np.floor(np.degrees(np.arctan2(point[:, 1], point[:, 0])) / 10).astype(int)
        solution = solve(residuals, np.zeros(6), PARAMETERS, group=block, steps=4)
        target_T_source = rigid_motion(solution.value) @ target_T_source

        # 4. Again with a narrower gate, until the pose rests.
        if gate_m == gates_m[-1] and float(np.abs(solution.value[3:]).max()) < _AT_REST_M:
            break
    assert solution is not None
    solution = replace(solution, covariance=solution.covariance + np.diag(_SYSTEMATIC_M**2))
    rms = float(np.sqrt(np.mean((solution.after * _SIGMA_M) ** 2)))
    return Registration(target_T_source=target_T_source, solution=solution, rms_m=rms, pairs=pairs, start=start)


def _plane_distances(
    value: Float[np.ndarray, " 6"],
    points_m: Float[np.ndarray, "n 3"],
    feet_m: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 1"]:
    away = transform_points(rigid_motion(value), points_m) - feet_m
    return np.einsum("ij,ij->i", away, normals)[:, None] / _SIGMA_M


def _voxelise(points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """One point of each voxel: the first, so that it lies on the surface."""
    points = points_m.astype(np.float64)
    range_m = np.linalg.norm(points, axis=1)
    points = points[(range_m > 2.0) & (range_m < _NEAR_M)]
    _, first = np.unique(np.floor(points / _VOXEL_M).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Planes:
    """Points of a sweep with the normals of their neighbourhoods."""

    tree: cKDTree
    points_m: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]


def _planes(points_m: Float[np.ndarray, "n 3"]) -> _Planes:
    """Planes through ten neighbours, where those are flat and not on one line (one ring)."""
    points = _voxelise(points_m)
    if len(points) <= _NEIGHBOURS:
        return _Planes(tree=cKDTree(np.zeros((1, 3)) + 1e9), points_m=np.zeros((1, 3)), normals=np.zeros((1, 3)))
    _, near = cKDTree(points).query(points, k=_NEIGHBOURS)
    near = np.asarray(near)
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around) / _NEIGHBOURS)
    planar = (values[:, 0] < _PLANAR * values[:, 1]) & (values[:, 1] > 0.05 * values[:, 2])
    return _Planes(
        tree=cKDTree(points[planar]), points_m=points[near].mean(axis=1)[planar], normals=vectors[planar, :, 0]
    )


def _pairs(
    planes: _Planes,
    source_m: Float[np.ndarray, "n 3"],
    target_T_source: Float[np.ndarray, "4 4"],
    gate_m: float,
    number: int,
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"], Int[np.ndarray, " m"]]:
    """Points in the target's frame, feet and normals of their planes, and the frame's number; 6,000 or a few more."""
    points_m = transform_points(target_T_source, source_m)
    distance, partner = planes.tree.query(points_m, distance_upper_bound=gate_m)
    rows = np.flatnonzero(np.isfinite(distance))
    rows = rows[:: max(len(rows) // _MOST_PAIRS, 1)]
    plane = np.asarray(partner)[rows]
    return points_m[rows], planes.points_m[plane], planes.normals[plane], np.full(len(rows), number)
