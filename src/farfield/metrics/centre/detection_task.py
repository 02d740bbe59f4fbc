"""The detection task of nuScenes whole (Caesar et al., CVPR 2020, section 3.1): all ten classes, five errors, NDS.

A prediction matches as in :mod:`farfield.metrics.centre.nuscenes`; besides there are of the matches at 2 m

    velocity error    difference of the velocities in the x-y plane, m/s; passed over where one is not known
    attribute error   1 - share of the matches whose attribute is that of the annotated box, of those that have one

and, with the mean AP and the mean errors over the classes (cones have no heading, velocity and attribute, barriers no
velocity and attribute, and a heading up to half a turn),

    NDS = (5 mAP + sum over the five errors of max(1 - error, 0)) / 10

Boxes count within their class' range, annotated ones if a point is in them, bicycles and motorcycles outside racks.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.geometry.boxes import Boxes, points_in_boxes, wrap_angle_rad
from farfield.geometry.iou import aligned_iou
from farfield.metrics.bootstrap import Bootstrap, Draws
from farfield.metrics.centre.matching import Limits, greedy_match, rank_predictions
from farfield.metrics.curves import Ranking, average_precisions, mean_errors, row_chunks, weighted_curves
from farfield.metrics.detections import Detections
from farfield.metrics.frames import check_scores, frames_in_order, group_frames, nearest_first
from farfield.metrics.options import check_numbers, check_range_bins, json_options, option_text
from farfield.vocabulary.classes import (
    CIRRUS_FROM_NUSCENES,
    NUSCENES_DETECTION_CLASSES,
    NUSCENES_FROM_CIRRUS,
    NUSCENES_RANGES_M,
)

ERRORS = ("trans_err", "scale_err", "orient_err", "vel_err", "attr_err")
WITHOUT: Mapping[str, tuple[str, ...]] = {
    "traffic_cone": ("orient_err", "vel_err", "attr_err"),
    "barrier": ("vel_err", "attr_err"),
}
"""Errors that a class does not have."""
_RACK = "static_object.bicycle_rack"
_IN_RACKS = ("bicycle", "motorcycle")
_AP_WEIGHT, _SHOWN = 5, 8


@dataclass(frozen=True, kw_only=True)
class DetectionTaskSettings:
    """The options of nuScenes' detection task.

    Args:
        classes: The classes that are scored and averaged.
        relabel: Class names that stand for another; a nuScenes category stands for its class anyway.
        ranges: ``"class"``: boxes count within the range of their class; ``"none"``: everywhere.
        absent: Classes of which nothing is annotated count as 0, their errors as 1 (``"zero"``, as in the devkit), or
            are left out of the means.
        thresholds_m: Distance thresholds whose AP is averaged.
        error_threshold_m: At whose matches errors are taken.
        range_bins_m: Edges of the half-open range bins, 2D range.
        max_boxes: Only so many predictions a frame count, the best of all classes.
        racks: Whether bicycles and motorcycles in an annotated rack are left out.
        ties: Order of equal scores: ``"nearest_first"``, or ``"later_first"``, by the file's lines, as in the devkit.
        bootstrap: How intervals are drawn.

    Raises:
        ConfigError: If an option is not one of those possible.
    """

    classes: tuple[str, ...] = tuple(NUSCENES_RANGES_M)
    relabel: Mapping[str, str] = field(default_factory=lambda: dict(NUSCENES_FROM_CIRRUS))
    ranges: Literal["class", "none"] = "class"
    absent: Literal["zero", "left_out"] = "zero"
    thresholds_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    error_threshold_m: float = 2.0
    range_bins_m: tuple[float, ...] = (0.0, 20.0, 30.0, 40.0, 50.0)
    max_boxes: int = 500
    racks: bool = True
    ties: Literal["nearest_first", "later_first"] = "nearest_first"
    bootstrap: Bootstrap = field(default_factory=Bootstrap)

    def __post_init__(self) -> None:
        for name, choices in (
            ("ranges", ("class", "none")),
            ("absent", ("zero", "left_out")),
            ("ties", ("nearest_first", "later_first")),
        ):
            if getattr(self, name) not in choices:
                raise ConfigError(f"{name}: expected one of {', '.join(choices)}, got {getattr(self, name)!r}")
        check_range_bins(self.range_bins_m)
        check_numbers(self)
        if not self.thresholds_m or min(self.thresholds_m) <= 0 or self.error_threshold_m <= 0:
            raise ConfigError(f"thresholds_m: expected positive distances, got {self.thresholds_m}")
        if not self.classes or len(set(self.classes)) < len(self.classes):
            raise ConfigError(f"classes: expected classes, each once, got {', '.join(self.classes) or 'none'}")
        strange = [name for name in self.classes if name not in NUSCENES_RANGES_M]
        if strange and self.ranges == "class":
            raise ConfigError(
                f"classes: expected some of {', '.join(NUSCENES_RANGES_M)}, which have a range, got {strange[0]!r}. "
                "Rename it with --options relabel=NAME:CLASS, or count boxes everywhere: --options ranges=none"
            )
        if self.max_boxes < 1:
            raise ConfigError(f"max_boxes: expected at least 1, got {self.max_boxes}")

    @property
    def all_thresholds_m(self) -> tuple[float, ...]:
        """Thresholds at which boxes are matched."""
        return tuple(dict.fromkeys((*self.thresholds_m, self.error_threshold_m)))

    def range_m(self, name: str) -> float:
        """Within which boxes of a class count."""
        return NUSCENES_RANGES_M[name] if self.ranges == "class" else np.inf

    def to_json(self) -> dict[str, Any]:
        """All options as JSON values."""
        region = "within each class' range" if self.ranges == "class" else "none"
        return json_options(asdict(self)) | {"region": region}

    def convention(self) -> str:
        """The chosen options in one line of ``name=value`` pairs."""
        return option_text({name: v for name, v in self.to_json().items() if name not in ("bootstrap", "region")})


class TaskBoxes(NamedTuple):
    """Boxes of all frames in flat arrays.

    Args:
        boxes: n boxes.
        name: Class of each as the task calls it; empty of those that it does not score.
        frame: Number of each one's frame.
        attribute: Attribute of each, empty where it is not known.
    """

    boxes: Boxes
    name: Shaped[np.ndarray, " n"]
    frame: Int[np.ndarray, " n"]
    attribute: Shaped[np.ndarray, " n"]

    def cut(self, mask: Bool[np.ndarray, " n"]) -> "TaskBoxes":
        """The marked boxes."""
        return TaskBoxes(self.boxes[mask], self.name[mask], self.frame[mask], self.attribute[mask])


@dataclass(frozen=True, eq=False, kw_only=True)
class TaskScene:
    """What is scored: predicted and annotated boxes that count, and how frames are grouped.

    Args:
        predicted: With scores.
        annotated: With points.
        group: Resampling group of each frame.
        grouped_by: ``"sequences"`` or ``"frames"``.
        frames: Number of frames.
        notes: What was left out.
    """

    predicted: TaskBoxes
    annotated: TaskBoxes
    group: Int[np.ndarray, " frames"]
    grouped_by: str
    frames: int
    notes: tuple[str, ...]

    @property
    def n_groups(self) -> int:
        """Number of groups."""
        return int(self.group.max()) + 1 if len(self.group) else 0


def gather_task(detections: Detections, settings: DetectionTaskSettings) -> TaskScene:
    """The boxes that count, of all frames.

    Raises:
        ConfigError: If predictions lack scores, a box has several attributes, or ranges are not known.
    """
    if settings.ranges == "class" and detections.facts.get("ranges") == "not known":
        raise ConfigError(
            "nuscenes-detection: boxes count within 30 to 50 m of the car, and nothing says where it was. Name the "
            "data set's folder in the place of the labels, give ego_translation in one of the files, or take all: "
            "--options ranges=none"
        )
    keys = frames_in_order(detections.boxes, detections.annotations, settings.ties)
    over, sides = 0, ([], [])  # type: tuple[int, tuple[list[TaskBoxes], list[TaskBoxes]]]
    unknown, far, strange = 0, 0, Counter[str]()
    for number, key in enumerate(keys):
        annotation = detections.annotations[key]
        annotated, racks = _annotated(annotation, settings, number)
        predicted = detections.boxes.get(key, _NONE)
        check_scores(predicted)
        details = detections.prediction_details.get(key, {})
        attributes = np.asarray(details.get("attribute", np.full(len(predicted), "")), dtype=np.str_)
        unknown += len(predicted) if "attribute" not in details else 0
        order = nearest_first(predicted) if settings.ties == "nearest_first" else np.arange(len(predicted))
        if len(predicted) > settings.max_boxes and predicted.score is not None:
            best = np.argsort(-predicted.score[order], kind="stable")[: settings.max_boxes]
            over += len(predicted) - settings.max_boxes
            order = order[np.sort(best)]
        boxes = predicted[order]
        names = np.array([settings.relabel.get(str(name), str(name)) for name in boxes.label], dtype=np.str_)
        whole = TaskBoxes(boxes, names, np.full(len(boxes), number), attributes[order])
        sides[0].append(_counting(whole, racks, settings))
        sides[1].append(_counting(annotated, racks, settings))
        strange.update(str(name) for name in annotated.name if name and name not in NUSCENES_RANGES_M)
        far += int((np.isin(annotated.name, settings.classes) & ~_in_range(annotated, settings)).sum())
    group, grouped_by = group_frames(keys, detections.drives)
    predicted_all, annotated_all = (_joined(parts) for parts in sides)
    notes = []
    if over:
        notes.append(
            f"{over} predictions beyond the best {settings.max_boxes} a frame do not count; the devkit refuses"
        )
    strange = Counter({name: count for name, count in strange.items() if name not in settings.classes})
    if strange:
        shown = ", ".join(name for name, _ in strange.most_common(_SHOWN))
        notes.append(f"{strange.total()} annotated boxes of classes that are none of the task's ({shown}) do not count")
    if far:
        notes.append(f"{far} annotated boxes lie beyond the range of their class and do not count")
    if unknown and (annotated_all.attribute != "").any():
        notes.append(f"{unknown} predictions come without attributes: their attribute error is 1")
    if len(annotated_all.name) and not (annotated_all.attribute != "").any():
        notes.append("nothing annotated has an attribute: the attribute error counts as 1, as in the devkit")
    return TaskScene(
        predicted=predicted_all,
        annotated=annotated_all,
        group=group,
        grouped_by=grouped_by,
        frames=len(keys),
        notes=tuple(notes),
    )


_NONE = Boxes.empty(scored=True)


def _annotated(annotation: Annotation, settings: DetectionTaskSettings, number: int) -> tuple[TaskBoxes, Boxes]:
    """The annotated boxes with the task's names, empty of those without points, and the racks."""
    boxes = annotation.boxes
    original = list(annotation.original_label) if annotation.original_label is not None else list(boxes.label)
    pairs = zip(original, boxes.label, strict=True)
    names = np.array([_task_name(name, str(label), settings) for name, label in pairs], dtype=np.str_)
    racks = boxes[np.array([name == _RACK for name in original], dtype=bool)]
    if boxes.point_count is not None:
        radar = np.asarray(annotation.details.get("radar_points", np.zeros(len(boxes), np.int64)))
        names = np.where(boxes.point_count + np.maximum(radar, 0) == 0, "", names) if len(boxes) else names
    attribute = np.asarray(annotation.details.get("attribute", np.full(len(boxes), "")), dtype=np.str_)
    several = [str(text) for text, name in zip(attribute, names, strict=True) if "," in str(text) and name]
    if several:
        raise ConfigError(f"nuscenes-detection: expected at most one attribute of an annotated box, got {several[0]}")
    order = nearest_first(boxes) if settings.ties == "nearest_first" else np.arange(len(boxes))
    return TaskBoxes(boxes[order], names[order], np.full(len(boxes), number), attribute[order]), racks


