"""Odometry of one LiDAR: where the sensor was at each sweep, by fitting each to a map of those before it.

:meth:`Odometry.register_sweep` is the algorithm; its steps are those of KISS-ICP (Vizzo et al., RA-L 2023), with
planes in place of points. The motion between two sweeps is predicted as the last one's, the points of a sweep are moved
to its reference moment by it where they have times, and what moves by itself is left to the robust weights. Drift is
bounded by nothing: no loop is closed.

Two steps differ from KISS-ICP: a sweep is voxelised before it is deskewed, so that fewer points are moved, and it is
deskewed and aligned a second time, with the motion that the first fit gave.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from farfield.geometry.poses import exponential, invert, logarithm
from farfield.odometry.surface_map import SurfaceMap, voxel_rows

START_SWEEPS = 5
"""So many sweeps decide at what speed a drive begins."""
_START_STEP_M = 1.5  # between two hypotheses of the first motion: what the fit reaches from either side
_START_MOST = 20
_FAST_M_S = 45.0
_AS_GOOD = 0.9  # standing matches nearly as well as the best motion
_LOST_SHARE = 0.1
_LOST_SWEEPS = 5
_THRESHOLD_M = (1.0, 3.0)
_KEEP, _LEARN = 0.8, 0.2  # weights of the deviation so far and of the last sweep's, in the running mean
_FAR_M = 50.0  # where the deviation of a turn is measured
_MOVED_M, _TURNED_RAD = 0.2, 0.01  # since the map grew last: a car that stands adds nothing


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
    """The pose of one sweep.

    Args:
        world_T_sensor: The pose, shape (4, 4).
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
    """Registers sweeps one after another, forwards or backwards in time.

    Args:
        settings: Its settings.
    """

    def __init__(self, settings: OdometrySettings | None = None) -> None:
        self.settings = settings or OdometrySettings()
        self.surfaces = SurfaceMap(self.settings.voxel_m)
        self.pose: Float[np.ndarray, "4 4"] = np.eye(4)
        self.twist: Float[np.ndarray, " 6"] = np.zeros(6)  # rad/s, then m/s, along the sensor's axes: turn, translation
        self.time_s: float | None = None
        self.deviation_m2 = 1.0
        self.lost_in_a_row = 0
        self.map_pose: Float[np.ndarray, "4 4"] = np.eye(4)  # when the map grew last

    def register_sweep(self, sweep: OdometrySweep) -> RegistrationResult:
        """Find the pose of the next sweep of a map that was begun, at another time than the sweep before.

        Sweeps of equal times must not come here: ``times_of`` of :mod:`farfield.odometry.drives` refuses them.
        """
        assert self.time_s is not None
        before, step_s = self.pose, sweep.time_s - self.time_s

        # Crop and voxelise: points in range, one a voxel.
        points_m, offset_s = _voxelise(sweep, self.settings)

        # Deskew, with the motion of the sweep before.
        deskewed_m = _deskew(points_m, offset_s, self.twist)

        # Threshold: how far the motion deviated from its model so far.
        threshold_m = float(np.clip(3 * np.sqrt(self.deviation_m2), *_THRESHOLD_M))

        # Initial guess: the motion goes on.
        guess = before @ exponential(self.twist[None] * step_s)[0]

        # Align.
        source_m = deskewed_m[voxel_rows(deskewed_m, self.settings.source_m)]
        fit = align(self.surfaces, source_m, guess, threshold_m=threshold_m)
        if fit is None or fit.matched < _LOST_SHARE:
            self.pose, self.time_s = guess, sweep.time_s
            self.lost_in_a_row += 1
            return RegistrationResult(self.pose, lost=True, matched=fit.matched if fit else 0.0)
        self.twist = _twist_between(before, fit.world_T_sensor, step_s)

        # Deskew and align once more, with the motion of this sweep: the car may have braked or turned.
        if offset_s is not None:
            deskewed_m = _deskew(points_m, offset_s, self.twist)
            source_m = deskewed_m[voxel_rows(deskewed_m, self.settings.source_m)]
            refined = align(self.surfaces, source_m, fit.world_T_sensor, threshold_m=threshold_m)
            if refined is not None:  # _LOST_SHARE was met by the first fit, from which this one begins
                fit = refined
                self.twist = _twist_between(before, fit.world_T_sensor, step_s)

        # Model deviation, of position and of a turn's effect far away.
        deviation = invert(guess) @ fit.world_T_sensor
        deviation_m = np.linalg.norm(deviation[:3, 3]) + _FAR_M * np.linalg.norm(logarithm(deviation[None])[0, :3])
        self.deviation_m2 = _KEEP * self.deviation_m2 + _LEARN * float(deviation_m) ** 2
        self.pose, self.time_s, self.lost_in_a_row = fit.world_T_sensor, sweep.time_s, 0

        # Map update, where the sensor has moved.
        motion = logarithm((invert(self.map_pose) @ self.pose)[None])[0]
        if np.linalg.norm(motion[3:]) > _MOVED_M or np.linalg.norm(motion[:3]) > _TURNED_RAD:
            self._update_map(deskewed_m)
        blind = fit.blind[0] if len(fit.blind) else np.zeros(6)
        return RegistrationResult(self.pose, fit.matched, fit.residual_m, fit.information, blind)

    def needs_new_map(self, sweep: OdometrySweep) -> bool:
        """Whether a new map begins with a sweep: at the first, after a pause, or when too many were lost."""
        if self.time_s is None or self.lost_in_a_row >= _LOST_SWEEPS:
            return True
        return abs(sweep.time_s - self.time_s) > self.settings.gap_s

    def start_map(self, sweeps: Sequence[OdometrySweep]) -> RegistrationResult:
        """Put the first of some sweeps where the last one was, into an empty map, at the speed that fits them best."""
        self.surfaces = SurfaceMap(self.settings.voxel_m)
        self.twist, self.lost_in_a_row, self.deviation_m2 = np.zeros(6), 0, 0.25
        if len(sweeps) > 1:
            hypotheses = [self._try_motion(sweeps, twist) for twist in _first_motions(sweeps)]
            best = max(hypotheses, key=_matched)
            # Once more, from nearer by.
            refined = (self._try_motion(sweeps, twist) for twist in (best.first, best.last))
            best = max((best, *refined), key=_matched)
            is_observed = not best.blind or hypotheses[0].matched < _AS_GOOD * best.matched
            self.twist = best.first if is_observed else np.zeros(6)  # else as if the car stood
        points_m, offset_s = _voxelise(sweeps[0], self.settings)
        self._update_map(_deskew(points_m, offset_s, self.twist))
        self.time_s = sweeps[0].time_s
        return RegistrationResult(self.pose, begins=True)

    def _try_motion(self, sweeps: Sequence[OdometrySweep], twist: Float[np.ndarray, " 6"]) -> "_MotionHypothesis":
        """Register the first sweeps as if they began at a speed."""
        trial = Odometry(replace(self.settings, source_m=1.5 * self.settings.source_m))
        trial.twist, trial.deviation_m2 = twist, 0.25
        points_m, offset_s = _voxelise(sweeps[0], trial.settings)
        trial._update_map(_deskew(points_m, offset_s, twist))
        trial.time_s = sweeps[0].time_s
        matched, first, blind = 0.0, twist, 0
        for number, sweep in enumerate(sweeps[1:]):
            result = trial.register_sweep(sweep)
            matched += result.matched
            blind += int(abs(result.blind[3]) > 0.7)
            first = trial.twist if number == 0 else first
        return _MotionHypothesis(matched, first, trial.twist, 2 * blind > len(sweeps) - 1)

    def _update_map(self, points_m: Float[np.ndarray, "n 3"]) -> None:
        """Add the points of a sweep at the present pose."""
        rotation, position_m = self.pose[:3, :3], self.pose[:3, 3]
        self.surfaces.insert(points_m @ rotation.T + position_m, position_m, 1.1 * self.settings.most_m)
        self.map_pose = self.pose

    def state(self) -> dict[str, np.ndarray | float]:
        """What it knows besides the map, to be saved."""
        assert self.time_s is not None
        return {
            "pose": self.pose,
            "twist": self.twist,
            "inserted": self.map_pose,
            "time_s": self.time_s,
            "deviation_m2": self.deviation_m2,
            "lost_in_a_row": self.lost_in_a_row,
        }

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from a state that was saved."""
        self.pose, self.twist, self.map_pose = state["pose"], state["twist"], state["inserted"]
        self.time_s, self.deviation_m2 = float(state["time_s"]), float(state["deviation_m2"])
        self.lost_in_a_row = int(state["lost_in_a_row"])


def _twist_between(
    first: Float[np.ndarray, "4 4"], second: Float[np.ndarray, "4 4"], step_s: float
) -> Float[np.ndarray, " 6"]:
    """The constant motion that leads from one pose to another in a time, turn (rad/s) then translation (m/s)."""
    return logarithm((invert(first) @ second)[None])[0] / step_s


def _voxelise(
    sweep: OdometrySweep, settings: OdometrySettings
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"] | None]:
    """Points in range, one a voxel, and when they were measured."""
    points_m = np.asarray(sweep.points_m, dtype=np.float64)
    range2_m2 = (points_m**2).sum(1)
    in_range = np.flatnonzero((range2_m2 > settings.least_m**2) & (range2_m2 < settings.most_m**2))
    rows = in_range[voxel_rows(points_m[in_range], settings.voxel_m)]
    return points_m[rows], None if sweep.offset_s is None else sweep.offset_s[rows]


def _deskew(
    points_m: Float[np.ndarray, "n 3"], offset_s: Float[np.ndarray, " n"] | None, twist: Float[np.ndarray, " 6"]
) -> Float[np.ndarray, "n 3"]:
    """Points at the sweep's reference moment, for a constant motion."""
    if offset_s is None or not len(points_m):
        return points_m
    moments_s, column = np.unique(offset_s, return_inverse=True)  # many rays are fired at once
    motion = exponential(twist[None] * moments_s[:, None])[column]
    return (motion[:, :3, :3] @ points_m[:, :, None])[:, :, 0] + motion[:, :3, 3]


