"""Whole tracks, looking ahead: joined over gaps, smoothed, and chosen by their score.

Smoothing is Rauch, Tung and Striebel's (AIAA Journal, 1965), in closed form for each axis: positions run through a
filter of constant velocity and back; sizes become the mean of the track, weighted by score; a heading that points
against most of its track is turned by half a turn; gaps are filled.

Joining: a track's end and another's start are one object's if it may have moved from the one to the other: on with the
speed that it had, back with the speed that it has, or with the mean of both, each within an error that grows with the
time between; and if it is as large, and of the class that it was of at this end. The pairs of a drive are chosen
together, for the least sum of errors.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.optimize import linear_sum_assignment

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.metrics.detections import Detections
from farfield.tracking.timeline import Timeline, timelines

_UNKNOWN_SPEED_VARIANCE = 1e6
_NO_BOXES = Boxes.empty(scored=True)
_NO_PAIR = 2.0  # cost of pairs that may not be joined: above the 1 of the worst that may


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackRows:
    """The boxes of one track in the order of time, in world coordinates where there are poses.

    Args:
        name: Its ``track_id``.
        number: Frames of its drive.
        boxes: A box for each.
        box_px: Likewise in the image; -1 where there is none.
    """

    name: int
    number: Int[np.ndarray, " n"]
    boxes: Boxes
    box_px: Float[np.ndarray, "n 4"]


def tracks_of(tracks: Detections, drive: Timeline) -> list[TrackRows]:
    """The tracks of a drive, each with its boxes in the order of time."""
    rows: dict[int, list[tuple[int, Boxes, np.ndarray]]] = {}
    for number, key in enumerate(drive.keys):
        boxes = tracks.boxes.get(key, _NO_BOXES)
        if not len(boxes) or boxes.track_id is None:
            continue
        box_px = tracks.prediction_details.get(key, {}).get("box_px", np.full((len(boxes), 4), -1.0))
        box_px = np.asarray(box_px, dtype=np.float64)
        in_world = boxes if drive.world_T_frame is None else boxes.transform(drive.world_T_frame[number])
        for row, name in enumerate(boxes.track_id.tolist()):
            rows.setdefault(name, []).append((number, in_world[row], box_px[row : row + 1]))
    return [
        TrackRows(
            name=name,
            number=np.array([number for number, _, _ in track_rows]),
            boxes=Boxes.concatenate([boxes for _, boxes, _ in track_rows]),
            box_px=np.concatenate([box_px for _, _, box_px in track_rows]),
        )
        for name, track_rows in rows.items()
    ]


# Smoothing


def smooth_tracks(
    tracks: Detections,
    *,
    step_s: float = 0.1,
    variance_m2: float = 0.05,
    acceleration: float | None = None,
    longest_gap_s: float = 1.0,
) -> Detections:
    """Smooth tracks, looking ahead.

    Args:
        tracks: Boxes with ``track_id``, best those of the detections themselves.
        step_s: Seconds between frames where there are no stamps.
        variance_m2: Variance of a box's position along each axis.
        acceleration: Variance of the acceleration, (m/s^2)^2; None takes 9 where there are poses, else 200, since the
            sensor's own motion is in it.
        longest_gap_s: Frames between two boxes of a track are filled if these are not further apart.

    Returns:
        The same tracks with smoothed boxes and velocities, and boxes in gaps; a box that was filled in has no box in
        the image (-1). A track of one box stays as it is.
    """
    rows: dict[Key, list[tuple[Boxes, np.ndarray]]] = {key: [] for key in tracks.boxes}
    for drive in timelines(tracks, step_s=step_s):
        white = acceleration if acceleration is not None else (200.0 if drive.world_T_frame is None else 9.0)
        times_s = np.cumsum(drive.step_s)
        for track in tracks_of(tracks, drive):
            for number, boxes, box_px in _smooth_track(track, times_s, variance_m2, white, longest_gap_s):
                pose = None if drive.world_T_frame is None else drive.world_T_frame[number]
                in_frame = boxes if pose is None else boxes.transform(np.linalg.inv(pose))
                rows.setdefault(drive.keys[number], []).append((in_frame, box_px))
    smooth = {
        key: Boxes.concatenate([boxes for boxes, _ in parts]) if parts else _NO_BOXES for key, parts in rows.items()
    }
    details: dict[Key, dict[str, np.ndarray]] = {}
    if tracks.prediction_details:
        none = np.zeros((0, 4))
        details = {
            key: {"box_px": np.concatenate([none, *[box_px for _, box_px in parts]])} for key, parts in rows.items()
        }
    return replace(tracks, boxes=smooth, prediction_details=details)


def _smooth_track(
    track: TrackRows, times_s: Float[np.ndarray, " frames"], variance: float, white: float, longest_gap_s: float
) -> list[tuple[int, Boxes, np.ndarray]]:
    """Frame number, box and box in the image of each frame of a smoothed track."""
    boxes, number = track.boxes, track.number
    if len(number) == 1:
        velocity = np.full((1, 3), np.nan) if boxes.velocity_m_s is None else boxes.velocity_m_s
        return [(int(number[0]), boxes.replace(velocity_m_s=velocity), track.box_px)]
    # All frames from the first to the last box; those within longer gaps are left out at the end.
    frames = np.arange(number[0], number[-1] + 1)
    row = np.searchsorted(number, frames)
    has_box = number[row] == frames
    before = np.maximum(np.searchsorted(number, frames, side="right") - 1, 0)
    is_filled = has_box | (times_s[number[row]] - times_s[number[before]] <= longest_gap_s)
    # Positions by filter and smoother, sizes by their mean, headings and scores between the boxes.
    measured_m = np.where(has_box[:, None], boxes.centre_m[row], np.nan)
    step_s = np.diff(times_s[frames], prepend=times_s[frames[0]])
    position_m, velocity, _ = smooth_positions(measured_m, step_s, variance, white)
    weight = np.ones(len(boxes)) if boxes.score is None else np.exp(boxes.score - boxes.score.max())
    size_m = np.average(boxes.size_m, axis=0, weights=weight)
    yaw_rad = np.interp(frames, number, np.unwrap(_one_way(boxes.yaw_rad)))
    smooth = Boxes(
        centre_m=position_m,
        size_m=np.tile(size_m, (len(frames), 1)),
        yaw_rad=wrap_angle_rad(yaw_rad),
        label=np.full(len(frames), boxes.label[0]),
        score=None if boxes.score is None else np.interp(frames, number, boxes.score),
        track_id=np.full(len(frames), boxes.track_id[0] if boxes.track_id is not None else -1),
        velocity_m_s=velocity,
    )
    box_px = np.where(has_box[:, None], track.box_px[row], -1.0)
    return [(int(frames[k]), smooth[k], box_px[k : k + 1]) for k in np.flatnonzero(is_filled).tolist()]


def _one_way(yaw_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Headings of which those that point against most of the track are turned by half a turn."""
    axis = np.angle(np.exp(2j * yaw_rad)) / 2
    axis = np.unwrap(axis, period=np.pi)
    is_against = np.cos(yaw_rad - axis) < 0
    return wrap_angle_rad(axis + (np.pi if is_against.mean() > 0.5 else 0.0))