def _task_name(original: str, label: str, settings: DetectionTaskSettings) -> str:
    if original in CIRRUS_FROM_NUSCENES and original not in NUSCENES_DETECTION_CLASSES:
        return ""  # a category that the task does not score
    name = NUSCENES_DETECTION_CLASSES.get(original, settings.relabel.get(label, label))
    return settings.relabel.get(name, name)


def _counting(task: TaskBoxes, racks: Boxes, settings: DetectionTaskSettings) -> TaskBoxes:
    """The boxes of scored classes, in range and outside racks."""
    if not len(task.boxes):
        return task
    mask = _in_range(task, settings)
    if settings.racks and len(racks):
        inside = np.zeros(len(mask), dtype=bool)
        for rows in points_in_boxes(task.boxes.centre_m, racks):
            inside[rows] = True
        mask &= ~(inside & np.isin(task.name, _IN_RACKS))
    return task.cut(mask)


def _in_range(task: TaskBoxes, settings: DetectionTaskSettings) -> Bool[np.ndarray, " n"]:
    """Whether boxes are of scored classes and within the range of theirs."""
    limit_m = [settings.range_m(str(name)) if name in settings.classes else -1.0 for name in task.name]
    return np.asarray(np.hypot(task.boxes.centre_m[:, 0], task.boxes.centre_m[:, 1]) < np.array(limit_m))


