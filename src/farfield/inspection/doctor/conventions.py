"""Conventions decided from the data: quaternion order, size order, heading, centre or bottom, axes."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.cirrus import Cirrus
from farfield.datasets.cirrus.labels import RawLabels, boxes_from_labels
from farfield.datasets.maps import none_before
from farfield.errors import FarfieldError
from farfield.frame import Annotation, Boxes
from farfield.inspection.doctor.evidence import (
    HEADINGS,
    READINGS,
    SIZE_READINGS,
    ConventionVotes,
    convention_votes,
    count_points,
    misfit_is_clear,
    misfit_share,
    supported_changes,
)
from farfield.inspection.doctor.findings import Finding
from farfield.inspection.doctor.survey import Survey

_UPRIGHT = 0.9  # cosine of the largest tilt of an upright box, 26 degrees
_SPELLED = {"xyzw": "x y z w", "wxyz": "w x y z"}


def quaternions(found: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Decide the order of the quaternions: in the right one objects stand upright."""
    reader = found.dataset.unwrapped
    if not isinstance(reader, Cirrus):
        return
    raws = list(_raw_labels(reader, found.dataset.origins))
    rows = np.concatenate([raw.quaternion for raw in raws]) if raws else np.zeros((0, 4))
    norm = np.linalg.norm(rows, axis=1)
    rows = rows[norm > 0] / norm[norm > 0, None]
    if not len(rows):
        return
    read = reader.mapping.labels.quat_order
    upright = {order: _upright_share(rows, order) for order in ("xyzw", "wxyz")}
    other = "wxyz" if read == "xyzw" else "xyzw"
    decided = other if upright[other] > 0.9 and upright[read] < 0.9 else read
    facts["quaternion_order"] = decided
    evidence = f"{upright[decided]:.0%} of {len(rows)} boxes stand upright so"
    evidence += f", {upright['wxyz' if decided == 'xyzw' else 'xyzw']:.0%} the other way round"
    what = f"{_SPELLED[decided]}, decided from the data ({evidence})"
    if decided != read:
        mend = _mend(reader, f"Write them as {_SPELLED[read]}", f"quat_order: {decided}")
        what = f"{_SPELLED[decided]}, but read as {_SPELLED[read]} ({evidence})"
        yield Finding(severity="fail", topic="quaternion order", what=what, mend=mend)
    elif upright[read] < 0.9:
        mend = "Neither order makes the boxes upright: the quaternions are damaged or in other axes."
        what = f"unclear: {upright['xyzw']:.0%} upright as x y z w, {upright['wxyz']:.0%} as w x y z"
        yield Finding(severity="fail", topic="quaternion order", what=what, mend=mend)
    else:
        yield Finding(severity="ok", topic="quaternion order", what=what)
    off = int((np.abs(norm - 1) > 1e-3).sum())
    if off:
        what = f"{off} of {len(norm)} are not of length 1"
        yield Finding(severity="warn", topic="quaternion norm", what=what, mend="They are normalised when read.")


def _upright_share(rows: np.ndarray, order: str) -> float:
    x, y = (rows[:, 0], rows[:, 1]) if order == "xyzw" else (rows[:, 1], rows[:, 2])
    return float((1 - 2 * (x * x + y * y) > _UPRIGHT).mean())


def _raw_labels(reader: Cirrus, indices: Iterable[int]) -> Iterator[RawLabels]:
    for index in indices:
        try:
            raw = reader.raw_labels(index)
        except (FarfieldError, OSError):
            continue  # the survey has reported it
        if raw is not None and len(raw):
            yield raw