def smooth_positions(
    measured_m: Float[np.ndarray, "n axes"], step_s: Float[np.ndarray, " n"], variance: float, white: float
) -> tuple[Float[np.ndarray, "n axes"], Float[np.ndarray, "n axes"], Float[np.ndarray, "n 3"]]:
    """Smooth the positions of one object that moves with a white acceleration, the axes each for itself.

    Args:
        measured_m: Measured positions, NaN in frames without one; the first frame has one.
        step_s: Seconds since the frame before; the first does not count.
        variance: Of a measurement.
        white: Variance of the acceleration, constant over a step.

    Returns:
        Positions, velocities, and the covariance of both, the same for all axes: position, position with velocity,
        velocity.
    """
    n, axes = measured_m.shape
    predicted, predicted_p = np.zeros((n, 2, axes)), np.zeros((n, 2, 2))
    filtered, filtered_p = np.zeros_like(predicted), np.zeros_like(predicted_p)
    state, p = np.stack([measured_m[0], np.zeros(axes)]), np.diag([variance, _UNKNOWN_SPEED_VARIANCE])
    # Forwards: the Kalman filter.
    for k, dt in enumerate(step_s.tolist()):
        if k:
            transition = np.array([[1.0, dt], [0.0, 1.0]])
            state = transition @ state
            p = transition @ p @ transition.T + white * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
            predicted[k], predicted_p[k] = state, p
            if not np.isnan(measured_m[k]).any():
                gain = p[:, 0] / (p[0, 0] + variance)
                state = state + gain[:, None] * (measured_m[k] - state[0])
                p = p - np.outer(gain, p[0])
        filtered[k], filtered_p[k] = state, p
    # Backwards: the smoother.
    smooth, smooth_p = filtered, filtered_p
    for k in range(n - 2, -1, -1):
        transition = np.array([[1.0, step_s[k + 1]], [0.0, 1.0]])
        gain = filtered_p[k] @ transition.T @ np.linalg.inv(predicted_p[k + 1])
        smooth[k] += gain @ (smooth[k + 1] - predicted[k + 1])
        smooth_p[k] += gain @ (smooth_p[k + 1] - predicted_p[k + 1]) @ gain.T
    return smooth[:, 0], smooth[:, 1], np.stack([smooth_p[:, 0, 0], smooth_p[:, 0, 1], smooth_p[:, 1, 1]], axis=1)


