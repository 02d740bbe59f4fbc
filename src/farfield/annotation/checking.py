"""Checks of annotated boxes: pure functions, quick enough to run at every edit.

:func:`check` runs all of them over a frame: boxes that cannot be, sizes, overlaps, doubles, tracks over the frames
around, points of the LiDAR, and what a detector sees.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.annotation.motion import turn_angle
from farfield.annotation.surroundings import Surroundings, beyond_m, in_box_axes
from farfield.datasets.labels import BoxLabel, Numbers
from farfield.frame import Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.vocabulary.counts import count_of

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True, kw_only=True)
class LabelIssue:
    """Something that a person should look at.

    Args:
        check: Which check, one of :data:`~farfield.annotation.checking.CHECKS`.
        severity: ``error``: cannot be right; ``warning``: is seldom right; ``info``: worth a look.
        sentence: What is the matter, for people.
        frame: The frame to jump to.
        box: The box, or None where it is one that is missing.
        track: Its track; empty where it has none.
        xy_m: Where it is, x and y in the frame, metres: the view goes there.
        ignored: Why a person lets it stand; None where nobody does.
    """

    check: str
    severity: Severity
    sentence: str
    frame: Key
    box: str | None
    track: str = ""
    xy_m: tuple[float, float] | None = None
    ignored: str | None = None

    @property
    def id(self) -> str:
        """The finding's name, the same as long as the check finds it."""
        where = "" if self.xy_m is None else f"{self.xy_m[0]:.0f},{self.xy_m[1]:.0f}"
        return "/".join((self.check, *self.frame, f"at {where}" if self.box is None else self.box))


class SizeRange(NamedTuple):
    """Sizes of a class: length, width, height, metres.

    Args:
        usual: The median or preset.
        low: What 0.5 % of the set's boxes lie below; None: not known.
        high: What 0.5 % lie above; None: not known.
        types: Usual sizes of kinds within the class.
    """

    usual: tuple[float, float, float]
    low: tuple[float, float, float] | None = None
    high: tuple[float, float, float] | None = None
    types: tuple[tuple[float, float, float], ...] = ()


class SensorView(NamedTuple):
    """What a sensor sees.

    Args:
        sensor: Its name.
        range_m: How far.
        left_rad: Azimuth of the left edge, counter-clockwise from +x.
        right_rad: Azimuth of the right edge; the view goes counter-clockwise from here to the left edge.
    """

    sensor: str
    range_m: float
    left_rad: float = math.pi
    right_rad: float = -math.pi

    def sees(self, x: float, y: float) -> bool:
        """Whether a place is in the view."""
        full_turn = self.left_rad - self.right_rad >= 2 * math.pi
        inside = (math.atan2(y, x) - self.right_rad) % (2 * math.pi) <= (self.left_rad - self.right_rad) % (2 * math.pi)
        return math.hypot(x, y) <= self.range_m and (full_turn or inside)


class TrackStep(NamedTuple):
    """A box of a track in one frame.

    Args:
        row: The frame's row in its drive.
        time_s: When.
        box: The box: in the world where the drive has poses, else as the frame has it.
    """

    row: int
    time_s: float
    box: Numbers


class NearbyTrack(NamedTuple):
    """A track near the frame that is checked.

    Args:
        steps: Boxes of the frames around, in the order of time, one a frame.
        frames: In how many frames the track is.
        posed: Whether the boxes stand in the world.
        locked: Whether its size is locked.
    """

    steps: Sequence[TrackStep]
    frames: int
    posed: bool = False
    locked: bool = False


class DetectorBox(NamedTuple):
    """A detector's box.

    Args:
        label: Its class as the data set spells it, or as the detector does.
        box: The box.
        score: Its score.
    """

    label: str
    box: Numbers
    score: float


