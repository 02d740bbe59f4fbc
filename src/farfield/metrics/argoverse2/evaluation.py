"""Argoverse 2's detection metrics (Wilson et al., NeurIPS Datasets 2021): AP, ATE, ASE, AOE, CDS by category and range.

    1. gather     boxes of the categories nearer than 150 m; annotated boxes that hold a point; the 100 best detections
                  of a sweep and category
    2. match      each detection looks at its *nearest* annotated box in space, and each annotated box keeps the *best*
                  detection that looks at it: that one is a match at each threshold above its distance. A sure detection
                  farther away so blocks a less sure one that is nearer, other than in nuScenes' matching
    3. average    at each threshold precision after the k-th match, made monotone from the right, sampled at recalls 0,
                  0.01 ... 1 and averaged; AP is the mean over the thresholds

Errors are means over the matches at 2 m: ATE the distance, ASE 1 - prod min(size) / prod max(size), AOE the turn in
[0, pi]; without a match they are 2 m, 1 and pi.

    CDS = AP mean(1 - ATE / 2, 1 - ASE, 1 - AOE / pi),   averaged over the categories

A category without annotated boxes has no figure here. In ``mean_of_all`` it counts as in Argoverse 2's own kit, with
AP and CDS of 0 and the largest errors; ``mean_of_present`` is over the categories that are annotated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive
from farfield.geometry.boxes import wrap_angle_rad
from farfield.metrics.argoverse2.settings import Argoverse2Settings
from farfield.metrics.bootstrap import Draws, Weighted, point_and_intervals
from farfield.metrics.curves import RECALL, TabledCurve, row_chunks
from farfield.metrics.frames import BoxesByFrame, pairs_of_owners
from farfield.metrics.result import Result, table
from farfield.metrics.several_classes import ClassFrames, ClassRows, gather_classes

MEANS = ("mean_of_all", "mean_of_present")
FIGURES = ("cds", "ap", "ate", "ase", "aoe")
UNMATCHED = -1


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Argoverse2Result(Result):
    """Argoverse 2's figures by category and range: scores in [0, 1], ATE in metres, AOE in radians."""

    def __str__(self) -> str:
        classes = self.counts["classes"]
        shown = [*MEANS, *(name for name in self.settings["classes"] if classes[name]["annotated"])]
        distances = [f"ap_{threshold:g}" for threshold in self.settings["thresholds_m"]]
        head = ["", *(name.upper() for name in FIGURES), *(name.replace("_", " ") for name in distances)]
        rows = []
        for label in shown:
            values = [self.figures.get(f"ap/{label}/{name}") for name in (*FIGURES, *distances)]
            counts = classes.get(label, self.counts)
            cells = ["-" if value is None else f"{value:.3f}" for value in values]
            rows.append([label.replace("_", " "), *cells, str(counts["annotated"]), str(counts["predictions"])])
            span = self.intervals.get("overall", {}).get(f"ap/{label}/cds")
            if span and label in MEANS:
                rows.append(["  CDS [low, high]", f"{span[0]:.3f}-{span[1]:.3f}", *[""] * (len(head) + 0)])
        by_range = [
            [
                f"{label.replace('_', ' ')} {name.upper()}",
                *(self.cell(part, f"ap/{label}/{name}") for part in self.ranges),
            ]
            for label in shown
            for name in ("cds", "ap")
        ]
        tables = [table([*head, "annotated", "predicted"], rows), table(["by range", *self.ranges], by_range)]
        return f"{self.protocol}: scores in [0, 1], ATE in m, AOE in rad\n\n" + "\n\n".join([*tables, self.footer()])


# Step 1: gather


@dataclass(frozen=True, eq=False, kw_only=True)
class Argoverse2Frames:
    """Boxes of all frames as they may count.

    Args:
        frames: Boxes of the categories; annotated ones hold points.
        ranked: Rows of the predictions by frame and category, the best first, shape (n,).
        without_points: Annotated boxes that were left out since they hold too few points.
        uncounted: Annotated boxes whose number of points is not known; they count.
    """

    frames: ClassFrames
    ranked: Int[np.ndarray, " n"]
    without_points: int
    uncounted: int