def _joined(parts: Sequence[TaskBoxes]) -> TaskBoxes:
    """Parts one after another, with what matching and errors read of the boxes."""
    filled = [part for part in parts if len(part.boxes)]
    if not filled:
        return TaskBoxes(_NONE, np.zeros(0, "<U1"), np.zeros(0, np.int64), np.zeros(0, "<U1"))
    boxes = [part.boxes for part in filled]
    scored = all(entry.score is not None for entry in boxes)
    joined = Boxes(
        centre_m=np.concatenate([entry.centre_m for entry in boxes]),
        size_m=np.concatenate([entry.size_m for entry in boxes]),
        yaw_rad=np.concatenate([entry.yaw_rad for entry in boxes]),
        label=np.concatenate([entry.label for entry in boxes]),
        score=np.concatenate([entry.score for entry in boxes if entry.score is not None]) if scored else None,
        velocity_m_s=np.concatenate([_velocity(entry) for entry in boxes]),
    )
    names, frames, attributes = (np.concatenate([part[column] for part in filled]) for column in (1, 2, 3))
    return TaskBoxes(joined, names, frames, attributes)


def _velocity(boxes: Boxes) -> Float[np.ndarray, "n 2"]:
    return np.full((len(boxes), 2), np.nan) if boxes.velocity_m_s is None else boxes.velocity_m_s[:, :2]


