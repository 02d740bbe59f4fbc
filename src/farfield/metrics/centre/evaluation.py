"""The evaluation that DDS, wDDS and nuScenes share: gather, match by centre distance, average over the curves.

The steps of :func:`evaluate_centre`; formulas of the scores stand in :mod:`~farfield.metrics.centre.dds` and
:mod:`~farfield.metrics.centre.nuscenes`, those of the curves in :mod:`farfield.metrics.curves`:

    1. gather        boxes of one class in the region, of all frames in flat arrays
    2. match         greedily by falling score, for each threshold t and epsilon: nearest free box nearer than omega t,
                     omega = exp(epsilon d)
    3. rank          matches and false positives by confidence, for the region and each range bin, with the errors of
                     the matches: distance, 1 - IoU of sizes, heading, 1 - aligned IoU
    4. average       AP over thresholds and aIoU over matches, for weights of 1 (the result) and for bootstrap draws
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.geometry.iou import aligned_iou
from farfield.metrics.bootstrap import (
    Draws,
    Statistics,
    point_and_intervals,
)
from farfield.metrics.centre.matching import DROPPED, NO_MATCH, Limits, greedy_match, rank_predictions
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.curves import FIRST, RECALL, Ranking, average_precisions, mean_errors, row_chunks, weighted_curves
from farfield.metrics.frames import (
    BoxesByFrame,
    check_frames,
    check_scores,
    flatten,
    frames_in_order,
    group_frames,
    has_label,
    in_range,
    in_region,
    nearest_first,
)
from farfield.vocabulary.counts import count_of

Variant = tuple[float, float]  # epsilon, threshold in metres
ERRORS = ("trans_err", "scale_err", "orient_err")


def evaluate_centre(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: CentreSettings,
    *,
    protocol: str,
    drives: Sequence[Drive] = (),
    reach_m: float | None = None,
) -> dict[str, Any]:
    """Evaluate the region and each of its range bins; returns the fields of a :class:`~farfield.metrics.Result`.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotations: Annotated boxes by (sequence, frame): every frame that counts.
        settings: The options.
        protocol: What the result is to be called.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.
        reach_m: Range bins that begin here or beyond are not in the mean of the bins.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    # 1. Gather the boxes of the class in the region.
    boxes = gather(predictions, annotations, settings, drives)
    # 2, 3. Match them, and rank matches and false positives of the region and of each range bin.
    parts = rank_parts(boxes, settings)
    # 4. Average over the curves: the figures under weights of 1, and their intervals over draws of the drives.
    figures = partial(part_figures, parts, settings, bins_in_reach(settings, reach_m))
    point, intervals = point_and_intervals(figures, boxes.n_groups, settings.bootstrap)
    frames = np.union1d(boxes.predicted_frame, boxes.annotated_frame[~boxes.ignored])
    counts = {
        name: {"annotated": part.annotated, "predictions": part.predicted, "ignored": part.ignored}
        for name, part in parts.items()
    }
    return {
        "protocol": protocol,
        "label": settings.label,
        "settings": settings.to_json(),
        "convention": settings.convention(),
        "figures": point["overall"],
        "ranges": {name: values for name, values in point.items() if name not in ("overall", "mean_of_bins")},
        "mean_of_bins": point["mean_of_bins"],
        "counts": {
            "frames": len(frames),  # with a prediction or an annotated box that counts
            "frames_given": len(annotations),  # all annotated ones, empty ones too
            **counts.pop("overall"),
            "matches": _matches(parts["overall"], settings),  # that carry aIoU and the errors
            "predictions_over_limit": boxes.over_limit,
            "ranges": counts,
        },
        "intervals": intervals,
        "grouped_by": boxes.grouped_by,
        "curves": {name: _curves(part, settings) for name, part in parts.items()},
        "notes": (*low_recall_notes(parts, point, settings), *_few_matches(parts["overall"], settings)),
    }


# Step 1: gather


