"""Tracks as arrays, and the Kalman filter over place, velocity, size and heading in closed form.

With independent errors along the axes the covariance falls into blocks of place and velocity of each axis, and single
numbers for size and heading, exactly: no matrix is inverted.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.boxes import wrap_angle_rad
from farfield.tracking.settings import TrackerSettings


@dataclass(eq=False, kw_only=True)
class Tracks:
    """n tracks of several drives.

    Args:
        drive: Number of the drive, shape (n,), rising.
        name: Identity within the drive.
        label: Number of the class.
        place_m: Filtered point of the box, shape (n, 3).
        speed: Its velocity, metres a second or a frame, shape (n, 3).
        pp: Variances of the places, shape (n, 3).
        pv: Covariances of place and velocity, shape (n, 3).
        vv: Variances of the velocities, shape (n, 3).
        size_m: Length, width, height, shape (n, 3).
        yaw_rad: Heading, shape (n,).
        spread: Variance of size and heading, shape (n,).
        hits: Frames with a match, that of birth counted.
        misses: Frames since the last match.
        unseen_s: Seconds since then.
        source: Row of the last detection that was taken.
        score: Its score.
        best: The best score so far.
        range_m: How far from the sensor that detection was.
        cross: Covariances of (x, velocity along x) with (y, velocity along y), shape (n, 2, 2); 0 without Doppler.
    """

    drive: Int[np.ndarray, " n"]
    name: Int[np.ndarray, " n"]
    label: Int[np.ndarray, " n"]
    place_m: Float[np.ndarray, "n 3"]
    speed: Float[np.ndarray, "n 3"]
    pp: Float[np.ndarray, "n 3"]
    pv: Float[np.ndarray, "n 3"]
    vv: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    spread: Float[np.ndarray, " n"]
    hits: Int[np.ndarray, " n"]
    misses: Int[np.ndarray, " n"]
    unseen_s: Float[np.ndarray, " n"]
    source: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]
    best: Float[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    cross: Float[np.ndarray, "n 2 2"]

    @classmethod
    def none(cls) -> "Tracks":
        """No tracks."""
        three = ("place_m", "speed", "pp", "pv", "vv", "size_m")
        whole = ("drive", "name", "label", "hits", "misses", "source")
        kinds = {each.name: np.int64 if each.name in whole else np.float64 for each in fields(cls)}
        shape = {name: (0, 2, 2) if name == "cross" else (0, 3) if name in three else (0,) for name in kinds}
        return cls(**{name: np.zeros(shape[name], dtype=kind) for name, kind in kinds.items()})

    def __len__(self) -> int:
        return len(self.drive)

    def __getitem__(self, rows: Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "Tracks":
        return Tracks(**{name: values[rows] for name, values in vars(self).items()})

    def joined(self, born: "Tracks") -> "Tracks":
        """These and new ones, by drive."""
        if not len(born):
            return self
        both = {name: np.concatenate([values, getattr(born, name)]) for name, values in vars(self).items()}
        order = np.argsort(both["drive"], kind="stable")
        return Tracks(**{name: values[order] for name, values in both.items()})


def predict(tracks: Tracks, dt: Float[np.ndarray, " n"], settings: TrackerSettings) -> None:
    """Move tracks on in place by constant velocity.

    Args:
        tracks: The tracks.
        dt: Step of each, seconds or frames.
        settings: Process noise.
    """
    dt = dt[:, None]
    tracks.place_m = tracks.place_m + dt * tracks.speed
    tracks.misses = tracks.misses + 1
    tracks.pp = tracks.pp + 2 * dt * tracks.pv + dt**2 * tracks.vv
    tracks.pv = tracks.pv + dt * tracks.vv
    tracks.spread = tracks.spread + settings.process_variance
    if settings.acceleration is None:
        tracks.pp = tracks.pp + settings.process_variance
        tracks.vv = tracks.vv + settings.process_speed_variance
        return
    white = settings.acceleration
    tracks.pp = tracks.pp + white * dt**4 / 4
    tracks.pv = tracks.pv + white * dt**3 / 2
    tracks.vv = tracks.vv + white * dt**2


def update(
    tracks: Tracks,
    rows: Int[np.ndarray, " k"],
    seen: Float[np.ndarray, "k 7"],
    variance: Float[np.ndarray, "k 3"],
    settings: TrackerSettings,
    axes: slice = slice(0, 3),
) -> None:
    """Take detections into tracks, in place.

    A heading that differs by more than a right angle turns the track by half a turn first (AB3DMOT).

    Args:
        tracks: The tracks.
        rows: Which of them, each once.
        seen: The detections as x, y, z, length, width, height, yaw.
        variance: Variances of their places.
        settings: Variance of size and heading.
        axes: Axes of the place that are updated here.
    """
    _update_axes(tracks, rows, seen[:, :3], variance, axes)
    spread = tracks.spread[rows]
    gain = spread / (spread + settings.measurement_variance)
    tracks.size_m[rows] += gain[:, None] * (seen[:, 3:6] - tracks.size_m[rows])
    turn = wrap_angle_rad(seen[:, 6] - tracks.yaw_rad[rows])
    turned = np.abs(turn) > np.pi / 2
    yaw = tracks.yaw_rad[rows] + np.where(turned, np.pi, 0.0)
    tracks.yaw_rad[rows] = wrap_angle_rad(yaw + gain * wrap_angle_rad(seen[:, 6] - yaw))
    tracks.spread[rows] = spread * (1 - gain)


def _update_axes(
    tracks: Tracks,
    rows: Int[np.ndarray, " k"],
    seen_m: Float[np.ndarray, "k 3"],
    variance: Float[np.ndarray, "k 3"],
    axes: slice,
) -> None:
    pp, pv = tracks.pp[rows, axes], tracks.pv[rows, axes]
    gain_p, gain_v = pp / (pp + variance[:, axes]), pv / (pp + variance[:, axes])
    gap = seen_m[:, axes] - tracks.place_m[rows, axes]
    tracks.place_m[rows, axes] += gain_p * gap
    tracks.speed[rows, axes] += gain_v * gap
    tracks.pp[rows, axes] = pp * (1 - gain_p)
    tracks.pv[rows, axes] = pv * (1 - gain_p)
    tracks.vv[rows, axes] -= gain_v * pv