@dataclass(frozen=True, eq=False, kw_only=True)
class TaskPart:
    """One part (the whole, or a range bin): rankings and errors by class.

    Args:
        ranking: By class and threshold.
        error: By class and error, of the matches in rank order.
        annotated: Number of annotated boxes by class.
        predicted: Number of predictions by class.
    """

    ranking: dict[str, dict[float, Ranking]]
    error: dict[str, dict[str, Float[np.ndarray, " h"]]]
    annotated: dict[str, int]
    predicted: dict[str, int]


def rank_task(scene: TaskScene, settings: DetectionTaskSettings) -> dict[str, TaskPart]:
    """The rankings of the whole, ``"overall"``, and of each range bin; bins are cut out and matched by themselves."""
    parts = {"overall": _rank(scene, scene.predicted, scene.annotated, settings)}
    for low_m, high_m in pairwise(settings.range_bins_m):
        sides = []
        for side in (scene.predicted, scene.annotated):
            range_m = np.hypot(side.boxes.centre_m[:, 0], side.boxes.centre_m[:, 1])
            sides.append(side.cut((range_m >= low_m) & (range_m < high_m)))
        parts[f"{low_m:g}-{high_m:g}"] = _rank(scene, sides[0], sides[1], settings)
    return parts


def _rank(scene: TaskScene, predicted: TaskBoxes, annotated: TaskBoxes, settings: DetectionTaskSettings) -> TaskPart:
    rankings, errors = {}, {}
    for name in settings.classes:
        own, real = predicted.cut(predicted.name == name), annotated.cut(annotated.name == name)
        rankings[name], errors[name] = _rank_class(scene, own, real, settings, name)
    return TaskPart(
        ranking=rankings,
        error=errors,
        annotated={name: int(np.count_nonzero(annotated.name == name)) for name in settings.classes},
        predicted={name: int(np.count_nonzero(predicted.name == name)) for name in settings.classes},
    )