@dataclass(frozen=True, eq=False, kw_only=True)
class CentreBoxes:
    """Predicted and annotated boxes of all frames, with the frame of each.

    Args:
        predicted: n predictions with scores.
        predicted_frame: Frame number of each, shape (n,).
        annotated: m annotated boxes, those to be ignored included.
        annotated_frame: Frame number of each, shape (m,).
        ignored: Which annotated boxes are neither right nor wrong to find, shape (m,).
        group: Resampling group of each frame, shape (frames,).
        grouped_by: ``"sequences"``, or ``"frames"`` where there is only one sequence.
        over_limit: Predictions left out because their frame had too many.
    """

    predicted: Boxes
    predicted_frame: Int[np.ndarray, " n"]
    annotated: Boxes
    annotated_frame: Int[np.ndarray, " m"]
    ignored: Bool[np.ndarray, " m"]
    group: Int[np.ndarray, " frames"]
    grouped_by: str
    over_limit: int = 0

    @property
    def score(self) -> Float[np.ndarray, " n"]:
        """Scores of the predictions, shape (n,)."""
        return np.zeros(0) if self.predicted.score is None else self.predicted.score

    @property
    def n_groups(self) -> int:
        """Number of resampling groups."""
        return int(self.group.max()) + 1 if len(self.group) else 0

    def annotated_per_group(self, mask: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " groups"]:
        """Marked annotated boxes that are not ignored, by group."""
        return np.bincount(self.group[self.annotated_frame[~self.ignored & mask]], minlength=self.n_groups)

    def cut(self, predicted: Bool[np.ndarray, " n"], annotated: Bool[np.ndarray, " m"]) -> "CentreBoxes":
        """Return the marked boxes only."""
        if predicted.all() and annotated.all():
            return self
        return replace(
            self,
            predicted=self.predicted[predicted],
            predicted_frame=self.predicted_frame[predicted],
            annotated=self.annotated[annotated],
            annotated_frame=self.annotated_frame[annotated],
            ignored=self.ignored[annotated],
        )


