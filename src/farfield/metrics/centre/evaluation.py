"""The evaluation that DDS, wDDS and nuScenes share: match by centre distance, then read the figures off the curves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.geometry.iou import aligned_iou
from farfield.metrics.bootstrap import Statistics
from farfield.metrics.centre.matching import DROPPED, Limits, greedy_match, rank_predictions
from farfield.metrics.centre.scene import CentreScene
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.curves import Curve, Ranking, average_precision, mean_error, weighted_curve
from farfield.metrics.frames import in_range
from farfield.metrics.replicates import average_precisions, mean_errors, shares, weighted_curves

Variant = tuple[float, float]  # epsilon, threshold in metres
ERRORS = ("trans_err", "scale_err", "orient_err")


@dataclass(frozen=True, eq=False, kw_only=True)
class GreedyMatches:
    """What each prediction of a scene took, for every epsilon and threshold.

    Args:
        order: Predictions by falling score, shape (n,).
        confidence: Score on the confidence axis of each prediction, shape (n,).
        taken: Index of the annotated box, NO_MATCH or DROPPED, shape (n,), by (epsilon, threshold).
    """

    order: Int[np.ndarray, " n"]
    confidence: Float[np.ndarray, " n"]
    taken: dict[Variant, Int[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False, kw_only=True)
class PartRankings:
    """The rankings of one part of a scene (a range bin, or all of it), with the errors of the matches.

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


def match_scene(scene: CentreScene, settings: CentreSettings) -> GreedyMatches:
    """Play the greedy game for all epsilons and thresholds at once."""
    confidence = scene.score
    thresholds = list(dict.fromkeys((*settings.thresholds_m, *settings.error_thresholds_m)))
    variants = [(epsilon, threshold) for epsilon in settings.epsilons for threshold in thresholds]
    epsilon = np.array([variant[0] for variant in variants])[:, None]
    by_annotated = settings.omega_range == "gt"
    omega = np.exp(epsilon * (scene.annotated if by_annotated else scene.predicted).range_m)
    limits = Limits(
        threshold_m=np.array([variant[1] for variant in variants]),
        omega_annotated=omega if by_annotated else None,
        omega_predicted=None if by_annotated else omega,
        normalised=settings.match == "nearest_normalised",
    )
    axes = 3 if settings.distance == "3d" else 2
    order = rank_predictions(confidence, scene.predicted_frame, ties=settings.ties)
    taken = greedy_match(
        scene.predicted.centre_m[:, :axes],
        scene.predicted_frame,
        order,
        scene.annotated.centre_m[:, :axes],
        scene.annotated_frame,
        limits,
        ignored=scene.ignored,
    )
    return GreedyMatches(order=order, confidence=confidence, taken=dict(zip(variants, taken, strict=True)))


def with_confidences(scene: CentreScene, settings: CentreSettings) -> CentreScene:
    """Put the scores on the confidence axis, where zero means "nothing" (row 17)."""
    score, kind = scene.score, settings.scores
    if kind == "auto":
        kind = "sigmoid" if len(score) and (score.min() < 0 or score.max() > 1) else "raw"
    if kind == "rank":
        values, place = np.unique(score, return_inverse=True)
        score = (place + 1.0) / max(len(values), 1)
    elif kind == "sigmoid":
        score = np.exp(-np.logaddexp(0.0, -score))
    return replace(scene, predicted=scene.predicted.replace(score=score))


def whole(scene: CentreScene, matches: GreedyMatches, settings: CentreSettings) -> PartRankings:
    """All of a scene as one part."""
    return _part(
        scene, matches, settings, np.ones(len(scene.predicted), dtype=bool), np.ones(len(scene.annotated), dtype=bool)
    )


def binned(
    scene: CentreScene, matches: GreedyMatches, settings: CentreSettings, low_m: float, high_m: float
) -> PartRankings:
    """One range bin of a scene that was matched as a whole: matches count where their annotated box is."""
    return _part(
        scene, matches, settings, in_range(scene.predicted, low_m, high_m), in_range(scene.annotated, low_m, high_m)
    )


