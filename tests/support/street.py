"""A small synthetic world for tests: boxes whose visible faces carry points, on a flat ground."""

from pathlib import Path

import numpy as np

from farfield.datasets.cirrus import CirrusWriter
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame, Sensor

START_NS = 1_558_131_117_608_556_768
GROUND_M = -1.9


def street(rng: np.random.Generator, count: int = 30) -> tuple[Cloud, Boxes]:
    """Cars and trucks at random headings, points on their faces towards the sensor, and ground points."""
    size = np.where(rng.random((count, 1)) < 0.8, [4.6, 1.9, 1.6], [11.0, 2.6, 3.4]) * rng.uniform(0.9, 1.1, (count, 3))
    spots = np.stack(np.meshgrid(np.arange(10, 240, 23.0), np.arange(-36, 37, 18.0)), -1).reshape(-1, 2)
    at = spots[rng.permutation(len(spots))[:count]]
    boxes = Boxes(
        centre_m=np.column_stack([at, GROUND_M + size[:, 2] / 2]),
        size_m=size,
        yaw_rad=rng.uniform(-np.pi, np.pi, count),
        label=["vehicle" if length < 7 else "large_vehicle" for length in size[:, 0]],
    )
    parts = [_faces(rng, boxes, index) for index in range(count)]
    ground = rng.uniform([0, -60, GROUND_M - 0.02], [250, 60, GROUND_M + 0.02], (20000, 3))
    points = np.concatenate([*parts, ground]).astype(np.float32)
    return Cloud(points, rng.uniform(0, 0.8, len(points)).astype(np.float32)), boxes


def _faces(rng: np.random.Generator, boxes: Boxes, index: int) -> np.ndarray:
    number = max(6, int(4000 / np.hypot(*boxes.centre_m[index, :2])))
    local = rng.uniform(-0.5, 0.5, (number, 3))
    axis = rng.integers(0, 2, number)
    cos, sin = np.cos(boxes.yaw_rad[index]), np.sin(boxes.yaw_rad[index])
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    towards = -(boxes.centre_m[index] @ turn)
    local[np.arange(number), axis] = 0.5 * np.sign(towards[axis])
    return (local * boxes.size_m[index] * 0.999) @ turn.T + boxes.centre_m[index]


def street_frame(rng: np.random.Generator, number: int = 0) -> Frame:
    cloud, boxes = street(rng)
    time_ns = START_NS + number * 100_000_000
    return Frame(
        sequence="street",
        frame_id=str(time_ns),
        time_ns=time_ns,
        clouds={"gaussian": cloud},
        sensors={"gaussian": Sensor(kind="lidar")},
        load_annotation=Constant(Annotation(boxes=boxes, extent="visible")),
    )


def write_street(folder: Path, rng: np.random.Generator, *, frames: int = 3) -> Path:
    """Write a few frames in the Cirrus layout; returns the data set's root."""
    writer = CirrusWriter(folder)
    for number in range(frames):
        writer.write(street_frame(rng, number))
    return folder / "Cirrus_dataset1"
