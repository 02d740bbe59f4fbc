"""Intervals of DDS, wDDS and nuScenes over drawn objects.

They are for frames too few to be drawn: annotated objects are drawn with replacement, each with all its boxes and
with what was matched to them. It is assumed that objects are found or missed independently of each other, that the
frames' false positives stay what they are whichever objects are drawn, and that matches stay too. Frames of one scene
share weather, sensor and place, which no drawing of their objects varies: the interval is that of this scene, not of
others.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from farfield.metrics.bootstrap import Bootstrap, percentile_interval, replicate_weights
from farfield.metrics.centre.evaluation import (
    CentreBoxes,
    GreedyMatches,
    PartRankings,
    figures_of_part,
    gather,
    match_boxes,
    rank,
    with_confidences,
)
from farfield.metrics.centre.matching import DROPPED
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.frames import BoxesByFrame, frame_order


@dataclass(frozen=True, kw_only=True)
class ObjectIntervals:
    """Intervals of the figures of all ranges together.

    Args:
        objects: How many different objects were drawn.
        intervals: [low, high] by figure, as ``dds/0/dds``; None where two objects or more are wanting.
    """

    objects: int
    intervals: Mapping[str, tuple[float, float] | None]


def object_intervals(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: CentreSettings,
    *,
    bootstrap: Bootstrap | None = None,
) -> ObjectIntervals:
    """Percentile intervals over drawn objects.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotations: Annotated boxes by (sequence, frame): every frame that counts. Boxes of one sequence with one
            ``track_id`` are one object; where there are no identities, or they are negative, each box is one, which
            makes intervals too narrow where frames show the same objects.
        settings: The options of the score.
        bootstrap: How to draw; that of the settings unless given.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    boxes = with_confidences(gather(predictions, annotations, settings), settings)
    part, count = _rank_by_object(boxes, match_boxes(boxes, settings), settings, _object_of_box(boxes, annotations))
    drawing = bootstrap or settings.bootstrap
    if count < 2 or drawing.replicates < 2:
        figures = figures_of_part(part, settings, np.ones((1, count + 1)))
        return ObjectIntervals(objects=count, intervals=dict.fromkeys(figures))
    drawn = replicate_weights(count, drawing.replicates, np.random.default_rng(drawing.seed))
    weights = np.column_stack([drawn, np.ones(len(drawn))])  # the last group is that of false positives
    spans = {
        name: percentile_interval(values, drawing.level, least=1)
        for name, values in figures_of_part(part, settings, weights).items()
    }
    return ObjectIntervals(
        objects=count, intervals={name: None if span is None else (span[0], span[1]) for name, span in spans.items()}
    )


def _object_of_box(boxes: CentreBoxes, annotations: BoxesByFrame) -> Int[np.ndarray, " m"]:
    """A number of the object of each gathered annotated box: boxes there are known by frame and centre."""
    number_of: dict[tuple[str, int], int] = {}
    by_centre: dict[tuple[int, bytes], int] = {}
    for frame, key in enumerate(sorted(annotations, key=frame_order)):
        frame_boxes = annotations[key]
        track_id = np.full(len(frame_boxes), -1) if frame_boxes.track_id is None else frame_boxes.track_id
        for row, track in enumerate(track_id.tolist()):
            identity = (f"{key} {row}", -1) if track < 0 else (key[0], track)
            by_centre[frame, frame_boxes.centre_m[row].tobytes()] = number_of.setdefault(identity, len(number_of))
    rows = zip(boxes.annotated_frame.tolist(), boxes.annotated.centre_m, strict=True)
    return np.array([by_centre[frame, centre.tobytes()] for frame, centre in rows], dtype=np.int64)


def _rank_by_object(
    boxes: CentreBoxes, matches: GreedyMatches, settings: CentreSettings, object_of_box: Int[np.ndarray, " m"]
) -> tuple[PartRankings, int]:
    """The whole region as one part whose groups are the objects, and how many these are."""
    part = rank(boxes, matches, settings)
    objects = np.unique(object_of_box[~boxes.ignored])
    number = np.searchsorted(objects, object_of_box)  # of ignored boxes' objects: never read, as they are dropped
    annotated = np.append(np.bincount(number[~boxes.ignored], minlength=len(objects)), 0)
    rankings = {}
    for variant, ranking in part.ranking.items():
        assigned = matches.assigned[variant]
        rows = matches.order[(assigned != DROPPED)[matches.order]]  # the predictions in the order of the ranking
        group: Int[np.ndarray, " n"] = np.full(len(rows), len(objects))
        group[ranking.is_match] = number[assigned[rows[ranking.is_match]]]
        rankings[variant] = replace(ranking, group=group, annotated=annotated)
    return replace(part, ranking=rankings), len(objects)
