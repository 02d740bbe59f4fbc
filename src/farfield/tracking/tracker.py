"""Detections of drives to detections with identities and velocities."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.metrics.detections import Detections
from farfield.tracking.engine import DetectionBatch, TrackEngine
from farfield.tracking.kalman import Tracks
from farfield.tracking.presets import preset
from farfield.tracking.settings import TrackerSettings
from farfield.tracking.timeline import Timeline, assumed, is_number, timelines


def track(found: Detections, settings: TrackerSettings | str = "default", **changes: Any) -> Detections:
    """Give detections identities and velocities, frame by frame, without looking ahead.

    Drives come from ``found.drives`` with their stamps and poses. Without drives, a sequence is a drive; frames whose
    names are whole numbers are taken in their order from 0 on, the missing ones as frames without detections and
    without annotated boxes.

    Args:
        found: Scored boxes. ``prediction_details`` may hold ``doppler_m_s``, radial velocities relative to the sensor
            as measured, away from it positive, NaN for none, shape (n,), and ``doppler_ray``, the mean direction from
            the sensor to the points that they were measured on, shape (n, 3), else that to the box's centre is taken.
        settings: Options, or a preset's name.
        **changes: Options that differ from these.

    Returns:
        The same with boxes that bear ``track_id``, from 0 in each drive, and ``velocity_m_s`` over ground where steps
        are seconds; ``box_px`` is that of the track's last detection. Notes say what was assumed.

    Raises:
        ConfigError: If an option is impossible, or a column of details has not a row for each box.
    """
    chosen = (preset(settings) if isinstance(settings, str) else settings).changed(**changes)
    drives = timelines(found, step_s=chosen.step_s, ego_motion=chosen.ego_motion)
    notes = assumed(drives, seconds=chosen.time == "seconds", ego_motion=chosen.ego_motion, step_s=chosen.step_s)
    labels = sorted({str(name) for boxes in found.boxes.values() for name in np.unique(boxes.label)})
    table = _DetectionTable(found, drives, labels, chosen)
    radial = any("doppler_m_s" in details for details in found.prediction_details.values())
    engine = TrackEngine(chosen, drives=len(drives), labels=labels, logits=_are_logits(found), doppler=radial)
    shown: list[tuple[int, Tracks]] = []
    for number in range(max((len(drive.keys) for drive in drives), default=0)):
        running = np.array([number < len(drive.keys) for drive in drives])
        dt = np.array([drive.step_s[number] if number < len(drive.keys) else 0.0 for drive in drives])
        shown.append((number, engine.step(table.frame(number), dt, running)))
    boxes, details = table.assembled(shown)
    in_image = any("box_px" in known for known in found.prediction_details.values())
    kept = {key: {"box_px": rows} for key, rows in details.items()} if in_image else {}
    return replace(
        found,
        boxes=boxes,
        prediction_details=kept,
        annotations=_with_filled(found.annotations, boxes),
        notes=(*found.notes, *notes),
    )


def _are_logits(found: Detections) -> bool:
    """Whether any score lies outside [0, 1]."""
    scores = [boxes.score for boxes in found.boxes.values() if boxes.score is not None]
    return any(((score < 0) | (score > 1)).any() for score in scores)


def _with_filled(annotations: Mapping[Key, Annotation], boxes: Mapping[Key, Boxes]) -> dict[Key, Annotation]:
    """Annotations, and empty ones for the missing frames of annotated sequences, where a track may coast."""
    annotated = {sequence for sequence, _ in annotations}
    missing = [key for key in boxes if key not in annotations and key[0] in annotated and is_number(key[1])]
    return {**annotations} | {key: Annotation(boxes=Boxes.empty()) for key in missing}


class _DetectionTable:
    """All detections as rows by frame number, then drive, then falling score."""

    def __init__(
        self, found: Detections, drives: Sequence[Timeline], labels: Sequence[str], settings: TrackerSettings
    ) -> None:
        self.drives, self.labels, self.settings = drives, labels, settings
        number_of = {name: number for number, name in enumerate(labels)}
        parts: list[dict[str, np.ndarray]] = []
        for place, drive in enumerate(drives):
            for number, key in enumerate(drive.keys):
                if key in found.boxes and len(found.boxes[key]):
                    pose = None if drive.world_T_frame is None else drive.world_T_frame[number]
                    known = found.prediction_details.get(key, {})
                    part = _frame_rows(found.boxes[key], place, number, pose, known, number_of, settings)
                    part["radial"][:, 3:6] = drive.sensor_velocity_m_s[number]
                    parts.append(part)
        empty = _frame_rows(Boxes.empty(scored=True), 0, 0, None, {}, number_of, settings)
        joined = {name: np.concatenate([part[name] for part in (empty, *parts)]) for name in empty}
        order = np.lexsort(
            [joined["rows"][:, 1], joined["rows"][:, 0], -joined["score"], joined["drive"], joined["number"]]
        )
        self.columns = {name: values[order] for name, values in joined.items()}
        most = max((len(drive.keys) for drive in drives), default=0)
        self.start = np.searchsorted(self.columns["number"], np.arange(most + 1))
        fields = ("drive", "rows", "velocity_m_s", "ray_m", "score", "label", "radial")
        self.seen = DetectionBatch(**{name: self.columns[name] for name in fields}, source=np.arange(len(order)))

    def frame(self, number: int) -> DetectionBatch:
        """Detections of the frame of this number of all drives."""
        return self.seen[slice(self.start[number], self.start[number + 1])]

    def assembled(self, shown: list[tuple[int, Tracks]]) -> tuple[dict[Key, Boxes], dict[Key, np.ndarray]]:
        """Reported tracks as boxes in their frames' coordinates, and the boxes in the image."""
        boxes = {key: Boxes.empty(scored=True) for drive in self.drives for key in drive.keys}
        box_px = {key: np.zeros((0, 4)) for key in boxes}
        for number, tracks in shown:
            bounds = np.searchsorted(tracks.drive, np.arange(len(self.drives) + 1))
            for place in np.unique(tracks.drive).tolist():
                part = tracks[np.arange(bounds[place], bounds[place + 1])]
                key = self.drives[place].keys[number]
                boxes[key] = self._boxes(part, place, number)
                box_px[key] = self.columns["box_px"][part.source]
        return boxes, box_px

    def _boxes(self, part: Tracks, place: int, number: int) -> Boxes:
        rows = np.column_stack([part.place_m, part.size_m, part.yaw_rad])
        if self.settings.output == "detection":
            rows = np.where((part.misses == 0)[:, None], self.seen.rows[part.source], rows)
        if self.settings.anchor == "bottom":
            rows[:, 2] += rows[:, 5] / 2
        boxes = Boxes(
            centre_m=rows[:, :3],
            size_m=np.maximum(rows[:, 3:6], 1e-3),
            yaw_rad=rows[:, 6],
            label=[self.labels[number] for number in part.label.tolist()],
            score=part.score,
            track_id=part.name,
            velocity_m_s=part.speed if self.settings.time == "seconds" else None,
        )
        pose = self.drives[place].world_T_frame
        return boxes if pose is None else boxes.transform(np.linalg.inv(pose[number]))


