"""Which detection continues which track."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from farfield.metrics.frames import same_owner
from farfield.metrics.tracking.pairing import best_pairs, greedy_pairs
from farfield.tracking.settings import TrackerSettings
from farfield.tracking.similarity import iou_3d
from farfield.tracking.whole import best_whole

_Pairs = tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]


@dataclass(frozen=True, eq=False, kw_only=True)
class GateUncertainty:
    """How uncertain places are, for gates.

    Args:
        wider_m: What gates of distance grow by, of each track, shape (n,).
        tracks_m2: Variances of the tracks' x and y, shape (n, 2).
        seen_m2: Variances of the detections' x and y, shape (m, 2).
        radial: How far measured radial velocities of pairs (rows of tracks, rows of detections) lie from the tracks',
            in standard deviations; None where there are none.
    """

    wider_m: Float[np.ndarray, " n"]
    tracks_m2: Float[np.ndarray, "n 2"]
    seen_m2: Float[np.ndarray, "m 2"]
    radial: Callable[[Int[np.ndarray, " p"], Int[np.ndarray, " p"]], np.ndarray] | None = None

    def may_pass(
        self, gap_m: Float[np.ndarray, "p 2"], a: Int[np.ndarray, " p"], b: Int[np.ndarray, " p"], sigmas: float
    ) -> np.ndarray:
        """Pairs whose places, and whose radial velocities, differ by at most so many standard deviations."""
        near = np.asarray((gap_m**2 / (self.tracks_m2[a] + self.seen_m2[b])).sum(axis=1) <= sigmas**2)
        return near if self.radial is None else near & (self.radial(a, b) <= sigmas)


def associate(
    tracks: Float[np.ndarray, "n 7"],
    track_drive: Int[np.ndarray, " n"],
    track_label: Int[np.ndarray, " n"],
    seen: Float[np.ndarray, "m 7"],
    seen_drive: Int[np.ndarray, " m"],
    seen_label: Int[np.ndarray, " m"],
    settings: TrackerSettings,
    gate: Float[np.ndarray, " labels"],
    reach: GateUncertainty | None = None,
) -> _Pairs:
    """Pair tracks and detections of the same drive, each once.

    Args:
        tracks: Predicted boxes as x, y, z (centre), length, width, height, yaw; by drive.
        track_drive: Their drives, rising.
        track_label: Their classes.
        seen: The detections likewise, by drive, the best score first.
        seen_drive: Their drives, rising.
        seen_label: Their classes.
        settings: Similarity, assignment, gate's order.
        gate: Gate of each class: least similarity, or largest distance.
        reach: What widens or narrows it.

    Returns:
        Rows of the tracks and rows of their detections.
    """
    drives = int(max(track_drive.max(initial=-1), seen_drive.max(initial=-1))) + 1
    if _is_whole(settings, track_label, seen_label):
        return best_whole(tracks, track_drive, seen, seen_drive, drives, gate[seen_label])
    a, b = same_owner(track_drive, seen_drive, drives)
    if settings.same_class:
        alike = track_label[a] == seen_label[b]
        a, b = a[alike], b[alike]
    if reach is not None and settings.gate_sigmas is not None:
        near = reach.may_pass(tracks[a, :2] - seen[b, :2], a, b, settings.gate_sigmas)
        a, b = a[near], b[near]
    limit = gate[seen_label[b]]
    if reach is not None and settings.similarity == "distance":
        limit = limit + reach.wider_m[a]
    if settings.gate_first or settings.similarity == "iou":
        near = _may_pass(tracks, seen, a, b, settings, limit)
        a, b, limit = a[near], b[near], limit[near]
    if not len(a):
        return a, b
    worth = _worth(tracks[a], seen[b], settings)
    least = limit if settings.similarity != "distance" else -limit
    if settings.gate_first:
        passed = worth >= least
        a, b, worth, least = a[passed], b[passed], worth[passed], least[passed]
    if settings.assignment == "greedy":
        chosen = greedy_pairs(a, b, np.lexsort([-worth, b]))
    else:
        chosen = best_pairs(a, b, worth + _lift(worth, settings), track_drive[a])
    chosen = chosen[worth[chosen] >= least[chosen]]
    return a[chosen], b[chosen]


def _is_whole(settings: TrackerSettings, of_tracks: np.ndarray, of_seen: np.ndarray) -> bool:
    """Whether every track may take every detection of its drive, by generalised IoU."""
    alike = not settings.same_class or len({*of_tracks.tolist(), *of_seen.tolist()}) < 2
    gated = settings.gate_first or settings.gate_sigmas is not None
    return alike and not gated and settings.similarity == "giou" and settings.assignment == "hungarian"


def _lift(worth: Float[np.ndarray, " p"], settings: TrackerSettings) -> float:
    """What makes every possible pair better than none; overlaps are so already."""
    return 0.0 if settings.similarity == "iou" else 1.0 - float(worth.min(initial=0.0))


def _worth(a: Float[np.ndarray, "p 7"], b: Float[np.ndarray, "p 7"], settings: TrackerSettings) -> np.ndarray:
    if settings.similarity == "distance":
        return -np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1])
    return iou_3d(a, b, generalised=settings.similarity == "giou")


def _may_pass(
    tracks: Float[np.ndarray, "n 7"],
    seen: Float[np.ndarray, "m 7"],
    a: Int[np.ndarray, " p"],
    b: Int[np.ndarray, " p"],
    settings: TrackerSettings,
    gate: Float[np.ndarray, " p"],
) -> np.ndarray:
    """Pairs that are near enough for the gate, by their centres alone."""
    gap_m = np.hypot(tracks[a, 0] - seen[b, 0], tracks[a, 1] - seen[b, 1])
    if settings.similarity == "distance":
        return np.asarray(gap_m <= gate)
    reach = (np.hypot(tracks[:, 3], tracks[:, 4])[a] + np.hypot(seen[:, 3], seen[:, 4])[b]) / 2
    if settings.similarity == "iou":
        return np.asarray(gap_m < reach)
    # Seen from above, the hull holds the outer halves of both, and a trapezoid over the line between the centres.
    flat_m2 = tracks[a, 3] * tracks[a, 4] + seen[b, 3] * seen[b, 4]
    solid_m3 = np.prod(tracks[a, 3:6], axis=1) + np.prod(seen[b, 3:6], axis=1)
    high_m = np.maximum(tracks[a, 5], seen[b, 5])
    across_m = np.minimum(tracks[a, 3], tracks[a, 4]) + np.minimum(seen[b, 3], seen[b, 4])
    most_m2 = solid_m3 / (np.maximum(1 + gate, 1e-3) * high_m)
    return np.asarray((gap_m < reach) | (gap_m <= (2 * most_m2 - flat_m2) / across_m))
