"""LiDAR to LiDAR: point-to-plane registration (Chen and Medioni, 1992) of the sweeps of two sensors of one car."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from farfield.calibration.problems import Parameter, Solution, solve
from farfield.errors import DatasetError
from farfield.geometry.poses import pose, transform_points

_VOXEL_M = 0.25
_NEIGHBOURS = 10
_GATES_M = (2.0, 1.0, 0.5, 0.3, 0.3, 0.3, 0.3, 0.3)
_SIGMA_M = 0.03
_LEAST_POINTS = 200
_PLANAR = 0.05  # of the variance of a neighbourhood across its plane
_NEAR_M = 50.0

PARAMETERS = (
    *(
        Parameter(name=n, unit="rad", scale=np.radians(0.1), prior_sigma=np.radians(5.0))
        for n in ("roll", "pitch", "yaw")
    ),
    *(Parameter(name=n, unit="m", scale=0.01, prior_sigma=1.0) for n in ("x", "y", "z")),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Registration:
    """What was found.

    Args:
        target_T_source: Maps points of the second LiDAR to the first's frame, shape (4, 4).
        solution: Turns about and shifts along the first's axes from the last step, with sigma.
        rms_m: Root mean square distance from the planes.
        pairs: Points that had a plane within the last gate.
    """

    target_T_source: Float[np.ndarray, "4 4"]
    solution: Solution
    rms_m: float
    pairs: int


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
    planes = [_planes(points) for points in targets]
    thin = [_thinned(points) for points in sources]
    found = np.eye(4) if start is None else start.copy()
    solution, pairs = None, 0
    for gate_m in gates_m:
        rows = [
            _pairs(plane, source, found, gate_m, i) for i, (plane, source) in enumerate(zip(planes, thin, strict=True))
        ]
        point, foot, normal, frame = (np.concatenate(column) for column in zip(*rows, strict=True))
        if (pairs := len(point)) < _LEAST_POINTS:
            raise DatasetError(
                f"registration: expected {_LEAST_POINTS} points within {gate_m:g} m of the other LiDAR's planes, got "
                f"{pairs}. Give a nearer start."
            )
        residuals = partial(_distances, points_m=point, feet_m=foot, normals=normal)
        block = frame * 1000 + np.floor(np.degrees(np.arctan2(point[:, 1], point[:, 0])) / 10).astype(int)
        solution = solve(residuals, np.zeros(6), PARAMETERS, group=block, steps=4)
        found = _step(solution.value) @ found
        if gate_m == gates_m[-1] and float(np.abs(solution.value[3:]).max()) < 1e-4:
            break
    assert solution is not None
    rms = float(np.sqrt(np.mean((solution.after * _SIGMA_M) ** 2)))
    return Registration(target_T_source=found, solution=replace(solution), rms_m=rms, pairs=pairs)


def _step(value: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "4 4"]:
    return pose(Rotation.from_rotvec(value[:3]).as_matrix(), value[3:])


def _distances(
    value: Float[np.ndarray, " 6"],
    points_m: Float[np.ndarray, "n 3"],
    feet_m: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 1"]:
    away = transform_points(_step(value), points_m) - feet_m
    return np.einsum("ij,ij->i", away, normals)[:, None] / _SIGMA_M


def _thinned(points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """One point of each voxel: the first, so that it lies on the surface."""
    points = points_m.astype(np.float64)
    reach = np.linalg.norm(points, axis=1)
    points = points[(reach > 2.0) & (reach < _NEAR_M)]
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
    points = _thinned(points_m)
    if len(points) <= _NEIGHBOURS:
        return _Planes(tree=cKDTree(np.zeros((1, 3)) + 1e9), points_m=np.zeros((1, 3)), normals=np.zeros((1, 3)))
    _, near = cKDTree(points).query(points, k=_NEIGHBOURS)
    near = np.asarray(near)
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around) / _NEIGHBOURS)
    flat = (values[:, 0] < _PLANAR * values[:, 1]) & (values[:, 1] > 0.05 * values[:, 2])
    return _Planes(tree=cKDTree(points[flat]), points_m=points[near].mean(axis=1)[flat], normals=vectors[flat, :, 0])


def _pairs(
    planes: _Planes, source_m: Float[np.ndarray, "n 3"], found: Float[np.ndarray, "4 4"], gate_m: float, number: int
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"], Int[np.ndarray, " m"]]:
    at = transform_points(found, source_m)
    distance, partner = planes.tree.query(at, distance_upper_bound=gate_m)
    partner, kept = np.asarray(partner), np.flatnonzero(np.isfinite(distance))
    kept = kept[:: max(len(kept) // 6000, 1)]
    plane = partner[kept]
    return at[kept], planes.points_m[plane], planes.normals[plane], np.full(len(kept), number)
