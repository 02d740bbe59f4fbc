"""Tracking by detection: prediction, data association, update, birth, output and death, frame by frame.

The headings are those of AB3DMOT (Weng et al., IROS 2020); :class:`TrackEngine` takes a step of many drives at once.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.metrics.detections import Detections
from farfield.tracking.association import GateUncertainty, associate
from farfield.tracking.kalman import (
    Tracks,
    narrow_births,
    polar_covariance,
    predict,
    predict_cross,
    radial_gaps,
    update,
    update_coupled,
    update_doppler,
)
from farfield.tracking.presets import TrackerSettings, preset
from farfield.tracking.timeline import Timeline, assumption_notes, input_notes, is_number, timelines, unreported_note

_TICK_S = 1e-6  # sums of steps are no exact multiples


def track(
    detections: Detections | None = None, settings: TrackerSettings | str = "default", **changes: Any
) -> Detections:
    """Give detections identities and velocities, frame by frame, without looking ahead.

    Drives come from ``detections.drives`` with their stamps and poses. Without drives, a sequence is a drive; frames
    whose names are whole numbers are taken in their order from 0 on, the missing ones as frames without detections and
    without annotated boxes.

    Args:
        detections: Scored boxes. ``prediction_details`` may hold ``doppler_m_s``, radial velocities relative to the
            sensor as measured, away from it positive, NaN for none, shape (n,), and ``doppler_ray``, the mean direction
            from the sensor to the points that they were measured on, shape (n, 3), else that to the box's centre is
            taken.
        settings: Options, or a preset's name.
        **changes: Options that differ from these.

    Returns:
        The same with boxes that bear ``track_id``, from 0 in each drive, and ``velocity_m_s`` over ground where steps
        are seconds; ``box_px`` is that of the track's last detection. Notes say what was assumed.

    Raises:
        ConfigError: If an option is impossible, or a column of details has not a row for each box.
    """
    if "found" in changes:
        warnings.warn("track: found= is called detections= now", DeprecationWarning, stacklevel=2)
        detections = changes.pop("found")
    if detections is None:
        raise ConfigError("track: expected detections, got none")
    settings = (preset(settings) if isinstance(settings, str) else settings).changed(**changes)
    drives = timelines(detections, step_s=settings.step_s, ego_motion=settings.ego_motion)
    labels = sorted({str(name) for boxes in detections.boxes.values() for name in np.unique(boxes.label)})
    scores = [boxes.score for boxes in detections.boxes.values() if boxes.score is not None]
    table = _DetectionTable(detections, drives, labels, settings)
    engine = TrackEngine(
        settings,
        drives=len(drives),
        labels=labels,
        logits=any(((score < 0) | (score > 1)).any() for score in scores),
        doppler=any("doppler_m_s" in details for details in detections.prediction_details.values()),
    )
    reported: list[tuple[int, Tracks]] = []
    for number in range(max((len(drive.keys) for drive in drives), default=0)):
        running = np.array([number < len(drive.keys) for drive in drives])
        dt = np.array([drive.step_s[number] if number < len(drive.keys) else 0.0 for drive in drives])
        reported.append((number, engine.step(table.frame(number), dt, running)))
    boxes, box_px = table.boxes_of(reported)
    in_image = any("box_px" in details for details in detections.prediction_details.values())
    notes = assumption_notes(
        drives, seconds=settings.time == "seconds", ego_motion=settings.ego_motion, step_s=settings.step_s
    )
    notes += input_notes(detections, ego_motion=settings.ego_motion, least_score=settings.least_score)
    notes += unreported_note(
        drives,
        boxes=sum(map(len, detections.boxes.values())),
        reported=sum(map(len, boxes.values())),
        min_hits=settings.min_hits,
        unsure_hits=settings.unsure_hits,
        sure_score=settings.sure_score,
    )
    return replace(
        detections,
        boxes=boxes,
        prediction_details={key: {"box_px": rows} for key, rows in box_px.items()} if in_image else {},
        annotations=_with_missing_frames(detections.annotations, boxes),
        notes=(*detections.notes, *notes),
    )


def _with_missing_frames(annotations: Mapping[Key, Annotation], boxes: Mapping[Key, Boxes]) -> dict[Key, Annotation]:
    """Annotations, and empty ones for the missing frames of annotated sequences, where a track may coast."""
    annotated = {sequence for sequence, _ in annotations}
    missing = [key for key in boxes if key not in annotations and key[0] in annotated and is_number(key[1])]
    return {**annotations} | {key: Annotation(boxes=Boxes.empty()) for key in missing}


@dataclass(frozen=True, eq=False, kw_only=True)
class DetectionBatch:
    """Detections of one frame of each of several drives.

    Args:
        drive: Numbers of the drives, rising, shape (n,).
        boxes: x, y, z (the filtered point), length, width, height, yaw, shape (n, 7).
        velocity_m_s: Where the detector gives it, else 0, shape (n, 2).
        ray_m: From the sensor to the box along the axes of ``boxes``, shape (n, 2).
        score: Scores, shape (n,), falling within a drive.
        label: Numbers of the classes, shape (n,).
        source: Their rows in the table of all detections, shape (n,).
        radial: Measured radial velocities as :func:`farfield.tracking.kalman.update_doppler` takes them, shape (n, 7).
    """

    drive: Int[np.ndarray, " n"]
    boxes: Float[np.ndarray, "n 7"]
    velocity_m_s: Float[np.ndarray, "n 2"]
    ray_m: Float[np.ndarray, "n 2"]
    score: Float[np.ndarray, " n"]
    label: Int[np.ndarray, " n"]
    source: Int[np.ndarray, " n"]
    radial: Float[np.ndarray, "n 7"] | None = None

    def __len__(self) -> int:
        return len(self.drive)

    def __getitem__(self, index: Bool[np.ndarray, " n"] | Int[np.ndarray, " k"] | slice) -> "DetectionBatch":
        columns: dict[str, Any] = {
            name: None if values is None else values[index] for name, values in vars(self).items()
        }
        return DetectionBatch(**columns)


class TrackEngine:
    """Tracks of several drives, updated frame by frame.

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
        self.settings = settings
        self.tracks = Tracks.empty()
        self.next_id = np.zeros(drives, dtype=np.int64)
        self.frames = np.zeros(drives, dtype=np.int64)
        self.gate = np.array([settings.gates_m.get(name.lower(), settings.gate) for name in labels] or [settings.gate])
        self.sure_score = -np.inf if settings.sure_score is None else settings.sure_score
        if logits and settings.sure_score is not None:
            with np.errstate(divide="ignore"):
                self.sure_score = float(np.log(settings.sure_score) - np.log1p(-settings.sure_score))
        self.coupled = doppler and settings.doppler_sigma_m_s is not None

    def step(
        self, detections: DetectionBatch, dt: Float[np.ndarray, " drives"], running: Bool[np.ndarray, " drives"]
    ) -> Tracks:
        """Take one frame of each running drive.

        Args:
            detections: Detections of these frames.
            dt: Seconds since the frame before.
            running: Drives that have such a frame.

        Returns:
            The tracks that are reported.
        """
        settings = self.settings
        self.frames += running

        # Tracks end with their drive and, where the settings say so, with a frame without detections.
        continuing = running.copy()
        if settings.forget_when_empty:
            continuing &= np.bincount(detections.drive, minlength=len(continuing)) > 0
        if not continuing.all():
            self.tracks = self.tracks[continuing[self.tracks.drive]]

        # Prediction: constant velocity over a span, one frame or its seconds (frames or seconds).
        span = (np.ones_like(dt) if settings.time == "frames" else dt)[self.tracks.drive]
        predict(self.tracks, span, settings)
        if self.coupled:
            predict_cross(self.tracks, span)

        # Ageing: every track counts as missed in this frame, until a match sets both to 0 (_update).
        self.tracks.misses = self.tracks.misses + 1
        self.tracks.unseen_s = self.tracks.unseen_s + dt[self.tracks.drive]

        # Data association and update: every track with the strong detections, greedily or by the Hungarian method, as
        # settings.assignment says. strong_score is on the scale of the scores as they come, logits too, unlike
        # sure_score, a probability that __init__ takes to that scale.
        is_strong = np.ones(len(detections), dtype=bool)
        if settings.strong_score is not None:
            is_strong = detections.score >= settings.strong_score
        strong = detections if is_strong.all() else detections[is_strong]
        track_rows, detection_rows = self._associate(strong, np.arange(len(self.tracks)), self.gate)
        self._update(track_rows, strong[detection_rows])

        # Second stage: tracks without a match with the weak detections (Pang et al., SimpleTrack, 2022).
        if settings.weak_gate is not None and not is_strong.all():
            weak = detections[~is_strong]
            weak_gate = np.full(len(self.gate), settings.weak_gate)
            track_rows, weak_rows = self._associate(weak, np.flatnonzero(self.tracks.misses > 0), weak_gate)
            self._update(track_rows, weak[weak_rows], alive_only=not settings.weak_updates)

        # Birth: of each strong detection without a match.
        unmatched = np.ones(len(strong), dtype=bool)
        unmatched[detection_rows] = False
        self.tracks = self.tracks.with_new(self._birth(strong[unmatched]))

        # Output: tracks with enough matches, or of the drive's first frames. Indexing copies: what is reported
        # stays as it is when tracks are updated later.
        reported = self.tracks[self._is_reported()]

        # Death: of tracks that were missed for too long.
        alive = self._is_alive()
        self.tracks = self.tracks if alive.all() else self.tracks[alive]
        return reported

    def _associate(
        self, detections: DetectionBatch, track_rows: Int[np.ndarray, " k"], gate: Float[np.ndarray, " labels"]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Rows of those tracks of ``track_rows`` that have a match, and the rows of their detections."""
        if not len(detections) or not len(track_rows):
            none = np.zeros(0, dtype=np.int64)
            return none, none
        tracks = self.tracks if len(track_rows) == len(self.tracks) else self.tracks[track_rows]
        track_boxes = np.column_stack([tracks.position_m, tracks.size_m, tracks.yaw_rad])
        detection_boxes = detections.boxes
        if self.settings.anchor == "bottom":
            track_boxes = _centred(track_boxes)
            detection_boxes = _centred(detection_boxes)
        matched, detection_rows = associate(
            track_boxes,
            tracks.drive,
            tracks.label,
            detection_boxes,
            detections.drive,
            detections.label,
            self.settings,
            gate,
            self._gate_uncertainty(tracks, detections),
        )
        return track_rows[matched], detection_rows

    def _gate_uncertainty(self, tracks: Tracks, detections: DetectionBatch) -> GateUncertainty | None:
        settings = self.settings
        if settings.gate_sigmas is None and not settings.gate_speed_m_s:
            return None
        radial = None
        if self.coupled and detections.radial is not None and settings.doppler_sigma_m_s is not None:
            radial = partial(
                radial_gaps,
                tracks,
                detections.radial,
                sigma_m_s=settings.doppler_sigma_m_s,
                span_m_s=settings.doppler_span_m_s,
            )
        return GateUncertainty(
            wider_m=settings.gate_speed_m_s * tracks.unseen_s,
            tracks_m2=tracks.position_var[:, :2],
            detections_m2=self._variance(detections.ray_m)[:, :2],
            radial=radial,
        )

    def _update(
        self, track_rows: Int[np.ndarray, " k"], detections: DetectionBatch, *, alive_only: bool = False
    ) -> None:
        """Update tracks by their detections, or only note that they were seen."""
        tracks, settings = self.tracks, self.settings
        if not len(track_rows):
            return
        tracks.misses[track_rows] = 0
        tracks.unseen_s[track_rows] = 0.0
        if alive_only:
            return
        tracks.hits[track_rows] += 1
        tracks.best_score[track_rows] = np.maximum(tracks.best_score[track_rows], detections.score)
        tracks.range_m[track_rows] = np.hypot(*detections.ray_m.T)
        tracks.source[track_rows] = detections.source
        tracks.score[track_rows] = detections.score
        if settings.motion == "detection":
            tracks.position_m[track_rows] = detections.boxes[:, :3]
            tracks.size_m[track_rows] = detections.boxes[:, 3:6]
            tracks.yaw_rad[track_rows] = detections.boxes[:, 6]
            tracks.velocity[track_rows, :2] = detections.velocity_m_s
            return
        variance = self._variance(detections.ray_m)
        if not self.coupled:
            update(tracks, track_rows, detections.boxes, variance, settings)
            return
        # With radial velocities: x and y together, z on its own axis, then the radial velocity.
        covariance = variance[:, :2, None] * np.eye(2)
        if settings.range_sigma_m is not None:
            covariance = polar_covariance(detections.ray_m, settings.range_sigma_m, settings.azimuth_sigma_rad)
        update(tracks, track_rows, detections.boxes, variance, settings, axes=slice(2, 3))
        update_coupled(tracks, track_rows, detections.boxes[:, :2], covariance)
        self._update_doppler(tracks, track_rows, detections)

    def _update_doppler(self, tracks: Tracks, track_rows: Int[np.ndarray, " k"], detections: DetectionBatch) -> None:
        sigma, span = self.settings.doppler_sigma_m_s, self.settings.doppler_span_m_s
        if detections.radial is not None and sigma is not None:
            range_m = np.hypot(*detections.ray_m.T)
            update_doppler(tracks, track_rows, detections.radial, range_m, sigma_m_s=sigma, span_m_s=span)

    def _variance(self, ray_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Variances of detected positions: the same for all, or by range and direction."""
        settings = self.settings
        variance = np.full((len(ray_m), 3), settings.measurement_variance)
        if settings.range_sigma_m is not None:
            range_m = np.hypot(*ray_m.T)
            unit2 = (ray_m / np.maximum(range_m, 1e-9)[:, None]) ** 2
            across = (range_m * settings.azimuth_sigma_rad) ** 2
            variance[:, :2] = settings.range_sigma_m**2 * unit2 + across[:, None] * unit2[:, ::-1]
        return variance

    def _birth(self, detections: DetectionBatch) -> Tracks:
        """New tracks, numbered by drive in the order of the detections."""
        n, settings = len(detections), self.settings
        rank = np.arange(n) - np.searchsorted(detections.drive, detections.drive)
        track_id = self.next_id[detections.drive] + rank
        self.next_id += np.bincount(detections.drive, minlength=len(self.next_id))
        velocity = np.zeros((n, 3))
        if settings.motion == "detection" or settings.time == "seconds":
            velocity[:, :2] = detections.velocity_m_s
        variance = np.full((n, 3), settings.initial_variance)
        born = Tracks(
            drive=detections.drive,
            track_id=track_id,
            label=detections.label,
            position_m=detections.boxes[:, :3].copy(),
            velocity=velocity,
            position_var=variance,
            position_velocity_cov=np.zeros((n, 3)),
            velocity_var=np.full((n, 3), settings.initial_speed_variance),
            size_m=detections.boxes[:, 3:6].copy(),
            yaw_rad=detections.boxes[:, 6].copy(),
            shape_var=variance[:, 0].copy(),
            hits=np.ones(n, dtype=np.int64),
            misses=np.zeros(n, dtype=np.int64),
            unseen_s=np.zeros(n),
            source=detections.source.copy(),
            score=detections.score.copy(),
            best_score=detections.score.copy(),
            range_m=np.hypot(*detections.ray_m.T),
            cross_cov=np.zeros((n, 2, 2)),
        )
        if self.coupled:
            if settings.across_speed_m_s is not None and detections.radial is not None:
                narrow_births(born, detections.radial, settings.across_speed_m_s)
            self._update_doppler(born, np.arange(n), detections)
        return born

    def _is_reported(self) -> Bool[np.ndarray, " n"]:
        tracks, settings = self.tracks, self.settings
        proven = (tracks.hits >= self._by_range("min_hits")) | (self.frames[tracks.drive] <= settings.warm_up)
        proven &= (tracks.best_score >= self.sure_score) | (tracks.hits >= settings.unsure_hits)
        return proven & (self._is_alive() if settings.report_coasted else (tracks.misses == 0))

    def _is_alive(self) -> Bool[np.ndarray, " n"]:
        """Which tracks have not been missed for too long; one that was matched just now lives."""
        tracks, longest_s = self.tracks, self.settings.max_age_s
        if longest_s is None:
            return np.asarray(tracks.misses < self._by_range("max_age"))
        return np.asarray((tracks.misses == 0) | (tracks.unseen_s < longest_s - _TICK_S))

    def _by_range(self, name: str) -> int | Int[np.ndarray, " n"]:
        """An option that may be another one far away."""
        near = int(getattr(self.settings, name))
        if self.settings.far_m is None:
            return near
        return np.where(self.tracks.range_m >= self.settings.far_m, getattr(self.settings, f"far_{name}"), near)


def _centred(box_rows: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 7"]:
    """Boxes given by the centres of their bottoms, as boxes given by their centres."""
    centred = box_rows.copy()
    centred[:, 2] += box_rows[:, 5] / 2
    return centred


class _DetectionTable:
    """All detections as rows by frame number, then drive, then falling score.

    Args:
        detections: The detections.
        drives: Their frames.
        labels: Names of the classes; a row holds a class's number.
        settings: Which detections take part, and which point of a box is filtered.
    """

    def __init__(
        self, detections: Detections, drives: Sequence[Timeline], labels: Sequence[str], settings: TrackerSettings
    ) -> None:
        self.drives, self.labels, self.settings = drives, labels, settings
        label_numbers = {name: number for number, name in enumerate(labels)}
        frames = [_frame_rows(Boxes.empty(scored=True), 0, 0, None, {}, label_numbers, settings)]
        for drive_number, drive in enumerate(drives):
            for number, key in enumerate(drive.keys):
                if key in detections.boxes and len(detections.boxes[key]):
                    pose = None if drive.world_T_frame is None else drive.world_T_frame[number]
                    details = detections.prediction_details.get(key, {})
                    columns = _frame_rows(
                        detections.boxes[key], drive_number, number, pose, details, label_numbers, settings
                    )
                    columns["radial"][:, 3:6] = drive.sensor_velocity_m_s[number]
                    frames.append(columns)
        table = {name: np.concatenate([columns[name] for columns in frames]) for name in frames[0]}
        order = np.lexsort(
            [table["boxes"][:, 1], table["boxes"][:, 0], -table["score"], table["drive"], table["number"]]
        )
        self.columns = {name: values[order] for name, values in table.items()}
        longest = max((len(drive.keys) for drive in drives), default=0)
        self.start = np.searchsorted(self.columns["number"], np.arange(longest + 1))
        names = ("drive", "boxes", "velocity_m_s", "ray_m", "score", "label", "radial")
        self.detections = DetectionBatch(**{name: self.columns[name] for name in names}, source=np.arange(len(order)))

    def frame(self, number: int) -> DetectionBatch:
        """Detections of the frame of this number of all drives."""
        return self.detections[slice(self.start[number], self.start[number + 1])]

    def boxes_of(self, reported: list[tuple[int, Tracks]]) -> tuple[dict[Key, Boxes], dict[Key, np.ndarray]]:
        """Reported tracks, by frame number, as boxes in their frames' coordinates, and the boxes in the image."""
        boxes = {key: Boxes.empty(scored=True) for drive in self.drives for key in drive.keys}
        box_px = {key: np.zeros((0, 4)) for key in boxes}
        for number, tracks in reported:
            bounds = np.searchsorted(tracks.drive, np.arange(len(self.drives) + 1))
            for drive in np.unique(tracks.drive).tolist():
                of_drive = tracks[np.arange(bounds[drive], bounds[drive + 1])]
                key = self.drives[drive].keys[number]
                boxes[key] = self._boxes(of_drive, drive, number)
                box_px[key] = self.columns["box_px"][of_drive.source]
        return boxes, box_px

    def _boxes(self, tracks: Tracks, drive: int, number: int) -> Boxes:
        box_rows = np.column_stack([tracks.position_m, tracks.size_m, tracks.yaw_rad])
        if self.settings.output == "detection":
            box_rows = np.where((tracks.misses == 0)[:, None], self.detections.boxes[tracks.source], box_rows)
        if self.settings.anchor == "bottom":
            box_rows[:, 2] += box_rows[:, 5] / 2
        boxes = Boxes(
            centre_m=box_rows[:, :3],
            size_m=np.maximum(box_rows[:, 3:6], 1e-3),
            yaw_rad=box_rows[:, 6],
            label=[self.labels[number] for number in tracks.label.tolist()],
            score=tracks.score,
            track_id=tracks.track_id,
            velocity_m_s=tracks.velocity if self.settings.time == "seconds" else None,
        )
        pose = self.drives[drive].world_T_frame
        return boxes if pose is None else boxes.transform(np.linalg.inv(pose[number]))


def _frame_rows(
    boxes: Boxes,
    drive: int,
    number: int,
    pose: Float[np.ndarray, "4 4"] | None,
    details: Mapping[str, np.ndarray],
    label_numbers: dict[str, int],
    settings: TrackerSettings,
) -> dict[str, np.ndarray]:
    """The columns of one frame's detections that take part."""
    n = len(boxes)
    box_px = _checked_column(details, "box_px", np.full((n, 4), -1.0))
    radial = _radial(details, boxes.centre_m, pose)
    score = np.ones(n) if boxes.score is None else boxes.score
    takes_part = np.ones(n, dtype=bool) if settings.least_score is None else score >= settings.least_score
    if settings.suppress_iou is not None:
        takes_part = _suppress(boxes, score, takes_part, settings.suppress_iou)
    boxes, score = boxes[takes_part], score[takes_part]
    ray = boxes.centre_m
    if pose is not None:
        ray = ray @ pose[:3, :3].T
        boxes = boxes.transform(pose)
    box_rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])
    if settings.anchor == "bottom":
        box_rows[:, 2] -= box_rows[:, 5] / 2
    velocity = np.zeros((len(boxes), 2)) if boxes.velocity_m_s is None else np.nan_to_num(boxes.velocity_m_s[:, :2])
    return {
        "drive": np.full(len(boxes), drive),
        "number": np.full(len(boxes), number),
        "boxes": box_rows,
        "velocity_m_s": velocity,
        "ray_m": ray[:, :2],
        "score": score,
        "label": np.array([label_numbers[str(name)] for name in boxes.label], dtype=np.int64),
        "box_px": box_px[takes_part],
        "radial": radial[takes_part],
    }