def readings(found: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Let the points decide size order, heading, centre and axes."""
    points, boxes = [], []
    for sample, annotated in found.annotated_samples():
        points.append(sample.points_m)
        boxes.append(_in_decided_order(found, sample.key, annotated, facts))
    if not boxes:
        return
    counts = np.concatenate([count_points(p, b, (*READINGS, *HEADINGS)) for p, b in zip(points, boxes, strict=True)])
    by_name = {ballot.name: ballot for ballot in convention_votes(counts, READINGS)}
    changes = (
        [ballot for ballot, _ in supported_changes(points, boxes)] if any(b.wins for b in by_name.values()) else []
    )
    together = Boxes.concatenate([b.plain() for b in boxes])
    yield from _size_order(found, by_name, changes, together, facts)
    headings = counts[:, [0, *range(1 + len(READINGS), counts.shape[1])]]
    reader = found.dataset.unwrapped
    yield from _heading(reader, by_name, changes, together, misfit_share(headings, together.size_m), facts)
    yield from _centre(reader, by_name, changes, facts)
    for ballot in changes:
        if ballot.name in _AXES:
            yield Finding(severity="fail", topic="axes", what=_AXES[ballot.name] + _votes(ballot), mend=_AXES_MEND)


_AXES = {
    "mirrored in y": "boxes are mirrored: y points right in them or in the cloud",
    "turned by 90": "boxes are a quarter turn clockwise of the cloud",
    "turned by 180": "boxes are half a turn off the cloud",
    "turned by 270": "boxes are a quarter turn counter-clockwise of the cloud",
    "camera axes": "boxes stand in camera axes (x right, y down, z ahead)",
}
_AXES_MEND = "Bring boxes and clouds to one frame: x forward, y left, z up."
_YAW = {
    "yaw x 180/pi": (
        "yaw was multiplied by pi/180 once too often: all headings are nearly 0",
        "Rebuild the quaternions from yaw in radians",
        "yaw_scale: 57.29577951308232",
    ),
    "yaw x pi/180": (
        "yaw is in degrees, read as radians",
        "Convert the yaw to radians",
        "",
    ),
    "yaw clockwise": (
        "yaw runs clockwise",
        "Change its sign",
        "yaw_scale: -1",
    ),
    "yaw clockwise from y": (
        "yaw runs clockwise from +y, like a compass",
        "Use pi/2 - yaw",
        "yaw_scale: -1, yaw_offset_deg: 90",
    ),
}
"""What is wrong, what to do, and which setting of a Cirrus mapping does it."""


def _mend(reader: Dataset, action: str, setting: str) -> str:
    """What to do, and the setting that does it where the layout has a mapping with such settings: Cirrus' alone."""
    settable = f", or set labels: {{{setting}}} in the mapping" if setting and isinstance(reader, Cirrus) else ""
    return f"{action}{settable}."


def _in_decided_order(found: Survey, key: tuple[str, str], boxes: Boxes, facts: dict[str, Any]) -> Boxes:
    """Boxes read with the quaternion order that the data show, so that the other checks do not trip over it."""
    order, reader = facts.get("quaternion_order"), found.dataset.unwrapped
    if not isinstance(reader, Cirrus) or order in (None, reader.mapping.labels.quat_order):
        return boxes
    index = reader.keys.index(key)
    raw = reader.raw_labels(index)
    assert raw is not None
    read = boxes_from_labels(raw, reader.mapping.labels.model_copy(update={"quat_order": order}))
    seen = reader.frame(index).annotated(Annotation(boxes=read))
    for function in found.dataset.maps:
        seen = function(seen, none_before)
    return boxes if seen.boxes is None else seen.boxes


def _votes(ballot: ConventionVotes) -> str:
    return f" ({ballot.votes_for} boxes hold more points so, {ballot.votes_against} as read)"


def _size_order(
    found: Survey,
    by_name: dict[str, ConventionVotes],
    changes: list[ConventionVotes],
    boxes: Boxes,
    facts: dict[str, Any],
) -> Iterator[Finding]:
    reader = found.dataset.unwrapped
    read = reader.mapping.labels.size_order if isinstance(reader, Cirrus) else "lwh"
    change = next((ballot for ballot in changes if ballot.name in SIZE_READINGS), None)
    if change is not None and not _quarter_turn(change, boxes):
        letters = [""] * 3
        for place, letter in zip(SIZE_READINGS[change.name], "lwh", strict=True):
            letters[read.index("lwh"[place])] = letter
        facts["size_order"] = "".join(letters)
        what = f"{' '.join(letters)}, but read as {' '.join(read)}{_votes(change)}"
        mend = _mend(reader, f"Write sizes as {' '.join(read)}", f"size_order: {''.join(letters)}")
        yield Finding(severity="fail", topic="size order", what=what, mend=mend)
        return
    facts["size_order"] = read
    swapped = by_name["size 102"]
    if swapped.loses:
        votes = f"{swapped.votes_against} boxes hold more points so, {swapped.votes_for} with length and width swapped"
        what = f"{' '.join(read)}, decided from the data ({votes})"
    else:
        what = f"{' '.join(read)} as documented; the points do not decide (too few, or square boxes)"
    yield Finding(severity="ok", topic="size order", what=what)


def _quarter_turn(change: ConventionVotes, boxes: Boxes) -> bool:
    """Swapped sizes and a heading off by 90 degrees draw the same boxes; no vehicle is 3.2 m wide, many are long."""
    wide, long = (boxes.size_m[:, 1] > 3.2).sum(), (boxes.size_m[:, 0] > 3.2).sum()
    return change.name == "size 102" and bool(long > wide)


def _heading(
    reader: Dataset,
    by_name: dict[str, ConventionVotes],
    changes: list[ConventionVotes],
    boxes: Boxes,
    misfit: tuple[float, int],
    facts: dict[str, Any],
) -> Iterator[Finding]:
    share, elongated = misfit
    facts["heading_misfit"] = {"share": round(share, 4), "boxes": elongated}
    facts["yaw"] = "counter-clockwise from +x, radians"
    for change in changes:
        if change.name in _YAW:
            what, action, setting = _YAW[change.name]
            facts["yaw"] = what
            mend = _mend(reader, action, setting)
            yield Finding(severity="fail", topic="yaw", what=what + _votes(change), mend=mend)
            return
        if change.name in SIZE_READINGS and _quarter_turn(change, boxes):
            facts["yaw"] = "off by 90 degrees"
            mend = _mend(reader, "Add 90 degrees to the yaw", "yaw_offset_deg: 90")
            yield Finding(severity="fail", topic="yaw", what="off by 90 degrees" + _votes(change), mend=mend)
            return
    if misfit_is_clear(share, elongated) and not changes:
        what = f"{share:.0%} of {elongated} long boxes with points would fit much better with another heading"
        mend = "Check the unit, sign and zero of the yaw against the points."
        yield Finding(severity="fail", topic="yaw", what=what, mend=mend)
        return
    tested = [by_name[name] for name in _YAW]
    if any(ballot.loses for ballot in tested):
        votes = "; ".join(f"{b.votes_against}:{b.votes_for} against {b.name}" for b in tested if b.loses)
        what = f"counter-clockwise from +x in radians, decided from the data ({votes})"
    else:
        what = "counter-clockwise from +x in radians as documented; the points do not decide"
    yield Finding(severity="ok", topic="yaw", what=what)
    largest = float(np.abs(boxes.yaw_rad).max(initial=0.0))
    if len(boxes) >= 20 and 0 < largest <= np.pi * np.pi / 180 + 1e-6:
        what = f"all {len(boxes)} headings lie within {np.rad2deg(largest):.1f} degrees of +x"
        mend = "Right on a straight one-way road; otherwise yaw may have been multiplied by pi/180 once too often."
        yield Finding(severity="warn", topic="yaw", what=what, mend=mend)


def _centre(
    reader: Dataset, by_name: dict[str, ConventionVotes], changes: list[ConventionVotes], facts: dict[str, Any]
) -> Iterator[Finding]:
    names = {"raised by h/2": "bottom", "lowered by h/2": "top"}
    change = next((ballot for ballot in changes if ballot.name in names), None)
    if change is not None:
        place = names[change.name]
        facts["position"] = place
        what = f"position is the {place} of the box, but read as its centre{_votes(change)}"
        sign = "Add" if place == "bottom" else "Subtract"
        mend = _mend(reader, f"{sign} half the height", "position_is: bottom" if place == "bottom" else "")
        yield Finding(severity="fail", topic="box centre", what=what, mend=mend)
        return
    facts["position"] = "centre"
    ballot = by_name["raised by h/2"]
    votes = f"{ballot.votes_against} boxes hold more points so, {ballot.votes_for} raised by half their height"
    what = f"position is the centre, decided from the data ({votes})" if ballot.loses else "position is the centre"
    yield Finding(severity="ok", topic="box centre", what=what + ("" if ballot.loses else " as documented"))
