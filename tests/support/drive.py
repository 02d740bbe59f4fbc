"""A small drive in memory, with every kind of product that K-Radar has."""

from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.kradar import KRadarWriter
from farfield.datasets.kradar.layout import os2_T_radar
from farfield.frame import Annotation, Boxes, Camera, Cloud, Constant, Frame, Sensor, camera_sensor
from farfield.geometry.poses import pose_from_yaw

OS2_T_OS1 = pose_from_yaw(0.01, (0.35, 0.0, -0.25))


def cloud(rng: np.random.Generator, lines: int, columns: int, count: int, first_ns: int = 0) -> Cloud:
    """Points in random places of the grid, in the order of the file: ring by ring."""
    place = np.sort(rng.choice(lines * columns, count, replace=False))
    points = rng.normal(0, 40, (count, 3)).astype(np.float32)
    extra = {
        "ring": (place // columns).astype(np.uint8),
        "column": (place % columns).astype(np.uint16),
        "time_ns": rng.integers(first_ns, first_ns + 100_000_000, count).astype(np.int32),
        "reflectivity": rng.integers(0, 256, count).astype(np.uint16),
        "ambient": rng.integers(0, 65536, count).astype(np.uint16),
        "range_mm": rng.integers(0, 240_000, count).astype(np.uint32),
    }
    return Cloud(points, rng.random(count, dtype=np.float32), extra)


def camera(yaw_rad: float) -> Camera:
    """An eye with the real intrinsics that looks to the given direction."""
    base = Camera(matrix=np.array([[567.72, 0, 628.72], [0, 577.21, 369.31], [0, 0, 1.0]]))
    pose = base.camera_T_lidar @ pose_from_yaw(-yaw_rad, (0.18, -0.13, 0.02))
    distortion = np.array([-0.0289, 0.0006, 0.00396, -0.00505, 0.0])
    return Camera(matrix=base.matrix, distortion=distortion, camera_T_lidar=pose, width_px=1280, height_px=720)


def boxes(rng: np.random.Generator) -> Boxes:
    """One box of each class that K-Radar annotates, and an animal, which it does not."""
    label = ["vehicle", "large_vehicle", "motorcycle", "bicycle", "pedestrian", "animal"]
    return Boxes(
        centre_m=rng.normal(0, 40, (6, 3)),
        size_m=rng.uniform(0.5, 8, (6, 3)),
        yaw_rad=rng.uniform(-np.pi, np.pi, 6),
        label=label,
        track_id=np.array([3, 7, 8, 11, 12, 90]),
    )


def frame(number: int, *, sequence: str = "1", lead: int = 32, weather: str = "light_snow", **rest: Any) -> Frame:
    """Frame ``number`` (from 1) of a sequence: boxes, two small clouds, sparse radar, the front camera."""
    rng = np.random.default_rng((int(sequence), number))
    annotation = Annotation(boxes=boxes(rng), visibility=["R", "L", "L1", "R", "R", "R"])
    time_ns = 1_643_292_946_710_046_076 + number * 100_000_000
    content: dict[str, Any] = {
        "sequence": sequence,
        "frame_id": str(number),
        "time_ns": time_ns,
        "clouds": {"os2-64": cloud(rng, 64, 512, 900), "os1-128": cloud(rng, 128, 512, 1500, -50_000_000)},
        "radar": {"sparse": np.abs(rng.normal(0, 30, (50, 4)))},
        "images": {
            name: rng.integers(0, 256, (36, 64, 3), dtype=np.uint8) for name in ("cam-front", "cam-front-right")
        },
        "cameras": {"cam-front": camera(0.01), "cam-front-right": camera(0.02), "cam-rear": camera(3.1)},
        "load_annotation": Constant(annotation),
        "sensors": {
            "os2-64": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=time_ns),
            "os1-128": Sensor(kind="lidar", frame_T_sensor=OS2_T_OS1, in_frame=False, time_ns=time_ns + 1),
            "cam-front": camera_sensor(camera(0.01), time_ns - 5),
            "radar": Sensor(kind="radar", frame_T_sensor=os2_T_radar(), time_ns=time_ns + 7),
        },
        "conditions": {"road": "suburban", "time": "day", "weather": weather},
        "world_T_frame": pose_from_yaw(0.01 * number, (5.0 + 1.5 * number, 2.0, 1.6)),
        "reference": "os2-64",
        "indices": {
            "radar": number + lead,
            "os2-64": number,
            "cam-front": 3 * number - 1,
            "os1-128": number,
            "cam-lrr": 3 * number + 1,
        },
    }
    return Frame(**(content | rest))


def write_kradar(root: Path) -> Path:
    """Two frames of K-Radar on one of the authors' disks."""
    writer = KRadarWriter(root / "dir_1to20", columns=512)
    for number in (2, 3):
        writer.write(frame(number))
    writer.finish()
    return root