def gather_argoverse2(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: Argoverse2Settings,
    drives: Sequence[Drive] = (),
) -> Argoverse2Frames:
    """Collect the categories from all frames; the arguments are those of :func:`evaluate_argoverse2`."""
    frames = gather_classes(predictions, annotations, settings.classes, settings.relabel, drives)
    points = frames.annotated.boxes.point_count
    points = np.full(len(frames.annotated), -1) if points is None else points
    held = (points < 0) | (points >= settings.min_points)
    frames = ClassFrames(**{**vars(frames), "annotated": frames.annotated[held]})
    predicted = frames.predicted
    rows = np.arange(len(predicted))
    return Argoverse2Frames(
        frames=frames,
        ranked=np.lexsort((rows, -predicted.score, predicted.owner(len(settings.classes)))),
        without_points=int((~held).sum()),
        uncounted=int((points < 0).sum()) if settings.min_points else 0,
    )


def within_limit(data: Argoverse2Frames, settings: Argoverse2Settings, reach_m: float) -> Bool[np.ndarray, " n"]:
    """Which predictions nearer than some distance are among the best of their frame and category."""
    predicted = data.frames.predicted
    near = data.ranked[predicted.range_m[data.ranked] < reach_m]
    owner = predicted.owner(len(settings.classes))[near]
    first = np.concatenate([[True], owner[1:] != owner[:-1]]) if len(owner) else np.zeros(0, dtype=bool)
    start = np.maximum.accumulate(np.where(first, np.arange(len(near)), 0))
    mask = np.zeros(len(predicted), dtype=bool)
    mask[near[np.arange(len(near)) - start < settings.max_boxes]] = True
    return mask


# Step 2: match


