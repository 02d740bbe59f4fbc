"""Checks of a track in the frames around: size, turn, jump, speed, gaps, length."""

import math
from collections.abc import Iterator, Mapping, Sequence

from farfield.annotation.angles import turn
from farfield.annotation.checking.contract import (
    Boxes,
    CheckedFrame,
    CheckSettings,
    LabelIssue,
    NearbyTrack,
    Severity,
    TrackStep,
)
from farfield.annotation.checking.shapes import finding
from farfield.datasets.labels import BoxLabel, Numbers

FRAME_S = 0.1
"""The limit of a turn is one for frames 0.1 s apart; over longer times it grows, up to a quarter turn."""
FASTEST_M_S = 60.0

Courses = Mapping[str, NearbyTrack]


def courses(boxes: Boxes, scene: CheckedFrame, tracks: Courses, settings: CheckSettings) -> Iterator[LabelIssue]:
    """All checks of the tracks that are in the frame."""
    for label in boxes:
        course = tracks.get(label.track) if label.track else None
        place = None if course is None else _place(course.steps, scene.row)
        if course is None or place is None:
            continue
        if course.frames < settings.shortest_track:
            sentence = f"{label.label} {label.track} is in {course.frames} frames only."
            yield finding(scene, label, "short", "info", sentence)
        yield from _jump(label, course, place, scene, settings)
        if place > 0:
            yield from _since(label, course, place, scene, settings)


def _place(steps: Sequence[TrackStep], row: int) -> int | None:
    return next((place for place, step in enumerate(steps) if step.row == row), None)


def _since(
    label: BoxLabel, course: NearbyTrack, place: int, scene: CheckedFrame, settings: CheckSettings
) -> Iterator[LabelIssue]:
    """What changed since the frame before in the track."""
    before, now = course.steps[place - 1], course.steps[place]
    name, missing = f"{label.label} {label.track}", now.row - before.row - 1
    if 1 <= missing <= settings.longest_gap:
        words = "is missing in the frame before" if missing == 1 else f"is missing in the {missing} frames before"
        yield finding(scene, label, "gap", "warning", f"{name} {words}.")
    change = max(abs(a / b - 1) for a, b in zip(now.box[3:6], before.box[3:6], strict=True))
    if change > settings.track_size and not course.locked:
        severity: Severity = "warning" if change > settings.track_size_far else "info"
        yield finding(scene, label, "track_size", severity, f"{name} changes its size by {change:.0%}; lock it?")
    time_s = max(now.time_s - before.time_s, 1e-3)
    turned = abs(turn(before.box[6], now.box[6]))
    if turned > settings.flip_rad:
        sentence = f"{name} turns by {math.degrees(turned):.0f} degrees in {time_s:.1f} s: front and back are swapped."
        yield finding(scene, label, "turn", "error", sentence)
    elif turned > min(settings.turn_rad * max(1.0, time_s / FRAME_S), math.pi / 2):
        yield finding(
            scene, label, "turn", "warning", f"{name} turns by {math.degrees(turned):.0f} degrees in {time_s:.1f} s."
        )
    speed = math.dist(before.box[:2], now.box[:2]) / time_s
    fastest = settings.fastest_m_s.get(label.label, FASTEST_M_S)
    if course.posed and speed > fastest:
        yield finding(scene, label, "speed", "warning", f"{name} goes {speed:.0f} m/s, more than {fastest:.0f}.")


def _jump(
    label: BoxLabel, course: NearbyTrack, place: int, scene: CheckedFrame, settings: CheckSettings
) -> Iterator[LabelIssue]:
    """Distance of the box from constant velocity over its neighbouring frames; reported in the worst frame only."""
    steps = course.steps
    if len(steps) < 3:
        return
    off = _bend(steps, min(max(place, 1), len(steps) - 2))
    if off is None or off <= settings.jump_m:
        return
    around = [_bend(steps, other) for other in (place - 1, place + 1) if 1 <= other <= len(steps) - 2]
    if any(other is not None and other > off for other in around):
        return
    severity: Severity = "error" if off > settings.jump_far_m else "warning"
    sentence = f"{label.label} {label.track} jumps: {off:.1f} m off an even motion over three frames."
    yield finding(scene, label, "jump", severity, sentence)


def _bend(steps: Sequence[TrackStep], middle: int) -> float | None:
    """Distance of a third box from where two give it at constant velocity; None where frames are missing."""
    first, second, third = steps[middle - 1 : middle + 2]
    if third.row - first.row != 2:
        return None
    return math.dist(third.box[:2], _ahead(first.box, second.box, first, second, third))


def _ahead(before: Numbers, now: Numbers, first: TrackStep, second: TrackStep, third: TrackStep) -> tuple[float, float]:
    share = (third.time_s - second.time_s) / max(second.time_s - first.time_s, 1e-3)
    return now[0] + share * (now[0] - before[0]), now[1] + share * (now[1] - before[1])
