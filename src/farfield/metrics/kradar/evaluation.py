"""K-Radar's average precision (Paek et al., NeurIPS 2022): AP3D and AP_BEV by class, overlap and condition.

A prediction matches an annotated box of its class whose exact rotated IoU with it exceeds 0.3, 0.5 or 0.7:

    IoU(a, b) = |a and b| / |a or b|,   in the x-y plane ("bev") or in space ("3d")

The measure is KITTI's: annotated boxes choose predictions (:mod:`farfield.metrics.kradar.matching`), precision is
sampled at 41 recalls and averaged (:mod:`farfield.metrics.recall_sampling`). Protocol ``kradar`` takes boxes as they
stand, the mean over 40 recalls, and every frame; the ``kradar-compat`` variants repeat what K-Radar's development kit
computes, see :mod:`farfield.metrics.kradar.settings`. Figures lie in [0, 1], the table shows per cent.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.frame.drive import Drive, Key
from farfield.metrics.bootstrap import Draws, Statistics, Weighted, point_and_intervals
from farfield.metrics.frames import BoxesByFrame
from farfield.metrics.kradar.conditions import group_conditions
from farfield.metrics.kradar.frames import KRadarFrames, Visibility, gather_kradar
from farfield.metrics.kradar.matching import OverlapGains, gains
from farfield.metrics.kradar.settings import KRadarSettings
from farfield.metrics.recall_sampling import ThresholdCounts, sample_thresholds
from farfield.metrics.result import Result, nest, table
from farfield.vocabulary.conditions import CONDITIONS, condition_name
from farfield.vocabulary.counts import count_of

MEASURES = ("3d", "bev")
_VISIBILITY = {"R": "seen by the radar", "L": "seen by the LiDAR alone", "L1": "visibility not known"}
_ClassCounts = dict[tuple[str, float], ThresholdCounts]  # by measure and overlap
_PartCounts = dict[str, _ClassCounts]  # by class
Conditions = Mapping[Key, Mapping[str, str]]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class KRadarResult(Result):
    """AP by class, measure and overlap: overall, by range, condition and visibility.

    Args:
        conditions: Figures by kind of condition (``weather``, ``road``, ``time``) and value.
        visibility: Figures of the boxes that the radar sees (``R``), the LiDAR alone (``L``), not known (``L1``); the
            others may then be found or not.
    """

    conditions: Mapping[str, Mapping[str, Statistics]] = field(default_factory=dict)
    visibility: Mapping[str, Statistics] = field(default_factory=dict)

    def __str__(self) -> str:
        tables = "\n\n".join(self._table(label) for label in self.settings["classes"])
        cut = self.counts["predictions_cut"]
        note = f"{count_of(cut, 'prediction')} at or below the score cut are left out" if cut else ""
        frames = f"{self.counts['frames']} of {count_of(self.counts['frames_given'], 'frame')} count"
        return f"{tables}\n\n{frames}; {note or 'no prediction is cut'}\n{self.footer()}"

    def to_json(self) -> dict[str, Any]:
        """The result as JSON values, see :meth:`Result.to_json`; with ``conditions`` and ``visibility``."""
        tree = super().to_json()
        tree["conditions"] = {
            kind: {value: _nest_or_none(part) for value, part in parts.items()}
            for kind, parts in self.conditions.items()
        }
        tree["visibility"] = {name: _nest_or_none(part) for name, part in self.visibility.items()}
        return tree

    def parts(self) -> Iterator[tuple[str, str, Statistics, Mapping[str, Any]]]:
        """Name, title, figures and counts of the whole and of every subset."""
        yield "overall", "all", self.figures, self.counts
        for name, part in self.ranges.items():
            yield name, f"{name} m", part, self.counts["ranges"][name]
        for kind, values in self.conditions.items():
            for value, part in values.items():
                yield f"{kind}/{value}", f"{kind}: {value}", part, self.counts["conditions"][kind][value]
        for name, part in self.visibility.items():
            yield f"visibility/{name}", _VISIBILITY.get(name, name), part, self.counts["visibility"][name]

    def _table(self, label: str) -> str:
        names = [(measure, f"{iou:g}") for measure in MEASURES for iou in self.settings["ious"]]
        rows = []
        for part, title, figures, counted in self.parts():
            values = [figures.get(f"ap/{label}/{measure}/{iou}") for measure, iou in names]
            cells = ["-" if value is None else f"{100 * value:.2f}" for value in values]
            rows.append([title, *cells, *(str(counted["classes"][label][n]) for n in ("annotated", "predictions"))])
            drawn = [self.intervals.get(part, {}).get(f"ap/{label}/{measure}/{iou}") for measure, iou in names]
            if part == "overall" and any(drawn):
                spans = [f"{100 * d[0]:.1f}-{100 * d[1]:.1f}" if d else "-" for d in drawn]
                rows.append(["  [low, high]", *spans, "", ""])
        head = ["", *(f"{measure.upper()} {iou}" for measure, iou in names), "annotated", "predicted"]
        return f"{self.protocol}: AP of {label!r} in per cent; '-': nothing annotated\n\n{table(head, rows)}"


def evaluate_kradar(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KRadarSettings | None = None,
    *,
    conditions: Conditions | None = None,
    visibility: Visibility | None = None,
    protocol: str = "kradar",
    drives: Sequence[Drive] = (),
) -> KRadarResult:
    """Score predictions with K-Radar's average precision.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes those of ``kradar``. Variants: :func:`kradar_settings`.
        conditions: ``weather``, ``road`` and ``time`` of each frame. Every subset is then scored by itself.
        visibility: ``R``, ``L`` or ``L1`` of each annotated box of a frame, in the order of its boxes.
        protocol: What the result is to be called.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.

    Returns:
        Figures in [0, 1] named ``ap/vehicle/3d/0.3``, ``ap/vehicle/bev/0.5``...

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, lack scores, or the visibility does not fit.
    """
    settings = settings or KRadarSettings()
    # 1. Gather the boxes of the classes in the region, with the overlap of each pair of a frame.
    data = gather_kradar(predictions, annotations, settings, visibility, drives)
    # 2. Match, and count true and false positives at the thresholds of 41 recalls, in all frames and in each subset.
    is_drawn = settings.bootstrap.replicates > 0
    tally = _count_parts(data, settings, conditions or {}, with_visibility=visibility is not None, by_group=is_drawn)
    # 3. Average precision over recalls, for weights of 1 (the figures) and for draws of the drives (the intervals).
    figures, intervals = point_and_intervals(
        partial(_part_figures, tally.parts, settings), tally.groups, settings.bootstrap
    )
    ranges = {f"{low:g}-{high:g}": figures.pop(f"{low:g}-{high:g}") for low, high in settings.bins_m}
    by_kind: dict[str, dict[str, Statistics]] = {}
    for part in figures:
        kind, _, value = part.partition("/")
        if value:
            by_kind.setdefault(kind, {})[value] = figures[part]
    by_visibility = by_kind.pop("visibility", {})
    return KRadarResult(
        protocol=protocol,
        label=settings.label,
        settings=settings.to_json(),
        convention=settings.convention(),
        figures=figures["overall"],
        ranges=ranges,
        conditions=by_kind,
        visibility=by_visibility,
        counts=_nested(tally.counts, len(annotations), data.cut),
        intervals=intervals if is_drawn else {},
        grouped_by=data.grouped_by,
        curves={"overall": _curves(tally.parts["overall"])},
    )


def weighted_kradar(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KRadarSettings,
    *,
    conditions: Conditions | None = None,
    visibility: Visibility | None = None,
    drives: Sequence[Drive] = (),
) -> Weighted:
    """The figures as functions of group weights; the arguments are those of :func:`evaluate_kradar`."""
    data = gather_kradar(predictions, annotations, settings, visibility, drives)
    with_visibility = visibility is not None
    tally = _count_parts(data, settings, conditions or {}, with_visibility=with_visibility, by_group=True)
    figures = {part: partial(_figures, counted, settings) for part, counted in tally.parts.items()}
    return Weighted(parts=figures, groups=tuple(data.group.tolist()), grouped_by=data.grouped_by)


# Step 2: match and count


def _count_parts(
    data: KRadarFrames, settings: KRadarSettings, conditions: Conditions, *, with_visibility: bool, by_group: bool
) -> "_ThresholdTally":
    """Counts at thresholds by part and class, and the numbers of frames and boxes by part."""
    tally = _ThresholdTally(data, by_group=by_group)
    subsets = list(_subsets(data, conditions))
    for kind, label in enumerate(settings.classes):
        matches = match(data, settings, kind)
        tally.add("overall", label, matches)
        for part, frames in subsets:
            tally.add(part, label, matches, frames)
        for low_m, high_m in settings.bins_m:
            masks = {
                name: (boxes.range_m >= low_m) & (boxes.range_m < high_m)
                for name, boxes in (("predicted_in", data.predicted), ("annotated_in", data.annotated))
            }
            tally.add(f"{low_m:g}-{high_m:g}", label, match(data, settings, kind, **masks))
        for name in _VISIBILITY if with_visibility else ():
            others = data.annotated.seen_by != name
            tally.add(f"visibility/{name}", label, match(data, settings, kind, optional=others))
    return tally


class _ThresholdTally:
    """Counts at thresholds by part and class, and the numbers of frames and boxes by part.

    Args:
        data: All frames.
        by_group: Whether counts are kept by group, as draws of groups need them.
    """

    def __init__(self, data: KRadarFrames, *, by_group: bool) -> None:
        self.data = data
        self.group = data.group if by_group else np.zeros(len(data.keys), dtype=np.int64)
        self.groups = data.groups if by_group else 1
        self.parts: dict[str, _PartCounts] = {}
        self.counts: dict[str, dict[str, Any]] = {}

    def add(self, part: str, label: str, matched: "ClassMatches", inside: Bool[np.ndarray, " f"] | None = None) -> None:
        """Count one class in one part: in all frames, or in those marked."""
        self.parts.setdefault(part, {})[label] = count(matched, inside, self.group, self.groups)
        counted = self.data.counted if inside is None else self.data.counted & inside
        here = self.counts.setdefault(part, {"frames": int(counted.sum()), "classes": {}})
        there = [matched.annotated_frame, matched.frame]
        sums = [len(frame) if inside is None else int(inside[frame].sum()) for frame in there]
        here["classes"][label] = dict(zip(("annotated", "predictions"), sums, strict=True))


def _subsets(data: KRadarFrames, conditions: Conditions) -> Iterator[tuple[str, Bool[np.ndarray, " f"]]]:
    """Frames of each condition of which anything is known."""
    for kind in CONDITIONS:
        if not any(kind in values for values in conditions.values()):
            continue
        stated = [condition_name(conditions.get(key, {}).get(kind, "")) for key in data.keys]
        values = np.array(stated, dtype=np.str_)
        for value in group_conditions(conditions, kind):
            yield f"{kind}/{value}", values == value


@dataclass(frozen=True, eq=False, kw_only=True)
class ClassMatches:
    """One class, matched at every overlap; the predictions stand in the order of falling scores.

    Args:
        score: Scores of the n predictions, falling.
        frame: Frames of the predictions, shape (n,).
        annotated_frame: Frames of the annotated boxes that must be found, shape (m,).
        gains: What each prediction adds, by measure and overlap.
    """

    score: Float[np.ndarray, " n"]
    frame: Int[np.ndarray, " n"]
    annotated_frame: Int[np.ndarray, " m"]
    gains: dict[tuple[str, float], OverlapGains]


def match(
    data: KRadarFrames,
    settings: KRadarSettings,
    kind: int,
    *,
    predicted_in: Bool[np.ndarray, " n"] | None = None,
    annotated_in: Bool[np.ndarray, " m"] | None = None,
    optional: Bool[np.ndarray, " m"] | None = None,
) -> ClassMatches:
    """Match the boxes of one class, or those of them that lie in a range bin.

    Args:
        data: All frames.
        settings: The options.
        kind: Place of the class among the settings' classes.
        predicted_in: Predictions that take part; None: all.
        annotated_in: Annotated boxes that take part; None: all.
        optional: Annotated boxes that may be found or not; None: none.
    """
    here = data.predicted.kind == kind if predicted_in is None else (data.predicted.kind == kind) & predicted_in
    there = data.annotated.kind == kind if annotated_in is None else (data.annotated.kind == kind) & annotated_in
    predictions, boxes = np.flatnonzero(here), np.flatnonzero(there)
    predictions = predictions[np.argsort(-data.predicted.score[predictions], kind="stable")]
    rank, row = np.full(len(data.predicted), -1), np.full(len(data.annotated), -1)
    rank[predictions], row[boxes] = np.arange(len(predictions)), np.arange(len(boxes))
    pairs = np.flatnonzero(here[data.pair[:, 1]] & there[data.pair[:, 0]])
    box, detection = row[data.pair[pairs, 0]], rank[data.pair[pairs, 1]]
    may = np.zeros(len(boxes), dtype=bool) if optional is None else optional[boxes]
    frame, score = data.annotated.frame[boxes], data.predicted.score[predictions]
    gains_of: dict[tuple[str, float], OverlapGains] = {}
    for measure in MEASURES:
        overlap = data.overlap[measure][pairs]
        for iou in settings.ious:
            enough = overlap > iou
            gains_of[measure, iou] = gains(
                box[enough],
                detection[enough],
                overlap[enough],
                frame=frame,
                optional=may,
                score=score,
                order=predictions,
            )
    return ClassMatches(
        score=score, frame=data.predicted.frame[predictions], annotated_frame=frame[~may], gains=gains_of
    )


def count(
    matched: ClassMatches, inside: Bool[np.ndarray, " f"] | None, group: Int[np.ndarray, " f"], groups: int
) -> dict[tuple[str, float], ThresholdCounts]:
    """True and false positives of a set of frames at its own thresholds, by measure and overlap.

    Args:
        matched: The matched class.
        inside: Which frames count; None: all.
        group: Resampling group of each frame.
        groups: Number of groups.
    """
    if inside is None:
        rows, boxes = np.arange(len(matched.frame)), matched.annotated_frame
    else:
        rows, boxes = np.flatnonzero(inside[matched.frame]), matched.annotated_frame[inside[matched.annotated_frame]]
    score, owner = matched.score[rows], group[matched.frame[rows]]
    annotated = np.bincount(group[boxes], minlength=groups)
    return {name: _count(gain, rows, score, owner, annotated) for name, gain in matched.gains.items()}


def _count(
    gain: OverlapGains,
    rows: Int[np.ndarray, " r"],
    score: Float[np.ndarray, " r"],
    owner: Int[np.ndarray, " r"],
    annotated: Int[np.ndarray, " g"],
) -> ThresholdCounts:
    total, groups = int(annotated.sum()), len(annotated)
    thresholds, recalls = sample_thresholds(score[gain.is_true[rows]], total) if total else ([], [])
    reached = np.searchsorted(-score, -np.array(thresholds, dtype=np.float64), side="right")
    step = np.repeat(np.arange(len(thresholds) + 1), np.diff(reached, prepend=0, append=len(rows)))
    cell, shape = step * groups + owner, (len(thresholds) + 1, groups)
    true = _above(cell, gain.true[rows], shape)
    return ThresholdCounts(
        thresholds=thresholds,
        recalls=recalls,
        true=true,
        false=_above(cell, None, shape) - true - _above(cell, gain.excused[rows], shape),
        annotated=annotated,
    )


def _above(
    cell: Int[np.ndarray, " r"], values: Int[np.ndarray, " r"] | None, shape: tuple[int, int]
) -> Float[np.ndarray, "t g"]:
    """Sums of the values (or numbers of rows) at or above each threshold, by group."""
    sums = np.bincount(cell, weights=values, minlength=shape[0] * shape[1])
    return sums.reshape(shape)[:-1].cumsum(axis=0).astype(np.float64)


# Step 3: average


def _part_figures(
    parts: Mapping[str, _PartCounts], settings: KRadarSettings, weights: Float[np.ndarray, "r g"]
) -> dict[str, Draws]:
    return {part: _figures(counted, settings, weights) for part, counted in parts.items()}


def _figures(counted: _PartCounts, settings: KRadarSettings, weights: Float[np.ndarray, "r g"]) -> Draws:
    """AP of one part by class, measure and overlap under each row of group weights."""
    points = settings.recall_points
    gaps = settings.sampling == "gaps"
    return {
        f"ap/{label}/{measure}/{iou:g}": at_thresholds.average_precisions(weights, (points,), gaps=gaps)[points]
        for label, counts in counted.items()
        for (measure, iou), at_thresholds in counts.items()
    }


def _nested(counts: dict[str, dict[str, Any]], frames_given: int, cut: int) -> dict[str, Any]:
    """Counts as the result holds them: the whole at the top, subsets by kind."""
    for part in counts.values():
        for name in ("annotated", "predictions"):
            part[name] = sum(boxes[name] for boxes in part["classes"].values())
    tree = {**counts.pop("overall"), "frames_given": frames_given, "predictions_cut": cut}
    tree |= {"ranges": {}, "conditions": {}, "visibility": {}}
    for name, part in counts.items():
        kind, _, value = name.partition("/")
        if not value:
            tree["ranges"][name] = part
        elif kind == "visibility":
            tree["visibility"][value] = part
        else:
            tree["conditions"].setdefault(kind, {})[value] = part
    return tree


def _curves(counted: _PartCounts) -> dict[str, dict[str, dict[str, Any]]]:
    tree: dict[str, dict[str, dict[str, Any]]] = {}
    for label, counts in counted.items():
        for (measure, iou), at_thresholds in counts.items():
            tree.setdefault(label, {}).setdefault(measure, {})[f"{iou:g}"] = at_thresholds.curve()
    return tree


def _nest_or_none(part: Statistics) -> dict[str, Any] | None:
    return None if all(value is None for value in part.values()) else nest(part)