def gather(
    predictions: BoxesByFrame, annotations: BoxesByFrame, settings: CentreSettings, drives: Sequence[Drive] = ()
) -> CentreBoxes:
    """Collect one class from all frames and cut it to the region.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame); every frame that counts, the empty ones too.
        settings: The options.
        drives: Drives of the data, for resampling.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    check_frames(predictions, annotations)
    keys = frames_in_order(predictions, annotations, settings.ties)
    # flatten takes one frame at a time, since they may lie on the disk; the stream counts what it passes on
    stream = _PredictionStream(predictions, keys, settings)
    predicted = flatten(stream, scored=True)
    annotated = flatten((_in_order(annotations[key], settings) for key in keys), scored=False)
    annotated_frame = np.repeat(np.arange(len(keys)), [len(annotations[key].yaw_rad) for key in keys])
    ignored = np.zeros(len(annotated), dtype=bool)
    for name in settings.ignore:
        ignored |= has_label(annotated, name, settings.relabel)
    counted = has_label(annotated, settings.label, settings.relabel) | ignored
    ignored |= ~in_region(annotated, settings)  # of these only what lies on the seam is left below
    enough = _enough_points(annotated, settings.min_points)
    if settings.ignores_few:
        ignored |= counted & ~enough
    else:
        counted &= enough  # ignored ones go too: predictions there are then false
    group, grouped_by = group_frames(keys, drives)
    boxes = CentreBoxes(
        predicted=predicted,
        predicted_frame=np.repeat(np.arange(len(keys)), stream.per_frame),
        annotated=annotated,
        annotated_frame=annotated_frame,
        ignored=ignored,
        group=group,
        grouped_by=grouped_by,
        over_limit=stream.over_limit,
    )
    return boxes.cut(np.ones(len(predicted), dtype=bool), counted & in_region(annotated, settings.with_seam()))


class _PredictionStream:
    """The predictions that count, frame by frame; at its end, how many per frame, and how many were over the limit."""

    def __init__(self, predictions: BoxesByFrame, keys: Sequence[Key], settings: CentreSettings) -> None:
        self.predictions, self.keys, self.settings = predictions, keys, settings
        self.region = settings.with_seam()
        self.per_frame, self.over_limit = np.zeros(len(keys), dtype=np.int64), 0

    def __iter__(self) -> Iterator[Boxes]:
        for frame, key in enumerate(self.keys):
            if key in self.predictions:
                boxes = _in_order(self.predictions[key], self.settings)
                check_scores(boxes)
                mask = np.ones(len(boxes), dtype=bool)
                if len(boxes) > self.settings.max_boxes and boxes.score is not None:
                    mask[np.argsort(-boxes.score, kind="stable")[self.settings.max_boxes :]] = False
                self.over_limit += len(boxes) - int(np.count_nonzero(mask))
                mask &= has_label(boxes, self.settings.label, self.settings.relabel) & in_region(boxes, self.region)
                self.per_frame[frame] = np.count_nonzero(mask)
                yield boxes[mask]


def _in_order(boxes: Boxes, settings: CentreSettings) -> Boxes:
    """The boxes of a frame in the order that decides between equal scores and equal distances."""
    return boxes[nearest_first(boxes)] if settings.ties == "nearest_first" and len(boxes) > 1 else boxes


def _enough_points(boxes: Boxes, least: int) -> Bool[np.ndarray, " n"]:
    if least == 0 or len(boxes) == 0:
        return np.ones(len(boxes), dtype=bool)
    if boxes.point_count is None or (boxes.point_count < 0).all():
        raise ConfigError(f"min_points={least}: expected annotated boxes with point counts, got none that has one")
    return (boxes.point_count < 0) | (boxes.point_count >= least)


# Step 2: match


@dataclass(frozen=True, eq=False, kw_only=True)
class GreedyMatches:
    """What each prediction matches, for every epsilon and threshold.

    Args:
        order: Predictions by falling score, shape (n,).
        confidence: Score on the confidence axis of each prediction, shape (n,).
        assigned: Index of the annotated box, NO_MATCH or DROPPED, shape (n,), by (epsilon, threshold).
    """

    order: Int[np.ndarray, " n"]
    confidence: Float[np.ndarray, " n"]
    assigned: dict[Variant, Int[np.ndarray, " n"]]


def with_confidences(boxes: CentreBoxes, settings: CentreSettings) -> CentreBoxes:
    """Put the scores on the confidence axis, where zero means "nothing" (docs/metrics.md, row 17)."""
    score = boxes.score
    kind = settings.scores
    if kind == "auto":
        kind = "sigmoid" if len(score) and (score.min() < 0 or score.max() > 1) else "raw"
    if kind == "rank":
        values, index = np.unique(score, return_inverse=True)
        score = (index + 1.0) / max(len(values), 1)
    elif kind == "sigmoid":
        score = np.exp(-np.logaddexp(0.0, -score))
    return replace(boxes, predicted=boxes.predicted.replace(score=score))


def match_boxes(boxes: CentreBoxes, settings: CentreSettings) -> GreedyMatches:
    """Match greedily by centre distance for all epsilons and thresholds at once."""
    variants = [(epsilon, threshold) for epsilon in settings.epsilons for threshold in settings.all_thresholds_m]
    epsilons, thresholds_m = (np.array(column) for column in zip(*variants, strict=True))
    by_annotated = settings.omega_range == "gt"
    omega = np.exp(epsilons[:, None] * (boxes.annotated if by_annotated else boxes.predicted).range_m)
    limits = Limits(
        threshold_m=thresholds_m,
        omega_annotated=omega if by_annotated else None,
        omega_predicted=None if by_annotated else omega,
        normalised=settings.match == "nearest_normalised",
    )
    axes = 3 if settings.distance == "3d" else 2
    order = rank_predictions(boxes.score, boxes.predicted_frame, ties=settings.ties)
    assigned = greedy_match(
        boxes.predicted.centre_m[:, :axes],
        boxes.predicted_frame,
        order,
        boxes.annotated.centre_m[:, :axes],
        boxes.annotated_frame,
        limits,
        ignored=boxes.ignored,
    )
    assigned[(assigned == NO_MATCH) & ~in_region(boxes.predicted, settings)] = DROPPED  # on the seam
    return GreedyMatches(order=order, confidence=boxes.score, assigned=dict(zip(variants, assigned, strict=True)))


# Step 3: rank


@dataclass(frozen=True, eq=False, kw_only=True)
class PartRankings:
    """The rankings of one part (a range bin, or the whole region), with the errors of the matches.

    Args:
        ranking: By (epsilon, threshold).
        error: Arrays of shape (matches,) in rank order by name (ERRORS, ``"aiou_err"``), by (epsilon, threshold).
        annotated: Number of annotated boxes that count.
        ignored: Number of annotated boxes that are ignored.
        predicted: Number of predictions.
    """

    ranking: dict[Variant, Ranking]
    error: dict[Variant, dict[str, Float[np.ndarray, " h"]]]
    annotated: int
    ignored: int
    predicted: int


def rank_parts(boxes: CentreBoxes, settings: CentreSettings) -> dict[str, PartRankings]:
    """The rankings of the region, ``"overall"``, and of each range bin, such as ``"0-70"``.

    A bin is cut out and matched by itself, or the region is matched once and its matches are shared out
    (``settings.range_assign``).
    """
    boxes = with_confidences(boxes, settings)
    matches = match_boxes(boxes, settings)
    parts = {"overall": rank(boxes, matches, settings)}
    for low_m, high_m in settings.bins_m:
        name = f"{low_m:g}-{high_m:g}"
        predicted_in = in_range(boxes.predicted, low_m, high_m)
        annotated_in = in_range(boxes.annotated, low_m, high_m)
        if settings.range_assign == "match_then_bin":
            parts[name] = rank(boxes, matches, settings, predicted_in, annotated_in)
        elif predicted_in.all() and annotated_in.all():
            parts[name] = parts["overall"]
        else:
            inside = boxes.cut(predicted_in, annotated_in)
            parts[name] = rank(inside, match_boxes(inside, settings), settings)
    return parts


def rank(
    boxes: CentreBoxes,
    matches: GreedyMatches,
    settings: CentreSettings,
    predicted_in: Bool[np.ndarray, " n"] | None = None,
    annotated_in: Bool[np.ndarray, " m"] | None = None,
) -> PartRankings:
    """Rank the matched predictions of the region, or of a range bin of it.

    A match counts where its annotated box is, a false positive where it is itself; predictions on ignored boxes count
    nowhere.

    Args:
        boxes: Predicted and annotated boxes, with confidences.
        matches: What its predictions match.
        settings: The options.
        predicted_in: Predictions inside the bin; None: all.
        annotated_in: Annotated boxes inside the bin; None: all.
    """
    predicted_in = np.ones(len(boxes.predicted), dtype=bool) if predicted_in is None else predicted_in
    annotated_in = np.ones(len(boxes.annotated), dtype=bool) if annotated_in is None else annotated_in
    per_group = boxes.annotated_per_group(annotated_in)
    group = boxes.group[boxes.predicted_frame]
    rankings, errors = {}, {}
    for (epsilon, threshold_m), assigned in matches.assigned.items():
        is_match = assigned >= 0
        is_inside = predicted_in.copy()
        is_inside[is_match] = annotated_in[assigned[is_match]]
        # What counts here, by falling score: the mask is put into that order, then picks from the order
        rows = matches.order[(is_inside & (assigned != DROPPED))[matches.order]]
        rankings[epsilon, threshold_m] = Ranking(
            confidence=matches.confidence[rows], is_match=is_match[rows], group=group[rows], annotated=per_group
        )
        if threshold_m in settings.error_thresholds_m:
            rows = rows[is_match[rows]]
            errors[epsilon, threshold_m] = pair_errors(boxes.predicted[rows], boxes.annotated[assigned[rows]], settings)
    return PartRankings(
        ranking=rankings,
        error=errors,
        annotated=int(per_group.sum()),
        ignored=int((boxes.ignored & annotated_in).sum()),
        predicted=int((predicted_in & in_region(boxes.predicted, settings)).sum()),
    )


def pair_errors(predicted: Boxes, annotated: Boxes, settings: CentreSettings) -> dict[str, Float[np.ndarray, " h"]]:
    """Errors of matched pairs: distance (metres), 1 - IoU of sizes, heading (radians), 1 - aIoU; each of shape (h,)."""
    axes = 3 if settings.distance == "3d" else 2
    offset_m = (predicted.centre_m - annotated.centre_m)[:, :axes]
    errors = {
        "trans_err": np.sqrt((offset_m**2).sum(axis=1)),
        "scale_err": 1.0 - aligned_iou(predicted, annotated, kind="scale"),
        "orient_err": np.abs(wrap_angle_rad(predicted.yaw_rad - annotated.yaw_rad)),
    }
    if settings.with_aiou:
        errors["aiou_err"] = 1.0 - aligned_iou(predicted, annotated, kind=settings.aiou)
    return errors


def _curves(part: PartRankings, settings: CentreSettings) -> dict[str, dict[str, Ranking]]:
    """The rankings by epsilon and threshold, as results hold them."""
    return {
        f"{epsilon:g}": {str(float(threshold)): part.ranking[epsilon, threshold] for threshold in settings.thresholds_m}
        for epsilon in settings.epsilons
    }


# Step 4: average


def part_figures(
    parts: Mapping[str, PartRankings], settings: CentreSettings, bins: Sequence[str], weights: Float[np.ndarray, "r g"]
) -> dict[str, Draws]:
    """All figures of each part, and their ``"mean_of_bins"``, under each row of group weights.

    Args:
        parts: The rankings by part.
        settings: The options.
        bins: Names of the bins that are averaged.
        weights: Weights of the groups.
    """
    by_identity = {id(part): part for part in parts.values()}  # a bin that holds everything is computed once
    figures = {key: figures_of_part(part, settings, weights) for key, part in by_identity.items()}
    named: dict[str, Draws] = {name: figures[id(part)] for name, part in parts.items()}
    return named | {"mean_of_bins": mean_of_bins([named[name] for name in bins])}


def figures_of_part(part: PartRankings, settings: CentreSettings, weights: Float[np.ndarray, "r g"]) -> Draws:
    """All figures of a part under each row of group weights, NaN where nothing is annotated, each of shape (r,).

    Names: ``ap/0.5`` and ``errors/trans_err`` at the first epsilon; ``dds/EPSILON/dds``, ``.../map``, ``.../aiou``, or,
    where aligned IoU is not scored, ``map``, at the first epsilon too.
    """
    length = max((len(ranking.confidence) for ranking in part.ranking.values()), default=0)
    chunks = [_figures_of_chunk(part, settings, rows) for rows in row_chunks(weights, length)]
    return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]} if chunks else {}


def _figures_of_chunk(part: PartRankings, settings: CentreSettings, weights: Float[np.ndarray, "r g"]) -> Draws:
    figures: dict[str, Float[np.ndarray, " r"]] = {}
    for epsilon in settings.epsilons:
        is_first = epsilon == settings.epsilons[0]
        names = [*(ERRORS if is_first else ()), *(["aiou_err"] if settings.with_aiou else [])]
        precisions: dict[float, Float[np.ndarray, " r"]] = {}
        errors: dict[str, list[Float[np.ndarray, " r"]]] = {name: [] for name in names}
        for threshold in settings.all_thresholds_m:
            curves = weighted_curves(part.ranking[epsilon, threshold], weights)
            precisions[threshold] = average_precisions(curves, method=settings.ap)
            for name in names if threshold in settings.error_thresholds_m else ():
                method = settings.aiou_mean if name == "aiou_err" else "nuscenes"
                errors[name].append(mean_errors(curves, part.error[epsilon, threshold][name], method=method))
        # mAP = mean of AP over the thresholds, aIoU = 1 - mean aligned error, DDS = (mAP + aIoU) / 2
        mean_ap = _mean([precisions[threshold] for threshold in settings.thresholds_m])
        if is_first:
            figures |= {f"ap/{float(threshold)}": precisions[threshold] for threshold in settings.thresholds_m}
            figures |= {f"errors/{name}": _mean(errors[name]) for name in ERRORS}
        if settings.with_aiou:
            aiou = 1.0 - _mean(errors["aiou_err"])
            figures |= {f"dds/{epsilon:g}/dds": _mean([mean_ap, aiou])}
            figures |= {f"dds/{epsilon:g}/map": mean_ap, f"dds/{epsilon:g}/aiou": aiou}
        else:
            figures.setdefault("map", mean_ap)
    return figures


def _mean(values: Sequence[Float[np.ndarray, " r"]]) -> Float[np.ndarray, " r"]:
    """Mean of figures row by row, added up in their order; NaN where one is."""
    total = values[0].copy()
    for value in values[1:]:
        total += value
    return total / len(values)


def mean_of_bins(bins: Sequence[Draws]) -> Draws:
    """Mean of each figure over the bins that have annotated boxes under a row's weights; NaN where none has."""
    means = {}
    for name in bins[0] if bins else ():
        total, count = np.zeros(len(bins[0][name])), np.zeros(len(bins[0][name]))
        for figures in bins:
            is_known = ~np.isnan(figures[name])
            total[is_known] += figures[name][is_known]
            count += is_known
        means[name] = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
    return means


