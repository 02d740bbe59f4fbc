"""What stands in a sweep that nobody annotated is no background: few points, long bodies, what touches a hedge."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float64

pytest.importorskip("embreex")

from farfield.datasets.memory import InMemory
from farfield.frame import Boxes, Cloud, Frame
from farfield.geometry.boxes import points_in_boxes
from farfield.simulation import donor_frames
from farfield.simulation.donor_frames import DonorConfig, DonorFrames, unsure_boxes
from farfield.simulation.donors import DonorSweep


def ground(rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """A level one, 1.8 m below the sensor."""
    return np.column_stack([rng.uniform(-80, 80, (60_000, 2)), rng.normal(-1.8, 0.02, 60_000)])


def body(low: list[float], high: list[float], count: int, rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    return rng.uniform(low, high, (count, 3))


def share_unsure(points_m: np.ndarray, unsure: Boxes) -> float:
    rows = points_in_boxes(points_m, unsure)
    return len(np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *rows]))) / len(points_m)


def test_what_stands_is_unsure_whatever_its_size_and_its_points(rng: np.random.Generator) -> None:
    rear = np.array([[60.0, y, z] for y, z in ((10.2, -1.2), (10.6, -0.9), (11.3, -1.0))])  # of a car of 4.4 m
    users = {
        "a car of three points": rear,
        "a car of one point": np.array([[-70.0, 30.0, -0.9]]),
        "a bus": body([20, -9, -1.7], [32, -6.5, 1.2], 1500, rng),
        "a car at a hedge": body([-20, 9.1, -1.7], [-15.6, 10.8, -0.4], 400, rng),
        "a car under a crown": body([10, 20, -1.7], [14.4, 21.8, -0.4], 300, rng),
    }
    hedge = body([-30, 10.5, -1.7], [10, 11.5, -0.2], 6000, rng)
    crown = body([9, 18, 1.5], [15, 24, 4], 900, rng)
    sweep = DonorSweep.of(Cloud(np.concatenate([ground(rng), hedge, crown, *users.values()]).astype(np.float32)))
    unsure = unsure_boxes(sweep, 0.5)
    for name, points in users.items():
        low = points[:, 2] > -1.4
        assert share_unsure(points[low], unsure) == 1, name
    assert share_unsure(np.array([[62.2, 10.75, -1.0]]), unsure) == 1  # the middle of the car behind its rear
    assert share_unsure(ground(rng), unsure) < 0.05  # the road stays background
    assert len(unsure) <= 1000


def test_boxes_of_what_stands_are_bounded_in_number(rng: np.random.Generator) -> None:
    posts = np.column_stack([rng.uniform(-80, 80, (5000, 2)), rng.uniform(-1.2, -0.2, 5000)])
    unsure = unsure_boxes(DonorSweep.of(Cloud(np.concatenate([ground(rng), posts]).astype(np.float32))), 0.5)
    assert len(unsure) <= 1000
    assert share_unsure(posts, unsure) > 0.99


def test_a_single_point_has_a_box_without_a_band() -> None:
    rng = np.random.default_rng(1)
    point = np.array([[9.0, 3.0, -0.9]])
    unsure = unsure_boxes(DonorSweep.of(Cloud(np.concatenate([ground(rng), point]).astype(np.float32))), 0)
    assert share_unsure(point, unsure) == 1


def test_what_is_unsure_is_looked_for_once_a_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames are drawn at random over all sweeps, more than are held in memory."""
    rng, looked = np.random.default_rng(1), []
    points = ground(rng)[::100].astype(np.float32)
    data = InMemory([replace(Frame.of(Cloud(points)), frame_id=str(row)) for row in range(40)])
    frames = DonorFrames(data, DonorConfig(copies=2, vehicles=0, large_vehicles=0, pedestrians=0, bicycles=0), "lidar")
    monkeypatch.setattr(donor_frames, "unsure_boxes", lambda *inputs: looked.append(1) or unsure_boxes(*inputs))
    for index in (*range(0, 80, 2), *range(1, 80, 2)):
        frames[index].cloud()
    assert len(looked) == 40
    assert len(pickle.loads(pickle.dumps(frames))[0].cloud())