def _frame_rows(
    boxes: Boxes,
    drive: int,
    number: int,
    pose: Float[np.ndarray, "4 4"] | None,
    known: Mapping[str, np.ndarray],
    number_of: dict[str, int],
    settings: TrackerSettings,
) -> dict[str, np.ndarray]:
    """The columns of one frame's detections that take part."""
    score = np.ones(len(boxes)) if boxes.score is None else boxes.score
    kept = np.ones(len(boxes), dtype=bool) if settings.least_score is None else score >= settings.least_score
    if settings.suppress_iou is not None:
        kept = _unsuppressed(boxes, score, kept, settings.suppress_iou)
    sensed = boxes.centre_m
    boxes, score = boxes[kept], score[kept]
    ray = boxes.centre_m
    if pose is not None:
        ray = ray @ pose[:3, :3].T
        boxes = boxes.transform(pose)
    rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])
    if settings.anchor == "bottom":
        rows[:, 2] -= rows[:, 5] / 2
    speed = np.zeros((len(boxes), 2)) if boxes.velocity_m_s is None else np.nan_to_num(boxes.velocity_m_s[:, :2])
    return {
        "drive": np.full(len(boxes), drive),
        "number": np.full(len(boxes), number),
        "rows": rows,
        "velocity_m_s": speed,
        "ray_m": ray[:, :2],
        "score": score,
        "label": np.array([number_of[str(name)] for name in boxes.label], dtype=np.int64),
        "box_px": _column(known, "box_px", np.full((len(kept), 4), -1.0))[kept],
        "radial": _radial(known, sensed, pose)[kept],
    }


def _radial(
    known: Mapping[str, np.ndarray], centre_m: Float[np.ndarray, "n 3"], pose: Float[np.ndarray, "4 4"] | None
) -> Float[np.ndarray, "n 7"]:
    """Rays and measured velocities along them; the sensor's velocity is still 0."""
    n = len(centre_m)
    ray = _column(known, "doppler_ray", centre_m)
    ray = ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
    ray = ray if pose is None else ray @ pose[:3, :3].T
    return np.column_stack([ray, np.zeros((n, 3)), _column(known, "doppler_m_s", np.full(n, np.nan))])


def _column(known: Mapping[str, np.ndarray], name: str, otherwise: np.ndarray) -> np.ndarray:
    """A column of details, checked against the shape that it must have."""
    values = np.asarray(known[name], dtype=np.float64) if name in known else otherwise
    if values.shape != otherwise.shape:
        raise ConfigError(f"{name} of predictions: expected shape {otherwise.shape}, got {values.shape}")
    return values


def _unsuppressed(boxes: Boxes, score: np.ndarray, kept: np.ndarray, most: float) -> np.ndarray:
    """Boxes that overlap no better one that stays."""
    iou = pairwise_iou(boxes, boxes)
    left = np.zeros(len(boxes), dtype=bool)
    for row in np.argsort(-score, kind="stable").tolist():
        left[row] = kept[row] and not (iou[row, left] > most).any()
    return left
