"""Folders of clouds of a wanted size for tests and benchmarks of the page: a road, walls, moving vehicles, boxes."""

import json
from pathlib import Path

import numpy as np

VEHICLE_M = (4.6, 1.9, 1.6)
GROUND_M = -1.7


def write_folder(folder: Path, frames: int, points: int, seed: int = 0) -> Path:
    """Clouds as KITTI writes them and the boxes of twenty vehicles beside them; what is there already stays."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame in range(frames):
        cloud = folder / f"{frame:06d}.bin"
        if cloud.exists():
            continue
        rng = np.random.default_rng([seed, frame])
        boxes = vehicles(frame)
        rows = np.concatenate([_ground(rng, points // 2), _walls(rng, points // 4), _bodies(rng, points // 4, boxes)])
        rows = rows[np.argsort(np.arctan2(rows[:, 1], rows[:, 0]), kind="stable")]
        cloud.write_bytes(rows.astype("<f4").tobytes())
        entries = [
            {"label": "vehicle", "centre_m": box[:3], "size_m": box[3:6], "yaw_rad": box[6], "track_id": place + 1}
            for place, box in enumerate(boxes)
        ]
        (folder / f"{frame:06d}.json").write_text(json.dumps({"boxes": entries}))
    return folder


def vehicles(frame: int) -> list[list[float]]:
    """Twenty boxes on four lanes, each lane with its own speed."""
    out = []
    for place in range(20):
        lane, row = place % 4, place // 4
        x = -30 + (12 + 25 * row + frame * 0.1 * (lane - 1.5) * 6 + 60) % 150
        yaw = 0.0 if lane < 2 else np.pi - 1e-6
        out.append([x, -5.25 + 3.5 * lane, GROUND_M + VEHICLE_M[2] / 2, *VEHICLE_M, yaw])
    return out


def _ground(rng: np.random.Generator, count: int) -> np.ndarray:
    rings = 1.7 / np.tan(np.radians(np.linspace(1.2, 24.0, 48)))
    r = rng.choice(rings, count) * rng.normal(1, 0.002, count)
    angle = rng.uniform(-np.pi, np.pi, count)
    z = GROUND_M + rng.normal(0, 0.02, count)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z, rng.uniform(0.05, 0.3, count)])


def _walls(rng: np.random.Generator, count: int) -> np.ndarray:
    x, side = rng.uniform(-60, 160, count), rng.choice([-1.0, 1.0], count)
    y = side * (14 + 2 * np.floor(np.sin(x / 9) * 2)) + rng.normal(0, 0.03, count)
    return np.column_stack([x, y, rng.uniform(GROUND_M, 6, count), rng.uniform(0.2, 0.9, count)])


def _bodies(rng: np.random.Generator, count: int, boxes: list[list[float]]) -> np.ndarray:
    """Points on the faces that look at the sensor."""
    which = rng.integers(0, len(boxes), count)
    centre, size = np.array(boxes)[which, :3], np.array(VEHICLE_M)
    local = rng.uniform(-0.5, 0.5, (count, 3)) * size
    along = rng.random(count) < 0.4
    local[along, 0] = -np.sign(centre[along, 0]) * size[0] / 2
    local[~along, 1] = -np.sign(centre[~along, 1]) * size[1] / 2
    return np.column_stack([centre + local + rng.normal(0, 0.02, (count, 3)), rng.uniform(0.3, 1, count)])