def _radial(
    details: Mapping[str, np.ndarray], centre_m: Float[np.ndarray, "n 3"], pose: Float[np.ndarray, "4 4"] | None
) -> Float[np.ndarray, "n 7"]:
    """Rays and measured velocities along them; the sensor's velocity is still 0."""
    n = len(centre_m)
    ray = _checked_column(details, "doppler_ray", centre_m)
    ray = ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
    ray = ray if pose is None else ray @ pose[:3, :3].T
    return np.column_stack([ray, np.zeros((n, 3)), _checked_column(details, "doppler_m_s", np.full(n, np.nan))])


def _checked_column(details: Mapping[str, np.ndarray], name: str, default: np.ndarray) -> np.ndarray:
    """A column of details, checked against the shape that it must have."""
    values = np.asarray(details[name], dtype=np.float64) if name in details else default
    if values.shape != default.shape:
        raise ConfigError(f"{name} of predictions: expected shape {default.shape}, got {values.shape}")
    return values


def _suppress(boxes: Boxes, score: np.ndarray, takes_part: np.ndarray, most_iou: float) -> np.ndarray:
    """Non-maximum suppression: boxes that overlap no better one that stays."""
    iou = pairwise_iou(boxes, boxes)
    stays = np.zeros(len(boxes), dtype=bool)
    for row in np.argsort(-score, kind="stable").tolist():
        stays[row] = takes_part[row] and not (iou[row, stays] > most_iou).any()
    return stays
