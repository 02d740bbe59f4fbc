"""Tracks smoothed as wholes: Rauch, Tung and Striebel (AIAA Journal, 1965), in closed form for each axis.

Places run through a filter of constant velocity and back; sizes become the mean of the track, weighted by score; a
heading that points against most of its track is turned by half a turn; gaps are filled.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.metrics.detections import Detections
from farfield.tracking.timeline import Timeline, timelines

_UNKNOWN = 1e6


def smoothed(
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
        variance_m2: Variance of a box's place along each axis.
        acceleration: Variance of the acceleration, (m/s^2)^2; None takes 9 where there are poses, else 200, since the
            sensor's own motion is in it.
        longest_gap_s: Frames between two boxes of a track are filled if these are not further apart.

    Returns:
        The same tracks with smoothed boxes and velocities, and boxes in gaps; a box that was filled in has no box in
        the image (-1). A track of one box stays as it is.
    """
    parts: dict[Key, list[tuple[Boxes, np.ndarray]]] = {key: [] for key in tracks.boxes}
    for drive in timelines(tracks, step_s=step_s):
        white = acceleration if acceleration is not None else (200.0 if drive.world_T_frame is None else 9.0)
        times = np.cumsum(drive.step_s)
        for track in tracks_of(tracks, drive):
            for number, boxes, box_px in _smooth_track(track, times, variance_m2, white, longest_gap_s):
                key = drive.keys[number]
                pose = None if drive.world_T_frame is None else drive.world_T_frame[number]
                back = boxes if pose is None else boxes.transform(np.linalg.inv(pose))
                parts.setdefault(key, []).append((back, box_px))
    joined = {key: Boxes.concatenate([b for b, _ in rows]) if rows else _NOTHING for key, rows in parts.items()}
    details: Mapping[Key, dict[str, np.ndarray]] = {}
    if tracks.prediction_details:
        details = {
            key: {"box_px": np.concatenate([np.zeros((0, 4)), *[px for _, px in rows]])} for key, rows in parts.items()
        }
    return replace(tracks, boxes=joined, prediction_details=details)


_NOTHING = Boxes.empty(scored=True)


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
        boxes = tracks.boxes.get(key, _NOTHING)
        if not len(boxes) or boxes.track_id is None:
            continue
        px = tracks.prediction_details.get(key, {}).get("box_px", np.full((len(boxes), 4), -1.0))
        moved = boxes if drive.world_T_frame is None else boxes.transform(drive.world_T_frame[number])
        for row, name in enumerate(boxes.track_id.tolist()):
            rows.setdefault(name, []).append((number, moved[row], np.asarray(px, dtype=np.float64)[row : row + 1]))
    return [
        TrackRows(
            name=name,
            number=np.array([number for number, _, _ in each]),
            boxes=Boxes.concatenate([boxes for _, boxes, _ in each]),
            box_px=np.concatenate([px for _, _, px in each]),
        )
        for name, each in rows.items()
    ]


def _smooth_track(
    track: TrackRows, times_s: Float[np.ndarray, " frames"], variance: float, white: float, longest_gap_s: float
) -> list[tuple[int, Boxes, np.ndarray]]:
    boxes, number = track.boxes, track.number
    if len(number) == 1:
        speed = np.full((1, 3), np.nan) if boxes.velocity_m_s is None else boxes.velocity_m_s
        return [(int(number[0]), boxes.replace(velocity_m_s=speed), track.box_px)]
    here = np.arange(number[0], number[-1] + 1)
    seen = np.searchsorted(number, here)
    is_seen = number[seen] == here
    before = np.maximum(np.searchsorted(number, here, side="right") - 1, 0)
    kept = is_seen | (times_s[number[seen]] - times_s[number[before]] <= longest_gap_s)
    place = np.where(is_seen[:, None], boxes.centre_m[seen], np.nan)
    place, speed, _ = smooth_places(place, np.diff(times_s[here], prepend=times_s[here[0]]), variance, white)
    weight = np.ones(len(boxes)) if boxes.score is None else np.exp(boxes.score - boxes.score.max())
    size = np.average(boxes.size_m, axis=0, weights=weight)
    yaw = _one_way(boxes.yaw_rad)
    between = np.interp(here, number, np.unwrap(yaw))
    score = None if boxes.score is None else np.interp(here, number, boxes.score)
    out = Boxes(
        centre_m=place,
        size_m=np.tile(size, (len(here), 1)),
        yaw_rad=wrap_angle_rad(between),
        label=np.full(len(here), boxes.label[0]),
        score=score,
        track_id=np.full(len(here), boxes.track_id[0] if boxes.track_id is not None else -1),
        velocity_m_s=speed,
    )
    px = np.where(is_seen[:, None], track.box_px[seen], -1.0)
    return [(int(here[row]), out[row], px[row : row + 1]) for row in np.flatnonzero(kept).tolist()]


def _one_way(yaw_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Headings of which those that point against most of the track are turned by half a turn."""
    axis = np.angle(np.exp(2j * yaw_rad)) / 2
    axis = np.unwrap(axis, period=np.pi)
    against = np.cos(yaw_rad - axis) < 0
    return wrap_angle_rad(axis + (np.pi if against.mean() > 0.5 else 0.0))


def smooth_places(
    seen_m: Float[np.ndarray, "n axes"], step_s: Float[np.ndarray, " n"], variance: float, white: float
) -> tuple[Float[np.ndarray, "n axes"], Float[np.ndarray, "n axes"], Float[np.ndarray, "n 3"]]:
    """Smooth the places of one object that moves with a white acceleration, the axes each for itself.

    Args:
        seen_m: Measured places, NaN in frames without one; the first frame has one.
        step_s: Seconds since the frame before; the first does not count.
        variance: Of a measurement.
        white: Variance of the acceleration, constant over a step.

    Returns:
        Places, velocities, and the covariance of both, the same for all axes: place, place with velocity, velocity.
    """
    n, axes = seen_m.shape
    ahead, ahead_p = np.zeros((n, 2, axes)), np.zeros((n, 2, 2))
    state, p = np.stack([seen_m[0], np.zeros(axes)]), np.diag([variance, _UNKNOWN])
    after, after_p = np.zeros_like(ahead), np.zeros_like(ahead_p)
    for k, dt in enumerate(step_s.tolist()):
        if k:
            move = np.array([[1.0, dt], [0.0, 1.0]])
            state = move @ state
            p = move @ p @ move.T + white * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
            ahead[k], ahead_p[k] = state, p
            if not np.isnan(seen_m[k]).any():
                gain = p[:, 0] / (p[0, 0] + variance)
                state = state + gain[:, None] * (seen_m[k] - state[0])
                p = p - np.outer(gain, p[0])
        after[k], after_p[k] = state, p
    for k in range(n - 2, -1, -1):
        move = np.array([[1.0, step_s[k + 1]], [0.0, 1.0]])
        back = after_p[k] @ move.T @ np.linalg.inv(ahead_p[k + 1])
        after[k] += back @ (after[k + 1] - ahead[k + 1])
        after_p[k] += back @ (after_p[k + 1] - ahead_p[k + 1]) @ back.T
    return after[:, 0], after[:, 1], np.stack([after_p[:, 0, 0], after_p[:, 0, 1], after_p[:, 1, 1]], axis=1)
