"""Does a given calibration fit the data? How far off is it, and did a sensor move during the drive?

:func:`check_camera`: a camera is aligned from its given calibration on all frames, and from there on each half, the
first and the second in time. It is called off where the edges' score over frames gains clearly, on frames to which the
camera was not fitted too, and it moved by more than it moves on correct data, in pixels or on both halves alike; edges
that fit nowhere much better than by chance tell nothing. It drifted where each half's own camera fits that half clearly
better than the other half's camera does, and one of them better than the given one, which cannot fit both then.

:func:`check_radar`: x, y and yaw are judged together: y and yaw err against each other, so that both are known much
better where the objects stand than each alone. An error is claimed where the distance from the given to the solved
values, in sigmas of the three (Mahalanobis), is larger than on correct data. What such a test would find is known
before: where errors of the asked size would stay below it, nothing found means nothing, and it is said how many frames
would tell. Few frames show few objects, from which no sigma is to be trusted: on simulated drives of 24 frames right
ones lay 4 to 11 sigmas off. Fewer than eighty are not judged.

:func:`information_distance` compares a picture's grey with a LiDAR's intensity: a last check of a camera, no verdict.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Shaped
from scipy import stats

from farfield.calibration.camera_edges import (
    EdgeViews,
    align_edges,
    camera_difference,
    edge_score,
    move_camera,
    refine_edges,
)
from farfield.calibration.radar_lidar import GATES_M, RefinedPose, refine_radar
from farfield.calibration.radar_matching import RadarEvidence, RadarPose, match_objects
from farfield.errors import DatasetError
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import transform_points

Verdict = Literal["fits", "off", "moved", "not told"]


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibrationCheck:
    """What a check says.

    Args:
        verdict: ``"fits"``, ``"off"``, ``"moved"`` during the drive, or ``"not told"`` by these data.
        degrees: Largest turn between the given and the solved calibration.
        cm: Largest shift.
        px: Median distance between the pixels of the two; 0 for a radar.
        drift_degrees: Largest turn between the calibrations of the first and the second half.
        drift_cm: Their largest shift.
        frames: Frames used.
        evidence: Standard errors by which the solved one is better, or sigmas by which it is away.
        needed: How many frames would tell, where these do not; 0 where that is not known, or no number would.
    """

    verdict: Verdict
    degrees: float
    cm: float
    px: float
    drift_degrees: float
    drift_cm: float
    frames: int
    evidence: float
    needed: int = 0

    @property
    def claimed(self) -> bool:
        """Whether something is said to be wrong."""
        return self.verdict in ("off", "moved")


def undecided(frames: int) -> CalibrationCheck:
    """What is said where so many frames tell nothing."""
    return CalibrationCheck(
        verdict="not told", degrees=0.0, cm=0.0, px=0.0, drift_degrees=0.0, drift_cm=0.0, frames=frames, evidence=0.0
    )


# Cameras

LEAST_FRAMES = 6
_CLEAR = 3.0  # standard errors over frames
_OTHER = 2.0  # the same, over frames to which it was not fitted
_OBSERVED = 3.0  # the same, against chance; twice as many of frames to which it was fitted
_USUAL_FRAMES = 20  # so many standard errors are meant of as many frames; fewer must show more
_FAR_RAD = np.radians(3.0)  # a camera turned so far meets edges by chance
_FAR_TURNS = [
    np.array([pitch * _FAR_RAD, yaw * _FAR_RAD, 0, 0, 0, 0])
    for pitch in (-1, 0, 1)
    for yaw in (-1, 0, 1)
    if pitch or yaw
]
_FLOOR_RAD = np.radians(0.4)  # a median pixel may be off so far on correct data (0.32 on KITTI)
_FLOORS = np.array([np.radians(0.5)] * 3 + [0.12] * 3)  # and a turn or a shift on which both halves agree
_LEVEL = 3
"""The finest scale: what moves only near edges, as a shift along the view does, shows there alone."""
_START_SIGMA = (np.radians(2.0),) * 3 + (0.4,) * 3


def check_camera(camera: Camera, views: EdgeViews) -> CalibrationCheck:
    """Check a camera's calibration.

    Args:
        camera: The calibration as given, with the picture's size.
        views: Edges of six or more frames in the order of time.
    """
    if views.count < LEAST_FRAMES:
        return undecided(views.count)

    # 1. Align on all frames, and from there on each half of the drive.
    halves = [np.arange(views.count) < views.count // 2, np.arange(views.count) >= views.count // 2]
    aligned = align_edges(camera, views, sigma=_START_SIGMA, most=None)
    by_half = [refine_edges(aligned, _only(views, half), sigma=_START_SIGMA) for half in halves]
    solved = (aligned, *by_half)

    # 2. Scores of the frames: as given, aligned, by chance; each half by its own and by the other half's camera.
    score, *scores = (edge_score(candidate, views, _LEVEL) for candidate in (camera, *solved))
    chance = np.mean([edge_score(move_camera(camera, turn), views, _LEVEL) for turn in _FAR_TURNS], axis=0)
    crossed = np.where(halves[0], scores[2], scores[1])  # not fitted to it
    own = np.where(halves[0], scores[1], scores[2])

    # 3. Edges that meet no better than by chance tell nothing.
    unfitted, fitted = (equivalent_errors(errors, views.count) for errors in (_OBSERVED, 2 * _OBSERVED))
    if _standard_errors(crossed - chance) < unfitted and _standard_errors(own - chance) < fitted:
        return undecided(views.count)

    # 4. Gains over the calibration as given, on all frames and on those to which a camera was not fitted.
    gains = [_standard_errors(row - score) for row in scores]
    better = int(np.argmax(gains))  # one half may have gone astray
    unfitted_gain = crossed - score if better == 0 else (scores[better] - score)[halves[2 - better]]
    other = _standard_errors(unfitted_gain)

    # 5. How far the cameras are from the given one, and the halves from one another.
    change = [camera_difference(candidate, camera) for candidate in solved]
    pixels = [replace(candidate, width_px=0, height_px=0).project(views.points_m)[0] for candidate in (camera, *solved)]
    away = float(np.nanmedian(np.linalg.norm(pixels[1 + better] - pixels[0], axis=1)))
    apart = float(np.nanmedian(np.linalg.norm(pixels[2] - pixels[3], axis=1)))
    agreed = np.where(np.sign(change[1]) == np.sign(change[2]), np.abs(change[1:]).min(axis=0), 0.0)
    drift = min(_standard_errors((own - crossed)[half]) for half in halves)
    gained = max(_standard_errors((own - score)[half]) for half in halves)

    # 6. The verdict.
    floor_px = max(1.5, _FLOOR_RAD * float(camera.matrix[0, 0]))
    verdict: Verdict = "fits"
    if gains[better] > _CLEAR and other > _OTHER and (away > floor_px or (agreed > _FLOORS).any()):
        verdict = "off"
    if verdict == "fits" and min(drift, gained) > _CLEAR and apart > floor_px:
        verdict = "moved"
    degrees, cm = _largest_turn_and_shift(change[better])
    drift_degrees, drift_cm = _largest_turn_and_shift(camera_difference(by_half[1], by_half[0]))
    return CalibrationCheck(
        verdict=verdict,
        degrees=degrees,
        cm=cm,
        px=away if verdict != "moved" else apart,
        drift_degrees=drift_degrees,
        drift_cm=drift_cm,
        frames=views.count,
        evidence=drift if verdict == "moved" else gains[better],
    )


def equivalent_errors(errors: float, frames: int) -> float:
    """How many standard errors so many frames must show to mean as much as ``errors`` of twenty do.

    The spread of few frames is itself known badly: their mean in standard errors follows Student's t with one degree of
    freedom fewer than there are frames.

    Args:
        errors: Standard errors over twenty frames.
        frames: Number of frames; of more than twenty as many are demanded.
    """
    if frames >= _USUAL_FRAMES:
        return errors
    return float(stats.t.isf(stats.t.sf(errors, _USUAL_FRAMES - 1), frames - 1))


def _only(views: EdgeViews, frames: Bool[np.ndarray, " frames"]) -> EdgeViews:
    """The edges of some frames."""
    rows = frames[views.frame]
    number = np.cumsum(frames) - 1
    return replace(
        views,
        points_m=views.points_m[rows],
        frame=number[views.frame[rows]],
        axis=views.axis[rows],
        weight=views.weight[rows],
        levels=tuple(level[frames] for level in views.levels),
    )


def _standard_errors(gain: Float[np.ndarray, " n"]) -> float:
    """Mean in standard errors."""
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-9)) if len(gain) > 1 else 0.0


def _largest_turn_and_shift(change: Float[np.ndarray, " 6"]) -> tuple[float, float]:
    """In degrees and in centimetres."""
    return float(np.degrees(np.abs(change[:3]).max())), 100 * float(np.abs(change[3:]).max())


# Radars

ASKED_M, ASKED_RAD = 0.4, float(np.radians(1.0))
"""Errors that are found nearly always, or nothing is told: a shift in the plane, a turn."""
CLAIMED = 3.3
"""Sigmas of three values together: one correct calibration in eighty lies farther off."""
LEAST_RADAR_FRAMES = 80
LEAST_OBJECTS = 20
"""From fewer no sigma is to be trusted: behind a truck that stays ahead a whole drive shows a dozen objects."""
_SURE = 1.64  # so much farther, 19 of 20 are claimed
_FLOOR_M, _FLOOR_TURN_RAD = 0.08, float(np.radians(0.3))  # less is no error
_MOST_FRAMES = 100_000


def check_radar(pose: RadarPose, evidence: RadarEvidence, *, least: int = LEAST_RADAR_FRAMES) -> CalibrationCheck:
    """Check a radar's x, y and yaw by the objects that both sensors see.

    Args:
        pose: The calibration as the files have it.
        evidence: Frames in runs of consecutive ones.
        least: Fewer frames are not judged; each half of a drive must have so many to be told from the other.
    """
    # 1. Solve from the given pose on all frames.
    count = len(evidence.sensor_pairs)
    refined = _refine(pose, evidence)
    if refined is None:
        return undecided(count)
    covariance, systematic = refined.covariance[:3, :3], refined.systematic[:3, :3]
    if count < least:
        return replace(undecided(count), needed=max(least, frames_needed(covariance, count, systematic)))

    # 2. How far that is from the given one, and what errors would be found.
    change = refined.value[:3] - pose.vector[:3]
    away = mahalanobis(change, covariance)
    detectable = detectable_errors(covariance)

    # 3. Each half of the drive alone, and how far they are apart.
    halves = [_refine(pose, _half(evidence, late=late)) if count >= 2 * least else None for late in (False, True)]
    apart, between = np.zeros(3), 0.0
    if halves[0] is not None and halves[1] is not None:
        apart = halves[1].value[:3] - halves[0].value[:3]
        between = mahalanobis(apart, halves[0].covariance[:3, :3] + halves[1].covariance[:3, :3])

    # 4. The verdict.
    verdict: Verdict = "not told"
    if detectable.enough:
        matches = match_objects(evidence, refined.value, pose.frames, GATES_M[-1])
        verdict = "fits" if len(np.unique(matches.track)) >= LEAST_OBJECTS else "not told"
    if away > CLAIMED and _is_error(change, 1.0):
        verdict = "off"
    elif between > CLAIMED and _is_error(apart, 1.5):
        verdict = "moved"
    return CalibrationCheck(
        verdict=verdict,
        degrees=float(np.degrees(abs(change[2]))),
        cm=100 * float(np.hypot(*change[:2])),
        px=0.0,
        drift_degrees=float(np.degrees(abs(apart[2]))),
        drift_cm=100 * float(np.hypot(*apart[:2])),
        frames=count,
        evidence=between if verdict == "moved" else away,
        needed=0 if detectable.enough else frames_needed(covariance, count, systematic),
    )


def _refine(pose: RadarPose, evidence: RadarEvidence) -> RefinedPose | None:
    try:
        return refine_radar(evidence, pose)
    except DatasetError:
        return None


def _half(evidence: RadarEvidence, *, late: bool) -> RadarEvidence:
    """The LiDAR's objects of one half of the drive."""
    numbers: Sequence[int] = sorted(evidence.targets)
    middle = numbers[len(numbers) // 2]
    targets = {number: row for number, row in evidence.targets.items() if (number >= middle) == late}
    return replace(evidence, targets=targets)


def _is_error(change: Float[np.ndarray, " 3"], floors: float) -> bool:
    """Whether a shift in the plane, or a turn, is larger than so many times what is no error."""
    return bool(np.hypot(*change[:2]) > floors * _FLOOR_M or abs(change[2]) > floors * _FLOOR_TURN_RAD)


def mahalanobis(change: Float[np.ndarray, " 3"], covariance: Float[np.ndarray, "3 3"]) -> float:
    """A change of x, y and yaw in sigmas of the three together."""
    return float(np.sqrt(change @ np.linalg.solve(covariance, change)))


@dataclass(frozen=True, kw_only=True)
class DetectableErrors:
    """Errors that nineteen of twenty checks would find.

    Args:
        shift_m: In the worst direction of the plane.
        turn_rad: About the vertical.
    """

    shift_m: float
    turn_rad: float

    @property
    def enough(self) -> bool:
        """Whether the errors asked are among them."""
        return self.shift_m <= ASKED_M and self.turn_rad <= ASKED_RAD


def detectable_errors(covariance: Float[np.ndarray, "3 3"]) -> DetectableErrors:
    """What errors a check with this covariance of x, y and yaw would find."""
    information = np.linalg.inv(covariance)
    weakest = float(np.linalg.eigvalsh(information[:2, :2])[0])
    threshold = CLAIMED + _SURE
    return DetectableErrors(
        shift_m=threshold / float(np.sqrt(weakest)), turn_rad=threshold / float(np.sqrt(information[2, 2]))
    )


def frames_needed(covariance: Float[np.ndarray, "3 3"], frames: int, systematic: Float[np.ndarray, "3 3"]) -> int:
    """How many frames of this kind would do: what is not systematic falls with their number; 0 where none would.

    Args:
        covariance: Of x, y and yaw, the systematic part included.
        frames: From how many it comes.
        systematic: The covariance of that part.
    """
    own = covariance - systematic
    low, high = frames, _MOST_FRAMES
    if not detectable_errors(systematic + own * frames / high).enough:
        return 0
    while high > low + 1:
        middle = (low + high) // 2
        enough = detectable_errors(systematic + own * frames / middle).enough
        low, high = (low, middle) if enough else (middle, high)
    return high


# Normalised information distance of grey and intensity
#
# ``(2 H(X, Y) - H(X) - H(Y)) / H(X, Y)`` (Li et al., "The similarity metric", IEEE Trans. Inf. Theory 2004, for
# histograms: Kraskov et al. 2005). Its basin is 0.1 to 0.3 degree wide and its depth 0.1 to 0.2 %, so that it may only
# say whether it agrees with what edges found.

LEAST_INFORMATION_FRAMES = 10
_BINS = 32
_CELL_PX = 4


def information_distance(
    camera: Camera,
    pictures: Sequence[Shaped[np.ndarray, "height width ..."]],
    points_m: Sequence[Float[np.ndarray, "_ 3"]],
    intensity: Sequence[Shaped[np.ndarray, " _"]],
) -> float:
    """Distance over all frames, from 0 (one tells the other) to 1 (nothing in common); 1 where no point is visible.

    Args:
        camera: The calibration to judge.
        pictures: One a frame.
        points_m: Points of each frame, shape (n, 3), at the moment of the picture.
        intensity: Their intensities; only their order counts.
    """
    joint = np.zeros((_BINS, _BINS))
    for picture, points, strength in zip(pictures, points_m, intensity, strict=True):
        # 1. The nearest point of each cell: what lies behind it is hidden.
        height, width = picture.shape[:2]
        pixels, _, visible = replace(camera, width_px=width, height_px=height).project(points)
        if not visible.any():
            continue
        pixels = pixels[visible]
        cell = np.floor(pixels / _CELL_PX).astype(np.int64)
        order = np.argsort(transform_points(camera.camera_T_lidar, points)[visible, 2], kind="stable")
        _, first = np.unique((cell[:, 1] * width + cell[:, 0])[order], return_index=True)
        nearest = order[first]

        # 2. Their grey, and the rank of their intensity, counted together.
        rank = stats.rankdata(strength[visible][nearest], method="average") / len(nearest)
        column, row = np.clip(np.floor(pixels[nearest]).astype(int), 0, [width - 1, height - 1]).T
        grey = picture.reshape(height, width, -1)[row, column].mean(axis=1) / 256.0
        bins = tuple(np.minimum((share * _BINS).astype(int), _BINS - 1) for share in (grey, rank))
        np.add.at(joint, bins, 1.0)

    # 3. The distance by their entropies.
    if not joint.any():
        return 1.0
    both = _entropy(joint.ravel())
    return 1.0 if both == 0 else (2 * both - _entropy(joint.sum(axis=0)) - _entropy(joint.sum(axis=1))) / both


def _entropy(counts: Float[np.ndarray, " n"]) -> float:
    share = counts[counts > 0] / counts.sum()
    return float(-(share * np.log2(share)).sum())