@dataclass(frozen=True, eq=False)
class _MotionHypothesis:
    matched: float
    first: Float[np.ndarray, " 6"]  # motion of the second sweep
    last: Float[np.ndarray, " 6"]
    blind: bool  # along x, in most sweeps


def _matched(hypothesis: _MotionHypothesis) -> float:
    return hypothesis.matched


def _first_motions(sweeps: Sequence[OdometrySweep]) -> list[Float[np.ndarray, " 6"]]:
    """Speeds along the sensor's x axis at which a drive may begin."""
    step_s = sweeps[1].time_s - sweeps[0].time_s
    most = min(int(np.ceil(_FAST_M_S * abs(step_s) / _START_STEP_M)), _START_MOST)
    order = sorted(range(-most, most + 1), key=abs)
    return [np.array([0, 0, 0, number * _START_STEP_M / step_s, 0, 0]) for number in order]


# Alignment: point to plane, robust, with the directions that nothing observes left as predicted
#
# Residuals are distances to planes (Chen and Medioni 1992), weighted by Geman and McClure's function, whose scale falls
# with the residuals' median. Directions of too little information keep the prediction (Zhang and Kaess, On degeneracy
# of optimization-based state estimation problems, ICRA 2016, section IV): a wall seems to tell a little of the motion
# along it, since fitted normals scatter, so the information is compared with what the normals' variance makes of
# nothing.

