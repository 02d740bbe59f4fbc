"""A small evaluation on made-up frames: enough for every part of a page."""

from typing import Any

import numpy as np
import pytest

from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.report_data import annotated_objects
from farfield.frame import Annotation, Cloud, Constant, Frame, Sensor
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.centre.dds import DdsSettings, evaluate_dds


def make_boxes(rng: np.random.Generator, x_m: list[float], **extra: Any) -> Boxes:
    n = len(x_m)
    return Boxes(
        centre_m=np.column_stack([x_m, rng.uniform(-20, 20, n), np.full(n, -1.0)]),
        size_m=np.tile([4.5, 1.9, 1.6], (n, 1)),
        yaw_rad=rng.uniform(-3, 3, n),
        label=extra.pop("label", "vehicle"),
        **extra,
    )


def make_cloud(rng: np.random.Generator, n: int) -> Cloud:
    points = np.column_stack([rng.uniform(1, 250, n), rng.uniform(-50, 50, n), rng.uniform(-2, 3, n)])
    return Cloud(points.astype(np.float32), rng.uniform(0, 1, n).astype(np.float32))


@pytest.fixture(scope="session")
def camera() -> Camera:
    matrix = np.array([[60.0, 0, 60], [0, 60, 40], [0, 0, 1]])
    return Camera(matrix=matrix, width_px=120, height_px=80)


@pytest.fixture(scope="session")
def evaluation(camera: Camera) -> Evaluation:
    rng = np.random.default_rng(20260101)
    annotations, predictions, frames = {}, {}, []
    for number in range(2):
        key = (f"drive_{number}", "100")
        counts = np.array([300, 40, 5, 9])
        label = ["vehicle", "vehicle", "large_vehicle", "pedestrian"]
        boxes = make_boxes(rng, [20.0, 90.0, 180.0, 30.0], label=label, point_count=counts)
        found = boxes[np.array([0, 1])].replace(score=np.array([0.9, 0.8]), label="vehicle", point_count=None)
        annotations[key], predictions[key] = boxes, found
        clouds = {"gaussian": make_cloud(rng, 200), "uniform": make_cloud(rng, 150)}
        images = {"camera": rng.integers(0, 255, (80, 120, 3)).astype(np.uint8)}
        frame = Frame(
            sequence=key[0],
            frame_id=key[1],
            clouds=clouds,
            images=images,
            cameras={"camera": camera},
            sensors={name: Sensor(kind="lidar") for name in clouds},
            load_annotation=Constant(Annotation(boxes=boxes)),
            conditions={"weather": "normal"},
        )
        frames.append(FrameView(frame=frame, predictions=dict.fromkeys(clouds, found), title=f"Frame <{number}>"))
    settings = DdsSettings(bootstrap=Bootstrap(replicates=5))
    result = evaluate_dds(predictions, annotations, settings).to_json()
    return Evaluation(
        title="A & B",
        results={"gaussian": result, "uniform": result},
        frames=frames[:1],
        settings={"detector": "none", "range_m": 250.0},
        provenance={"simulated": True, "trained_on": "nothing", "seed": 1},
        objects={"gaussian": annotated_objects(predictions, annotations)},
    )
