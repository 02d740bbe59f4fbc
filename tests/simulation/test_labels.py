"""Visible-part boxes: the smallest box of the true heading round the hits, with a margin, inside the body."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.frame import Boxes
from farfield.simulation.labels import MARGIN_M, visible_boxes


def body(yaw: float, centre: tuple[float, float, float] = (50.0, 4.0, -1.0), label: str = "vehicle") -> Boxes:
    return Boxes(centre_m=np.array([centre]), size_m=np.array([[4.6, 1.9, 1.5]]), yaw_rad=np.array([yaw]), label=label)


def on_body(full: Boxes, local: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(full.yaw_rad[0]), np.sin(full.yaw_rad[0])
    turned = np.stack([cos * local[:, 0] - sin * local[:, 1], sin * local[:, 0] + cos * local[:, 1], local[:, 2]], 1)
    return (turned + full.centre_m[0]).astype(np.float32)


@given(yaw=st.floats(-3.1, 3.1), seed=st.integers(0, 1000))
@settings(max_examples=50, deadline=None)
def test_box_hugs_the_points_at_every_heading(yaw: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    local = rng.uniform(-0.5, 0.5, (30, 3)) * [4.6, 1.9, 1.5] * 0.9
    full = body(yaw)
    box = visible_boxes(full, on_body(full, local), np.zeros(30, dtype=np.int64))
    np.testing.assert_allclose(box.size_m[0], np.ptp(local, axis=0) + 2 * MARGIN_M, atol=1e-4)
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    np.testing.assert_allclose(box.centre_m[0], on_body(full, middle[None])[0], atol=1e-4)
    assert box.yaw_rad[0] == full.yaw_rad[0]


def test_rear_of_a_car_ahead_gets_its_least_thickness_away_from_the_sensor() -> None:
    """Hits on a flat rear at x = 47.7: the box begins a margin before it and grows forwards to 0.3 m."""
    full = body(0.0)
    local = np.array([[-2.3, y, z] for y in (-0.8, 0.0, 0.8) for z in (-0.5, 0.3)])
    box = visible_boxes(full, on_body(full, local), np.zeros(6, dtype=np.int64))
    assert box.size_m[0] == pytest.approx([0.3, 1.7, 0.9], abs=1e-5)
    assert box.centre_m[0, 0] - box.size_m[0, 0] / 2 == pytest.approx(47.7 - MARGIN_M, abs=1e-5)


def test_front_of_an_oncoming_car_grows_backwards_too() -> None:
    full = body(np.pi)  # its front, at local x = 2.3, faces the sensor
    local = np.array([[2.3, y, z] for y in (-0.8, 0.8) for z in (-0.5, 0.3)])
    box = visible_boxes(full, on_body(full, local), np.zeros(4, dtype=np.int64))
    assert box.centre_m[0, 0] - box.size_m[0, 0] / 2 == pytest.approx(47.7 - MARGIN_M, abs=1e-5)
    assert box.size_m[0, 0] == pytest.approx(0.3, abs=1e-5)


def test_noise_does_not_push_the_box_out_of_the_body() -> None:
    full = body(0.3)
    local = np.array([[-3.5, 0, 0], [3.5, 1.4, 1.2], [0, -1.4, -1.2]])
    box = visible_boxes(full, on_body(full, local), np.zeros(3, dtype=np.int64))
    np.testing.assert_allclose(box.size_m[0], full.size_m[0] + 2 * MARGIN_M, atol=1e-9)
    np.testing.assert_allclose(box.centre_m, full.centre_m, atol=1e-9)


def test_several_bodies_in_any_order_of_points(rng: np.random.Generator) -> None:
    full = Boxes.concatenate([body(0.1), body(1.2, (80.0, -9.0, 0.0), "pedestrian")])
    owner = rng.integers(0, 2, 60)
    local = rng.uniform(-0.5, 0.5, (60, 3)) * 1.2
    points = np.concatenate([on_body(full[int(k)], row[None]) for k, row in zip(owner, local, strict=True)])
    boxes = visible_boxes(full, points, owner)
    for index in range(2):
        single = visible_boxes(full[index], points[owner == index], np.zeros((owner == index).sum(), dtype=np.int64))
        np.testing.assert_allclose(boxes.centre_m[index], single.centre_m[0], atol=1e-12)
        np.testing.assert_allclose(boxes.size_m[index], single.size_m[0], atol=1e-12)
