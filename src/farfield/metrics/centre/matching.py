"""Greedy matching of predictions to annotated boxes by centre distance, for many thresholds at once.

The rule is that of nuScenes and Cirrus: predictions take turns by falling score; each takes the nearest annotated box
of its frame that is still free, and is a match if that distance is *strictly* below the threshold. Each threshold is a
game of its own. Only predictions of one frame compete with each other, so the k-th best prediction of every frame can
be played at the same time: one numpy step a rank instead of one Python step a prediction.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.boxes import Boxes

NO_MATCH = -1
_CACHED = 1 << 15  # costs held at a time: they stay in the processor's second-level cache
DROPPED = -2  # the best match is a box that is neither right nor wrong to find


@dataclass(frozen=True, eq=False, kw_only=True)
class Limits:
    """The V distance limits that are played at once: threshold times omega (Cirrus: omega = exp(epsilon d)).

    Args:
        threshold_m: Distance threshold of each variant, shape (V,).
        omega_annotated: Factor of each annotated box in each variant, shape (V, m); 1 where absent.
        omega_predicted: Factor of each prediction in each variant, shape (V, n); 1 where absent.
        normalised: Whether "nearest" means the least distance over omega instead of the least distance.
    """

    threshold_m: Float[np.ndarray, " V"]
    omega_annotated: Float[np.ndarray, "V m"] | None = None
    omega_predicted: Float[np.ndarray, "V n"] | None = None
    normalised: bool = False


def rank_predictions(
    score: Float[np.ndarray, " n"], frame: Int[np.ndarray, " n"], *, ties: str = "stable"
) -> Int[np.ndarray, " n"]:
    """Return the predictions' indices by falling score.

    Args:
        score: Scores, shape (n,).
        frame: Frame number of each prediction, shape (n,).
        ties: ``"later_first"`` puts the later index first, as the nuScenes devkit does; any other value the earlier
            frame and the earlier index.
    """
    index = np.arange(len(score))
    if ties == "later_first":
        return np.lexsort((index, score))[::-1]
    return np.lexsort((index, frame, -score))


def greedy_match(
    predicted_m: Float[np.ndarray, "n d"],
    predicted_frame: Int[np.ndarray, " n"],
    order: Int[np.ndarray, " n"],
    annotated_m: Float[np.ndarray, "m d"],
    annotated_frame: Int[np.ndarray, " m"],
    limits: Limits,
    *,
    ignored: Bool[np.ndarray, " m"] | None = None,
) -> Int[np.ndarray, "V n"]:
    """Match predictions to annotated boxes, each threshold for itself.

    Args:
        predicted_m: Centres of the predictions, shape (n, 2) or (n, 3), metres; the distance is taken in these.
        predicted_frame: Frame number of each prediction, shape (n,).
        order: Prediction indices by falling score, from :func:`rank_predictions`.
        annotated_m: Centres of the annotated boxes, shape (m, 2) or (m, 3).
        annotated_frame: Frame number of each annotated box, shape (m,).
        limits: The distance limits.
        ignored: Annotated boxes that are never taken; a prediction whose best match is one of them is dropped.

    Returns:
        For each variant and prediction the index of its annotated box, NO_MATCH or DROPPED, shape (V, n).
    """
    result = np.full((len(limits.threshold_m), len(predicted_m)), NO_MATCH, dtype=np.int64)
    if len(predicted_m) == 0 or len(annotated_m) == 0:
        return result
    ignored = np.zeros(len(annotated_m), dtype=bool) if ignored is None else ignored
    n_frames = int(max(predicted_frame.max(), annotated_frame.max())) + 1
    ranked = _by_frame(order, predicted_frame, n_frames)
    boxes = _by_frame(np.arange(len(annotated_m)), annotated_frame, n_frames)
    for frames in _buckets(ranked.count, boxes.count, len(limits.threshold_m)):
        _play(frames, ranked, boxes, predicted_m, annotated_m, limits, ignored, result)
    return result


def found_by(predictions: Boxes, annotated: Boxes, *, distance_m: float = 2.0) -> Int[np.ndarray, " m"]:
    """Match one frame: for each annotated box the index of the prediction that found it, or -1, shape (m,).

    Predictions take turns by falling score; each takes the nearest free annotated box nearer than ``distance_m``
    between centres in the x-y plane.

    Args:
        predictions: Boxes of a detector; without scores their order is that of their turns.
        annotated: m annotated boxes of the same frame.
        distance_m: The distance at which a box no longer counts as found.
    """
    finder = np.full(len(annotated), -1, dtype=np.int64)
    if not len(predictions) or not len(annotated):
        return finder
    score = np.zeros(len(predictions)) if predictions.score is None else predictions.score
    one_frame = np.zeros(len(predictions), dtype=np.int64)
    assigned = greedy_match(
        predictions.centre_m[:, :2],
        one_frame,
        rank_predictions(score, one_frame),
        annotated.centre_m[:, :2],
        np.zeros(len(annotated), dtype=np.int64),
        Limits(threshold_m=np.array([distance_m])),
    )[0]
    finder[assigned[assigned >= 0]] = np.flatnonzero(assigned >= 0)
    return finder


@dataclass(frozen=True, eq=False)
class _ByFrame:
    """Indices grouped by frame: those of frame f stand at start[f] ... start[f] + count[f]."""

    index: Int[np.ndarray, " n"]
    start: Int[np.ndarray, " F"]
    count: Int[np.ndarray, " F"]


def _by_frame(order: Int[np.ndarray, " n"], frame: Int[np.ndarray, " n"], n_frames: int) -> _ByFrame:
    count = np.bincount(frame, minlength=n_frames)
    return _ByFrame(order[np.argsort(frame[order], kind="stable")], np.cumsum(count) - count, count)


def _buckets(
    predicted: Int[np.ndarray, " F"], annotated: Int[np.ndarray, " F"], variants: int
) -> Iterator[Int[np.ndarray, " f"]]:
    """Frames of similar numbers of annotated boxes (within a factor of two), those with most predictions first."""
    played = np.flatnonzero((predicted > 0) & (annotated > 0))
    size_class = np.ceil(np.log2(annotated[played])).astype(np.int64)
    for value in np.unique(size_class):
        frames = played[size_class == value]
        frames = frames[np.argsort(-predicted[frames], kind="stable")]
        step = max(_CACHED // (variants << int(value)), 64)
        for start in range(0, len(frames), step):
            yield frames[start : start + step]


def _play(
    frames: Int[np.ndarray, " f"],
    ranked: _ByFrame,
    boxes: _ByFrame,
    predicted_m: Float[np.ndarray, "n d"],
    annotated_m: Float[np.ndarray, "m d"],
    limits: Limits,
    ignored: Bool[np.ndarray, " m"],
    result: Int[np.ndarray, "V n"],
) -> None:
    """Play all ranks of one bucket of frames; writes into ``result``."""
    slot = np.arange(boxes.count[frames].max())
    absent = slot >= boxes.count[frames][:, None]
    box = boxes.index[np.where(absent, boxes.start[frames][:, None], boxes.start[frames][:, None] + slot)]
    centre_m = annotated_m[box]
    variant = np.arange(len(limits.threshold_m))[:, None]
    assigned = np.repeat(absent[None], len(variant), axis=0)
    for rank in range(int(ranked.count[frames].max())):
        active = int((ranked.count[frames] > rank).sum())
        row = np.arange(active)
        predicted = ranked.index[ranked.start[frames[:active]] + rank]
        squared = np.zeros((active, len(slot)))
        for axis in range(predicted_m.shape[1]):
            squared += (centre_m[:active, :, axis] - predicted_m[predicted, axis, None]) ** 2
        distance_m = np.sqrt(squared)
        cost: np.ndarray = distance_m[None]
        if limits.normalised and limits.omega_annotated is not None:
            cost = distance_m / limits.omega_annotated[:, box[:active]]
        best = np.where(assigned[:, :active], np.inf, cost).argmin(axis=2)
        nearest = box[row, best]
        limit_m = limits.threshold_m[:, None]
        if limits.omega_annotated is not None:
            limit_m = limit_m * limits.omega_annotated[variant, nearest]
        if limits.omega_predicted is not None:
            limit_m = limit_m * limits.omega_predicted[:, predicted]
        hit = ~assigned[variant, row, best] & (distance_m[row, best] < limit_m)
        assigned[variant, row, best] |= hit & ~ignored[nearest]
        result[:, predicted] = np.where(hit, np.where(ignored[nearest], DROPPED, nearest), NO_MATCH)
