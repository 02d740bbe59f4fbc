"""Sweeps as training data: their own objects gone, road users on their ground, what may be a car unsure."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.memory import InMemory
from farfield.frame import Boxes, Cloud, Frame
from farfield.geometry.boxes import count_points_in_boxes, points_in_boxes
from farfield.geometry.iou import pairwise_iou
from farfield.simulation.donor_frames import DonorConfig, DonorFrames, road_direction_rad
from farfield.simulation.donors import DonorSweep
from farfield.vocabulary.classes import UNSURE

pytest.importorskip("embreex")

FEW = DonorConfig(copies=3, vehicles=4, pedestrians=1, bicycles=1, large_vehicles=0, rows=1.0)


def street(road_rad: float = 0.0, walls_m: float = 12.0) -> np.ndarray:
    """Ground 1.8 m below a turning sensor of 64 rows, and a wall on each side of a road."""
    up, around = np.meshgrid(np.deg2rad(np.linspace(3, -22, 64)), np.linspace(-np.pi, np.pi, 600, endpoint=False))
    directions = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(
        -1, 3
    )
    across = -np.sin(road_rad) * directions[:, 0] + np.cos(road_rad) * directions[:, 1]
    with np.errstate(divide="ignore"):
        to_ground = np.where(directions[:, 2] < 0, -1.8 / directions[:, 2], np.inf)
        to_wall = walls_m / np.abs(across)
    range_m = np.minimum(to_ground, to_wall)
    range_m[range_m > 80] = np.inf
    return directions[np.isfinite(range_m)] * range_m[np.isfinite(range_m), None]


def block(x: float, y: float, rng: np.random.Generator) -> np.ndarray:
    """Something of a car's size."""
    return rng.uniform([x - 2, y - 0.9, -1.7], [x + 2, y + 0.9, -0.3], (300, 3))


BOX = Boxes(
    centre_m=np.array([[15.0, 4, -1]]), size_m=np.array([[4.4, 2, 1.6]]), yaw_rad=np.zeros(1), label=["vehicle"]
)


def sweeps(
    rng: np.random.Generator, boxes: Boxes | None = None, intensity: bool = True, walls_m: float = 12.0
) -> InMemory:
    points = np.concatenate([street(walls_m=walls_m), block(15, 4, rng), block(-12, -5, rng)])
    strength = np.full(len(points), 0.3, dtype=np.float32) if intensity else None
    return InMemory([Frame.of(Cloud(points, strength), boxes)])


def test_frames_are_made_of_a_sweep_and_repeat_themselves(rng: np.random.Generator) -> None:
    frames = DonorFrames(sweeps(rng), FEW, "lidar")
    again = pickle.loads(pickle.dumps(frames))
    assert len(frames) == 3
    assert len(set(frames.keys)) == 3
    labels = set()
    for index in range(3):
        frame = frames[index]
        np.testing.assert_array_equal(frame.cloud().points_m, again[index].cloud().points_m)
        boxes = frame.boxes[frame.boxes.label != UNSURE]
        labels |= set(boxes.label.tolist())
        assert count_points_in_boxes(frame.cloud().points_m, boxes, margin_m=0.1).min() > 0
        overlap = pairwise_iou(boxes, boxes, kind="bev")
        assert overlap[~np.eye(len(boxes), dtype=bool)].max() == 0
        bottom = boxes.centre_m[:, 2] - boxes.size_m[:, 2] / 2
        np.testing.assert_allclose(bottom, -1.8, atol=0.15)
    assert "vehicle" in labels
    assert {"pedestrian", "bicycle"} & labels
    assert not np.array_equal(frames[0].cloud().points_m, frames[1].cloud().points_m)


def test_what_may_be_a_car_is_unsure_and_what_is_annotated_is_gone(rng: np.random.Generator) -> None:
    bare, annotated = (DonorFrames(sweeps(rng, boxes, walls_m=np.inf), FEW, "lidar") for boxes in (None, BOX))
    trusted = DonorFrames(sweeps(rng, BOX, walls_m=np.inf), FEW.model_copy(update={"annotated_to_m": 30.0}), "lidar")
    counts = [int((data[0].boxes.label == UNSURE).sum()) for data in (bare, annotated, trusted)]
    assert counts == [2, 1, 0]
    unsure = bare[0].boxes[bare[0].boxes.label == UNSURE]
    assert min(map(len, points_in_boxes(bare[0].cloud().points_m.astype(np.float64), unsure))) > 100
    assert unsure.size_m[:, :2].max() > 4.9  # with a band round it
    users = bare[0].boxes[bare[0].boxes.label != UNSURE]
    assert pairwise_iou(users, unsure, kind="bev").max() == 0


def test_sweeps_without_intensity_stay_without(rng: np.random.Generator) -> None:
    cloud = DonorFrames(sweeps(rng, intensity=False), FEW, "lidar")[0].cloud()
    assert cloud.intensity is None


def test_cars_stand_along_the_road_wherever_it_leads() -> None:
    for road_deg in (0.0, 35.0, 120.0):
        sweep = DonorSweep.of(Cloud(street(np.deg2rad(road_deg))))
        assert np.rad2deg(road_direction_rad(sweep)) == pytest.approx(road_deg, abs=3)


@pytest.mark.slow
def test_open_sweeps_lend_their_background(shared_open: Path) -> None:
    """Ousters, and the VLS-128 without rings or intensity, whose rows are rebuilt from the angles."""
    for folder, options in (("ouster", {}), ("velodyne_vls128", {"rotate_deg": -90})):
        data = open_dataset(shared_open / folder, **options)
        cloud = next(iter(data[0].clouds))
        frame = DonorFrames(data, DonorConfig(copies=1), cloud)[0]
        labels = frame.boxes.label.tolist()
        assert labels.count(UNSURE) > 3
        assert labels.count("vehicle") >= 2
        sweep = DonorSweep.of(data[0].cloud())
        assert len(sweep.open_rays) > 0.05 * len(sweep.points_m)