def nearest_boxes(
    predicted: ClassRows, annotated: ClassRows, classes: int, owners: int
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The nearest annotated box of each prediction's frame and category, and its distance in space.

    Args:
        predicted: n predictions.
        annotated: Annotated boxes, by frame and category.
        classes: Number of categories.
        owners: Number of frames times categories.

    Returns:
        Rows of the annotated boxes, :data:`UNMATCHED` where there is none, and distances, each of shape (n,).
    """
    nearest, least_m = np.full(len(predicted), UNMATCHED), np.full(len(predicted), np.inf)
    if not len(predicted) or not len(annotated):
        return nearest, least_m
    for row, box in pairs_of_owners(predicted.owner(classes), annotated.owner(classes), owners):
        if not len(row):
            continue
        gap = predicted.boxes.centre_m[row] - annotated.boxes.centre_m[box]
        distance_m = np.sqrt((gap**2).sum(axis=1))
        starts = np.flatnonzero(np.concatenate([[True], row[1:] != row[:-1]]))
        best = np.minimum.reduceat(distance_m, starts)
        is_best = distance_m == np.repeat(best, np.diff(np.append(starts, len(row))))
        hits = np.flatnonzero(is_best)[::-1]  # of equal distances the first box stays
        nearest[row[hits]], least_m[row[hits]] = box[hits], distance_m[hits]
    return nearest, least_m


@dataclass(frozen=True, eq=False, kw_only=True)
class CategoryMatches:
    """The predictions of one category by falling score, and those that an annotated box keeps.

    Args:
        group: Resampling group of each prediction, shape (n,).
        confidence: Scores, falling, shape (n,).
        rank: Places in this ranking of the predictions that are kept, rising, shape (h,).
        distance_m: Their distances, shape (h,).
        error: Their errors by figure (``"ate"``, ``"ase"``, ``"aoe"``), each of shape (h,).
        annotated: Annotated boxes by group, shape (g,).
    """

    group: Int[np.ndarray, " n"]
    confidence: Float[np.ndarray, " n"]
    rank: Int[np.ndarray, " h"]
    distance_m: Float[np.ndarray, " h"]
    error: dict[str, Float[np.ndarray, " h"]]
    annotated: Int[np.ndarray, " g"]


def match_part(
    data: Argoverse2Frames,
    settings: Argoverse2Settings,
    predicted_in: Bool[np.ndarray, " n"],
    annotated_in: Bool[np.ndarray, " m"],
) -> dict[str, CategoryMatches]:
    """Match the marked boxes; by category."""
    frames, classes = data.frames, len(settings.classes)
    ranked = data.ranked[predicted_in[data.ranked]]
    predicted, annotated = frames.predicted[ranked], frames.annotated[annotated_in]
    box, distance_m = nearest_boxes(predicted, annotated, classes, max(len(frames.keys) * classes, 1))
    keeper = np.zeros(len(predicted), dtype=bool)
    looking = np.flatnonzero(box != UNMATCHED)
    keeper[looking[np.unique(box[looking], return_index=True)[1]]] = True  # the first looks with the highest score
    score, order = predicted.score, np.zeros(0, dtype=np.int64)
    order = np.lexsort((np.arange(len(predicted)), -score))
    matches = {}
    for kind, label in enumerate(settings.classes):
        rows = order[predicted.kind[order] == kind]
        rank = np.flatnonzero(keeper[rows])
        hits = rows[rank]
        matches[label] = CategoryMatches(
            group=frames.group[predicted.frame[rows]],
            confidence=score[rows],
            rank=rank,
            distance_m=distance_m[hits],
            error=_errors(predicted[hits], annotated[box[hits]], distance_m[hits]),
            annotated=np.bincount(frames.group[annotated.frame[annotated.kind == kind]], minlength=frames.groups),
        )
    return matches


def _errors(
    predicted: ClassRows, annotated: ClassRows, distance_m: Float[np.ndarray, " h"]
) -> dict[str, Float[np.ndarray, " h"]]:
    small = np.minimum(predicted.boxes.size_m, annotated.boxes.size_m).prod(axis=1)
    large = np.maximum(predicted.boxes.size_m, annotated.boxes.size_m).prod(axis=1)
    turn = np.abs(wrap_angle_rad(predicted.boxes.yaw_rad - annotated.boxes.yaw_rad))
    return {"ate": distance_m, "ase": 1.0 - small / large, "aoe": turn}


def match_parts(data: Argoverse2Frames, settings: Argoverse2Settings) -> dict[str, dict[str, CategoryMatches]]:
    """Matches by part (``"overall"``, ``"0-50"``...) and category."""
    predicted_m, annotated_m = data.frames.predicted.range_m, data.frames.annotated.range_m
    reach_m = settings.max_range_m
    parts = {"overall": match_part(data, settings, within_limit(data, settings, reach_m), annotated_m < reach_m)}
    for low_m, high_m in settings.bins_m:
        counted = within_limit(data, settings, max(reach_m, high_m))
        predicted_in = counted & (predicted_m >= low_m) & (predicted_m < high_m)
        annotated_in = (annotated_m >= low_m) & (annotated_m < high_m)
        parts[f"{low_m:g}-{high_m:g}"] = match_part(data, settings, predicted_in, annotated_in)
    return parts


# Step 3: average


def category_figures(
    matches: CategoryMatches, settings: Argoverse2Settings, weights: Float[np.ndarray, "r g"]
) -> dict[str, Float[np.ndarray, " r"]]:
    """The figures of one category under rows of group weights; NaN where nothing is annotated."""
    parts = [_figures_of_rows(matches, settings, rows) for rows in row_chunks(weights, len(matches.group))]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _figures_of_rows(
    matches: CategoryMatches, settings: Argoverse2Settings, weights: Float[np.ndarray, "r g"]
) -> dict[str, Float[np.ndarray, " r"]]:
    total = weights @ matches.annotated.astype(np.float64)
    figures = {name: np.full(len(weights), np.nan) for name in FIGURES}
    if not matches.annotated.any():
        return figures | {f"ap_{threshold:g}": figures["ap"] for threshold in settings.thresholds_m}
    row_weight = weights[:, matches.group]
    predicted = np.cumsum(row_weight, axis=1)
    every = predicted[:, -1] if predicted.shape[1] else np.zeros(len(weights))
    above, weight = predicted[:, matches.rank], row_weight[:, matches.rank]
    divisor = np.where(total > 0, total, 1.0)
    by_threshold = {}
    for threshold in settings.thresholds_m:
        near = matches.distance_m < threshold
        by_threshold[f"ap_{threshold:g}"] = _monotone_average(weight[:, near], above[:, near], every, divisor)
    figures["ap"] = np.mean([*by_threshold.values()], axis=0)
    near = matches.distance_m < settings.error_threshold_m
    weight = weight[:, near]
    matched, worst = weight.sum(axis=1), {"ate": settings.error_threshold_m, "ase": 1.0, "aoe": np.pi}
    scores = []
    for name, most in worst.items():
        sums = weight @ matches.error[name][near]
        figures[name] = np.divide(sums, matched, out=np.full(len(weights), most), where=matched > 0)
        scores.append(1.0 - figures[name] / most)
    figures["cds"] = figures["ap"] * np.mean(scores, axis=0)
    return {name: np.where(total > 0, values, np.nan) for name, values in (figures | by_threshold).items()}


def _monotone_average(
    weight: Float[np.ndarray, "r h"],
    above: Float[np.ndarray, "r h"],
    every: Float[np.ndarray, " r"],
    total: Float[np.ndarray, " r"],
) -> Float[np.ndarray, " r"]:
    """Mean over 101 recalls of the monotone precision, a row for each row of weights.

    Between one match and the next the monotone precision is that of the next; at the last recall it is that of all
    detections, and beyond it 0.

    Args:
        weight: Weight of each match.
        above: Weight of all detections down to the match.
        every: Weight of all detections.
        total: Weight of the annotated boxes.
    """
    rows, hits = weight.shape
    if not hits:
        return np.zeros(rows)
    matched = np.cumsum(weight, axis=1)
    precision = np.divide(matched, above, out=np.zeros_like(matched), where=above > 0)
    best = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
    last = np.divide(matched[:, -1], every, out=np.zeros(rows), where=every > 0)
    recall = matched / total[:, None]
    following = np.stack([np.searchsorted(row, RECALL, side="right") for row in recall])
    sampled = np.take_along_axis(best, np.minimum(following, hits - 1), axis=1)
    ends = np.where(recall[:, -1:] == RECALL, last[:, None], 0.0)
    return np.where(following < hits, sampled, ends).mean(axis=1)


def figures_of(
    matches: Mapping[str, CategoryMatches], settings: Argoverse2Settings, weights: Float[np.ndarray, "r g"]
) -> Draws:
    """The figures of one part by category, and their means over all categories and over the annotated ones."""
    categories = {label: category_figures(one, settings, weights) for label, one in matches.items()}
    absent = {"ate": settings.error_threshold_m, "ase": 1.0, "aoe": float(np.pi)}
    means: dict[str, Float[np.ndarray, " r"]] = {}
    for name in next(iter(categories.values())):
        values = np.array([figures[name] for figures in categories.values()])
        present = np.isfinite(values)
        count = present.sum(axis=0)
        sums = np.where(present, values, 0.0).sum(axis=0)
        missing = (len(values) - count) * absent.get(name, 0.0)
        nothing = count == 0
        means[f"ap/mean_of_all/{name}"] = np.where(nothing, np.nan, (sums + missing) / len(values))
        means[f"ap/mean_of_present/{name}"] = np.where(nothing, np.nan, sums / np.where(nothing, 1, count))
    ordered = {
        f"ap/{mean}/{name}": means[f"ap/{mean}/{name}"] for mean in MEANS for name in next(iter(categories.values()))
    }
    return ordered | {
        f"ap/{label}/{name}": values for label, figures in categories.items() for name, values in figures.items()
    }


def _part_figures(
    parts: Mapping[str, Mapping[str, CategoryMatches]], settings: Argoverse2Settings, weights: Float[np.ndarray, "r g"]
) -> dict[str, Draws]:
    return {part: figures_of(matches, settings, weights) for part, matches in parts.items()}


def _curve(matches: CategoryMatches, threshold_m: float) -> TabledCurve | None:
    total = int(matches.annotated.sum())
    if not total:
        return None
    rank = matches.rank[matches.distance_m < threshold_m]
    precision, confidence = np.zeros(len(RECALL)), np.zeros(len(RECALL))
    if len(rank):
        matched = np.arange(1, len(rank) + 1)
        best = np.maximum.accumulate((matched / (rank + 1))[::-1])[::-1]
        following = np.searchsorted(matched / total, RECALL, side="right")
        within = following < len(rank)
        precision[within] = best[following[within]]
        confidence[within] = matches.confidence[rank[following[within]]]
    return TabledCurve(recall=RECALL, precision=precision, confidence=confidence)


def evaluate_argoverse2(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: Argoverse2Settings | None = None,
    *,
    drives: Sequence[Drive] = (),
) -> Argoverse2Result:
    """Score predictions with Argoverse 2's metrics.

    Args:
        predictions: Scored boxes by (sequence, frame), in the coordinates of the ego vehicle.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes those of Argoverse 2's kit.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.

    Returns:
        Figures named ``ap/mean_of_all/cds``, ``ap/REGULAR_VEHICLE/ap_0.5``, ``ap/PEDESTRIAN/ate``...

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    settings = settings or Argoverse2Settings()
    if set(settings.classes) & set(MEANS):
        raise ConfigError(f"classes: {' and '.join(MEANS)} are means, got {', '.join(settings.classes)}")
    data = gather_argoverse2(predictions, annotations, settings, drives)
    frames, parts = data.frames, match_parts(data, settings)
    figures, intervals = point_and_intervals(partial(_part_figures, parts, settings), frames.groups, settings.bootstrap)
    boxes = {part: _box_counts(matches) for part, matches in parts.items()}
    curves = {
        label: {f"{threshold:g}": _curve(one, threshold) for threshold in settings.thresholds_m}
        for label, one in parts["overall"].items()
        if one.annotated.any()
    }
    used = np.union1d(frames.predicted.frame, frames.annotated.frame)
    return Argoverse2Result(
        protocol="argoverse2",
        label=settings.label,
        settings=settings.to_json(),
        figures=figures.pop("overall"),
        ranges=figures,
        counts={
            "frames": len(used),
            "frames_given": len(annotations),
            **boxes.pop("overall"),
            **_dropped(data, settings),
            "ranges": boxes,
        },
        intervals=intervals,
        grouped_by=frames.grouped_by,
        curves={"overall": curves},
        notes=tuple(_notes(data, settings, parts["overall"])),
    )


def _box_counts(matches: Mapping[str, CategoryMatches]) -> dict[str, Any]:
    classes = {
        label: {"annotated": int(one.annotated.sum()), "predictions": len(one.group)} for label, one in matches.items()
    }
    sums = {name: sum(counts[name] for counts in classes.values()) for name in ("annotated", "predictions")}
    return {**sums, "classes": classes}


def _dropped(data: Argoverse2Frames, settings: Argoverse2Settings) -> dict[str, int]:
    """Boxes that each rule leaves out of the whole."""
    frames, reach_m = data.frames, settings.max_range_m
    far = frames.predicted.range_m >= reach_m
    return {
        "annotated_without_points": data.without_points,
        "annotated_out_of_range": int((frames.annotated.range_m >= reach_m).sum()),
        "predictions_out_of_range": int(far.sum()),
        "predictions_over_limit": int((~far & ~within_limit(data, settings, reach_m)).sum()),
        "annotated_of_other_classes": frames.other_annotated,
        "predictions_of_other_classes": frames.other_predicted,
    }


def _notes(data: Argoverse2Frames, settings: Argoverse2Settings, matches: Mapping[str, CategoryMatches]) -> list[str]:
    dropped = _dropped(data, settings)
    named = {
        "annotated_without_points": f"annotated boxes hold fewer points than {settings.min_points}",
        "annotated_out_of_range": f"annotated boxes lie {settings.max_range_m:g} m away or farther",
        "predictions_out_of_range": f"predicted boxes lie {settings.max_range_m:g} m away or farther",
        "predictions_over_limit": f"predicted boxes are beyond the {settings.max_boxes} best of a sweep and category",
        "annotated_of_other_classes": "annotated boxes are of categories that are not scored",
        "predictions_of_other_classes": "predicted boxes are of categories that are not scored",
    }
    notes = [f"{dropped[name]} {words}: they do not count" for name, words in named.items() if dropped[name]]
    if data.uncounted:
        notes.append(f"how many points {data.uncounted} annotated boxes hold is not known: they count")
    present = sum(bool(one.annotated.any()) for one in matches.values())
    if 0 < present < len(matches):
        notes.append(
            f"{present} of {len(matches)} categories are annotated; in mean_of_all the others have AP and CDS 0"
        )
    notes.append(
        "boxes outside the map's region of interest count: Argoverse 2's leaderboard leaves them out (its kit with "
        "eval_only_roi_instances=False counts them too)"
    )
    return notes


def weighted_argoverse2(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: Argoverse2Settings,
    *,
    drives: Sequence[Drive] = (),
) -> Weighted:
    """The figures as functions of group weights; the arguments are those of :func:`evaluate_argoverse2`."""
    data = gather_argoverse2(predictions, annotations, settings, drives)
    figures = {part: partial(figures_of, matches, settings) for part, matches in match_parts(data, settings).items()}
    return Weighted(parts=figures, groups=tuple(data.frames.group.tolist()), grouped_by=data.frames.grouped_by)
