"""Tracks of one object that was out of sight for a while, joined afterwards: by motion, size and class.

A track's end and another's begin are one object's if it may have moved from the one to the other: on with the speed
that it had, back with the speed that it has, or with the mean of both, each within an error that grows with the time
between; and if it is as large, and of the class that it was of at this end. The pairs of a drive are chosen together,
for the least sum of errors.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Shaped
from scipy.optimize import linear_sum_assignment

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.detections import Detections
from farfield.tracking.smoothing import TrackRows, tracks_of
from farfield.tracking.timeline import timelines

_NOT = 2.0  # worth of pairs that are no pair: above the 1 of the worst that is one


@dataclass(frozen=True, kw_only=True)
class JoinSettings:
    """What two tracks of one object may differ by.

    Args:
        longest_s: Longest time between them.
        near_m: Error of the place that is allowed at once.
        speed_m_s: What the error grows by for each second between them.
        size: Largest relative difference of length, width or height.
        boxes: Boxes at a track's end from which its speed is taken.
        size_boxes: Boxes at a track's end whose median size is compared, where sizes are sure but change along a track;
            None takes the mean of the whole track, where they are noisy.
    """

    longest_s: float = 10.0
    near_m: float = 3.0
    speed_m_s: float = 5.0
    size: float = 0.1
    boxes: int = 8
    size_boxes: int | None = None

    def __post_init__(self) -> None:
        for name in ("longest_s", "near_m", "size"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected a positive number, got {getattr(self, name)!r}")
        if not self.speed_m_s >= 0 or self.boxes < 1 or (self.size_boxes is not None and self.size_boxes < 1):
            raise ConfigError(f"joining: expected speed_m_s of 0 or more and 1 box or more, got {self}")


ANNOTATED = JoinSettings(longest_s=30.0, near_m=8.0, size=0.001, size_boxes=8)
"""For boxes that people drew: an object that comes back is as long, wide and high as before, to the last digit, so that
its place may be less sure. Chosen on the odd ones of K-Radar's sequences."""


def joining_of(preset: str) -> JoinSettings:
    """What may be joined of a tracker's tracks, by the name of its preset."""
    return ANNOTATED if preset == "annotated" else JoinSettings()


def joined(tracks: Detections, chosen: JoinSettings | None = None, *, step_s: float = 0.1) -> Detections:
    """Join tracks, looking ahead; boxes stay as they are, and no two boxes of a frame become one object's.

    Args:
        tracks: Boxes with ``track_id``.
        chosen: What is allowed.
        step_s: Seconds between frames where there are no stamps.

    Returns:
        The same with the ``track_id`` of each object's first track.
    """
    names: dict[tuple[str, int], int] = {}
    for drive in timelines(tracks, step_s=step_s):
        found = tracks_of(tracks, drive)
        times_s = np.cumsum(drive.step_s)
        after = _pairs(found, times_s, chosen or JoinSettings())
        for row, each in enumerate(found):
            first = row
            while first in after:
                first = after[first]
            sequence = drive.keys[int(each.number[0])][0]
            names[sequence, each.name] = found[first].name
    boxes = {key: _renamed(key, part, names) for key, part in tracks.boxes.items()}
    return replace(tracks, boxes=boxes)


def _renamed(key: Key, part: Boxes, names: dict[tuple[str, int], int]) -> Boxes:
    if part.track_id is None or not len(part):
        return part
    return part.replace(track_id=np.array([names[key[0], name] for name in part.track_id.tolist()], dtype=np.int64))


@dataclass(frozen=True, eq=False)
class _TrackEnds:
    """One end of each track: when and where it is, how fast the object moves there (0 for a single box), what it is.

    Args:
        time_s: Time of the last box, or of the first.
        place_m: Its centre.
        speed_m_s: Velocity of the boxes at this end.
        log_size: Logarithms of length, width and height.
        label: Class of the last box, or of the first.
    """

    time_s: Float[np.ndarray, " n"]
    place_m: Float[np.ndarray, "n 2"]
    speed_m_s: Float[np.ndarray, "n 2"]
    log_size: Float[np.ndarray, "n 3"]
    label: Shaped[np.ndarray, " n"]

    @classmethod
    def of(
        cls, tracks: list[TrackRows], times_s: Float[np.ndarray, " frames"], settings: JoinSettings, *, last: bool
    ) -> "_TrackEnds":
        rows, end = [], -1 if last else 0
        for each in tracks:
            chosen = _at(settings.boxes, last=last)
            time, place = times_s[each.number[chosen]], each.boxes.centre_m[chosen, :2]
            away = time - time.mean()
            spread = float(away @ away)
            speed = away @ place / spread if spread > 0 else np.zeros(2)
            rows.append(np.concatenate([[time[end]], place[end], speed, _log_size(each.boxes, settings, last=last)]))
        table = np.array(rows).reshape(-1, 8)
        label = np.array([str(each.boxes.label[end]) for each in tracks])
        return cls(table[:, 0], table[:, 1:3], table[:, 3:5], table[:, 5:], label)

    def alike(self, others: "_TrackEnds", most: float) -> Bool[np.ndarray, "n m"]:
        """Which of these and those are of one class and of sizes that differ by at most a share."""
        near = np.abs(self.log_size[:, None] - others.log_size[None]).max(axis=2) <= np.log1p(most)
        return np.asarray(near & (self.label[:, None] == others.label[None]))


def _at(boxes: int, *, last: bool) -> slice:
    return slice(-boxes, None) if last else slice(None, boxes)


def _log_size(boxes: Boxes, settings: JoinSettings, *, last: bool) -> Float[np.ndarray, " 3"]:
    if settings.size_boxes is None:
        return np.asarray(np.log(boxes.size_m.mean(axis=0)))
    return np.asarray(np.log(np.median(boxes.size_m[_at(settings.size_boxes, last=last)], axis=0)))


def _pairs(tracks: list[TrackRows], times_s: Float[np.ndarray, " frames"], chosen: JoinSettings) -> dict[int, int]:
    """For each track that goes on another: the number of that one."""
    if len(tracks) < 2:
        return {}
    ends, begins = (_TrackEnds.of(tracks, times_s, chosen, last=last) for last in (True, False))
    gap_s = begins.time_s[None] - ends.time_s[:, None]
    may = (gap_s > 0) & (gap_s <= chosen.longest_s) & ends.alike(begins, chosen.size)
    way = begins.place_m[None] - ends.place_m[:, None]
    speeds = (ends.speed_m_s[:, None], begins.speed_m_s[None], (ends.speed_m_s[:, None] + begins.speed_m_s[None]) / 2)
    off_m = np.min([np.linalg.norm(way - speed * gap_s[..., None], axis=2) for speed in speeds], axis=0)
    error = np.where(may, off_m / (chosen.near_m + chosen.speed_m_s * np.maximum(gap_s, 0)), _NOT)
    before, after = linear_sum_assignment(np.where(error <= 1, error, _NOT))
    good = error[before, after] <= 1
    return dict(zip(after[good].tolist(), before[good].tolist(), strict=True))
