"""Waymo's AP and APH (Sun et al., CVPR 2020) and LET-3D-AP, -APH, -APL (Hung et al., 2022), by class, level and range.

    1. gather       boxes of the classes in all frames; annotated boxes without points are left out, those of few points
                    are of level 2
    2. match        at 101 score cut-offs the pairs of enough 3D IoU with the largest sum of IoU, see
                    :mod:`farfield.metrics.waymo.matching`
    3. count        at each cut-off c:  recall_L = TP / (TP + FN_L),  precision = sum of q over matches / (TP + FP)

A match counts at both levels whatever the level of its box, a box that is not found (FN) only at its own level and the
harder one. q is 1 for AP, 1 - |heading error| / pi for APH, the longitudinal affinity for APL.

    4. average      the area below precision over recall: at falling recalls the best precision so far, repeated every
                    0.05 where recall leaps by more, joined by straight lines, and level down to recall 0

Longitudinal error tolerant (LET): a prediction P is first moved along its line of sight to where it is nearest to the
annotated centre G, P' = (G.P / |P|^2) P, both seen from the sensor; IoU is that of the moved box, and a pair is worth
IoU times its affinity a = 1 - min(| |P| cos(angle) - |G| | / max(0.1 |G|, 0.5 m), 1), which must be above 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.geometry.iou import paired_iou
from farfield.metrics.bootstrap import Draws, Weighted, point_and_intervals
from farfield.metrics.curves import TabledCurve
from farfield.metrics.frames import BoxesByFrame, near_pairs
from farfield.metrics.kitti.evaluation import Details, detail_column
from farfield.metrics.result import Result, table
from farfield.metrics.several_classes import ClassFrames, gather_classes
from farfield.metrics.waymo.matching import CutoffMatches, match_at_cutoffs
from farfield.metrics.waymo.settings import WaymoLetSettings, WaymoSettings

LEVEL, NO_LABEL_ZONE = "detection_level", "no_label_zone"
_MILLIONTHS = np.float32(1_000_000)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class WaymoResult(Result):
    """Waymo's figures in [0, 1] by class, level and range; the table shows per cent."""

    def __str__(self) -> str:
        parts = ["overall", *self.ranges]
        shown = [label for label in self.settings["classes"] if self.counts["classes"][label]["annotated"]]
        rows = [
            [name.removeprefix("ap/").replace("/", " "), *(self.cell(part, name, scale=100.0) for part in parts)]
            for name in self.figures
            if name.split("/")[1] in shown
        ]
        for label in shown:
            for side in ("annotated", "predictions"):
                counts = [self.counts["classes"], *(part["classes"] for part in self.counts["ranges"].values())]
                rows.append([f"{label} {side}", *(str(count[label][side]) for count in counts)])
        title = f"{self.protocol}: figures in per cent, by range in metres; '-': nothing annotated"
        return f"{title}\n\n{table(['', *parts], rows)}\n\n{self.footer()}"


# Step 1: gather


@dataclass(frozen=True, eq=False, kw_only=True)
class WaymoFrames:
    """Boxes of all frames with what Waymo's metrics take of them, and the pairs that may match.

    Args:
        frames: Boxes of the classes.
        level: Level of each annotated box, 1 or 2, shape (m,).
        excused: Predictions in a zone without labels, which are never false, shape (n,).
        pair: Rows of annotated and predicted boxes that overlap, shape (p, 2).
        iou: Their overlap, shape (p,).
        affinity: What the match is worth beside, 1 unless LET, shape (p,).
        without_points: Annotated boxes that were left out since they hold no point.
        level_unknown: Annotated boxes taken for level 1 since neither a level nor points are known.
    """

    frames: ClassFrames
    level: Int[np.ndarray, " m"]
    excused: Bool[np.ndarray, " n"]
    pair: Int[np.ndarray, "p 2"]
    iou: Float[np.ndarray, " p"]
    affinity: Float[np.ndarray, " p"]
    without_points: int
    level_unknown: int


