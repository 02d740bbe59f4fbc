"""The tracker's loop: predict, associate, update, births, report, deaths; one frame of many drives a step."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.tracking.association import GateUncertainty, associate
from farfield.tracking.doppler import (
    narrow_births,
    polar_covariance,
    radial_gaps,
    spread_cross,
    update_coupled,
    update_doppler,
)
from farfield.tracking.kalman import Tracks, predict, update
from farfield.tracking.settings import TrackerSettings

_TICK_S = 1e-6  # sums of steps are no exact multiples


@dataclass(frozen=True, eq=False, kw_only=True)
class DetectionBatch:
    """Detections of one frame of each of several drives.

    Args:
        drive: Numbers of the drives, rising, shape (n,).
        rows: x, y, z (the filtered point), length, width, height, yaw, shape (n, 7).
        velocity_m_s: Where the detector gives it, else 0, shape (n, 2).
        ray_m: From the sensor to the box along the axes of the rows, shape (n, 2).
        score: Scores, shape (n,), falling within a drive.
        label: Numbers of the classes, shape (n,).
        source: What they are called, shape (n,).
        radial: Measured radial velocities as :func:`farfield.tracking.doppler.update_doppler` takes them, shape (n, 7).
    """

    drive: Int[np.ndarray, " n"]
    rows: Float[np.ndarray, "n 7"]
    velocity_m_s: Float[np.ndarray, "n 2"]
    ray_m: Float[np.ndarray, "n 2"]
    score: Float[np.ndarray, " n"]
    label: Int[np.ndarray, " n"]
    source: Int[np.ndarray, " n"]
    radial: Float[np.ndarray, "n 7"] | None = None

    def __len__(self) -> int:
        return len(self.drive)

    def __getitem__(self, rows: Bool[np.ndarray, " n"] | Int[np.ndarray, " k"] | slice) -> "DetectionBatch":
        chosen: dict[str, Any] = {name: None if all_ is None else all_[rows] for name, all_ in vars(self).items()}
        return DetectionBatch(**chosen)


class TrackEngine:
    """Tracks of several drives, kept from frame to frame.

    Args:
        settings: The tracker's options.
        drives: Number of drives.
        labels: Names of the classes.
        logits: Whether scores are logits rather than probabilities.
        doppler: Whether detections have radial velocities; x and y are then coupled.
    """

    def __init__(
        self,
        settings: TrackerSettings,
        *,
        drives: int,
        labels: Sequence[str],
        logits: bool = False,
        doppler: bool = False,
    ) -> None:
        self.settings, self.tracks = settings, Tracks.none()
        self.names, self.frames = np.zeros(drives, dtype=np.int64), np.zeros(drives, dtype=np.int64)
        self.gate = np.array([settings.gates_m.get(name.lower(), settings.gate) for name in labels] or [settings.gate])
        sure = -np.inf if settings.sure_score is None else settings.sure_score
        self.sure = float(_logit(sure)) if logits and settings.sure_score is not None else sure
        self.dt = np.zeros(drives)
        self.coupled = doppler and settings.doppler_sigma_m_s is not None

    def step(
        self, seen: DetectionBatch, dt: Float[np.ndarray, " drives"], running: Bool[np.ndarray, " drives"]
    ) -> Tracks:
        """Take one frame of each running drive.

        Args:
            seen: Detections of these frames.
            dt: Seconds since the frame before.
            running: Drives that have such a frame.

        Returns:
            The tracks that are reported.
        """
        self.frames += running
        self.dt = dt
        self._forget(seen, running)
        step = np.ones_like(dt) if self.settings.time == "frames" else dt
        predict(self.tracks, step[self.tracks.drive], self.settings)
        self.tracks.unseen_s = self.tracks.unseen_s + dt[self.tracks.drive]
        if self.coupled:
            spread_cross(self.tracks, step[self.tracks.drive])
        strong = np.ones(len(seen), dtype=bool)
        if self.settings.strong_score is not None:
            strong = seen.score >= self.settings.strong_score
        first = seen if strong.all() else seen[strong]
        left = first[self._take(first, np.ones(len(self.tracks), dtype=bool), self.gate, weak=False)]
        if self.settings.weak_gate is not None and not strong.all():
            gate = np.full(len(self.gate), self.settings.weak_gate)
            self._take(seen[~strong], self.tracks.misses > 0, gate, weak=True)
        self.tracks = self.tracks.joined(self._born(left))
        shown = self.tracks[self._shown()]
        alive = self._alive()
        self.tracks = self.tracks if alive.all() else self.tracks[alive]
        return shown

    def _alive(self) -> Bool[np.ndarray, " n"]:
        """Which tracks have not been lost for too long; one that was matched just now lives."""
        t, longest_s = self.tracks, self.settings.max_age_s
        if longest_s is None:
            return np.asarray(t.misses < self._by_range("max_age"))
        return np.asarray((t.misses == 0) | (t.unseen_s < longest_s - _TICK_S))

    def _by_range(self, name: str) -> int | Int[np.ndarray, " n"]:
        """An option that may be another one far away."""
        near = int(getattr(self.settings, name))
        if self.settings.far_m is None:
            return near
        return np.where(self.tracks.range_m >= self.settings.far_m, getattr(self.settings, f"far_{name}"), near)

    def _forget(self, seen: DetectionBatch, running: Bool[np.ndarray, " drives"]) -> None:
        kept = running.copy()
        if self.settings.forget_when_empty:
            kept &= np.bincount(seen.drive, minlength=len(kept)) > 0
        if not kept.all():
            self.tracks = self.tracks[kept[self.tracks.drive]]

    def _take(
        self, seen: DetectionBatch, waiting: Bool[np.ndarray, " n"], gate: Float[np.ndarray, " labels"], *, weak: bool
    ) -> Bool[np.ndarray, " m"]:
        """Continue waiting tracks; returns the detections that are left."""
        free = np.ones(len(seen), dtype=bool)
        places = np.flatnonzero(waiting)
        if not len(seen) or not len(places):
            return free
        t = self.tracks if waiting.all() else self.tracks[places]
        rows = np.column_stack([t.place_m, t.size_m, t.yaw_rad])
        theirs = seen.rows
        if self.settings.anchor == "bottom":
            rows, theirs = _lifted(rows), _lifted(theirs)
        reach = self._reach(t, seen)
        a, b = associate(rows, t.drive, t.label, theirs, seen.drive, seen.label, self.settings, gate, reach)
        a = places[a]
        free[b] = False
        t = self.tracks
        t.misses[a], t.unseen_s[a] = 0, 0.0
        if weak and not self.settings.weak_updates:
            return free
        t.hits[a] += 1
        t.best[a] = np.maximum(t.best[a], seen.score[b])
        t.range_m[a] = np.hypot(*seen.ray_m[b].T)
        t.source[a], t.score[a] = seen.source[b], seen.score[b]
        if self.settings.motion == "kalman":
            self._update(a, seen[b])
        else:
            t.place_m[a], t.size_m[a], t.yaw_rad[a] = seen.rows[b, :3], seen.rows[b, 3:6], seen.rows[b, 6]
            t.speed[a, :2] = seen.velocity_m_s[b]
        return free

    def _update(self, rows: Int[np.ndarray, " k"], seen: DetectionBatch) -> None:
        variance = self._variance(seen.ray_m)
        if not self.coupled:
            update(self.tracks, rows, seen.rows, variance, self.settings)
            return
        s = self.settings
        noise = variance[:, :2, None] * np.eye(2)
        if s.range_sigma_m is not None:
            noise = polar_covariance(seen.ray_m, s.range_sigma_m, s.azimuth_sigma_rad)
        update(self.tracks, rows, seen.rows, variance, s, axes=slice(2, 3))
        update_coupled(self.tracks, rows, seen.rows[:, :2], noise)
        self._doppler(self.tracks, rows, seen)

    def _doppler(self, tracks: Tracks, rows: Int[np.ndarray, " k"], seen: DetectionBatch) -> None:
        sigma, span = self.settings.doppler_sigma_m_s, self.settings.doppler_span_m_s
        if seen.radial is not None and sigma is not None:
            update_doppler(tracks, rows, seen.radial, np.hypot(*seen.ray_m.T), sigma_m_s=sigma, span_m_s=span)

    def _reach(self, tracks: Tracks, seen: DetectionBatch) -> GateUncertainty | None:
        s = self.settings
        if s.gate_sigmas is None and not s.gate_speed_m_s:
            return None
        radial = None
        if self.coupled and seen.radial is not None and s.doppler_sigma_m_s is not None:
            sigma, span = s.doppler_sigma_m_s, s.doppler_span_m_s
            radial = partial(radial_gaps, tracks, seen.radial, sigma_m_s=sigma, span_m_s=span)
        return GateUncertainty(
            wider_m=s.gate_speed_m_s * tracks.unseen_s,
            tracks_m2=tracks.pp[:, :2],
            seen_m2=self._variance(seen.ray_m)[:, :2],
            radial=radial,
        )

    def _variance(self, ray_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Variances of places: the same for all, or by range and direction."""
        s = self.settings
        variance = np.full((len(ray_m), 3), s.measurement_variance)
        if s.range_sigma_m is not None:
            range_m = np.hypot(*ray_m.T)
            unit2 = (ray_m / np.maximum(range_m, 1e-9)[:, None]) ** 2
            across = (range_m * s.azimuth_sigma_rad) ** 2
            variance[:, :2] = s.range_sigma_m**2 * unit2 + across[:, None] * unit2[:, ::-1]
        return variance

    def _born(self, seen: DetectionBatch) -> Tracks:
        n, s = len(seen), self.settings
        rank = np.arange(n) - np.searchsorted(seen.drive, seen.drive)
        name = self.names[seen.drive] + rank
        self.names += np.bincount(seen.drive, minlength=len(self.names))
        speed = np.zeros((n, 3))
        if s.motion == "detection" or s.time == "seconds":
            speed[:, :2] = seen.velocity_m_s
        start = np.full((n, 3), s.initial_variance)
        born = Tracks(
            drive=seen.drive,
            name=name,
            label=seen.label,
            place_m=seen.rows[:, :3].copy(),
            speed=speed,
            pp=start,
            pv=np.zeros((n, 3)),
            vv=np.full((n, 3), s.initial_speed_variance),
            size_m=seen.rows[:, 3:6].copy(),
            yaw_rad=seen.rows[:, 6].copy(),
            spread=start[:, 0].copy(),
            hits=np.ones(n, dtype=np.int64),
            misses=np.zeros(n, dtype=np.int64),
            unseen_s=np.zeros(n),
            source=seen.source.copy(),
            score=seen.score.copy(),
            best=seen.score.copy(),
            range_m=np.hypot(*seen.ray_m.T),
            cross=np.zeros((n, 2, 2)),
        )
        if self.coupled:
            if s.across_speed_m_s is not None and seen.radial is not None:
                narrow_births(born, seen.radial, s.across_speed_m_s)
            self._doppler(born, np.arange(n), seen)
        return born

    def _shown(self) -> Bool[np.ndarray, " n"]:
        t, s = self.tracks, self.settings
        proven = (t.hits >= self._by_range("min_hits")) | (self.frames[t.drive] <= s.warm_up)
        proven &= (t.best >= self.sure) | (t.hits >= s.unsure_hits)
        return proven & (self._alive() if s.report_coasted else (t.misses == 0))


def _logit(probability: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.log(probability) - np.log1p(-probability))


def _lifted(rows: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 7"]:
    """Rows of bottoms' centres as rows of centres."""
    lifted = rows.copy()
    lifted[:, 2] += rows[:, 5] / 2
    return lifted