@dataclass(frozen=True, kw_only=True)
class CheckedFrame:
    """The frame that is checked.

    Args:
        key: The frame.
        row: Its row in its drive.
        around: Its LiDAR points, sorted for quick look-up; None: points are not looked at.
        detections: What a detector found, if one was run.
        before: Issues of an earlier check: those against the points still stand where ``around`` is None.
    """

    key: Key
    row: int = 0
    around: Surroundings | None = None
    detections: Sequence[DetectorBox] = ()
    before: Sequence[LabelIssue] = ()


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """From where on something is found; what the defaults make of K-Radar's labels v2.1 stands in docs/studio.md.

    Args:
        sizes: Sizes by class; classes that are not in it have none.
        fastest_m_s: Speeds over ground that are not believed, by class; others: 60 m/s.
        extent: ``full``: boxes are whole bodies; ``visible``: what is seen of them (no check of the points around).
        views: What the sensors see; none: boxes may stand anywhere within ``farthest_m``.
        farthest_m: Distance beyond which nothing can be.
    """

    sizes: Mapping[str, SizeRange] = field(default_factory=dict)
    fastest_m_s: Mapping[str, float] = field(default_factory=dict)
    extent: Literal["full", "visible"] = "full"
    views: Sequence[SensorView] = ()
    farthest_m: float = 300.0
    size_ratio: float = 2.0
    track_size: float = 0.05
    track_size_far: float = 0.20
    turn_rad: float = math.radians(20.0)
    flip_rad: float = math.radians(135.0)
    jump_m: float = 1.0
    jump_far_m: float = 2.0
    overlap_iou: float = 0.05
    duplicate_iou: float = 0.3
    longest_gap: int = 5
    shortest_track: int = 3
    ground_m: float = 0.35
    fewest_points: int = 3
    ring_m: float = 0.3
    ring_share: float = 0.2
    detector_score: float = 0.5
    detector_iou: float = 0.5


Labels = Sequence[BoxLabel]

CHECKS = (
    "broken",
    "size",
    "overlap",
    "twice",
    "track_size",
    "turn",
    "jump",
    "speed",
    "gap",
    "short",
    "ground",
    "empty",
    "outside",
    "detector",
)
"""Names of the checks."""
POINT_CHECKS = ("ground", "empty", "outside")
"""Those that look at the points of the frame."""
_SEVERITIES = ("error", "warning", "info")


def check(
    boxes: Labels,
    frame: CheckedFrame,
    track: Mapping[str, NearbyTrack],
    settings: CheckSettings,
    *,
    ignored: Mapping[str, str] | None = None,
) -> list[LabelIssue]:
    """What a person should look at in a frame, errors first.

    Args:
        boxes: The frame's boxes that stand (no rejected proposals).
        frame: The frame: points, detections.
        track: The tracks in it, over the frames around.
        settings: Limits and usual sizes.
        ignored: Reasons by finding (its ``id``) that people gave for letting one stand; those come last.
    """
    valid = [label for label in boxes if is_valid(label.box)]
    issues = chain(
        impossible_boxes(boxes, frame, settings),
        unusual_sizes(valid, frame, settings),
        overlaps(valid, frame, settings),
        duplicate_tracks(boxes, frame, settings),
        track_checks(valid, frame, track, settings),
        point_checks(valid, frame, settings),
        disagreements(valid, frame, settings),
    )
    reasons = ignored or {}
    explained = [replace(issue, ignored=reasons.get(issue.id)) for issue in issues]
    return sorted(explained, key=_rank)


def _rank(finding: LabelIssue) -> tuple[bool, int]:
    return finding.ignored is not None, _SEVERITIES.index(finding.severity)


# One box by itself, and the boxes of a frame among each other


def box_issue(scene: CheckedFrame, label: BoxLabel, check: str, severity: Severity, sentence: str) -> LabelIssue:
    """A finding about a box."""
    xy_m = (label.box[0], label.box[1])
    return LabelIssue(
        check=check, severity=severity, sentence=sentence, frame=scene.key, box=label.id, track=label.track, xy_m=xy_m
    )


def is_valid(box: Numbers) -> bool:
    """Whether a box can be reckoned with: finite, with positive sizes."""
    return all(map(math.isfinite, box)) and min(box[3:6]) > 0


