"""Intervals of DDS, wDDS and nuScenes over drawn objects, and of their differences between two runs.

They are for frames too few to be drawn: annotated objects are drawn with replacement, each with all its boxes and
with what was matched to them. It is assumed that objects are found or missed independently of each other, that the
frames' false positives stay what they are whichever objects are drawn, and that matches stay too. Frames of one scene
share weather, sensor and place, which no drawing of their objects varies: the interval is that of this scene, not of
others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from farfield.frame.drive import Key
from farfield.metrics.bootstrap import Bootstrap, percentile_interval, replicate_weights
from farfield.metrics.centre.evaluation import (
    CentreBoxes,
    PartRankings,
    figures_of_part,
    gather,
    match_boxes,
    rank,
    with_confidences,
)
from farfield.metrics.centre.matching import DROPPED
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.frames import BoxesByFrame, frames_in_order


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
    scenes: Mapping[Key, str] | None = None,
    bootstrap: Bootstrap | None = None,
) -> ObjectIntervals:
    """Percentile intervals over drawn objects.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotations: Annotated boxes by (sequence, frame): every frame that counts. Boxes of one sequence with one
            ``track_id`` are one object; where there are no identities, or they are negative, each box is one, which
            makes intervals too narrow where frames show the same objects.
        settings: The options of the score.
        scenes: The scene of each frame, to draw scenes first and objects within each, as
            :func:`object_differences` does; unless given objects alone are drawn.
        bootstrap: How to draw (default: that of the settings).

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    part, scene_of_object, number = _rank_by_object(predictions, annotations, settings, scenes or {})
    drawing, count = bootstrap or settings.bootstrap, len(scene_of_object)
    if count < 2 or drawing.replicates < 2:
        figures = figures_of_part(part, settings, np.ones((1, count + number)))
        return ObjectIntervals(objects=count, intervals=dict.fromkeys(figures))
    rng = np.random.default_rng(drawing.seed)
    if scenes is None:
        drawn = replicate_weights(count, drawing.replicates, rng)
        weights = np.column_stack([drawn, np.ones((len(drawn), number))])  # the false positives stay
    else:
        weights = _drawn_objects(scene_of_object, number, drawing.replicates, rng)
    spans = {
        name: percentile_interval(values, drawing.level, least=1)
        for name, values in figures_of_part(part, settings, weights).items()
    }
    return ObjectIntervals(objects=count, intervals={name: _pair(span) for name, span in spans.items()})


@dataclass(frozen=True, kw_only=True)
class ObjectDifferences:
    """What changed between two runs over the same frames.

    Args:
        objects: How many different objects were drawn.
        scenes: How many scenes were drawn.
        before: Figures of the first run by name, as ``ap/2.0``; None where nothing is annotated.
        after: Those of the second.
        intervals: [low, high] of after - before by figure; None where two objects or more are wanting.
    """

    objects: int
    scenes: int
    before: Mapping[str, float | None]
    after: Mapping[str, float | None]
    intervals: Mapping[str, tuple[float, float] | None]


