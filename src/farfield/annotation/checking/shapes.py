"""Checks of one box by itself, and of the boxes of a frame among each other."""

import math
from collections import Counter
from collections.abc import Iterator

import numpy as np

from farfield.annotation.checking.contract import (
    Boxes,
    CheckedFrame,
    CheckSettings,
    LabelIssue,
    Severity,
    SizeRange,
)
from farfield.datasets.labels import BoxLabel, Numbers
from farfield.geometry.boxes import Boxes as BoxSet
from farfield.geometry.iou import pairwise_iou


def finding(scene: CheckedFrame, label: BoxLabel, check: str, severity: Severity, sentence: str) -> LabelIssue:
    """A finding about a box."""
    place = (label.box[0], label.box[1])
    return LabelIssue(
        check=check, severity=severity, sentence=sentence, frame=scene.key, box=label.id, track=label.track, place=place
    )


def is_sound(box: Numbers) -> bool:
    """Whether a box can be reckoned with: finite, with positive sizes."""
    return all(map(math.isfinite, box)) and min(box[3:6]) > 0


def broken(boxes: Boxes, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Boxes that cannot be: not finite, without a size, or where no sensor sees."""
    for label in boxes:
        if not is_sound(label.box):
            sentence = f"{label.label}: size or place is not a number, or a size is not positive."
            yield LabelIssue(
                check="broken", severity="error", sentence=sentence, frame=scene.key, box=label.id, track=label.track
            )
            continue
        x, y = label.box[:2]
        range_m = math.hypot(x, y)
        if range_m > settings.farthest_m:
            yield finding(
                scene, label, "broken", "error", f"{label.label}: {range_m:.0f} m away, farther than can be seen."
            )
        elif settings.views and not any(view.sees(x, y) for view in settings.views):
            sensors = ", ".join(view.sensor for view in settings.views)
            yield finding(scene, label, "broken", "error", f"{label.label}: outside what {sensors} can see.")


def sizes(boxes: Boxes, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Sizes that the class seldom or never has."""
    for label in boxes:
        known = settings.sizes.get(label.label)
        if known is None:
            continue
        fault = _size_fault(label.box[3:6], known, settings.size_ratio)
        if fault:
            yield finding(scene, label, "size", "warning", f"{label.label}: {fault}")


_AXES = ("length", "width", "height")


def _size_fault(size: tuple[float, ...], known: SizeRange, most: float) -> str:
    kinds = (known.usual, *known.types)
    fits = any(all(1 / most <= a / b <= most for a, b in zip(size, kind, strict=True)) for kind in kinds)
    for axis, name in enumerate(_AXES):
        ratio = size[axis] / known.usual[axis]
        if not fits and not 1 / most <= ratio <= most:
            return f"{name} {size[axis]:.2f} m is {ratio:.1f} times the usual {known.usual[axis]:.2f} m."
        low, high = (None if known.low is None else known.low[axis]), (None if known.high is None else known.high[axis])
        if (low is not None and size[axis] < low) or (high is not None and size[axis] > high):
            beyond = "below" if low is not None and size[axis] < low else "above"
            return f"{name} {size[axis]:.2f} m is {beyond} that of 99.5 % of the set."
    return "" if fits else f"{size[0]:.1f} x {size[1]:.1f} x {size[2]:.1f} m is the size of none of its kinds."


def overlaps(boxes: Boxes, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Boxes that stand in each other, seen from above: one finding a pair, at the later of the two."""
    if len(boxes) < 2:
        return
    iou = np.triu(pairwise_iou(as_set(boxes), as_set(boxes), kind="bev"), 1)
    for row, column in np.argwhere(iou > settings.overlap_iou).tolist():
        first, second, shared = boxes[row], boxes[column], iou[row, column]
        twice = shared > settings.duplicate_iou
        words = "are one object twice" if twice else "stand in each other"
        sentence = f"{second.label} {second.track} and {first.label} {first.track} {words} (IoU {shared:.2f})."
        yield finding(scene, second, "overlap", "error" if twice else "warning", sentence)


def as_set(boxes: Boxes) -> BoxSet:
    """Labels as boxes."""
    table = np.array([label.box for label in boxes], dtype=np.float64).reshape(-1, 7)
    names = [label.label for label in boxes]
    return BoxSet(centre_m=table[:, :3], size_m=table[:, 3:6], yaw_rad=table[:, 6], label=names)


def twice(boxes: Boxes, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Two boxes of one frame with the same track ID and class; reported for all but the first."""
    del settings
    counts: Counter[tuple[str, str]] = Counter()
    for label in boxes:
        counts[label.track, label.label] += 1
        if label.track and counts[label.track, label.label] > 1:
            sentence = f"{label.label} {label.track} is there twice in this frame."
            yield finding(scene, label, "twice", "error", sentence)
