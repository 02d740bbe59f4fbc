"""KITTI's average precision (Geiger et al., CVPR 2012): BEV and 3D overlap, R11 and R40, three difficulties.

A detection matches an annotated box of its class whose exact rotated IoU with it exceeds 0.7 (Car) or 0.5 (others):

    IoU(a, b) = |a and b| / |a or b|,   in the x-y plane ("bev") or in space ("3d")

The *annotated* boxes choose, in the order of the file, each a detection that is still free: first by score, to find the
scores at which recall grows; then, at each of 41 thresholds, by overlap among the detections above it. Precision is
sampled over recall as :mod:`farfield.metrics.recall_sampling` says: R11 averages it at recalls 0, 0.1 ... 1, R40 at
1/40 ... 1 (the official one since 2019).

Conventions. Annotated boxes of a neighbouring class (Van for Car) or beyond the difficulty may be found or not.
Detections whose 2D box is too low for the difficulty do not count. ``DontCare`` regions excuse detections in KITTI's 2D
measure only; ``dontcare="image"`` lets them do so here too. Without 2D facts there is one difficulty, ``all``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou
from farfield.metrics.bootstrap import Bootstrap, Draws, Weighted, point_and_intervals
from farfield.metrics.frames import (
    BoxesByFrame,
    check_frames,
    flatten,
    frame_order,
    group_frames,
    has_label,
    in_range,
    in_region,
    same_owner,
)
from farfield.metrics.options import check_range_bins, json_options, option_text
from farfield.metrics.recall_sampling import ThresholdCounts, sample_thresholds
from farfield.metrics.result import Result, table

Details = Mapping[Key, Mapping[str, np.ndarray]]
_PartMasks = dict[str, tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " m"]]]  # predicted and annotated boxes inside
_PartCounts = dict[tuple[str, str], ThresholdCounts]  # by measure and difficulty

DIFFICULTIES: dict[str, tuple[float, int, float]] = {  # least height in pixels, largest occlusion and truncation
    "easy": (40.0, 0, 0.15),
    "moderate": (25.0, 1, 0.30),
    "hard": (25.0, 2, 0.50),
}
NEIGHBOURS = {"Car": ("Van",), "Pedestrian": ("Person_sitting",)}
_STRICT = ("Car", "car", "Van", "vehicle", "Vehicle")


@dataclass(frozen=True, kw_only=True)
class KittiSettings:
    """Options of KITTI's average precision.

    Args:
        label: The class that is scored.
        relabel: Class names that stand for another.
        ignore: Classes whose annotated boxes may be found or not; None takes KITTI's neighbours (Van for Car).
        min_overlap: IoU that a match must exceed; None takes 0.7 for cars and vehicles and 0.5 for all else.
        dontcare: ``"image"``: detections that lie in a DontCare region of the image are not false.
        range_bins_m: Edges of the half-open range bins; both kinds of boxes are cut by their own 2D range.
        region: As for the other protocols.
        window_m: As for the other protocols.
        bootstrap: How intervals are drawn.
    """

    label: str = "Car"
    relabel: Mapping[str, str] = field(default_factory=lambda: {"large_vehicle": "vehicle"})
    ignore: tuple[str, ...] | None = None
    min_overlap: float | None = None
    dontcare: Literal["none", "image"] = "none"
    range_bins_m: tuple[float, ...] = (0.0, 70.0, 150.0, 250.0)
    region: Literal["window", "range", "none"] = "none"
    window_m: tuple[float, float, float, float] = (0.0, 250.0, -50.0, 50.0)
    bootstrap: Bootstrap = field(default_factory=Bootstrap)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ignore", NEIGHBOURS.get(self.label, ()) if self.ignore is None else self.ignore)
        object.__setattr__(self, "min_overlap", self.least_overlap)
        if not 0 < self.least_overlap < 1:
            raise ConfigError(f"min_overlap: expected a number between 0 and 1, got {self.min_overlap}")
        check_range_bins(self.range_bins_m)
        if self.dontcare not in ("none", "image") or self.region not in ("window", "range", "none"):
            raise ConfigError(f"expected dontcare none or image and region window, range or none, got {self}")
        if self.label in (self.ignore or ()):
            raise ConfigError(f"label: {self.label!r} is also ignored; take it out of ignore to score it")

    @property
    def least_overlap(self) -> float:
        """IoU that a match must exceed."""
        return (0.7 if self.label in _STRICT else 0.5) if self.min_overlap is None else self.min_overlap

    @property
    def bins_m(self) -> tuple[tuple[float, float], ...]:
        """The half-open range bins as (low, high)."""
        return tuple(pairwise(self.range_bins_m))

    def to_json(self) -> dict[str, Any]:
        """All options as JSON values."""
        return json_options(asdict(self))

    def convention(self) -> str:
        """The chosen options in one line."""
        shown = {name: value for name, value in self.to_json().items() if name not in ("bootstrap", "label")}
        if self.region != "window":
            del shown["window_m"]
        return "exact rotated IoU; " + option_text(shown)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class KittiResult(Result):
    """KITTI AP by overlap, recall points and difficulty; figures lie in [0, 1], the table shows per cent."""

    def __str__(self) -> str:
        parts = [*self.ranges, "overall"]
        rows = [
            [name.removeprefix("ap/").replace("/", " "), *(self.cell(part, name, scale=100.0) for part in parts)]
            for name in self.figures
        ]
        for name in ("annotated", "predictions"):
            counts = self.counts["ranges"] | {"overall": self.counts}
            rows.append([name, *(str(counts[part][name]) for part in parts)])
        title = f"KITTI AP of {self.label!r} in per cent, by range in metres; '-': nothing annotated"
        return f"{title}\n\n{table(['', *parts], rows)}\n\n{self.footer()}"


def evaluate_kitti(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KittiSettings | None = None,
    *,
    prediction_details: Details | None = None,
    annotation_details: Details | None = None,
    drives: Sequence[Drive] = (),
) -> KittiResult:
    """Score predictions with KITTI's average precision.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes the defaults.
        prediction_details: By frame, in the order of its boxes: ``box_px`` (n, 4) as left, top, right, bottom.
        annotation_details: Likewise ``truncation`` (n,), ``occlusion`` (n,), ``box_px`` (n, 4), and ``dontcare_px``
            (k, 4). None evaluates one difficulty, ``all``.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.

    Returns:
        Figures in [0, 1] named ``ap/bev_r11/easy``, ``ap/3d_r40/moderate``...

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, lack scores, or details do not fit.
    """
    settings = settings or KittiSettings()
    # 1. Gather the boxes of the class and their neighbours, with the overlap of each pair of a frame.
    data = gather_kitti(predictions, annotations, settings, prediction_details or {}, annotation_details, drives)
    parts = _part_masks(data, settings)
    # 2. Match, and count true and false positives at the thresholds of 41 recalls.
    counts = _count_parts(data, settings, parts)
    # 3. Average precision over recalls, for weights of 1 (the figures) and for draws of the drives (the intervals).
    figures, intervals = point_and_intervals(partial(_part_figures, counts), data.groups, settings.bootstrap)
    curves: dict[str, Any] = {part: {} for part in parts}
    for part, counted in counts.items():
        for (measure, difficulty), at_thresholds in counted.items():
            curves[part].setdefault(measure, {})[difficulty] = at_thresholds.curve()
    boxes = {
        part: {"annotated": int((data.is_label & annotated_in).sum()), "predictions": int(predicted_in.sum())}
        for part, (predicted_in, annotated_in) in parts.items()
    }
    frames = np.union1d(data.predicted_frame, data.annotated_frame[data.is_label])
    return KittiResult(
        protocol="kitti",
        label=settings.label,
        settings=settings.to_json(),
        convention=settings.convention(),
        figures=figures.pop("overall"),
        ranges=figures,
        counts={"frames": len(frames), "frames_given": len(annotations), **boxes.pop("overall"), "ranges": boxes},
        intervals=intervals,
        grouped_by=data.grouped_by,
        curves=curves,
    )


def weighted_kitti(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KittiSettings,
    *,
    prediction_details: Details | None = None,
    annotation_details: Details | None = None,
    drives: Sequence[Drive] = (),
) -> Weighted:
    """The figures as functions of group weights; the arguments are those of :func:`evaluate_kitti`."""
    data = gather_kitti(predictions, annotations, settings, prediction_details or {}, annotation_details, drives)
    counts = _count_parts(data, settings, _part_masks(data, settings))
    figures = {part: partial(_figures, counted) for part, counted in counts.items()}
    return Weighted(parts=figures, groups=tuple(data.group.tolist()), grouped_by=data.grouped_by)


def _part_masks(data: "KittiFrames", settings: KittiSettings) -> _PartMasks:
    """Which predicted and annotated boxes lie in the whole and in each range bin."""
    return {"overall": (np.ones(len(data.predicted), dtype=bool), np.ones(len(data.annotated), dtype=bool))} | {
        f"{low_m:g}-{high_m:g}": (in_range(data.predicted, low_m, high_m), in_range(data.annotated, low_m, high_m))
        for low_m, high_m in settings.bins_m
    }


def _count_parts(data: "KittiFrames", settings: KittiSettings, parts: _PartMasks) -> dict[str, _PartCounts]:
    return {
        part: {
            (measure, difficulty): _count(data, settings, measure, difficulty, *inside)
            for measure in data.overlap
            for difficulty in data.hardness
        }
        for part, inside in parts.items()
    }


def _part_figures(counts: Mapping[str, _PartCounts], weights: Float[np.ndarray, "r g"]) -> dict[str, Draws]:
    return {part: _figures(counted, weights) for part, counted in counts.items()}


def _figures(counted: _PartCounts, weights: Float[np.ndarray, "r g"]) -> Draws:
    """AP of one part by measure, recall points and difficulty under each row of group weights."""
    return {
        f"ap/{measure}_r{points}/{difficulty}": values
        for (measure, difficulty), at_thresholds in counted.items()
        for points, values in at_thresholds.average_precisions(weights, (11, 40)).items()
    }


# Step 1: gather


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
    frame_predictions = [predictions.get(key, Boxes.empty(scored=True)) for key in keys]
    frame_annotations = [annotations[key] for key in keys]
    predicted, annotated = flatten(frame_predictions, scored=True), flatten(frame_annotations, scored=False)
    predicted_frame = np.repeat(np.arange(len(keys)), [len(part) for part in frame_predictions])
    annotated_frame = np.repeat(np.arange(len(keys)), [len(part) for part in frame_annotations])
    is_label = has_label(annotated, settings.label, settings.relabel)
    used = is_label.copy()
    for name in settings.ignore or ():
        used |= has_label(annotated, name, settings.relabel)
    used &= in_region(annotated, settings)
    scored = has_label(predicted, settings.label, settings.relabel) & in_region(predicted, settings)
    box_px = detail_column(prediction_details, keys, frame_predictions, "box_px", 4)
    harmless = np.zeros(len(predicted), dtype=bool)
    if settings.dontcare == "image":
        harmless = in_dontcare(box_px, predicted_frame, keys, annotation_details or {}, settings.least_overlap)
    hardness = _hardness(annotation_details or {}, keys, frame_annotations)
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
    radius_m = (np.hypot(*annotated.size_m[:, :2].T)[box] + np.hypot(*predicted.size_m[:, :2].T)[detection]) / 2
    near = (gap**2).sum(axis=1) < radius_m**2
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


# Step 2: match and count


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
) -> tuple[Int[np.ndarray, "t f"], Int[np.ndarray, "t f"]]:
    """True and false positives of every frame at every threshold, each of shape (thresholds, frames)."""
    t = np.arange(len(thresholds))[:, None, None]
    allowed = frames.score[None] >= thresholds[:, None, None]
    assigned = np.zeros(allowed.shape, dtype=bool)
    true = np.zeros(allowed.shape[:2], dtype=np.int64)
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
        true[:, rows] += is_assigned & (frames.counts[rows, box] == 1) & ~frames.small[rows, chosen]
    false = allowed & ~assigned & ~(frames.small | frames.harmless) & np.isfinite(frames.score)
    return true, false.sum(axis=2)


def _count(
    data: KittiFrames,
    settings: KittiSettings,
    measure: str,
    difficulty: str,
    predicted_in: Bool[np.ndarray, " n"],
    annotated_in: Bool[np.ndarray, " m"],
) -> ThresholdCounts:
    must_find = data.is_label & ~data.hardness[difficulty] & annotated_in
    annotated = np.bincount(data.group[data.annotated_frame[must_find]], minlength=data.groups)
    small = data.height_px < (DIFFICULTIES[difficulty][0] if difficulty in DIFFICULTIES else 0.0)
    enough = data.overlap[measure] > settings.least_overlap
    frames = candidates(data, enough, measure, must_find, small, predicted_in, annotated_in)
    total = int(annotated.sum())
    thresholds, recalls = sample_thresholds(recall_scores(frames), total) if total else ([], [])
    true, false = count_at_thresholds(frames, np.array(thresholds, dtype=np.float64))
    return ThresholdCounts(
        thresholds=thresholds,
        recalls=recalls,
        true=_by_group(true, data),
        false=_by_group(false, data),
        annotated=annotated,
    )


def _by_group(counts: Int[np.ndarray, "t f"], data: KittiFrames) -> Float[np.ndarray, "t g"]:
    sums = [np.bincount(data.group, weights=row, minlength=data.groups) for row in counts]
    return np.array(sums).reshape(len(counts), data.groups)


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
    column, width = _places(data.predicted_frame, predicted_in, frames)
    slot, depth = _places(data.annotated_frame, annotated_in, frames)
    pairs = np.flatnonzero(enough & annotated_in[data.pair[:, 0]] & predicted_in[data.pair[:, 1]])
    box, detection = data.pair[pairs].T
    nth, choices = _places(box, np.ones(len(box), dtype=bool), len(data.annotated))
    choice = np.full((frames, depth, choices), -1)
    overlap = np.zeros(choice.shape)
    choice[data.annotated_frame[box], slot[box], nth] = column[detection]
    overlap[data.annotated_frame[box], slot[box], nth] = data.overlap[measure][pairs]
    counts = np.zeros((frames, depth), dtype=np.int64)
    counts[data.annotated_frame[must_find], slot[must_find]] = 1
    padded = {}
    score = np.zeros(0) if data.predicted.score is None else data.predicted.score
    for name, values, empty in (("score", score, -np.inf), ("small", small, False), ("harmless", data.harmless, False)):
        padded[name] = np.full((frames, width), empty)
        padded[name][data.predicted_frame[predicted_in], column[predicted_in]] = values[predicted_in]
    return Candidates(choice=choice, overlap=overlap, counts=counts, **padded)


def _places(
    owner: Int[np.ndarray, " n"], keep: Bool[np.ndarray, " n"], owners: int
) -> tuple[Int[np.ndarray, " n"], int]:
    """Place of each kept row among those of its owner (rows are sorted by owner), and the largest number of rows."""
    count = np.bincount(owner[keep], minlength=owners)
    index = np.zeros(len(owner), dtype=np.int64)
    index[keep] = np.arange(int(keep.sum())) - np.repeat(np.cumsum(count) - count, count)
    return index, max(int(count.max(initial=0)), 1)
