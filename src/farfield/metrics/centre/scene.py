"""All frames of an evaluation as flat arrays: one class, one region."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.settings import CentreSettings

Key = tuple[str, str]
BoxesByFrame = Mapping[Key, Boxes]


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
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

    def annotated_per_group(self, keep: Bool[np.ndarray, " m"] | None = None) -> Int[np.ndarray, " groups"]:
        """Annotated boxes that count, by group; of those kept only, if a mask is given."""
        counted = ~self.ignored if keep is None else ~self.ignored & keep
        return np.bincount(self.group[self.annotated_frame[counted]], minlength=self.n_groups)

    def cut(self, predicted: Bool[np.ndarray, " n"], annotated: Bool[np.ndarray, " m"]) -> "Scene":
        """Return the scene with the marked boxes only."""
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

    def cut_range(self, low_m: float, high_m: float) -> "Scene":
        """Return the scene with the boxes whose 2D range lies in [low, high)."""
        return self.cut(in_range(self.predicted, low_m, high_m), in_range(self.annotated, low_m, high_m))


def in_range(boxes: Boxes, low_m: float, high_m: float) -> Bool[np.ndarray, " n"]:
    """Which boxes' 2D range lies in [low, high)."""
    range_m = boxes.range_m
    return (range_m >= low_m) & (range_m < high_m)


