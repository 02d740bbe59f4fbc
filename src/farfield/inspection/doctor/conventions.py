"""Conventions decided from the data: quaternion order, size order, heading, centre or bottom, axes.

Every convention that data sets get wrong is a reading: the same boxes, changed. Changed boxes have the same volume, so
the reading that holds more points of objects is the better one. Each box votes; a reading replaces the one of the file
only by a clear majority.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from farfield.datasets.base import Dataset
from farfield.datasets.cirrus import Cirrus
from farfield.datasets.cirrus.labels import RawLabels, boxes_from_labels
from farfield.datasets.maps import none_before
from farfield.errors import FarfieldError
from farfield.frame import Annotation, Boxes
from farfield.geometry.boxes import BOX_MARGIN_M
from farfield.geometry.poses import pose_from_yaw
from farfield.inspection.doctor.survey import Finding, Survey
from farfield.vocabulary.counts import count_of

# Which reading of the boxes do the points support?


_MIN_POINTS = 4
_MIN_VOTES = 4
_MAJORITY = 0.75
_LEAST_HELD = 0.25  # changes after which fewer boxes hold points explain nothing
_TURNS_DEG = tuple(range(15, 180, 15))


@dataclass(frozen=True)
class BoxConvention:
    """One way to read the boxes: a name, and the change to what was read."""

    name: str
    change: Callable[[Boxes], Boxes]


@dataclass(frozen=True)
class ConventionVotes:
    """How the boxes vote between the file's reading and another one.

    Args:
        name: The other reading.
        votes_for: Boxes that hold clearly more points in the other reading.
        votes_against: Boxes that hold clearly more points as read.
        gain: Mean gain of points held, as a share of each box's better count; above 0 speaks for the other reading.
    """

    name: str
    votes_for: int
    votes_against: int
    gain: float

    @property
    def wins(self) -> bool:
        """Whether the points clearly support the other reading."""
        votes = self.votes_for + self.votes_against
        return self.votes_for >= _MIN_VOTES and self.votes_for >= _MAJORITY * votes and self.gain > 0

    @property
    def loses(self) -> bool:
        """Whether the points clearly support the file's reading."""
        votes = self.votes_for + self.votes_against
        return self.votes_against >= _MIN_VOTES and self.votes_against >= _MAJORITY * votes and self.gain < 0


def _resized(order: tuple[int, ...]) -> Callable[[Boxes], Boxes]:
    return lambda boxes: boxes.replace(size_m=boxes.size_m[:, list(order)])


def _raised(share: float) -> Callable[[Boxes], Boxes]:
    return lambda boxes: boxes.replace(centre_m=boxes.centre_m + boxes.size_m * [0.0, 0.0, share])


def _moved_round(deg: float | int) -> Callable[[Boxes], Boxes]:
    return lambda boxes: boxes.transform(pose_from_yaw(float(np.deg2rad(deg))))


def _turned(deg: float | int) -> Callable[[Boxes], Boxes]:
    return lambda boxes: boxes.replace(yaw_rad=boxes.yaw_rad + np.deg2rad(deg))


SIZE_READINGS = {f"size {''.join(map(str, order))}": order for order in permutations(range(3)) if order != (0, 1, 2)}

READINGS: tuple[BoxConvention, ...] = (
    *(BoxConvention(name, _resized(order)) for name, order in SIZE_READINGS.items()),
    BoxConvention("yaw x 180/pi", lambda boxes: boxes.replace(yaw_rad=boxes.yaw_rad * 180 / np.pi)),
    BoxConvention("yaw x pi/180", lambda boxes: boxes.replace(yaw_rad=boxes.yaw_rad * np.pi / 180)),
    BoxConvention("yaw clockwise", lambda boxes: boxes.replace(yaw_rad=-boxes.yaw_rad)),
    BoxConvention("yaw clockwise from y", lambda boxes: boxes.replace(yaw_rad=np.pi / 2 - boxes.yaw_rad)),
    BoxConvention("raised by h/2", _raised(0.5)),
    BoxConvention("lowered by h/2", _raised(-0.5)),
    BoxConvention("mirrored in y", lambda b: b.replace(centre_m=b.centre_m * [1.0, -1.0, 1.0], yaw_rad=-b.yaw_rad)),
    *(BoxConvention(f"turned by {deg}", _moved_round(deg)) for deg in (90, 180, 270)),
    BoxConvention(
        "camera axes", lambda boxes: boxes.replace(centre_m=boxes.centre_m[:, [2, 0, 1]] * [1.0, -1.0, -1.0])
    ),
)
HEADINGS: tuple[BoxConvention, ...] = tuple(BoxConvention(f"heading {deg}", _turned(deg)) for deg in _TURNS_DEG)