def gather_waymo(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: WaymoSettings,
    *,
    prediction_details: Details | None = None,
    annotation_details: Details | None = None,
    drives: Sequence[Drive] = (),
) -> WaymoFrames:
    """Collect the classes from all frames; the arguments are those of :func:`evaluate_waymo`."""
    frames = gather_classes(predictions, annotations, settings.classes, settings.relabel, drives)
    score = frames.predicted.score
    if len(score) and (score.min() < 0 or score.max() > 1):
        raise ConfigError(
            "predictions: expected scores from 0 to 1, since Waymo's metrics cut them at 0, 0.01 ... 1; got "
            f"{score.min():g} to {score.max():g}. Turn them into probabilities first"
        )
    annotated, count = frames.annotated, frames.annotated.boxes.point_count
    points = np.full(len(annotated), -1) if count is None else count
    stated = _column(annotation_details or {}, frames, annotations, LEVEL, annotated.origin)
    zone = _column(prediction_details or {}, frames, predictions, NO_LABEL_ZONE, frames.predicted.origin)
    level = np.where((points >= 0) & (points <= settings.hard_points), 2, 1)
    level = level if stated is None else np.where(np.isin(stated, (1, 2)), stated.astype(np.int64), level)
    unknown = (points < 0) & (True if stated is None else ~np.isin(stated, (1, 2)))
    held = points != 0
    frames = ClassFrames(**{**vars(frames), "annotated": annotated[held]})
    pair, iou, affinity = _pairs(frames, settings)
    return WaymoFrames(
        frames=frames,
        level=level[held],
        excused=np.zeros(len(frames.predicted), dtype=bool) if zone is None else zone > 0,
        pair=pair,
        iou=iou,
        affinity=affinity,
        without_points=int((~held).sum()),
        level_unknown=int(unknown.sum()),
    )


