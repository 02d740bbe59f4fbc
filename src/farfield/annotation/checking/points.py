"""Checks of boxes against the points: on the ground, not empty, nothing of the object left outside."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from farfield.annotation.checking.contract import Boxes, CheckedFrame, CheckSettings, LabelIssue
from farfield.annotation.checking.scene import Points, Surroundings, beyond_m, in_box_axes
from farfield.annotation.checking.shapes import finding
from farfield.datasets.labels import BoxLabel

ABOVE_GROUND_M = 0.25
FEWEST_OF_OBJECT, FEWEST_OUTSIDE = 10, 5
REACH_M, MARGIN_M = 1.0, 0.05
TALLER, TALL_M = 0.1, 1.5
"""Boxes of tall objects are drawn with more room: a tenth of what they are taller than 1.5 m is let stand."""
FACE_M = 0.1
"""So near a face, points are its own: range noise and a careful hand leave as much."""


def points(boxes: Boxes, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """All checks against the points of the frame."""
    if scene.around is None:
        return
    for label in boxes:
        local = _near(label, scene.around)
        beyond = beyond_m(local, label.box)
        height = scene.around.ground_m(label.box)
        ground = None if height is None else height - label.box[2]
        yield from _standing(label, ground, scene, settings)
        near = local[beyond <= settings.ring_m]
        beyond = beyond[beyond <= settings.ring_m]
        inside = (beyond <= MARGIN_M) & (np.abs(near[:, 2]) <= label.box[5] / 2 + MARGIN_M)
        count = int(inside.sum())
        yield from _empty(label, count, scene, settings)
        if settings.extent == "full":
            left = _left(label, near[beyond > FACE_M, 2], ground)
            yield from _outside(label, left, count, scene, settings)


def _near(label: BoxLabel, around: Surroundings) -> Points:
    reach_m = float(np.hypot(*label.box[3:5])) / 2 + REACH_M
    return in_box_axes(around.near(label.box[0], label.box[1], reach_m), label.box)


def _standing(
    label: BoxLabel, ground: float | None, scene: CheckedFrame, settings: CheckSettings
) -> Iterator[LabelIssue]:
    if ground is None:
        return
    bottom = -label.box[5] / 2
    most_m = settings.ground_m + TALLER * max(label.box[5] - TALL_M, 0.0)
    if ground > 0:
        yield finding(scene, label, "ground", "error", f"{label.label}: more than half of it is in the ground.")
    elif ground - bottom > most_m:
        yield finding(scene, label, "ground", "warning", f"{label.label}: {ground - bottom:.1f} m in the ground.")
    elif bottom - ground > most_m:
        yield finding(scene, label, "ground", "warning", f"{label.label}: {bottom - ground:.1f} m above the ground.")


def _empty(label: BoxLabel, count: int, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    if label.source == "radar":
        return
    if count == 0:
        sentence = f"{label.label}: no LiDAR point in it; if only the radar sees it, set its source to radar."
        yield finding(scene, label, "empty", "warning", sentence)
    elif count < settings.fewest_points:
        yield finding(scene, label, "empty", "info", f"{label.label}: {count} LiDAR points in it.")


def _left(label: BoxLabel, heights: Float[np.ndarray, " n"], ground: float | None) -> int:
    """How many points just outside a box are neither the ground's nor above it; 0 where the ground is not known."""
    if ground is None:
        return 0
    half = label.box[5] / 2
    return int(((heights > max(ground + ABOVE_GROUND_M, -half)) & (heights < half)).sum())


def _outside(
    label: BoxLabel, left: int, count: int, scene: CheckedFrame, settings: CheckSettings
) -> Iterator[LabelIssue]:
    if left >= FEWEST_OUTSIDE and left + count >= FEWEST_OF_OBJECT and left > settings.ring_share * count:
        sentence = f"{label.label}: {left} points just outside it, {count} inside: is it large enough?"
        yield finding(scene, label, "outside", "warning", sentence)