# Joining


@dataclass(frozen=True, kw_only=True)
class JoinSettings:
    """What two tracks of one object may differ by.

    Args:
        longest_s: Longest time between them.
        near_m: Error of the position that is allowed at once.
        speed_m_s: What the error grows by for each second between them.
        size: Largest relative difference of length, width or height.
        boxes: Boxes at a track's end from which its speed is taken.
        size_boxes: Boxes at a track's end whose median size is compared, where sizes are certain but change along a
            track; None takes the mean of the whole track, where they are noisy.
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
its position may be less certain. Chosen on the odd ones of K-Radar's sequences."""


def join_settings(preset: str) -> JoinSettings:
    """What may be joined of a tracker's tracks, by the name of its preset."""
    return ANNOTATED if preset == "annotated" else JoinSettings()


def join_tracks(tracks: Detections, settings: JoinSettings | None = None, *, step_s: float = 0.1) -> Detections:
    """Join tracks, looking ahead; boxes stay as they are, and no two boxes of a frame become one object's.

    Args:
        tracks: Boxes with ``track_id``.
        settings: What is allowed.
        step_s: Seconds between frames where there are no stamps.

    Returns:
        The same with the ``track_id`` of each object's first track.
    """
    names: dict[tuple[str, int], int] = {}
    for drive in timelines(tracks, step_s=step_s):
        rows = tracks_of(tracks, drive)
        continued = _continuations(rows, np.cumsum(drive.step_s), settings or JoinSettings())
        for number, track in enumerate(rows):
            first = number
            while first in continued:
                first = continued[first]
            sequence = drive.keys[int(track.number[0])][0]
            names[sequence, track.name] = rows[first].name
    boxes = {}
    for key, part in tracks.boxes.items():
        boxes[key] = part
        if part.track_id is not None and len(part):
            ids = [names[key[0], name] for name in part.track_id.tolist()]
            boxes[key] = part.replace(track_id=np.array(ids, dtype=np.int64))
    return replace(tracks, boxes=boxes)