def count_points(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes, readings: Sequence[BoxConvention]
) -> Int[np.ndarray, "m readings"]:
    """Count the object points in every box under the file's reading (column 0) and each other one.

    Args:
        points_m: The whole cloud; ground returns are left out.
        boxes: m boxes as read.
        readings: Other readings.

    Returns:
        Counts, shape (m, 1 + len(readings)).
    """
    sets = [boxes, *(reading.change(boxes) for reading in readings)]
    if len(boxes) == 0 or len(points_m) == 0:
        return np.zeros((len(boxes), len(sets)), dtype=np.int64)
    points = points_m[above_ground(points_m)]
    radius = float(np.linalg.norm(boxes.size_m, axis=1).max()) / 2 + 2 * BOX_MARGIN_M
    centres = np.unique(np.concatenate([part.centre_m for part in sets]).round(3), axis=0)
    nearest, _ = cKDTree(centres).query(points, distance_upper_bound=radius)
    points = points[np.isfinite(nearest)]
    if len(points) == 0:
        return np.zeros((len(boxes), len(sets)), dtype=np.int64)
    return _count(points, Boxes.concatenate(sets)).reshape(len(sets), len(boxes)).T


def _count(points_m: Float[np.ndarray, "n 3"], boxes: Boxes) -> Int[np.ndarray, " m"]:
    """Points inside each of many boxes, all pairs of a box and a point near it at once."""
    radius_m = np.hypot(*(boxes.size_m[:, :2].T / 2 + BOX_MARGIN_M))
    near = cKDTree(points_m[:, :2]).query_ball_point(boxes.centre_m[:, :2], radius_m, return_sorted=False)
    owner = np.repeat(np.arange(len(boxes)), [len(indices) for indices in near])
    if len(owner) == 0:
        return np.zeros(len(boxes), dtype=np.int64)
    offset = points_m[np.concatenate(near).astype(np.intp)] - boxes.centre_m[owner]
    cos, sin = np.cos(boxes.yaw_rad)[owner], np.sin(boxes.yaw_rad)[owner]
    x, y = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
    half = boxes.size_m[owner] / 2 + BOX_MARGIN_M
    inside = (np.abs(x) <= half[:, 0]) & (np.abs(y) <= half[:, 1]) & (np.abs(offset[:, 2]) <= half[:, 2])
    return np.bincount(owner[inside], minlength=len(boxes))


def convention_votes(counts: Int[np.ndarray, "m k"], readings: Sequence[BoxConvention]) -> list[ConventionVotes]:
    """Let the boxes vote on every reading.

    Args:
        counts: What :func:`count_points` gave, over all boxes of all frames.
        readings: The other readings, in the order of the columns.
    """
    return [_vote(reading.name, counts[:, 0], counts[:, 1 + k]) for k, reading in enumerate(readings)]


def _vote(name: str, base: Int[np.ndarray, " m"], other: Int[np.ndarray, " m"]) -> ConventionVotes:
    best = np.maximum(base, other)
    valid = best >= _MIN_POINTS
    clear = (np.abs(base - other) >= np.maximum(2.0, 0.2 * best)) & valid
    gain = ((other - base) / np.maximum(best, 1))[valid]
    return ConventionVotes(
        name,
        int((clear & (other > base)).sum()),
        int((clear & (other < base)).sum()),
        float(gain.mean()) if len(gain) else 0.0,
    )


def misfit_share(counts: Int[np.ndarray, "m k"], size_m: Float[np.ndarray, "m 3"]) -> tuple[float, int]:
    """Share of elongated boxes with points that some heading, at least 30 degrees off, fits much better.

    Args:
        counts: Columns as read and for each of :data:`HEADINGS`.
        size_m: Sizes of the boxes.

    Returns:
        The share, and the number of boxes it rests on.
    """
    far_off = [k for k, deg in enumerate(_TURNS_DEG) if 30 <= deg <= 150]
    best = counts[:, 1:][:, far_off].max(axis=1)
    long, short = size_m[:, :2].max(axis=1), size_m[:, :2].min(axis=1)
    valid = (np.maximum(best, counts[:, 0]) >= 10) & (long > 1.5 * short)
    if not valid.any():
        return 0.0, 0
    return float((best > 1.4 * counts[:, 0])[valid].mean()), int(valid.sum())


