"""All frames of a K-Radar evaluation as flat arrays: every overlap is computed once and serves every subset."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import bev_intersection_m2
from farfield.metrics.frames import (
    BoxesByFrame,
    check_frames,
    flatten,
    frame_order,
    group_frames,
    has_label,
    near_pairs,
    nearest_first,
)
from farfield.metrics.kradar.settings import KRadarSettings
from farfield.vocabulary.counts import count_of

Visibility = Mapping[Key, Sequence[str]]


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoredBoxes:
    """Predicted or annotated boxes of the scored classes, ordered by frame and class, then as the settings say.

    Args:
        box: x, y, z (radar's frame), length, width, height, yaw, shape (n, 7).
        frame: Frame number, shape (n,).
        kind: Place of the class among the settings' classes, shape (n,).
        range_m: Distance from the radar in the x-y plane, shape (n,).
        score: Scores, shape (n,); zeros for annotated boxes.
        seen_by: Which sensors see an annotated box, shape (n,); empty where unknown.
    """

    box: Float[np.ndarray, "n 7"]
    frame: Int[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]
    seen_by: np.ndarray

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, index: Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "ScoredBoxes":
        return ScoredBoxes(
            box=self.box[index],
            frame=self.frame[index],
            kind=self.kind[index],
            range_m=self.range_m[index],
            score=self.score[index],
            seen_by=self.seen_by[index],
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class KRadarFrames:
    """All frames as flat arrays; pairs are those of one frame and class whose boxes can touch.

    Args:
        keys: (sequence, frame) of every frame.
        counted: Frames that count, shape (f,).
        predicted: The predictions.
        annotated: The annotated boxes.
        pair: Annotated and predicted box, shape (p, 2), sorted by both.
        overlap: Overlap of the pairs by measure, ``"3d"`` and ``"bev"``, each of shape (p,).
        group: Resampling group of each frame, shape (f,).
        grouped_by: ``"sequences"`` or ``"frames"``.
        cut: Predictions that are not above the score cut.
    """

    keys: list[Key]
    counted: Bool[np.ndarray, " f"]
    predicted: ScoredBoxes
    annotated: ScoredBoxes
    pair: Int[np.ndarray, "p 2"]
    overlap: dict[str, Float[np.ndarray, " p"]]
    group: Int[np.ndarray, " f"]
    grouped_by: str
    cut: int

    @property
    def groups(self) -> int:
        """Number of resampling groups."""
        return int(self.group.max()) + 1 if len(self.group) else 0


def gather_kradar(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KRadarSettings,
    visibility: Visibility | None,
    drives: Sequence[Drive] = (),
) -> KRadarFrames:
    """Collect the classes from all frames; the arguments are those of ``evaluate_kradar``.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, lack scores, or the visibility does not fit.
    """
    check_frames(predictions, annotations)
    keys = sorted(annotations, key=frame_order)
    frame_predictions, frame_annotations = (
        [predictions.get(key, _NONE) for key in keys],
        [annotations[key] for key in keys],
    )
    annotated = _side(frame_annotations, settings, seen_by=_seen_by(keys, frame_annotations, visibility), scored=False)
    predicted = _side(frame_predictions, settings, seen_by=None, scored=True)
    annotated = annotated[_inside(annotated, settings)]
    if settings.outside == "dropped":
        predicted = predicted[_inside(predicted, settings)]
    above = predicted.score > settings.score_cut
    cut = int((~above).sum())
    predicted = predicted[above]
    counted = np.ones(len(keys), dtype=bool)
    if settings.empty_frames == "dropped":
        counted = np.bincount(annotated.frame, minlength=len(keys)) > 0
        predicted = predicted[counted[predicted.frame]]
    classes = len(settings.classes)
    pair, _ = near_pairs(
        annotated.frame * classes + annotated.kind,
        predicted.frame * classes + predicted.kind,
        len(keys) * classes,
        partial(_nearness, annotated.box, predicted.box),
        lambda owner: keys[owner // classes],
    )
    group, grouped_by = group_frames(keys, drives)
    return KRadarFrames(
        keys=keys,
        counted=counted,
        predicted=predicted,
        annotated=annotated,
        pair=pair,
        overlap=_overlaps(_written(annotated.box, settings), predicted.box, pair, settings),
        group=group,
        grouped_by=grouped_by,
        cut=cut,
    )


_NONE = Boxes.empty(scored=True)


def _side(parts: list[Boxes], settings: KRadarSettings, *, seen_by: np.ndarray | None, scored: bool) -> ScoredBoxes:
    boxes = flatten(parts, scored=scored)
    kind = np.full(len(boxes), -1)
    for number, name in enumerate(settings.classes):
        kind[has_label(boxes, name, settings.relabel)] = number
    frame = np.repeat(np.arange(len(parts)), [len(part.yaw_rad) for part in parts])
    rows = np.flatnonzero(kind >= 0)
    if settings.boxes_in == "os2-64":
        boxes = boxes.replace(centre_m=boxes.centre_m - np.array(settings.origin_m))
    owner = frame[rows] * len(settings.classes) + kind[rows]
    nearest = settings.order == "nearest_first"
    rows = rows[nearest_first(boxes[rows], owner) if nearest else np.argsort(owner, kind="stable")]
    centre_m = boxes.centre_m[rows]
    box = np.column_stack([centre_m, boxes.size_m[rows], boxes.yaw_rad[rows]])
    return ScoredBoxes(
        box=box,
        frame=frame[rows],
        kind=kind[rows],
        range_m=np.hypot(box[:, 0], box[:, 1]),
        score=np.zeros(len(rows)) if boxes.score is None else boxes.score[rows],
        seen_by=np.full(len(rows), "") if seen_by is None else seen_by[rows],
    )


def _inside(side: ScoredBoxes, settings: KRadarSettings) -> Bool[np.ndarray, " n"]:
    bounds_m = settings.bounds_m
    if bounds_m is None:
        return np.ones(len(side), dtype=bool)
    centre_m = side.box[:, :3]
    inside = np.all((centre_m >= bounds_m[::2]) & (centre_m <= bounds_m[1::2]), axis=1)
    if settings.azimuth_deg is not None:
        inside &= np.abs(np.arctan2(centre_m[:, 1], centre_m[:, 0])) <= math.radians(settings.azimuth_deg)
    return inside


def _written(box: Float[np.ndarray, "n 7"], settings: KRadarSettings) -> Float[np.ndarray, "n 7"]:
    """The annotated boxes as the kit's text files hold them: rounded, the yaw as it is written there.

    A correct yaw is brought to [-pi, pi) before it is rounded, as in what the parity figures were made of: of -pi the
    text holds 1.57 and not -4.71, which are 0.003 rad apart once 2 pi is added.
    """
    if settings.decimals is None:
        return box
    written = box.copy()
    turn = math.pi / 2 if settings.yaw == "correct" else 0.0
    if turn:
        written[:, 6] = np.mod(written[:, 6] - turn + math.pi, 2 * math.pi) - math.pi
    written = np.round(written, settings.decimals)
    written[:, 6] += turn
    return written


def _nearness(
    annotated: Float[np.ndarray, "n 7"], predicted: Float[np.ndarray, "m 7"], pair: Int[np.ndarray, "p 2"]
) -> Float[np.ndarray, " p"]:
    """By how much the circumscribed circles of each pair meet, squared metres; rounding may bring boxes 1 cm closer."""
    a, b = annotated[pair[:, 0]], predicted[pair[:, 1]]
    reach_m = (np.hypot(a[:, 3], a[:, 4]) + np.hypot(b[:, 3], b[:, 4])) / 2
    return (reach_m + 0.1) ** 2 - ((a[:, :2] - b[:, :2]) ** 2).sum(axis=1)


def _overlaps(
    annotated: Float[np.ndarray, "n 7"],
    predicted: Float[np.ndarray, "m 7"],
    pair: Int[np.ndarray, "p 2"],
    settings: KRadarSettings,
) -> dict[str, Float[np.ndarray, " p"]]:
    """Overlap of the pairs in the x-y plane and in space, from one clipping of the rectangles."""
    a, b = annotated[pair[:, 0]], predicted[pair[:, 1]]
    bev_columns = [0, 1, 3, 4, 6]
    turn = math.pi / 2 if settings.yaw == "as_shipped" else 0.0
    shift = np.array([0.0, 0.0, 0.0, 0.0, turn])
    shared = bev_intersection_m2(a[:, bev_columns] + shift, b[:, bev_columns] + shift)
    top = np.minimum(*(side[:, 2] + side[:, 5] * (1 - settings.z_center) for side in (a, b)))
    bottom = np.maximum(*(side[:, 2] - side[:, 5] * settings.z_center for side in (a, b)))
    height = np.clip(top - bottom, 0.0, np.minimum(a[:, 5], b[:, 5]))
    area_a, area_b = a[:, 3] * a[:, 4], b[:, 3] * b[:, 4]
    return {
        "3d": _ratio(shared * height, area_a * a[:, 5] + area_b * b[:, 5]),
        "bev": _ratio(shared, area_a + area_b),
    }


def _ratio(shared: Float[np.ndarray, " p"], both: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
    union = both - shared
    return np.clip(np.divide(shared, union, out=np.zeros_like(shared), where=union > 0), 0.0, 1.0)


def _seen_by(keys: list[Key], boxes: list[Boxes], visibility: Visibility | None) -> np.ndarray | None:
    if visibility is None:
        return None
    names: list[str] = []
    for key, part in zip(keys, boxes, strict=True):
        visible = visibility.get(key, ("",) * len(part))
        if len(visible) != len(part):
            raise ConfigError(
                f"visibility[{key}]: expected one word for each of "
                f"{count_of(len(part), 'box', 'boxes')}, got {len(visible)}"
            )
        names.extend(visible)
    return np.array(names, dtype=np.str_)