LEAST_INFORMATION = 2.0
"""A direction is observed if it has so many times the information that scattered normals alone make of it."""
_LEAST_NORMAL_VARIANCE = 3e-5
_LEAST_PAIRS = 30
_SCALES = 3.0  # of the residuals' median
_LEAST_SCALE_M, _MOST_SCALE_M = 0.1, 1.0
_ITERATIONS = 25
_CONVERGED_RAD, _CONVERGED_M = 1e-4, 2e-3
_NEAR_RAD, _NEAR_M = 1e-3, 0.03  # steps until which every fourth point will do
_COARSE_STRIDE = 4


@dataclass(frozen=True, eq=False)
class AlignmentFit:
    """A sweep on the map.

    Args:
        world_T_sensor: Its pose, shape (4, 4).
        matched: Sum of the weights over the number of points: 1 if all lie on the map's planes.
        residual_m: Weighted root mean square of the distances to the planes.
        information: The least of any direction, as a multiple of what scatter makes, see :data:`LEAST_INFORMATION`.
        blind: Directions that were left as predicted, in the sensor's coordinates, turns (about an axis, times the
            lever arm) then translations, shape (k, 6); empty where all are observed.
        iterations: Steps of the fit.
    """

    world_T_sensor: Float[np.ndarray, "4 4"]
    matched: float
    residual_m: float
    information: float
    blind: Float[np.ndarray, "k 6"]
    iterations: int


