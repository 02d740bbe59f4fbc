"""KITTI's matching, at all thresholds at once: annotated boxes choose, in the file's order, among free detections."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidates:
    """Which detections overlap each annotated box enough, padded by frame.

    Args:
        choice: Places of detections in their frame, -1 where there is none, shape (frames, boxes, choices).
        overlap: Their overlaps, shape (frames, boxes, choices).
        similarity: How alike their headings are to the box's, in [0, 1], shape (frames, boxes, choices).
        counts: 1 where an annotated box must be found, 0 where it may be, shape (frames, boxes).
        score: Scores, -inf where there is no detection, shape (frames, detections).
        small: Detections too small to count, shape (frames, detections).
        harmless: Detections that are not false even if no box takes them, shape (frames, detections).
    """

    choice: Int[np.ndarray, "f b c"]
    overlap: Float[np.ndarray, "f b c"]
    similarity: Float[np.ndarray, "f b c"]
    counts: Int[np.ndarray, "f b"]
    score: Float[np.ndarray, "f d"]
    small: Bool[np.ndarray, "f d"]
    harmless: Bool[np.ndarray, "f d"]


def recall_scores(frames: Candidates) -> Float[np.ndarray, " h"]:
    """Scores of the detections that count as found when all detections are allowed, falling, shape (h,)."""
    frame = np.arange(len(frames.score))
    assigned = np.zeros(frames.score.shape, dtype=bool)
    scores = []
    for box in range(frames.choice.shape[1]):
        detection = frames.choice[:, box]
        free = (detection >= 0) & ~assigned[frame[:, None], detection]
        best = np.where(free, frames.score[frame[:, None], detection], -np.inf).argmax(axis=1)
        chosen, is_assigned = detection[frame, best], free[frame, best]
        assigned[frame[is_assigned], chosen[is_assigned]] = True
        true = is_assigned & (frames.counts[:, box] == 1) & ~frames.small[frame, chosen]
        scores.append(frames.score[frame[true], chosen[true]])
    return np.sort(np.concatenate([np.zeros(0), *scores]))[::-1]


def count_at_thresholds(
    frames: Candidates, thresholds: Float[np.ndarray, " t"]
) -> tuple[Int[np.ndarray, "t f"], Int[np.ndarray, "t f"], Float[np.ndarray, "t f"]]:
    """True and false positives of every frame at every threshold, and the similarity of the true ones.

    Each is of shape (thresholds, frames).
    """
    t = np.arange(len(thresholds))[:, None, None]
    allowed = frames.score[None] >= thresholds[:, None, None]
    assigned = np.zeros(allowed.shape, dtype=bool)
    true = np.zeros(allowed.shape[:2], dtype=np.int64)
    alike = np.zeros(true.shape)
    for box in range(frames.choice.shape[1]):
        rows = np.flatnonzero((frames.choice[:, box] >= 0).any(axis=1))
        detection = frames.choice[rows, box]
        free = (detection >= 0) & allowed[t, rows[:, None], detection] & ~assigned[t, rows[:, None], detection]
        small = frames.small[rows[:, None], detection]
        # The largest overlap wins; a detection too small to count is taken only where there is no other, the first.
        preference = np.where(small, -1.0 - np.arange(detection.shape[1]), frames.overlap[rows, box])
        best = np.where(free, preference, -np.inf).argmax(axis=2)
        row = np.arange(len(rows))
        chosen = detection[row, best]
        is_assigned = free[t[:, :, 0], row, best]
        assigned[t[:, :, 0], rows, chosen] |= is_assigned
        is_true = is_assigned & (frames.counts[rows, box] == 1) & ~frames.small[rows, chosen]
        true[:, rows] += is_true
        alike[:, rows] += np.where(is_true, frames.similarity[rows, box][row, best], 0.0)
    false = allowed & ~assigned & ~(frames.small | frames.harmless) & np.isfinite(frames.score)
    return true, false.sum(axis=2), alike


def places_of_rows(
    owner: Int[np.ndarray, " n"], keep: Bool[np.ndarray, " n"], owners: int
) -> tuple[Int[np.ndarray, " n"], int]:
    """Place of each kept row among those of its owner (rows are sorted by owner), and the largest number of rows."""
    count = np.bincount(owner[keep], minlength=owners)
    index = np.zeros(len(owner), dtype=np.int64)
    index[keep] = np.arange(int(keep.sum())) - np.repeat(np.cumsum(count) - count, count)
    return index, max(int(count.max(initial=0)), 1)