def bins_in_reach(settings: CentreSettings, reach_m: float | None) -> list[str]:
    """Names of the bins that begin within the detector's reach."""
    return [f"{low_m:g}-{high_m:g}" for low_m, high_m in settings.bins_m if reach_m is None or low_m < reach_m]


def low_recall_notes(
    parts: Mapping[str, PartRankings], point: Mapping[str, Statistics], settings: CentreSettings
) -> list[str]:
    """Why figures are 0 or 1, the worst, in parts where something was found: recall ends before the averages begin.

    nuScenes' averages begin at a recall of 0.11 (``calc_ap`` and ``calc_tp`` of its devkit).
    """
    least = float(RECALL[FIRST])
    limit = settings.error_thresholds_m[0]
    notes = list[str]()
    for name, part in parts.items():
        ranking = part.ranking[settings.epsilons[0], limit]
        recall = float(ranking.recall[-1]) if len(ranking.recall) else 0.0
        is_worst = settings.with_aiou and point[name].get(f"dds/{settings.epsilons[0]:g}/aiou") == 0
        if part.annotated and 0 < recall < least and (is_worst or not settings.with_aiou):
            where = "over all ranges" if name == "overall" else f"at {name} m"
            score = "aIoU counts as 0" if settings.with_aiou else "errors count as 1"
            notes.append(
                f"{where} only {recall:.2f} of the {count_of(part.annotated, 'object is', 'objects are')} "
                f"found within {limit:g} m, and "
                f"averages begin at a recall of {least:g}: AP there is 0, and {score}"
            )
    return notes


_FEW_MATCHES = 10


def _matches(part: PartRankings, settings: CentreSettings) -> int:
    """Matches at the first epsilon within the distance at which aIoU and errors are taken."""
    return int(part.ranking[settings.epsilons[0], settings.error_thresholds_m[0]].is_match.sum())


def _few_matches(part: PartRankings, settings: CentreSettings) -> Iterator[str]:
    """A note where a few matches of many objects, which may be chance, carry aIoU and the errors."""
    matches, limit = _matches(part, settings), settings.error_thresholds_m[0]
    if 0 < matches < min(_FEW_MATCHES, part.annotated):
        figures = "aIoU, which is half of DDS, and the errors are those" if settings.with_aiou else "errors are those"
        yield (
            f"{figures} of {matches} match{'es' * (matches > 1)} within {limit:g} m alone, of {part.annotated} "
            "annotated objects: so few may be chance; mAP says what is found"
        )