def align(
    surfaces: SurfaceMap,
    points_m: Float[np.ndarray, "n 3"],
    world_T_sensor: Float[np.ndarray, "4 4"],
    *,
    threshold_m: float,
) -> AlignmentFit | None:
    """Fit points to the surfaces, from a predicted pose.

    Args:
        surfaces: The map.
        points_m: Points in the sensor's coordinates, shape (n, 3).
        world_T_sensor: The predicted pose.
        threshold_m: Pairs lie nearer than this.

    Returns:
        None where there are fewer than 30 pairs.
    """
    pose = world_T_sensor.copy()
    stride = _COARSE_STRIDE if len(points_m) > _COARSE_STRIDE * 10 * _LEAST_PAIRS else 1
    for iteration in range(1, _ITERATIONS + 1):
        # Pairs of points and planes, and their distances.
        lever = points_m[::stride] @ pose[:3, :3].T
        rows, voxels = surfaces.nearest(lever + pose[:3, 3], threshold_m)
        if len(rows) < _LEAST_PAIRS:
            return None
        lever, normal = lever[rows], surfaces.normal[voxels]
        residual = ((lever + pose[:3, 3] - surfaces.mean_m[voxels]) * normal).sum(1)

        # Robust weights.
        scale = min(max(_SCALES * float(np.median(np.abs(residual))), _LEAST_SCALE_M), _MOST_SCALE_M)
        weight = 1 / (1 + (residual / scale) ** 2) ** 2

        # Information of each direction, against what scattered normals alone make of it. Turns are scaled by the lever
        # arm, so that they are metres as translations are, and the two compare.
        arm_m = float(np.sqrt((lever**2).sum(1).mean()))
        jacobian = np.concatenate([np.cross(lever, normal) / arm_m, normal], axis=1)
        weighted = jacobian * weight[:, None]
        information = weighted.T @ jacobian / weight.sum()
        variance = np.maximum(surfaces.normal_variance[voxels], _LEAST_NORMAL_VARIANCE) * weight / weight.sum()
        # eigh(A, B) gives axes V with V' B V = 1 and V' A V = diag(eigenvalue): V diag(1 / eigenvalue) V' inverts A.
        eigenvalue, axes = eigh(information, _scatter_information(lever / arm_m, variance))
        observed = eigenvalue > LEAST_INFORMATION

        # A Gauss-Newton step along the observed directions.
        gradient = weighted.T @ residual / weight.sum()
        step = -axes[:, observed] @ ((axes[:, observed].T @ gradient) / eigenvalue[observed])
        turn, along = step[:3] / arm_m, step[3:]
        pose[:3, :3] = exponential(np.concatenate([turn, np.zeros(3)])[None])[0, :3, :3] @ pose[:3, :3]
        pose[:3, 3] += along
        turn_rad, along_m = float(np.linalg.norm(turn)), float(np.linalg.norm(along))
        if stride == 1 and turn_rad < _CONVERGED_RAD and along_m < _CONVERGED_M:
            break
        if (turn_rad < _NEAR_RAD and along_m < _NEAR_M) or iteration > _ITERATIONS // 2:
            stride = 1
    # Weights, residuals and information belong to the pose before the last step, which is tiny once it has converged.
    # The stride is 1 by then, so the weights are those of all points that have a pair; a point without one counts as 0.
    blind_axes = axes[:, ~observed] / np.linalg.norm(axes[:, ~observed], axis=0)
    blind = blind_axes.T.reshape(-1, 2, 3) @ pose[:3, :3]
    return AlignmentFit(
        world_T_sensor=pose,
        matched=float(weight.sum() / len(points_m)),
        residual_m=float(np.sqrt((weight * residual**2).sum() / weight.sum())),
        information=float(eigenvalue[0]),
        blind=blind.reshape(-1, 6),
        iterations=iteration,
    )


def _scatter_information(arm: Float[np.ndarray, "n 3"], variance: Float[np.ndarray, " n"]) -> Float[np.ndarray, "6 6"]:
    """Information that normals would seem to give if they were nothing but their scatter, alike in all directions.

    Sum of ``w A A^T`` over the points, where ``A``, shape (6, 3), takes a normal to its Jacobian: the cross product
    with the lever arm, and itself.
    """
    total = variance.sum()
    mean = variance @ arm
    spread = (arm * variance[:, None]).T @ arm
    x, y, z = mean
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[np.trace(spread) * np.eye(3) - spread, cross], [cross.T, total * np.eye(3)]])