def _continuations(
    tracks: list[TrackRows], times_s: Float[np.ndarray, " frames"], settings: JoinSettings
) -> dict[int, int]:
    """For each track that continues another: the number of that one."""
    if len(tracks) < 2:
        return {}
    ends, starts = (_TrackEnds.from_tracks(tracks, times_s, settings, last=last) for last in (True, False))
    gap_s = starts.time_s[None] - ends.time_s[:, None]
    is_possible = (gap_s > 0) & (gap_s <= settings.longest_s) & ends.is_alike(starts, settings.size)
    offset_m = starts.position_m[None] - ends.position_m[:, None]
    velocities = (
        ends.velocity_m_s[:, None],
        starts.velocity_m_s[None],
        (ends.velocity_m_s[:, None] + starts.velocity_m_s[None]) / 2,
    )
    error_m = np.min(
        [np.linalg.norm(offset_m - velocity * gap_s[..., None], axis=2) for velocity in velocities], axis=0
    )
    allowed_m = settings.near_m + settings.speed_m_s * np.maximum(gap_s, 0)
    cost = np.where(is_possible, error_m / allowed_m, _NO_PAIR)
    before, after = linear_sum_assignment(np.where(cost <= 1, cost, _NO_PAIR))
    good = cost[before, after] <= 1
    return dict(zip(after[good].tolist(), before[good].tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class _TrackEnds:
    """One end of each track: when and where it is, how fast the object moves there (0 for a single box), what it is.

    Args:
        time_s: Time of the last box, or of the first.
        position_m: Its centre.
        velocity_m_s: Velocity of the boxes at this end.
        log_size: Logarithms of length, width and height.
        label: Class of the last box, or of the first.
    """

    time_s: Float[np.ndarray, " n"]
    position_m: Float[np.ndarray, "n 2"]
    velocity_m_s: Float[np.ndarray, "n 2"]
    log_size: Float[np.ndarray, "n 3"]
    label: Shaped[np.ndarray, " n"]

    @classmethod
    def from_tracks(
        cls, tracks: list[TrackRows], times_s: Float[np.ndarray, " frames"], settings: JoinSettings, *, last: bool
    ) -> "_TrackEnds":
        rows, end = [], -1 if last else 0
        for track in tracks:
            boxes = _end_rows(settings.boxes, last=last)
            time_s, position_m = times_s[track.number[boxes]], track.boxes.centre_m[boxes, :2]
            from_mean_s = time_s - time_s.mean()
            spread = float(from_mean_s @ from_mean_s)
            velocity = from_mean_s @ position_m / spread if spread > 0 else np.zeros(2)
            if settings.size_boxes is None:
                size_m = track.boxes.size_m.mean(axis=0)
            else:
                size_m = np.median(track.boxes.size_m[_end_rows(settings.size_boxes, last=last)], axis=0)
            rows.append(np.concatenate([[time_s[end]], position_m[end], velocity, np.log(size_m)]))
        table = np.array(rows).reshape(-1, 8)
        label = np.array([str(track.boxes.label[end]) for track in tracks])
        return cls(table[:, 0], table[:, 1:3], table[:, 3:5], table[:, 5:], label)

    def is_alike(self, others: "_TrackEnds", most: float) -> Bool[np.ndarray, "n m"]:
        """Which of these and those are of one class and of sizes that differ by at most a share."""
        near = np.abs(self.log_size[:, None] - others.log_size[None]).max(axis=2) <= np.log1p(most)
        return np.asarray(near & (self.label[:, None] == others.label[None]))


def _end_rows(count: int, *, last: bool) -> slice:
    """The last rows of a track, or its first."""
    return slice(-count, None) if last else slice(None, count)


# Choosing by score


def track_scores(tracks: Detections) -> dict[tuple[str, int], float]:
    """Mean score over its boxes of each track, by (sequence, track id); 1 where there are no scores."""
    scores: dict[tuple[str, int], list[float]] = {}
    for (sequence, _), boxes in tracks.boxes.items():
        ids = [] if boxes.track_id is None else boxes.track_id.tolist()
        box_scores = np.ones(len(boxes)) if boxes.score is None else boxes.score
        for name, score in zip(ids, box_scores.tolist(), strict=True):
            scores.setdefault((sequence, name), []).append(score)
    return {name: float(np.mean(values)) for name, values in scores.items()}


def with_track_score(tracks: Detections, least: float) -> Detections:
    """The tracks whose mean score is at least this."""
    names = {name for name, score in track_scores(tracks).items() if score >= least}
    boxes, details = {}, {}
    for key, part in tracks.boxes.items():
        ids = [] if part.track_id is None else part.track_id.tolist()
        rows = np.array([(key[0], name) in names for name in ids], dtype=bool)
        boxes[key] = part[rows]
        columns = tracks.prediction_details.get(key, {})
        details[key] = {name: np.asarray(values)[rows] for name, values in columns.items()}
    return replace(tracks, boxes=boxes, prediction_details=details if tracks.prediction_details else {})