def misfit_is_clear(share: float, boxes: int, *, expected: float = 0.4) -> bool:
    """Whether more boxes misfit than ``expected``, by the lower end of Wilson's 95 % interval (Wilson 1927).

    Args:
        share: Share of boxes that another heading fits much better.
        boxes: Number of boxes it rests on.
        expected: Share that sound data may reach: partly seen and crowded objects misfit too.
    """
    if boxes < 8:
        return False
    z2 = 1.96**2
    centre = share + z2 / (2 * boxes)
    spread = 1.96 * math.sqrt(share * (1 - share) / boxes + z2 / (4 * boxes**2))
    return (centre - spread) / (1 + z2 / boxes) > expected


def supported_changes(
    points: Sequence[Float[np.ndarray, "_ 3"]], boxes: Sequence[Boxes]
) -> list[tuple[ConventionVotes, BoxConvention]]:
    """Find the changes that the points support, the most helpful first, each on top of those before.

    Args:
        points: Cloud of each frame.
        boxes: Boxes of each frame as read.

    Returns:
        Winning ballots and their readings; empty where the points support the file's reading.
    """
    changes: list[tuple[ConventionVotes, BoxConvention]] = []
    current = list(boxes)
    for _ in range(3):
        counts = np.concatenate([count_points(p, b, READINGS) for p, b in zip(points, current, strict=True)])
        winners = [
            (ballot, reading)
            for ballot, reading in zip(convention_votes(counts, READINGS), READINGS, strict=True)
            if ballot.wins
        ]
        if not winners:
            break
        winner = max(winners, key=lambda pair: pair[0].gain)
        changes.append(winner)
        current = [winner[1].change(b) for b in current]
    return changes if changes and held_share(points, current) >= _LEAST_HELD else []


def held_share(points: Sequence[Float[np.ndarray, "_ 3"]], boxes: Sequence[Boxes]) -> float:
    """Share of boxes, nearer than 70 m if there are some, that hold at least one object point."""
    held = np.concatenate([count_points(p, b, ())[:, 0] > 0 for p, b in zip(points, boxes, strict=True)])
    near = np.concatenate([b.range_m < 70.0 for b in boxes])
    return float((held[near] if near.any() else held).mean()) if len(held) else 0.0


# A rough ground height, so that ground returns do not count as points of an object.

_CELL_M = 4.0
_REACH_M = 400.0
_SHARE = 0.05  # height below which this share of a cell's points lies
_MIN_CELL_POINTS = 10