def _rank_class(
    scene: TaskScene, predicted: TaskBoxes, annotated: TaskBoxes, settings: DetectionTaskSettings, name: str
) -> tuple[dict[float, Ranking], dict[str, Float[np.ndarray, " h"]]]:
    score = np.zeros(0) if predicted.boxes.score is None else predicted.boxes.score
    order = rank_predictions(score, predicted.frame, ties=settings.ties)
    thresholds_m = settings.all_thresholds_m
    assigned = greedy_match(
        predicted.boxes.centre_m[:, :2],
        predicted.frame,
        order,
        annotated.boxes.centre_m[:, :2],
        annotated.frame,
        Limits(threshold_m=np.array(thresholds_m)),
    )[:, order]
    per_group = np.bincount(scene.group[annotated.frame], minlength=scene.n_groups)
    rankings = {
        threshold_m: Ranking(
            confidence=score[order], is_match=row >= 0, group=scene.group[predicted.frame[order]], annotated=per_group
        )
        for threshold_m, row in zip(thresholds_m, assigned, strict=True)
    }
    row = assigned[thresholds_m.index(settings.error_threshold_m)]
    hits = row >= 0
    return rankings, _pair_errors(predicted, order[hits], annotated, row[hits], half_turns=name == "barrier")


def _pair_errors(
    predicted: TaskBoxes,
    own: Int[np.ndarray, " h"],
    annotated: TaskBoxes,
    real: Int[np.ndarray, " h"],
    *,
    half_turns: bool,
) -> dict[str, Float[np.ndarray, " h"]]:
    """The five errors of matched pairs, NaN where one is not known."""
    boxes, others = predicted.boxes[own], annotated.boxes[real]
    turn = wrap_angle_rad(boxes.yaw_rad - others.yaw_rad)
    turn = (turn + np.pi / 2) % np.pi - np.pi / 2 if half_turns else turn
    expected = annotated.attribute[real]
    right = (predicted.attribute[own] == expected).astype(np.float64)
    return {
        "trans_err": np.linalg.norm((boxes.centre_m - others.centre_m)[:, :2], axis=1),
        "scale_err": 1.0 - aligned_iou(boxes, others, kind="scale"),
        "orient_err": np.abs(turn),
        "vel_err": np.linalg.norm(_velocity(boxes) - _velocity(others), axis=1),
        "attr_err": np.where(expected == "", np.nan, 1.0 - right),
    }


def task_figures(
    parts: Mapping[str, TaskPart],
    settings: DetectionTaskSettings,
    bins: Sequence[str],
    weights: Float[np.ndarray, "r g"],
) -> dict[str, Draws]:
    """All figures of each part, and their mean over some bins, under each row of group weights."""
    named: dict[str, Draws] = {name: part_draws(part, settings, name, weights) for name, part in parts.items()}
    return named | {"mean_of_bins": _mean_of_bins([named[name] for name in bins])}


def _mean_of_bins(bins: Sequence[Draws]) -> Draws:
    return {name: _known_mean([part[name] for part in bins]) for name in (bins[0] if bins else ())}


def part_draws(part: TaskPart, settings: DetectionTaskSettings, name: str, weights: Float[np.ndarray, "r g"]) -> Draws:
    """The figures of a part under each row of group weights, NaN where nothing is annotated."""
    lengths = (len(ranking.confidence) for by_limit in part.ranking.values() for ranking in by_limit.values())
    chunks = [_chunk(part, settings, name, rows) for rows in row_chunks(weights, max(lengths, default=0))]
    return {figure: np.concatenate([chunk[figure] for chunk in chunks]) for figure in chunks[0]}


