"""All frames of an evaluation by centre distance as flat arrays: one class, one region."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.frames import (
    BoxesByFrame,
    check_frames,
    check_scores,
    flatten,
    frame_order,
    group_frames,
    has_label,
    in_range,
    in_region,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class CentreScene:
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

    def cut(self, predicted: Bool[np.ndarray, " n"], annotated: Bool[np.ndarray, " m"]) -> "CentreScene":
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

    def cut_range(self, low_m: float, high_m: float) -> "CentreScene":
        """Return the scene with the boxes whose 2D range lies in [low, high)."""
        return self.cut(in_range(self.predicted, low_m, high_m), in_range(self.annotated, low_m, high_m))


def gather(
    predictions: BoxesByFrame, annotations: BoxesByFrame, settings: CentreSettings, drives: Sequence[Drive] = ()
) -> CentreScene:
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
    counts = np.zeros((3, len(keys)), dtype=np.int64)  # predictions that count, those over the limit, annotated boxes
    predicted = flatten(_that_count(predictions, keys, settings, counts), scored=True)
    annotated = flatten(_every(annotations, keys, counts), scored=False)
    annotated_frame = np.repeat(np.arange(len(keys)), counts[2])
    ignored = np.zeros(len(annotated), dtype=bool)
    for name in settings.ignore:
        ignored |= has_label(annotated, name, settings.relabel)
    counted = has_label(annotated, settings.label, settings.relabel) | ignored
    counted &= _enough_points(annotated, settings.min_points)
    group, grouped_by = group_frames(keys, drives)
    scene = CentreScene(
        predicted=predicted,
        predicted_frame=np.repeat(np.arange(len(keys)), counts[0]),
        annotated=annotated,
        annotated_frame=annotated_frame,
        ignored=ignored,
        group=group,
        grouped_by=grouped_by,
        over_limit=int(counts[1].sum()),
    )
    return scene.cut(np.ones(len(predicted), dtype=bool), counted & in_region(annotated, settings))


def _that_count(
    predictions: BoxesByFrame, keys: Sequence[Key], settings: CentreSettings, counts: Int[np.ndarray, "3 frames"]
) -> Iterator[Boxes]:
    """The predictions of each frame that count, and how many those are and how many were over the limit."""
    for place, key in enumerate(keys):
        if key in predictions:
            boxes = predictions[key]
            check_scores(boxes)
            keep = _best(boxes, settings.max_boxes)
            counts[1, place] = len(boxes) - np.count_nonzero(keep)
            keep &= has_label(boxes, settings.label, settings.relabel) & in_region(boxes, settings)
            counts[0, place] = np.count_nonzero(keep)
            yield boxes[keep]


def _every(annotations: BoxesByFrame, keys: Sequence[Key], counts: Int[np.ndarray, "3 frames"]) -> Iterator[Boxes]:
    for place, key in enumerate(keys):
        boxes = annotations[key]
        counts[2, place] = len(boxes)
        yield boxes


def _best(boxes: Boxes, limit: int) -> Bool[np.ndarray, " n"]:
    """Which boxes of a frame are among its best by score."""
    keep = np.ones(len(boxes), dtype=bool)
    if len(boxes) > limit and boxes.score is not None:
        keep[np.argsort(-boxes.score, kind="stable")[limit:]] = False
    return keep


def _enough_points(boxes: Boxes, least: int) -> Bool[np.ndarray, " n"]:
    if least == 0 or len(boxes) == 0:
        return np.ones(len(boxes), dtype=bool)
    if boxes.point_count is None or (boxes.point_count < 0).all():
        raise ConfigError(f"min_points={least}: expected annotated boxes with point counts, got none that has one")
    return (boxes.point_count < 0) | (boxes.point_count >= least)