def _part(
    scene: CentreScene,
    matches: GreedyMatches,
    settings: CentreSettings,
    predicted_in: Bool[np.ndarray, " n"],
    annotated_in: Bool[np.ndarray, " m"],
) -> PartRankings:
    per_group = scene.annotated_per_group(annotated_in)
    group = scene.group[scene.predicted_frame]
    rankings, errors = {}, {}
    for variant, taken in matches.taken.items():
        hit = taken >= 0
        inside = predicted_in.copy()
        inside[hit] = annotated_in[taken[hit]]
        rows = matches.order[(inside & (taken != DROPPED))[matches.order]]
        rankings[variant] = Ranking(
            confidence=matches.confidence[rows], is_match=hit[rows], group=group[rows], annotated=per_group
        )
        if variant[1] in settings.error_thresholds_m:
            rows = rows[hit[rows]]
            errors[variant] = pair_errors(scene.predicted[rows], scene.annotated[taken[rows]], settings)
    return PartRankings(
        ranking=rankings,
        error=errors,
        annotated=int(per_group.sum()),
        ignored=int((scene.ignored & annotated_in).sum()),
        predicted=int(predicted_in.sum()),
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


def statistics(part: PartRankings, settings: CentreSettings, weight: Float[np.ndarray, " groups"]) -> Statistics:
    """All figures of a part under given group weights, None where nothing is annotated.

    Names: ``ap/0.5`` and ``errors/trans_err`` at the first epsilon; ``dds/EPSILON/dds``, ``.../map``, ``.../aiou``, or,
    where aligned IoU is not scored, ``map``, at the first epsilon too.
    """
    curves = {variant: weighted_curve(ranking, weight) for variant, ranking in part.ranking.items()}
    figures: Statistics = {}
    for epsilon in settings.epsilons:
        error = partial(_error, part, curves, settings, epsilon)
        precisions = [_precision(curves[epsilon, threshold], settings) for threshold in settings.thresholds_m]
        if epsilon == settings.epsilons[0]:
            figures |= {f"ap/{float(t)}": v for t, v in zip(settings.thresholds_m, precisions, strict=True)}
            figures |= {f"errors/{name}": error(name, "nuscenes") for name in ERRORS}
        mean_ap = _mean(precisions)
        if not settings.with_aiou:
            figures.setdefault("map", mean_ap)
            continue
        aiou_err = error("aiou_err", settings.aiou_mean)
        aiou = None if aiou_err is None else 1.0 - aiou_err
        figures |= {f"dds/{epsilon:g}/dds": _mean([mean_ap, aiou])}
        figures |= {f"dds/{epsilon:g}/map": mean_ap, f"dds/{epsilon:g}/aiou": aiou}
    return figures


def statistics_of_many(
    part: PartRankings, settings: CentreSettings, weights: Float[np.ndarray, "r g"]
) -> dict[str, Float[np.ndarray, " r"]]:
    """The figures of :func:`statistics` under each row of group weights; NaN where nothing is annotated."""
    figures: dict[str, np.ndarray] = {}
    for epsilon in settings.epsilons:
        first = epsilon == settings.epsilons[0]
        names = [*(ERRORS if first else ()), *(["aiou_err"] if settings.with_aiou else [])]
        precisions = {threshold: np.zeros(0) for threshold in settings.thresholds_m}
        errors: dict[str, list[np.ndarray]] = {name: [] for name in names}
        for threshold in dict.fromkeys((*settings.thresholds_m, *settings.error_thresholds_m)):
            area, found = _figures_of_many(part, settings, (epsilon, threshold), names, weights)
            if threshold in precisions:
                precisions[threshold] = area
            for name, values in found.items():
                errors[name].append(values)
        mean_ap = _mean_of_many([precisions[threshold] for threshold in settings.thresholds_m])
        if first:
            figures |= {f"ap/{float(threshold)}": precisions[threshold] for threshold in settings.thresholds_m}
            figures |= {f"errors/{name}": _mean_of_many(errors[name]) for name in ERRORS}
        if not settings.with_aiou:
            figures.setdefault("map", mean_ap)
            continue
        aiou = 1.0 - _mean_of_many(errors["aiou_err"])
        figures |= {f"dds/{epsilon:g}/dds": _mean_of_many([mean_ap, aiou])}
        figures |= {f"dds/{epsilon:g}/map": mean_ap, f"dds/{epsilon:g}/aiou": aiou}
    return figures


def _figures_of_many(
    part: PartRankings,
    settings: CentreSettings,
    variant: Variant,
    names: Sequence[str],
    weights: Float[np.ndarray, "r g"],
) -> tuple[Float[np.ndarray, " r"], dict[str, Float[np.ndarray, " r"]]]:
    """Average precisions of one variant, and its errors where those are taken at its threshold."""
    areas: list[np.ndarray] = []
    found: dict[str, list[np.ndarray]] = {name: [] for name in names if variant[1] in settings.error_thresholds_m}
    for some in shares(part.ranking[variant], weights):
        curves = weighted_curves(part.ranking[variant], some)
        areas.append(average_precisions(curves, method=settings.ap))
        for name, values in found.items():
            method = settings.aiou_mean if name == "aiou_err" else "nuscenes"
            values.append(mean_errors(curves, part.error[variant][name], method=method))
    return np.concatenate(areas), {name: np.concatenate(values) for name, values in found.items()}


def _mean_of_many(values: Sequence[Float[np.ndarray, " r"]]) -> Float[np.ndarray, " r"]:
    """Means of rows, added up in order as :func:`_mean` does; NaN where one is."""
    total = values[0].copy()
    for each in values[1:]:
        total += each
    return total / len(values)


def mean_of_parts_of_many(
    parts: Sequence[Mapping[str, Float[np.ndarray, " r"]]],
) -> dict[str, Float[np.ndarray, " r"]]:
    """Mean of each figure over the parts that have annotated boxes under a row's weights; NaN where none has."""
    means = {}
    for name in parts[0] if parts else ():
        total, count = np.zeros(len(parts[0][name])), np.zeros(len(parts[0][name]))
        for part in parts:
            known = ~np.isnan(part[name])
            total[known] += part[name][known]
            count += known
        means[name] = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
    return means


def _precision(curve: Curve | None, settings: CentreSettings) -> float | None:
    return None if curve is None else average_precision(curve, method=settings.ap)


def _error(
    part: PartRankings,
    curves: dict[Variant, Curve | None],
    settings: CentreSettings,
    epsilon: float,
    name: str,
    method: str,
) -> float | None:
    values = []
    for threshold in settings.error_thresholds_m:
        curve = curves[epsilon, threshold]
        found = None if curve is None else mean_error(curve, part.error[epsilon, threshold][name], method=method)
        values.append(found)
    return _mean(values)


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) and known else None


def mean_of_parts(parts: list[Statistics]) -> Statistics:
    """Mean of each figure over the parts that have annotated boxes; None where none has."""
    return {
        name: _mean([part[name] for part in parts if part[name] is not None]) for name in (parts[0] if parts else ())
    }
