"""Texts of other people's data sets for fuzz_readers.py: labels, radar targets, sensors and poses."""

import json
import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from farfield.files import aimotive, argoverse1, dual_radar

Recipe = tuple[str, Callable[[Path], Any], tuple[bytes, ...], Callable[[Any], bool], tuple[bytes, ...]]
_TIME_NS = 315978406019574000


def set_targets() -> Mapping[str, Recipe]:
    """Suffix, reader, good files, what a valid result is, and files that must be refused, by the reader's name."""
    box = {"ActorName": "CAR 1", "ObjectId": 1, "ObjectType": "CAR", "Occluded": 0, "Truncated": 1}
    parts = {"Origin": (30.0, -5.0, 0.5), "Extent": (4.5, 1.9, 1.6), "Orientation Quat": (0.0, 0.0, 0.6)}
    box |= {
        f"BoundingBox3D {name} {axis}": value
        for name, values in parts.items()
        for axis, value in zip("XYZ", values, strict=True)
    }
    box |= {"BoundingBox3D Orientation Quat W": 0.8} | {f"Relative Velocity {axis}": 1.5 for axis in "XYZ"}
    boxes = {"CapturedObjects": [box | {"ObjectId": number} for number in range(6)], "Timestamp": "4833189570000"}
    target = dict(zip(aimotive.RADAR_COLUMNS, (0.1, -0.02, 40.0, -29.5, 2.5, 139.0, 103.0), strict=True))
    lens = {"focal_length_px": [100, 110], "principal_point_px": [32, 24], "distortion_coeffs": [0.1] * 5}
    camera = lens | {"sensor_type": "camera", "model": "mei", "image_resolution_px": [64, 48]}
    sensors = {"C": camera | {"RT_body_from_sensor": np.eye(4).tolist()}, "Imu0": {"sensor_type": "imu"}}
    label = {
        "center": {"x": 12.0, "y": -3.0, "z": 0.9},
        "rotation": {"w": 0.8, "x": 0.0, "y": 0.0, "z": 0.6},
        **{"length": 4.5, "width": 1.9, "height": 1.8, "label_class": "VEHICLE", "timestamp": _TIME_NS, "occlusion": 0},
    }
    labels = [label | {"track_label_uuid": f"00000000-{number}"} for number in range(6)]
    line = "Car 0.1 1 0 10 20 30 40 1.6 1.8 4.4 1.0 1.6 20.0 0.3 -1 7"
    pose = {"rotation": [0.8, 0, 0, 0.6], "translation": [2000.0, -300.0, 15.0]}
    read_labels = partial(argoverse1.read_sweep_labels, time_ns=_TIME_NS)
    return {
        "aimotive boxes": (".json", aimotive.read_boxes, (_json(boxes),), _finite_boxes, ()),
        "aimotive targets": (".json", aimotive.read_targets, (_json({"targets": [target] * 6}),), _finite, ()),
        "aimotive sensors": (".json", aimotive.read_sensors, (_json(sensors),), bool_of_any, ()),
        "argoverse1 labels": (".json", read_labels, (_json(labels),), _finite_boxes, ()),
        "argoverse1 pose": (".json", argoverse1.read_ego_pose, (_json(pose),), _finite_pose, ()),
        "dual radar labels": (".txt", dual_radar.read_track_labels, ((f"{line}\n" * 6).encode(),), bool_of_any, ()),
    }


def _json(content: Any) -> bytes:
    return json.dumps(content).encode()


def bool_of_any(result: Any) -> bool:
    """Any result is sound that the reader gives."""
    return result is not None


def _finite(table: np.ndarray) -> bool:
    return bool(np.isfinite(table).all())


def _finite_boxes(boxes: Any) -> bool:
    return bool(np.isfinite(boxes.centre_m).all() and (boxes.size_m > 0).all())


def _finite_pose(pose: tuple[np.ndarray, np.ndarray]) -> bool:
    return math.isclose(float(np.linalg.norm(pose[0])), 1, abs_tol=0.02) and bool(np.isfinite(pose[1]).all())
