"""The assignment of the largest sum of generalised IoU, of which few are worked out.

Pairs of boxes that are apart begin with an upper bound. An assignment that chooses no pair with a mere bound is the
best one; else the chosen ones are worked out, and their drive is assigned again.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from farfield.tracking.similarity import iou_3d

_Rows = Int[np.ndarray, " k"]


class _Part:
    """Tracks and detections of one drive: what each pair is worth at most, and whether exactly."""

    def __init__(
        self,
        tracks: Float[np.ndarray, "n 7"],
        seen: Float[np.ndarray, "m 7"],
        first: tuple[int, int],
        facts: tuple[Float[np.ndarray, "4 n"], Float[np.ndarray, "4 m"]],
    ) -> None:
        (reach, flat, side, solid), (reach_b, flat_b, side_b, solid_b) = facts
        self.first = first
        gap_m = np.hypot(tracks[:, :1] - seen[:, 0], tracks[:, 1:2] - seen[:, 1])
        # See the outer halves and the trapezoid of `association._may_pass`.
        hull_m2 = (flat[:, None] + flat_b + gap_m * (side[:, None] + side_b)) / 2
        most = (solid[:, None] + solid_b) / (hull_m2 * np.maximum(tracks[:, 5:6], seen[:, 5]))
        self.worth: np.ndarray = np.minimum(most, 1.0) - 1 + 1e-9
        self.exact: Bool[np.ndarray, "n m"] = np.zeros(gap_m.shape, dtype=bool)
        self.wanted: tuple[np.ndarray, ...] = np.nonzero(gap_m < reach[:, None] + reach_b)
        self.chosen: tuple[np.ndarray, ...] = ()

    def choose(self) -> bool:
        """Assign; whether a chosen pair is to be worked out yet."""
        a, b = linear_sum_assignment(self.worth, maximize=True)
        self.chosen = a, b
        open_ = ~self.exact[a, b]
        self.wanted = a[open_], b[open_]
        return bool(open_.any())


def best_whole(
    tracks: Float[np.ndarray, "n 7"],
    track_drive: Int[np.ndarray, " n"],
    seen: Float[np.ndarray, "m 7"],
    seen_drive: Int[np.ndarray, " m"],
    drives: int,
) -> tuple[_Rows, _Rows, Float[np.ndarray, " k"]]:
    """Pair tracks and detections of each drive, as many as there are of the fewer, for the largest sum.

    Args:
        tracks: Boxes as x, y, z, length, width, height, yaw; by drive.
        track_drive: Their drives, rising.
        seen: The detections likewise.
        seen_drive: Their drives, rising.
        drives: Number of drives.

    Returns:
        Rows of the tracks, rows of their detections, and their generalised IoU.
    """
    i, j = (np.searchsorted(of, np.arange(drives + 1)).tolist() for of in (track_drive, seen_drive))
    facts, facts_b = _facts(tracks), _facts(seen)
    parts = [
        _Part(
            tracks[i[d] : i[d + 1]],
            seen[j[d] : j[d + 1]],
            (i[d], j[d]),
            (facts[:, i[d] : i[d + 1]], facts_b[:, j[d] : j[d + 1]]),
        )
        for d in range(drives)
        if i[d + 1] > i[d] and j[d + 1] > j[d]
    ]
    active = parts
    while active:
        _work_out(active, tracks, seen)
        active = [part for part in active if part.choose()]
    none = np.zeros(0, dtype=np.int64)
    return (
        np.concatenate([none, *(part.chosen[0] + part.first[0] for part in parts)]),
        np.concatenate([none, *(part.chosen[1] + part.first[1] for part in parts)]),
        np.concatenate([np.zeros(0), *(part.worth[part.chosen] for part in parts)]),
    )


def _work_out(parts: Sequence[_Part], tracks: Float[np.ndarray, "n 7"], seen: Float[np.ndarray, "m 7"]) -> None:
    """Replace the bounds of the wanted pairs by what they are worth."""
    a = np.concatenate([part.wanted[0] + part.first[0] for part in parts])
    b = np.concatenate([part.wanted[1] + part.first[1] for part in parts])
    worth = iou_3d(tracks[a], seen[b], generalised=True)
    cuts = np.cumsum([len(part.wanted[0]) for part in parts])[:-1]
    for part, values in zip(parts, np.split(worth, cuts), strict=True):
        part.worth[part.wanted], part.exact[part.wanted] = values, True


def _facts(rows: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "4 n"]:
    """Half the diagonal, area seen from above, shorter side, and volume of each box."""
    length, width = rows[:, 3], rows[:, 4]
    flat = length * width
    return np.stack([np.hypot(length, width) / 2, flat, np.minimum(length, width), flat * rows[:, 5]])
