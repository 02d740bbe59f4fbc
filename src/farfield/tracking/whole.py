"""The assignment of the largest sum of generalised IoU, of which few are worked out.

Each pair has bounds on both sides. An assignment that is the best one by upper bounds, and stays so when its own pairs
are worth their lower bounds only, is the best one. Where it does not stay so, the pairs that it would give up are
worked out, and their drive is assigned again. Where there are fewer detections than tracks and each likes another track
best (or the other way round), no assignment is needed at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from farfield.tracking.similarity import iou_3d

_Rows = Int[np.ndarray, " k"]
_MARGIN = 1e-9
_MOST_CELLS = 1 << 20
_NOWHERE_M = 1e12


@dataclass(frozen=True, eq=False, kw_only=True)
class _BoxBounds:
    """What the bounds take of each box: centre, half the diagonal, area from above, shorter side, height, volume."""

    x: np.ndarray
    y: np.ndarray
    reach: np.ndarray
    flat: np.ndarray
    side: np.ndarray
    high: np.ndarray
    solid: np.ndarray

    @classmethod
    def of(cls, rows: Float[np.ndarray, "n 7"]) -> "_BoxBounds":
        length, width, high = rows[:, 3], rows[:, 4], rows[:, 5]
        flat = length * width
        return cls(
            x=rows[:, 0],
            y=rows[:, 1],
            reach=np.sqrt(length * length + width * width) / 2,
            flat=flat,
            side=np.minimum(length, width),
            high=high,
            solid=flat * high,
        )

    def padded(self, places: Int[np.ndarray, " n"], shape: tuple[int, int]) -> "_BoxBounds":
        """The same with a row a drive; what fills the rows up is far away from all boxes."""
        parts = {}
        for name, values in vars(self).items():
            rows = np.full(shape[0] * shape[1], {"x": _NOWHERE_M, "solid": 0.0, "reach": 0.0}.get(name, 1.0))
            rows[places] = values
            parts[name] = rows.reshape(shape)
        return _BoxBounds(**parts)

    def __getitem__(self, index: Any) -> "_BoxBounds":
        return _BoxBounds(**{name: values[index] for name, values in vars(self).items()})


def _bounds(a: _BoxBounds, b: _BoxBounds) -> tuple[np.ndarray, Bool[np.ndarray, "..."]]:
    """What pairs that are apart are worth at most, and which pairs may meet."""
    gap_x, gap_y = a.x - b.x, a.y - b.y
    gap_m = np.sqrt(gap_x * gap_x + gap_y * gap_y)
    # See the outer halves and the trapezoid of `association._may_pass`.
    hull_m2 = (a.flat + b.flat + gap_m * (a.side + b.side)) / 2
    most = (a.solid + b.solid) / (hull_m2 * np.maximum(a.high, b.high))
    return np.minimum(most, 1.0) - 1 + _MARGIN, gap_m < a.reach + b.reach


def best_whole(
    tracks: Float[np.ndarray, "n 7"],
    track_drive: Int[np.ndarray, " n"],
    seen: Float[np.ndarray, "m 7"],
    seen_drive: Int[np.ndarray, " m"],
    drives: int,
    gate: Float[np.ndarray, " m"],
) -> tuple[_Rows, _Rows]:
    """Pair tracks and detections of each drive, as many as there are of the fewer, for the largest sum.

    Args:
        tracks: Boxes as x, y, z, length, width, height, yaw; by drive.
        track_drive: Their drives, rising.
        seen: The detections likewise.
        seen_drive: Their drives, rising.
        drives: Number of drives.
        gate: Least generalised IoU that each detection's pair keeps.

    Returns:
        Rows of the tracks, and rows of their detections, of the pairs that reach the gate.
    """
    starts = [np.searchsorted(of, np.arange(drives + 1)) for of in (track_drive, seen_drive)]
    cells = max(int(np.diff(starts[0]).max(initial=0)) * int(np.diff(starts[1]).max(initial=0)), 1)
    each = max(_MOST_CELLS // cells, 1)
    cuts = [slice(first, min(first + each, drives) + 1) for first in range(0, drives, each)]
    found = [_of_drives(tracks, seen, (starts[0][cut], starts[1][cut]), gate) for cut in cuts]
    none = np.zeros(0, dtype=np.int64)
    return np.concatenate([none, *(a for a, _ in found)]), np.concatenate([none, *(b for _, b in found)])


class _DriveAssignment:
    """Tracks and detections of one drive: what each pair is worth at most, and whether exactly.

    Args:
        first: Rows of its first track and of its first detection.
        worth: Upper bounds.
        shared: IoU of the pairs that may meet, else 0.
    """

    def __init__(
        self, first: tuple[int, int], worth: Float[np.ndarray, "n m"], shared: Float[np.ndarray, "n m"]
    ) -> None:
        self.first, self.worth, self.shared = first, worth, shared
        self.exact: Bool[np.ndarray, "n m"] = np.zeros(worth.shape, dtype=bool)
        self.least = np.zeros(0)
        self.chosen: tuple[np.ndarray, ...] = ()

    def choose(self) -> None:
        """Assign by upper bounds."""
        self.chosen = linear_sum_assignment(self.worth, maximize=True)

    def doubted(self, least: Float[np.ndarray, " k"]) -> tuple[np.ndarray, ...]:
        """The chosen pairs that would be given up if all of them were worth as little as that; none if it holds."""
        exact = self.exact[self.chosen]
        self.least = np.where(exact, self.worth[self.chosen], least)
        lowered = self.worth.copy()
        lowered[self.chosen] = self.least
        again = linear_sum_assignment(lowered, maximize=True)
        if float(lowered[again].sum()) <= float(self.least.sum()) + 1e-12:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        kept = np.zeros(self.worth.shape, dtype=bool)
        kept[again] = True
        given_up = ~kept[self.chosen] & ~exact
        return self.chosen[0][given_up], self.chosen[1][given_up]


def _of_drives(
    tracks: Float[np.ndarray, "n 7"],
    seen: Float[np.ndarray, "m 7"],
    starts: tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]],
    gate: Float[np.ndarray, " m"],
) -> tuple[_Rows, _Rows]:
    """The pairs of some drives, whose rows begin at ``starts``, that reach the gate."""
    most, shared = _grid(tracks, seen, starts)
    counts = np.diff(starts[0]), np.diff(starts[1])
    drive, row, column = _favourites(most, counts)
    a, b = row + starts[0][drive], column + starts[1][drive]
    least, worth = _at_least(tracks[a], seen[b], shared[drive, row, column]), most[drive, row, column]
    plain = _are_best(most, (drive, row, column), least, counts)
    of_plain = plain[drive]
    parts = [
        _DriveAssignment(
            (int(starts[0][d]), int(starts[1][d])),
            most[d, : counts[0][d], : counts[1][d]],
            shared[d, : counts[0][d], : counts[1][d]],
        )
        for d in np.flatnonzero(~plain & (counts[0] > 0) & (counts[1] > 0)).tolist()
    ]
    _finish(parts, tracks, seen)
    more, more_b = _rows(parts)
    a, b = np.r_[a[of_plain], more], np.r_[b[of_plain], more_b]
    least = np.concatenate([least[of_plain], *(part.least for part in parts)])
    worth = np.concatenate([worth[of_plain], *(part.worth[part.chosen] for part in parts)])
    kept = least >= gate[b]
    unsure = np.flatnonzero(~kept & (worth >= gate[b]))
    if len(unsure):
        kept[unsure] = iou_3d(tracks[a[unsure]], seen[b[unsure]], generalised=True) >= gate[b[unsure]]
    return a[kept], b[kept]


def _favourites(
    most: Float[np.ndarray, "d n m"], counts: tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]]
) -> tuple[_Rows, _Rows, _Rows]:
    """Drive, row and column of the best pair of each detection, or of each track where there are fewer of them."""
    fewer = counts[1] <= counts[0]
    drive_b, column = np.nonzero((np.arange(most.shape[2]) < counts[1][:, None]) & fewer[:, None])
    drive_a, row = np.nonzero((np.arange(most.shape[1]) < counts[0][:, None]) & ~fewer[:, None])
    of_column, of_row = most.argmax(axis=1)[drive_b, column], most.argmax(axis=2)[drive_a, row]
    return np.r_[drive_b, drive_a], np.r_[of_column, row], np.r_[column, of_row]


def _are_best(
    most: Float[np.ndarray, "d n m"],
    favourites: tuple[_Rows, _Rows, _Rows],
    least: Float[np.ndarray, " k"],
    counts: tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]],
) -> Bool[np.ndarray, " d"]:
    """Drives in which the favourites are the best assignment: all differ, and no other pair could be better."""
    drive, row, column = favourites
    kept = most[favourites]
    most[favourites] = -np.inf
    by_column = counts[1][drive] <= counts[0][drive]
    second = np.where(by_column, most.max(axis=1)[drive, column], most.max(axis=2)[drive, row])
    most[favourites] = kept
    place = np.where(by_column, row, column) + drive * max(most.shape[1:])
    rivals = np.bincount(place, minlength=1)[place]
    bad = (least < second) | (rivals > 1)
    return np.bincount(drive[bad], minlength=len(most)) == 0


def _grid(
    tracks: Float[np.ndarray, "n 7"],
    seen: Float[np.ndarray, "m 7"],
    starts: tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]],
) -> tuple[Float[np.ndarray, "drives rows columns"], Float[np.ndarray, "drives rows columns"]]:
    """Upper bounds of all pairs of each drive, and the IoU of those that may meet."""
    padded, before = [], []
    for rows, start in zip((tracks, seen), starts, strict=True):
        count = np.diff(start)
        shape = (len(count), max(int(count.max(initial=0)), 1))
        before.append(np.arange(len(count)) * shape[1] - start[:-1])
        places = np.arange(start[0], start[-1]) + np.repeat(before[-1], count)
        padded.append(_BoxBounds.of(rows[start[0] : start[-1]]).padded(places, shape))
    most, near = _bounds(padded[0][:, :, None], padded[1][:, None, :])
    at = np.nonzero(near)
    shared = np.zeros(most.shape)
    a = at[0] * most.shape[1] + at[1] - before[0][at[0]]
    b = at[0] * most.shape[2] + at[2] - before[1][at[0]]
    shared[at] = iou_3d(tracks[a], seen[b])
    most[at] += shared[at]  # the bound holds for what generalised IoU takes off
    return most, shared


def _rows(parts: Sequence[_DriveAssignment]) -> tuple[_Rows, _Rows]:
    """Rows of the tracks and of the detections that are chosen."""
    none = np.zeros(0, dtype=np.int64)
    a, b = (np.concatenate([none, *(part.chosen[side] + part.first[side] for part in parts)]) for side in (0, 1))
    return a, b


def _finish(
    parts: Sequence[_DriveAssignment], tracks: Float[np.ndarray, "n 7"], seen: Float[np.ndarray, "m 7"]
) -> None:
    """Assign each part, working out what its assignment needs."""
    active = list(parts)
    while active:
        for part in active:
            part.choose()
        a, b = _rows(active)
        least = _at_least(tracks[a], seen[b], np.concatenate([part.shared[part.chosen] for part in active]))
        lows = np.split(least, np.cumsum([len(part.chosen[0]) for part in active])[:-1])
        doubts = [(part, part.doubted(low)) for part, low in zip(active, lows, strict=True)]
        doubts = [(part, pairs) for part, pairs in doubts if len(pairs[0])]
        if not doubts:
            return
        a = np.concatenate([np.zeros(0, dtype=np.int64), *(pairs[0] + part.first[0] for part, pairs in doubts)])
        b = np.concatenate([np.zeros(0, dtype=np.int64), *(pairs[1] + part.first[1] for part, pairs in doubts)])
        worth = iou_3d(tracks[a], seen[b], generalised=True)
        done = 0
        for part, pairs in doubts:
            part.worth[pairs], part.exact[pairs] = worth[done : done + len(pairs[0])], True
            done += len(pairs[0])
        active = [part for part, _ in doubts]


def _at_least(a: Float[np.ndarray, "p 7"], b: Float[np.ndarray, "p 7"], iou: Float[np.ndarray, " p"]) -> np.ndarray:
    """Lower bounds of generalised IoU: with the rectangle around both, along the first box, for their hull."""
    gap_x, gap_y, turn = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1], b[:, 6] - a[:, 6]
    cos, sin, cos_a, sin_a = np.abs(np.cos(turn)), np.abs(np.sin(turn)), np.cos(a[:, 6]), np.sin(a[:, 6])
    area = np.ones(len(a))
    for gap, half, half_b in (
        (gap_x * cos_a + gap_y * sin_a, a[:, 3] / 2, (b[:, 3] * cos + b[:, 4] * sin) / 2),
        (gap_y * cos_a - gap_x * sin_a, a[:, 4] / 2, (b[:, 3] * sin + b[:, 4] * cos) / 2),
    ):
        area *= np.maximum(half, gap + half_b) - np.minimum(-half, gap - half_b)
    high = np.maximum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    low = np.minimum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2)
    union = (a[:, 3] * a[:, 4] * a[:, 5] + b[:, 3] * b[:, 4] * b[:, 5]) / (1 + iou)
    return np.asarray(iou + np.minimum(union / (area * (high - low)), 1.0) - 1 - _MARGIN)
