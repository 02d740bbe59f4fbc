"""Data association: which detection continues which track, by IoU, generalised IoU or distance.

:func:`associate` is the way for all settings. Where every track may take every detection of its drive by generalised
IoU, :func:`assign_giou` gives the same as an assignment over all pairs and computes few of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from farfield.geometry.iou import bev_intersection_m2
from farfield.metrics.frames import same_owner
from farfield.metrics.tracking.scene import best_pairs, greedy_pairs
from farfield.tracking.presets import TrackerSettings

_Pairs = tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]
_BoxRows = Float[np.ndarray, "p 7"]  # x, y, z (centre), length, width, height, yaw
_BEV = [0, 1, 3, 4, 6]


@dataclass(frozen=True, eq=False, kw_only=True)
class GateUncertainty:
    """How uncertain positions are, for gates.

    Args:
        wider_m: What gates of distance grow by, of each track, shape (n,).
        tracks_m2: Variances of the tracks' x and y, shape (n, 2).
        detections_m2: Variances of the detections' x and y, shape (m, 2).
        radial: How far measured radial velocities of pairs (rows of tracks, rows of detections) lie from the tracks',
            in standard deviations; None where there are none.
    """

    wider_m: Float[np.ndarray, " n"]
    tracks_m2: Float[np.ndarray, "n 2"]
    detections_m2: Float[np.ndarray, "m 2"]
    radial: Callable[[Int[np.ndarray, " p"], Int[np.ndarray, " p"]], np.ndarray] | None = None

    def is_near(
        self, gap_m: Float[np.ndarray, "p 2"], a: Int[np.ndarray, " p"], b: Int[np.ndarray, " p"], sigmas: float
    ) -> np.ndarray:
        """Pairs whose positions, and whose radial velocities, differ by at most so many standard deviations."""
        near = np.asarray((gap_m**2 / (self.tracks_m2[a] + self.detections_m2[b])).sum(axis=1) <= sigmas**2)
        return near if self.radial is None else near & (self.radial(a, b) <= sigmas)


def associate(
    tracks: Float[np.ndarray, "n 7"],
    track_drive: Int[np.ndarray, " n"],
    track_label: Int[np.ndarray, " n"],
    detections: Float[np.ndarray, "m 7"],
    detection_drive: Int[np.ndarray, " m"],
    detection_label: Int[np.ndarray, " m"],
    settings: TrackerSettings,
    gate: Float[np.ndarray, " labels"],
    uncertainty: GateUncertainty | None = None,
) -> _Pairs:
    """Pair tracks and detections of the same drive, each once.

    Args:
        tracks: Predicted boxes as x, y, z (centre), length, width, height, yaw; by drive.
        track_drive: Their drives, rising.
        track_label: Their classes.
        detections: The detections likewise, by drive, the best score first.
        detection_drive: Their drives, rising.
        detection_label: Their classes.
        settings: Similarity, assignment, gate's order.
        gate: Gate of each class: least similarity, or largest distance.
        uncertainty: What widens or narrows it.

    Returns:
        Rows of the tracks and rows of their detections.
    """
    drives = int(max(track_drive.max(initial=-1), detection_drive.max(initial=-1))) + 1
    if _is_every_pair_by_giou(settings, track_label, detection_label):
        return assign_giou(tracks, track_drive, detections, detection_drive, drives, gate[detection_label])

    # Pairs (a, b) of one drive and class.
    a, b = same_owner(track_drive, detection_drive, drives)
    if settings.same_class:
        alike = track_label[a] == detection_label[b]
        a, b = a[alike], b[alike]

    # Gates by uncertainty and, as far as centres alone decide, by similarity.
    if uncertainty is not None and settings.gate_sigmas is not None:
        near = uncertainty.is_near(tracks[a, :2] - detections[b, :2], a, b, settings.gate_sigmas)
        a, b = a[near], b[near]
    limit = gate[detection_label[b]]
    if uncertainty is not None and settings.similarity == "distance":
        limit = limit + uncertainty.wider_m[a]
    if settings.gate_first or settings.similarity == "iou":
        near = _can_reach_gate(tracks, detections, a, b, settings, limit)
        a, b, limit = a[near], b[near], limit[near]
    if not len(a):
        return a, b

    # Similarity, and its gate before the assignment.
    if settings.similarity == "distance":
        similarity = -np.hypot(tracks[a, 0] - detections[b, 0], tracks[a, 1] - detections[b, 1])
        least = -limit
    else:
        similarity = iou_3d(tracks[a], detections[b], generalised=settings.similarity == "giou")
        least = limit
    if settings.gate_first:
        passed = similarity >= least
        a, b, similarity, least = a[passed], b[passed], similarity[passed], least[passed]

    # Assignment, and the gate after it.
    if settings.assignment == "greedy":
        chosen = greedy_pairs(a, b, np.lexsort([-similarity, b]))
    else:  # lifted, so that every possible pair is better than none; overlaps are so already
        lift = 0.0 if settings.similarity == "iou" else 1.0 - float(similarity.min(initial=0.0))
        chosen = best_pairs(a, b, similarity + lift, track_drive[a])
    chosen = chosen[similarity[chosen] >= least[chosen]]
    return a[chosen], b[chosen]


def _is_every_pair_by_giou(settings: TrackerSettings, track_label: np.ndarray, detection_label: np.ndarray) -> bool:
    """Whether every track may take every detection of its drive, by generalised IoU."""
    alike = not settings.same_class or len({*track_label.tolist(), *detection_label.tolist()}) < 2
    gated = settings.gate_first or settings.gate_sigmas is not None
    return alike and not gated and settings.similarity == "giou" and settings.assignment == "hungarian"


def _can_reach_gate(
    tracks: Float[np.ndarray, "n 7"],
    detections: Float[np.ndarray, "m 7"],
    a: Int[np.ndarray, " p"],
    b: Int[np.ndarray, " p"],
    settings: TrackerSettings,
    gate: Float[np.ndarray, " p"],
) -> np.ndarray:
    """Pairs that are near enough for the gate, by their centres alone."""
    gap_m = np.hypot(tracks[a, 0] - detections[b, 0], tracks[a, 1] - detections[b, 1])
    if settings.similarity == "distance":
        return np.asarray(gap_m <= gate)
    radius_m = (np.hypot(tracks[:, 3], tracks[:, 4])[a] + np.hypot(detections[:, 3], detections[:, 4])[b]) / 2
    if settings.similarity == "iou":
        return np.asarray(gap_m < radius_m)
    # Seen from above, the hull holds the outer halves of both, and a trapezoid over the line between the centres.
    area_m2 = tracks[a, 3] * tracks[a, 4] + detections[b, 3] * detections[b, 4]
    volume_m3 = np.prod(tracks[a, 3:6], axis=1) + np.prod(detections[b, 3:6], axis=1)
    height_m = np.maximum(tracks[a, 5], detections[b, 5])
    width_m = np.minimum(tracks[a, 3], tracks[a, 4]) + np.minimum(detections[b, 3], detections[b, 4])
    most_hull_m2 = volume_m3 / (np.maximum(1 + gate, 1e-3) * height_m)
    return np.asarray((gap_m < radius_m) | (gap_m <= (2 * most_hull_m2 - area_m2) / width_m))


# Similarity


def iou_3d(a: _BoxRows, b: _BoxRows, *, generalised: bool = False) -> Float[np.ndarray, " p"]:
    """IoU of the i-th boxes, in [0, 1]; generalised (Rezatofighi et al., CVPR 2019) in (-1, 1].

    The generalised one takes as enclosing body the convex hull of both seen from above, times their common height.

    Args:
        a: Boxes as rows x, y, z, length, width, height, yaw, shape (p, 7).
        b: The other box of each pair, shape (p, 7).
        generalised: Which one.
    """
    top = np.minimum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    bottom = np.maximum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2)
    shared_m3 = np.zeros(len(a))
    radius_m = (np.hypot(a[:, 3], a[:, 4]) + np.hypot(b[:, 3], b[:, 4])) / 2
    meet = (np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1]) < radius_m) & (top > bottom)
    if meet.any():
        shared_m3[meet] = bev_intersection_m2(a[meet][:, _BEV], b[meet][:, _BEV]) * (top - bottom)[meet]
    union_m3 = a[:, 3] * a[:, 4] * a[:, 5] + b[:, 3] * b[:, 4] * b[:, 5] - shared_m3
    if not generalised:
        return shared_m3 / union_m3
    highest = np.maximum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    lowest = np.minimum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2)
    hull_m2 = hull_area_m2(np.concatenate([_bev_corners(a), _bev_corners(b)], axis=1))
    hull_m3 = np.maximum(hull_m2 * (highest - lowest), union_m3)
    return shared_m3 / union_m3 - (hull_m3 - union_m3) / hull_m3


def _bev_corners(rows: _BoxRows) -> Float[np.ndarray, "p 4 2"]:
    cos, sin = np.cos(rows[:, 6]), np.sin(rows[:, 6])
    half_l, half_w = rows[:, 3] / 2, rows[:, 4] / 2
    along, across = np.stack([half_l * cos, half_l * sin], 1), np.stack([-half_w * sin, half_w * cos], 1)
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return np.stack([rows[:, :2] + s * along + t * across for s, t in signs], axis=1)


def hull_area_m2(points_m: Float[np.ndarray, "p k 2"]) -> Float[np.ndarray, " p"]:
    """Areas of the convex hulls of p sets of k points: gift wrapping of all sets at the same time.

    From the lowest point on, each step goes to the point that lies furthest clockwise of all lines to others.
    """
    points = points_m - points_m.mean(axis=1, keepdims=True)
    x, y = np.ascontiguousarray(points[..., 0]), np.ascontiguousarray(points[..., 1])
    rows = np.arange(len(x))
    start = np.lexsort([x, y], axis=1)[:, 0] if len(x) else rows
    current, area = start, np.zeros(len(x))
    is_open: Bool[np.ndarray, " p"] = np.ones(len(x), dtype=bool)
    heading = np.zeros(len(x))
    for _ in range(x.shape[1]):
        if not is_open.any():
            break
        dx, dy = x - x[rows, current][:, None], y - y[rows, current][:, None]
        distance2 = dx * dx + dy * dy
        turn = np.mod(np.arctan2(dy, dx) - heading[:, None] + 1e-9, 2 * np.pi)
        turn = np.where(distance2 > 1e-18, turn, np.inf)
        least_turn = turn.min(axis=1, keepdims=True)
        following = np.where(turn <= least_turn + 2e-9, distance2, -1.0).argmax(axis=1)
        cross = x[rows, current] * y[rows, following] - y[rows, current] * x[rows, following]
        area += np.where(is_open, cross, 0.0)
        heading = np.arctan2(dy[rows, following], dx[rows, following])
        current = following
        is_open &= np.abs(x[rows, current] - x[rows, start]) + np.abs(y[rows, current] - y[rows, start]) > 1e-9
    return area / 2


# The assignment of the largest sum of generalised IoU, of which few are computed
#
# Each pair has bounds on both sides. An assignment that is the best one by upper bounds, and stays so when its own
# pairs are worth their lower bounds only, is the best one. Where it does not stay so, the pairs that it would give up
# are computed, and their drive is assigned again. Where there are fewer detections than tracks and each likes another
# track best (or the other way round), no assignment is needed at all.

_Rows = Int[np.ndarray, " k"]
_MARGIN = 1e-9
_MOST_CELLS = 1 << 20  # pairs at a time
_PADDING_X_M = 1e12


def assign_giou(
    tracks: Float[np.ndarray, "n 7"],
    track_drive: Int[np.ndarray, " n"],
    detections: Float[np.ndarray, "m 7"],
    detection_drive: Int[np.ndarray, " m"],
    drives: int,
    gate: Float[np.ndarray, " m"],
) -> tuple[_Rows, _Rows]:
    """Pair tracks and detections of each drive, as many as there are of the fewer, for the largest sum.

    Args:
        tracks: Boxes as x, y, z, length, width, height, yaw; by drive.
        track_drive: Their drives, rising.
        detections: The detections likewise.
        detection_drive: Their drives, rising.
        drives: Number of drives.
        gate: Least generalised IoU that each detection's pair must have.

    Returns:
        Rows of the tracks, and rows of their detections, of the pairs that reach the gate.
    """
    track_starts, detection_starts = (
        np.searchsorted(numbers, np.arange(drives + 1)) for numbers in (track_drive, detection_drive)
    )
    cells = max(int(np.diff(track_starts).max(initial=0)) * int(np.diff(detection_starts).max(initial=0)), 1)
    at_once = max(_MOST_CELLS // cells, 1)
    cuts = [slice(first, min(first + at_once, drives) + 1) for first in range(0, drives, at_once)]
    pairs = [_assign_drives(tracks, detections, (track_starts[cut], detection_starts[cut]), gate) for cut in cuts]
    none = np.zeros(0, dtype=np.int64)
    return np.concatenate([none, *(a for a, _ in pairs)]), np.concatenate([none, *(b for _, b in pairs)])


def _assign_drives(
    tracks: Float[np.ndarray, "n 7"],
    detections: Float[np.ndarray, "m 7"],
    starts: tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]],
    gate: Float[np.ndarray, " m"],
) -> tuple[_Rows, _Rows]:
    """The pairs of some drives, whose rows begin at ``starts``, that reach the gate."""
    # The favourite of each detection, or of each track where there are fewer of them.
    upper, iou = _upper_bounds(tracks, detections, starts)
    counts = np.diff(starts[0]), np.diff(starts[1])
    drive, row, column = _favourites(upper, counts)
    a, b = row + starts[0][drive], column + starts[1][drive]
    lower, best = _lower_bounds(tracks[a], detections[b], iou[drive, row, column]), upper[drive, row, column]

    # Drives in which these are not the best assignment are assigned.
    is_plain = _are_best(upper, (drive, row, column), lower, counts)
    plain_pairs = is_plain[drive]
    parts = [
        _DriveAssignment(
            (int(starts[0][d]), int(starts[1][d])),
            upper[d, : counts[0][d], : counts[1][d]],
            iou[d, : counts[0][d], : counts[1][d]],
        )
        for d in np.flatnonzero(~is_plain & (counts[0] > 0) & (counts[1] > 0)).tolist()
    ]
    _assign_parts(parts, tracks, detections)
    assigned_a, assigned_b = _assigned_rows(parts)
    a, b = np.r_[a[plain_pairs], assigned_a], np.r_[b[plain_pairs], assigned_b]

    # The gate: pairs whose bounds leave it open are computed.
    lower = np.concatenate([lower[plain_pairs], *(part.lower for part in parts)])
    best = np.concatenate([best[plain_pairs], *(part.upper[part.assignment] for part in parts)])
    passes = lower >= gate[b]
    unsure = np.flatnonzero(~passes & (best >= gate[b]))
    if len(unsure):
        passes[unsure] = iou_3d(tracks[a[unsure]], detections[b[unsure]], generalised=True) >= gate[b[unsure]]
    return a[passes], b[passes]


@dataclass(frozen=True, eq=False, kw_only=True)
class _BoxBounds:
    """What the bounds take of boxes: centre, half the diagonal, area from above, shorter side, height, volume."""

    x: np.ndarray
    y: np.ndarray
    radius_m: np.ndarray
    area_m2: np.ndarray
    side_m: np.ndarray
    height_m: np.ndarray
    volume_m3: np.ndarray

    @classmethod
    def from_rows(cls, rows: Float[np.ndarray, "n 7"]) -> "_BoxBounds":
        length, width, height = rows[:, 3], rows[:, 4], rows[:, 5]
        area = length * width
        return cls(
            x=rows[:, 0],
            y=rows[:, 1],
            radius_m=np.sqrt(length * length + width * width) / 2,
            area_m2=area,
            side_m=np.minimum(length, width),
            height_m=height,
            volume_m3=area * height,
        )

    def padded(self, index: Int[np.ndarray, " n"], shape: tuple[int, int]) -> "_BoxBounds":
        """The same with a row a drive; what fills the rows up is far away from all boxes."""
        fill = {"x": _PADDING_X_M, "volume_m3": 0.0, "radius_m": 0.0}
        columns = {}
        for name, values in vars(self).items():
            column = np.full(shape[0] * shape[1], fill.get(name, 1.0))
            column[index] = values
            columns[name] = column.reshape(shape)
        return _BoxBounds(**columns)

    def __getitem__(self, index: Any) -> "_BoxBounds":
        return _BoxBounds(**{name: values[index] for name, values in vars(self).items()})


def _upper_bounds(
    tracks: Float[np.ndarray, "n 7"],
    detections: Float[np.ndarray, "m 7"],
    starts: tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]],
) -> tuple[Float[np.ndarray, "drives rows columns"], Float[np.ndarray, "drives rows columns"]]:
    """Upper bounds of all pairs of each drive, and the IoU of those that may meet."""
    padded, before = [], []
    for rows, start in zip((tracks, detections), starts, strict=True):
        count = np.diff(start)
        shape = (len(count), max(int(count.max(initial=0)), 1))
        before.append(np.arange(len(count)) * shape[1] - start[:-1])
        index = np.arange(start[0], start[-1]) + np.repeat(before[-1], count)
        padded.append(_BoxBounds.from_rows(rows[start[0] : start[-1]]).padded(index, shape))
    a, b = padded[0][:, :, None], padded[1][:, None, :]
    gap_x, gap_y = a.x - b.x, a.y - b.y
    gap_m = np.sqrt(gap_x * gap_x + gap_y * gap_y)
    # The outer halves and the trapezoid of `_can_reach_gate`: exact for nothing, a bound for pairs that are apart.
    hull_m2 = (a.area_m2 + b.area_m2 + gap_m * (a.side_m + b.side_m)) / 2
    most = (a.volume_m3 + b.volume_m3) / (hull_m2 * np.maximum(a.height_m, b.height_m))
    upper = np.minimum(most, 1.0) - 1 + _MARGIN
    near = np.nonzero(gap_m < a.radius_m + b.radius_m)
    row = near[0] * upper.shape[1] + near[1] - before[0][near[0]]
    column = near[0] * upper.shape[2] + near[2] - before[1][near[0]]
    iou = np.zeros(upper.shape)
    iou[near] = iou_3d(tracks[row], detections[column])
    upper[near] += iou[near]  # the bound holds for what generalised IoU takes off
    return upper, iou


def _lower_bounds(a: _BoxRows, b: _BoxRows, iou: Float[np.ndarray, " p"]) -> np.ndarray:
    """Lower bounds of generalised IoU: with the rectangle around both, along the first box, for their hull."""
    gap_x, gap_y, turn = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1], b[:, 6] - a[:, 6]
    cos, sin, cos_a, sin_a = np.abs(np.cos(turn)), np.abs(np.sin(turn)), np.cos(a[:, 6]), np.sin(a[:, 6])
    area_m2 = np.ones(len(a))
    for gap, half, half_b in (
        (gap_x * cos_a + gap_y * sin_a, a[:, 3] / 2, (b[:, 3] * cos + b[:, 4] * sin) / 2),
        (gap_y * cos_a - gap_x * sin_a, a[:, 4] / 2, (b[:, 3] * sin + b[:, 4] * cos) / 2),
    ):
        area_m2 *= np.maximum(half, gap + half_b) - np.minimum(-half, gap - half_b)
    highest = np.maximum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    lowest = np.minimum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2)
    union_m3 = (a[:, 3] * a[:, 4] * a[:, 5] + b[:, 3] * b[:, 4] * b[:, 5]) / (1 + iou)
    return np.asarray(iou + np.minimum(union_m3 / (area_m2 * (highest - lowest)), 1.0) - 1 - _MARGIN)


def _favourites(
    upper: Float[np.ndarray, "d n m"], counts: tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]]
) -> tuple[_Rows, _Rows, _Rows]:
    """Drive, row and column of the best pair of each detection, or of each track where there are fewer of them."""
    fewer = counts[1] <= counts[0]
    drive_b, column = np.nonzero((np.arange(upper.shape[2]) < counts[1][:, None]) & fewer[:, None])
    drive_a, row = np.nonzero((np.arange(upper.shape[1]) < counts[0][:, None]) & ~fewer[:, None])
    best_row, best_column = upper.argmax(axis=1)[drive_b, column], upper.argmax(axis=2)[drive_a, row]
    return np.r_[drive_b, drive_a], np.r_[best_row, row], np.r_[column, best_column]


def _are_best(
    upper: Float[np.ndarray, "d n m"],
    favourites: tuple[_Rows, _Rows, _Rows],
    lower: Float[np.ndarray, " k"],
    counts: tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]],
) -> Bool[np.ndarray, " d"]:
    """Drives in which the favourites are the best assignment: all differ, and no other pair could be better."""
    drive, row, column = favourites
    best = upper[favourites]
    upper[favourites] = -np.inf
    by_column = counts[1][drive] <= counts[0][drive]
    second = np.where(by_column, upper.max(axis=1)[drive, column], upper.max(axis=2)[drive, row])
    upper[favourites] = best
    choice = np.where(by_column, row, column) + drive * max(upper.shape[1:])
    rivals = np.bincount(choice, minlength=1)[choice]
    is_open = (lower < second) | (rivals > 1)
    return np.bincount(drive[is_open], minlength=len(upper)) == 0


class _DriveAssignment:
    """Tracks and detections of one drive: what each pair is worth at most, and whether exactly.

    Args:
        first: Rows of its first track and of its first detection.
        upper: Upper bounds.
        iou: IoU of the pairs that may meet, else 0.
    """

    def __init__(self, first: tuple[int, int], upper: Float[np.ndarray, "n m"], iou: Float[np.ndarray, "n m"]) -> None:
        self.first, self.upper, self.iou = first, upper, iou
        self.is_exact: Bool[np.ndarray, "n m"] = np.zeros(upper.shape, dtype=bool)
        self.lower = np.zeros(0)
        self.assignment: tuple[np.ndarray, ...] = ()

    def assign(self) -> None:
        """Assign by upper bounds."""
        self.assignment = linear_sum_assignment(self.upper, maximize=True)

    def doubtful_pairs(self, lower: Float[np.ndarray, " k"]) -> tuple[np.ndarray, ...]:
        """The assigned pairs that would be given up if all were worth as little as that; none if it holds."""
        exact = self.is_exact[self.assignment]
        self.lower = np.where(exact, self.upper[self.assignment], lower)
        lowered = self.upper.copy()
        lowered[self.assignment] = self.lower
        other = linear_sum_assignment(lowered, maximize=True)
        if float(lowered[other].sum()) <= float(self.lower.sum()) + 1e-12:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        in_other = np.zeros(self.upper.shape, dtype=bool)
        in_other[other] = True
        given_up = ~in_other[self.assignment] & ~exact
        return self.assignment[0][given_up], self.assignment[1][given_up]


def _assign_parts(
    parts: Sequence[_DriveAssignment], tracks: Float[np.ndarray, "n 7"], detections: Float[np.ndarray, "m 7"]
) -> None:
    """Assign each part, computing the pairs that its assignment needs."""
    active = list(parts)
    while active:
        for part in active:
            part.assign()
        a, b = _assigned_rows(active)
        lower = _lower_bounds(tracks[a], detections[b], np.concatenate([part.iou[part.assignment] for part in active]))
        lowers = np.split(lower, np.cumsum([len(part.assignment[0]) for part in active])[:-1])
        doubts = [(part, part.doubtful_pairs(values)) for part, values in zip(active, lowers, strict=True)]
        doubts = [(part, pairs) for part, pairs in doubts if len(pairs[0])]
        if not doubts:
            return
        a = np.concatenate([pairs[0] + part.first[0] for part, pairs in doubts])
        b = np.concatenate([pairs[1] + part.first[1] for part, pairs in doubts])
        giou = iou_3d(tracks[a], detections[b], generalised=True)
        start = 0
        for part, pairs in doubts:
            part.upper[pairs] = giou[start : start + len(pairs[0])]
            part.is_exact[pairs] = True
            start += len(pairs[0])
        active = [part for part, _ in doubts]


def _assigned_rows(parts: Sequence[_DriveAssignment]) -> tuple[_Rows, _Rows]:
    """Rows of the tracks and of the detections that are assigned."""
    none = np.zeros(0, dtype=np.int64)
    a, b = (np.concatenate([none, *(part.assignment[side] + part.first[side] for part in parts)]) for side in (0, 1))
    return a, b
