"""Intervals over objects, where frames are too few to be drawn: what a score had been, had other objects stood there.

Annotated objects are drawn with replacement, each with all its boxes and with what was matched to them. It is assumed
that objects are found or missed independently of each other, that the frames' false positives stay what they are
whichever objects are drawn, and that matches stay too. Frames of one scene share weather, sensor and place, which no
drawing of their objects varies: the interval is that of this scene, not of others.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from farfield.metrics.bootstrap import Bootstrap, replicate_weights
from farfield.metrics.centre.evaluation import (
    GreedyMatches,
    PartRankings,
    match_scene,
    statistics_of_many,
    whole,
    with_confidences,
)
from farfield.metrics.centre.matching import DROPPED
from farfield.metrics.centre.scene import CentreScene, gather
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
    scene = with_confidences(gather(predictions, annotations, settings), settings)
    part, count = _by_objects(scene, match_scene(scene, settings), settings, _names(scene, annotations))
    drawing = bootstrap or settings.bootstrap
    figures = partial(statistics_of_many, part, settings)
    if count < 2 or drawing.replicates < 2:
        return ObjectIntervals(objects=count, intervals=dict.fromkeys(figures(np.ones((1, count + 1)))))
    drawn = replicate_weights(count, drawing.replicates, np.random.default_rng(drawing.seed))
    weights = np.column_stack([drawn, np.ones(len(drawn))])  # the last group is that of false positives
    tail = (1.0 - drawing.level) / 2
    found = {name: values[~np.isnan(values)] for name, values in figures(weights).items()}
    between = {name: _between(values, tail) if len(values) else None for name, values in found.items()}
    return ObjectIntervals(objects=count, intervals=between)


def _between(values: Float[np.ndarray, " r"], tail: float) -> tuple[float, float]:
    low, high = np.quantile(values, [tail, 1 - tail])
    return float(low), float(high)


def _names(scene: CentreScene, annotations: BoxesByFrame) -> Int[np.ndarray, " m"]:
    """A number of the object of each annotated box of the scene: boxes there are known by frame and place."""
    numbers: dict[tuple[str, int], int] = {}
    by_place: dict[tuple[int, bytes], int] = {}
    for frame, key in enumerate(sorted(annotations, key=frame_order)):
        boxes = annotations[key]
        told = np.full(len(boxes), -1) if boxes.track_id is None else boxes.track_id
        for row, name in enumerate(told.tolist()):
            own = (f"{key} {row}", -1) if name < 0 else (key[0], name)
            by_place[frame, boxes.centre_m[row].tobytes()] = numbers.setdefault(own, len(numbers))
    places = zip(scene.annotated_frame.tolist(), scene.annotated.centre_m, strict=True)
    return np.array([by_place[frame, centre.tobytes()] for frame, centre in places], dtype=np.int64)


def _by_objects(
    scene: CentreScene, matches: GreedyMatches, settings: CentreSettings, name: Int[np.ndarray, " m"]
) -> tuple[PartRankings, int]:
    """All of the scene as one part whose groups are the objects, and how many these are."""
    part = whole(scene, matches, settings)
    names = np.unique(name[~scene.ignored])
    number = np.searchsorted(names, name)  # of ignored boxes' objects: never asked for, as they are dropped
    annotated = np.append(np.bincount(number[~scene.ignored], minlength=len(names)), 0)
    rankings = {}
    for variant, ranking in part.ranking.items():
        taken = matches.taken[variant]
        rows = _rows(matches, taken)
        group: Int[np.ndarray, " n"] = np.full(len(rows), len(names))
        group[ranking.is_match] = number[taken[rows[ranking.is_match]]]
        rankings[variant] = replace(ranking, group=group, annotated=annotated)
    return replace(part, ranking=rankings), len(names)


def _rows(matches: GreedyMatches, taken: Int[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """The predictions of a ranking of the whole scene, in its order."""
    return matches.order[(taken != DROPPED)[matches.order]]
