"""Tracks as files: KITTI's tracking text, nuScenes' tracking JSON, our CSV."""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import ConfigError
from farfield.files.atomic import write_text
from farfield.files.boxes_csv import BoxRows, write_boxes_csv_parts
from farfield.files.coordinates import camera_words, write_coordinates
from farfield.files.kitti import KittiObjects, KittiTracks, write_tracking
from farfield.files.nuscenes import WORLD
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.kitti import camera_from_lidar
from farfield.metrics.detections import Detections
from farfield.metrics.frames import frame_order
from farfield.vocabulary.counts import count_of

MOST_BOXES = 500
"""Boxes of a sample that nuScenes' format holds."""


def write_kitti_tracks(folder: Path | str, tracks: Detections) -> list[Path]:
    """Write KITTI's tracking text, a file a sequence; frames are named by whole numbers.

    Boxes stand on plain camera axes at the sensor's origin, as :mod:`farfield.metrics.box_files` reads them. The box in
    the image is that of ``prediction_details``, -1 where there is none. A sequence without boxes is an empty file.

    Returns:
        The files.

    Raises:
        ConfigError: If a frame is not named by a whole number, or a box has no track.
    """
    keys = sorted(tracks.boxes, key=frame_order)
    wrong = [key for key in keys if not (key[1].isascii() and key[1].isdigit())]
    if wrong:
        raise ConfigError(
            f"KITTI's tracking text: expected frames named by whole numbers, got {wrong[0]}. Write boxes-csv instead"
        )
    paths = []
    for sequence in dict.fromkeys(key[0] for key in keys):
        path = Path(folder) / f"{sequence or 'tracks'}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_tracking(path, _kitti_tracks([key for key in keys if key[0] == sequence], tracks))
        paths.append(path)
    if tracks.reference:
        already = tracks.reference.startswith(("camera ", "a camera's axes"))
        write_coordinates(Path(folder), tracks.reference if already else camera_words("", tracks.reference))
    return paths


def _kitti_tracks(keys: list[Key], tracks: Detections) -> KittiTracks:
    boxes = Boxes.concatenate([_check_ids(tracks.boxes[key], key) for key in keys])
    frame = np.repeat([int(key[1]) for key in keys], [len(tracks.boxes[key]) for key in keys])
    bottom, size, rotation = camera_from_lidar(boxes.centre_m, boxes.size_m, boxes.yaw_rad)
    box_px = [
        np.asarray(
            tracks.prediction_details.get(key, {}).get("box_px", np.full((len(tracks.boxes[key]), 4), -1.0)),
            dtype=np.float64,
        )
        for key in keys
    ]
    objects = KittiObjects(
        type=np.asarray(boxes.label),
        truncation=np.zeros(len(boxes)),
        occlusion=np.zeros(len(boxes), dtype=np.int64),
        alpha_rad=np.mod(rotation - np.arctan2(bottom[:, 0], bottom[:, 2]) + np.pi, 2 * np.pi) - np.pi,
        box_px=np.concatenate([np.zeros((0, 4)), *box_px]),
        size_m=size,
        bottom_m=bottom,
        rotation_y_rad=rotation,
        score=np.ones(len(boxes)) if boxes.score is None else boxes.score,
        line=np.arange(1, len(boxes) + 1),
    )
    ids = np.zeros(0, dtype=np.int64) if boxes.track_id is None else boxes.track_id
    return KittiTracks(frame=frame.astype(np.int64), track_id=ids, objects=objects)


def _check_ids(boxes: Boxes, key: Key) -> Boxes:
    if len(boxes) and (boxes.track_id is None or (boxes.track_id < 0).any()):
        raise ConfigError(f"expected boxes with a track_id, got a box without one in {key}; track them first")
    return boxes


def write_tracks_csv(path: Path | str, tracks: Detections) -> None:
    """Write our CSV of boxes, with ``track_id`` and velocities where they are known."""
    write_boxes_csv_parts(path, _csv_parts(tracks))


def _csv_parts(tracks: Detections) -> Iterator[BoxRows]:
    named = any(sequence for sequence, _ in tracks.boxes)
    for key in sorted(tracks.boxes, key=frame_order):
        boxes = _check_ids(tracks.boxes[key], key)
        yield BoxRows(
            sequence=np.full(len(boxes), key[0]) if named else None,
            frame=np.full(len(boxes), key[1]),
            label=np.asarray(boxes.label),
            centre_m=boxes.centre_m,
            size_m=boxes.size_m,
            yaw_rad=boxes.yaw_rad,
            score=boxes.score,
            track_id=boxes.track_id,
            velocity_m_s=boxes.velocity_m_s,
            reference=np.full(len(boxes), tracks.reference) if tracks.reference else None,
        )


def write_nuscenes_tracks(path: Path | str, tracks: Detections, *, names: Mapping[str, str] | None = None) -> None:
    """Write nuScenes' tracking JSON: every frame is a sample, boxes stand in the world where drives have poses.

    Args:
        path: The file.
        tracks: Boxes with ``track_id``; frame names are the samples' tokens. Scores lie in [0, 1].
        names: nuScenes' class names by ours; others stay.

    Raises:
        ConfigError: If a box has no track, a score is outside [0, 1], or a sample has more than 500 boxes.
    """
    poses = {
        key: drive.world_T_frame[number]
        for drive in tracks.drives
        if drive.world_T_frame is not None
        for number, key in enumerate(drive.keys)
    }
    results: dict[str, list[dict[str, Any]]] = {}
    for key in sorted(tracks.boxes, key=frame_order):
        boxes = _check_ids(tracks.boxes[key], key)
        if len(boxes) > MOST_BOXES or key[1] in results:
            expected = f"at most {MOST_BOXES} boxes a sample, and each token once"
            raise ConfigError(
                f"nuScenes' tracking JSON: expected {expected}; got {count_of(len(boxes), 'box', 'boxes')} in {key}"
            )
        boxes = boxes.transform(poses[key]) if key in poses else boxes
        results[key[1]] = [_nuscenes_box(boxes, row, key, names or {}) for row in range(len(boxes))]
    meta: dict[str, Any] = {f"use_{name}": name == "lidar" for name in _SENSORS}
    reference = WORLD if poses else tracks.reference
    meta |= {"reference": reference} if reference else {}
    write_text(path, json.dumps({"meta": meta, "results": results}, allow_nan=False) + "\n")


_SENSORS = ("camera", "lidar", "radar", "map", "external")


def _nuscenes_box(boxes: Boxes, row: int, key: Key, names: Mapping[str, str]) -> dict[str, Any]:
    score = 1.0 if boxes.score is None else float(boxes.score[row])
    if not 0 <= score <= 1:
        raise ConfigError(f"nuScenes' tracking JSON: expected scores in [0, 1], got {score:g} in {key}")
    length, width, height = boxes.size_m[row].tolist()
    yaw, label = float(boxes.yaw_rad[row]), str(boxes.label[row])
    speed = [0.0, 0.0] if boxes.velocity_m_s is None else np.nan_to_num(boxes.velocity_m_s[row, :2]).tolist()
    track_id = -1 if boxes.track_id is None else int(boxes.track_id[row])
    return {
        "sample_token": key[1],
        "translation": boxes.centre_m[row].tolist(),
        "size": [width, length, height],
        "rotation": [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)],
        "velocity": speed,
        "tracking_id": f"{key[0]}:{track_id}",
        "tracking_name": names.get(label, label),
        "tracking_score": score,
    }
