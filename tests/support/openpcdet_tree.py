"""A custom set in OpenPCDet's layout, written byte by byte: ground, a parked car and a truck that stands across."""

from pathlib import Path

import numpy as np

CAR = np.array([10.0, 2.0, -0.9, 4.2, 1.8, 1.6, 0.4])  # x y z of the centre, length, width, height, yaw
TRUCK = np.array([24.0, -6.0, 0.1, 8.0, 2.5, 3.4, -1.3])
NAMES = ("Car", "Truck")


def body(box: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on the near half of a box, from its foot to its top."""
    own = rng.uniform((-0.48, -0.48, -0.48), (0.0, 0.2, 0.48), (count, 3)) * box[3:6]
    sin, cos = np.sin(box[6]), np.cos(box[6])
    turned = np.column_stack([own[:, 0] * cos - own[:, 1] * sin, own[:, 0] * sin + own[:, 1] * cos, own[:, 2]])
    return turned + box[:3]


def rows(number: int, *, columns: int = 4) -> np.ndarray:
    rng = np.random.default_rng(number)
    ground = np.column_stack([rng.uniform(-60, 60, (1500, 2)), rng.uniform(-1.9, -1.72, 1500)])
    places = np.concatenate([ground, body(CAR, 80, rng), body(TRUCK, 60, rng)])
    strength = rng.uniform(0, 1, len(places))
    ring = rng.integers(0, 32, len(places))
    return np.column_stack([places, strength, ring])[:, :columns].astype("<f4")


def write_openpcdet(root: Path, *, suffix: str = ".npy", bottom: bool = False, columns: int = 4) -> Path:
    """Three frames; two to train on, one to validate."""
    for folder in ("points", "labels", "ImageSets"):
        (root / folder).mkdir(parents=True)
    for number in range(3):
        table = rows(number, columns=columns)
        path = root / f"points/{number:06d}{suffix}"
        np.save(path, table) if suffix == ".npy" else path.write_bytes(table.tobytes())
        lines = []
        for box, name in zip((CAR, TRUCK), NAMES, strict=True):
            x, y, z, length, width, height, yaw = box.tolist()
            lines.append(f"{x} {y} {z - height / 2 if bottom else z} {length} {width} {height} {yaw} {name}\n")
        (root / f"labels/{number:06d}.txt").write_text("".join(lines))
    (root / "ImageSets/train.txt").write_text("000000\n000002\n")
    (root / "ImageSets/val.txt").write_text("000001")
    return root
