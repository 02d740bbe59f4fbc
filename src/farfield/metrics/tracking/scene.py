"""The boxes that scores of tracks take: one class of all frames, its ignored neighbours, and the pairs that touch.

:func:`gather` makes a :class:`TrackingScene` of detections by the options of :class:`TrackingSettings`;
:func:`best_pairs` pairs boxes one to one so that the sum of gains is largest (Hungarian method).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import iou_of_pairs
from farfield.metrics.detections import Detections
from farfield.metrics.frames import check_frames, flatten, frame_order, has_label, near_pairs
from farfield.metrics.kitti.evaluation import NEIGHBOURS, Details, detail_column, in_dontcare
from farfield.metrics.options import check_range_bins


@dataclass(frozen=True, kw_only=True)
class TrackingSettings:
    """Options of the scores of tracks.

    Args:
        label: The class that is scored.
        relabel: Class names that stand for another.
        ignore: Classes whose annotated boxes may be detections or not; None takes KITTI's neighbours (Van for Car).
        similarity: How alike two boxes are: ``"3d"`` and ``"bev"`` IoU, or ``"centre"``: 1 at the same place of x and
            y, 0 at ``distance_m`` and beyond.
        iou: Similarity that a match needs at least, for CLEAR and identity F1; HOTA takes all from 0.05 to 0.95.
        distance_m: For ``"centre"``: where the similarity is 0.
        least_track_score: Tracks whose mean score is lower are left out; None keeps all.
        count_ignored: Whether matches with ignored boxes help to place AB3DMOT's thresholds, as its code has it.
        range_bins_m: Edges of the half-open range bins: annotated boxes and matches count where the annotated box is,
            false ones where they are themselves. No track is cut.
    """

    label: str = "Car"
    relabel: Mapping[str, str] = field(default_factory=dict)
    ignore: tuple[str, ...] | None = None
    similarity: Literal["3d", "bev", "centre"] = "3d"
    iou: float = 0.25
    distance_m: float = 4.0
    least_track_score: float | None = None
    count_ignored: bool = True
    range_bins_m: tuple[float, ...] = (0.0, 70.0, 150.0, 250.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ignore", NEIGHBOURS.get(self.label, ()) if self.ignore is None else self.ignore)
        if not 0 < self.iou < 1:
            raise ConfigError(f"iou: expected a number between 0 and 1, got {self.iou}")
        if self.similarity not in ("3d", "bev", "centre"):
            raise ConfigError(f"similarity: expected 3d, bev or centre, got {self.similarity!r}")
        if not self.distance_m > 0:
            raise ConfigError(f"distance_m: expected a positive number, got {self.distance_m}")
        check_range_bins(self.range_bins_m)
        if self.label in (self.ignore or ()):
            raise ConfigError(f"label: {self.label!r} is also ignored; take it out of ignore to score it")

    @property
    def bins_m(self) -> dict[str, tuple[float, float]]:
        """The half-open range bins as (low, high) by name."""
        return {f"{low:g}-{high:g}": (low, high) for low, high in pairwise(self.range_bins_m)}


LEAST_HEIGHT_PX = 25.0
MOST_OCCLUSION, MOST_TRUNCATION = 2, 0
DONTCARE_SHARE = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxTable:
    """Boxes of all frames, in the order of the frames.

    Args:
        frame: Number of the frame, shape (n,).
        track: Number of the track, from 0, no two sequences share one, shape (n,).
        range_m: Distance from the sensor, shape (n,).
        aside: Annotated boxes that are ignored; predicted ones that are not false if nothing takes them, shape (n,).
        score: Mean score of the track, shape (n,); 0 for annotated boxes.
    """

    frame: Int[np.ndarray, " n"]
    track: Int[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    aside: Bool[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Bool[np.ndarray, " n"]) -> "BoxTable":
        return BoxTable(**{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackingScene:
    """Annotated and predicted boxes of one class, and how alike those of a frame are.

    Args:
        annotated: Annotated boxes with the ignored ones.
        predicted: Predicted boxes.
        pair: Rows (annotated, predicted) of one frame with a similarity above 0, shape (p, 2).
        similarity: Of each pair, in (0, 1], shape (p,).
        notes: What was assumed, one sentence each.
    """

    annotated: BoxTable
    predicted: BoxTable
    pair: Int[np.ndarray, "p 2"]
    similarity: Float[np.ndarray, " p"]
    notes: tuple[str, ...] = ()

    def cut(self, annotated: Bool[np.ndarray, " m"], predicted: Bool[np.ndarray, " n"]) -> "TrackingScene":
        """Some of the rows, with the pairs of these."""
        mask = annotated[self.pair[:, 0]] & predicted[self.pair[:, 1]]
        number = np.column_stack([(np.cumsum(m) - 1)[self.pair[mask, i]] for i, m in enumerate((annotated, predicted))])
        return replace(
            self,
            annotated=self.annotated[annotated],
            predicted=self.predicted[predicted],
            pair=number,
            similarity=self.similarity[mask],
        )


def gather(detections: Detections, settings: TrackingSettings) -> TrackingScene:
    """Collect one class of all frames.

    Raises:
        ConfigError: If boxes have no track, or a track has two boxes in a frame.
    """
    check_frames(detections.boxes, detections.annotated)
    keys = sorted(detections.annotations, key=frame_order)
    frame_annotations = [detections.annotations[key].boxes for key in keys]
    frame_predictions = [detections.boxes.get(key, Boxes.empty(scored=True)) for key in keys]
    annotated, predicted = flatten(frame_annotations, scored=False), flatten(frame_predictions, scored=True)
    is_label = has_label(annotated, settings.label, settings.relabel)
    used = is_label.copy()
    for name in settings.ignore or ():
        used |= has_label(annotated, name, settings.relabel)
    scored = has_label(predicted, settings.label, settings.relabel)
    ignored, facts_note = _ignored(detections, keys, frame_annotations)
    harmless, notes = _harmless(detections, keys, frame_predictions, scored)
    rows = collect_rows(keys, frame_annotations, annotated, used, ~is_label | ignored, what="annotations")
    tracks = collect_rows(keys, frame_predictions, predicted, scored, harmless, what="predictions")
    annotated, predicted = annotated[used], predicted[scored]
    measure = partial(_similarity, annotated, predicted, settings)
    pair, similarity = near_pairs(rows.frame, tracks.frame, len(keys), measure, keys.__getitem__)
    scene = TrackingScene(
        annotated=rows,
        predicted=tracks,
        pair=pair,
        similarity=similarity,
        notes=(*facts_note, *notes),
    )
    if settings.least_track_score is None:
        return scene
    return scene.cut(np.ones(len(rows), dtype=bool), tracks.score >= settings.least_track_score)


def collect_rows(
    keys: Sequence[Key],
    parts: Sequence[Boxes],
    boxes: Boxes,
    used: Bool[np.ndarray, " n"],
    aside: Bool[np.ndarray, " n"],
    *,
    what: str,
) -> BoxTable:
    """The used rows of all frames' boxes with their tracks, which are checked.

    Args:
        keys: The frames in their order.
        parts: The boxes of each.
        boxes: All of them.
        used: Which of them.
        aside: Which of them are ignored or harmless, see :class:`BoxTable`.
        what: Whose boxes, for messages.

    Raises:
        ConfigError: If boxes have no track, or a track has two boxes in a frame.
    """
    frame = np.repeat(np.arange(len(keys)), [len(part) for part in parts])[used]
    ids = [np.full(len(part), -1) if part.track_id is None else part.track_id for part in parts]
    track_id = np.concatenate([np.zeros(0, dtype=np.int64), *ids])[used]
    if (track_id < 0).any():
        key = keys[frame[np.flatnonzero(track_id < 0)[0]]]
        raise ConfigError(
            f"{what}: expected boxes with a track_id, to score tracks; got a box without one in {key}. "
            "Run `farfield track` over the detections first"
        )
    twice = np.unique(np.column_stack([frame, track_id]), axis=0, return_counts=True)
    if (twice[1] > 1).any():
        number, name = twice[0][np.flatnonzero(twice[1] > 1)[0]].tolist()
        raise ConfigError(f"{what}: expected each track once a frame, got track {name} twice in {keys[number]}")
    names = {name: index for index, name in enumerate(dict.fromkeys(key[0] for key in keys))}
    sequence = np.array([names[key[0]] for key in keys], dtype=np.int64)[frame]
    track = np.unique(np.column_stack([sequence, track_id]), axis=0, return_inverse=True)[1].reshape(-1)
    score = np.zeros(len(boxes)) if boxes.score is None else boxes.score
    mean = np.bincount(track, score[used]) / np.maximum(np.bincount(track), 1)
    return BoxTable(frame=frame, track=track, range_m=boxes.range_m[used], aside=aside[used], score=mean[track])


def _similarity(
    annotated: Boxes, predicted: Boxes, settings: TrackingSettings, pair: Int[np.ndarray, "p 2"]
) -> Float[np.ndarray, " p"]:
    if settings.similarity == "centre":
        gap_m = np.hypot(*(annotated.centre_m[pair[:, 0]] - predicted.centre_m[pair[:, 1]])[:, :2].T)
        return np.maximum(1 - gap_m / settings.distance_m, 0.0)
    return iou_of_pairs(annotated, predicted, pair, kind=settings.similarity)


def _ignored(
    detections: Detections, keys: list[Key], frame_annotations: list[Boxes]
) -> tuple[Bool[np.ndarray, " n"], tuple[str, ...]]:
    """Annotated boxes that KITTI ignores as hidden or cut; a note where that is not known."""
    details: Details = {key: annotation.details for key, annotation in detections.annotations.items()}
    ignored = np.zeros(sum(map(len, frame_annotations)), dtype=bool)
    missing = []
    for name, most in (("occlusion", MOST_OCCLUSION), ("truncation", MOST_TRUNCATION)):
        column = detail_column(details, keys, frame_annotations, name, 1)
        if column is None:
            missing.append(name)
        else:
            ignored |= column[:, 0] > most
    return ignored, (f"boxes are annotated without {', '.join(missing)}: none is ignored for it",) if missing else ()


def _harmless(
    detections: Detections, keys: list[Key], frame_predictions: list[Boxes], scored: Bool[np.ndarray, " n"]
) -> tuple[Bool[np.ndarray, " n"], tuple[str, ...]]:
    """Predicted boxes that are never false: low in the image, or in a DontCare region; a note on those unknown."""
    regions: Details = {key: annotation.unboxed for key, annotation in detections.annotations.items()}
    box_px = detail_column(detections.prediction_details, keys, frame_predictions, "box_px", 4)
    if box_px is None:
        has_boxes = any("box_px" in annotation.details for annotation in detections.annotations.values())
        note = "predictions have no box in the image: none is spared as too low in the image or in a DontCare region"
        return np.zeros(len(scored), dtype=bool), (note,) if has_boxes and scored.any() else ()
    valid = (box_px[:, 2:] > box_px[:, :2]).all(axis=1)
    frame = np.repeat(np.arange(len(keys)), [len(part) for part in frame_predictions])
    low = box_px[:, 3] - box_px[:, 1] <= LEAST_HEIGHT_PX
    harmless = valid & (low | in_dontcare(box_px, frame, keys, regions, DONTCARE_SHARE))
    absent = int((scored & ~valid).sum())
    note = f"{absent} of {int(scored.sum())} predicted boxes have no box in the image: they count as false if unmatched"
    return harmless, (note,) if absent else ()


# One-to-one pairs of rows and columns, of many groups at once


def best_pairs(
    row: Int[np.ndarray, " p"],
    column: Int[np.ndarray, " p"],
    gain: Float[np.ndarray, " p"],
    group: Int[np.ndarray, " p"],
) -> Int[np.ndarray, " k"]:
    """Choose pairs, no row and no column twice, whose gains have the largest sum.

    Rows and columns without rivals are paired at once, the others by the Hungarian method, group by group.

    Args:
        row: Row of each possible pair; a number stands for one row of all groups.
        column: Column of each, likewise.
        gain: What a pair adds to the sum, above 0; a pair that is not listed adds 0.
        group: Group of each pair, such as its frame, rising.

    Returns:
        Places of the chosen pairs, rising.
    """
    if not len(row):
        return np.zeros(0, dtype=np.int64)
    alone = (np.bincount(row)[row] == 1) & (np.bincount(column)[column] == 1)
    chosen = [np.flatnonzero(alone)]
    rest = np.flatnonzero(~alone)
    if len(rest):
        cuts = np.flatnonzero(np.diff(group[rest])) + 1
        chosen += [_hungarian(row, column, gain, part) for part in np.split(rest, cuts)]
    return np.sort(np.concatenate(chosen))


def _hungarian(
    row: Int[np.ndarray, " p"],
    column: Int[np.ndarray, " p"],
    gain: Float[np.ndarray, " p"],
    part: Int[np.ndarray, " q"],
) -> Int[np.ndarray, " k"]:
    """The best of the pairs that stand at some places."""
    low_row, low_column = row[part].min(), column[part].min()
    shape = (int(row[part].max() - low_row) + 1, int(column[part].max() - low_column) + 1)
    index = np.full(shape, -1)
    index[row[part] - low_row, column[part] - low_column] = part
    worth = np.where(index >= 0, gain[index], 0.0)
    chosen = index[linear_sum_assignment(worth, maximize=True)]
    return chosen[chosen >= 0]


def greedy_pairs(
    row: Int[np.ndarray, " p"], column: Int[np.ndarray, " p"], order: Int[np.ndarray, " p"]
) -> Int[np.ndarray, " k"]:
    """Choose pairs one after the other, each whose row and column are still free.

    Args:
        row: Row of each possible pair.
        column: Column of each.
        order: Places of the pairs in the order in which they may choose.

    Returns:
        Places of the chosen pairs, rising.
    """
    rows: set[int] = set()
    columns: set[int] = set()
    chosen = []
    for pair, a, b in zip(order.tolist(), row[order].tolist(), column[order].tolist(), strict=True):
        if a not in rows and b not in columns:
            rows.add(a)
            columns.add(b)
            chosen.append(pair)
    return np.sort(np.array(chosen, dtype=np.int64))
