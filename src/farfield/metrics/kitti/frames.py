"""All frames of a KITTI evaluation as flat arrays, and the candidates of each annotated box."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou
from farfield.metrics.frames import (
    BoxesByFrame,
    check_frames,
    flatten,
    frame_order,
    group_frames,
    has_label,
    in_region,
    same_owner,
)
from farfield.metrics.kitti.matching import Candidates
from farfield.metrics.kitti.settings import DIFFICULTIES, KittiSettings

Details = Mapping[Key, Mapping[str, np.ndarray]]


@dataclass(frozen=True, eq=False, kw_only=True)
class KittiFrames:
    """All frames as flat arrays; pairs are those of one frame whose boxes can touch."""

    predicted: Boxes
    predicted_frame: Int[np.ndarray, " n"]
    height_px: Float[np.ndarray, " n"]
    harmless: Bool[np.ndarray, " n"]
    annotated: Boxes
    annotated_frame: Int[np.ndarray, " m"]
    is_label: Bool[np.ndarray, " m"]
    hardness: dict[str, Bool[np.ndarray, " m"]]  # by difficulty: boxes beyond it
    pair: Int[np.ndarray, "p 2"]  # annotated, predicted
    overlap: dict[str, Float[np.ndarray, " p"]]
    group: Int[np.ndarray, " f"]
    grouped_by: str

    @property
    def groups(self) -> int:
        """Number of resampling groups."""
        return int(self.group.max()) + 1 if len(self.group) else 0


def gather_kitti(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KittiSettings,
    prediction_details: Details,
    annotation_details: Details | None,
    drives: Sequence[Drive] = (),
) -> KittiFrames:
    """Collect one class from all frames; the arguments are those of ``evaluate_kitti``."""
    check_frames(predictions, annotations)
    keys = sorted(annotations, key=frame_order)
    found = [predictions.get(key, Boxes.empty(scored=True)) for key in keys]
    given = [annotations[key] for key in keys]
    predicted, annotated = flatten(found, scored=True), flatten(given, scored=False)
    predicted_frame = np.repeat(np.arange(len(keys)), [len(part) for part in found])
    annotated_frame = np.repeat(np.arange(len(keys)), [len(part) for part in given])
    is_label = has_label(annotated, settings.label, settings.relabel)
    used = is_label.copy()
    for name in settings.ignore or ():
        used |= has_label(annotated, name, settings.relabel)
    used &= in_region(annotated, settings)
    scored = has_label(predicted, settings.label, settings.relabel) & in_region(predicted, settings)
    box_px = detail_column(prediction_details, keys, found, "box_px", 4)
    harmless = np.zeros(len(predicted), dtype=bool)
    if settings.dontcare == "image":
        harmless = in_dontcare(box_px, predicted_frame, keys, annotation_details or {}, settings.least_overlap)
    hardness = _hardness(annotation_details or {}, keys, given)
    height_px = np.full(len(predicted), np.inf) if box_px is None else np.abs(box_px[:, 3] - box_px[:, 1])
    predicted, annotated = predicted[scored], annotated[used]
    predicted_frame, annotated_frame = predicted_frame[scored], annotated_frame[used]
    pair = _pairs(predicted, predicted_frame, annotated, annotated_frame, len(keys))
    group, grouped_by = group_frames(keys, drives)
    return KittiFrames(
        predicted=predicted,
        predicted_frame=predicted_frame,
        height_px=height_px[scored],
        harmless=harmless[scored],
        annotated=annotated,
        annotated_frame=annotated_frame,
        is_label=is_label[used],
        hardness={name: hard[used] for name, hard in hardness.items()},
        pair=pair,
        overlap={kind: paired_iou(annotated[pair[:, 0]], predicted[pair[:, 1]], kind=kind) for kind in ("bev", "3d")},
        group=group,
        grouped_by=grouped_by,
    )


def candidates(
    data: KittiFrames,
    enough: Bool[np.ndarray, " p"],
    measure: str,
    must_find: Bool[np.ndarray, " m"],
    small: Bool[np.ndarray, " n"],
    predicted_in: Bool[np.ndarray, " n"],
    annotated_in: Bool[np.ndarray, " m"],
) -> Candidates:
    """Pad what one part, measure and difficulty needs by frame."""
    frames = len(data.group)
    place, width = _places(data.predicted_frame, predicted_in, frames)
    slot, depth = _places(data.annotated_frame, annotated_in, frames)
    kept = np.flatnonzero(enough & annotated_in[data.pair[:, 0]] & predicted_in[data.pair[:, 1]])
    box, detection = data.pair[kept].T
    nth, choices = _places(box, np.ones(len(box), dtype=bool), len(data.annotated))
    choice = np.full((frames, depth, choices), -1)
    overlap = np.zeros(choice.shape)
    choice[data.annotated_frame[box], slot[box], nth] = place[detection]
    overlap[data.annotated_frame[box], slot[box], nth] = data.overlap[measure][kept]
    counts = np.zeros((frames, depth), dtype=np.int64)
    counts[data.annotated_frame[must_find], slot[must_find]] = 1
    padded = {}
    score = np.zeros(0) if data.predicted.score is None else data.predicted.score
    for name, values, empty in (("score", score, -np.inf), ("small", small, False), ("harmless", data.harmless, False)):
        padded[name] = np.full((frames, width), empty)
        padded[name][data.predicted_frame[predicted_in], place[predicted_in]] = values[predicted_in]
    return Candidates(choice=choice, overlap=overlap, counts=counts, **padded)


def _places(
    owner: Int[np.ndarray, " n"], keep: Bool[np.ndarray, " n"], owners: int
) -> tuple[Int[np.ndarray, " n"], int]:
    """Place of each kept row among those of its owner (rows are sorted by owner), and the largest number of rows."""
    count = np.bincount(owner[keep], minlength=owners)
    place = np.zeros(len(owner), dtype=np.int64)
    place[keep] = np.arange(int(keep.sum())) - np.repeat(np.cumsum(count) - count, count)
    return place, max(int(count.max(initial=0)), 1)


def _pairs(
    predicted: Boxes,
    predicted_frame: Int[np.ndarray, " n"],
    annotated: Boxes,
    annotated_frame: Int[np.ndarray, " m"],
    frames: int,
) -> Int[np.ndarray, "p 2"]:
    """Pairs (annotated, predicted) of one frame whose circumscribed circles meet, in the order of the boxes."""
    box, detection = same_owner(annotated_frame, predicted_frame, frames)
    gap = annotated.centre_m[box, :2] - predicted.centre_m[detection, :2]
    reach = (np.hypot(*annotated.size_m[:, :2].T)[box] + np.hypot(*predicted.size_m[:, :2].T)[detection]) / 2
    near = (gap**2).sum(axis=1) < reach**2
    return np.column_stack([box[near], detection[near]])


def detail_column(
    details: Details, keys: list[Key], boxes: list[Boxes], name: str, width: int
) -> Float[np.ndarray, "n width"] | None:
    """One detail of all boxes, or None where no frame has it.

    Raises:
        ConfigError: If some frames with boxes lack it, or it does not have one row a box.
    """
    if not any(name in details.get(key, {}) for key in keys):
        return None
    parts = []
    for key, part in zip(keys, boxes, strict=True):
        values = np.asarray(details.get(key, {}).get(name, np.zeros((0, width))), dtype=np.float64).reshape(-1, width)
        if len(values) != len(part):
            raise ConfigError(
                f"details[{key}][{name!r}]: expected a row for each of {len(part)} boxes, got {len(values)}"
            )
        parts.append(values)
    return np.concatenate(parts)


def _hardness(details: Details, keys: list[Key], boxes: list[Boxes]) -> dict[str, Bool[np.ndarray, " n"]]:
    """Which annotated boxes are beyond each difficulty; ``all`` alone where there are no 2D facts."""
    columns = {name: detail_column(details, keys, boxes, name, 1) for name in ("truncation", "occlusion")}
    truncation, occlusion = columns["truncation"], columns["occlusion"]
    box_px = detail_column(details, keys, boxes, "box_px", 4)
    if truncation is None or occlusion is None or box_px is None:
        return {"all": np.zeros(sum(map(len, boxes)), dtype=bool)}
    height_px = np.abs(box_px[:, 3] - box_px[:, 1])
    return {
        name: (height_px <= least_px) | (occlusion[:, 0] > occluded) | (truncation[:, 0] > truncated)
        for name, (least_px, occluded, truncated) in DIFFICULTIES.items()
    }


def in_dontcare(
    box_px: Float[np.ndarray, "n 4"] | None,
    frame: Int[np.ndarray, " n"],
    keys: list[Key],
    details: Details,
    least: float,
) -> Bool[np.ndarray, " n"]:
    """Which predictions lie in a DontCare region by more than ``least`` of their own 2D area."""
    if box_px is None:
        raise ConfigError("dontcare='image': expected box_px in prediction_details, got none")
    inside = np.zeros(len(box_px), dtype=bool)
    start = np.searchsorted(frame, np.arange(len(keys) + 1))
    for number, key in enumerate(keys):
        regions = np.asarray(details.get(key, {}).get("dontcare_px", np.zeros((0, 4))), dtype=np.float64)
        rows = slice(start[number], start[number + 1])
        boxes = box_px[rows, None]
        low, high = np.maximum(boxes[..., :2], regions[:, :2]), np.minimum(boxes[..., 2:], regions[:, 2:])
        area = np.prod(np.maximum(boxes[..., 2:] - boxes[..., :2], 1e-9), axis=-1)
        inside[rows] = (np.prod(np.maximum(high - low, 0.0), axis=-1) > least * area).any(axis=1)
    return inside
