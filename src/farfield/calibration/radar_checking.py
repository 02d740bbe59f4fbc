"""Does a radar's given calibration fit the objects that both sensors see, and did the radar move during the drive?

x, y and yaw are judged together: y and yaw err against each other, so that both are known much better where the objects
stand than each alone. An error is claimed where the distance from the given to the found values, in sigmas of the three
(Mahalanobis), is larger than on correct data. What such a test would find is known before: where errors of the asked
size would stay below it, nothing found means nothing, and it is said how many frames would tell. Few frames show few
objects, from which no sigma is to be trusted: on simulated drives of 24 frames right ones lay 4 to 11 sigmas off.
Fewer than eighty are not judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from farfield.calibration.checking import CalibrationCheck, Verdict, undecided
from farfield.calibration.radar_lidar import GATES_M, RefinedPose, refine_radar
from farfield.calibration.radar_matching import RadarEvidence, RadarPose, match_objects
from farfield.errors import DatasetError

ASKED_M, ASKED_RAD = 0.4, float(np.radians(1.0))
"""Errors that are found nearly always, or nothing is told: a shift in the plane, a turn."""
CLAIMED = 3.3
"""Sigmas of three values together: one correct calibration in eighty lies farther off."""
LEAST_RADAR_FRAMES = 80
LEAST_OBJECTS = 20
"""From fewer no sigma is to be trusted: behind a truck that stays ahead a whole drive shows a dozen objects."""
_SURE = 1.64  # so much farther, 19 of 20 are claimed
_FLOOR_M, _FLOOR_RAD = 0.08, float(np.radians(0.3))  # less is no error
_MOST_FRAMES = 100_000


def check_radar(given: RadarPose, evidence: RadarEvidence, *, least: int = LEAST_RADAR_FRAMES) -> CalibrationCheck:
    """Check a radar's x, y and yaw by the objects that both sensors see.

    Args:
        given: The calibration as the files have it.
        evidence: Frames in runs of consecutive ones.
        least: Fewer frames are not judged; each half of a drive must have so many to be told from the other.
    """
    count = len(evidence.moments)
    whole = _refined(given, evidence)
    if whole is None:
        return undecided(count)
    if count < least:
        return replace(undecided(count), needed=max(least, _needed(whole, count)))
    change = whole.value[:3] - given.vector[:3]
    away = mahalanobis(change, whole.covariance[:3, :3])
    told = detectable_errors(whole.covariance[:3, :3])
    enough = count >= 2 * least
    halves = [_refined(given, _half(evidence, late=late)) if enough else None for late in (False, True)]
    apart, between = np.zeros(3), 0.0
    if halves[0] is not None and halves[1] is not None:
        apart = halves[1].value[:3] - halves[0].value[:3]
        both = halves[0].covariance[:3, :3] + halves[1].covariance[:3, :3]
        between = mahalanobis(apart, both)
    verdict: Verdict = "fits" if told.enough and _objects(whole, given, evidence) >= LEAST_OBJECTS else "not told"
    if away > CLAIMED and _beyond(change, 1.0):
        verdict = "off"
    elif between > CLAIMED and _beyond(apart, 1.5):
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
        needed=0 if told.enough else _needed(whole, count),
    )


def _beyond(change: Float[np.ndarray, " 3"], floors: float) -> bool:
    """Whether a shift in the plane, or a turn, is larger than so many times what is no error."""
    return bool(np.hypot(*change[:2]) > floors * _FLOOR_M or abs(change[2]) > floors * _FLOOR_RAD)


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


def mahalanobis(change: Float[np.ndarray, " 3"], covariance: Float[np.ndarray, "3 3"]) -> float:
    """A change of x, y and yaw in sigmas of the three together."""
    return float(np.sqrt(change @ np.linalg.solve(covariance, change)))


def detectable_errors(covariance: Float[np.ndarray, "3 3"]) -> DetectableErrors:
    """What errors a check with this covariance of x, y and yaw would find."""
    known = np.linalg.inv(covariance)
    weakest = float(np.linalg.eigvalsh(known[:2, :2])[0])
    return DetectableErrors(
        shift_m=(CLAIMED + _SURE) / float(np.sqrt(weakest)), turn_rad=(CLAIMED + _SURE) / float(np.sqrt(known[2, 2]))
    )


def _needed(found: RefinedPose, frames: int) -> int:
    return frames_needed(found.covariance[:3, :3], frames, found.systematic[:3, :3])


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
        low, high = (low, middle) if detectable_errors(systematic + own * frames / middle).enough else (middle, high)
    return high


def _refined(given: RadarPose, evidence: RadarEvidence) -> RefinedPose | None:
    try:
        return refine_radar(evidence, given)
    except DatasetError:
        return None


def _objects(found: RefinedPose, given: RadarPose, evidence: RadarEvidence) -> int:
    """How many objects both sensors see where a solution puts them."""
    return len(np.unique(match_objects(evidence, found.value, given.frames, GATES_M[-1]).track))


def _half(evidence: RadarEvidence, *, late: bool) -> RadarEvidence:
    middle: Sequence[int] = sorted(evidence.targets)
    limit = middle[len(middle) // 2]
    kept = {number: each for number, each in evidence.targets.items() if (number >= limit) == late}
    return replace(evidence, targets=kept)