def _chunk(part: TaskPart, settings: DetectionTaskSettings, name: str, weights: Float[np.ndarray, "r g"]) -> Draws:
    figures: dict[str, Float[np.ndarray, " r"]] = {}
    lists: dict[str, list[Float[np.ndarray, " r"]]] = {figure: [] for figure in ("map", *ERRORS)}
    for label in settings.classes:
        for figure, values in _class_figures(part, settings, label, weights):
            figures[figure] = values
            kind = "map" if figure == f"ap/{label}/mean" else figure.rpartition("/")[2]
            if kind in lists and label not in _left_out(part, settings, name):
                absent = part.annotated[label] == 0
                worst = 0.0 if kind == "map" else 1.0
                lists[kind].append(np.full(len(weights), worst) if absent else values)
    mean_ap = _known_mean(lists["map"], len(weights))
    errors = {figure: _known_mean(lists[figure], len(weights)) for figure in ERRORS}
    scores = [np.where(np.isnan(error), 0.0, np.maximum(1.0 - error, 0.0)) for error in errors.values()]
    nds = (_AP_WEIGHT * mean_ap + np.sum(scores, axis=0)) / (_AP_WEIGHT + len(ERRORS))
    return {"nds": nds, "map": mean_ap, **{f"errors/{figure}": values for figure, values in errors.items()}, **figures}


def _left_out(part: TaskPart, settings: DetectionTaskSettings, name: str) -> set[str]:
    """Classes without an annotated box that are left out of the means: of bins, and of the whole where chosen so."""
    if any(part.annotated.values()) and (name == "overall" and settings.absent == "zero"):
        return set()
    return {label for label, count in part.annotated.items() if count == 0}


def _class_figures(
    part: TaskPart, settings: DetectionTaskSettings, label: str, weights: Float[np.ndarray, "r g"]
) -> Iterator[tuple[str, Float[np.ndarray, " r"]]]:
    precisions = []
    errors: dict[str, Float[np.ndarray, " r"]] = {}
    for threshold_m, ranking in part.ranking[label].items():
        curves = weighted_curves(ranking, weights)
        if threshold_m in settings.thresholds_m:
            precisions.append(average_precisions(curves))
            yield f"ap/{label}/{float(threshold_m)}", precisions[-1]
        if threshold_m == settings.error_threshold_m:
            errors = {
                name: mean_errors(curves, values)
                for name, values in part.error[label].items()
                if name not in WITHOUT.get(label, ())
            }
    yield f"ap/{label}/mean", np.sum(precisions, axis=0) / len(precisions)
    for name, values in errors.items():
        yield f"class_errors/{label}/{name}", values


def _known_mean(values: Sequence[Float[np.ndarray, " r"]], rows: int = 1) -> Float[np.ndarray, " r"]:
    """Mean of figures row by row over those that are known; NaN where none is."""
    if not values:
        return np.full(rows, np.nan)
    stacked = np.stack(values)
    is_known = ~np.isnan(stacked)
    total = np.where(is_known, stacked, 0.0).sum(axis=0)
    count = is_known.sum(axis=0)
    return np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)


def task_parts(scene: TaskScene, settings: DetectionTaskSettings, reach_m: float | None) -> Mapping[str, Any]:
    """For resampling: what gives each part's figures under rows of weights."""
    parts = rank_task(scene, settings)
    named = {name: partial(part_draws, part, settings, name) for name, part in parts.items()}
    reached = bins_of(settings, reach_m)
    return {**named, "mean_of_bins": partial(_bins_draws, {name: parts[name] for name in reached}, settings)}


def _bins_draws(
    bins: Mapping[str, TaskPart], settings: DetectionTaskSettings, weights: Float[np.ndarray, "r g"]
) -> Draws:
    return _mean_of_bins([part_draws(part, settings, name, weights) for name, part in bins.items()])


def bins_of(settings: DetectionTaskSettings, reach_m: float | None) -> list[str]:
    """Names of the bins that begin within the detector's reach."""
    edges = pairwise(settings.range_bins_m)
    return [f"{low_m:g}-{high_m:g}" for low_m, high_m in edges if reach_m is None or low_m < reach_m]
