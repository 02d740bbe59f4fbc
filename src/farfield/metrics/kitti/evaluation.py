"""KITTI's average precision (Geiger et al., CVPR 2012): 2D, BEV and 3D overlap, AOS, R11 and R40, three difficulties.

A detection matches an annotated box of its class whose exact rotated IoU with it exceeds 0.7 (Car) or 0.5 (others):

    IoU(a, b) = |a and b| / |a or b|,   in the image ("2d"), the x-y plane ("bev") or in space ("3d")

The average orientation similarity ("aos") is that of the image with s / (TP + FP) in the place of precision, where s
sums (1 + cos d) / 2 over the matches, d the difference of the headings as the camera sees them.

The *annotated* boxes choose, in the order of the file, each a detection that is still free: first by score, to find the
scores at which recall grows; then, at each of 41 thresholds, by overlap among the detections above it. Precision is
sampled over recall as :mod:`farfield.metrics.recall_sampling` says: R11 averages it at recalls 0, 0.1 ... 1, R40 at
1/40 ... 1 (the official one since 2019). Fewer than 41 annotated boxes: see ``sampling``.

Conventions. Annotated boxes of a neighbouring class (Van for Car) or beyond the difficulty may be found or not.
Detections whose 2D box is too low for the difficulty do not count. ``DontCare`` regions excuse detections in KITTI's 2D
measure only; ``dontcare="image"`` lets them do so in the others too. Without 2D facts of the annotation there is one
difficulty, ``all``; without 2D boxes on both sides there are neither "2d" nor "aos".
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import iou_of_pairs
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
    near_pairs,
)
from farfield.metrics.kitti.image import heading_similarity, image_iou, image_overlap_px
from farfield.metrics.kitti.matching import Candidates, count_at_thresholds, places_of_rows, recall_scores
from farfield.metrics.options import check_range_bins, json_options, option_text
from farfield.metrics.recall_sampling import SAMPLES, ThresholdCounts, sample_thresholds
from farfield.metrics.result import Result, table
from farfield.vocabulary.counts import count_of

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
        sampling: With fewer than 41 annotated boxes KITTI's code leaves recall samples at 0 (``"gaps"``), so that no
            detector reaches 100; ``"filled"`` gives them the best precision at that recall.
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
    sampling: Literal["filled", "gaps"] = "filled"
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
        if self.sampling not in ("filled", "gaps"):
            raise ConfigError(f"sampling: expected filled or gaps, got {self.sampling!r}")
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
        """All options as JSON values; ``sampling`` where it is not the one of results written before there was any."""
        options = json_options(asdict(self))
        if self.sampling == "filled":
            del options["sampling"]
        return options

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
        prediction_details: By frame, in the order of its boxes: ``box_px`` (n, 4) as left, top, right, bottom, and
            ``alpha_rad`` (n,), the heading as the camera sees it.
        annotation_details: Likewise ``truncation`` (n,), ``occlusion`` (n,), ``box_px`` (n, 4), ``alpha_rad`` (n,), and
            ``dontcare_px`` (k, 4). None evaluates one difficulty, ``all``.
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
    figures, intervals = point_and_intervals(partial(_part_figures, counts, settings), data.groups, settings.bootstrap)
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
    figures = {part: partial(_figures, counted, settings) for part, counted in counts.items()}
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
            (name, difficulty): counted
            for measure in data.overlap
            for difficulty in data.hardness
            for name, counted in _count(data, settings, measure, difficulty, *inside).items()
        }
        for part, inside in parts.items()
    }


def _part_figures(
    counts: Mapping[str, _PartCounts], settings: KittiSettings, weights: Float[np.ndarray, "r g"]
) -> dict[str, Draws]:
    return {part: _figures(counted, settings, weights) for part, counted in counts.items()}


def _figures(counted: _PartCounts, settings: KittiSettings, weights: Float[np.ndarray, "r g"]) -> Draws:
    """AP of one part by measure, recall points and difficulty under each row of group weights."""
    gaps = settings.sampling == "gaps"
    return {
        f"ap/{measure}_r{points}/{difficulty}": values
        for (measure, difficulty), at_thresholds in counted.items()
        for points, values in at_thresholds.average_precisions(weights, (11, 40), gaps=gaps).items()
    }


# Step 1: gather


@dataclass(frozen=True, eq=False, kw_only=True)
class KittiFrames:
    """All frames as flat arrays; pairs are those of one frame whose boxes can touch."""

    predicted: Boxes
    predicted_frame: Int[np.ndarray, " n"]
    height_px: Float[np.ndarray, " n"]
    harmless: dict[str, Bool[np.ndarray, " n"]]  # by measure
    annotated: Boxes
    annotated_frame: Int[np.ndarray, " m"]
    is_label: Bool[np.ndarray, " m"]
    hardness: dict[str, Bool[np.ndarray, " m"]]  # by difficulty: boxes beyond it
    pair: Int[np.ndarray, "p 2"]  # annotated, predicted
    overlap: dict[str, Float[np.ndarray, " p"]]
    similarity: Float[np.ndarray, " p"]  # of headings as a camera sees them
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
    marked_px = detail_column(annotation_details or {}, keys, frame_annotations, "box_px", 4)
    in_image = box_px is not None and marked_px is not None
    none = np.zeros(len(predicted), dtype=bool)
    excused = none
    if settings.dontcare == "image" or in_image:
        excused = in_dontcare(box_px, predicted_frame, keys, annotation_details or {}, settings.least_overlap)
    hardness = _hardness(annotation_details or {}, keys, frame_annotations)
    height_px = np.full(len(predicted), np.inf) if box_px is None else np.abs(box_px[:, 3] - box_px[:, 1])
    angles = [
        detail_column(details, keys, frames, "alpha_rad", 1)
        for details, frames in ((annotation_details or {}, frame_annotations), (prediction_details, frame_predictions))
    ]
    columns_px = (marked_px[used], box_px[scored]) if box_px is not None and marked_px is not None else None
    alpha_rad = [
        None if column is None else column[rows, 0] for column, rows in zip(angles, (used, scored), strict=True)
    ]
    predicted, annotated = predicted[scored], annotated[used]
    predicted_frame, annotated_frame = predicted_frame[scored], annotated_frame[used]
    nearness = partial(_nearness, annotated, predicted, columns_px)
    pair, _ = near_pairs(annotated_frame, predicted_frame, len(keys), nearness, keys.__getitem__)
    overlap = {kind: iou_of_pairs(annotated, predicted, pair, kind=kind) for kind in ("bev", "3d")}
    overlap |= {"2d": image_iou(*columns_px, pair)} if columns_px else {}
    group, grouped_by = group_frames(keys, drives)
    harmless = (excused if settings.dontcare == "image" else none)[scored]
    return KittiFrames(
        predicted=predicted,
        predicted_frame=predicted_frame,
        height_px=height_px[scored],
        harmless={"bev": harmless, "3d": harmless, "2d": excused[scored]},
        annotated=annotated,
        annotated_frame=annotated_frame,
        is_label=is_label[used],
        hardness={name: hard[used] for name, hard in hardness.items()},
        pair=pair,
        overlap=overlap,
        similarity=heading_similarity(annotated, predicted, pair, *alpha_rad),
        group=group,
        grouped_by=grouped_by,
    )


def _nearness(
    annotated: Boxes,
    predicted: Boxes,
    box_px: tuple[Float[np.ndarray, "m 4"], Float[np.ndarray, "n 4"]] | None,
    pair: Int[np.ndarray, "p 2"],
) -> Float[np.ndarray, " p"]:
    """By how much the circumscribed circles of each pair meet, squared metres, or the boxes in the image, if more."""
    box, detection = pair.T
    gap = annotated.centre_m[box, :2] - predicted.centre_m[detection, :2]
    radius_m = (np.hypot(*annotated.size_m[:, :2].T)[box] + np.hypot(*predicted.size_m[:, :2].T)[detection]) / 2
    near = radius_m**2 - (gap**2).sum(axis=1)
    return near if box_px is None else np.maximum(near, image_overlap_px(*box_px, pair))


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
                f"details[{key}][{name!r}]: expected a row for each of "
                f"{count_of(len(part), 'box', 'boxes')}, got {len(values)}"
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


def _count(
    data: KittiFrames,
    settings: KittiSettings,
    measure: str,
    difficulty: str,
    predicted_in: Bool[np.ndarray, " n"],
    annotated_in: Bool[np.ndarray, " m"],
) -> dict[str, ThresholdCounts]:
    """Counts of one measure, and of AOS beside that of the image."""
    must_find = data.is_label & ~data.hardness[difficulty] & annotated_in
    annotated = np.bincount(data.group[data.annotated_frame[must_find]], minlength=data.groups)
    small = data.height_px < (DIFFICULTIES[difficulty][0] if difficulty in DIFFICULTIES else 0.0)
    enough = data.overlap[measure] > settings.least_overlap
    blocks = _blocks_of_frames(data, enough, predicted_in, annotated_in)
    padded = partial(candidates, data, enough, measure, must_find, small, predicted_in, annotated_in)
    total = int(annotated.sum())
    thresholds: list[float] = []
    recalls: list[float] = []
    if total:
        scores = np.concatenate([recall_scores(padded(block)) for block in blocks])
        thresholds, recalls = sample_thresholds(np.sort(scores)[::-1], total)
    true, false, alike = (np.zeros((len(thresholds), len(data.group))) for _ in range(3))
    for block in blocks:
        counts = count_at_thresholds(padded(block), np.array(thresholds, dtype=np.float64))
        true[:, block], false[:, block], alike[:, block] = counts
    counted = ThresholdCounts(
        thresholds=thresholds,
        recalls=recalls,
        true=_by_group(true, data),
        false=_by_group(false, data),
        annotated=annotated,
    )
    if measure != "2d":
        return {measure: counted}
    return {measure: counted, "aos": replace(counted, worth=_by_group(alike, data))}


_PADDED_AT_ONCE = 8_000_000  # numbers of a block of frames


def _blocks_of_frames(
    data: KittiFrames,
    enough: Bool[np.ndarray, " p"],
    predicted_in: Bool[np.ndarray, " n"],
    annotated_in: Bool[np.ndarray, " m"],
) -> list[Int[np.ndarray, " f"]]:
    """Frames, each in one block, that together fill little memory when all are padded to the largest of their block."""
    frames = len(data.group)
    width = np.bincount(data.predicted_frame[predicted_in], minlength=frames)
    depth = np.bincount(data.annotated_frame[annotated_in], minlength=frames)
    box = data.pair[enough & annotated_in[data.pair[:, 0]] & predicted_in[data.pair[:, 1]], 0]
    most = np.zeros(frames, dtype=np.int64)
    np.maximum.at(most, data.annotated_frame, np.bincount(box, minlength=len(data.annotated)))
    sizes = np.maximum(np.array([width, depth, most]), 1)
    widest, deepest, longest = sizes.max(axis=1, initial=1).tolist()
    if frames * max(SAMPLES * widest, deepest * longest) <= _PADDED_AT_ONCE:
        return [np.arange(frames)]
    blocks = []
    kinds = np.unique(np.ceil(np.log2(sizes)).astype(np.int64), axis=1, return_inverse=True)
    for kind, (wide, deep, choices) in enumerate((2 ** kinds[0].T).tolist()):
        chosen = np.flatnonzero(kinds[1].reshape(-1) == kind)
        step = max(_PADDED_AT_ONCE // max(SAMPLES * wide, deep * choices), 1)
        blocks += [chosen[start : start + step] for start in range(0, len(chosen), step)]
    return blocks


def _by_group(counts: Float[np.ndarray, "t f"], data: KittiFrames) -> Float[np.ndarray, "t g"]:
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
    block: Int[np.ndarray, " f"],
) -> Candidates:
    """Pad what one part, measure and difficulty needs by frame, of some frames in rising order."""
    frames, row_of = len(block), np.full(len(data.group), -1)
    row_of[block] = np.arange(frames)
    predicted_in = predicted_in & (row_of[data.predicted_frame] >= 0)
    annotated_in = annotated_in & (row_of[data.annotated_frame] >= 0)
    must_find = must_find & annotated_in
    predicted_frame, annotated_frame = row_of[data.predicted_frame], row_of[data.annotated_frame]
    column, width = places_of_rows(predicted_frame, predicted_in, frames)
    slot, depth = places_of_rows(annotated_frame, annotated_in, frames)
    pairs = np.flatnonzero(enough & annotated_in[data.pair[:, 0]] & predicted_in[data.pair[:, 1]])
    box, detection = data.pair[pairs].T
    nth, choices = places_of_rows(box, np.ones(len(box), dtype=bool), len(data.annotated))
    choice = np.full((frames, depth, choices), -1)
    overlap, similarity = np.zeros(choice.shape), np.zeros(choice.shape)
    choice[annotated_frame[box], slot[box], nth] = column[detection]
    overlap[annotated_frame[box], slot[box], nth] = data.overlap[measure][pairs]
    similarity[annotated_frame[box], slot[box], nth] = data.similarity[pairs]
    counts = np.zeros((frames, depth), dtype=np.int64)
    counts[annotated_frame[must_find], slot[must_find]] = 1
    padded = {}
    score = np.zeros(0) if data.predicted.score is None else data.predicted.score
    for name, values, empty in (
        ("score", score, -np.inf),
        ("small", small, False),
        ("harmless", data.harmless[measure], False),
    ):
        padded[name] = np.full((frames, width), empty)
        padded[name][predicted_frame[predicted_in], column[predicted_in]] = values[predicted_in]
    return Candidates(choice=choice, overlap=overlap, similarity=similarity, counts=counts, **padded)
