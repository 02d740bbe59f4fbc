"""KITTI's matching by overlap and its sampling of thresholds, for all frames and thresholds at once.

KITTI lets the *annotated* boxes choose, in the order of the file: first by score, to find at which scores recall grows;
then, at each of 41 thresholds, by overlap among the detections above it. Frames do not touch each other, so the i-th
annotated box of every frame chooses at the same time.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidates:
    """Which detections overlap each annotated box enough, padded by frame.

    Args:
        choice: Places of detections in their frame, -1 where there is none, shape (frames, boxes, choices).
        overlap: Their overlaps, shape (frames, boxes, choices).
        counts: 1 where an annotated box must be found, 0 where it may be, shape (frames, boxes).
        score: Scores, -inf where there is no detection, shape (frames, detections).
        small: Detections too small to count, shape (frames, detections).
        harmless: Detections that are not false even if no box takes them, shape (frames, detections).
    """

    choice: Int[np.ndarray, "f b c"]
    overlap: Float[np.ndarray, "f b c"]
    counts: Int[np.ndarray, "f b"]
    score: Float[np.ndarray, "f d"]
    small: Bool[np.ndarray, "f d"]
    harmless: Bool[np.ndarray, "f d"]


def recall_scores(found: Candidates) -> Float[np.ndarray, " h"]:
    """Scores of the detections that count as found when all detections are allowed, falling, shape (h,)."""
    frame = np.arange(len(found.score))
    assigned = np.zeros(found.score.shape, dtype=bool)
    scores = []
    for box in range(found.choice.shape[1]):
        place = found.choice[:, box]
        free = (place >= 0) & ~assigned[frame[:, None], place]
        best = np.where(free, found.score[frame[:, None], place], -np.inf).argmax(axis=1)
        chosen, taken = place[frame, best], free[frame, best]
        assigned[frame[taken], chosen[taken]] = True
        true = taken & (found.counts[:, box] == 1) & ~found.small[frame, chosen]
        scores.append(found.score[frame[true], chosen[true]])
    return np.sort(np.concatenate([np.zeros(0), *scores]))[::-1]


def count_at_thresholds(
    found: Candidates, thresholds: Float[np.ndarray, " t"]
) -> tuple[Int[np.ndarray, "t f"], Int[np.ndarray, "t f"]]:
    """True and false positives of every frame at every threshold, each of shape (thresholds, frames)."""
    t = np.arange(len(thresholds))[:, None, None]
    allowed = found.score[None] >= thresholds[:, None, None]
    assigned = np.zeros(allowed.shape, dtype=bool)
    true = np.zeros(allowed.shape[:2], dtype=np.int64)
    for box in range(found.choice.shape[1]):
        rows = np.flatnonzero((found.choice[:, box] >= 0).any(axis=1))
        place = found.choice[rows, box]
        free = (place >= 0) & allowed[t, rows[:, None], place] & ~assigned[t, rows[:, None], place]
        small = found.small[rows[:, None], place]
        # The largest overlap wins; a detection too small to count is taken only where there is no other, the first.
        preference = np.where(small, -1.0 - np.arange(place.shape[1]), found.overlap[rows, box])
        best = np.where(free, preference, -np.inf).argmax(axis=2)
        row = np.arange(len(rows))
        chosen = place[row, best]
        taken = free[t[:, :, 0], row, best]
        assigned[t[:, :, 0], rows, chosen] |= taken
        true[:, rows] += taken & (found.counts[rows, box] == 1) & ~found.small[rows, chosen]
    false = allowed & ~assigned & ~(found.small | found.harmless) & np.isfinite(found.score)
    return true, false.sum(axis=2)
