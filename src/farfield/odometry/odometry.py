"""Odometry of one LiDAR: where the sensor was at each sweep, by fitting each to a map of those before it.

The motion between two sweeps is predicted as the last one's, the points of a sweep are moved to its reference moment by
it where they have times, and what moves by itself is left to the robust weights. Drift is bounded by nothing: no loop
is closed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from farfield.geometry.poses import exponential, invert, logarithm
from farfield.odometry.surface_map import SurfaceMap, thinned

START_SWEEPS = 5
"""So many sweeps decide at what speed a drive begins."""
_START_STEP_M = 1.5  # between two hypotheses of the first motion: what the fit reaches from either side
_START_MOST = 20
_FAST_M_S = 45.0
_AS_GOOD = 0.9  # standing matches nearly as well as the best motion
_LOST_SHARE = 0.1
_LOST_SWEEPS = 5
_GATE_M = (1.0, 3.0)
_FAR_M = 50.0  # where the deviation of a turn is measured


_STATE = ("pose", "twist", "inserted", "time_s", "deviation_m2", "lost_in_a_row")


@dataclass(frozen=True, eq=False)
class OdometrySweep:
    """One sweep.

    Args:
        points_m: Points in the sensor's coordinates, shape (n, 3).
        time_s: Reference moment, in seconds since the drive's first sweep.
        offset_s: When each point was measured, since the reference moment, shape (n,); None where that is not known or
            the points were moved to it.
    """

    points_m: Float[np.ndarray, "n 3"]
    time_s: float
    offset_s: Float[np.ndarray, " n"] | None = None


@dataclass(frozen=True)
class OdometrySettings:
    """Settings of :class:`Odometry`.

    Args:
        voxel_m: Edge of the map's voxels.
        source_m: Distance of the points that are fitted.
        least_m: Nearer points are left out: the car's own.
        most_m: Farther points are left out.
        gap_s: After a longer pause a new map is begun.
    """

    voxel_m: float = 0.5
    source_m: float = 1.5
    least_m: float = 2.0
    most_m: float = 120.0
    gap_s: float = 1.0


@dataclass(frozen=True, eq=False)
class RegistrationResult:
    """Where one sweep was found to be.

    Args:
        world_T_sensor: Its pose, shape (4, 4).
        matched: Weight of the points that lie on the map, as a share of all; 0 where it was not fitted.
        residual_m: Root mean square distance to the planes.
        information: The least of any direction, as a multiple of what scatter makes.
        blind: The least observed direction of those that nothing observes, shape (6,): turns, translations; zeros where
            all are observed.
        lost: It fits nowhere: the pose is the prediction.
        begins: A new map begins here: the motion from the sweep before is not measured.
    """

    world_T_sensor: Float[np.ndarray, "4 4"]
    matched: float = 0.0
    residual_m: float = 0.0
    information: float = 0.0
    blind: Float[np.ndarray, " 6"] = field(default_factory=lambda: np.zeros(6))
    lost: bool = False
    begins: bool = False


class Odometry:
    """Places sweeps one after another, forwards or backwards in time.

    Args:
        settings: Its settings.
    """

    def __init__(self, settings: OdometrySettings | None = None) -> None:
        self.settings = settings or OdometrySettings()
        self.surfaces = SurfaceMap(self.settings.voxel_m)
        self.pose: Float[np.ndarray, "4 4"] = np.eye(4)
        self.twist: Float[np.ndarray, " 6"] = np.zeros(6)
        self.time_s: float | None = None
        self.deviation_m2 = 1.0
        self.lost_in_a_row = 0
        self.inserted: Float[np.ndarray, "4 4"] = np.eye(4)

    def state(self) -> dict[str, np.ndarray | float]:
        """What it knows besides the map, to be saved."""
        assert self.time_s is not None
        return {name: getattr(self, name) for name in _STATE}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Take up a state that was saved."""
        self.pose, self.twist, self.inserted = state["pose"], state["twist"], state["inserted"]
        self.time_s, self.deviation_m2 = float(state["time_s"]), float(state["deviation_m2"])
        self.lost_in_a_row = int(state["lost_in_a_row"])

    def begins_at(self, sweep: OdometrySweep) -> bool:
        """Whether a new map is to be begun with a sweep: at the first, after a pause, or when too many were lost."""
        if self.time_s is None or self.lost_in_a_row >= _LOST_SWEEPS:
            return True
        return abs(sweep.time_s - self.time_s) > self.settings.gap_s

    def begin(self, sweeps: Sequence[OdometrySweep]) -> RegistrationResult:
        """Place the first of some sweeps where the last one was, in an empty map, at the speed that fits them best."""
        self.surfaces = SurfaceMap(self.settings.voxel_m)
        self.twist, self.lost_in_a_row, self.deviation_m2 = np.zeros(6), 0, 0.25
        if len(sweeps) > 1:
            tried = [self._tried(sweeps, twist) for twist in _first_motions(sweeps)]
            best = max(tried, key=_score)
            again = (self._tried(sweeps, twist) for twist in (best.first, best.last))  # once more, from nearer by
            best = max((best, *again), key=_score)
            tells = not best.blind or tried[0].matched < _AS_GOOD * best.matched
            self.twist = best.first if tells else np.zeros(6)  # where nothing tells, as if the car stood
        self._put(sweeps[0])
        return RegistrationResult(self.pose, begins=True)

    def _tried(self, sweeps: Sequence[OdometrySweep], twist: Float[np.ndarray, " 6"]) -> "_Hypothesis":
        """Place the first sweeps as if they began at a speed."""
        trial = Odometry(replace(self.settings, source_m=1.5 * self.settings.source_m))
        trial.twist, trial.deviation_m2 = twist, 0.25
        trial._put(sweeps[0])
        matched, first, blind = 0.0, twist, 0
        for number, sweep in enumerate(sweeps[1:]):
            found = trial.add(sweep)
            matched += found.matched
            blind += int(abs(found.blind[3]) > 0.7)
            first = trial.twist if number == 0 else first
        return _Hypothesis(matched, first, trial.twist, 2 * blind > len(sweeps) - 1)

    def _put(self, sweep: OdometrySweep) -> None:
        fine = self._prepared(sweep)
        self.surfaces.insert(fine @ self.pose[:3, :3].T + self.pose[:3, 3], self.pose[:3, 3], self._radius_m)
        self.time_s, self.inserted = sweep.time_s, self.pose

    @property
    def _radius_m(self) -> float:
        return 1.1 * self.settings.most_m

    def _prepared(self, sweep: OdometrySweep) -> Float[np.ndarray, "n 3"]:
        """Points within reach, one a voxel, at the sweep's reference moment."""
        points = np.asarray(sweep.points_m, dtype=np.float64)
        squared = (points**2).sum(1)
        near = np.flatnonzero((squared > self.settings.least_m**2) & (squared < self.settings.most_m**2))
        rows = near[thinned(points[near], self.settings.voxel_m)]
        points = points[rows]
        if sweep.offset_s is None or not len(points):
            return points
        offsets, column = np.unique(sweep.offset_s[rows], return_inverse=True)  # many rays are fired at once
        motion = exponential(self.twist[None] * offsets[:, None])[column]
        return (motion[:, :3, :3] @ points[:, :, None])[:, :, 0] + motion[:, :3, 3]

    def add(self, sweep: OdometrySweep) -> RegistrationResult:
        """Place the next sweep of a map that was begun."""
        assert self.time_s is not None
        step_s = sweep.time_s - self.time_s
        predicted = self.pose @ exponential(self.twist[None] * step_s)[0]
        before, fine = self.pose, self._prepared(sweep)
        found = self._fitted(fine, predicted)
        if found is None or found.matched < _LOST_SHARE:
            self.pose, self.time_s = predicted, sweep.time_s
            self.lost_in_a_row += 1
            return RegistrationResult(self.pose, lost=True, matched=found.matched if found else 0.0)
        self._moved(before, found, step_s)
        if sweep.offset_s is not None:  # the same with the motion that was found: it may have braked or turned
            fine = self._prepared(sweep)
            again = self._fitted(fine, found.world_T_sensor)
            if again is not None:
                found = again
                self._moved(before, found, step_s)
        off = invert(predicted) @ found.world_T_sensor
        deviation = np.linalg.norm(off[:3, 3]) + _FAR_M * np.linalg.norm(logarithm(off[None])[0, :3])
        self.deviation_m2 = 0.8 * self.deviation_m2 + 0.2 * float(deviation) ** 2
        self.pose, self.time_s, self.lost_in_a_row = found.world_T_sensor, sweep.time_s, 0
        if self._news():
            self.surfaces.insert(fine @ self.pose[:3, :3].T + self.pose[:3, 3], self.pose[:3, 3], self._radius_m)
            self.inserted = self.pose
        blind = found.blind[0] if len(found.blind) else np.zeros(6)
        return RegistrationResult(self.pose, found.matched, found.residual_m, found.information, blind)

    def _fitted(self, fine: Float[np.ndarray, "n 3"], start: Float[np.ndarray, "4 4"]) -> AlignmentFit | None:
        coarse = fine[thinned(fine, self.settings.source_m)]
        within = float(np.clip(3 * np.sqrt(self.deviation_m2), *_GATE_M))
        return fit(self.surfaces, coarse, start, within_m=within)

    def _moved(self, before: Float[np.ndarray, "4 4"], found: AlignmentFit, step_s: float) -> None:
        self.twist = logarithm((invert(before) @ found.world_T_sensor)[None])[0] / step_s

    def _news(self) -> bool:
        """Whether the sensor has moved since the map grew last: a car that stands learns nothing."""
        off = logarithm((invert(self.inserted) @ self.pose)[None])[0]
        return bool(np.linalg.norm(off[3:]) > 0.2 or np.linalg.norm(off[:3]) > 0.01)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    matched: float
    first: Float[np.ndarray, " 6"]  # speed at which the second sweep was found
    last: Float[np.ndarray, " 6"]
    blind: bool  # along x, in most sweeps


def _score(tried: _Hypothesis) -> float:
    return tried.matched


def _first_motions(sweeps: Sequence[OdometrySweep]) -> list[Float[np.ndarray, " 6"]]:
    """Speeds along the sensor's x axis at which a drive may begin."""
    step_s = sweeps[1].time_s - sweeps[0].time_s
    most = min(int(np.ceil(_FAST_M_S * abs(step_s) / _START_STEP_M)), _START_MOST)
    order = sorted(range(-most, most + 1), key=abs)
    return [np.array([0, 0, 0, number * _START_STEP_M / step_s, 0, 0]) for number in order]


# A sweep fitted to a map: point to plane, robust, with the directions that nothing observes left as predicted.
#
# Residuals are distances to planes (Chen and Medioni 1992), weighted by Geman and McClure's function, whose scale
# falls with the residuals' median. Directions of too little information keep the prediction (Zhang and Kaess, On
# degeneracy of optimization-based state estimation problems, ICRA 2016, section IV): a wall seems to tell a little of
# the motion along it, since fitted normals scatter, so the information is compared with what the normals' variance
# makes of nothing.

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