def _column(
    details: Details, frames: ClassFrames, boxes: BoxesByFrame, name: str, origin: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"] | None:
    """A detail of the rows; None where no frame has it."""
    parts = [boxes.get(key, Boxes.empty()) for key in frames.keys]
    column = detail_column(details, frames.keys, parts, name, 1)
    return None if column is None else column[origin, 0]


def _pairs(
    frames: ClassFrames, settings: WaymoSettings
) -> tuple[Int[np.ndarray, "p 2"], Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Pairs of a frame and class that may overlap, with IoU and affinity."""
    classes = len(settings.classes)
    annotated, predicted = frames.annotated, frames.predicted
    gap = partial(_nearness, annotated.boxes, predicted.boxes, settings)
    owners = max(len(frames.keys) * classes, 1)
    pair, _ = near_pairs(
        annotated.owner(classes), predicted.owner(classes), owners, gap, lambda owner: frames.keys[owner // classes]
    )
    boxes = annotated.boxes[pair[:, 0]]
    aligned, affinity = aligned_boxes(boxes, predicted.boxes[pair[:, 1]], settings)
    return pair, paired_iou(boxes, aligned, kind="3d"), affinity


def _nearness(
    annotated: Boxes, predicted: Boxes, settings: WaymoSettings, pair: Int[np.ndarray, "p 2"]
) -> Float[np.ndarray, " p"]:
    """By how much the circumscribed circles of each pair meet, squared metres; less than 0 without affinity."""
    boxes, detections = annotated[pair[:, 0]], predicted[pair[:, 1]]
    detections, affinity = aligned_boxes(boxes, detections, settings)
    gap = boxes.centre_m[:, :2] - detections.centre_m[:, :2]
    radius_m = (np.hypot(*boxes.size_m[:, :2].T) + np.hypot(*detections.size_m[:, :2].T)) / 2
    return np.where(affinity > 0, radius_m**2 - (gap**2).sum(axis=1), -1.0)


def aligned_boxes(annotated: Boxes, predicted: Boxes, settings: WaymoSettings) -> tuple[Boxes, Float[np.ndarray, " p"]]:
    """Predictions as they are compared with annotated boxes, and the affinity of each pair.

    Args:
        annotated: p annotated boxes.
        predicted: The predicted box of each.
        settings: Those of LET move predictions along the line of sight; others leave them, with an affinity of 1.
    """
    if not isinstance(settings, WaymoLetSettings) or not len(annotated):
        return predicted, np.ones(len(annotated))
    sensor_m = np.array(settings.sensor_m)
    box_m, seen_m = annotated.centre_m - sensor_m, predicted.centre_m - sensor_m
    dot = (box_m * seen_m).sum(axis=1)
    box_range_m = np.maximum(np.linalg.norm(box_m, axis=1), 1e-9)
    seen_range_m = np.maximum(np.linalg.norm(seen_m, axis=1), 1e-9)
    tolerance_m = np.maximum(settings.tolerance * box_range_m, settings.least_tolerance_m)
    error_m = np.abs(dot / box_range_m - box_range_m)  # the prediction's range along the annotated line of sight
    moved = predicted.replace(centre_m=seen_m * (dot / seen_range_m**2)[:, None] + sensor_m)
    return moved, np.clip(1.0 - error_m / tolerance_m, 0.0, 1.0)


# Steps 2 and 3: match and count


@dataclass(frozen=True, eq=False, kw_only=True)
class CutoffCounts:
    """Matches, false boxes and missed boxes at each cut-off by group.

    Args:
        true: Matches, shape (groups, cutoffs).
        false: Predictions that are false, shape (groups, cutoffs).
        missed: Annotated boxes that are not found, by level, each of shape (groups, cutoffs).
        worth: Sums over the matches by figure (``"ap"``, ``"aph"``, ``"apl"``), each of shape (groups, cutoffs).
        annotated: Annotated boxes by level, each of shape (groups,).
        recall_step: See :class:`WaymoSettings`.
    """

    true: Float[np.ndarray, "g c"]
    false: Float[np.ndarray, "g c"]
    missed: dict[int, Float[np.ndarray, "g c"]]
    worth: dict[str, Float[np.ndarray, "g c"]]
    annotated: dict[int, Float[np.ndarray, " g"]]
    recall_step: float

    def curve(
        self, weights: Float[np.ndarray, "r g"], level: int, figure: str
    ) -> tuple[Float[np.ndarray, "r c"], Float[np.ndarray, "r c"]]:
        """Recall and precision at each cut-off under rows of group weights."""
        true, false, missed = weights @ self.true, weights @ self.false, weights @ self.missed[level]
        positive, to_find = true + false, true + missed
        worth = weights @ self.worth[figure]
        recall = np.divide(true, to_find, out=np.zeros_like(true), where=to_find > 0)
        return recall, np.divide(worth, positive, out=np.zeros_like(true), where=positive > 0)

    def averages(self, weights: Float[np.ndarray, "r g"], level: int, figure: str) -> Float[np.ndarray, " r"]:
        """The figure under rows of group weights; NaN where nothing is annotated."""
        area = area_below(*self.curve(weights, level, figure), self.recall_step)
        return np.where(weights @ self.annotated[level] > 0, area, np.nan)


def area_below(
    recall: Float[np.ndarray, "r c"], precision: Float[np.ndarray, "r c"], step: float
) -> Float[np.ndarray, " r"]:
    """Area below each curve as Waymo's tools take it, shape (r,).

    Args:
        recall: Recalls in any order.
        precision: The precision at each.
        step: Gaps of recall above it are filled with points of the better precision, this far apart.
    """
    order = np.lexsort((-precision, -recall), axis=1)
    recall = np.take_along_axis(recall, order, axis=1)
    precision = np.where(recall > 0, np.take_along_axis(precision, order, axis=1), 0.0)
    recall = np.concatenate([recall, np.zeros((len(recall), 1))], axis=1)
    best = np.maximum.accumulate(np.concatenate([precision, np.zeros((len(recall), 1))], axis=1), axis=1)
    gap = recall[:, :-1] - recall[:, 1:]
    level = np.maximum(np.ceil((gap - step - 1e-6) / step), 0.0) * step
    areas = best[:, :-1] * level + 0.5 * (gap - level) * (best[:, :-1] + best[:, 1:])
    return np.asarray(areas.sum(axis=1))


@dataclass(frozen=True, eq=False, kw_only=True)
class PassedFrames:
    """What the counts of every part share.

    Args:
        data: The frames.
        passed: How many cut-offs each prediction passes, from the lowest on, shape (n,).
        weight: What each pair is worth to the matching, in millionths; 0 where it may not match, shape (p,).
        heading: Heading accuracy of each pair, shape (p,).
    """

    data: WaymoFrames
    passed: Int[np.ndarray, " n"]
    weight: Int[np.ndarray, " p"]
    heading: Float[np.ndarray, " p"]


def prepare(data: WaymoFrames, settings: WaymoSettings) -> PassedFrames:
    """Quantise scores and overlaps as Waymo's tools do, in single precision."""
    annotated, predicted = data.frames.annotated, data.frames.predicted
    score: Float32[np.ndarray, " n"] = predicted.score.astype(np.float32)
    iou, affinity = data.iou.astype(np.float32), data.affinity.astype(np.float32)
    box, detection = data.pair.T
    enough = (iou >= settings.least_iou[annotated.kind[box]]) & (affinity > 0)
    weight = np.rint(iou * affinity * _MILLIONTHS).astype(np.int64)
    turned = np.abs(wrap_angle_rad(predicted.boxes.yaw_rad[detection] - annotated.boxes.yaw_rad[box]))
    return PassedFrames(
        data=data,
        passed=np.searchsorted(settings.cutoff_scores, score, side="right"),
        weight=np.where(enough, weight, 0),
        heading=np.clip(1.0 - turned / np.pi, 0.0, 1.0),
    )


def count_part(
    prepared: PassedFrames,
    settings: WaymoSettings,
    kind: int,
    annotated_in: Bool[np.ndarray, " m"],
    predicted_in: Bool[np.ndarray, " n"],
) -> CutoffCounts:
    """Match one class among the marked boxes, and count at every cut-off."""
    data, frames = prepared.data, prepared.data.frames
    annotated_in = annotated_in & (frames.annotated.kind == kind)
    predicted_in = predicted_in & (frames.predicted.kind == kind)
    box, detection = data.pair.T
    pairs = np.flatnonzero((prepared.weight > 0) & annotated_in[box] & predicted_in[detection])
    box, detection = box[pairs], detection[pairs]
    matched = match_at_cutoffs(box, detection, prepared.weight[pairs], prepared.passed[detection])
    sums = partial(_sums, frames.group, (frames.groups, settings.cutoffs), matched, frames.annotated.frame[box])
    present = _below(frames, predicted_in & ~data.excused, prepared.passed, settings.cutoffs)
    true = sums(np.ones(len(pairs)))
    annotated, missed = {}, {}
    for level in settings.levels:
        own = annotated_in & (data.level <= level)
        group = frames.group[frames.annotated.frame[own]]
        annotated[level] = np.bincount(group, minlength=frames.groups).astype(np.float64)
        missed[level] = annotated[level][:, None] - sums((data.level[box] <= level).astype(np.float64))
    worth = {"ap": true, "aph": sums(prepared.heading[pairs])}
    if isinstance(settings, WaymoLetSettings):
        worth["apl"] = sums(data.affinity[pairs])
    return CutoffCounts(
        true=true,
        false=present - sums((~data.excused[detection]).astype(np.float64)),
        missed=missed,
        worth=worth,
        annotated=annotated,
        recall_step=settings.recall_step,
    )


def _sums(
    group: Int[np.ndarray, " f"],
    shape: tuple[int, int],
    matched: CutoffMatches,
    frame: Int[np.ndarray, " q"],
    value: Float[np.ndarray, " q"],
) -> Float[np.ndarray, "g c"]:
    """Sums of a value of each pair over the matches at each cut-off, by group."""
    groups, cutoffs = shape
    row = group[frame[matched.pair]] * (cutoffs + 1)
    size, values = groups * (cutoffs + 1), value[matched.pair]
    steps = np.bincount(row + matched.first, weights=values, minlength=size).astype(np.float64)
    steps -= np.bincount(row + matched.last, weights=values, minlength=size)
    return steps.reshape(groups, cutoffs + 1)[:, :-1].cumsum(axis=1)


def _below(
    frames: ClassFrames, counted: Bool[np.ndarray, " n"], passed: Int[np.ndarray, " n"], cutoffs: int
) -> Float[np.ndarray, "g c"]:
    """Marked predictions at each cut-off, by group."""
    cell = frames.group[frames.predicted.frame[counted]] * (cutoffs + 1) + passed[counted]
    counts = np.bincount(cell, minlength=frames.groups * (cutoffs + 1)).reshape(frames.groups, cutoffs + 1)
    return counts[:, ::-1].cumsum(axis=1)[:, ::-1][:, 1:].astype(np.float64)


_PartCounts = dict[str, CutoffCounts]  # by class


def count_parts(data: WaymoFrames, settings: WaymoSettings) -> dict[str, _PartCounts]:
    """Counts by part (``"overall"``, ``"0-30"``...) and class."""
    prepared, annotated, predicted = prepare(data, settings), data.frames.annotated, data.frames.predicted
    inside = {"overall": (np.ones(len(annotated), dtype=bool), np.ones(len(predicted), dtype=bool))}
    for low_m, high_m in settings.bins_m:
        rows = [(side.range_m >= low_m) & (side.range_m < high_m) for side in (annotated, predicted)]
        inside[f"{low_m:g}-{high_m:g}"] = (rows[0], rows[1])
    return {
        part: {name: count_part(prepared, settings, kind, *masks) for kind, name in enumerate(settings.classes)}
        for part, masks in inside.items()
    }


# Step 4: average


def figures_of(counted: _PartCounts, settings: WaymoSettings, weights: Float[np.ndarray, "r g"]) -> Draws:
    """The figures of one part by class, level and kind under rows of group weights."""
    return {
        f"ap/{label}/level_{level}/{figure}": counts.averages(weights, level, figure)
        for label, counts in counted.items()
        for level in settings.levels
        for figure in counts.worth
    }


def _part_figures(
    parts: Mapping[str, _PartCounts], settings: WaymoSettings, weights: Float[np.ndarray, "r g"]
) -> dict[str, Draws]:
    return {part: figures_of(counted, settings, weights) for part, counted in parts.items()}


def evaluate_waymo(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: WaymoSettings | None = None,
    *,
    prediction_details: Details | None = None,
    annotation_details: Details | None = None,
    drives: Sequence[Drive] = (),
) -> WaymoResult:
    """Score predictions with Waymo's metrics; the LET metrics with :class:`WaymoLetSettings`.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes those of Waymo's tool.
        prediction_details: By frame, in the order of its boxes: ``no_label_zone`` (n,), not 0 where a box overlaps a
            zone without labels and so is never false.
        annotation_details: Likewise ``detection_level`` (n,): 1, 2, or 0 where the number of points decides.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.

    Returns:
        Figures in [0, 1] named ``ap/vehicle/level_1/ap``, ``ap/vehicle/level_2/aph``...

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, lack scores or have some beyond 0 to 1.
    """
    settings = settings or WaymoSettings()
    details = {"prediction_details": prediction_details, "annotation_details": annotation_details}
    data = gather_waymo(predictions, annotations, settings, drives=drives, **details)
    return waymo_result(data, settings, len(annotations))


def waymo_result(data: WaymoFrames, settings: WaymoSettings, frames_given: int) -> WaymoResult:
    """The result of frames that were gathered."""
    frames, parts = data.frames, count_parts(data, settings)
    figures, intervals = point_and_intervals(partial(_part_figures, parts, settings), frames.groups, settings.bootstrap)
    boxes = {part: _box_counts(data, settings, part, counted) for part, counted in parts.items()}
    used = np.union1d(frames.predicted.frame, frames.annotated.frame)
    return WaymoResult(
        protocol="waymo-let" if isinstance(settings, WaymoLetSettings) else "waymo",
        label=settings.label,
        settings=settings.to_json(),
        figures=figures.pop("overall"),
        ranges=figures,
        counts={
            "frames": len(used),
            "frames_given": frames_given,
            **boxes.pop("overall"),
            "annotated_without_points": data.without_points,
            "annotated_of_other_classes": frames.other_annotated,
            "predictions_of_other_classes": frames.other_predicted,
            "predictions_in_no_label_zones": int(data.excused.sum()),
            "ranges": boxes,
        },
        intervals=intervals,
        grouped_by=frames.grouped_by,
        curves={"overall": _curves(parts["overall"], settings)},
        notes=tuple(_notes(data)),
    )


def _box_counts(data: WaymoFrames, settings: WaymoSettings, part: str, counted: _PartCounts) -> dict[str, Any]:
    predicted = data.frames.predicted
    inside = np.ones(len(predicted), dtype=bool)
    if part != "overall":
        low_m, high_m = map(float, part.split("-", 1))
        inside = (predicted.range_m >= low_m) & (predicted.range_m < high_m)
    classes = {
        label: {
            **{f"annotated_level_{level}": int(counts.annotated[level].sum()) for level in settings.levels},
            "annotated": int(counts.annotated[2].sum()),
            "predictions": int((inside & (predicted.kind == kind)).sum()),
        }
        for kind, (label, counts) in enumerate(counted.items())
    }
    sums = {name: sum(counts[name] for counts in classes.values()) for name in ("annotated", "predictions")}
    return {**sums, "classes": classes}


def _curves(counted: _PartCounts, settings: WaymoSettings) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for label, counts in counted.items():
        ones = np.ones((1, len(counts.annotated[2])))
        tree[label] = {}
        for level in settings.levels:
            recall, precision = counts.curve(ones, level, "ap")
            curve = TabledCurve(
                recall=recall[0], precision=precision[0], confidence=settings.cutoff_scores.astype(float)
            )
            tree[label][f"level_{level}"] = curve if counts.annotated[level].sum() else None
    return tree


def _notes(data: WaymoFrames) -> list[str]:
    frames, notes = data.frames, []
    if data.without_points:
        notes.append(f"{data.without_points} annotated boxes hold no point and are left out")
    if data.level_unknown:
        notes.append(
            f"{data.level_unknown} annotated boxes have neither a level nor a number of points: they count as level 1"
        )
    if frames.other_annotated or frames.other_predicted:
        notes.append(
            f"{frames.other_annotated} annotated and {frames.other_predicted} predicted boxes are of classes that are "
            "not scored"
        )
    return notes


def weighted_waymo(data: WaymoFrames, settings: WaymoSettings) -> Weighted:
    """The figures as functions of group weights."""
    figures = {part: partial(figures_of, counted, settings) for part, counted in count_parts(data, settings).items()}
    return Weighted(parts=figures, groups=tuple(data.frames.group.tolist()), grouped_by=data.frames.grouped_by)