def impossible_boxes(boxes: Labels, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Labels that cannot be: not finite, without a size, or where no sensor sees."""
    for label in boxes:
        if not is_valid(label.box):
            sentence = f"{label.label}: size or place is not a number, or a size is not positive."
            yield LabelIssue(
                check="broken", severity="error", sentence=sentence, frame=scene.key, box=label.id, track=label.track
            )
            continue
        x, y = label.box[:2]
        range_m = math.hypot(x, y)
        if range_m > settings.farthest_m:
            yield box_issue(
                scene, label, "broken", "error", f"{label.label}: {range_m:.0f} m away, farther than can be seen."
            )
        elif settings.views and not any(view.sees(x, y) for view in settings.views):
            sensors = ", ".join(view.sensor for view in settings.views)
            yield box_issue(scene, label, "broken", "error", f"{label.label}: outside what {sensors} can see.")


def unusual_sizes(boxes: Labels, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Sizes that the class seldom or never has."""
    for label in boxes:
        range_of_class = settings.sizes.get(label.label)
        if range_of_class is None:
            continue
        fault = _size_fault(label.box[3:6], range_of_class, settings.size_ratio)
        if fault:
            yield box_issue(scene, label, "size", "warning", f"{label.label}: {fault}")


_AXES = ("length", "width", "height")


def _size_fault(size: tuple[float, ...], range_of_class: SizeRange, most: float) -> str:
    kinds = (range_of_class.usual, *range_of_class.types)
    fits = any(all(1 / most <= a / b <= most for a, b in zip(size, kind, strict=True)) for kind in kinds)
    for axis, name in enumerate(_AXES):
        ratio = size[axis] / range_of_class.usual[axis]
        if not fits and not 1 / most <= ratio <= most:
            return f"{name} {size[axis]:.2f} m is {ratio:.1f} times the usual {range_of_class.usual[axis]:.2f} m."
        low, high = (
            (None if range_of_class.low is None else range_of_class.low[axis]),
            (None if range_of_class.high is None else range_of_class.high[axis]),
        )
        if (low is not None and size[axis] < low) or (high is not None and size[axis] > high):
            beyond = "below" if low is not None and size[axis] < low else "above"
            return f"{name} {size[axis]:.2f} m is {beyond} that of 99.5 % of the set."
    return "" if fits else f"{size[0]:.1f} x {size[1]:.1f} x {size[2]:.1f} m is the size of none of its kinds."


def overlaps(boxes: Labels, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Labels that stand in each other, seen from above: one finding a pair, at the later of the two."""
    if len(boxes) < 2:
        return
    iou = np.triu(pairwise_iou(to_boxes(boxes), to_boxes(boxes), kind="bev"), 1)
    for row, column in np.argwhere(iou > settings.overlap_iou).tolist():
        first, second, overlap = boxes[row], boxes[column], iou[row, column]
        duplicate = overlap > settings.duplicate_iou
        verb = "are one object twice" if duplicate else "stand in each other"
        sentence = f"{second.label} {second.track} and {first.label} {first.track} {verb} (IoU {overlap:.2f})."
        yield box_issue(scene, second, "overlap", "error" if duplicate else "warning", sentence)


def to_boxes(boxes: Labels) -> Boxes:
    """Labels as boxes."""
    table = np.array([label.box for label in boxes], dtype=np.float64).reshape(-1, 7)
    names = [label.label for label in boxes]
    return Boxes(centre_m=table[:, :3], size_m=table[:, 3:6], yaw_rad=table[:, 6], label=names)


def duplicate_tracks(boxes: Labels, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Two boxes of one frame with the same track ID and class; reported for all but the first."""
    del settings
    counts: Counter[tuple[str, str]] = Counter()
    for label in boxes:
        counts[label.track, label.label] += 1
        if label.track and counts[label.track, label.label] > 1:
            sentence = f"{label.label} {label.track} is there twice in this frame."
            yield box_issue(scene, label, "twice", "error", sentence)


# A track in the frames around: size, turn, jump, speed, gaps, length

FRAME_S = 0.1
"""The limit of a turn is one for frames 0.1 s apart; over longer times it grows, up to a quarter turn."""
FASTEST_M_S = 60.0

Courses = Mapping[str, NearbyTrack]


def track_checks(boxes: Labels, scene: CheckedFrame, tracks: Courses, settings: CheckSettings) -> Iterator[LabelIssue]:
    """All checks of the tracks that are in the frame."""
    for label in boxes:
        course = tracks.get(label.track) if label.track else None
        if course is None:
            continue
        step = next((number for number, step in enumerate(course.steps) if step.row == scene.row), None)
        if step is None:
            continue
        if course.frames < settings.shortest_track:
            sentence = f"{label.label} {label.track} is in {count_of(course.frames, 'frame')} only."
            yield box_issue(scene, label, "short", "info", sentence)
        yield from _jump(label, course, step, scene, settings)
        if step > 0:
            yield from _changes_since(label, course, step, scene, settings)


def _changes_since(
    label: BoxLabel, course: NearbyTrack, step: int, scene: CheckedFrame, settings: CheckSettings
) -> Iterator[LabelIssue]:
    """What changed since the frame before in the track."""
    before, now = course.steps[step - 1], course.steps[step]
    name, missing = f"{label.label} {label.track}", now.row - before.row - 1
    if 1 <= missing <= settings.longest_gap:
        gap = (
            "is missing in the frame before"
            if missing == 1
            else f"is missing in the {count_of(missing, 'frame')} before"
        )
        yield box_issue(scene, label, "gap", "warning", f"{name} {gap}.")
    change = max(abs(a / b - 1) for a, b in zip(now.box[3:6], before.box[3:6], strict=True))
    if change > settings.track_size and not course.locked:
        severity: Severity = "warning" if change > settings.track_size_far else "info"
        yield box_issue(scene, label, "track_size", severity, f"{name} changes its size by {change:.0%}; lock it?")
    time_s = max(now.time_s - before.time_s, 1e-3)
    turn_rad = abs(turn_angle(before.box[6], now.box[6]))
    if turn_rad > settings.flip_rad:
        sentence = (
            f"{name} turns by {math.degrees(turn_rad):.0f} degrees in {time_s:.1f} s: front and back are swapped."
        )
        yield box_issue(scene, label, "turn", "error", sentence)
    elif turn_rad > min(settings.turn_rad * max(1.0, time_s / FRAME_S), math.pi / 2):
        yield box_issue(
            scene, label, "turn", "warning", f"{name} turns by {math.degrees(turn_rad):.0f} degrees in {time_s:.1f} s."
        )
    speed = math.dist(before.box[:2], now.box[:2]) / time_s
    fastest = settings.fastest_m_s.get(label.label, FASTEST_M_S)
    if course.posed and speed > fastest:
        yield box_issue(scene, label, "speed", "warning", f"{name} goes {speed:.0f} m/s, more than {fastest:.0f}.")


def _jump(
    label: BoxLabel, course: NearbyTrack, step: int, scene: CheckedFrame, settings: CheckSettings
) -> Iterator[LabelIssue]:
    """Distance of the box from constant velocity over its neighbouring frames; reported in the worst frame only."""
    steps = course.steps
    if len(steps) < 3:
        return
    off = _bend(steps, min(max(step, 1), len(steps) - 2))
    if off is None or off <= settings.jump_m:
        return
    neighbours = [_bend(steps, other) for other in (step - 1, step + 1) if 1 <= other <= len(steps) - 2]
    if any(other is not None and other > off for other in neighbours):
        return
    severity: Severity = "error" if off > settings.jump_far_m else "warning"
    sentence = f"{label.label} {label.track} jumps: {off:.1f} m off an even motion over three frames."
    yield box_issue(scene, label, "jump", severity, sentence)


def _bend(steps: Sequence[TrackStep], middle: int) -> float | None:
    """Distance of a third box from where two give it at constant velocity; None where frames are missing."""
    first, second, third = steps[middle - 1 : middle + 2]
    if third.row - first.row != 2:
        return None
    share = (third.time_s - second.time_s) / max(second.time_s - first.time_s, 1e-3)
    x, y = (now + share * (now - before) for before, now in zip(first.box[:2], second.box[:2], strict=True))
    return math.dist(third.box[:2], (x, y))


# Boxes against the points: on the ground, not empty, nothing of the object left outside

ABOVE_GROUND_M = 0.25
FEWEST_OF_OBJECT, FEWEST_OUTSIDE = 10, 5
REACH_M, MARGIN_M = 1.0, 0.05
TALLER, TALL_M = 0.1, 1.5
"""Labels of tall objects are drawn with more room: a tenth of what they are taller than 1.5 m is let stand."""
FACE_M = 0.1
"""So near a face, points are its own: range noise and a careful hand leave as much."""


def point_checks(boxes: Labels, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """All checks against the points of the frame."""
    if scene.around is None:
        names = {label.id for label in boxes}
        yield from (issue for issue in scene.before if issue.check in POINT_CHECKS and issue.box in names)
        return
    for label in boxes:
        radius_m = float(np.hypot(*label.box[3:5])) / 2 + REACH_M
        local = in_box_axes(scene.around.near(label.box[0], label.box[1], radius_m), label.box)
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
            outside = _count_outside(label, near[beyond > FACE_M, 2], ground)
            yield from _outside(label, outside, count, scene, settings)


def _standing(
    label: BoxLabel, ground: float | None, scene: CheckedFrame, settings: CheckSettings
) -> Iterator[LabelIssue]:
    if ground is None:
        return
    bottom = -label.box[5] / 2
    most_m = settings.ground_m + TALLER * max(label.box[5] - TALL_M, 0.0)
    if ground > 0:
        yield box_issue(scene, label, "ground", "error", f"{label.label}: more than half of it is in the ground.")
    elif ground - bottom > most_m:
        yield box_issue(scene, label, "ground", "warning", f"{label.label}: {ground - bottom:.1f} m in the ground.")
    elif bottom - ground > most_m:
        yield box_issue(scene, label, "ground", "warning", f"{label.label}: {bottom - ground:.1f} m above the ground.")


def _empty(label: BoxLabel, count: int, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    if label.source == "radar":
        return
    if count == 0:
        sentence = f"{label.label}: no LiDAR point in it; if only the radar sees it, set its source to radar."
        yield box_issue(scene, label, "empty", "warning", sentence)
    elif count < settings.fewest_points:
        yield box_issue(scene, label, "empty", "info", f"{label.label}: {count} LiDAR points in it.")


def _count_outside(label: BoxLabel, heights: Float[np.ndarray, " n"], ground: float | None) -> int:
    """How many points just outside a box are neither the ground's nor above it; 0 where the ground is not known."""
    if ground is None:
        return 0
    half = label.box[5] / 2
    return int(((heights > max(ground + ABOVE_GROUND_M, -half)) & (heights < half)).sum())


def _outside(
    label: BoxLabel, outside: int, count: int, scene: CheckedFrame, settings: CheckSettings
) -> Iterator[LabelIssue]:
    if outside >= FEWEST_OUTSIDE and outside + count >= FEWEST_OF_OBJECT and outside > settings.ring_share * count:
        sentence = f"{label.label}: {count_of(outside, 'point')} just outside it, {count} inside: is it large enough?"
        yield box_issue(scene, label, "outside", "warning", sentence)


# Where a detector disagrees with the annotators

MEETS_IOU = 0.05
"""Below it, a detection is of no box at all."""


def disagreements(boxes: Labels, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Detections without a box, and boxes that confident detections place otherwise."""
    confident = [candidate for candidate in scene.detections if candidate.score > settings.detector_score]
    if not confident:
        return
    detector_boxes = to_boxes([BoxLabel(id="", label=candidate.label, box=candidate.box) for candidate in confident])
    iou = pairwise_iou(detector_boxes, to_boxes(boxes), kind="bev")
    for number, detection in enumerate(confident):
        best = int(iou[number].argmax()) if len(boxes) else -1
        overlap = float(iou[number, best]) if len(boxes) else 0.0
        score = f"score {detection.score:.2f}"
        if overlap < MEETS_IOU:
            yield LabelIssue(
                check="detector",
                severity="info",
                sentence=f"The detector sees a {detection.label} without a box ({score}).",
                frame=scene.key,
                box=None,
                xy_m=(detection.box[0], detection.box[1]),
            )
        elif overlap < settings.detector_iou:
            label = boxes[best]
            sentence = f"{label.label} {label.track}: the detector places it otherwise (IoU {overlap:.2f}, {score})."
            yield box_issue(scene, label, "detector", "info", sentence)
