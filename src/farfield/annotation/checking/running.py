"""All checks of a frame."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import chain

from farfield.annotation.checking.contract import Boxes, CheckedFrame, CheckSettings, LabelIssue, NearbyTrack
from farfield.annotation.checking.courses import courses
from farfield.annotation.checking.disagreeing import disagreements
from farfield.annotation.checking.points import points
from farfield.annotation.checking.shapes import broken, is_sound, overlaps, sizes, twice

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
_SEVERITIES = ("error", "warning", "info")


def check(
    boxes: Boxes,
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
    sound = [label for label in boxes if is_sound(label.box)]
    found = chain(
        broken(boxes, frame, settings),
        sizes(sound, frame, settings),
        overlaps(sound, frame, settings),
        twice(boxes, frame, settings),
        courses(sound, frame, track, settings),
        points(sound, frame, settings),
        disagreements(sound, frame, settings),
    )
    reasons = ignored or {}
    marked = [replace(each, ignored=reasons[each.id]) if each.id in reasons else each for each in found]
    return sorted(marked, key=_rank)


def _rank(finding: LabelIssue) -> tuple[bool, int]:
    return finding.ignored is not None, _SEVERITIES.index(finding.severity)
