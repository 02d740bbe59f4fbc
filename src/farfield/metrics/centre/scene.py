"""All frames of an evaluation by centre distance as flat arrays: one class, one region."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive
from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.frames import (
    BoxesByFrame,
    check_frames,
    flatten,
    frame_order,
    group_frames,
    has_label,
    in_range,
    in_region,
)


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


def gather(
    predictions: BoxesByFrame, annotations: BoxesByFrame, settings: CentreSettings, drives: Sequence[Drive] = ()
) -> Scene:
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
    group, grouped_by = group_frames(keys, drives)
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