def gather(predictions: BoxesByFrame, annotations: BoxesByFrame, settings: CentreSettings) -> Scene:
    """Collect one class from all frames and cut it to the region.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame); every frame that counts, the empty ones too.
        settings: The options.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    check_frames(predictions, annotations)
    keys = sorted(annotations, key=frame_order)
    found = [predictions[key] for key in keys if key in predictions]
    found_frame = np.array([i for i, key in enumerate(keys) if key in predictions], dtype=np.int64)
    predicted = flatten(found, scored=True)
    frame = np.repeat(found_frame, [len(part) for part in found]) if found else np.zeros(0, dtype=np.int64)
    keep = _best_of_frame(predicted, frame, settings.max_boxes)
    over_limit = len(predicted) - int(keep.sum())
    keep &= has_label(predicted, settings.label, settings.relabel)
    parts = [annotations[key] for key in keys]
    annotated = flatten(parts, scored=False)
    annotated_frame = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    ignored = np.zeros(len(annotated), dtype=bool)
    for name in settings.ignore:
        ignored |= has_label(annotated, name, settings.relabel)
    counted = has_label(annotated, settings.label, settings.relabel) | ignored
    counted &= _enough_points(annotated, settings.min_points)
    group, grouped_by = group_frames(keys)
    scene = Scene(
        predicted=predicted,
        predicted_frame=frame,
        annotated=annotated,
        annotated_frame=annotated_frame,
        ignored=ignored,
        group=group,
        grouped_by=grouped_by,
        over_limit=over_limit,
    )
    return scene.cut(keep & in_region(predicted, settings), counted & in_region(annotated, settings))


def check_frames(predictions: BoxesByFrame, annotations: BoxesByFrame) -> None:
    """Raise ConfigError if there are predictions in frames that are not annotated."""
    strangers = [key for key in predictions if key not in annotations]
    if strangers:
        raise ConfigError(
            f"predictions: expected frames that are annotated, got {len(strangers)} others, the first "
            f"{strangers[0]}. For a frame annotated as empty give an entry with no boxes."
        )


def flatten(parts: Sequence[Boxes], *, scored: bool) -> Boxes:
    """Join the boxes of many frames; unlike ``Boxes.concatenate`` it drops what a score does not need.

    Raises:
        ConfigError: If scores are asked for and some box has none.
    """
    parts = [part for part in parts if len(part.yaw_rad)]
    if not parts:
        return Boxes.empty(scored=scored)
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("centre_m", "size_m", "yaw_rad", "label")
    }
    if scored:
        if any(part.score is None for part in parts):
            raise ConfigError("predictions: expected a score for every box, got boxes without scores")
        joined["score"] = np.concatenate([part.score for part in parts if part.score is not None])
    elif any(part.point_count is not None for part in parts):
        counts = [np.full(len(part), -1) if part.point_count is None else part.point_count for part in parts]
        joined["point_count"] = np.concatenate(counts)
    return Boxes(**joined)


def has_label(boxes: Boxes, label: str, relabel: Mapping[str, str]) -> Bool[np.ndarray, " n"]:
    """Which boxes bear a label after relabelling."""
    names = [name for name in {label, *relabel} if relabel.get(name, name) == label]
    mask = np.zeros(len(boxes), dtype=bool)
    for name in names:
        mask |= boxes.label == name
    return mask


def group_frames(keys: Sequence[Key]) -> tuple[Int[np.ndarray, " frames"], str]:
    """Group frames by sequence for resampling; each frame for itself where there is only one sequence."""
    number: dict[str, int] = {}
    group = np.array([number.setdefault(sequence, len(number)) for sequence, _ in keys], dtype=np.int64)
    return (group, "sequences") if len(number) > 1 else (np.arange(len(keys)), "frames")


@runtime_checkable
class Region(Protocol):
    """What the settings of every protocol say of the region, see :class:`CentreSettings`."""

    @property
    def region(self) -> Literal["window", "range", "none"]:
        """Which region counts."""

    @property
    def range_bins_m(self) -> tuple[float, ...]:
        """Edges of the range bins."""

    @property
    def window_m(self) -> tuple[float, float, float, float]:
        """Bounds of the window: x from, x to, y from, y to."""


def in_region(boxes: Boxes, settings: Region) -> Bool[np.ndarray, " n"]:
    """Which boxes lie in the region that counts."""
    if settings.region == "none":
        return np.ones(len(boxes), dtype=bool)
    inside = in_range(boxes, settings.range_bins_m[0], settings.range_bins_m[-1])
    if settings.region == "window":
        x_from, x_to, y_from, y_to = settings.window_m
        x, y = boxes.centre_m[:, 0], boxes.centre_m[:, 1]
        inside &= (x >= x_from) & (x <= x_to) & (y >= y_from) & (y <= y_to)
    return inside


def labels_of(parts: Mapping[Key, Boxes], relabel: Mapping[str, str]) -> Iterator[tuple[str, int]]:
    """Class names after relabelling with their numbers of boxes, most frequent first."""
    counts: dict[str, int] = {}
    for boxes in parts.values():
        for name in np.asarray(boxes.label).tolist():
            name = relabel.get(name, name)
            counts[name] = counts.get(name, 0) + 1
    yield from sorted(counts.items(), key=lambda item: (-item[1], item[0]))


def frame_order(key: Key) -> tuple[str, int, int, str]:
    """Sort key of a frame, under which frame "9" stands before frame "10"."""
    sequence, frame = key
    number = frame.isascii() and frame.isdigit() and len(frame) <= 20
    return (sequence, 0, int(frame), frame) if number else (sequence, 1, 0, frame)


def _best_of_frame(boxes: Boxes, frame: Int[np.ndarray, " n"], limit: int) -> Bool[np.ndarray, " n"]:
    keep = np.ones(len(boxes), dtype=bool)
    counts = np.bincount(frame) if len(frame) else np.zeros(0, dtype=np.int64)
    for crowded in np.flatnonzero(counts > limit):
        members = np.flatnonzero(frame == crowded)
        score: Float[np.ndarray, " k"] = boxes.score[members]  # type: ignore[index]
        keep[members[np.argsort(-score, kind="stable")[limit:]]] = False
    return keep


def _enough_points(boxes: Boxes, least: int) -> Bool[np.ndarray, " n"]:
    if least == 0 or len(boxes) == 0:
        return np.ones(len(boxes), dtype=bool)
    if boxes.point_count is None or (boxes.point_count < 0).all():
        raise ConfigError(f"min_points={least}: expected annotated boxes with point counts, got none that has one")
    return (boxes.point_count < 0) | (boxes.point_count >= least)
