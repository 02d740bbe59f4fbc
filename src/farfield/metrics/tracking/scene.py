"""All frames of an evaluation of tracks as flat arrays: one class, its ignored neighbours, pairs that touch."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou
from farfield.metrics.frames import check_frames, flatten, frame_order, has_label, same_owner
from farfield.metrics.kitti.frames import Details, detail_column, in_dontcare
from farfield.metrics.tracking.settings import TrackingSettings

if TYPE_CHECKING:
    from farfield.metrics.detections import Detections

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
        kept = annotated[self.pair[:, 0]] & predicted[self.pair[:, 1]]
        number = np.column_stack([(np.cumsum(m) - 1)[self.pair[kept, i]] for i, m in enumerate((annotated, predicted))])
        return replace(
            self,
            annotated=self.annotated[annotated],
            predicted=self.predicted[predicted],
            pair=number,
            similarity=self.similarity[kept],
        )


def gather(found: "Detections", settings: TrackingSettings) -> TrackingScene:
    """Collect one class of all frames.

    Raises:
        ConfigError: If boxes have no track, or a track has two boxes in a frame.
    """
    check_frames(found.boxes, found.annotated)
    keys = sorted(found.annotations, key=frame_order)
    given = [found.annotations[key].boxes for key in keys]
    seen = [found.boxes.get(key, Boxes.empty(scored=True)) for key in keys]
    annotated, predicted = flatten(given, scored=False), flatten(seen, scored=True)
    is_label = has_label(annotated, settings.label, settings.relabel)
    used = is_label.copy()
    for name in settings.ignore or ():
        used |= has_label(annotated, name, settings.relabel)
    scored = has_label(predicted, settings.label, settings.relabel)
    ignored, facts_note = _ignored(found, keys, given)
    harmless, notes = _harmless(found, keys, seen, scored)
    rows = collect_rows(keys, given, annotated, used, ~is_label | ignored, what="annotations")
    tracks = collect_rows(keys, seen, predicted, scored, harmless, what="predictions")
    annotated, predicted = annotated[used], predicted[scored]
    pair = np.column_stack(same_owner(rows.frame, tracks.frame, len(keys)))
    similarity = _similarity(annotated, predicted, pair, settings)
    alike = similarity > 0
    scene = TrackingScene(
        annotated=rows,
        predicted=tracks,
        pair=pair[alike],
        similarity=similarity[alike],
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
    names = {name: place for place, name in enumerate(dict.fromkeys(key[0] for key in keys))}
    sequence = np.array([names[key[0]] for key in keys], dtype=np.int64)[frame]
    track = np.unique(np.column_stack([sequence, track_id]), axis=0, return_inverse=True)[1].reshape(-1)
    score = np.zeros(len(boxes)) if boxes.score is None else boxes.score
    mean = np.bincount(track, score[used]) / np.maximum(np.bincount(track), 1)
    return BoxTable(frame=frame, track=track, range_m=boxes.range_m[used], aside=aside[used], score=mean[track])


def _similarity(
    annotated: Boxes, predicted: Boxes, pair: Int[np.ndarray, "p 2"], settings: TrackingSettings
) -> Float[np.ndarray, " p"]:
    a, b = annotated[pair[:, 0]], predicted[pair[:, 1]]
    if settings.similarity == "centre":
        gap_m = np.hypot(*(a.centre_m - b.centre_m)[:, :2].T)
        return np.maximum(1 - gap_m / settings.distance_m, 0.0)
    return paired_iou(a, b, kind=settings.similarity)


def _ignored(
    found: "Detections", keys: list[Key], given: list[Boxes]
) -> tuple[Bool[np.ndarray, " n"], tuple[str, ...]]:
    """Annotated boxes that KITTI ignores as hidden or cut; a note where that is not known."""
    details: Details = {key: annotation.details for key, annotation in found.annotations.items()}
    ignored = np.zeros(sum(map(len, given)), dtype=bool)
    missing = []
    for name, most in (("occlusion", MOST_OCCLUSION), ("truncation", MOST_TRUNCATION)):
        column = detail_column(details, keys, given, name, 1)
        if column is None:
            missing.append(name)
        else:
            ignored |= column[:, 0] > most
    return ignored, (f"boxes are annotated without {', '.join(missing)}: none is ignored for it",) if missing else ()


def _harmless(
    found: "Detections", keys: list[Key], seen: list[Boxes], scored: Bool[np.ndarray, " n"]
) -> tuple[Bool[np.ndarray, " n"], tuple[str, ...]]:
    """Predicted boxes that are never false: low in the image, or in a DontCare region; a note on those unknown."""
    regions: Details = {key: annotation.unboxed for key, annotation in found.annotations.items()}
    box_px = detail_column(found.prediction_details, keys, seen, "box_px", 4)
    if box_px is None:
        known = any("box_px" in annotation.details for annotation in found.annotations.values())
        note = "predictions have no box in the image: none is spared as too low in the image or in a DontCare region"
        return np.zeros(len(scored), dtype=bool), (note,) if known and scored.any() else ()
    valid = (box_px[:, 2:] > box_px[:, :2]).all(axis=1)
    frame = np.repeat(np.arange(len(keys)), [len(part) for part in seen])
    low = box_px[:, 3] - box_px[:, 1] <= LEAST_HEIGHT_PX
    harmless = valid & (low | in_dontcare(box_px, frame, keys, regions, DONTCARE_SHARE))
    absent = int((scored & ~valid).sum())
    note = f"{absent} of {int(scored.sum())} predicted boxes have no box in the image: they count as false if unmatched"
    return harmless, (note,) if absent else ()