def ground_height_m(points_m: Float[np.ndarray, "n 3"], at_m: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
    """Ground height at some places: the lowest cell (4 m) of the 3 x 3 around each; NaN where too few points lie.

    Args:
        points_m: The cloud.
        at_m: Places x, y.

    Returns:
        Heights in metres, shape (m,).
    """
    side = int(2 * _REACH_M / _CELL_M) + 2
    low = np.full((side, side), np.nan)
    cell = _cells(points_m[:, :2], side)
    order = np.lexsort((points_m[:, 2], cell))
    names, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    enough = count >= _MIN_CELL_POINTS
    low.flat[names[enough]] = points_m[order[first + (count * _SHARE).astype(np.intp)], 2][enough]
    padded = np.pad(low, 1, constant_values=np.nan)
    around = np.stack([padded[i : i + side, j : j + side] for i in range(3) for j in range(3)])
    floor = np.where(np.isnan(around), np.inf, around).min(axis=0)
    height = floor.flat[_cells(at_m, side)]
    return np.where(np.isinf(height), np.nan, height)


def above_ground(points_m: Float[np.ndarray, "n 3"], *, clearance_m: float = 0.3) -> Bool[np.ndarray, " n"]:
    """Which points stand clear of the ground; where it is not known they count as clear."""
    ground = ground_height_m(points_m, points_m[:, :2])
    return ~(points_m[:, 2] <= ground + clearance_m)


def _cells(at_m: Float[np.ndarray, "m 2"], side: int) -> np.ndarray:
    index = np.clip((at_m + _REACH_M) / _CELL_M, 0, side - 1).astype(np.intp)
    return index[:, 0] * side + index[:, 1]


_UPRIGHT = 0.9  # cosine of the largest tilt of an upright box, 26 degrees
_SPELLED = {"xyzw": "x y z w", "wxyz": "w x y z"}


def check_quaternion_order(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Decide the order of the quaternions: in the right one objects stand upright."""
    reader = survey.dataset.unwrapped
    if not isinstance(reader, Cirrus):
        return
    raws = list(_raw_labels(reader, survey.dataset.origins))
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
    evidence = f"{upright[decided]:.0%} of {count_of(len(rows), 'box', 'boxes')} stand upright so"
    evidence += f", {upright['wxyz' if decided == 'xyzw' else 'xyzw']:.0%} the other way round"
    what = f"{_SPELLED[decided]}, decided from the data ({evidence})"
    if decided != read:
        fix = _fix(reader, f"Write them as {_SPELLED[read]}", f"quat_order: {decided}")
        what = f"{_SPELLED[decided]}, but read as {_SPELLED[read]} ({evidence})"
        yield Finding(severity="fail", topic="quaternion order", what=what, fix=fix)
    elif upright[read] < 0.9:
        fix = "Neither order makes the boxes upright: the quaternions are damaged or in other axes."
        what = f"unclear: {upright['xyzw']:.0%} upright as x y z w, {upright['wxyz']:.0%} as w x y z"
        yield Finding(severity="fail", topic="quaternion order", what=what, fix=fix)
    else:
        yield Finding(severity="ok", topic="quaternion order", what=what)
    off = int((np.abs(norm - 1) > 1e-3).sum())
    if off:
        what = f"{off} of {len(norm)} are not of length 1"
        yield Finding(severity="warn", topic="quaternion norm", what=what, fix="They are normalised when read.")


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


def check_conventions(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Let the points decide size order, heading, centre and axes."""
    points, boxes = [], []
    for sample, annotated in survey.annotated_samples():
        points.append(sample.points_m)
        boxes.append(_in_decided_order(survey, sample.key, annotated, facts))
    if not boxes:
        return
    counts = np.concatenate([count_points(p, b, (*READINGS, *HEADINGS)) for p, b in zip(points, boxes, strict=True)])
    by_name = {ballot.name: ballot for ballot in convention_votes(counts, READINGS)}
    changes = (
        [ballot for ballot, _ in supported_changes(points, boxes)] if any(b.wins for b in by_name.values()) else []
    )
    together = Boxes.concatenate([b.plain() for b in boxes])
    yield from _size_order(survey, by_name, changes, together, facts)
    headings = counts[:, [0, *range(1 + len(READINGS), counts.shape[1])]]
    reader = survey.dataset.unwrapped
    yield from _heading(reader, by_name, changes, together, misfit_share(headings, together.size_m), facts)
    yield from _centre(reader, by_name, changes, facts)
    for ballot in changes:
        if ballot.name in _AXES:
            is_kitti = ballot.name == "camera axes" and not _OF_KITTI.isdisjoint(one.name for one in changes)
            fix = _AXES_MEND + (_KITTI_MEND if is_kitti else "")
            yield Finding(severity="fail", topic="axes", what=_AXES[ballot.name] + _votes(ballot), fix=fix)


_AXES = {
    "mirrored in y": "boxes are mirrored: y points right in them or in the cloud",
    "turned by 90": "boxes are a quarter turn clockwise of the cloud",
    "turned by 180": "boxes are half a turn off the cloud",
    "turned by 270": "boxes are a quarter turn counter-clockwise of the cloud",
    "camera axes": "boxes stand in camera axes (x right, y down, z ahead)",
}
_AXES_MEND = "Bring boxes and clouds to one frame: x forward, y left, z up."
_OF_KITTI = {"yaw clockwise from y", "raised by h/2"}
_KITTI_MEND = " With yaw and centre above these are KITTI's labels, which are read as they are in its own layout."
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


def _fix(reader: Dataset, action: str, setting: str) -> str:
    """What to do, and the setting that does it where the layout has a mapping with such settings: Cirrus' alone."""
    settable = f", or set labels: {{{setting}}} in the mapping" if setting and isinstance(reader, Cirrus) else ""
    return f"{action}{settable}."


def _in_decided_order(survey: Survey, key: tuple[str, str], boxes: Boxes, facts: dict[str, Any]) -> Boxes:
    """Boxes read with the quaternion order that the data show, so that the other checks do not trip over it."""
    order, reader = facts.get("quaternion_order"), survey.dataset.unwrapped
    if not isinstance(reader, Cirrus) or order in (None, reader.mapping.labels.quat_order):
        return boxes
    index = reader.keys.index(key)
    raw = reader.raw_labels(index)
    assert raw is not None
    read = boxes_from_labels(raw, reader.mapping.labels.model_copy(update={"quat_order": order}))
    frame = reader.frame(index).annotated(Annotation(boxes=read))
    for function in survey.dataset.maps:
        frame = function(frame, none_before)
    return boxes if frame.boxes is None else frame.boxes


def _votes(ballot: ConventionVotes) -> str:
    return f" ({count_of(ballot.votes_for, 'box holds', 'boxes hold')} more points so, {ballot.votes_against} as read)"


def _size_order(
    survey: Survey,
    by_name: dict[str, ConventionVotes],
    changes: list[ConventionVotes],
    boxes: Boxes,
    facts: dict[str, Any],
) -> Iterator[Finding]:
    reader = survey.dataset.unwrapped
    read = reader.mapping.labels.size_order if isinstance(reader, Cirrus) else "lwh"
    change = next((ballot for ballot in changes if ballot.name in SIZE_READINGS), None)
    if change is not None and not _quarter_turn(change, boxes):
        letters = [""] * 3
        for axis, letter in zip(SIZE_READINGS[change.name], "lwh", strict=True):
            letters[read.index("lwh"[axis])] = letter
        facts["size_order"] = "".join(letters)
        what = f"{' '.join(letters)}, but read as {' '.join(read)}{_votes(change)}"
        fix = _fix(reader, f"Write sizes as {' '.join(read)}", f"size_order: {''.join(letters)}")
        yield Finding(severity="fail", topic="size order", what=what, fix=fix)
        return
    facts["size_order"] = read
    swapped = by_name["size 102"]
    if swapped.loses:
        votes = (
            f"{count_of(swapped.votes_against, 'box holds', 'boxes hold')} more points "
            f"so, {swapped.votes_for} with length and width swapped"
        )
        what = f"{' '.join(read)}, decided from the data ({votes})"
    else:
        what = f"{' '.join(read)} as documented; the points do not decide (too few, or square boxes)"
    yield Finding(severity="ok" if swapped.loses else "open", topic="size order", what=what)


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
            fix = _fix(reader, action, setting)
            yield Finding(severity="fail", topic="yaw", what=what + _votes(change), fix=fix)
            return
        if change.name in SIZE_READINGS and _quarter_turn(change, boxes):
            facts["yaw"] = "off by 90 degrees"
            fix = _fix(reader, "Add 90 degrees to the yaw", "yaw_offset_deg: 90")
            yield Finding(severity="fail", topic="yaw", what="off by 90 degrees" + _votes(change), fix=fix)
            return
    if misfit_is_clear(share, elongated) and not changes:
        what = f"{share:.0%} of {elongated} long boxes with points would fit much better with another heading"
        fix = "Check the unit, sign and zero of the yaw against the points."
        yield Finding(severity="fail", topic="yaw", what=what, fix=fix)
        return
    tested = [by_name[name] for name in _YAW]
    decided = any(ballot.loses for ballot in tested)
    if decided:
        votes = "; ".join(f"{b.votes_against}:{b.votes_for} against {b.name}" for b in tested if b.loses)
        what = f"counter-clockwise from +x in radians, decided from the data ({votes})"
    else:
        what = "counter-clockwise from +x in radians as documented; the points do not decide"
    yield Finding(severity="ok" if decided else "open", topic="yaw", what=what)
    largest = float(np.abs(boxes.yaw_rad).max(initial=0.0))
    if len(boxes) >= 20 and 0 < largest <= np.pi * np.pi / 180 + 1e-6:
        what = f"all {len(boxes)} headings lie within {np.rad2deg(largest):.1f} degrees of +x"
        fix = "Right on a straight one-way road; otherwise yaw may have been multiplied by pi/180 once too often."
        yield Finding(severity="warn", topic="yaw", what=what, fix=fix)


def _centre(
    reader: Dataset, by_name: dict[str, ConventionVotes], changes: list[ConventionVotes], facts: dict[str, Any]
) -> Iterator[Finding]:
    names = {"raised by h/2": "bottom", "lowered by h/2": "top"}
    change = next((ballot for ballot in changes if ballot.name in names), None)
    if change is not None:
        position = names[change.name]
        facts["position"] = position
        what = f"position is the {position} of the box, but read as its centre{_votes(change)}"
        sign = "Add" if position == "bottom" else "Subtract"
        fix = _fix(reader, f"{sign} half the height", "position_is: bottom" if position == "bottom" else "")
        yield Finding(severity="fail", topic="box centre", what=what, fix=fix)
        return
    facts["position"] = "centre"
    ballot = by_name["raised by h/2"]
    votes = (
        f"{count_of(ballot.votes_against, 'box holds', 'boxes hold')} more "
        f"points so, {ballot.votes_for} raised by half their height"
    )
    if ballot.loses:
        what = f"position is the centre, decided from the data ({votes})"
    else:
        what = "position is the centre as documented; the points do not decide"
    yield Finding(severity="ok" if ballot.loses else "open", topic="box centre", what=what)