def object_differences(
    before: BoxesByFrame,
    after: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: CentreSettings,
    *,
    scenes: Mapping[Key, str] | None = None,
    bootstrap: Bootstrap | None = None,
) -> ObjectDifferences:
    """Differences of two runs with percentile intervals: the same scenes and the same objects are drawn for both.

    Scenes are drawn with replacement, then objects within each scene that was drawn, with all their boxes and with what
    was matched to them; a scene's false positives come as often as the scene. Of a single scene only objects are drawn,
    and the interval is that of this scene (Efron & Tibshirani, 1993, ch. 8).

    Args:
        before: Scored boxes of the first run by (sequence, frame).
        after: Those of the second.
        annotations: Annotated boxes of every frame that counts, objects told by their ``track_id`` as in
            :func:`object_intervals`.
        settings: The options of the score.
        scenes: The scene of each frame (default: its sequence).
        bootstrap: How to draw (default: that of the settings).

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    part, scene_of_object, number = _rank_by_object(before, annotations, settings, scenes or {})
    second, *_ = _rank_by_object(after, annotations, settings, scenes or {})
    drawing = bootstrap or settings.bootstrap
    weights = np.ones((1, len(scene_of_object) + number))
    if len(scene_of_object) > 1 and drawing.replicates > 1:
        rng = np.random.default_rng(drawing.seed)
        weights = np.concatenate([weights, _drawn_objects(scene_of_object, number, drawing.replicates, rng)])
    values = [figures_of_part(own, settings, weights) for own in (part, second)]
    points = [{name: None if np.isnan(rows[0]) else float(rows[0]) for name, rows in run.items()} for run in values]
    spans = {
        name: percentile_interval(values[1][name][1:] - rows[1:], drawing.level, least=2)
        for name, rows in values[0].items()
    }
    return ObjectDifferences(
        objects=len(scene_of_object),
        scenes=number,
        before=points[0],
        after=points[1],
        intervals={name: _pair(span) for name, span in spans.items()},
    )


def _pair(span: Sequence[float] | None) -> tuple[float, float] | None:
    return None if span is None else (span[0], span[1])


def _drawn_objects(
    scene_of_object: Int[np.ndarray, " objects"], scenes: int, replicates: int, rng: np.random.Generator
) -> Float[np.ndarray, "replicates groups"]:
    """How often each object, and each scene behind them, comes in each replicate."""
    scene_count = replicate_weights(scenes, replicates, rng) if scenes > 1 else np.ones((replicates, 1))
    drawn = np.zeros((replicates, len(scene_of_object)))
    for scene in range(scenes):
        own = np.flatnonzero(scene_of_object == scene)
        if len(own):
            times = scene_count[:, scene].astype(np.int64) * len(own)
            drawn[:, own] = rng.multinomial(times, np.full(len(own), 1.0 / len(own)))
    return np.column_stack([drawn, scene_count])


def _object_of_box(boxes: CentreBoxes, annotations: BoxesByFrame, keys: Sequence[Key]) -> Int[np.ndarray, " m"]:
    """A number of the object of each gathered annotated box: boxes there are known by frame and centre."""
    number_of: dict[tuple[str, int], int] = {}
    by_centre: dict[tuple[int, bytes], int] = {}
    for frame, key in enumerate(keys):
        frame_boxes = annotations[key]
        track_id = np.full(len(frame_boxes), -1) if frame_boxes.track_id is None else frame_boxes.track_id
        for row, track in enumerate(track_id.tolist()):
            identity = (f"{key} {row}", -1) if track < 0 else (key[0], track)
            by_centre[frame, frame_boxes.centre_m[row].tobytes()] = number_of.setdefault(identity, len(number_of))
    rows = zip(boxes.annotated_frame.tolist(), boxes.annotated.centre_m, strict=True)
    return np.array([by_centre[frame, centre.tobytes()] for frame, centre in rows], dtype=np.int64)


def _rank_by_object(
    predictions: BoxesByFrame, annotations: BoxesByFrame, settings: CentreSettings, scenes: Mapping[Key, str]
) -> tuple[PartRankings, Int[np.ndarray, " objects"], int]:
    """The whole region as one part whose groups are the objects and then the scenes, which own the false positives.

    Returns:
        The part, the scene of each object, and how many scenes there are.
    """
    boxes = with_confidences(gather(predictions, annotations, settings), settings)
    matches = match_boxes(boxes, settings)
    part = rank(boxes, matches, settings)
    keys = frames_in_order(predictions, annotations, settings.ties)
    names, scene_of_frame = np.unique([scenes.get(key, key[0]) for key in keys], return_inverse=True)
    object_of_box = _object_of_box(boxes, annotations, keys)
    objects, first = np.unique(object_of_box[~boxes.ignored], return_index=True)
    number = np.searchsorted(objects, object_of_box)  # of ignored boxes' objects: never read, as they are dropped
    annotated = np.bincount(number[~boxes.ignored], minlength=len(objects) + len(names))
    rankings = {}
    for variant, ranking in part.ranking.items():
        assigned = matches.assigned[variant]
        rows = matches.order[(assigned != DROPPED)[matches.order]]  # the predictions in the order of the ranking
        group: Int[np.ndarray, " n"] = len(objects) + scene_of_frame[boxes.predicted_frame[rows]]
        group[ranking.is_match] = number[assigned[rows[ranking.is_match]]]
        rankings[variant] = replace(ranking, group=group, annotated=annotated)
    scene_of_object = scene_of_frame[boxes.annotated_frame[~boxes.ignored][first]]
    return replace(part, ranking=rankings), scene_of_object, len(names)
