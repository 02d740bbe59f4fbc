"""Does a given calibration fit the data? How far off is it, and did a sensor move during the drive?

A camera is aligned from its given calibration on all frames, and from there on each half, the first and the second in
time. It is called off where the edges' score over frames gains clearly, on frames to which the camera was not fitted
too, and it moved by more than it moves on correct data, in pixels or on both halves alike; edges that fit nowhere much
better than by chance tell nothing. It drifted where each
half's own camera fits that half clearly better than the other half's camera does, and one of them better than the
given one, which cannot fit both then. ``radar_checking`` checks radars.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy import stats

from farfield.calibration.edges import EdgeViews, align_edges, camera_difference, edge_score, move_camera, refine_edges
from farfield.geometry.cameras import Camera

Verdict = Literal["fits", "off", "moved", "not told"]
LEAST_FRAMES = 6
_CLEAR = 3.0  # standard errors over frames
_OTHER = 2.0  # the same, over frames to which it was not fitted
_OBSERVED = 3.0  # the same, against chance; twice as many of frames to which it was fitted
_USUAL_FRAMES = 20  # so many standard errors are meant of as many frames; fewer must show more
_FAR_RAD = np.radians(3.0)  # a camera turned so far meets edges by chance
_FLOOR_RAD = np.radians(0.4)  # a median pixel may be off so far on correct data (0.32 on KITTI)
_FLOORS = np.array([np.radians(0.5)] * 3 + [0.12] * 3)  # and a turn or a shift on which both halves agree
_LEVEL = 3
"""The finest scale: what moves only near edges, as a shift along the view does, shows there alone."""
_FIRST = (np.radians(2.0),) * 3 + (0.4,) * 3


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibrationCheck:
    """What a check says.

    Args:
        verdict: ``"fits"``, ``"off"``, ``"moved"`` during the drive, or ``"not told"`` by these data.
        degrees: Largest turn between the given and the found calibration.
        cm: Largest shift.
        px: Median distance between the pixels of the two; 0 for a radar.
        drift_degrees: Largest turn between the calibrations of the first and the second half.
        drift_cm: Their largest shift.
        frames: Frames used.
        evidence: Standard errors by which the found one is better, or sigmas by which it is away.
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


def check_camera(camera: Camera, views: EdgeViews) -> CalibrationCheck:
    """Check a camera's calibration.

    Args:
        camera: The calibration as given, with the picture's size.
        views: Edges of six or more frames in the order of time.
    """
    halves = [np.arange(views.count) < views.count // 2, np.arange(views.count) >= views.count // 2]
    if views.count < LEAST_FRAMES:
        return undecided(views.count)
    whole = align_edges(camera, views, sigma=_FIRST, most=None)
    own = [refine_edges(whole, _only(views, half), sigma=_FIRST) for half in halves]
    given, *scores = (edge_score(each, views, _LEVEL) for each in (camera, whole, *own))
    chance = np.mean([edge_score(move_camera(camera, each), views, _LEVEL) for each in _far()], axis=0)
    crossed = np.where(halves[0], scores[2], scores[1])  # each half by the other half's camera: not fitted to it
    mine = np.where(halves[0], scores[1], scores[2])
    unfitted, fitted = (equivalent_errors(errors, views.count) for errors in (_OBSERVED, 2 * _OBSERVED))
    if _errors(crossed - chance) < unfitted and _errors(mine - chance) < fitted:
        return undecided(views.count)
    found = (whole, *own)
    change = [camera_difference(each, camera) for each in found]
    pixels = [_pixels(each, views) for each in (camera, *found)]
    apart = float(np.nanmedian(np.linalg.norm(pixels[2] - pixels[3], axis=1)))
    gains = [_errors(each - given) for each in scores]
    better = int(np.argmax(gains))  # one half may have gone astray
    unseen = crossed - given if better == 0 else (scores[better] - given)[halves[2 - better]]
    other = _errors(unseen)
    away = float(np.nanmedian(np.linalg.norm(pixels[1 + better] - pixels[0], axis=1)))
    drift = min(_errors((mine - crossed)[half]) for half in halves)
    gained = max(_errors((mine - given)[half]) for half in halves)
    agreed = np.where(np.sign(change[1]) == np.sign(change[2]), np.abs(change[1:]).min(axis=0), 0.0)
    floor_px = max(1.5, _FLOOR_RAD * float(camera.matrix[0, 0]))
    verdict: Verdict = "fits"
    if gains[better] > _CLEAR and other > _OTHER and (away > floor_px or (agreed > _FLOORS).any()):
        verdict = "off"
    if verdict == "fits" and min(drift, gained) > _CLEAR and apart > floor_px:
        verdict = "moved"
    turn, shift = _sizes(change[better])
    drift_turn, drift_shift = _sizes(camera_difference(own[1], own[0]))
    return CalibrationCheck(
        verdict=verdict,
        degrees=turn,
        cm=shift,
        px=away if verdict != "moved" else apart,
        drift_degrees=drift_turn,
        drift_cm=drift_shift,
        frames=views.count,
        evidence=drift if verdict == "moved" else gains[better],
    )


def undecided(frames: int) -> CalibrationCheck:
    """What is said where so many frames tell nothing."""
    return CalibrationCheck(
        verdict="not told", degrees=0.0, cm=0.0, px=0.0, drift_degrees=0.0, drift_cm=0.0, frames=frames, evidence=0.0
    )


def equivalent_errors(errors: float, frames: int) -> float:
    """How many standard errors so many frames must show to mean as much as ``errors`` of twenty do.

    The spread of few frames is itself known badly: their mean in standard errors follows Student's t with one degree of
    freedom fewer than there are frames.

    Args:
        errors: Standard errors over twenty frames.
        frames: Number of frames; more than twenty are asked for as many.
    """
    if frames >= _USUAL_FRAMES:
        return errors
    return float(stats.t.isf(stats.t.sf(errors, _USUAL_FRAMES - 1), frames - 1))


def _far() -> list[Float[np.ndarray, " 6"]]:
    """Turns after which edges meet by chance, in yaw and pitch."""
    signs = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
    return [np.array([a * _FAR_RAD, b * _FAR_RAD, 0, 0, 0, 0]) for a, b in signs]


def _only(views: EdgeViews, frames: Bool[np.ndarray, " frames"]) -> EdgeViews:
    """The edges of some frames."""
    kept = frames[views.frame]
    number = np.cumsum(frames) - 1
    return replace(
        views,
        points_m=views.points_m[kept],
        frame=number[views.frame[kept]],
        axis=views.axis[kept],
        weight=views.weight[kept],
        levels=tuple(level[frames] for level in views.levels),
    )


def _errors(gain: Float[np.ndarray, " n"]) -> float:
    """Mean in standard errors."""
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-9)) if len(gain) > 1 else 0.0


def _pixels(camera: Camera, views: EdgeViews) -> Float[np.ndarray, "n 2"]:
    return replace(camera, width_px=0, height_px=0).project(views.points_m)[0]


def _sizes(change: Float[np.ndarray, " 6"]) -> tuple[float, float]:
    """Largest turn in degrees and largest shift in centimetres."""
    return float(np.degrees(np.abs(change[:3]).max())), 100 * float(np.abs(change[3:]).max())
