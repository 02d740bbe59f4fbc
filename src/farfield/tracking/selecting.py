"""Tracks chosen by their score."""

from dataclasses import replace

import numpy as np

from farfield.frame.drive import Key
from farfield.metrics.detections import Detections

TrackName = tuple[str, int]


def track_scores(tracks: Detections) -> dict[TrackName, float]:
    """Mean score over its boxes of each track, by (sequence, track id); 1 where there are no scores."""
    sums: dict[TrackName, list[float]] = {}
    for (sequence, _), boxes in tracks.boxes.items():
        ids = [] if boxes.track_id is None else boxes.track_id.tolist()
        scores = np.ones(len(boxes)) if boxes.score is None else boxes.score
        for name, score in zip(ids, scores.tolist(), strict=True):
            sums.setdefault((sequence, name), []).append(score)
    return {name: float(np.mean(values)) for name, values in sums.items()}


def with_track_score(tracks: Detections, least: float) -> Detections:
    """The tracks whose mean score is at least this."""
    kept = {name for name, score in track_scores(tracks).items() if score >= least}
    boxes, details = {}, {}
    for key, part in tracks.boxes.items():
        rows = _rows(key, [] if part.track_id is None else part.track_id.tolist(), kept)
        boxes[key] = part[rows]
        known = tracks.prediction_details.get(key, {})
        details[key] = {name: np.asarray(values)[rows] for name, values in known.items()}
    return replace(tracks, boxes=boxes, prediction_details=details if tracks.prediction_details else {})


def _rows(key: Key, ids: list[int], kept: set[TrackName]) -> np.ndarray:
    return np.array([(key[0], name) in kept for name in ids], dtype=bool)
